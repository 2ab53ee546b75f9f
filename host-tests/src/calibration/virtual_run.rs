//! A virtual unit that runs a scheme, for simulation, prediction and statistics.

use super::{Chain, Outcome, Setup};
use crate::virtual_unit::drive::SchemeDrive;
use crate::virtual_unit::plant::Reading;
use crate::virtual_unit::unit::VirtualUnit;
use crate::virtual_unit::virtual_rins::VirtualRins;
use rins_selfcal::scheme::Scheme;

/// Settling time at the end of each move, before the stop counts, s. It is the sequencer's.
pub const SETTLING_S: f64 = rins_selfcal::scheme::SETTLING_S;

/// Independent streams of random numbers from one seed.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// Errors of the unit.
    Errors,
    /// Noise of the sensors and encoders.
    Noise,
}

/// Seed of a stream in run number `run`. (SplitMix64; Steele, Lea and Flood 2014)
pub fn derived_seed(seed: u64, run: u64, stream: Stream) -> u64 {
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let mixed = |x: u64| {
        let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    };
    let of_seed = mixed(seed.wrapping_add(GOLDEN));
    mixed(of_seed.wrapping_add((2 * run + stream as u64 + 1).wrapping_mul(GOLDEN)))
}

/// One run of one unit.
#[derive(Clone, Debug)]
pub struct VirtualRun {
    /// The unit.
    pub unit: VirtualUnit,
    /// The scheme.
    pub scheme: Scheme,
    /// Seed of the noise.
    pub seed: u64,
}

impl VirtualRun {
    /// The unit at the start of the scheme, in open loop.
    pub fn drive(&self) -> SchemeDrive {
        SchemeDrive::new(VirtualRins::new(&self.unit, self.seed), &self.scheme, SETTLING_S)
    }

    /// Runs several calibrations on the same readings.
    pub fn calibrate(&self, setups: &[Setup]) -> Vec<Outcome> {
        self.calibrate_noting(setups, |_| ())
    }

    /// As [`Self::calibrate`]; `note` is called with every reading.
    pub fn calibrate_noting(&self, setups: &[Setup], mut note: impl FnMut(&Reading)) -> Vec<Outcome> {
        let chain = |setup: &Setup| (setup.clone().on_scheme(&self.scheme).chain(), Vec::new());
        let mut chains: Vec<_> = setups.iter().map(chain).collect();
        let mut drive = self.drive();
        while let Some(reading) = drive.next() {
            note(&reading);
            for (chain, live_truth) in &mut chains {
                // The live estimates are part of the outcome.
                live_truth.extend(chain.step(&reading).map(|_| drive.rins().errors_of_live_estimate()));
            }
        }
        let truth = drive.rins().errors_now();
        let conclude = |(mut chain, mut live_truth): (Box<dyn Chain>, Vec<_>)| {
            let outcome = chain.conclude();
            // The last live estimate is the solution.
            live_truth.resize(outcome.live.len(), truth);
            Outcome { truth: Some(truth), live_truth, ..outcome }
        };
        chains.into_iter().map(conclude).collect()
    }

    /// Duration including ramps and settling, s.
    pub fn duration_s(&self) -> f64 {
        self.drive().total_samples() as f64 / self.unit.rate_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::quantity;
    use crate::calibration::Precision;
    use crate::files::unit_file::{Noise, UnitConfig};
    use crate::virtual_unit::presets;
    use rins_selfcal::base::method::Method;
    use rins_selfcal::model::error_model::block;

    #[test]
    fn seeds_of_runs_and_streams_differ() {
        let seeds = (0..4).flat_map(|seed| {
            (0..50).flat_map(move |run| [Stream::Errors, Stream::Noise].map(|stream| derived_seed(seed, run, stream)))
        });
        assert_eq!(seeds.collect::<std::collections::HashSet<_>>().len(), 400);
    }

    #[test]
    fn the_duration_includes_ramps_and_settling() {
        let run = VirtualRun { unit: VirtualUnit::default(), scheme: Scheme::bai(10.0, 1), seed: 0 };
        assert!((run.duration_s() - (289.0 + 19.0 * SETTLING_S)).abs() < 1e-9);
    }

    /// With both methods, each segment reports its innovations once, and their squares sum to the chi-square of the
    /// solution.
    #[test]
    fn innovations_of_the_last_sweep_make_up_the_chi_square() {
        let config = UnitConfig::ideal();
        let unit = VirtualUnit { errors: presets::table3(), rate_hz: 50.0, ..VirtualUnit::default() };
        let run = VirtualRun { unit, scheme: Scheme::bai(2.0, 2), seed: 3 };
        let setups = [Method::Joint, Method::Bai].map(|method| Setup::new(&config, 50.0, method, Precision::F64));
        for outcome in run.calibrate(&setups) {
            let segments: Vec<u16> = outcome.innovations.iter().map(|innovations| innovations.segment).collect();
            assert_eq!(segments, (0..outcome.solution.segments).collect::<Vec<_>>());
            let all = outcome.innovations.iter().flat_map(|innovations| innovations.normalized).flatten();
            let (count, sum) = all.fold((0, 0.0), |(count, sum), value| (count + 1, sum + f64::from(value * value)));
            let fit = &outcome.solution.fit;
            assert_eq!(count, fit.measurements);
            // The estimate may still change by a hundredth of a sigma after the last sweep.
            assert!((sum / fit.chi_square - 1.0).abs() < 1e-3, "{sum} for {}", fit.chi_square);
        }
    }

    /// What errors the paper's method does not model become, with the sizes of the issue: a bias of 30 ug is a tilt of 6.2
    /// arcsec, and a mounting angle takes in up to 1.5 of them.
    #[test]
    fn the_papers_method_is_wrong_on_a_real_unit_and_says_so() {
        let config = UnitConfig { noise: Noise::bai(), ..UnitConfig::ideal() };
        let unit =
            VirtualUnit { errors: presets::real(1), noise: config.noise, rate_hz: 50.0, ..VirtualUnit::default() };
        let run = VirtualRun { unit, scheme: Scheme::bai(200.0, 2), seed: 1 };
        let outcome = run.calibrate(&[Setup::new(&config, 50.0, Method::Bai, Precision::F64)]).remove(0);
        let errors = quantity::errors(&outcome.estimate().errors, &run.unit.errors);
        let worst = errors[..block::ACCEL_BIAS].iter().fold(0.0_f64, |worst, error| worst.max(error.abs()));
        assert!((4.0..10.0).contains(&worst), "{errors:?}");
        assert!(!outcome.verdict.accepted());
    }
}
