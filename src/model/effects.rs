//! Effects of real hardware: states beside the 28 parameters, and noise that is not white.
//!
//! The sizes are those of [`Hardware`]. All effects act linearly through quantities that the measurement models have.
//! ```text
//! (M8)  accelerometer i    K f_i^2 + ka' |f_i| + warm-up + flicker
//!       gyro i             kg' int |w_i| + kg'' int w_i |w_i| / (20 deg/s) + warm-up
//!       warm-up            exp(-t / tau) - exp(-t_ref / tau), t from the start of the run
//! (M9)  encoder error      sum over n of c_n (cos n angle - 1) + s_n sin n angle, + backlash times the sense of arrival
//! (M10) axis wobble        the axis tilts across itself by c_n (cos n angle - 1) + s_n sin n angle, n = 1, 2
//!       sag                the inner axis tilts about y of the outer gimbal, by the same function of the outer angle
//! (M11) flicker, 1/f       a sum of processes with exponential correlation, whose time constants form a series
//! ```
//! t_ref is the end of the run in the solution, and the start of the run in the live estimates before it.
//!
//! Harmonics, wobble and sag vanish at angle zero, because the encoder zeros define the rotation frame. What adds only
//! noise that differs from segment to segment has no state: cross-quadratic, g-sensitivity, sub-division, rocking, and
//! pulses.

use crate::base::bounds::{Bounded, DEGREES, MILLIGALS};
use crate::base::hardware::{FLICKER_DENSITY, Hardware, HardwareSize, REFERENCE_RATE_RAD_S};
use crate::base::linear::{ComplexField, Matrix, Real, Vector3, columns as columns_of, real};
use crate::base::site::{EARTH_RATE_RAD_S, LATITUDE_SIGMA_DEG, UNKNOWN_LATITUDE_SIGMA_DEG};
use crate::base::units::{ARCSEC, DEG, DEG_H, HOUR_S, MGAL, MICRO_G, PPM};
use crate::model::error_model::{ParameterInfo, block};
use crate::model::measurement::{BACKLASH, GEOMETRY, Prediction};
use crate::segment::Segment;
use core::ops::Range;
use serde::{Deserialize, Serialize};

/// Number of states of effects, without the flicker.
pub const EFFECT_STATES: usize = 67;

/// Number of effects that are tested: those with a state, then those that are noise in the filter.
pub const EFFECTS: usize = EFFECT_STATES + 18;

/// Blocks of the effects, as ranges of indices.
pub mod effect {
    use core::ops::Range;
    /// Quadratic of the accelerometers x y z.
    pub const ACCEL_QUADRATIC: Range<usize> = 0..3;
    /// Scale asymmetry of the accelerometers.
    pub const ACCEL_ASYMMETRY: Range<usize> = 3..6;
    /// Scale asymmetry of the gyros.
    pub const GYRO_ASYMMETRY: Range<usize> = 6..9;
    /// Scale of the gyros against rate.
    pub const GYRO_RATE_SCALE: Range<usize> = 9..12;
    /// Warm-up of the accelerometer biases: fast, then slow.
    pub const ACCEL_WARM_UP: Range<usize> = 12..18;
    /// Warm-up of the gyro biases.
    pub const GYRO_WARM_UP: Range<usize> = 18..21;
    /// Warm-up of the accelerometer scale factors.
    pub const ACCEL_SCALE_WARM_UP: Range<usize> = 21..24;
    /// Warm-up of the gyro scale factors.
    pub const GYRO_SCALE_WARM_UP: Range<usize> = 24..27;
    /// Effects of encoders and axes, in the order of
    /// [`Prediction::by_geometry`](crate::model::measurement::Prediction).
    pub const GEOMETRY: Range<usize> = 27..63;
    /// Drift of roll and pitch of the base.
    pub const BASE_DRIFT: Range<usize> = 63..65;
    /// Latitude minus the configured latitude.
    pub const LATITUDE: usize = 65;
    /// Gravity minus that of the site.
    pub const GRAVITY: usize = 66;
    /// Cross-quadratic, no state: accelerometers x y z, for the products yz, zx and xy each.
    pub const ACCEL_CROSS_QUADRATIC: Range<usize> = 67..76;
    /// g-sensitivity, no state: gyros x y z, by the forces x y z each.
    pub const G_SENSITIVITY: Range<usize> = 76..85;
}

/// Time constants of the warm-up of the accelerometer biases, and of all other quantities, s. A sum of the first two
/// follows an exponential with any constant from 100 to 1000 s.
const WARM_UP_S: [f64; 2] = [130.0, 500.0];
const OTHER_WARM_UP_S: f64 = 250.0;
/// Part of the size that each of the two exponentials has.
const WARM_UP_PART: f64 = 0.8;

/// Number of states of the flicker of the accelerometers: medium and slow, x y z each.
pub const FLICKER_STATES: usize = 6;
/// Time constants of the flicker, s. The fastest part is noise of each stop.
const FLICKER_S: [f64; 3] = [4.0, 30.0, 250.0];
/// Smallest decay of the flicker between two segments. It is as good as none, and the filter can divide by it in `f32`.
const LEAST_DECAY: f64 = 1e-6;
/// Natural logarithm of the ratio of two successive time constants.
const FLICKER_SPACING: f64 = 2.07;
/// Random walk of a gyro's bias that is as uncertain after some minutes as its flicker, in units of the floor per
/// sqrt(s). White noise hides the finer structure of the flicker of a gyro.
const GYRO_FLICKER_WALK: f64 = 0.17;

