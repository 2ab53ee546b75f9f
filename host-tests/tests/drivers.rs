//! The drivers of the core with models of the chips, including bit errors.

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::{ErrorType as PinErrorType, InputPin, OutputPin};
use embedded_hal::pwm::{ErrorType as PwmErrorType, SetDutyCycle};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use host_tests::bench::chips::adis16495::{Adis16495Chip, Model, flag};
use host_tests::bench::chips::biss::BissChip;
use host_tests::bench::chips::bridge::{BridgeChip, PWM_PERIODS};
use host_tests::bench::chips::exchange;
use host_tests::bench::chips::kvh1750::Kvh1750Chip;
use host_tests::bench::wire::DUTY_STEPS;
use host_tests::virtual_unit::plant::Output;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rins_selfcal::acquisition::queue::{SampleQueue, SampleWithGimbal};
use rins_selfcal::acquisition::{Acquisition, Streaming};
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::loss::{LossCounts, LossReason};
use rins_selfcal::drivers::adis16495::{self, Adis16495, Clock, FilterBank, StartFault};
use rins_selfcal::drivers::biss::{BissEncoder, BissFault, Mounting, Resolution};
use rins_selfcal::drivers::bridge::{Bridge, BridgeDriverFault};
use rins_selfcal::drivers::kvh1750::{self, Kvh1750};
use rins_selfcal::drivers::{ImuFault, ImuReading};
use rins_selfcal::gimbal::GimbalStatus;
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// A bus whose answers come from a function.
struct Bus(Answer);

type Answer = Box<dyn FnMut(&mut [u8])>;

impl Bus {
    fn to(answer: impl FnMut(&mut [u8]) + 'static) -> Self {
        Self(Box::new(answer))
    }
}

impl ErrorType for Bus {
    type Error = Infallible;
}

impl SpiDevice for Bus {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        exchange(operations, &mut self.0);
        Ok(())
    }
}

fn random(seed: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(seed)
}

fn uniform(rng: &mut Xoshiro256PlusPlus) -> f64 {
    (rng.next_u64() >> 11) as f64 * 2_f64.powi(-53)
}

/// Flips each bit with this probability. Returns whether a bit was flipped.
fn spoil(rng: &mut Xoshiro256PlusPlus, bytes: &mut [u8], probability: f64) -> bool {
    let mut spoiled = false;
    for bit in 0..8 * bytes.len() {
        if uniform(rng) < probability {
            bytes[bit / 8] ^= 1 << (bit % 8);
            spoiled = true;
        }
    }
    spoiled
}

// --------------------------------------------------------------------------------------------------------- ADIS16495

type SharedImu = Rc<RefCell<Adis16495Chip>>;

struct ChipDelay(SharedImu);

impl DelayNs for ChipDelay {
    fn delay_ns(&mut self, ns: u32) {
        self.0.borrow_mut().elapse(ns.into());
    }
}

fn imu(model: Model) -> SharedImu {
    let mut chip = Adis16495Chip::new(model);
    chip.timed = true;
    Rc::new(RefCell::new(chip))
}

fn bus(chip: &SharedImu) -> Bus {
    let chip = Rc::clone(chip);
    Bus::to(move |bytes: &mut [u8]| chip.borrow_mut().transfer(bytes))
}

/// The driver of the IMU after its start on a chip, or the reason why the start failed.
fn started(chip: &SharedImu) -> Result<Adis16495<Bus>, StartFault<Infallible>> {
    Adis16495::start(bus(chip), &mut ChipDelay(Rc::clone(chip)), &adis16495::Adis16495Settings::default())
}

#[test]
fn the_imu_takes_every_setting_and_no_word_comes_too_early() {
    let banks = [None, Some(FilterBank::A), Some(FilterBank::D)];
    for (decimation, filter) in
        [1, 17, 20, 4250].into_iter().flat_map(|decimation| banks.map(|bank| (decimation, bank)))
    {
        for clock in [Clock::Internal, Clock::External { rate_hz: 4000 }] {
            let chip = imu(Model::ADIS16495_1);
            let settings = adis16495::Adis16495Settings { clock, decimation, filter, latency_us: 0 };
            Adis16495::start(bus(&chip), &mut ChipDelay(Rc::clone(&chip)), &settings).expect("a start");
            let chip = chip.borrow();
            assert_eq!((chip.early_words, chip.sampling()), (0, Some((decimation, clock != Clock::Internal))));
        }
    }
}

