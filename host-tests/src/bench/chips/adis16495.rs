//! An ADIS16495 or ADIS16497: pages of registers that are read and written by words of 16 bits, and the burst.

use super::bits::{bits_of, crc};
/// Pages that are simulated. The pages after them hold the coefficients of the filters.
const PAGES: usize = 6;

const PAGE_ID: u8 = 0x00;
const DATA_CNT: u8 = 0x04;
const SYS_E_FLAG: u8 = 0x08;
const DIAG_STS: u8 = 0x0a;
const TEMP_OUT: u8 = 0x0e;
const X_GYRO_LOW: u8 = 0x10;
const BURST_CMD: u8 = 0x7c;
const PROD_ID: u8 = 0x7e;
const GLOB_CMD: u8 = 0x02;
const FNCTIO_CTRL: u8 = 0x06;
const DEC_RATE: u8 = 0x0c;
const RANG_MDL: u8 = 0x12;
const FILTR_BNK_0: u8 = 0x16;
const SERIAL_NUM: u8 = 0x20;

/// Flags of SYS_E_FLAG.
pub mod flag {
    /// A transfer did not consist of whole words.
    pub const SPI: u16 = 1 << 3;
    /// A sensor failed.
    pub const SENSOR: u16 = 1 << 5;
    /// The external clock is out of range.
    pub const CLOCK: u16 = 1 << 8;
}

/// Product and sub-model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Model {
    /// 16495 or 16497.
    pub product: u16,
    /// 1 to 3.
    pub number: u8,
}

impl Model {
    /// ADIS16495-1: 125 deg/s, 8 g.
    pub const ADIS16495_1: Self = Self { product: 16_495, number: 1 };

    fn range(self) -> u16 {
        [0x3, 0x7, 0xf][usize::from(self.number) - 1]
    }

    /// Value of the lowest of the 32 bits, rad/s and m/s^2.
    fn steps(self) -> (f64, f64) {
        let gyro_deg_s = [0.006_25, 0.025, 0.1][usize::from(self.number) - 1];
        let accel_g = if self.product == 16_497 { 0.001_25 } else { 0.000_25 };
        (f64::to_radians(gyro_deg_s) / 65_536.0, accel_g * 9.806_65 / 65_536.0)
    }
}

/// The IMU.
#[derive(Clone, Debug)]
pub struct Adis16495Chip {
    model: Model,
    serial: u16,
    /// Registers by page and half the address.
    registers: [[u16; 64]; PAGES],
    page: u8,
    /// Whether two words open a burst, as at clocks above 3.6 MHz.
    pub fast: bool,
    /// Whether the IMU loses a word that comes before the previous word has been carried out, as the real IMU does.
    pub timed: bool,
    busy_ns: u64,
    /// Words that came too early.
    pub early_words: u32,
    /// Answer to the previous word.
    answer: u16,
    count: u16,
}

impl Adis16495Chip {
    /// A model after power-up, at a fast clock, without timing checks.
    pub fn new(model: Model) -> Self {
        let mut chip = Self {
            model,
            serial: 0x0bad,
            registers: [[0; 64]; PAGES],
            page: 0,
            fast: true,
            timed: false,
            busy_ns: 0,
            early_words: 0,
            answer: 0,
            count: 0,
        };
        chip.reset();
        chip
    }

    /// Gives the IMU another serial number.
    pub fn set_serial(&mut self, serial: u16) {
        self.serial = serial;
        *self.register(4, SERIAL_NUM) = serial;
    }

    /// Restarts the IMU, as if its supply had failed for a moment. It has its initial settings then, or the present ones if
    /// they have been saved in its flash.
    pub fn restart(&mut self, settings_saved: bool) {
        let kept = self.registers[3];
        self.reset();
        if settings_saved {
            self.registers[3] = kept;
        }
    }

    /// Advances the time.
    pub fn elapse(&mut self, ns: u64) {
        self.busy_ns = self.busy_ns.saturating_sub(ns);
    }

    /// Raises flags of SYS_E_FLAG. The flags stay until they are read.
    pub fn raise(&mut self, flags: u16) {
        *self.register(0, SYS_E_FLAG) |= flags;
    }

    /// Makes sensors fail their test. `sensors` are bits of DIAG_STS.
    pub fn fail_sensors(&mut self, sensors: u16) {
        *self.register(0, DIAG_STS) = sensors;
        self.raise(flag::SENSOR);
    }

    /// Samples per output, and whether the samples are clocked externally. `None` if data-ready is not on DIO2.
    pub fn sampling(&self) -> Option<(u16, bool)> {
        let [function, decimation] = [FNCTIO_CTRL, DEC_RATE].map(|address| self.registers[3][usize::from(address / 2)]);
        (function & 0xf == 0xd).then_some((decimation + 1, function & 0x80 != 0))
    }