/// Sigmas of what is known about the site. [`SITE_SIGMA_BOUNDS`] has the permitted range of every number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SiteSigmas {
    /// Sigma of the latitude, rad.
    pub latitude_rad: f64,
    /// Sigma of gravity at the given latitude, from height and anomaly, m/s^2.
    pub gravity_m_s2: f64,
}

/// The permitted range of every number of [`SiteSigmas`].
pub static SITE_SIGMA_BOUNDS: [Bounded<SiteSigmas>; 2] = [
    Bounded::new("sigma of the latitude", DEGREES, [0.0, 90.0], |sigmas| sigmas.latitude_rad),
    Bounded::new("sigma of gravity", MILLIGALS, [0.0, 100_000.0], |sigmas| sigmas.gravity_m_s2),
];

impl SiteSigmas {
    /// The site is known exactly.
    pub const EXACT: Self = Self { latitude_rad: 0.0, gravity_m_s2: 0.0 };
    /// Latitude and height are given: sigmas of 0.02 deg, of 30 m, and of 20 mGal for the anomaly of gravity.
    pub const GIVEN: Self = Self { latitude_rad: LATITUDE_SIGMA_DEG * DEG, gravity_m_s2: 22.0 * MGAL };
    /// Nothing is given: any latitude, and a height of 0 m with a sigma of 2000 m.
    pub const UNKNOWN: Self = Self { latitude_rad: UNKNOWN_LATITUDE_SIGMA_DEG * DEG, gravity_m_s2: 617.5 * MGAL };
}

/// Prior sigmas of the effects, SI; 0 for an effect that is absent.
pub fn prior_sigmas(hardware: &Hardware, site: &SiteSigmas) -> [f64; EFFECTS] {
    let Hardware { encoder_harmonics: [first, second, third, fourth], wobble: [wobble, wobble_twice], sag, .. } =
        *hardware;
    let with_sag = |size: f32| ComplexField::hypot(f64::from(size), f64::from(sag));
    let blocks: [(Range<usize>, f64); 23] = [
        (effect::ACCEL_QUADRATIC, hardware.accel_quadratic.into()),
        (effect::ACCEL_ASYMMETRY, hardware.accel_asymmetry.into()),
        (effect::GYRO_ASYMMETRY, hardware.gyro_asymmetry.into()),
        (effect::GYRO_RATE_SCALE, hardware.gyro_rate_scale.into()),
        (effect::ACCEL_WARM_UP, WARM_UP_PART * f64::from(hardware.accel_warm_up)),
        (effect::GYRO_WARM_UP, hardware.gyro_warm_up.into()),
        (effect::ACCEL_SCALE_WARM_UP, hardware.scale_warm_up.into()),
        (effect::GYRO_SCALE_WARM_UP, hardware.scale_warm_up.into()),
        // The base that tilts about x with the outer angle acts as the first harmonic of the outer encoder.
        (geometry(0, 2), with_sag(first)),
        (geometry(2, 2), first.into()),
        (geometry(4, 4), second.into()),
        (geometry(8, 4), third.into()),
        (geometry(12, 4), fourth.into()),
        (geometry(16, 2), hardware.backlash.into()),
        // The base that tilts about y with the outer angle acts as the wobble of the outer axis.
        (geometry(18, 2), with_sag(wobble)),
        (geometry(20, 6), wobble.into()),
        (geometry(26, 2), sag.into()),
        (geometry(28, 8), wobble_twice.into()),
        (effect::BASE_DRIFT, hardware.base_drift.into()),
        (effect::LATITUDE..effect::LATITUDE + 1, site.latitude_rad),
        (effect::GRAVITY..effect::GRAVITY + 1, site.gravity_m_s2),
        (effect::ACCEL_CROSS_QUADRATIC, hardware.accel_cross_quadratic.into()),
        (effect::G_SENSITIVITY, hardware.gyro_g_sensitivity.into()),
    ];
    let mut sigmas = [0.0; EFFECTS];
    for (states, size) in blocks {
        for sigma in sigmas.iter_mut().take(states.end).skip(states.start) {
            *sigma = size;
        }
    }
    sigmas
}

const fn geometry(first: usize, count: usize) -> Range<usize> {
    effect::GEOMETRY.start + first..effect::GEOMETRY.start + first + count
}

const fn info(name: &'static str, unit: &'static str, unit_si: f64) -> ParameterInfo {
    ParameterInfo { name, unit, unit_si }
}