#[test]
fn samples_come_through_to_half_a_step_from_every_model() {
    let mut rng = random(1);
    for (product, number, fast) in [(16_495, 1, true), (16_495, 2, false), (16_495, 3, true), (16_497, 1, false)] {
        let chip = imu(Model { product, number });
        chip.borrow_mut().fast = fast;
        let mut driver = started(&chip).expect("a start");
        let gyro = [0.006_25, 0.025, 0.1][usize::from(number) - 1] / 65_536.0_f64;
        let accel = if product == 16_497 { 0.001_25 } else { 0.000_25 } / 65_536.0 * 9.806_65;
        for sample in 0..1000_u64 {
            let omega: [f64; 3] = std::array::from_fn(|_| 4.0 * uniform(&mut rng) - 2.0);
            let force: [f64; 3] = std::array::from_fn(|_| 40.0 * uniform(&mut rng) - 20.0);
            chip.borrow_mut().sample(omega, force, 31.25);
            let reading: ImuReading<f64> = driver.read(5000 * sample + 2500).expect("a sample");
            assert_eq!((reading.time_us, reading.missed, reading.temperature_c), (5000 * sample, 0, 31.25));
            let off = |read: &[f64], truth: &[f64; 3]| {
                read.iter().zip(truth).map(|(read, truth)| (read - truth).abs()).fold(0.0, f64::max)
            };
            assert!(off(reading.omega_g.as_slice(), &omega) <= 0.5001 * gyro.to_radians());
            assert!(off(reading.force_a.as_slice(), &force) <= 0.5001 * accel);
        }
    }
}

#[test]
fn an_imu_that_does_not_start_says_why() {
    for level in [0x00, 0xff] {
        let dead = Bus::to(move |bytes: &mut [u8]| bytes.fill(level));
        let word = u16::from_be_bytes([level; 2]);
        let fault =
            Adis16495::start(dead, &mut ChipDelay(imu(Model::ADIS16495_1)), &adis16495::Adis16495Settings::default());
        assert_eq!(fault.err(), Some(StartFault::Product(word)));
    }
    let chip = imu(Model::ADIS16495_1);
    chip.borrow_mut().fail_sensors(0b10_0001);
    assert_eq!(started(&chip).err(), Some(StartFault::Sensor(0b10_0001)));
}

#[test]
fn each_unit_says_which_one_it_is() {
    for (product, serial) in [(16_495, 1), (16_497, 0xffff)] {
        let chip = imu(Model { product, number: 1 });
        chip.borrow_mut().set_serial(serial);
        let identity = started(&chip).expect("a start").identity();
        assert_eq!(identity, ImuIdentity { product, serial: serial.into() });
    }
}

#[test]
fn a_flag_costs_the_samples_that_carry_it() {
    let chip = imu(Model::ADIS16495_1);
    let mut driver = started(&chip).expect("a start");
    let mut edges = (0..).step_by(5000);
    let mut read = || {
        chip.borrow_mut().sample([0.0; 3], [0.0; 3], 25.0);
        driver.read::<f64>(edges.next().unwrap()).map(|reading| reading.missed)
    };
    assert_eq!(read(), Ok(0));
    chip.borrow_mut().raise(flag::CLOCK);
    assert_eq!([read(), read()], [Err(ImuFault::Status(flag::CLOCK)), Ok(0)]);
}

/// The outcomes and the counts of losses of an acquisition from an IMU that samples for a minute at 200 Hz, is off for 0.3
/// s, and then gives 1000 samples, at 4250 Hz until it has its settings.
fn after_a_restart(settings_saved: bool) -> (Vec<Result<(), LossReason>>, LossCounts) {
    let chip = imu(Model::ADIS16495_1);
    let mut queue = SampleQueue::<f64, 16>::new();
    let (producer, mut samples) = queue.split();
    let mut acquisition = Acquisition::new(started(&chip).expect("a start"), producer);
    let mut edge_us = 0;
    let mut on_edge = |interval_us: u64| {
        edge_us += interval_us;
        chip.borrow_mut().elapse(1000 * interval_us);
        chip.borrow_mut().sample([0.1; 3], [0.0, 0.0, 9.8], 25.0);
        let taken = acquisition.on_data_ready(edge_us, |_| Ok(([Angle::default(); 2], GimbalStatus::default())));
        samples.pop();
        taken
    };
    assert!((0..12_000).all(|_| on_edge(5000).is_ok()));
    chip.borrow_mut().restart(settings_saved);
    let mut outcomes = vec![on_edge(300_000)];
    for _ in 1..1000 {
        let interval_us = match chip.borrow().sampling().expect("data-ready is on DIO2") {
            (decimation, false) => u64::from(decimation) * 1_000_000 / 4250,
            (decimation, true) => u64::from(decimation) * 250,
        };
        outcomes.push(on_edge(interval_us));
    }
    assert_eq!(chip.borrow().early_words, 0);
    (outcomes, samples.losses())
}

