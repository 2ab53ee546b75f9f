//! Driver for the inertial measurement units ADIS16495 and ADIS16497 on SPI with a data-ready line.
//!
//! Source: Analog Devices, ADIS16495 data sheet, Rev. C. Where the data sheet is ambiguous, the driver follows the
//! Linux driver `adis16480`.
//!
//! SPI mode 3; words of 16 bits, high byte first; at least 5 us between words (stall); at most 15 MHz, and 6 MHz in a
//! burst. Registers have 16 bits and lie on pages. Writing a page number to address 0 selects the page. A read sends
//! the address; the answer comes with the next word. A write sends `0x80 | address` and one byte, first for the low
//! byte, then for the high byte. Some registers need a longer stall.
//!
//! ```text
//! burst: sent      0x7c00, then zeros for 19 words
//!        received  any word, one or two words 0xa5a5 (two above 3.6 MHz), then
//!                  SYS_E_FLAG, TEMP_OUT, X_GYRO_LOW, X_GYRO_OUT, .. Z_GYRO_OUT, X_ACCL_LOW, .. Z_ACCL_OUT, DATA_CNT,
//!                  CRC_LWR, CRC_UPR: CRC-32/ISO-HDLC of the 15 words before, low bytes first
//! ```
//! | | per 2^-16 of the upper word |
//! |---|---|
//! | gyro, -1 / -2 / -3 (RANG_MDL 0x3, 0x7, 0xf) | 0.00625 / 0.025 / 0.1 deg/s |
//! | accelerometer, ADIS16495 / ADIS16497 | 0.25 / 1.25 mg |
//! | temperature, from 25 deg C | 0.0125 deg C, 16 bits |
//!
//! Samples have 32 bits. For the -1 model one step is 9.5e-8 deg/s and 3.8e-9 g. This is 1/2500 of the noise of a gyro
//! with 0.001 deg/sqrt(h) and 1/37000 of the noise of an accelerometer with 10 ug/sqrt(Hz), both at 200 Hz. The noise
//! dithers the steps, so rounding loses nothing.
//!
//! The IMU samples with its own clock of 4250 Hz, or at each rising edge on DIO1 (3000 to 4500 Hz). Each output is the
//! mean of as many samples as the decimation says. Data-ready rises on DIO2. For 200 Hz on the clock of the processor,
//! supply 4000 Hz and set a decimation of 20. Status bits: 15 watchdog, 8 clock, 7 overrun, 6 flash, 5 sensor, 3 SPI, 2
//! memory, 1 boot.
//!
//! An IMU that loses its supply for a moment restarts with its initial settings: 4250 samples a second, and no filter.
//! Its sample counter begins at zero. The driver compares the counter with the times of the edges. If they do not agree, it
//! refuses all samples and reads the settings again, one word at each edge. If the settings do not hold, it writes them as
//! at the start and reads them once more, until they hold. A software reset is not needed, because the IMU has just
//! started. Whoever uses the samples learns of the restart from [`ImuFault::Restarted`]: the biases may have changed.

use super::imu::{Cadence, Counter, ImuFault, ImuReading, field};
use crate::base::imu_identity::ImuIdentity;
use crate::base::linear::{Real, Vector3, real};
use crate::base::units::{DEG, MICRO_G};
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;

/// Length of a burst, bytes.
pub const BURST_BYTES: usize = 40;
/// Word that opens the content of a burst.
const BURST_ID: [u8; 2] = [0xa5, 0xa5];
/// Length of the content after the opening word, bytes: 15 words covered by the CRC, and two words of CRC.
const CONTENT_BYTES: usize = 34;
const COVERED_BYTES: usize = 30;
/// Bits of SYS_E_FLAG that report a fault.
const FLAGS: u16 = 0x81ee;

/// Shortest time between two words (stall), us.
const STALL_US: u32 = 5;
/// Time from power-on until the IMU answers, ms: 250 ms by the data sheet, with a margin for a slow supply.
pub const POWER_ON_MS: u32 = 300;
/// Most tries to start an IMU that may have got its power just now.
pub const TRIES: u32 = 3;
/// Time from a software reset to the first sample, ms.
const RESET_MS: u32 = 210;

static CRC_32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A register: its page, the address of its low byte, and the stall after a write to it, us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Register {
    page: u8,
    address: u8,
    stall_us: u32,
}