/// Names and units of the effects.
pub static EFFECT_INFO: [ParameterInfo; EFFECTS] = [
    info("accel_quadratic_x", "ug/g^2", MICRO_G),
    info("accel_quadratic_y", "ug/g^2", MICRO_G),
    info("accel_quadratic_z", "ug/g^2", MICRO_G),
    info("accel_asymmetry_x", "ppm", PPM),
    info("accel_asymmetry_y", "ppm", PPM),
    info("accel_asymmetry_z", "ppm", PPM),
    info("gyro_asymmetry_x", "ppm", PPM),
    info("gyro_asymmetry_y", "ppm", PPM),
    info("gyro_asymmetry_z", "ppm", PPM),
    info("gyro_rate_scale_x", "ppm at 20 deg/s", PPM),
    info("gyro_rate_scale_y", "ppm at 20 deg/s", PPM),
    info("gyro_rate_scale_z", "ppm at 20 deg/s", PPM),
    info("accel_warm_up_fast_x", "ug", MICRO_G),
    info("accel_warm_up_fast_y", "ug", MICRO_G),
    info("accel_warm_up_fast_z", "ug", MICRO_G),
    info("accel_warm_up_slow_x", "ug", MICRO_G),
    info("accel_warm_up_slow_y", "ug", MICRO_G),
    info("accel_warm_up_slow_z", "ug", MICRO_G),
    info("gyro_warm_up_x", "deg/h", DEG_H),
    info("gyro_warm_up_y", "deg/h", DEG_H),
    info("gyro_warm_up_z", "deg/h", DEG_H),
    info("accel_scale_warm_up_x", "ppm", PPM),
    info("accel_scale_warm_up_y", "ppm", PPM),
    info("accel_scale_warm_up_z", "ppm", PPM),
    info("gyro_scale_warm_up_x", "ppm", PPM),
    info("gyro_scale_warm_up_y", "ppm", PPM),
    info("gyro_scale_warm_up_z", "ppm", PPM),
    info("outer_harmonic_1_cos", "arcsec", ARCSEC),
    info("outer_harmonic_1_sin", "arcsec", ARCSEC),
    info("inner_harmonic_1_cos", "arcsec", ARCSEC),
    info("inner_harmonic_1_sin", "arcsec", ARCSEC),
    info("outer_harmonic_2_cos", "arcsec", ARCSEC),
    info("outer_harmonic_2_sin", "arcsec", ARCSEC),
    info("inner_harmonic_2_cos", "arcsec", ARCSEC),
    info("inner_harmonic_2_sin", "arcsec", ARCSEC),
    info("outer_harmonic_3_cos", "arcsec", ARCSEC),
    info("outer_harmonic_3_sin", "arcsec", ARCSEC),
    info("inner_harmonic_3_cos", "arcsec", ARCSEC),
    info("inner_harmonic_3_sin", "arcsec", ARCSEC),
    info("outer_harmonic_4_cos", "arcsec", ARCSEC),
    info("outer_harmonic_4_sin", "arcsec", ARCSEC),
    info("inner_harmonic_4_cos", "arcsec", ARCSEC),
    info("inner_harmonic_4_sin", "arcsec", ARCSEC),
    info("outer_backlash", "arcsec", ARCSEC),
    info("inner_backlash", "arcsec", ARCSEC),
    info("outer_wobble_y_cos", "arcsec", ARCSEC),
    info("outer_wobble_y_sin", "arcsec", ARCSEC),
    info("outer_wobble_z_cos", "arcsec", ARCSEC),
    info("outer_wobble_z_sin", "arcsec", ARCSEC),
    info("inner_wobble_x_cos", "arcsec", ARCSEC),
    info("inner_wobble_x_sin", "arcsec", ARCSEC),
    info("inner_wobble_y_cos", "arcsec", ARCSEC),
    info("inner_wobble_y_sin", "arcsec", ARCSEC),
    info("inner_sag_cos", "arcsec", ARCSEC),
    info("inner_sag_sin", "arcsec", ARCSEC),
    info("outer_wobble_2_y_cos", "arcsec", ARCSEC),
    info("outer_wobble_2_y_sin", "arcsec", ARCSEC),
    info("outer_wobble_2_z_cos", "arcsec", ARCSEC),
    info("outer_wobble_2_z_sin", "arcsec", ARCSEC),
    info("inner_wobble_2_x_cos", "arcsec", ARCSEC),
    info("inner_wobble_2_x_sin", "arcsec", ARCSEC),
    info("inner_wobble_2_y_cos", "arcsec", ARCSEC),
    info("inner_wobble_2_y_sin", "arcsec", ARCSEC),
    info("base_roll_drift", "arcsec/h", ARCSEC / HOUR_S),
    info("base_pitch_drift", "arcsec/h", ARCSEC / HOUR_S),
    info("site_latitude", "deg", DEG),
    info("site_gravity", "mGal", MGAL),
    info("accel_cross_quadratic_x_yz", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_x_zx", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_x_xy", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_y_yz", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_y_zx", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_y_xy", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_z_yz", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_z_zx", "ug/g^2", MICRO_G),
    info("accel_cross_quadratic_z_xy", "ug/g^2", MICRO_G),
    info("gyro_g_sensitivity_x_x", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_x_y", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_x_z", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_y_x", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_y_y", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_y_z", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_z_x", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_z_y", "deg/h/g", DEG_H),
    info("gyro_g_sensitivity_z_z", "deg/h/g", DEG_H),
];

/// Effects, and the size of the hardware that each has.
static SIZE_KEYS: [(Range<usize>, &str); 18] = [
    (effect::ACCEL_QUADRATIC, "accel_quadratic_ug_g2"),
    (effect::ACCEL_ASYMMETRY, "accel_asymmetry_ppm"),
    (effect::GYRO_ASYMMETRY, "gyro_asymmetry_ppm"),
    (effect::GYRO_RATE_SCALE, "gyro_rate_scale_ppm"),
    (effect::ACCEL_WARM_UP, "accel_warm_up_ug"),
    (effect::GYRO_WARM_UP, "gyro_warm_up_deg_h"),
    (effect::ACCEL_SCALE_WARM_UP.start..effect::GYRO_SCALE_WARM_UP.end, "scale_warm_up_ppm"),
    (geometry(0, 4), "encoder_harmonic_1_arcsec"),
    (geometry(4, 4), "encoder_harmonic_2_arcsec"),
    (geometry(8, 4), "encoder_harmonic_3_arcsec"),
    (geometry(12, 4), "encoder_harmonic_4_arcsec"),
    (geometry(16, 2), "backlash_arcsec"),
    (geometry(18, 8), "wobble_1_arcsec"),
    (geometry(26, 2), "sag_arcsec"),
    (geometry(28, 8), "wobble_2_arcsec"),
    (effect::BASE_DRIFT, "base_drift_arcsec_h"),
    (effect::ACCEL_CROSS_QUADRATIC, "accel_cross_quadratic_ug_g2"),
    (effect::G_SENSITIVITY, "gyro_g_sensitivity_deg_h_g"),
];

/// Largest number of effects of one kind.
pub const LARGEST_KIND: usize = 12;

/// Number of kinds of effects that have a state: one for each size of the hardware, and one for all motions of the axes.
pub const KINDS: usize = 17;

/// The kind behind the others: the flicker of the accelerometers.
pub const FLICKER_KIND: u8 = KINDS as u8;

/// The effects of a kind, counted from 0, by their indices. Those of one kind share a size, or resemble each other.
pub fn kind(number: usize) -> impl Iterator<Item = u8> {
    let [first, second] = match SIZE_KEYS.get(number) {
        Some((effects, _)) if number + 1 < KINDS => [effects.clone(), 0..0],
        _ if number < KINDS => [geometry(0, 2), geometry(18, 10)],
        _ => [0..0, 0..0],
    };
    first.chain(second).map(|effect| effect as u8)
}

/// The sizes of the hardware of a kind, as keys of the unit description.
pub fn kind_keys(number: u8) -> &'static str {
    match SIZE_KEYS.get(usize::from(number)) {
        Some((_, key)) if usize::from(number) + 1 < KINDS => key,
        _ if number < FLICKER_KIND => "wobble_1_arcsec and sag_arcsec",
        _ => "accel_floor_ug",
    }
}

/// The size of the hardware of a kind; `None` for all motions of the axes.
pub fn size_of_kind(number: u8) -> Option<&'static HardwareSize> {
    HardwareSize::named(kind_keys(number))
}

