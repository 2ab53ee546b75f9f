//! The assignment that a board reads at power-up.

use super::{bytes_of, stable_bytes};
use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use rins_selfcal::run::assignment::{Assignment, MAX_ASSIGNMENT_BYTES};
use rins_selfcal::run::config::{ConfigError, SelfCalibrationConfig};
use rins_selfcal::scheme::Scheme;
use rins_selfcal::scheme::library::LIBRARY;

/// Assignments encoded as postcard.
pub struct Assignments(Vec<Vec<u8>>);

impl Assignments {
    /// Good assignments to damage: every scheme of the library, with and without options, and a replay.
    pub fn new() -> Self {
        let Assignment::SelfCalibrate(usual) = Assignment::default() else { panic!("it calibrates") };
        let schemes: Vec<Scheme> = LIBRARY.iter().filter_map(|entry| Scheme::named(entry.name)).collect();
        let calibrate = schemes.into_iter().map(|scheme| SelfCalibrationConfig { scheme, ..usual.clone() });
        let calibrate = calibrate.filter(|config| config.check().is_ok()).map(Assignment::SelfCalibrate);
        Self(calibrate.chain([Assignment::Replay(usual.calibrator)]).map(|assignment| bytes_of(&assignment)).collect())
    }
}

impl Target for Assignments {
    fn name(&self) -> &'static str {
        "assignment"
    }

    fn moment(&self) -> u64 {
        4_000
    }

    fn has_corpus(&self) -> bool {
        false
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        if source.one_in(16) {
            *input = source.noise(200);
            return Claim::Nothing;
        }
        input.extend(source.pick(&self.0));
        if source.one_in(16) {
            return Claim::Value(digest(&*input));
        }
        source.damage(input);
        input.truncate(MAX_ASSIGNMENT_BYTES);
        Claim::Nothing
    }

    /// A decoded assignment encodes to the same bytes, and its check names the fault in one line.
    fn judge(&self, input: &[u8]) -> Outcome {
        match postcard::from_bytes(input) {
            Err(_) => Outcome::refused("unreadable"),
            Ok(assignment @ Assignment::Replay(_)) => Outcome::accepted("replay", stable_bytes(&assignment)),
            Ok(Assignment::SelfCalibrate(config)) => match config.check() {
                Ok(()) => Outcome::accepted("calibrate", stable_bytes(&Assignment::SelfCalibrate(config))),
                Err(error) => {
                    let line = error.to_string();
                    assert!(!line.is_empty() && !line.contains('\n'), "{line}");
                    stable_bytes(&Assignment::SelfCalibrate(config));
                    Outcome::refused(name(error))
                }
            },
        }
    }
}

fn name(error: ConfigError) -> &'static str {
    match error {
        ConfigError::Rate => "rate",
        ConfigError::Noise => "noise",
        ConfigError::Heading => "heading",
        ConfigError::Stillness => "stillness",
        ConfigError::OutOfBounds { .. } => "bounds",
        ConfigError::Pace => "pace",
        ConfigError::Policy => "policy",
        ConfigError::Limits => "limits",
        ConfigError::Hardware(_) => "hardware",
        ConfigError::Segments => "segments",
        ConfigError::Site => "site",
        ConfigError::Scheme(_) => "scheme",
        ConfigError::TooFast(_) => "too-fast",
        ConfigError::Travel { .. } => "travel",
        ConfigError::ShortStop(_) => "short-stop",
        ConfigError::Unobserved(_) => "unobserved",
    }
}
