//! The instrument's devices around a [`Plant`]: an IMU, two BiSS-C encoders of 26 bits and two motor bridges, with
//! faults of encoders and bridges.
//!
//! Time advances in control periods. The IMU samples as often as the plant does. The decimation that is set in the IMU
//! has no effect.

use super::bridge_pins::{BridgeLines, Outputs, PinBridge, bridge};
use super::bus::{Chip, Damage};
use super::chips::biss::BissChip;
use super::chips::bridge::BridgeChip;
use super::chips::exchange;
use super::imu::{Imu, ImuChip, Received};
use super::wire::{PERIOD_BYTES, input, pin};
use crate::virtual_unit::plant::{Output, Plant, Tick};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{self, Operation, SpiDevice};
use rins_selfcal::acquisition::queue::SampleProducer;
use rins_selfcal::acquisition::{Acquisition, GimbalView, Streaming};
use rins_selfcal::base::imu_identity::ImuIdentity;
use rins_selfcal::base::linear::Real;
use rins_selfcal::drivers::adis16495::{Adis16495, Adis16495Settings, BURST_BYTES, Clock};
use rins_selfcal::drivers::biss::{BissEncoder, CAPTURE_BYTES, Mounting, Resolution};
use rins_selfcal::drivers::kvh1750::{self, Kvh1750};
use rins_selfcal::gimbal::Gimbal;
use rins_selfcal::gimbal::control::Control;
use rins_selfcal::gimbal::servo::PERIOD_US;
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// A fault of an encoder, a bridge or a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The encoder does not answer.
    EncoderSilent,
    /// One frame of the encoder in this number is damaged.
    EncoderCrc(u32),
    /// The encoder reports an error.
    EncoderAlarm,
    /// The encoder repeats its last angle in good frames.
    EncoderFrozen,
    /// The encoder's angle has this error, deg.
    EncoderSlip(f64),
    /// The encoder counts the other way.
    EncoderReversed,
    /// The bridge gives this fraction of its duty.
    Weak(f64),
    /// The motor turns the other way.
    MotorReversed,
    /// The bridge keeps its last duty until it is switched off.
    BridgeStuck,
    /// The bridge gives full duty whatever is commanded, until it is switched off.
    BridgeFull,
    /// The bridge reports an overcurrent.
    Overcurrent,
    /// The bridge gives no output and reports no fault.
    BridgeDead,
}

/// The devices of one axis.
struct AxisChips {
    encoder: BissChip,
    bridge: BridgeChip,
    trouble: Option<Trouble>,
    /// Angle at the encoder, rad.
    seen_rad: f64,
    /// How far the encoder turned in the last period, rad.
    turned_rad: f64,
    /// How far the encoder has turned since then until it is clocked, rad.
    late_rad: f64,
    /// Angle at which the encoder froze, rad.
    frozen_rad: f64,
    frames: u32,
    output: Output,
}

impl AxisChips {
    fn new() -> Self {
        Self {
            encoder: BissChip::new(26),
            bridge: BridgeChip::default(),
            trouble: None,
            seen_rad: 0.0,
            turned_rad: 0.0,
            late_rad: 0.0,
            frozen_rad: 0.0,
            frames: 0,
            output: Output::Open,
        }
    }

    fn set_trouble(&mut self, trouble: Option<Trouble>) {
        self.trouble = trouble;
        self.frozen_rad = self.seen_rad;
        self.encoder.dead = trouble == Some(Trouble::EncoderSilent);
        self.encoder.error = trouble == Some(Trouble::EncoderAlarm);
    }