impl Register {
    /// Faults of the IMU. Reading this register clears them.
    pub const SYS_E_FLAG: Self = Self::new(0, 0x08, STALL_US);
    /// Self-test failures of the sensors: bits 0 to 2 for the gyros, 3 to 5 for the accelerometers.
    pub const DIAG_STS: Self = Self::new(0, 0x0a, STALL_US);
    /// Burst read.
    pub const BURST_CMD: Self = Self::new(0, 0x7c, STALL_US);
    /// Product number.
    pub const PROD_ID: Self = Self::new(0, 0x7e, STALL_US);
    /// Commands. Bit 7 resets the IMU.
    pub const GLOB_CMD: Self = Self::new(3, 0x02, 1120);
    /// Function of the DIO lines.
    pub const FNCTIO_CTRL: Self = Self::new(3, 0x06, 340);
    /// Decimation: samples per output, minus one.
    pub const DEC_RATE: Self = Self::new(3, 0x0c, 340);
    /// Sub-model, which has its own gyro range.
    pub const RANG_MDL: Self = Self::new(3, 0x12, STALL_US);
    /// FIR filters of the gyros and of the x and y accelerometers.
    pub const FILTR_BNK_0: Self = Self::new(3, 0x16, 65);
    /// FIR filter of the z accelerometer.
    pub const FILTR_BNK_1: Self = Self::new(3, 0x18, 65);

    /// Serial number within a production lot.
    pub const SERIAL_NUM: Self = Self::new(4, 0x20, STALL_US);

    const fn new(page: u8, address: u8, stall_us: u32) -> Self {
        Self { page, address, stall_us }
    }
}

/// Clock of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Clock {
    /// Clock of the IMU: 4250 Hz within the tolerance of its oscillator.
    Internal,
    /// Rising edges on DIO1, 3000 to 4500 Hz.
    External {
        /// Rate of the edges, Hz.
        rate_hz: u16,
    },
}

/// FIR filter bank with 120 taps. Unless other taps have been written, banks A, B, C and D are low-pass filters of 300,
/// 100, 300 and 100 Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FilterBank {
    /// Bank A.
    A = 0,
    /// Bank B.
    B = 1,
    /// Bank C.
    C = 2,
    /// Bank D.
    D = 3,
}

/// Settings of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Adis16495Settings {
    /// Clock of the samples.
    pub clock: Clock,
    /// Decimation: samples per output, 1 to 4250.
    pub decimation: u16,
    /// FIR filter before the decimation. With `None` an output is the plain mean over its interval.
    pub filter: Option<FilterBank>,
    /// Delay from the end of an interval to its data-ready edge, us: delay of the sensors and processing time of the
    /// IMU.
    pub latency_us: u32,
}

impl Default for Adis16495Settings {
    /// 200 Hz: external clock of 4000 Hz with a decimation of 20, no filter, no latency.
    fn default() -> Self {
        Self { clock: Clock::External { rate_hz: 4000 }, decimation: 20, filter: None, latency_us: 0 }
    }
}

impl Adis16495Settings {
    /// Delay of the FIR filter: half of 119 sample intervals.
    const FILTER_DELAY_SAMPLES: f64 = 59.5;

    fn are_valid(&self) -> bool {
        let clock = match self.clock {
            Clock::Internal => true,
            Clock::External { rate_hz } => (3000..=4500).contains(&rate_hz),
        };
        clock && (1..=4250).contains(&self.decimation)
    }

    fn clock_hz(&self) -> f64 {
        match self.clock {
            Clock::Internal => 4250.0,
            Clock::External { rate_hz } => rate_hz.into(),
        }
    }

    /// Interval between two outputs, s.
    pub fn interval_s(&self) -> f64 {
        f64::from(self.decimation) / self.clock_hz()
    }

    /// Delay from the middle of an output interval to its data-ready edge, us.
    pub fn lag_us(&self) -> u64 {
        let filter = if self.filter.is_some() { Self::FILTER_DELAY_SAMPLES } else { 0.0 };
        let samples = 0.5 * f64::from(self.decimation) + filter;
        (samples / self.clock_hz() * 1e6) as u64 + u64::from(self.latency_us)
    }

    /// FNCTIO_CTRL: data-ready rises on DIO2; an external clock rises on DIO1.
    fn function(&self) -> u16 {
        let clock = if self.clock == Clock::Internal { 0 } else { 0b1100_0000 };
        clock | 0b1101
    }

    /// Filter bits for `sensors` sensors, three bits each: enable bit and bank number.
    fn filter_bits(&self, sensors: u32) -> u16 {
        let bits = self.filter.map_or(0, |bank| 4 | bank as u16);
        (0..sensors).fold(0, |word, _| word << 3 | bits)
    }

    fn registers(&self) -> [(Register, u16); 4] {
        [
            (Register::FNCTIO_CTRL, self.function()),
            (Register::DEC_RATE, self.decimation.saturating_sub(1)),
            (Register::FILTR_BNK_0, self.filter_bits(5)),
            (Register::FILTR_BNK_1, self.filter_bits(1)),
        ]
    }
}

/// Why the IMU does not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StartFault<E> {
    /// The bus transfer failed.
    Bus(E),
    /// The settings are outside the range of the IMU.
    Settings,
    /// The product number does not belong to this family.
    Product(u16),
    /// The sub-model does not belong to this family.
    Model(u16),
    /// A register does not hold the value that was written.
    Register {
        /// The register.
        register: Register,
        /// Value that was read back.
        holds: u16,
    },
    /// A sensor failed its self-test. The bits are those of [`Register::DIAG_STS`].
    Sensor(u16),
    /// The IMU reports faults. The documentation at the top of this file explains the bits.
    Status(u16),
}