/// The size of the hardware to which an effect belongs; `None` for an error of the configured site.
pub fn size_of(effect: usize) -> Option<&'static HardwareSize> {
    let (_, key) = SIZE_KEYS.iter().find(|(effects, _)| effects.contains(&effect))?;
    HardwareSize::named(key)
}

/// Whether a unit that works can have an effect of this value, SI. A larger value has another cause.
pub fn is_possible(effect: usize, value: f64) -> bool {
    let largest = match size_of(effect) {
        Some(size) => size.largest * size.unit_si,
        None => f64::INFINITY,
    };
    value.abs() <= largest
}

/// Whether an effect is a motion of the axes: wobble or sag.
pub fn is_of_axes(effect: usize) -> bool {
    let first_of_axes = effect::GEOMETRY.start + BACKLASH + 2;
    (first_of_axes..effect::GEOMETRY.end).contains(&effect)
}

/// Whether an effect is an error of the configured site.
pub fn is_of_site(effect: usize) -> bool {
    effect == effect::LATITUDE || effect == effect::GRAVITY
}

/// When a segment was, and from which side the axes came.
#[derive(Clone, Copy, Debug)]
pub struct Situation<T> {
    /// Time from the start of the run to the start of the segment, s.
    pub from_s: T,
    /// Duration of the segment, s.
    pub duration_s: T,
    /// Time from the start of the run to the time to which biases and attitude refer, s.
    pub reference_s: T,
    /// Sense in which the outer and the inner axis last turned, -1, 0 or 1: before the segment, and at its end.
    pub arrivals: [[T; 2]; 2],
    /// Latitude about which the measurement is linearized, rad.
    pub latitude_rad: f64,
    /// Derivative of gravity by the latitude, m/s^2/rad; 0 if gravity was measured.
    pub gravity_by_latitude: f64,
}

impl<T: Real> Situation<T> {
    /// Time from the reference time to the middle of the segment, s.
    fn since_reference_s(&self) -> T {
        self.from_s + self.duration_s * real(0.5) - self.reference_s
    }

    /// Mean of the warm-up over the segment, minus its value at the reference time. At the start of the run the warm-up
    /// is 1.
    fn warm_up(&self, tau_s: f64) -> T {
        let tau: T = real(tau_s);
        let at = |time_s: T| (-time_s / tau).exp();
        let mean = (at(self.from_s) - at(self.from_s + self.duration_s)) * tau / self.duration_s;
        mean - at(self.reference_s)
    }
}

/// Derivative of a measurement by the effects that have a state, (3 x 67).
pub type EffectColumns<T> = Matrix<T, 3, EFFECT_STATES>;

/// Sets the block of three columns from `first` on to a diagonal matrix.
fn set_diagonal<T: Real>(columns: &mut EffectColumns<T>, first: usize, diagonal: [T; 3]) {
    for (axis, value) in diagonal.into_iter().enumerate() {
        if let Some(entry) = columns.get_mut((axis, first + axis)) {
            *entry = value;
        }
    }
}

/// Derivatives that force and rotation have in common. `backlash` has the derivatives by the backlash of both axes.
fn common<T: Real>(prediction: &Prediction<T>, since_reference_s: T, backlash: [Vector3<T>; 2]) -> EffectColumns<T> {
    let mut columns = EffectColumns::<T>::zeros();
    let tilt = prediction.by_parameters.fixed_columns::<2>(block::ATTITUDE) * since_reference_s;
    columns.fixed_columns_mut::<2>(effect::BASE_DRIFT.start).copy_from(&tilt);
    columns.fixed_columns_mut::<GEOMETRY>(effect::GEOMETRY.start).copy_from(&prediction.by_geometry);
    let [outer, inner] = backlash;
    columns.set_column(effect::GEOMETRY.start + BACKLASH, &outer);
    columns.set_column(effect::GEOMETRY.start + BACKLASH + 1, &inner);
    columns
}