/// None of the samples that it gives without its settings is taken.
#[test]
fn an_imu_that_restarts_and_loses_its_settings_gets_them_again() {
    let (outcomes, losses) = after_a_restart(false);
    let taken = outcomes.iter().position(Result::is_ok).expect("samples are taken again");
    assert!((20..40).contains(&taken), "{taken}");
    let (lost, after) = outcomes.split_at(taken);
    assert!(lost.iter().all(|outcome| *outcome == Err(LossReason::Restarted)));
    assert!(after.iter().all(Result::is_ok));
    assert_eq!(losses, LossCounts { restarted: taken as u32, ..LossCounts::default() });
}

#[test]
fn an_imu_that_restarts_with_saved_settings_goes_on_after_a_check() {
    let (outcomes, losses) = after_a_restart(true);
    let (check, after) = outcomes.split_at(7);
    assert!(check.iter().all(|outcome| *outcome == Err(LossReason::Restarted)));
    assert!(after.iter().all(Result::is_ok));
    assert_eq!(losses, LossCounts { restarted: 7, ..LossCounts::default() });
}

/// One bit in a thousand is wrong, so that a quarter of the bursts is damaged. CRC-32 misses none of them in this run,
/// and every lost sample is reported.
#[test]
fn no_damaged_burst_passes_for_a_sample() {
    let mut rng = random(2);
    let chip = imu(Model::ADIS16495_1);
    let shared = Rc::clone(&chip);
    let probability = Rc::new(RefCell::new(0.0));
    let (noise, mut noise_rng) = (Rc::clone(&probability), random(3));
    let damaged = Bus::to(move |bytes: &mut [u8]| {
        shared.borrow_mut().transfer(bytes);
        spoil(&mut noise_rng, bytes, *noise.borrow());
    });
    let settings = adis16495::Adis16495Settings::default();
    let mut driver = Adis16495::start(damaged, &mut ChipDelay(Rc::clone(&chip)), &settings).expect("a start");
    *probability.borrow_mut() = 1e-3;
    let (mut lost, mut missed) = (0, 0);
    for edge_us in (0..).step_by(5000).take(100_000) {
        let omega: [f64; 3] = std::array::from_fn(|_| 0.1 * uniform(&mut rng));
        chip.borrow_mut().sample(omega, [0.0, 0.0, 9.8], 25.0);
        match driver.read::<f64>(edge_us) {
            Ok(reading) => {
                missed += reading.missed;
                assert!(reading.omega_g.iter().zip(omega).all(|(read, truth)| (read - truth).abs() < 1e-9));
            }
            Err(_) => lost += 1,
        }
    }
    // A burst has 288 bits, and at least one of them is wrong in 1 - 0.999^288 = 25 % of the bursts. A wrong bit in
    // the first of the two opening words does no harm.
    assert!((22_000..30_000).contains(&lost), "{lost}");
    assert_eq!(missed, 0, "each was told when it was lost");
}

// -------------------------------------------------------------------------------------------------------------- BiSS

#[test]
fn angles_come_through_either_way_and_from_any_zero() {
    let mut rng = random(4);
    for (bits, resolution) in [(26, Resolution::Bits26), (32, Resolution::Bits32)] {
        for reversed in [false, true] {
            let (zero_rad, acknowledge) = (1.25, 1 + (rng.next_u32() % 52).min(51));
            let chip = BissChip { zero_rad, reversed, acknowledge, ..BissChip::new(bits) };
            let truth = Rc::new(RefCell::new(0.0));
            let (angle, clocked) = (Rc::clone(&truth), chip.clone());
            let line = Bus::to(move |bytes: &mut [u8]| clocked.clock(*angle.borrow(), bytes));
            // Reading of the encoder at the zero of the axis.
            let offset_rad = if reversed { zero_rad } else { -zero_rad };
            let mounting = Mounting { zero: Angle::from_rad(offset_rad), reversed };
            let mut encoder = BissEncoder::new(line, resolution, mounting);
            let step = 1_i32 << (32 - bits);
            for _ in 0..2000 {
                *truth.borrow_mut() = 100.0 * uniform(&mut rng) - 50.0;
                let off = encoder.read().expect("an angle").since(Angle::from_rad(*truth.borrow()));
                assert!(off.abs() <= step / 2 + 2, "{off} {bits} {reversed}");
            }
        }
    }
}