/// Scale factors of the raw numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Scale {
    gyro_rad_s: f64,
    accel_m_s2: f64,
}

impl Scale {
    const LOWER_WORD: f64 = 65_536.0;

    fn new<E>(product: u16, model: u16) -> Result<Self, StartFault<E>> {
        let accel_ug = match product {
            16_495 => 250.0,
            16_497 => 1250.0,
            _ => return Err(StartFault::Product(product)),
        };
        let gyro_deg_s = match model & 0xf {
            0x3 => 0.006_25,
            0x7 => 0.025,
            0xf => 0.1,
            _ => return Err(StartFault::Model(model)),
        };
        Ok(Self { gyro_rad_s: gyro_deg_s * DEG / Self::LOWER_WORD, accel_m_s2: accel_ug * MICRO_G / Self::LOWER_WORD })
    }
}

/// Driver of a started IMU.
#[derive(Debug)]
pub struct Adis16495<S> {
    spi: S,
    identity: ImuIdentity,
    scale: Scale,
    settings: Adis16495Settings,
    counter: Counter,
    cadence: Cadence,
    /// The next word while the settings are checked or written; `None` while samples are read.
    recovery: Option<Recovery>,
}

/// The next word of the recovery after a restart.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Recovery {
    /// Reading the settings.
    Check {
        step: usize,
        /// Whether all registers that have been read hold their settings.
        hold: bool,
    },
    /// Writing the settings.
    Write {
        step: usize,
        /// No word may be sent at an edge before this time, us.
        ready_us: u64,
    },
}

impl Recovery {
    const CHECK: Self = Self::Check { step: 0, hold: true };
    const WRITE: Self = Self::Write { step: 0, ready_us: 0 };
}

/// Longest delay of a transfer after its edge, us. The control interrupt may delay it.
const LATE_US: u64 = 500;

impl<S: SpiDevice> Adis16495<S> {
    /// Resets the IMU on `spi`, checks product and sub-model, reads the serial number, and writes the settings. The IMU
    /// samples from then on. This call takes a quarter of a second. The IMU has been powered for [`POWER_ON_MS`].
    ///
    /// # Errors
    /// The IMU does not answer as a member of its family, reports a fault, or does not accept the settings.
    pub fn start(spi: S, delay: &mut impl DelayNs, settings: &Adis16495Settings) -> Result<Self, StartFault<S::Error>> {
        let mut registers = RegisterAccess { spi, delay, page: None };
        let found = registers.start(settings)?;
        Ok(Self::started(registers.spi, found, settings))
    }

    /// As [`Self::start`], for an IMU that may have got its power at the time of the call: waits for [`POWER_ON_MS`], and
    /// tries up to [`TRIES`] times.
    ///
    /// # Errors
    /// The fault of the last try.
    pub fn start_cold(
        spi: S,
        delay: &mut impl DelayNs,
        settings: &Adis16495Settings,
    ) -> Result<Self, StartFault<S::Error>> {
        delay.delay_ms(POWER_ON_MS);
        let mut registers = RegisterAccess { spi, delay, page: None };
        let mut found = registers.start(settings);
        for _ in 1..TRIES {
            if found.is_ok() {
                break;
            }
            registers.page = None;
            found = registers.start(settings);
        }
        let found = found?;
        Ok(Self::started(registers.spi, found, settings))
    }

    fn started(spi: S, (identity, scale): (ImuIdentity, Scale), settings: &Adis16495Settings) -> Self {
        Self {
            spi,
            identity,
            scale,
            settings: *settings,
            counter: Counter::new(16),
            cadence: Cadence::new((1e6 * settings.interval_s()) as f32),
            recovery: None,
        }
    }

    /// Product and serial number, as read at the start.
    pub fn identity(&self) -> ImuIdentity {
        self.identity
    }

    /// Reads the measurement of the last data-ready edge, which came at `edge_us`. Call this function once for every
    /// edge. It makes at most one transfer and does not wait.
    ///
    /// # Errors
    /// The sample is lost for the returned reason.
    pub fn read<T: Real>(&mut self, edge_us: u64) -> Result<ImuReading<T>, ImuFault<S::Error>> {
        let read = self.try_read(edge_us);
        if read.is_err() {
            self.counter.count_reported();
        }
        read
    }