    fn clock_encoder(&mut self, frame: &mut [u8]) {
        self.frames = self.frames.wrapping_add(1);
        let seen_rad = self.seen_rad + std::mem::take(&mut self.late_rad);
        let angle_rad = match self.trouble {
            Some(Trouble::EncoderFrozen) => self.frozen_rad,
            Some(Trouble::EncoderSlip(slip_deg)) => seen_rad + slip_deg.to_radians(),
            Some(Trouble::EncoderReversed) => -seen_rad,
            _ => seen_rad,
        };
        self.encoder.clock(angle_rad, frame);
        if let Some(Trouble::EncoderCrc(every)) = self.trouble
            && self.frames.is_multiple_of(every)
        {
            frame[4] ^= 1;
        }
    }

    /// Output to the winding in the next period.
    fn drive(&mut self) -> Output {
        self.bridge.begin_period();
        self.bridge.overcurrent |= self.trouble == Some(Trouble::Overcurrent) && self.bridge.enabled;
        let told = self.bridge.output();
        let on = told != Output::Open;
        self.output = match (self.trouble, told) {
            (Some(Trouble::BridgeStuck), _) if on => self.output,
            (Some(Trouble::BridgeFull), _) if on => Output::Driven(1.0),
            (Some(Trouble::BridgeDead), _) => Output::Open,
            (Some(Trouble::Weak(part)), Output::Driven(duty)) => Output::Driven(part * duty),
            (Some(Trouble::MotorReversed), Output::Driven(duty)) => Output::Driven(-duty),
            _ => told,
        };
        self.output
    }
}

/// The chips and the plant they measure and drive.
pub struct Bench<P> {
    plant: P,
    periods: u64,
    data_ready: bool,
    samples: u32,
    imu: ImuChip,
    axes: [AxisChips; 2],
    damage: Option<Damage>,
    switched_off: u32,
    /// A trouble that is to come: its control period, its axis, and what it is.
    planned: Option<(u64, usize, Trouble)>,
}

impl<P: Plant> Bench<P> {
    /// The bench around `plant`, with an ADIS16495 and the bridges off.
    pub fn new(plant: P) -> Self {
        Self::with_imu(plant, Imu::Adis16495)
    }

    /// The bench around `plant`, with this IMU and the bridges off.
    pub fn with_imu(plant: P, imu: Imu) -> Self {
        Self {
            plant,
            periods: 0,
            data_ready: false,
            samples: 0,
            imu: ImuChip::new(imu),
            axes: [AxisChips::new(), AxisChips::new()],
            damage: None,
            switched_off: 0,
            planned: None,
        }
    }

    /// Applies `damage` to all measurements from now on. The transfers that set up the IMU are not damaged.
    pub fn damage(&mut self, damage: impl FnMut(Chip, &mut [u8]) + 'static) {
        self.damage = Some(Box::new(damage));
    }

    /// Number of times that the motors were switched off by the line that bypasses the control.
    pub fn switched_off(&self) -> u32 {
        self.switched_off
    }

    /// Sets the fault of an axis. `None` repairs the axis.
    pub fn set_trouble(&mut self, axis: usize, trouble: Option<Trouble>) {
        self.axes[axis].set_trouble(trouble);
    }

    /// Sets the fault of an axis at this time of the bench, us.
    pub fn plan_trouble(&mut self, at_us: u64, axis: usize, trouble: Trouble) {
        self.planned = Some((at_us / PERIOD_US, axis, trouble));
    }

    /// Number of samples that the IMU has given.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// Time, us.
    pub fn now_us(&self) -> u64 {
        self.periods * PERIOD_US
    }

    /// Outputs to the windings of the outer and the inner motor in the last period.
    pub fn outputs(&self) -> [Output; 2] {
        self.axes.each_ref().map(|axis| axis.output)
    }

    /// Number of times that a direction changed while its PWM was on.
    pub fn hard_turns(&self) -> u32 {
        self.axes.iter().map(|axis| axis.bridge.hard_turns).sum()
    }

    /// The IMU of the bench.
    pub fn imu(&self) -> Imu {
        self.imu.kind()
    }

