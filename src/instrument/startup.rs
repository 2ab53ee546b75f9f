//! What an instrument knows at power-up: its configuration, why its software has started, and whether it may move.

use super::surroundings::Archive;
use crate::base::restart::Restart;
use crate::run::config::SelfCalibrationConfig;
use crate::run::policy::MotionLock;

/// What an instrument knows at power-up.
#[derive(Clone, Debug)]
pub struct Startup {
    config: SelfCalibrationConfig,
    restart: Restart,
    lock: Option<MotionLock>,
    /// The configuration in place of a stored one that is refused; `None` for a configuration that was assigned.
    otherwise: Option<fn() -> SelfCalibrationConfig>,
}

impl Startup {
    /// With a configuration that somebody has assigned to this unit: code of the board, a test bench or a host. It
    /// commissions the unit.
    pub fn assigned(config: SelfCalibrationConfig, restart: Restart) -> Self {
        let lock = MotionLock::after(&restart);
        Self { config, restart, lock, otherwise: None }
    }

    /// With the configuration in the archive. Without a valid one, the unit is not commissioned: it uses the
    /// configuration that `otherwise` makes, and nothing moves.
    #[inline(never)]
    pub fn stored(archive: &mut impl Archive, otherwise: fn() -> SelfCalibrationConfig, restart: Restart) -> Self {
        let start = match archive.configuration().configuration {
            Some(unit) => Self::assigned(unit.run, restart),
            None => Self { lock: Some(MotionLock::NotCommissioned), ..Self::assigned(otherwise(), restart) },
        };
        Self { otherwise: Some(otherwise), ..start }
    }

    /// Replaces a stored configuration that is refused. Returns whether it was stored: an assigned one stays.
    pub(super) fn replace_refused(&mut self) -> bool {
        let Some(otherwise) = self.otherwise.take() else { return false };
        (self.config, self.lock) = (otherwise(), Some(MotionLock::NotCommissioned));
        true
    }

    /// The configuration.
    pub fn config(&self) -> &SelfCalibrationConfig {
        &self.config
    }

    /// The configuration, which the run may change when the link asks for it.
    pub(super) fn config_mut(&mut self) -> &mut SelfCalibrationConfig {
        &mut self.config
    }

    /// Why the software has started.
    pub fn restart(&self) -> &Restart {
        &self.restart
    }

    /// Why motion is locked, if it is.
    pub fn motion_lock(&self) -> Option<MotionLock> {
        self.lock
    }
}
