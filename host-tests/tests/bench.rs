//! The drivers on the simulated bench, without the emulator.

use host_tests::bench::power_up::{Interrupts, share, shared};
use host_tests::bench::{Bench, Chip, Imu, Trouble, acquisition, control};
use host_tests::virtual_unit::plant::Output;
use host_tests::virtual_unit::plant::{Plant, Tick, at_rest};
use rins_selfcal::acquisition::queue::{SampleQueue, SampleWithGimbal};
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::loss::{LossCounts, LossReason};
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::gimbal::axis::AxisLimits;
use rins_selfcal::gimbal::control::COMMAND_DELAY_US;
use rins_selfcal::gimbal::servo::{MotorAndLoad, PERIOD_US};
use rins_selfcal::gimbal::{BridgeFault, Fault, FaultKind, Gimbal, MotionCommand};

fn gimbal() -> Gimbal<f64> {
    Gimbal::new(&[AxisLimits::default(); 2], &[MotorAndLoad::default(); 2])
}

/// Axes that are turned by hand, at constant rates, rad/s.
struct TurnedByHand([f64; 2], u64);

impl Plant for TurnedByHand {
    fn advance(&mut self, _outputs: [Output; 2]) -> Option<Tick> {
        self.1 += PERIOD_US;
        Some(Tick { encoders_rad: self.0.map(|rate| rate * self.1 as f64 * 1e-6), reading: None })
    }
}

#[test]
fn samples_go_through_the_drivers() {
    let bench = shared(at_rest(3));
    let mut queue = SampleQueue::<f64, 4>::new();
    let (producer, mut consumer) = queue.split();
    let mut interrupts = Interrupts::new(&bench, 200.0, gimbal(), producer);
    let mut edges = 0;
    while interrupts.period(&bench) {
        if !bench.borrow().data_ready() {
            continue;
        }
        let SampleWithGimbal { sample, gimbal } = consumer.pop().expect("a sample");
        // Half a step of the IMU is 1.9e-8 m/s^2.
        assert!((sample.force_a.z - 9.8_f64).abs() < 2e-8);
        assert_eq!((sample.time_us, sample.temperature_c), (edges * 5000 + 2500, 20.0));
        edges += 1;
        assert_eq!((gimbal.time_us, gimbal.at_rest, gimbal.fault), (edges * 5000, true, None));
    }
    assert_eq!((edges, consumer.losses()), (3, LossCounts::default()));
    assert_eq!(bench.borrow().outputs(), [Output::Shorted; 2], "nothing is driven without a command");
}

/// A message comes in the control period after its interval. Its stamp is the middle of that interval, rounded to a
/// microsecond.
#[test]
fn bytes_go_through_the_driver() {
    let bench = share(Bench::with_imu(at_rest(3), Imu::Kvh1750));
    let mut queue = SampleQueue::<f64, 4>::new();
    let (producer, mut consumer) = queue.split();
    let mut interrupts = Interrupts::new(&bench, 200.0, gimbal(), producer);
    let mut samples = Vec::new();
    while interrupts.period(&bench) {
        samples.extend(consumer.pop().map(|observed| (bench.borrow().now_us(), observed)));
    }
    let times: Vec<_> = samples.iter().map(|(now_us, observed)| (*now_us, observed.sample.time_us)).collect();
    assert_eq!(times, [(6000, 2500), (11_000, 7500)], "the third was on its way when the plant ended");
    for (now_us, SampleWithGimbal { sample, gimbal }) in samples {
        // Half a step of a single precision number of 1 g is 3e-8 g.
        assert!((sample.force_a.z - 9.8_f64).abs() < 3e-7);
        assert_eq!((sample.temperature_c, gimbal.time_us, gimbal.fault), (20.0, now_us, None));
    }
    assert_eq!(consumer.losses(), LossCounts::default());
}

/// Bytes wait in the receiver. Its transfers give all of them, whatever the sizes of the transfers are.
#[test]
fn the_receiver_gives_every_byte_with_its_age() {
    let mut bench = Bench::with_imu(at_rest(3), Imu::Kvh1750);
    (0..6).for_each(|_| assert!(bench.period()));
    let mut frame = [0; 1 + 3 * 31];
    let (mut bytes, mut ages) = (Vec::new(), Vec::new());
    for expected in [31, 5, 0] {
        bench.transfer(Chip::Imu, &mut frame);
        assert_eq!(frame[0], expected);
        for [low, high, byte] in frame[1..].as_chunks().0.iter().take(expected.into()) {
            bytes.push(*byte);
            ages.push(u16::from_le_bytes([*low, *high]));
        }
    }
    assert_eq!(bytes[..4], [0xfe, 0x81, 0xff, 0x55]);
    assert_eq!((ages[0], ages[35]), (1000 - 65 - 10, 1000 - 65 - 390));
}