    /// Gives the IMU another serial number, as if it had been replaced. A KVH 1750 has none that its driver can read.
    pub fn set_imu_serial(&mut self, serial: u16) {
        self.imu.set_serial(serial);
    }

    /// Restarts the IMU, as if its supply had failed for a moment. An ADIS16495 loses its settings; the bench still samples
    /// at the rate of the plant.
    pub fn restart_imu(&mut self) {
        self.imu.restart();
    }

    /// Makes a gyro of the IMU fail.
    pub fn fail_gyro(&mut self) {
        self.imu.fail_gyro();
    }

    /// Loses bytes on the serial line of the IMU. A byte is lost if `loses` is true for its number, counted from 0.
    ///
    /// # Panics
    /// The IMU has no serial line.
    pub fn lose(&mut self, loses: impl FnMut(u64) -> bool + 'static) {
        self.imu.line_mut().expect("an IMU with a serial line").loses = Some(Box::new(loses));
    }

    /// The plant.
    pub fn plant(&self) -> &P {
        &self.plant
    }

    /// The plant.
    pub fn plant_mut(&mut self) -> &mut P {
        &mut self.plant
    }

    /// Gives the plant back.
    pub fn into_plant(self) -> P {
        self.plant
    }

    /// Advances by a control period. Returns whether the instrument is still switched on.
    pub fn period(&mut self) -> bool {
        let outputs = self.axes.each_mut().map(AxisChips::drive);
        let Some(Tick { encoders_rad, reading }) = self.plant.advance(outputs) else { return false };
        self.periods += 1;
        if let Some((_, axis, trouble)) = self.planned.take_if(|(period, ..)| *period == self.periods) {
            self.set_trouble(axis, Some(trouble));
        }
        for (axis, seen_rad) in self.axes.iter_mut().zip(encoders_rad) {
            axis.turned_rad = seen_rad - std::mem::replace(&mut axis.seen_rad, seen_rad);
        }
        self.data_ready = reading.is_some() && self.imu() == Imu::Adis16495;
        if let Some(reading) = reading {
            self.imu.sample(&reading, self.periods * PERIOD_US, self.damage.as_mut());
            self.samples = self.samples.wrapping_add(1);
        }
        true
    }

    /// Whether the data-ready line had an edge in the last period.
    pub fn data_ready(&self) -> bool {
        self.data_ready
    }

    /// The next byte that has come over the serial line of the IMU. `None` if no byte waits or the IMU has no serial
    /// line.
    pub fn receive(&mut self) -> Option<Received> {
        let now_us = self.now_us();
        self.imu.line_mut()?.receive(now_us)
    }

    /// One transfer. `frame` holds the bytes of the master before the call and the bytes of the chip after it.
    pub fn transfer(&mut self, chip: Chip, frame: &mut [u8]) {
        let is_spared = chip == Chip::Imu && frame.len() != BURST_BYTES;
        match chip {
            Chip::Imu => self.imu.transfer(frame, self.periods * PERIOD_US),
            Chip::OuterEncoder => self.axes[0].clock_encoder(frame),
            Chip::InnerEncoder => self.axes[1].clock_encoder(frame),
            Chip::Period => return self.exchange(frame),
            Chip::MotorsOff => return self.switch_off(),
        }
        if let Some(damage) = self.damage.as_mut().filter(|_| !is_spared) {
            damage(chip, frame);
        }
    }

