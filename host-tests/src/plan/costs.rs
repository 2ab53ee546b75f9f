//! What each imperfection of the hardware costs: the sigmas without it.

use crate::calibration::Setup;
use crate::calibration::virtual_run::VirtualRun;
use rins_selfcal::base::hardware::{HARDWARE, Hardware};
use rins_selfcal::base::units::ARCSEC;
use rins_selfcal::model::error_model::INSTALLATION_STATES;
use serde::Serialize;

/// Cost of the imperfections of the hardware.
#[derive(Clone, Debug, Serialize)]
pub struct HardwareCosts {
    /// The largest sigma of Bai's twelve states without any imperfection, arcsec.
    pub worst_of_ideal_arcsec: f64,
    /// Each imperfection that the unit has, the most expensive first.
    pub each: Vec<HardwareCost>,
}

/// Cost of one imperfection.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct HardwareCost {
    /// Key of its size in the unit description.
    pub key: &'static str,
    /// Its size.
    pub size: f64,
    /// Unit of the size.
    pub unit: &'static str,
    /// The largest sigma of Bai's twelve states without it, arcsec.
    pub worst_without_arcsec: f64,
}

impl HardwareCosts {
    /// The costs on a run without noise. The core solves the segments of the run once more for each imperfection.
    pub fn new(setup: &Setup, run: &VirtualRun) -> Self {
        let mut chain = setup.clone().on_scheme(&run.scheme).chain();
        run.drive().for_each(|reading| {
            let _ = chain.step(&reading);
        });
        let _ = chain.finish();
        let mut worst_arcsec = |hardware: &Hardware| {
            let sigmas = chain.sigmas_with(hardware);
            sigmas.iter().take(INSTALLATION_STATES).fold(0.0, |worst, sigma| f64::max(worst, *sigma)) / ARCSEC
        };
        let present = HARDWARE.iter().filter(|size| size.get(&setup.hardware) > 0.0);
        let mut each: Vec<HardwareCost> = present
            .map(|size| {
                let mut without = setup.hardware;
                size.set(&mut without, 0.0);
                HardwareCost {
                    key: size.key,
                    size: size.get(&setup.hardware) / size.unit_si,
                    unit: size.unit,
                    worst_without_arcsec: worst_arcsec(&without),
                }
            })
            .collect();
        each.sort_by(|a, b| a.worst_without_arcsec.total_cmp(&b.worst_without_arcsec));
        Self { worst_of_ideal_arcsec: worst_arcsec(&Hardware::IDEAL), each }
    }
}
