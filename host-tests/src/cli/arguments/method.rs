//! Estimation method and its options.

use super::unit::rate_hz;
use crate::calibration::method::{MethodChoice, chosen};
use crate::calibration::{HostMethod, Precision, Setup};
use crate::files::unit_file::UnitConfig;
use crate::separating::SeparatingMethod;
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};

/// A method for readings that are there: one of the core's chain, or a separating method.
#[derive(Clone, Copy, Debug)]
pub enum ReplayMethod {
    Chain(HostMethod),
    Separating(SeparatingMethod),
}

impl Default for ReplayMethod {
    fn default() -> Self {
        Self::Chain(HostMethod::default())
    }
}

impl ValueEnum for ReplayMethod {
    fn value_variants<'a>() -> &'a [Self] {
        &[
            Self::Chain(HostMethod::Joint),
            Self::Chain(HostMethod::Bai),
            Self::Separating(SeparatingMethod::ThinShell),
            Self::Separating(SeparatingMethod::SingularValues),
        ]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match self {
            Self::Chain(method) => method.to_possible_value(),
            Self::Separating(method) => method.to_possible_value(),
        }
    }
}

/// Methods of a study: those of the core's chain, separating methods, or all of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StudyMethod {
    Chain(MethodChoice),
    Separating(SeparatingMethod),
}

impl ValueEnum for StudyMethod {
    fn value_variants<'a>() -> &'a [Self] {
        &[
            Self::Chain(MethodChoice::One(HostMethod::Joint)),
            Self::Chain(MethodChoice::One(HostMethod::Bai)),
            Self::Separating(SeparatingMethod::ThinShell),
            Self::Separating(SeparatingMethod::SingularValues),
            Self::Chain(MethodChoice::All),
        ]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match self {
            Self::Chain(choice) => choice.to_possible_value(),
            Self::Separating(method) => method.to_possible_value(),
        }
    }
}

/// The methods of the core's chain among the chosen ones, each once.
pub fn of_chain(methods: &[StudyMethod]) -> Vec<HostMethod> {
    let choice = |method: &StudyMethod| match method {
        StudyMethod::Chain(choice) => Some(*choice),
        StudyMethod::Separating(_) => None,
    };
    chosen(&methods.iter().filter_map(choice).collect::<Vec<_>>())
}

/// The separating methods among the chosen ones, each once.
pub fn separating(methods: &[StudyMethod]) -> Vec<SeparatingMethod> {
    let is_chosen = |method: &SeparatingMethod| {
        methods.contains(&StudyMethod::Chain(MethodChoice::All)) || methods.contains(&StudyMethod::Separating(*method))
    };
    SeparatingMethod::value_variants().iter().copied().filter(is_chosen).collect()
}

#[derive(Debug, Args)]
pub struct MethodArguments {
    /// Estimation method
    #[arg(long, value_enum, default_value_t)]
    pub method: HostMethod,
    /// Floating-point type of the core
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
}

impl MethodArguments {
    pub fn setup(&self, unit: &UnitConfig) -> Setup {
        Setup::new(unit, rate_hz(unit), self.method, self.precision)
    }
}