    /// One transfer with an encoder some time after the last period: the first four bytes of `frame` are that time, ns,
    /// low byte first. The axis is taken to turn on as in the last period.
    pub fn clock_late(&mut self, chip: Chip, frame: &mut [u8]) {
        let axis = &mut self.axes[usize::from(chip == Chip::InnerEncoder)];
        let late_ns = frame.first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes));
        // A continuous angle that is wrapped steps by a turn.
        let turned_rad = if axis.turned_rad.abs() < 1.0 { axis.turned_rad } else { 0.0 };
        axis.late_rad = turned_rad * f64::from(late_ns) / (1000.0 * PERIOD_US as f64);
        self.transfer(chip, frame);
    }

    /// Puts the word that the IMU sends with the next word into `frame`. A bus that sends and receives byte by byte needs
    /// the answer before it has the whole word.
    pub fn imu_answer(&self, frame: &mut [u8]) {
        let answer = self.imu.next_answer().to_be_bytes();
        frame.iter_mut().zip(answer).for_each(|(byte, answer)| *byte = answer);
    }

    fn switch_off(&mut self) {
        self.switched_off += 1;
        self.axes.iter_mut().for_each(|axis| axis.bridge.set(0, axis.bridge.forward, false));
    }

    /// The emulated board sends its pins in every period. If its control interrupt dies, no period begins any more, so
    /// neither the motors nor the time of the bench go on.
    fn exchange(&mut self, frame: &mut [u8]) {
        let Ok(frame) = <&mut [u8; PERIOD_BYTES]>::try_from(frame) else { return };
        for (axis, pins) in self.axes.iter_mut().zip(frame.as_chunks::<3>().0) {
            let [low, high, pins] = *pins;
            axis.bridge.set(u16::from_le_bytes([low, high]), pins & pin::DIRECTION != 0, pins & pin::ENABLE != 0);
        }
        let (inputs, captures) = frame.split_first_mut().expect("a frame with the inputs byte");
        *inputs = self.inputs();
        for (chip, capture) in
            [Chip::OuterEncoder, Chip::InnerEncoder].into_iter().zip(captures.chunks_mut(CAPTURE_BYTES))
        {
            self.transfer(chip, capture);
        }
    }

    fn inputs(&mut self) -> u8 {
        if !self.period() {
            return 0;
        }
        let faults = self.axes.iter().zip(input::FAULT).filter(|(axis, _)| axis.bridge.fault_line());
        let now_us = self.periods * PERIOD_US;
        let asks = self.data_ready || self.imu.line_mut().is_some_and(|line| line.waits(now_us));
        let asks = if asks { input::IMU } else { 0 };
        faults.fold(input::POWERED | asks, |bits, (_, bit)| bits | bit)
    }
}

/// A bench that several drivers share.
pub type SharedBench<P> = Rc<RefCell<Bench<P>>>;

/// The SPI bus to one chip of a shared bench, for a driver.
pub struct BenchSpi<P> {
    bench: SharedBench<P>,
    chip: Chip,
}

impl<P: Plant> BenchSpi<P> {
    /// The bus to `chip`.
    pub fn new(bench: &SharedBench<P>, chip: Chip) -> Self {
        Self { bench: Rc::clone(bench), chip }
    }
}

impl<P> spi::ErrorType for BenchSpi<P> {
    type Error = Infallible;
}

impl<P: Plant> SpiDevice for BenchSpi<P> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        exchange(operations, |bytes| self.bench.borrow_mut().transfer(self.chip, bytes));
        Ok(())
    }
}

/// The bridges' pins on a shared bench.
pub struct BenchLines<P>(SharedBench<P>);

impl<P> Clone for BenchLines<P> {
    fn clone(&self) -> Self {
        Self(Rc::clone(&self.0))
    }
}

impl<P: Plant> BridgeLines for BenchLines<P> {
    fn change(&mut self, axis: usize, change: impl FnOnce(&mut Outputs)) {
        let chip = &mut self.0.borrow_mut().axes[axis].bridge;
        let mut outputs = Outputs { duty: chip.duty, forward: chip.forward, enabled: chip.enabled };
        change(&mut outputs);
        chip.set(outputs.duty, outputs.forward, outputs.enabled);
    }

    fn fault_line(&mut self, axis: usize) -> bool {
        self.0.borrow().axes[axis].bridge.fault_line()
    }
}

/// A delay that takes no time on the bench.
struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _ns: u32) {}
}