/// Derivative of the mean specific force at a stop by the effects.
#[inline(never)]
pub fn force_columns<T: Real>(prediction: &Prediction<T>, now: &Situation<T>) -> EffectColumns<T> {
    let [_, [outer, inner]] = now.arrivals;
    let [_, _, by_outer, by_inner] = *columns_of(&prediction.by_encoder_errors);
    let backlash = [Vector3::from(by_outer) * outer, Vector3::from(by_inner) * inner];
    let mut columns = common(prediction, now.since_reference_s(), backlash);
    let in_g: [T; 3] = prediction.in_g.into();
    let force: [T; 3] = prediction.value.into();
    set_diagonal(&mut columns, effect::ACCEL_QUADRATIC.start, in_g.map(|f| f * f));
    set_diagonal(&mut columns, effect::ACCEL_ASYMMETRY.start, force.map(|f| f.abs()));
    let [fast, slow] = WARM_UP_S.map(|tau_s| now.warm_up(tau_s));
    set_diagonal(&mut columns, effect::ACCEL_WARM_UP.start, [fast; 3]);
    set_diagonal(&mut columns, effect::ACCEL_WARM_UP.start + 3, [slow; 3]);
    let scale = now.warm_up(OTHER_WARM_UP_S);
    set_diagonal(&mut columns, effect::ACCEL_SCALE_WARM_UP.start, force.map(|f| f * scale));
    columns.set_column(effect::LATITUDE, &(prediction.in_g * real::<T>(now.gravity_by_latitude)));
    columns.set_column(effect::GRAVITY, &prediction.in_g);
    columns
}

/// Derivative of the rotation over a segment by the effects.
#[inline(never)]
pub fn rotation_columns<T: Real>(
    prediction: &Prediction<T>,
    segment: &Segment<T>,
    now: &Situation<T>,
) -> EffectColumns<T> {
    let [[outer_before, inner_before], [outer, inner]] = now.arrivals;
    // The teeth change sides at the start of a move. From there on the inner encoder has the error of the new side, which
    // acts across while the outer axis turns.
    let [_, across_before, _, across_after] = columns_of(&prediction.by_encoder_errors).map(Vector3::from);
    let along = |axis: usize| prediction.by_geometry.column(BACKLASH + axis);
    let of_outer = along(0) * (outer_before - outer);
    let of_inner = along(1) * (inner_before - inner) + (across_before + across_after) * inner;
    let mut columns = common(prediction, now.since_reference_s(), [of_outer, of_inner]);
    // The gyros feel the rate at which the base tilts.
    let mut drift = columns.fixed_columns_mut::<2>(effect::BASE_DRIFT.start);
    drift += prediction.by_attitude_rate.fixed_columns::<2>(0);
    if let Some(path) = segment.gyro_path() {
        let single = |sum: f32| real::<T>(sum.into());
        set_diagonal(&mut columns, effect::GYRO_ASYMMETRY.start, path.absolute_rad.map(single));
        let by_rate = path.squared_rad2_s.map(|sum| real::<T>(f64::from(sum) / REFERENCE_RATE_RAD_S));
        set_diagonal(&mut columns, effect::GYRO_RATE_SCALE.start, by_rate);
    }
    let warm_up = now.warm_up(OTHER_WARM_UP_S);
    set_diagonal(&mut columns, effect::GYRO_WARM_UP.start, [warm_up * now.duration_s; 3]);
    let rotation: [T; 3] = prediction.value.into();
    set_diagonal(&mut columns, effect::GYRO_SCALE_WARM_UP.start, rotation.map(|angle| angle * warm_up));
    let (sin, cos) = ComplexField::sin_cos(now.latitude_rad);
    let by_latitude = [-EARTH_RATE_RAD_S * sin, EARTH_RATE_RAD_S * cos].map(real::<T>);
    let [north, up] = columns_of(&prediction.by_earth_rate).map(Vector3::from);
    columns.set_column(effect::LATITUDE, &(north * by_latitude[0] + up * by_latitude[1]));
    columns
}

/// Derivative of one channel by an effect that has no state, if it has one. `in_g` is the specific force in g; for a
/// gyro, its integral over the segment, s.
pub fn by_noise_effect(effect: usize, channel: u8, in_g: &[f64; 3]) -> f64 {
    let [x, y, z] = *in_g;
    let of = |block: &Range<usize>, sensor: u8, factors: [f64; 3]| {
        let place = effect.checked_sub(block.start + 3 * usize::from(sensor));
        place.and_then(|place| factors.get(place)).copied().unwrap_or(0.0)
    };
    if effect::ACCEL_CROSS_QUADRATIC.contains(&effect) && channel < 3 {
        of(&effect::ACCEL_CROSS_QUADRATIC, channel, [y * z, z * x, x * y])
    } else if effect::G_SENSITIVITY.contains(&effect) && channel >= 3 {
        of(&effect::G_SENSITIVITY, channel - 3, *in_g)
    } else {
        0.0
    }
}

/// Part of the variance of a process with the correlation time `tau_s` that its mean over `duration_s` has.
fn mean_part(tau_s: f64, duration_s: f64) -> f64 {
    let x = duration_s / tau_s;
    if x < 1e-3 { 1.0 } else { 2.0 / x * (1.0 - (1.0 - ComplexField::exp(-x)) / x) }
}

