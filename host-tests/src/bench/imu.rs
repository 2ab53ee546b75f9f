//! The IMU of a bench and its serial line.

use super::bus::{Chip, Damage};
use super::chips::adis16495::{Adis16495Chip, Model, flag};
use super::chips::kvh1750::{Kvh1750Chip, arrival_us};
use crate::virtual_unit::plant::Reading;
use std::collections::VecDeque;
use std::fmt;

/// Temperature that a KVH 1750 reports if the plant has none, deg C. It is the same as for an ADIS16495.
const ROOM_C: f64 = 25.0;

/// Type of IMU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Imu {
    /// An ADIS16495-1 on SPI, with data-ready.
    #[default]
    Adis16495,
    /// A KVH 1750 on a serial line, whose outputs are requested at the ends of the plant's intervals.
    Kvh1750,
}

impl fmt::Display for Imu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Adis16495 => "adis16495",
            Self::Kvh1750 => "kvh1750",
        })
    }
}

/// The simulated IMU.
pub(super) enum ImuChip {
    Adis16495(Box<Adis16495Chip>),
    Kvh1750(Kvh1750Chip, SerialLine),
}

impl ImuChip {
    pub(super) fn new(imu: Imu) -> Self {
        match imu {
            Imu::Adis16495 => Self::Adis16495(Box::new(Adis16495Chip::new(Model::ADIS16495_1))),
            Imu::Kvh1750 => Self::Kvh1750(Kvh1750Chip::default(), SerialLine::default()),
        }
    }

    pub(super) fn kind(&self) -> Imu {
        match self {
            Self::Adis16495(_) => Imu::Adis16495,
            Self::Kvh1750(..) => Imu::Kvh1750,
        }
    }

    /// Measures at the end of an interval. `damage` may change the bytes of a message.
    pub(super) fn sample(&mut self, reading: &Reading, now_us: u64, damage: Option<&mut Damage>) {
        let Reading { omega_g, force_a, temperature_c, .. } = *reading;
        match self {
            Self::Adis16495(chip) => {
                if !omega_g.iter().chain(&force_a).all(|number| number.is_finite()) {
                    chip.raise(flag::SENSOR);
                }
                chip.sample(omega_g, force_a, temperature_c.into());
            }
            Self::Kvh1750(chip, line) => {
                let temperature_c = if temperature_c.is_nan() { ROOM_C } else { temperature_c.into() };
                let mut message = chip.message(omega_g, force_a, temperature_c);
                damage.into_iter().for_each(|damage| damage(Chip::Imu, &mut message));
                line.send(&message, now_us);
            }
        }
    }

    /// One transfer with the ADIS16495 or with the receiver of the serial line.
    pub(super) fn transfer(&mut self, frame: &mut [u8], now_us: u64) {
        match self {
            Self::Adis16495(chip) => chip.transfer(frame),
            Self::Kvh1750(_, line) => line.empty_into(frame, now_us),
        }
    }

    /// The word that an ADIS16495 sends with the next word. A KVH 1750 sends none.
    pub(super) fn next_answer(&self) -> u16 {
        match self {
            Self::Adis16495(chip) => chip.next_answer(),
            Self::Kvh1750(..) => 0,
        }
    }

    /// Makes the x gyro fail its test.
    pub(super) fn fail_gyro(&mut self) {
        match self {
            Self::Adis16495(chip) => chip.fail_sensors(1),
            Self::Kvh1750(chip, _) => chip.invalid |= 1,
        }
    }

    /// Gives the IMU another serial number. A KVH 1750 has none that the driver can read.
    pub(super) fn set_serial(&mut self, serial: u16) {
        if let Self::Adis16495(chip) = self {
            chip.set_serial(serial);
        }
    }

    /// Restarts the IMU with its initial settings. A KVH 1750 keeps its settings.
    pub(super) fn restart(&mut self) {
        match self {
            Self::Adis16495(chip) => chip.restart(false),
            Self::Kvh1750(chip, _) => chip.restart(),
        }
    }

    /// The serial line, if the IMU has one.
    pub(super) fn line_mut(&mut self) -> Option<&mut SerialLine> {
        match self {
            Self::Adis16495(_) => None,
            Self::Kvh1750(_, line) => Some(line),
        }
    }
}

/// A byte and its time of arrival, us.
pub type Received = (u8, u64);

/// Bytes on a serial line and in its receiver.
#[derive(Default)]
pub(super) struct SerialLine {
    bytes: VecDeque<Received>,
    sent: u64,
    /// Whether the byte with this number, counted from 0, is lost.
    pub(super) loses: Option<Box<dyn FnMut(u64) -> bool>>,
}

impl SerialLine {
    fn send(&mut self, message: &[u8], requested_us: u64) {
        for (place, byte) in message.iter().enumerate() {
            let lost = self.loses.as_mut().is_some_and(|loses| loses(self.sent));
            self.sent += 1;
            if !lost {
                self.bytes.push_back((*byte, requested_us + arrival_us(place)));
            }
        }
    }

    /// Whether a byte has come.
    pub(super) fn waits(&self, now_us: u64) -> bool {
        self.bytes.front().is_some_and(|(_, came_us)| *came_us <= now_us)
    }

    /// The next byte that has come.
    pub(super) fn receive(&mut self, now_us: u64) -> Option<Received> {
        if self.waits(now_us) { self.bytes.pop_front() } else { None }
    }

    /// Fills the frame of the emulated receiver: the number of bytes, and for each byte its age (u16, us, low byte
    /// first) and its value.
    fn empty_into(&mut self, frame: &mut [u8], now_us: u64) {
        let Some((count, places)) = frame.split_first_mut() else { return };
        *count = 0;
        for place in places.as_chunks_mut::<3>().0 {
            let Some((byte, came_us)) = self.receive(now_us) else { return };
            let [low, high] = u16::try_from(now_us - came_us).unwrap_or(u16::MAX).to_le_bytes();
            *place = [low, high, byte];
            *count += 1;
        }
    }
}