/// The data of the IMU's interrupt on the board, for the IMU of the bench.
pub enum BenchImu<'q, T: Real, P> {
    /// The acquisition of an ADIS16495.
    Adis16495(BenchAcquisition<'q, T, P>),
    /// The acquisition of a KVH 1750.
    Kvh1750(Streaming<'q, T>),
}

impl<'q, T: Real, P: Plant> BenchImu<'q, T, P> {
    /// The acquisition on a bench whose plant samples `rate_hz` times a second.
    pub fn new(bench: &SharedBench<P>, rate_hz: f64, producer: SampleProducer<'q, T>) -> Self {
        let imu = bench.borrow().imu();
        match imu {
            Imu::Adis16495 => Self::Adis16495(acquisition(bench, rate_hz, producer)),
            Imu::Kvh1750 => {
                let settings = kvh1750::Kvh1750Settings { rate_hz, ..kvh1750::Kvh1750Settings::default() };
                Self::Kvh1750(Streaming::new(Kvh1750::new(&settings), producer))
            }
        }
    }

    /// Identity of the IMU, if its driver knows it.
    pub fn identity(&self) -> Option<ImuIdentity> {
        match self {
            Self::Adis16495(acquisition) => Some(acquisition.imu().identity()),
            Self::Kvh1750(streaming) => streaming.imu().identity(),
        }
    }

    /// Does the work of the interrupt at the end of a control period.
    pub fn on_period(&mut self, bench: &SharedBench<P>, view_at: impl Fn(u64) -> GimbalView) {
        let (now_us, data_ready) = (bench.borrow().now_us(), bench.borrow().data_ready());
        // A lost sample needs no action here, because the acquisition counts lost samples.
        match self {
            Self::Adis16495(acquisition) => {
                let _ = data_ready.then(|| acquisition.on_data_ready(now_us, view_at));
            }
            Self::Kvh1750(streaming) => {
                for (byte, came_us) in std::iter::from_fn(|| bench.borrow_mut().receive()) {
                    let _ = streaming.on_byte(byte, came_us, &view_at);
                }
            }
        }
    }
}

/// The acquisition of a bench. On the board the data-ready interrupt runs it.
pub type BenchAcquisition<'q, T, P> = Acquisition<'q, T, BenchSpi<P>>;
/// A bridge of a bench.
pub type BenchBridge<P> = PinBridge<BenchLines<P>>;
/// The control of a bench. On the board the control interrupt runs it.
pub type BenchControl<T, P> = Control<T, BenchSpi<P>, BenchBridge<P>>;

/// The acquisition of a bench whose plant samples `rate_hz` times a second.
///
/// # Panics
/// The IMU does not start.
pub fn acquisition<'q, T: Real, P: Plant>(
    bench: &SharedBench<P>,
    rate_hz: f64,
    producer: SampleProducer<'q, T>,
) -> BenchAcquisition<'q, T, P> {
    let decimation = (4000.0 / rate_hz).round() as u16;
    let settings =
        Adis16495Settings { clock: Clock::External { rate_hz: 4000 }, decimation, ..Adis16495Settings::default() };
    let imu = Adis16495::start(BenchSpi::new(bench, Chip::Imu), &mut NoDelay, &settings).expect("a sound IMU");
    Acquisition::new(imu, producer)
}

/// The control of a bench, assembled as on the board.
pub fn control<T: Real, P: Plant>(bench: &SharedBench<P>, gimbal: Gimbal<T>) -> BenchControl<T, P> {
    let encoder = |chip| BissEncoder::new(BenchSpi::new(bench, chip), Resolution::Bits26, Mounting::STRAIGHT);
    let lines = BenchLines(Rc::clone(bench));
    Control::new([Chip::OuterEncoder, Chip::InnerEncoder].map(encoder), [0, 1].map(|axis| bridge(&lines, axis)), gimbal)
}
