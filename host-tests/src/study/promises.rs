//! What the programs of the studies of promises share.

use anyhow::{Result, ensure};
use clap::Args;

/// The seed of a study.
#[derive(Clone, Copy, Debug, Args)]
pub struct Seed {
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Prints every broken promise.
///
/// # Errors
/// A promise was broken.
pub fn kept<'a>(breaches: impl IntoIterator<Item = &'a String>) -> Result<()> {
    let broken = breaches.into_iter().inspect(|breach| println!("  {breach}")).count();
    ensure!(broken == 0, "{broken} promises were broken");
    Ok(())
}