    fn try_read<T: Real>(&mut self, edge_us: u64) -> Result<ImuReading<T>, ImuFault<S::Error>> {
        match self.recovery {
            Some(Recovery::Check { step, hold }) => return Err(self.check_settings(step, hold)),
            Some(Recovery::Write { step, ready_us }) => return Err(self.write_settings(step, ready_us, edge_us)),
            None => {}
        }
        let mut burst = [0; BURST_BYTES];
        burst[0] = Register::BURST_CMD.address;
        self.spi.transfer_in_place(&mut burst).map_err(ImuFault::Bus)?;
        let burst = Burst::decode(&burst)?;
        if burst.flags & FLAGS != 0 {
            return Err(ImuFault::Status(burst.flags & FLAGS));
        }
        if !self.cadence.agrees(edge_us, burst.count) {
            (self.counter, self.recovery) = (Counter::new(16), Some(Recovery::CHECK));
            return Err(ImuFault::Restarted);
        }
        let scaled = |raw: [i32; 3], step: f64| Vector3::from(raw.map(|raw| real(f64::from(raw) * step)));
        Ok(ImuReading {
            time_us: edge_us.saturating_sub(self.settings.lag_us()),
            missed: self.counter.take(burst.count.into()),
            omega_g: scaled(burst.gyro, self.scale.gyro_rad_s),
            force_a: scaled(burst.accel, self.scale.accel_m_s2),
            temperature_c: 25.0 + f32::from(burst.temperature) * 0.0125,
        })
    }

    /// Sends one word of a check: the page of the settings, the address of each register, and the page of the burst. The
    /// value of a register comes with the word after its address. The edges are further apart than the stall between two
    /// words, so no step waits.
    fn check_settings(&mut self, step: usize, hold: bool) -> ImuFault<S::Error> {
        let registers = self.settings.registers();
        let mut word = match step.checked_sub(1) {
            None => [0x80, Register::DEC_RATE.page],
            Some(number) => registers.get(number).map_or([0x80, 0], |(register, _)| [register.address, 0]),
        };
        if let Err(fault) = self.spi.transfer_in_place(&mut word) {
            self.recovery = Some(Recovery::CHECK);
            return ImuFault::Bus(fault);
        }
        let answered = step.checked_sub(2).and_then(|number| registers.get(number));
        let hold = hold && answered.is_none_or(|(_, value)| *value == u16::from_be_bytes(word));
        self.recovery = match (step > registers.len(), hold) {
            (false, _) => Some(Recovery::Check { step: step + 1, hold }),
            (true, true) => None,
            (true, false) => Some(Recovery::WRITE),
        };
        ImuFault::Restarted
    }

    /// Sends one word of the settings: their page, then the low and the high byte of each register. Some registers take
    /// a write longer than the time to the next edge; the edges until then are left out. A check follows the last word.
    fn write_settings(&mut self, step: usize, ready_us: u64, edge_us: u64) -> ImuFault<S::Error> {
        // If the clock went back, nothing is left out.
        if (1..=2 * LATE_US).contains(&ready_us.saturating_sub(edge_us)) {
            return ImuFault::Restarted;
        }
        let registers = self.settings.registers();
        let (mut word, stall_us) = match step.checked_sub(1).map(|byte| (registers.get(byte / 2), byte % 2)) {
            None => ([0x80, Register::DEC_RATE.page], 0),
            Some((Some((register, value)), 0)) => ([0x80 | register.address, value.to_be_bytes()[1]], 0),
            Some((Some((register, value)), _)) => {
                ([0x80 | (register.address + 1), value.to_be_bytes()[0]], register.stall_us)
            }
            Some((None, _)) => {
                // The interval is that of the settings again.
                self.cadence = Cadence::new((1e6 * self.settings.interval_s()) as f32);
                return self.check_settings(0, true);
            }
        };
        if let Err(fault) = self.spi.transfer_in_place(&mut word) {
            self.recovery = Some(Recovery::CHECK);
            return ImuFault::Bus(fault);
        }
        let wait_us = if stall_us > STALL_US { u64::from(stall_us) + LATE_US } else { 0 };
        let ready_us = edge_us.saturating_add(wait_us);
        self.recovery = Some(Recovery::Write { step: step + 1, ready_us });
        ImuFault::Restarted
    }
}

/// Content of a burst in raw numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Burst {
    /// Status word SYS_E_FLAG.
    pub flags: u16,
    /// Temperature relative to 25 deg C, 0.0125 deg C per step.
    pub temperature: i16,
    /// Gyros x, y, z.
    pub gyro: [i32; 3],
    /// Accelerometers x, y, z.
    pub accel: [i32; 3],
    /// Sample counter. It wraps.
    pub count: u16,
}