#[test]
fn an_encoder_without_a_position_says_so() {
    let chip = Rc::new(RefCell::new(BissChip::new(32)));
    let clocked = Rc::clone(&chip);
    let line = Bus::to(move |bytes: &mut [u8]| clocked.borrow().clock(0.5, bytes));
    let mut encoder = BissEncoder::new(line, Resolution::Bits32, Mounting::STRAIGHT);
    let good = encoder.read();
    assert!(good.is_ok());
    chip.borrow_mut().warning = true;
    assert_eq!((encoder.read(), encoder.warnings()), (good, 1));
    chip.borrow_mut().error = true;
    assert_eq!(encoder.read(), Err(BissFault::Error));
    chip.borrow_mut().acknowledge = 100;
    assert_eq!(encoder.read(), Err(BissFault::NotReady));
    chip.borrow_mut().dead = true;
    assert_eq!(encoder.read(), Err(BissFault::NoAnswer));
}

/// One bit in a thousand is wrong, so that one frame in eleven is damaged. A frame has three wrong bits with a
/// probability of 1e-5, and the CRC of six bits passes one of 64 such frames. So a read gives a wrong angle with a
/// probability of 2e-7, and none is expected in this test.
#[test]
fn no_damaged_frame_passes_for_an_angle() {
    let chip = BissChip::new(32);
    let mut noise = random(5);
    let line = Bus::to(move |bytes: &mut [u8]| {
        chip.clock(2.5, bytes);
        spoil(&mut noise, bytes, 1e-3);
    });
    let mut encoder = BissEncoder::new(line, Resolution::Bits32, Mounting::STRAIGHT);
    let right = Angle::from_rad(2.5);
    let refused = (0..100_000).filter(|_| match encoder.read() {
        Ok(angle) => {
            assert_eq!(angle, right);
            false
        }
        Err(_) => true,
    });
    assert!((5000..12_000).contains(&refused.count()));
}

// --------------------------------------------------------------------------------------------------------------- KVH

/// What happens to a message on the line.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Whole,
    Spoiled,
    Cut,
    Preceded,
}

fn way(rng: &mut Xoshiro256PlusPlus) -> Way {
    match rng.next_u32() % 20 {
        0 => Way::Spoiled,
        1 => Way::Cut,
        2 => Way::Preceded,
        _ => Way::Whole,
    }
}

/// Messages are damaged, cut short, or preceded by other bytes. The driver reads all messages that arrive whole and no
/// others. It reports each of the others as damaged, or counts it as missing by the sequence numbers.
#[test]
fn every_whole_message_of_a_damaged_stream_is_read_and_no_other() {
    let mut rng = random(6);
    let (mut chip, mut driver) = (Kvh1750Chip::default(), Kvh1750::new(&kvh1750::Kvh1750Settings::default()));
    let (mut whole, mut read, mut told, mut missed) = (0, 0, 0, 0);
    for sample in 0..100_000 {
        let truth = f64::from(sample) * 1e-5;
        let mut message = chip.message([truth, 0.0, 0.0], [0.0, 0.0, 9.806_65], 30.0);
        let way = way(&mut rng);
        match way {
            Way::Whole => {}
            Way::Spoiled => {
                let at = rng.next_u32() as usize % message.len();
                message[at] ^= 1 << (rng.next_u32() % 8);
            }
            Way::Cut => message.truncate(rng.next_u32() as usize % 36),
            Way::Preceded => message.splice(0..0, (0..rng.next_u32() % 50).map(|k| (k * 37) as u8)).for_each(drop),
        }
        whole += u32::from(matches!(way, Way::Whole | Way::Preceded));
        for byte in message {
            match driver.push::<f64>(byte, 1_000_000) {
                Some(Ok(reading)) => {
                    read += 1;
                    missed += reading.missed;
                    assert!((reading.force_a.z - 9.806_65).abs() < 1e-6 && (reading.temperature_c - 30.0).abs() < 0.01);
                }
                Some(Err(_)) => told += 1,
                None => {}
            }
        }
    }
    assert_eq!(read, whole);
    let lost = 100_000 - whole;
    // A message that is cut within its header counts as missing and is not reported as damaged. One damaged message may
    // consist of parts of two.
    assert!(missed <= lost && missed + told >= lost - 1, "{missed} missed, {told} told of {lost}");
}

