//! The methods that the host program offers, by name.

use clap::ValueEnum;
use clap::builder::PossibleValue;
use rins_selfcal::base::method::Method;
use rins_selfcal::model::error_model::block;

/// A method that the host program offers: one of the core, or one that only the host has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum HostMethod {
    /// All 28 parameters at once
    #[default]
    Joint,
    /// The filter of Bai et al. as they write it: the twelve installation errors in two stages; also: two-stage
    #[value(alias = "two-stage")]
    Bai,
}

impl HostMethod {
    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::Bai => "bai",
        }
    }

    /// The method of the core that takes in the samples.
    pub fn core(self) -> Method {
        match self {
            Self::Joint => Method::Joint,
            Self::Bai => Method::Bai,
        }
    }

    /// Whether the method estimates a parameter. The paper's method takes biases, scale-factor errors and
    /// non-perpendicularity as zero, and levels the first stop for the attitude.
    pub fn estimates(self, parameter: usize) -> bool {
        match self {
            Self::Joint => true,
            Self::Bai => parameter < block::ACCEL_BIAS,
        }
    }
}

impl From<Method> for HostMethod {
    fn from(method: Method) -> Self {
        match method {
            Method::Joint => Self::Joint,
            Method::Bai => Self::Bai,
        }
    }
}

impl PartialEq<Method> for HostMethod {
    fn eq(&self, method: &Method) -> bool {
        *self == Self::from(*method)
    }
}

/// One method, or all of them on the same data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MethodChoice {
    /// This method.
    One(HostMethod),
    /// All methods.
    All,
}

impl ValueEnum for MethodChoice {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::One(HostMethod::Joint), Self::One(HostMethod::Bai), Self::All]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match self {
            Self::One(method) => method.to_possible_value(),
            Self::All => Some(PossibleValue::new("all").help("All methods, on the same data")),
        }
    }
}

/// The methods that are chosen, each once, in their order.
pub fn chosen(choices: &[MethodChoice]) -> Vec<HostMethod> {
    let is_chosen = |method: &HostMethod| {
        choices.iter().any(|choice| *choice == MethodChoice::All || *choice == MethodChoice::One(*method))
    };
    HostMethod::value_variants().iter().copied().filter(is_chosen).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_command_line() {
        for method in HostMethod::value_variants() {
            assert_eq!(HostMethod::from_str(method.name(), false), Ok(*method));
            assert_eq!(
                MethodChoice::from_str(method.name(), false),
                Ok(MethodChoice::One(*method)),
                "every method can be chosen"
            );
            assert_eq!(HostMethod::from(method.core()), *method);
        }
        assert_eq!(HostMethod::from_str("two-stage", false), Ok(HostMethod::Bai), "the older name");
    }

    #[test]
    fn each_method_is_chosen_once() {
        let (bai, joint) = (MethodChoice::One(HostMethod::Bai), MethodChoice::One(HostMethod::Joint));
        assert_eq!(chosen(&[bai, joint, bai]), [HostMethod::Joint, HostMethod::Bai]);
        assert_eq!(chosen(&[MethodChoice::All, bai]), HostMethod::value_variants());
    }
}