impl Burst {
    /// Decodes the received bytes of a burst.
    ///
    /// # Errors
    /// [`ImuFault::NoAnswer`] if the opening word is missing, [`ImuFault::Crc`] if the CRC is wrong.
    pub fn decode<E>(burst: &[u8; BURST_BYTES]) -> Result<Self, ImuFault<E>> {
        let content = content(burst).ok_or(ImuFault::NoAnswer)?;
        let word = |bytes: [u8; 2]| u16::from_be_bytes(bytes);
        let crc = u32::from(word(field::<32, 2, _>(content))) << 16 | u32::from(word(field::<30, 2, _>(content)));
        let mut swapped = field::<0, COVERED_BYTES, _>(content);
        for word in swapped.as_chunks_mut::<2>().0 {
            word.reverse();
        }
        if CRC_32.checksum(&swapped) != crc {
            return Err(ImuFault::Crc);
        }
        let long = |[l1, l0, h1, h0]: [u8; 4]| i32::from_be_bytes([h1, h0, l1, l0]);
        Ok(Self {
            flags: word(field::<0, 2, _>(content)),
            temperature: i16::from_be_bytes(field::<2, 2, _>(content)),
            gyro: [field::<4, 4, _>(content), field::<8, 4, _>(content), field::<12, 4, _>(content)].map(long),
            accel: [field::<16, 4, _>(content), field::<20, 4, _>(content), field::<24, 4, _>(content)].map(long),
            count: word(field::<28, 2, _>(content)),
        })
    }
}

/// The content after the opening words. The content begins with the second, third or fourth word.
fn content(burst: &[u8; BURST_BYTES]) -> Option<&[u8; CONTENT_BYTES]> {
    [2, 4, 6].into_iter().find_map(|at: usize| {
        let before = burst.get(at - 2..at)?;
        let content = burst.get(at..)?.first_chunk::<CONTENT_BYTES>()?;
        (before == BURST_ID && !content.starts_with(&BURST_ID)).then_some(content)
    })
}

/// Access to the registers while the IMU starts.
struct RegisterAccess<'d, S, D> {
    spi: S,
    delay: &'d mut D,
    /// Selected page; `None` while it is unknown.
    page: Option<u8>,
}