#[test]
fn the_angles_of_a_sample_are_those_at_its_stamp() {
    let rates = [20.0 * DEG, -3.0 * DEG];
    let bench = shared(TurnedByHand(rates, 0));
    let mut control = control(&bench, gimbal());
    for _ in 0..10 {
        assert!(bench.borrow_mut().period());
        let now_us = bench.borrow().now_us();
        control.on_period(|| now_us);
    }
    let (angles, _) = control.view(7500).expect("two readings enclose it");
    for (angle, rate) in angles.into_iter().zip(rates) {
        // Steps of 0.02 arcsec, and their interpolation.
        let off = f64::from(angle.since(Angle::from_rad(rate * 0.0075)));
        assert!((off * std::f64::consts::TAU / 2_f64.powi(32)).abs() < 0.02 * ARCSEC, "{off}");
    }
    assert_eq!(control.view(10_001).err(), Some(LossReason::Status), "it has not been read yet");
}

/// What the control of axes at rest reports in each of these periods.
fn held(periods: u64, mut act: impl FnMut(u64, &mut Bench<TurnedByHand>, &mut dyn FnMut(MotionCommand))) -> Vec<Told> {
    let bench = shared(TurnedByHand([0.0; 2], 0));
    let mut control = control(&bench, gimbal());
    let period = |period| {
        assert!(bench.borrow_mut().period());
        let now_us = bench.borrow().now_us();
        control.on_period(|| now_us);
        let seen_us = control.status().time_us;
        act(period, &mut bench.borrow_mut(), &mut |command| control.command(command, seen_us));
        Told { commands: control.status().commands, fault: control.status().fault, outputs: bench.borrow().outputs() }
    };
    (1..=periods).map(period).collect()
}

#[derive(Debug, PartialEq)]
struct Told {
    commands: u16,
    fault: Option<Fault>,
    outputs: [Output; 2],
}

const DELAY: usize = (COMMAND_DELAY_US / PERIOD_US) as usize;

#[test]
fn a_command_takes_effect_a_definite_time_after_what_it_was_computed_from() {
    let told = held(40, |period, _, command| {
        if [3, 5].contains(&period) {
            command(MotionCommand::Hold);
        }
    });
    let counts: Vec<u16> = told.iter().map(|told| told.commands).collect();
    // The status of period 3 is the third in the list.
    assert_eq!(counts.iter().position(|count| *count == 1), Some(2 + DELAY));
    assert_eq!(counts.iter().position(|count| *count == 2), Some(4 + DELAY));
}

#[test]
fn an_overcurrent_opens_the_winding_and_a_command_from_before_it_is_dropped() {
    let told = held(80, |period, bench, command| match period {
        3 => command(MotionCommand::Hold),
        20 => bench.set_trouble(1, Some(Trouble::Overcurrent)),
        // This command follows from a status without the fault, which shows two periods later.
        21 => command(MotionCommand::Hold),
        40 => bench.set_trouble(1, None),
        // This command follows from a status with the fault.
        50 => command(MotionCommand::Hold),
        _ => {}
    });
    let found = told.iter().position(|told| told.fault.is_some()).expect("it is noticed");
    assert!((20..24).contains(&found), "{found}");
    let overcurrent = Fault { axis: 1, angle_rad: 0.0, kind: FaultKind::Bridge(BridgeFault::Overcurrent) };
    let before_command = &told[found..49 + DELAY];
    assert!(before_command.iter().all(|told| told.fault == Some(overcurrent) && told.outputs[1] == Output::Open));
    let last = told.last().expect("some");
    assert_eq!((last.commands, last.fault, last.outputs[1]), (3, None, Output::Shorted), "the fault line is cleared");
}

#[test]
fn a_missing_reading_is_bridged_and_two_cost_a_sample() {
    for (bad, expected) in [(1, Ok(())), (2, Err(LossReason::Crc))] {
        let bench = shared(TurnedByHand([0.0; 2], 0));
        let mut control = control(&bench, gimbal());
        let mut frames = 0;
        bench.borrow_mut().damage(move |chip, frame| {
            frames += u32::from(chip == Chip::InnerEncoder);
            if chip == Chip::InnerEncoder && (5..5 + bad).contains(&frames) {
                frame[4] ^= 1;
            }
        });
        for _ in 0..8 {
            assert!(bench.borrow_mut().period());
            let now_us = bench.borrow().now_us();
            control.on_period(|| now_us);
        }
        assert_eq!(control.view(5500).map(|_| ()), expected);
    }
}

/// A log of two hours: IMU, encoders and bridges a thousand times a second, in some seconds.
#[test]
fn the_bench_is_fast() {
    let samples = 100_000;
    let bench = shared(at_rest(samples));
    let mut queue = SampleQueue::<f64, 4>::new();
    let (producer, mut consumer) = queue.split();
    let mut acquisition = acquisition(&bench, 200.0, producer);
    let mut control = control(&bench, gimbal());
    let start = std::time::Instant::now();
    let mut popped = 0;
    while bench.borrow_mut().period() {
        let now_us = bench.borrow().now_us();
        control.on_period(|| now_us);
        if bench.borrow().data_ready() {
            acquisition.on_data_ready(now_us, |time_us| control.view(time_us)).expect("a sample");
            popped += u32::from(consumer.pop().is_some());
        }
    }
    println!("{samples} samples in {:.2} s", start.elapsed().as_secs_f64());
    assert_eq!(popped, samples);
}
