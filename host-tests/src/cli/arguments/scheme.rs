//! Which scheme is run.

use super::value::{number_in, of_option};
use crate::cli::files::Named;
use crate::files::scheme_file::scheme_named;
use clap::Args;
use rins_selfcal::base::method::Method;
use rins_selfcal::scheme::Scheme;
use std::path::Path;

#[derive(Debug, Args)]
pub struct SchemeArguments {
    /// A scheme of the library (`rins observability --all` lists them), or a file [default: fast-180, two-stage bai]
    #[arg(long, value_name = "NAME|FILE")]
    scheme: Option<String>,
    /// Time of every stop, s [default: as the scheme says]
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    stop: Option<f64>,
    /// How often the scheme is run [default: as the scheme says, two-stage bai 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    periods: Option<u8>,
}

impl SchemeArguments {
    /// The scheme, the usual one of this method where nothing else is asked for.
    pub fn scheme(&self, method: Method) -> anyhow::Result<Scheme> {
        let usual = Scheme::default_for(method);
        let name = self.scheme.as_deref().unwrap_or(&usual.name);
        let periods = self.periods.or((name == usual.name).then_some(usual.periods));
        of_option("--scheme", scheme_named(name, self.stop, periods))
    }

    /// The file that it may be.
    pub fn input(&self) -> Named<'_> {
        ("--scheme", self.scheme.as_deref().map(Path::new))
    }
}

/// What is done about a scheme that leaves parameters unobserved.
#[derive(Debug, Args)]
pub struct UnobservedArguments {
    /// Run a scheme that leaves parameters unobserved, to see what it shows: it is rejected in the end, not refused before
    #[arg(long)]
    pub run_unobserved: bool,
}

pub fn seconds(text: &str) -> Result<f64, String> {
    number_in(text, 0.1, 1e6)
}
