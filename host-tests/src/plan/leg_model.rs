//! The measurement model of one leg, from the core.

use rins_selfcal::base::linear::ComplexField;
use rins_selfcal::base::site::EARTH_RATE_RAD_S;
use rins_selfcal::estimator::rehearsal::{move_segment, stop_segment};
use rins_selfcal::model::error_model::block;
use rins_selfcal::model::measurement::{MeasurementModel, Prediction};
use rins_selfcal::scheme::{Leg, Turning};
use rins_selfcal::segment::{AngleIntegrals, Course, Segment};

/// Rounding unit of the numbers of a model. Derivatives of rotation by attitude are rounded to this part of Earth rate.
const ROUNDING: f64 = 1.0 / (1 << 24) as f64;

/// Measurement model of a stop and the move to the stop. It does not depend on the duration of the stop.
#[derive(Clone, Debug)]
pub struct LegModel {
    /// Time of the move, s.
    pub move_s: f64,
    /// Rotation over the move.
    pub turn: Prediction<f64>,
    /// Mean force at the stop.
    pub force: Prediction<f64>,
    /// Rotation over one second of rest.
    pub rest: Prediction<f64>,
    /// The move.
    pub moved: Segment<f64>,
    /// One second of the stop.
    pub at_rest: Segment<f64>,
}

impl LegModel {
    /// The leg between two stops; the first stop has no move before it.
    pub fn new(model: &MeasurementModel<f64>, turning: &Turning, from: &Leg, to: &Leg) -> Self {
        let (moved, at_rest) = (move_segment(from, to, turning), stop_segment(to, 1.0));
        let mut rest = model.rotation(&rest_segment(to));
        // The encoder error is the same at both ends, so it cancels.
        rest.by_encoder_errors.fill(0.0);
        rest.by_geometry.fill(0.0);
        let of_rotation = ROUNDING * EARTH_RATE_RAD_S;
        Self {
            move_s: turning.move_s(from, to),
            turn: rounded(model.rotation(&moved), of_rotation),
            force: rounded(model.force_at_stop(&at_rest), ROUNDING),
            rest: rounded(rest, of_rotation),
            moved,
            at_rest,
        }
    }

    /// Rotation over a stop of this duration.
    pub fn rest_of(&self, duration_s: f64) -> Prediction<f64> {
        let Prediction { value, by_parameters, in_g, by_attitude_rate, by_earth_rate, .. } = self.rest;
        Prediction {
            value: value * duration_s,
            by_parameters: by_parameters * duration_s,
            in_g: in_g * duration_s,
            by_attitude_rate: by_attitude_rate * duration_s,
            by_earth_rate: by_earth_rate * duration_s,
            ..self.rest
        }
    }
}

/// One second at rest, written as a move by zero. A stop has angles in whole ticks of the encoders, and the result of a
/// search must not depend on the ticks.
fn rest_segment(stand: &Leg) -> Segment<f64> {
    let ((so, co), (si, ci)) = (stand.outer_rad.sin_cos(), stand.inner_rad.sin_cos());
    let attitude_s = [1.0, ci, si].map(|inner| [1.0, co, so].map(|outer| (inner * outer) as f32));
    let integrals = AngleIntegrals { attitude_s, ..AngleIntegrals::default() };
    Segment { course: Course::Move(integrals), ..stop_segment(stand, 1.0) }
}

/// A prediction without its last digits, which depend on the order of operations in the core. So a search finds the
/// same scheme after a change of the core that does not change the model. Derivatives by attitude are rounded to
/// `by_attitude`.
fn rounded(mut prediction: Prediction<f64>, by_attitude: f64) -> Prediction<f64> {
    let round = |value: &mut f64, unit: f64| *value = ComplexField::round(*value / unit) * unit;
    let all = prediction.by_encoder_errors.iter_mut().chain(prediction.by_geometry.iter_mut());
    let all = all.chain(prediction.by_attitude_rate.iter_mut()).chain(prediction.by_earth_rate.iter_mut());
    all.chain(prediction.in_g.iter_mut()).for_each(|value| round(value, ROUNDING));
    prediction.value.iter_mut().for_each(|value| round(value, by_attitude));
    for (parameter, mut column) in prediction.by_parameters.column_iter_mut().enumerate() {
        let unit = if parameter < block::ATTITUDE { ROUNDING } else { by_attitude };
        column.iter_mut().for_each(|value| round(value, unit));
    }
    prediction
}