/// Variance of each part of the flicker of the accelerometers.
fn flicker_variance(hardware: &Hardware) -> f64 {
    FLICKER_DENSITY * FLICKER_SPACING * f64::from(hardware.accel_floor) * f64::from(hardware.accel_floor)
}

/// Standard deviations of the flicker states, SI.
pub fn flicker_sigmas(hardware: &Hardware) -> [f64; FLICKER_STATES] {
    [ComplexField::sqrt(flicker_variance(hardware)); FLICKER_STATES]
}

/// Derivative of the mean force at a stop of this duration by the medium and by the slow flicker of its accelerometer.
pub fn by_flicker(duration_s: f64) -> [f64; 2] {
    let [_, medium, slow] = FLICKER_S;
    [medium, slow].map(|tau_s| ComplexField::sqrt(mean_part(tau_s, duration_s)))
}

/// Factors by which the medium and the slow flicker decay over a time, s. They are at least 1e-6.
pub fn flicker_decay(time_s: f64) -> [f64; 2] {
    let [_, medium, slow] = FLICKER_S;
    [medium, slow].map(|tau_s| ComplexField::exp(-time_s / tau_s).max(LEAST_DECAY))
}

/// Growth of the variance of an accelerometer bias and of a gyro bias, per second.
pub fn walk_variances(hardware: &Hardware) -> [f64; 2] {
    let square = |x: f64| x * x;
    let gyro_flicker = GYRO_FLICKER_WALK * f64::from(hardware.gyro_floor);
    [square(hardware.accel_walk.into()), square(hardware.gyro_walk.into()) + square(gyro_flicker)]
}

/// Increments of the pulse outputs per channel, m/s and rad: the larger of what is configured and what was seen.
pub fn pulses(hardware: &Hardware, seen: &[f32; 6]) -> [f64; 6] {
    let mut pulses = [hardware.accel_pulse, hardware.accel_pulse, hardware.accel_pulse, 0.0, 0.0, 0.0];
    pulses.iter_mut().skip(3).for_each(|pulse| *pulse = hardware.gyro_pulse);
    let mut larger = [0.0; 6];
    for (larger, (configured, seen)) in larger.iter_mut().zip(pulses.iter().zip(seen)) {
        *larger = f64::from(configured.max(*seen));
    }
    larger
}

/// Variance of the mean force at a stop beyond white noise, for each accelerometer, (m/s^2)^2. `in_g` is the force in
/// g.
pub fn force_noise(hardware: &Hardware, in_g: &[f64; 3], duration_s: f64, pulses: &[f64; 3], gravity: f64) -> [f64; 3] {
    let [x, y, z] = in_g.map(|f| f * f);
    let square = |size: f32| f64::from(size) * f64::from(size);
    let products = x * y + y * z + z * x;
    let tilt = square(hardware.base_rocking) / (1.0 + duration_s);
    let [fast, ..] = FLICKER_S;
    let common = square(hardware.accel_cross_quadratic) * products
        + flicker_variance(hardware) * mean_part(fast, duration_s)
        + tilt * gravity * gravity;
    pulses.map(|pulse| common + pulse * pulse / (6.0 * duration_s * duration_s))
}

/// Variance of the rotation over a segment beyond white noise, for each gyro, rad^2.
pub fn rotation_noise(hardware: &Hardware, duration_s: f64) -> f64 {
    let sigma = f64::from(hardware.gyro_g_sensitivity) * duration_s;
    sigma * sigma
}

/// Variance of the error of each gyro's angle at the end of a segment: rocking of the base, and what does not fill a
/// pulse, rad^2.
pub fn gyro_end_variances(hardware: &Hardware, pulses: &[f64; 3]) -> [f64; 3] {
    // A base rocks about its two horizontal axes, which the three gyros share.
    let rocking = 2.0 / 3.0 * f64::from(hardware.base_rocking) * f64::from(hardware.base_rocking);
    pulses.map(|pulse| rocking + pulse * pulse / 12.0)
}

/// Variance of the error of an encoder at a stop beyond its repeatability, rad^2.
pub fn encoder_noise(hardware: &Hardware) -> f64 {
    f64::from(hardware.encoder_subdivision) * f64::from(hardware.encoder_subdivision)
}