    /// Takes a sample: rates, rad/s, forces, m/s^2, temperature, deg C.
    pub fn sample(&mut self, omega: [f64; 3], force: [f64; 3], temperature_c: f64) {
        let (gyro, accel) = self.model.steps();
        let numbers = omega.map(|rate| rate / gyro).into_iter().chain(force.map(|force| force / accel));
        for (address, number) in (X_GYRO_LOW..).step_by(4).zip(numbers) {
            // The conversion saturates as the IMU does.
            let number = number.round() as i32;
            *self.register(0, address) = number as u16;
            *self.register(0, address + 2) = (number >> 16) as u16;
        }
        // A plant without a temperature sensor reads 25 deg C.
        *self.register(0, TEMP_OUT) = ((temperature_c - 25.0) / 0.0125).round() as i16 as u16;
        *self.register(0, DATA_CNT) = self.count;
        self.count = self.count.wrapping_add(1);
    }

    /// One transaction. `bytes` holds the bytes of the master before the call and the bytes of the IMU after it.
    pub fn transfer(&mut self, bytes: &mut [u8]) {
        if bytes.len() % 2 == 1 {
            self.raise(flag::SPI);
        }
        let mut burst = None;
        for place in bytes.chunks_exact_mut(2) {
            let word = u16::from_be_bytes([place[0], place[1]]);
            let out = match &mut burst {
                Some(words) => Iterator::next(words).unwrap_or(0),
                None => self.word(word),
            };
            place.copy_from_slice(&out.to_be_bytes());
            if burst.is_none() && self.page == 0 && word == u16::from(BURST_CMD) << 8 {
                burst = Some(self.burst().into_iter());
            }
        }
    }

    /// The answer to the previous word, which the IMU sends with the next one.
    pub fn next_answer(&self) -> u16 {
        self.answer
    }

    /// Takes a word and gives the answer to the previous word.
    fn word(&mut self, word: u16) -> u16 {
        if self.timed && self.busy_ns > 0 {
            self.early_words += 1;
            return 0xffff;
        }
        let [address, byte] = word.to_be_bytes();
        let out = std::mem::take(&mut self.answer);
        self.busy_ns = 5000;
        if address & 0x80 != 0 {
            self.write(address & 0x7f, byte);
        } else {
            self.answer = self.read(address);
        }
        out
    }

    /// A register. All registers of pages that are not simulated are the same register.
    fn register(&mut self, page: u8, address: u8) -> &mut u16 {
        &mut self.registers[usize::from(page).min(PAGES - 1)][usize::from(address / 2)]
    }

    fn read(&mut self, address: u8) -> u16 {
        match address {
            PAGE_ID => self.page.into(),
            SYS_E_FLAG if self.page == 0 => std::mem::take(self.register(0, SYS_E_FLAG)),
            _ => *self.register(self.page, address),
        }
    }

    fn write(&mut self, address: u8, byte: u8) {
        let (even, high) = (address & !1, address & 1 == 1);
        match (self.page, even) {
            (_, PAGE_ID) => self.page = if high { self.page } else { byte },
            // Measurements and identification cannot be written.
            (0 | 4, _) | (3, RANG_MDL) => {}
            (page, _) => {
                let register = self.register(page, even);
                *register =
                    if high { *register & 0xff | u16::from(byte) << 8 } else { *register & 0xff00 | u16::from(byte) };
                if high {
                    self.carry_out(page, even);
                }
            }
        }
    }

    /// Carries out a write, which takes effect when the high byte is written.
    fn carry_out(&mut self, page: u8, address: u8) {
        self.busy_ns = write_time_ns(page, address);
        if (page, address) == (3, GLOB_CMD) && std::mem::take(self.register(page, address)) & 0x80 != 0 {
            self.reset();
            self.busy_ns = 210_000_000;
        }
    }

    fn reset(&mut self) {
        (self.page, self.count, self.answer) = (0, 0, 0);
        let (model, sensors) = (self.model, *self.register(0, DIAG_STS));
        self.registers = [[0; 64]; PAGES];
        let initial = [
            (0, DIAG_STS, sensors),
            (0, PROD_ID, model.product),
            (4, SERIAL_NUM, self.serial),
            (3, RANG_MDL, model.range()),
            (3, FNCTIO_CTRL, 0x000d),
        ];
        for (page, address, value) in initial {
            *self.register(page, address) = value;
        }
    }

    fn burst(&mut self) -> Vec<u16> {
        let flags = std::mem::take(self.register(0, SYS_E_FLAG));
        let page = &self.registers[0];
        let measured = usize::from(X_GYRO_LOW / 2);
        let single = |address: u8| page[usize::from(address / 2)];
        let words: Vec<u16> = [flags, single(TEMP_OUT)]
            .into_iter()
            .chain(page[measured..measured + 12].iter().copied())
            .chain([single(DATA_CNT)])
            .collect();
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        // CRC-32/ISO-HDLC: the CRC of the reflected bits, reflected.
        let reflected: Vec<u8> = bytes.iter().map(|byte| byte.reverse_bits()).collect();
        let crc = !crc(32, 0x04c1_1db7, u32::MAX, bits_of(&reflected)).reverse_bits();
        let opening = if self.fast { vec![0xa5a5; 2] } else { vec![0xa5a5] };
        [opening, words, vec![crc as u16, (crc >> 16) as u16]].concat()
    }
}

/// Duration of a write, ns.
fn write_time_ns(page: u8, address: u8) -> u64 {
    match (page, address) {
        (3, FNCTIO_CTRL | DEC_RATE) => 340_000,
        (3, FILTR_BNK_0..=0x18) => 65_000,
        (3, GLOB_CMD) => 1_120_000,
        _ => 5000,
    }
}