/// The bytes arrive one by one at 921 600 baud, as in the interrupt of a UART. They are 200 messages of a unit at 200
/// Hz whose outer axis turns at 20 deg/s. Every tenth message is damaged.
#[test]
fn a_streaming_imu_fills_the_queue_with_the_angles_of_its_stamps() {
    let (mut chip, mut queue) = (Kvh1750Chip::default(), SampleQueue::<f64, 256>::new());
    let (producer, mut samples) = queue.split();
    let mut streaming = Streaming::new(Kvh1750::new(&kvh1750::Kvh1750Settings::default()), producer);
    let outer = |time_us: u64| Angle::from_ticks((time_us as f64 * 1e-6 * 20.0 / 360.0 * 2_f64.powi(32)) as u32);
    let status = |time_us| GimbalStatus { time_us, ..GimbalStatus::default() };
    let view = |time_us| Ok(([outer(time_us), Angle::default()], status(time_us)));
    for interval in 1..=200_u64 {
        let mut message = chip.message([0.349, 0.0, 0.0], [0.0, 0.0, 9.806_65], 30.0);
        if interval % 10 == 0 {
            message[20] ^= 1;
        }
        let taken: Vec<_> = (1..)
            .zip(message)
            .filter_map(|(bytes, byte)| {
                streaming.on_byte(byte, interval * 5000 + 65 + bytes * 10_000_000 / 921_600, view)
            })
            .collect();
        assert_eq!(taken, [if interval % 10 == 0 { Err(LossReason::Crc) } else { Ok(()) }]);
    }
    assert_eq!(samples.losses(), LossCounts { crc: 20, ..LossCounts::default() });
    let taken: Vec<_> = std::iter::from_fn(|| samples.pop()).collect();
    assert_eq!(taken.len(), 180);
    for (interval, SampleWithGimbal { sample, gimbal }) in (1..).filter(|interval| interval % 10 != 0).zip(taken) {
        // The stamp is the middle of the interval, rounded to a microsecond.
        assert!(sample.time_us.abs_diff(interval * 5000 - 2500) <= 1, "{} {interval}", sample.time_us);
        assert_eq!((sample.outer, gimbal), (outer(sample.time_us), status(sample.time_us)));
        assert!((sample.omega_g.x - 0.349).abs() < 1e-7 && (sample.force_a.z - 9.806_65).abs() < 1e-6);
    }
}

/// The resolution of the outputs, compared with the noise of a unit of navigation grade at 200 Hz: numbers in single
/// precision of the KVH, and the steps of the ADIS16495.
#[test]
fn steps_of_the_numbers_are_lost_in_the_noise() {
    let mut rng = random(7);
    let (sigma_omega, sigma_force) = (0.001 / 60.0 * 200_f64.sqrt(), 10e-6 * 200_f64.sqrt());
    let (omega_deg_s, force_g) = (20.0, 0.999_999_7);
    let chip = imu(Model::ADIS16495_1);
    let mut adis = started(&chip).expect("a start");
    let (mut kvh_chip, mut kvh) = (Kvh1750Chip::default(), Kvh1750::new(&kvh1750::Kvh1750Settings::default()));
    let samples = 20_000_u32;
    let mut sums = [[0.0; 2]; 2];
    for sample in 0..samples {
        let mut noise = || Distribution::<f64>::sample(&StandardNormal, &mut rng);
        let omega = (omega_deg_s + sigma_omega * noise()).to_radians();
        let force = (force_g + sigma_force * noise()) * 9.806_65;
        chip.borrow_mut().sample([omega; 3], [force; 3], 25.0);
        let mut errors = |unit: usize, reading: ImuReading<f64>| {
            sums[unit][0] += (reading.omega_g.x - omega) / f64::from(samples);
            sums[unit][1] += (reading.force_a.x - force) / f64::from(samples);
        };
        errors(0, adis.read(5000 * u64::from(sample)).expect("a sample"));
        let message = kvh_chip.message([omega; 3], [force; 3], 25.0);
        let pushed = message.iter().find_map(|byte| kvh.push(*byte, 0));
        errors(1, pushed.expect("a message").expect("a good one"));
    }
    // Steps of the ADIS16495, and of a number in single precision below 1 g and 0.5 rad/s. The errors are uniform and
    // independent, so that their mean has a sigma of step / sqrt(12 samples). The bound is five sigma.
    let bound = |step: f64| 5.0 * step / (12.0 * f64::from(samples)).sqrt();
    let steps = [[1.67e-9, 3.8e-9 * 9.8], [2_f64.powi(-25), 2_f64.powi(-23) * 9.8]];
    for (sums, steps) in sums.iter().zip(steps) {
        assert!(sums.iter().zip(steps).all(|(sum, step)| sum.abs() < bound(step)), "{sums:?} {steps:?}");
    }
    // The rounding of a rate in single precision is less than a hundredth of the noise of one sample.
    let of_stop = steps[1][0] / 12_f64.sqrt() / sigma_omega.to_radians();
    assert!(of_stop < 0.01, "{of_stop}");
}

