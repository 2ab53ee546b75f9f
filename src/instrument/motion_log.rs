//! What the archive knows of the motion of axes whose turn it must know after the next power-up.
//!
//! Before the first move the archive keeps [`Mark::Moving`], and after the axes have come to rest [`Mark::AtRest`] with
//! their angles. At power-up the axes stand where the last mark says, if it says that they are at rest and if the
//! encoders agree. Otherwise somebody must say where they stand. Nothing is written for axes that need no mark.

use super::surroundings::{Archive, Axes, Surroundings};
use crate::base::linear::Real;
use crate::base::units::DEG;
use crate::gimbal::GimbalStatus;
use crate::gimbal::travel::{Travel, TurnSource, TurnState};
use crate::keep::mark::Mark;
use crate::run::config::SelfCalibrationConfig;
use crate::run::self_calibration::SelfCalibration;

/// Greatest difference between the angles of a mark and the encoders, rad. An axis that was turned by hand differs
/// more.
const AGREEMENT_RAD: f64 = DEG;

/// The state of the marks.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MotionLog {
    /// The last mark says that the axes move.
    moving: bool,
    /// The mark of the last power-off has been used.
    looked_up: bool,
}

impl MotionLog {
    /// Keeps in the archive that the axes move from now on. Returns whether they may move.
    pub(super) fn begin(&mut self, config: &SelfCalibrationConfig, archive: &mut impl Archive) -> bool {
        self.moving = self.moving || !needs_marks(config) || archive.mark(Mark::Moving);
        self.moving
    }

    /// Somebody has said where the axes stand, so that the next mark says so too.
    pub(super) fn confirm(&mut self) {
        self.moving = true;
    }

    /// Looks up the mark of the last power-off when the encoders have been found, and keeps the angles of axes that
    /// have come to rest after a run.
    pub(super) fn follow<T: Real>(
        &mut self,
        run: &SelfCalibration<'_, T>,
        gimbal: &GimbalStatus,
        outside: &mut impl Surroundings<T>,
    ) {
        if !needs_marks(run.config()) {
            return;
        }
        if !self.looked_up && !gimbal.turns.contains(&TurnState::Searching) {
            self.looked_up = true;
            look_up(run.config(), outside);
        }
        if self.moving && run.state().is_idle() && gimbal.at_rest {
            self.moving = false;
            rest(outside);
        }
    }
}

#[inline(never)]
fn look_up<T: Real>(config: &SelfCalibrationConfig, outside: &mut impl Surroundings<T>) {
    let Some(Mark::AtRest { angles_rad: [outer_rad, inner_rad] }) = outside.archive().last_mark() else { return };
    let [outer, inner] = config.axes.each_ref().map(|axis| is_stored(&axis.travel));
    // If an encoder does not agree, the turn stays unknown, and the first move reports it.
    let _ = outside.locate([outer.then_some(outer_rad), None], AGREEMENT_RAD);
    let _ = outside.locate([None, inner.then_some(inner_rad)], AGREEMENT_RAD);
}

/// If the mark cannot be stored, the last one still says that the axes move, which is safe.
#[inline(never)]
fn rest<T: Real>(outside: &mut impl Surroundings<T>) {
    if let [Some(outer_rad), Some(inner_rad)] = Axes::angles_rad(outside) {
        outside.archive().mark(Mark::AtRest { angles_rad: [outer_rad, inner_rad] });
    }
}

fn needs_marks(config: &SelfCalibrationConfig) -> bool {
    config.axes.iter().any(|axis| is_stored(&axis.travel))
}

fn is_stored(travel: &Travel) -> bool {
    matches!(travel, Travel::Limited { turn: TurnSource::Stored, .. })
}
