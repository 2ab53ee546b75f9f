//! Choice of the scheme.

use super::value::{number_in, of_option};
use crate::calibration::HostMethod;
use crate::cli::files::NamedFile;
use crate::files::scheme_file::scheme_named;
use clap::Args;
use rins_selfcal::scheme::Scheme;
use std::path::Path;

#[derive(Debug, Args)]
pub struct SchemeArguments {
    /// Scheme of the library (`rins observability --all` lists them), or a file [default: fast-180; bai for the method bai]
    #[arg(long, value_name = "NAME|FILE")]
    scheme: Option<String>,
    /// Duration of every stop, s [default: that of the scheme]
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    stop: Option<f64>,
    /// Number of times the scheme is run [default: that of the scheme; 2 for bai with the method bai]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    periods: Option<u8>,
}

impl SchemeArguments {
    /// The chosen scheme, or the default scheme of the method.
    pub fn scheme(&self, method: impl Into<HostMethod>) -> anyhow::Result<Scheme> {
        let usual = Scheme::default_for(method.into().core());
        let name = self.scheme.as_deref().unwrap_or(&usual.name);
        let periods = self.periods.or((name == usual.name).then_some(usual.periods));
        of_option("--scheme", scheme_named(name, self.stop, periods))
    }

    /// The scheme as an input file, because its name may be the path of a file.
    pub fn input(&self) -> NamedFile<'_> {
        ("--scheme", self.scheme.as_deref().map(Path::new))
    }
}

/// Treatment of a scheme that leaves parameters unobserved.
#[derive(Debug, Args)]
pub struct UnobservedArguments {
    /// Run a scheme that leaves parameters unobserved: it is not refused at the start, but rejected at the end
    #[arg(long)]
    pub run_unobserved: bool,
}

pub fn seconds(text: &str) -> Result<f64, String> {
    number_in(text, 0.1, 1e6)
}