impl<S: SpiDevice, D: DelayNs> RegisterAccess<'_, S, D> {
    /// Resets the IMU, finds out which one it is, and writes the settings. Page 0 is selected then, as the burst requires.
    fn start(&mut self, settings: &Adis16495Settings) -> Result<(ImuIdentity, Scale), StartFault<S::Error>> {
        if !settings.are_valid() {
            return Err(StartFault::Settings);
        }
        self.write(Register::GLOB_CMD, 1 << 7)?;
        self.delay.delay_ms(RESET_MS);
        self.page = None;
        let product = self.read(Register::PROD_ID)?;
        let scale = Scale::new(product, self.read(Register::RANG_MDL)?)?;
        let identity = ImuIdentity { product, serial: self.read(Register::SERIAL_NUM)?.into() };
        for (register, value) in settings.registers() {
            self.write(register, value)?;
            let holds = self.read(register)?;
            if holds != value {
                return Err(StartFault::Register { register, holds });
            }
        }
        match self.read(Register::DIAG_STS)? {
            0 => {}
            sensors => return Err(StartFault::Sensor(sensors)),
        }
        match self.read(Register::SYS_E_FLAG)? & FLAGS {
            0 => Ok((identity, scale)),
            flags => Err(StartFault::Status(flags)),
        }
    }

    fn send(&mut self, word: [u8; 2], stall_us: u32) -> Result<(), StartFault<S::Error>> {
        self.spi.write(&word).map_err(StartFault::Bus)?;
        self.delay.delay_us(stall_us);
        Ok(())
    }

    fn select_page(&mut self, page: u8) -> Result<(), StartFault<S::Error>> {
        if self.page != Some(page) {
            self.send([0x80, page], STALL_US)?;
            self.page = Some(page);
        }
        Ok(())
    }

    fn write(&mut self, register: Register, value: u16) -> Result<(), StartFault<S::Error>> {
        self.select_page(register.page)?;
        let [high, low] = value.to_be_bytes();
        self.send([0x80 | register.address, low], STALL_US)?;
        self.send([0x80 | (register.address + 1), high], register.stall_us)
    }

    fn read(&mut self, register: Register) -> Result<u16, StartFault<S::Error>> {
        self.select_page(register.page)?;
        self.send([register.address, 0], STALL_US)?;
        let mut word = [0; 2];
        self.spi.read(&mut word).map_err(StartFault::Bus)?;
        self.delay.delay_us(STALL_US);
        Ok(u16::from_be_bytes(word))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::spi::{ErrorKind, Operation};
    use embedded_hal_mock::eh1::delay::{CheckedDelay, NoopDelay, Transaction as Delay};
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};
    use proptest::prelude::*;

    /// A burst of the 15 words as received at a fast clock. This function computes the CRC bit by bit, independent of
    /// the driver.
    fn burst(words: [u16; 15]) -> [u8; BURST_BYTES] {
        let crc = !words.iter().flat_map(|word| word.to_le_bytes()).fold(!0_u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| crc >> 1 ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
        });
        let opening = [0_u16, 0xa5a5, 0xa5a5];
        let all = opening.into_iter().chain(words).chain([crc as u16, (crc >> 16) as u16]);
        all.flat_map(u16::to_be_bytes).collect::<Vec<_>>().try_into().unwrap()
    }

    const SERIAL: u16 = 1234;
    /// The default settings as register values.
    const SETTINGS: [u16; 4] = [0x00cd, 19, 0, 0];
    const WORDS: [u16; 15] = [0, 80, 1, 0, 0xffff, 0xffff, 0, 1, 0, 0x8000, 5, 0, 0, 4000, 513];

    fn transaction(operation: Transaction<u8>) -> Vec<Transaction<u8>> {
        vec![Transaction::transaction_start(), operation, Transaction::transaction_end()]
    }

    fn sent(words: &[u16]) -> Vec<Transaction<u8>> {
        words.iter().flat_map(|word| transaction(Transaction::write_vec(word.to_be_bytes().to_vec()))).collect()
    }

    fn answered(word: u16, answer: u16) -> Vec<Transaction<u8>> {
        [sent(&[word]), transaction(Transaction::read_vec(answer.to_be_bytes().to_vec()))].concat()
    }

    /// Expected transfers of a start: reset, product, sub-model, serial number, then the settings, each read back.
    fn start_script(product: u16, model: u16, function: u16, errors: u16) -> Vec<Transaction<u8>> {
        [
            sent(&[0x8003, 0x8280, 0x8300, 0x8000]),
            answered(0x7e00, product),
            sent(&[0x8003]),
            answered(0x1200, model),
            sent(&[0x8004]),
            answered(0x2000, SERIAL),
            sent(&[0x8003, 0x86cd, 0x8700]),
            answered(0x0600, function),
            sent(&[0x8c13, 0x8d00]),
            answered(0x0c00, 19),
            sent(&[0x9600, 0x9700]),
            answered(0x1600, 0),
            sent(&[0x9800, 0x9900]),
            answered(0x1800, 0),
            sent(&[0x8000]),
            answered(0x0a00, 0),
            answered(0x0800, errors),
        ]
        .concat()
    }

    fn start_delays() -> Vec<Delay> {
        let us = |us: &[u32]| us.iter().map(|us| Delay::delay_us(*us)).collect::<Vec<_>>();
        [
            us(&[5, 5, 1120]),
            vec![Delay::delay_ms(210)],
            us(&[5, 5, 5, 5, 5, 5]),
            us(&[5, 5, 5, 5]),
            us(&[5, 340, 5, 5, 5, 340, 5, 5, 5, 65, 5, 5, 5, 65, 5, 5]),
            us(&[5, 5, 5, 5, 5]),
        ]
        .concat()
    }

    /// The IMU, and its mock bus, which the test checks at its end.
    type Started = (Adis16495<Mock<u8>>, Mock<u8>);

    /// Starts the IMU with the scripted transfers.
    fn start(script: Vec<Transaction<u8>>) -> Result<Started, StartFault<ErrorKind>> {
        let spi = Mock::new(&script);
        let mut kept = spi.clone();
        let started = Adis16495::start(spi, &mut NoopDelay, &Adis16495Settings::default());
        if started.is_err() {
            // The start stopped before the end of the script; this discards the rest.
            while kept.next().is_some() {}
            kept.done();
        }
        started.map(|imu| (imu, kept))
    }

    /// A burst with this sample count.
    fn numbered(count: u16) -> [u8; BURST_BYTES] {
        burst([WORDS.as_slice()[..14].to_vec(), vec![count]].concat().try_into().unwrap())
    }

    fn counted(count: u16) -> Vec<Transaction<u8>> {
        burst_transfer(numbered(count))
    }

    fn burst_transfer(answer: [u8; BURST_BYTES]) -> Vec<Transaction<u8>> {
        let mut asked = vec![0; BURST_BYTES];
        asked[0] = 0x7c;
        transaction(Transaction::transfer_in_place(asked, answer.to_vec()))
    }

    #[test]
    fn the_start_sends_the_words_of_the_data_sheet() {
        let mut spi = Mock::new(&start_script(16_495, 0x3, 0x00cd, 0));
        let mut delay = CheckedDelay::new(&start_delays());
        let imu = Adis16495::start(spi.clone(), &mut delay, &Adis16495Settings::default()).unwrap();
        assert_eq!(imu.identity(), ImuIdentity { product: 16_495, serial: SERIAL.into() });
        spi.done();
        delay.done();
    }

    /// An IMU that does not answer at the first two tries, as one whose supply is slow.
    #[test]
    fn a_cold_start_waits_and_tries_again() {
        let silent =
            [sent(&[0x8003, 0x8280, 0x8300, 0x8000]), answered(0x7e00, 0), sent(&[0x8003]), answered(0x1200, 0)];
        let silent = silent.concat();
        let cold = |script: &[Vec<Transaction<u8>>]| {
            let mut spi = Mock::new(&script.concat());
            let waits = vec![Delay::delay_ms(300)];
            let tries =
                script.iter().map(|part| if *part == silent { start_delays()[..10].to_vec() } else { start_delays() });
            let mut delay = CheckedDelay::new(&waits.into_iter().chain(tries.flatten()).collect::<Vec<_>>());
            let started = Adis16495::start_cold(spi.clone(), &mut delay, &Adis16495Settings::default());
            spi.done();
            delay.done();
            started.map(|imu| imu.identity().product)
        };
        let good = start_script(16_495, 0x3, 0x00cd, 0);
        assert_eq!(cold(std::slice::from_ref(&good)), Ok(16_495));
        assert_eq!(cold(&[silent.clone(), silent.clone(), good]), Ok(16_495));
        assert_eq!(cold(&[silent.clone(), silent.clone(), silent.clone()]), Err(StartFault::Product(0)));
    }

    #[test]
    fn a_failed_start_returns_its_reason() {
        let fault = |script| start(script).err().unwrap();
        assert_eq!(fault(start_script(0xffff, 0xffff, 0, 0)), StartFault::Product(0xffff));
        assert_eq!(fault(start_script(16_495, 0x5, 0, 0)), StartFault::Model(5));
        let refused = StartFault::Register { register: Register::FNCTIO_CTRL, holds: 0x000d };
        assert_eq!(fault(start_script(16_495, 0xf, 0x000d, 0)), refused);
        assert_eq!(fault(start_script(16_495, 0xf, 0x00cd, 0x0004)), StartFault::Status(4));
        let settings = Adis16495Settings { clock: Clock::External { rate_hz: 2999 }, ..Adis16495Settings::default() };
        let mut spi = Mock::<u8>::new(&[]);
        assert_eq!(Adis16495::start(spi.clone(), &mut NoopDelay, &settings).err(), Some(StartFault::Settings));
        spi.done();
    }

    #[test]
    fn settings_become_register_bits() {
        let settings =
            Adis16495Settings { clock: Clock::Internal, decimation: 17, filter: Some(FilterBank::C), latency_us: 100 };
        let values = settings.registers().map(|(_, value)| value);
        assert_eq!(values, [0x000d, 16, 0b0110_1101_1011_0110, 0b110]);
        assert!((settings.interval_s() - 0.004).abs() < 1e-15);
        // 2 ms, 59.5 samples and the latency.
        assert_eq!(settings.lag_us(), 2000 + 14_000 + 100);
    }

    #[test]
    fn a_burst_is_scaled_by_the_sub_model() {
        for (product, model, gyro_deg_s, accel_g) in [(16_495, 0x3, 0.006_25, 0.000_25), (16_497, 0xf, 0.1, 0.001_25)] {
            let script = [start_script(product, model, 0x00cd, 0), burst_transfer(burst(WORDS))].concat();
            let (mut imu, mut spi) = start(script).unwrap();
            let reading = imu.read::<f64>(1_000_000).unwrap();
            let (gyro, accel) = (gyro_deg_s / 65_536.0 * DEG, accel_g / 65_536.0 * 9.806_65);
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-15 * b.abs();
            let omega = [gyro, -gyro, 65_536.0 * gyro];
            let force = [-2_147_483_648.0 * accel, 5.0 * accel, 4000.0 * 65_536.0 * accel];
            assert!(reading.omega_g.iter().zip(omega).all(|(a, b)| close(*a, b)), "{reading:?}");
            assert!(reading.force_a.iter().zip(force).all(|(a, b)| close(*a, b)), "{reading:?}");
            assert_eq!((reading.time_us, reading.missed, reading.temperature_c), (997_500, 0, 26.0));
            spi.done();
        }
    }

    #[test]
    fn lost_samples_are_reported_once() {
        let mut damaged = numbered(65_535);
        damaged[20] ^= 4;
        let mut flagged = WORDS;
        flagged[0] = 0x0100;
        let bursts = [numbered(65_534), damaged, burst(flagged), [0xff; BURST_BYTES], numbered(3), numbered(4)];
        let script = bursts
            .into_iter()
            .fold(start_script(16_495, 0x3, 0x00cd, 0), |script, burst| [script, burst_transfer(burst)].concat());
        let (mut imu, mut spi) = start(script).unwrap();
        let edges = [0, 5000, 10_000, 15_000, 25_000, 30_000];
        let missed = edges.map(|edge_us| imu.read::<f32>(edge_us).map(|reading| reading.missed));
        // Samples 65535 and 0 to 2 are missing; a fault was returned for three of them.
        let expected = [Ok(0), Err(ImuFault::Crc), Err(ImuFault::Status(0x100)), Err(ImuFault::NoAnswer), Ok(1), Ok(0)];
        assert_eq!(missed, expected);
        spi.done();
    }

    /// The transfers of a check whose registers hold these values.
    fn check_script(values: [u16; 4]) -> Vec<Transaction<u8>> {
        let [function, decimation, bank_0, bank_1] = values;
        [(0x8003, 0), (0x0600, 0), (0x0c00, function), (0x1600, decimation), (0x1800, bank_0), (0x8000, bank_1)]
            .into_iter()
            .flat_map(|(word, answer): (u16, u16)| {
                transaction(Transaction::transfer_in_place(word.to_be_bytes().into(), answer.to_be_bytes().into()))
            })
            .collect()
    }

    /// The transfers that write the settings again.
    fn write_script() -> Vec<Transaction<u8>> {
        [0x8003, 0x86cd, 0x8700, 0x8c13, 0x8d00, 0x9600, 0x9700, 0x9800, 0x9900]
            .into_iter()
            .flat_map(|word: u16| transaction(Transaction::transfer_in_place(word.to_be_bytes().into(), vec![0, 0])))
            .collect()
    }

    #[test]
    fn an_imu_that_has_lost_its_settings_gets_them_again() {
        let initial = check_script([0x000d, 0, 0, 0]);
        let script = [start_script(16_495, 0x3, 0x00cd, 0), counted(500), counted(0), initial, write_script()].concat();
        let (mut imu, mut spi) = start([script, check_script(SETTINGS), counted(700)].concat()).unwrap();
        let mut edge_us = 0;
        let mut read = |interval_us| {
            edge_us += interval_us;
            imu.read::<f64>(edge_us).map(|reading| reading.missed)
        };
        assert_eq!(read(5000), Ok(0));
        // The IMU was off for 0.3 s. No sample is taken until the settings hold. The edges after the high byte of a slow
        // register are left out: three for each of the first two registers, two for each of the others.
        assert_eq!(read(300_000), Err(ImuFault::Restarted));
        assert!((0..6 + 9 + 3 + 3 + 2 + 2 + 6).all(|_| read(235) == Err(ImuFault::Restarted)));
        assert_eq!(read(5000), Ok(0));
        spi.done();
    }

    /// A bus that answers with these words. `None` is a failed transfer.
    struct Flaky(std::vec::IntoIter<Option<u16>>);

    impl embedded_hal::spi::ErrorType for Flaky {
        type Error = ErrorKind;
    }

    impl SpiDevice for Flaky {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
            let [Operation::TransferInPlace(bytes)] = operations else { panic!("a transfer") };
            let word = self.0.next().unwrap().ok_or(ErrorKind::Other)?;
            bytes.copy_from_slice(&word.to_be_bytes());
            Ok(())
        }
    }

    #[test]
    fn a_bus_fault_during_a_check_begins_the_check_again() {
        let [function, decimation, bank_0, bank_1] = SETTINGS.map(Some);
        let good = [Some(0), Some(0), function, decimation, bank_0, bank_1];
        let answers = [&good[..4], &[None], &good[..]].concat();
        let mut imu = Adis16495 {
            spi: Flaky(answers.into_iter()),
            identity: ImuIdentity { product: 16_495, serial: 0 },
            scale: Scale::new::<()>(16_495, 3).unwrap(),
            settings: Adis16495Settings::default(),
            counter: Counter::new(16),
            cadence: Cadence::new(5000.0),
            recovery: Some(Recovery::CHECK),
        };
        for step in 0..11 {
            let expected = if step == 4 { ImuFault::Bus(ErrorKind::Other) } else { ImuFault::Restarted };
            assert_eq!(imu.read::<f64>(0), Err(expected), "{step}");
        }
        assert!(imu.recovery.is_none());
    }

    #[test]
    fn no_single_wrong_bit_gives_a_wrong_sample() {
        let good = burst(WORDS);
        let right = Burst::decode::<ErrorKind>(&good).unwrap();
        for bit in 0..8 * BURST_BYTES {
            let mut wrong = good;
            wrong[bit / 8] ^= 1 << (bit % 8);
            let decoded = Burst::decode::<ErrorKind>(&wrong);
            // The first word has no meaning, and one of the two opening words is enough.
            assert!(if bit < 32 { decoded == Ok(right) } else { decoded.is_err() }, "bit {bit}: {decoded:?}");
        }
    }

    proptest! {
        #[test]
        fn a_burst_is_decoded_as_sent_at_any_clock(words: [u16; 15], slow: bool) {
            prop_assume!(words[0] != 0xa5a5);
            let mut came = burst(words);
            if slow {
                came.copy_within(4.., 2);
            }
            let long = |at: usize| (u32::from(words[at + 1]) << 16 | u32::from(words[at])).cast_signed();
            let expected = Burst {
                flags: words[0],
                temperature: words[1].cast_signed(),
                gyro: [2, 4, 6].map(long),
                accel: [8, 10, 12].map(long),
                count: words[14],
            };
            prop_assert_eq!(Burst::decode::<ErrorKind>(&came), Ok(expected));
        }

        #[test]
        fn two_wrong_bits_are_found(words: [u16; 15], a in 48_usize..320, b in 48_usize..320) {
            prop_assume!(words[0] != 0xa5a5 && a != b);
            let mut wrong = burst(words);
            for bit in [a, b] {
                wrong[bit / 8] ^= 0x80 >> (bit % 8);
            }
            prop_assert!(Burst::decode::<ErrorKind>(&wrong).is_err());
        }
    }
}
