//! The attacks: what a hostile host sends.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rins_selfcal::link::{Command, Item, MAX_FRAME_BYTES, Payload, Setting, SettingName, UNLOCK_WORD, encode};
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::policy::PowerUpPolicy;
use rins_selfcal::run::sequencer::Pace;
use rins_selfcal::run::unit::UnitName;
use rins_selfcal::scheme::Scheme;
use rins_selfcal::verdict::VerdictLimits;
use serde::de::Error;
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// An attack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attack {
    /// As many commands to read as the line takes.
    Reads,
    /// As many commands of every kind as the line takes, none with the word that unlocks.
    Commands,
    /// Everything that the instrument sends is sent back.
    Echo,
    /// Random bytes.
    Noise,
    /// Commands with damage.
    Damaged,
    /// Commands at wrong times, and commands whose content was changed under a right CRC. On a board that may be
    /// unlocked they include the right word.
    Confused,
}

impl Attack {
    /// All attacks.
    pub const ALL: [Self; 6] = [Self::Reads, Self::Commands, Self::Echo, Self::Noise, Self::Damaged, Self::Confused];

    /// Attacks that contain no command that ends a run.
    pub const SPARING: [Self; 4] = [Self::Reads, Self::Echo, Self::Noise, Self::Damaged];

    /// Name for tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reads => "floods of reads",
            Self::Commands => "floods of commands",
            Self::Echo => "echoes",
            Self::Noise => "noise",
            Self::Damaged => "damaged frames",
            Self::Confused => "confused hosts",
        }
    }
}

/// Random numbers.
#[derive(Clone, Debug)]
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// The numbers of this seed.
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// A number below `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }

    /// True once in so many times.
    pub fn one_in(&mut self, many: u64) -> bool {
        self.below(many) == 0
    }

    /// One of these.
    pub fn pick<'a, V>(&mut self, all: &'a [V]) -> &'a V {
        &all[self.below(all.len() as u64) as usize]
    }

    /// A byte.
    pub fn byte(&mut self) -> u8 {
        self.below(256) as u8
    }
}

/// A command to read something.
pub fn read(random: &mut Random) -> Command {
    let back = random.below(12) as u16;
    Command::Read(match random.below(8) {
        0 => Item::Calibration,
        1 | 2 => Item::History { back },
        3 => Item::Event { back },
        4 => Item::Estimate,
        5 => Item::Covariance { row: random.below(40) as u8 },
        6 => Item::Setting(*random.pick(&SettingName::ALL)),
        _ => Item::Unit,
    })
}

/// Any command but one that unlocks. A setting is one that leaves the result of a run right.
pub fn command(random: &mut Random, config: &SelfCalibrationConfig) -> Command {
    match random.below(16) {
        0 => Command::Hello,
        1 => Command::Status,
        2 | 3 => Command::Start,
        4 => Command::Abort,
        5 => Command::Stop,
        6 => Command::Stream(random.one_in(2)),
        7 => Command::Unlock(random.below(u64::from(UNLOCK_WORD)) as u32),
        8 => Command::Erase,
        9 => Command::Decommission,
        10 => Command::Commission(UnitName::default()),
        11 => Command::ConfirmAngles([Some(random.below(7) as f32), None]),
        12 | 13 => Command::Set(setting(random, config)),
        _ => read(random),
    }
}

fn setting(random: &mut Random, config: &SelfCalibrationConfig) -> Setting {
    let policies = [PowerUpPolicy::Always, PowerUpPolicy::OnCommand];
    match random.below(10) {
        0 => Setting::Pace(Pace { stop_repeats: random.below(5) as u8, ..Pace::default() }),
        1 => Setting::Pace(Pace { longest_s: Some(f64::NAN), ..Pace::default() }),
        2 => Setting::Policy(*random.pick(&policies)),
        3 => Setting::PowerUpUtc(Some(random.below(1 << 40))),
        4 => Setting::Limits(VerdictLimits { scale: -1.0, ..VerdictLimits::default() }),
        5 => Setting::Scheme(Scheme { rate_rad_s: 1e3, ..config.scheme.clone() }),
        6 => Setting::Scheme(config.scheme.clone()),
        7 => Setting::Axes(config.axes),
        8 => Setting::Motors(config.motors),
        _ => Setting::Calibrator(config.calibrator),
    }
}

/// The frame of a command.
pub fn framed<P: Payload>(number: u16, payload: &P) -> Vec<u8> {
    encode(number, payload, &mut [0; MAX_FRAME_BYTES]).map(<[u8]>::to_vec).unwrap_or_default()
}

/// The frame of a command with some of its content changed under a right CRC. `None` if the result is a command that
/// `is_spared`.
pub fn changed(
    random: &mut Random,
    number: u16,
    command: &Command,
    is_spared: impl Fn(&Command) -> bool,
) -> Option<Vec<u8>> {
    let mut content = postcard::to_stdvec(command).ok()?;
    for _ in 0..=random.below(3) {
        let place = random.below(content.len() as u64) as usize;
        match random.below(4) {
            0 => content.truncate(place.max(1)),
            1 => content.push(random.byte()),
            _ => content[place] = random.byte(),
        }
    }
    let is_spared = postcard::from_bytes(&content).is_ok_and(|command| is_spared(&command));
    (!is_spared).then(|| framed(number, &Content(content)))
}

/// Damages a frame.
pub fn damage(random: &mut Random, frame: &mut Vec<u8>) {
    let place = random.below(frame.len() as u64) as usize;
    match random.below(5) {
        0 => frame.truncate(place),
        1 => frame.insert(place, random.byte()),
        2 => frame.insert(place, 0),
        3 => drop(frame.remove(place)),
        _ => frame[place] ^= 1 << random.below(8),
    }
}

/// The content of a command as bytes.
struct Content(Vec<u8>);

impl Payload for Content {
    const KIND: u8 = Command::KIND;
}

impl Serialize for Content {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // postcard writes a tuple as its bytes, without a length.
        let mut bytes = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|byte| bytes.serialize_element(byte))?;
        bytes.end()
    }
}

impl<'de> Deserialize<'de> for Content {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        Err(D::Error::custom("the content is only sent"))
    }
}