// ------------------------------------------------------------------------------------------------------------ bridge

/// One of the pins of a bridge.
struct Pin(Rc<RefCell<BridgeChip>>, fn(&mut BridgeChip, bool));

impl PinErrorType for Pin {
    type Error = Infallible;
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.1(&mut self.0.borrow_mut(), false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.1(&mut self.0.borrow_mut(), true);
        Ok(())
    }
}

impl InputPin for Pin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.borrow().fault_line())
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().fault_line())
    }
}

struct Pwm(Rc<RefCell<BridgeChip>>);

impl PwmErrorType for Pwm {
    type Error = Infallible;
}

impl SetDutyCycle for Pwm {
    fn max_duty_cycle(&self) -> u16 {
        DUTY_STEPS
    }
    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        let mut chip = self.0.borrow_mut();
        let BridgeChip { forward, enabled, .. } = *chip;
        chip.set(duty, forward, enabled);
        Ok(())
    }
}

#[test]
fn the_bridge_drives_as_commanded_and_opens_on_overcurrent() {
    let chip = Rc::new(RefCell::new(BridgeChip::default()));
    let pin = |set| Pin(Rc::clone(&chip), set);
    let direction = pin(|chip, high| chip.set(chip.duty, high, chip.enabled));
    let enable = pin(|chip, high| chip.set(chip.duty, chip.forward, high));
    let mut bridge = Bridge::with_pins(Pwm(Rc::clone(&chip)), direction, enable, pin(|_, _| {}));
    assert_eq!(chip.borrow().output(), Output::Open);
    bridge.enable().expect("no fault");
    assert_eq!(chip.borrow().output(), Output::Shorted);
    let mut rng = random(8);
    let mut before = 0.0;
    for _ in 0..10_000 {
        let part = 2.0 * uniform(&mut rng) - 1.0;
        bridge.command(part as f32).expect("no fault");
        match chip.borrow().output() {
            Output::Driven(driven) => assert!((driven - part).abs() <= 0.501 / f64::from(DUTY_STEPS)),
            output => assert!(output == Output::Shorted && part * before <= 0.0),
        }
        before = part;
    }
    assert_eq!(chip.borrow().hard_turns, 0);
    chip.borrow_mut().overcurrent = true;
    assert_eq!(bridge.command(0.5), Err(BridgeDriverFault::Reported));
    assert_eq!((chip.borrow().output(), bridge.is_on()), (Output::Open, false));
    bridge.enable().expect("the overcurrent is over");
    bridge.command(0.5).expect("no fault");
    assert_eq!(chip.borrow().output(), Output::Driven(0.5));
}

/// If the control stops and sets the PWM no longer, the bridge brakes its motor after 5 ms.
#[test]
fn a_bridge_without_control_brakes() {
    let mut chip = BridgeChip::default();
    chip.set(DUTY_STEPS / 2, true, true);
    let outputs: Vec<_> = (1..=20)
        .map(|_| {
            chip.begin_period();
            chip.output()
        })
        .collect();
    let (driven, after) = outputs.split_at(PWM_PERIODS as usize);
    assert!(driven.iter().all(|output| *output == Output::Driven(0.5)));
    assert!(after.iter().all(|output| *output == Output::Shorted));
    chip.set(DUTY_STEPS / 2, false, true);
    assert_eq!(chip.output(), Output::Driven(-0.5));
}