const _: () = assert!(effect::GEOMETRY.end - effect::GEOMETRY.start == GEOMETRY);
const _: () = assert!(effect::GRAVITY + 1 == EFFECT_STATES && effect::G_SENSITIVITY.end == EFFECTS);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::angle::{Angle, rad_to_ticks};
    use crate::base::linear::{Vector, exp_so3};
    use crate::base::site::{Site, gravity_by_latitude};
    use crate::model::error_model::{InstrumentErrors, PARAMETERS};
    use crate::model::measurement::MeasurementModel;
    use crate::model::measurement::example::{errors, segments_along, smooth};
    use crate::segment::{AngleIntegrals, Course, GyroPath};

    const REFERENCE_S: f64 = 20.0;
    const STEPS: u32 = 40_000;

    /// The outer axis starts first, and the inner axis reverses its sense of arrival.
    fn path(time_s: f64) -> (f64, f64) {
        (-1.2 * smooth((time_s - 2.0) / 3.0), 0.9 * smooth((time_s - 2.0) / 4.0))
    }

    fn situation(segment: &Segment<f64>) -> Situation<f64> {
        Situation {
            from_s: segment.start_us as f64 * 1e-6,
            duration_s: segment.duration_s(),
            reference_s: REFERENCE_S,
            arrivals: [[1.0, -1.0], [-1.0, 1.0]],
            latitude_rad: Site::default().latitude_rad,
            gravity_by_latitude: gravity_by_latitude(Site::default().latitude_rad),
        }
    }

    /// What one effect adds to the gyros: `angles` to the readings of both encoders at a time, `outputs` to the outputs
    /// for a true rate, `base` to the rates of the base, and `site` to the site.
    struct Gyros<'a> {
        path: &'a dyn Fn(f64) -> (f64, f64),
        outputs: &'a dyn Fn(f64, Vector3<f64>) -> Vector3<f64>,
        tilt_rate_b: Vector3<f64>,
        site: Site,
    }

    /// Integral of the outputs of the gyros over a move, in small steps.
    fn integrated(turn: &Segment<f64>, gyros: &Gyros<'_>) -> Vector3<f64> {
        let errors = errors();
        let (start_s, step_s) = (turn.start_us as f64 * 1e-6, turn.duration_s() / f64::from(STEPS));
        let axis_r = errors.rot_inner_axis() * Vector3::z();
        let earth_b = errors.rot_nb().transpose() * Vector3::from(gyros.site.earth_rate_n());
        let mut sum = Vector3::zeros();
        for step in 0..STEPS {
            let time_s = start_s + f64::from(step) * step_s;
            let (from, to) = ((gyros.path)(time_s), (gyros.path)(time_s + step_s));
            let rot_inner = exp_so3(&(axis_r * (-0.5 * (from.1 + to.1))));
            let rot_rr0 = rot_inner * exp_so3(&(Vector3::x() * (-0.5 * (from.0 + to.0))));
            // In a frame that has turned by phi, v becomes v + v x phi.
            let tilt_b = gyros.tilt_rate_b * (time_s + 0.5 * step_s - REFERENCE_S);
            let base_b = earth_b + earth_b.cross(&tilt_b) + gyros.tilt_rate_b;
            let turned = rot_inner * Vector3::x() * (to.0 - from.0) + axis_r * (to.1 - from.1);
            let rate_r = turned / step_s + rot_rr0 * base_b;
            let rate_g = errors.corrupt(&Vector3::zeros(), &(errors.rot_sr() * rate_r)).1;
            sum += (rate_g + (gyros.outputs)(time_s + 0.5 * step_s, rate_g)) * step_s;
        }
        sum
    }

    #[test]
    fn columns_of_the_gyros_match_differences() {
        let [_, turn, _] = segments_along(path, 1000);
        let now = situation(&turn);
        let gyro_path = core::cell::Cell::new(GyroPath::ZERO);
        let note = |_: f64, rate_g: Vector3<f64>| {
            let mut path = gyro_path.get();
            let step_s = turn.duration_s() / f64::from(STEPS);
            path.add((rate_g * step_s).map(|turned| turned as f32).into(), step_s as f32);
            gyro_path.set(path);
            Vector3::zeros()
        };
        let plain = Gyros { path: &path, outputs: &note, tilt_rate_b: Vector3::zeros(), site: Site::default() };
        let exact = integrated(&turn, &plain);
        let none = |_: f64, _: Vector3<f64>| Vector3::zeros();
        let plain = Gyros { outputs: &none, ..plain };
        // The samples of the example have no rates.
        let course = Course::Move(AngleIntegrals { gyro_path: gyro_path.get(), ..turn.integrals() });
        let turn = Segment { course, ..turn };
        let model = MeasurementModel::new(&errors(), &Site::default());
        let found = rotation_columns(&model.rotation(&turn), &turn, &now);
        let bias = errors().to_vector().fixed_rows::<3>(block::GYRO_BIAS).into_owned();
        let left = |time_s: f64| (-time_s / OTHER_WARM_UP_S).exp() - (-REFERENCE_S / OTHER_WARM_UP_S).exp();
        let differs = |effect: usize, with: Vector3<f64>, size: f64, within: f64| {
            let difference = (with - exact) / size;
            let column = found.column(effect);
            let scale = difference.norm().max(1e-3);
            assert!(
                (difference - column).norm() < within * scale,
                "{}: {column} for {difference}",
                EFFECT_INFO[effect].name
            );
        };
        let only = |axis: usize, value: f64| Vector3::from_fn(|row, _| if row == axis { value } else { 0.0 });
        for axis in 0..3 {
            let with =
                |outputs: &dyn Fn(f64, Vector3<f64>) -> Vector3<f64>| integrated(&turn, &Gyros { outputs, ..plain });
            // The path of a gyro is summed in single precision.
            let asymmetry = with(&|_, rate| only(axis, 1e-6 * rate[axis].abs()));
            differs(effect::GYRO_ASYMMETRY.start + axis, asymmetry, 1e-6, 1e-3);
            let of_rate = with(&|_, rate| only(axis, 1e-6 * rate[axis] * rate[axis].abs() / REFERENCE_RATE_RAD_S));
            differs(effect::GYRO_RATE_SCALE.start + axis, of_rate, 1e-6, 1e-3);
            let warm_up = with(&|time_s, _| only(axis, 1e-6 * left(time_s)));
            differs(effect::GYRO_WARM_UP.start + axis, warm_up, 1e-6, 1e-6);
            // The mean of the warm-up over the move is taken. It changes by a quarter over this move, so close to the
            // reference, and the axes do not turn evenly.
            let scale = with(&|time_s, rate| only(axis, 1e-6 * left(time_s) * (rate[axis] - bias[axis])));
            differs(effect::GYRO_SCALE_WARM_UP.start + axis, scale, 1e-6, 0.05);
        }
        for axis in 0..2 {
            // The true angle is the reading minus the error, which changes sides when the axis begins to turn.
            let side = |time_s: f64| now.arrivals[usize::from(time_s > 2.0)][axis] * 1e-5;
            let with_play = |time_s: f64| {
                let (outer, inner) = path(time_s);
                if axis == 0 { (outer - side(time_s), inner) } else { (outer, inner - side(time_s)) }
            };
            let played = integrated(&turn, &Gyros { path: &with_play, ..plain });
            differs(effect::GEOMETRY.start + BACKLASH + axis, played, 1e-5, 5e-3);
            // The base turns about its x for roll, and about the horizontal axis that pitch is about.
            let (sin_roll, cos_roll) = errors().to_vector()[block::ATTITUDE].sin_cos();
            let about = [Vector3::x(), Vector3::new(0.0, cos_roll, -sin_roll)][axis];
            let tilted = integrated(&turn, &Gyros { tilt_rate_b: about * 1e-7, ..plain });
            differs(effect::BASE_DRIFT.start + axis, tilted, 1e-7, 1e-3);
        }
        let site = Site { latitude_rad: Site::default().latitude_rad + 1e-5, ..Site::default() };
        differs(effect::LATITUDE, integrated(&turn, &Gyros { site, ..plain }), 1e-5, 1e-3);
    }

    #[test]
    fn every_effect_but_the_errors_of_the_site_has_a_size() {
        for (effect, info) in EFFECT_INFO.iter().enumerate() {
            assert_eq!(size_of(effect).is_none(), is_of_site(effect), "{}", info.name);
        }
    }

    #[test]
    fn columns_of_the_accelerometers_match_differences() {
        let [.., stop] = segments_along(path, 1000);
        let now = situation(&stop);
        let predict =
            |errors: &InstrumentErrors<f64>, site: &Site| MeasurementModel::new(errors, site).force_at_stop(&stop);
        let (errors, site) = (errors(), Site::default());
        let unit = errors;
        let prediction = predict(&errors, &site);
        let found = force_columns(&prediction, &now);
        let force = prediction.value;
        let bias = errors.to_vector().fixed_rows::<3>(block::ACCEL_BIAS).into_owned();
        let gravity = site.gravity_m_s2();
        for axis in 0..3 {
            let of = |block: &Range<usize>| found[(axis, block.start + axis)];
            // A quadratic of 1 m/s^2/g^2 and an asymmetry of 1, to a percent: bias and scale are small.
            let in_g = (force[axis] - bias[axis]) / 9.806_65;
            assert!((of(&effect::ACCEL_QUADRATIC) - in_g * in_g).abs() < 0.02);
            assert!((of(&effect::ACCEL_ASYMMETRY) - (in_g * 9.806_65).abs()).abs() < 0.02 * gravity);
            let mean = |tau_s: f64| {
                let part = |step: u32| now.from_s + now.duration_s * (f64::from(step) + 0.5) / 1000.0;
                (0..1000).map(|step| (-part(step) / tau_s).exp() - (-REFERENCE_S / tau_s).exp()).sum::<f64>() / 1000.0
            };
            assert!((of(&effect::ACCEL_WARM_UP) - mean(WARM_UP_S[0])).abs() < 1e-6);
            assert!((found[(axis, effect::ACCEL_WARM_UP.start + 3 + axis)] - mean(WARM_UP_S[1])).abs() < 1e-6);
            let scale = (force[axis] - bias[axis]) * mean(OTHER_WARM_UP_S);
            assert!((of(&effect::ACCEL_SCALE_WARM_UP) - scale).abs() < 0.01 * gravity * mean(OTHER_WARM_UP_S).abs());
        }
        let differs = |effect: usize, with: Vector3<f64>, size: f64| {
            let difference = (with - force) / size;
            assert!((difference - found.column(effect)).norm() < 1e-3 * gravity, "{}", EFFECT_INFO[effect].name);
        };
        let since_s = now.since_reference_s();
        for axis in 0..2 {
            let tilted =
                Vector::<f64, PARAMETERS>::from_fn(
                    |row, _| if row == block::ATTITUDE + axis { 1e-6 * since_s } else { 0.0 },
                );
            let errors = InstrumentErrors::from_vector(&(errors.to_vector() + tilted));
            differs(effect::BASE_DRIFT.start + axis, predict(&errors, &site).value, 1e-6);
            // With the reading too large by the error, the true angle is smaller.
            let ticks = rad_to_ticks(1e-5 * now.arrivals[1][axis]) as i32;
            let back = |angle: Angle, moves: bool| if moves { angle.turned(-ticks) } else { angle };
            let read = Segment { outer: back(stop.outer, axis == 0), inner: back(stop.inner, axis == 1), ..stop };
            let played = MeasurementModel::new(&unit, &site).force_at_stop(&read).value;
            differs(effect::GEOMETRY.start + BACKLASH + axis, played, 1e-5);
        }
        let north = Site { latitude_rad: site.latitude_rad + 1e-4, ..site };
        differs(effect::LATITUDE, predict(&errors, &north).value, 1e-4);
        let heavy = Site { measured_gravity_m_s2: Some(gravity + 1e-3), ..site };
        differs(effect::GRAVITY, predict(&errors, &heavy).value, 1e-3);
    }
}
