//! Imperfections of a unit's hardware, with the physical form of each, not the filter's.
//!
//! ```text
//! accelerometer  f + K f^2 + ka' |f| + sum of Kjk fj fk                     f along the sensors' axes
//! gyro           w + kg' |w| + kg'' w |w| / (20 deg/s) + G f
//! warm-up        amplitude exp(-t / tau)  on biases and scale factors, t from power-up
//! flicker        1/f: random processes of one octave after the other, from 0.05 s to 7 hours
//! base           tilts with the outer angle under unbalance, and rocks
//! axes           lean with their angle (wobble); the inner axis sags with the outer angle
//! encoders       harmonics of the angle, 4096 periods a turn, and the sense of arrival
//! outputs        whole pulses of angle and velocity
//! ```

use super::vec3::{Vec3, add, add_scaled, scale};
use rand_distr::{Distribution, StandardNormal, Uniform};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rins_selfcal::base::hardware::{Hardware, HardwareSize, REFERENCE_RATE_RAD_S};
use rins_selfcal::base::site::{GRAVITY_SIGMA_MGAL, HEIGHT_SIGMA_M, LATITUDE_SIGMA_DEG, Site};
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G, PPM, STANDARD_GRAVITY_M_S2};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2, TAU};

/// Cosine and sine of a function of an angle, arcsec: `c (cos - 1) + s sin`, which is zero at angle zero.
pub type Wave = [f64; 2];

/// Warm-up after power-up: amplitudes at power-up, which decay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmUp {
    /// Time constant, s.
    pub time_constant_s: f64,
    /// Amplitude of the accelerometer biases, ug.
    pub accel_ug: Vec3,
    /// Amplitude of the gyro biases, deg/h.
    pub gyro_deg_h: Vec3,
    /// Amplitude of the accelerometer scale factors, ppm.
    pub accel_scale_ppm: Vec3,
    /// Amplitude of the gyro scale factors, ppm.
    pub gyro_scale_ppm: Vec3,
}

impl Default for WarmUp {
    fn default() -> Self {
        Self {
            time_constant_s: 300.0,
            accel_ug: [0.0; 3],
            gyro_deg_h: [0.0; 3],
            accel_scale_ppm: [0.0; 3],
            gyro_scale_ppm: [0.0; 3],
        }
    }
}

impl WarmUp {
    /// Part of the amplitudes that is left after this time.
    pub fn left(&self, time_s: f64) -> f64 {
        (-time_s / self.time_constant_s).exp()
    }
}

/// Imperfections of one unit. All of them are absent by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Imperfections {
    /// Accelerometer quadratic, ug/g^2.
    pub accel_quadratic_ug_g2: Vec3,
    /// Accelerometer scale asymmetry, ppm.
    pub accel_asymmetry_ppm: Vec3,
    /// Accelerometer cross-quadratic of each accelerometer for the products yz, zx and xy, ug/g^2.
    pub accel_cross_quadratic_ug_g2: [Vec3; 3],
    /// Allan floor of the accelerometers, ug.
    pub accel_floor_ug: f64,
    /// Allan floor of the gyros, deg/h.
    pub gyro_floor_deg_h: f64,
    /// Gyro scale asymmetry, ppm.
    pub gyro_asymmetry_ppm: Vec3,
    /// Gyro scale against rate, ppm at 20 deg/s.
    pub gyro_rate_scale_ppm: Vec3,
    /// Gyro g-sensitivity: rows are gyros, deg/h/g.
    pub gyro_g_sensitivity_deg_h_g: [Vec3; 3],
    /// Warm-up.
    pub warm_up: WarmUp,
    /// Harmonics 1 to 4 of the outer and the inner encoder, arcsec.
    pub encoder_harmonics_arcsec: [[Wave; 4]; 2],
    /// Amplitude of the sub-division error of both encoders, arcsec.
    pub encoder_subdivision_arcsec: [f64; 2],
    /// Its phase at angle zero, rad.
    pub encoder_subdivision_phase_rad: [f64; 2],
    /// Half of the difference between the readings after arrival from either side, arcsec.
    pub backlash_arcsec: [f64; 2],
    /// Wobble of the outer axis, once and twice a turn, about y and z of the base, arcsec.
    pub outer_wobble_arcsec: [[Wave; 2]; 2],
    /// Wobble of the inner axis, once and twice a turn, about x and y of the outer gimbal, arcsec.
    pub inner_wobble_arcsec: [[Wave; 2]; 2],
    /// Sag of the inner axis about y of the outer gimbal, arcsec.
    pub sag_arcsec: Wave,
    /// Tilt of the base about x and y with the outer angle, arcsec.
    pub base_tilt_arcsec: [Wave; 2],
    /// Rocking of the base about x and y, root mean square, arcsec.
    pub base_rocking_arcsec: f64,
    /// Pulses of the gyros, arcsec; 0 for none.
    pub gyro_pulse_arcsec: f64,
    /// Pulses of the accelerometers, mm/s; 0 for none.
    pub accel_pulse_mm_s: f64,
    /// True latitude minus the configured latitude, deg.
    pub latitude_error_deg: f64,
    /// True height minus the configured height, m.
    pub height_error_m: f64,
    /// True gravity minus that of latitude and height, mGal.
    pub gravity_anomaly_mgal: f64,
}

impl Imperfections {
    /// Draws a unit whose imperfections have these sizes. The configured site is wrong by typical errors times
    /// `site_factor`.
    pub fn draw(hardware: &Hardware, site_factor: f64, seed: u64) -> Self {
        let mut draw = Draw(Xoshiro256PlusPlus::seed_from_u64(seed));
        let of = |size: f32, unit: f64| f64::from(size) / unit;
        let (arcsec, ug) = (|size| of(size, ARCSEC), |size| of(size, MICRO_G));
        let harmonics = hardware.encoder_harmonics.map(arcsec);
        let [wobble_1, wobble_2] = hardware.wobble.map(arcsec);
        let time_constant_s = 100.0 * 10_f64.powf(draw.uniform());
        Self {
            accel_quadratic_ug_g2: draw.many(ug(hardware.accel_quadratic)),
            accel_asymmetry_ppm: draw.many(of(hardware.accel_asymmetry, PPM)),
            accel_cross_quadratic_ug_g2: [(); 3].map(|()| draw.many(ug(hardware.accel_cross_quadratic))),
            accel_floor_ug: ug(hardware.accel_floor),
            gyro_floor_deg_h: of(hardware.gyro_floor, DEG_H),
            gyro_asymmetry_ppm: draw.many(of(hardware.gyro_asymmetry, PPM)),
            gyro_rate_scale_ppm: draw.many(of(hardware.gyro_rate_scale, PPM)),
            gyro_g_sensitivity_deg_h_g: [(); 3].map(|()| draw.many(of(hardware.gyro_g_sensitivity, DEG_H))),
            warm_up: WarmUp {
                time_constant_s,
                accel_ug: draw.many(ug(hardware.accel_warm_up)),
                gyro_deg_h: draw.many(of(hardware.gyro_warm_up, DEG_H)),
                accel_scale_ppm: draw.many(of(hardware.scale_warm_up, PPM)),
                gyro_scale_ppm: draw.many(of(hardware.scale_warm_up, PPM)),
            },
            encoder_harmonics_arcsec: [(); 2].map(|()| harmonics.map(|size| draw.many(size))),
            encoder_subdivision_arcsec: [arcsec(hardware.encoder_subdivision); 2],
            encoder_subdivision_phase_rad: [(); 2].map(|()| TAU * draw.uniform()),
            backlash_arcsec: draw.many(arcsec(hardware.backlash)),
            outer_wobble_arcsec: [wobble_1, wobble_2].map(|size| [(); 2].map(|()| draw.many(size))),
            inner_wobble_arcsec: [wobble_1, wobble_2].map(|size| [(); 2].map(|()| draw.many(size))),
            sag_arcsec: draw.many(arcsec(hardware.sag)),
            base_tilt_arcsec: [(); 2].map(|()| draw.many(arcsec(hardware.sag))),
            base_rocking_arcsec: arcsec(hardware.base_rocking),
            gyro_pulse_arcsec: arcsec(hardware.gyro_pulse),
            accel_pulse_mm_s: of(hardware.accel_pulse, 1e-3),
            latitude_error_deg: LATITUDE_SIGMA_DEG * site_factor * draw.normal(),
            height_error_m: HEIGHT_SIGMA_M * site_factor * draw.normal(),
            gravity_anomaly_mgal: GRAVITY_SIGMA_MGAL * site_factor * draw.normal(),
        }
    }

    /// Checks that every number is one that a unit can have. The bounds are those of the sizes of the hardware.
    ///
    /// # Errors
    /// The key and what is wrong with its value.
    pub(crate) fn check(&self) -> Result<(), (&'static str, String)> {
        let WarmUp { time_constant_s, accel_ug, gyro_deg_h, accel_scale_ppm, gyro_scale_ppm } = &self.warm_up;
        // A value may have either sign, a magnitude not.
        let of = |key: &str, lowest: f64| {
            let size = HardwareSize::named(key).expect("a key of the hardware");
            (lowest * size.largest, size.largest, size.unit)
        };
        let value = |key| of(key, -1.0);
        let magnitude = |key| of(key, 0.0);
        let arcsec = value("encoder_harmonic_1_arcsec");
        let (harmonics, outer) =
            (self.encoder_harmonics_arcsec.as_flattened(), self.outer_wobble_arcsec.as_flattened());
        let inner = self.inner_wobble_arcsec.as_flattened();
        type Bounds = (f64, f64, &'static str);
        let rows: [(&str, Bounds, &[f64]); 27] = [
            ("accel_quadratic_ug_g2", value("accel_quadratic_ug_g2"), &self.accel_quadratic_ug_g2),
            ("accel_asymmetry_ppm", value("accel_asymmetry_ppm"), &self.accel_asymmetry_ppm),
            (
                "accel_cross_quadratic_ug_g2",
                value("accel_cross_quadratic_ug_g2"),
                self.accel_cross_quadratic_ug_g2.as_flattened(),
            ),
            ("accel_floor_ug", magnitude("accel_floor_ug"), &[self.accel_floor_ug]),
            ("gyro_floor_deg_h", magnitude("gyro_floor_deg_h"), &[self.gyro_floor_deg_h]),
            ("gyro_asymmetry_ppm", value("gyro_asymmetry_ppm"), &self.gyro_asymmetry_ppm),
            ("gyro_rate_scale_ppm", value("gyro_rate_scale_ppm"), &self.gyro_rate_scale_ppm),
            (
                "gyro_g_sensitivity_deg_h_g",
                value("gyro_g_sensitivity_deg_h_g"),
                self.gyro_g_sensitivity_deg_h_g.as_flattened(),
            ),
            ("warm_up.time_constant_s", (1.0, 1e6, "s"), &[*time_constant_s]),
            ("warm_up.accel_ug", value("accel_warm_up_ug"), accel_ug),
            ("warm_up.gyro_deg_h", value("gyro_warm_up_deg_h"), gyro_deg_h),
            ("warm_up.accel_scale_ppm", value("scale_warm_up_ppm"), accel_scale_ppm),
            ("warm_up.gyro_scale_ppm", value("scale_warm_up_ppm"), gyro_scale_ppm),
            ("encoder_harmonics_arcsec", arcsec, harmonics.as_flattened()),
            ("encoder_subdivision_arcsec", value("encoder_subdivision_arcsec"), &self.encoder_subdivision_arcsec),
            ("encoder_subdivision_phase_rad", (-1e6, 1e6, "rad"), &self.encoder_subdivision_phase_rad),
            ("backlash_arcsec", value("backlash_arcsec"), &self.backlash_arcsec),
            ("outer_wobble_arcsec", value("wobble_1_arcsec"), outer.as_flattened()),
            ("inner_wobble_arcsec", value("wobble_1_arcsec"), inner.as_flattened()),
            ("sag_arcsec", value("sag_arcsec"), &self.sag_arcsec),
            ("base_tilt_arcsec", value("sag_arcsec"), self.base_tilt_arcsec.as_flattened()),
            ("base_rocking_arcsec", magnitude("base_rocking_arcsec"), &[self.base_rocking_arcsec]),
            ("gyro_pulse_arcsec", magnitude("gyro_pulse_arcsec"), &[self.gyro_pulse_arcsec]),
            ("accel_pulse_mm_s", magnitude("accel_pulse_mm_s"), &[self.accel_pulse_mm_s]),
            ("latitude_error_deg", (-180.0, 180.0, "deg"), &[self.latitude_error_deg]),
            ("height_error_m", (-1e5, 1e5, "m"), &[self.height_error_m]),
            ("gravity_anomaly_mgal", (-1e5, 1e5, "mGal"), &[self.gravity_anomaly_mgal]),
        ];
        let wrong = |(_, (low, high, _), values): &&(&str, Bounds, &[f64])| {
            !values.iter().all(|value| (*low..=*high).contains(value))
        };
        match rows.iter().find(wrong) {
            Some((key, (low, high, unit), _)) => Err((key, format!("must be from {low} to {high} {unit}"))),
            None => Ok(()),
        }
    }

    /// Whether encoders, axes or base act on the attitude.
    pub fn bends(&self) -> bool {
        let waves = self.outer_wobble_arcsec.iter().chain(&self.inner_wobble_arcsec).flatten();
        waves.chain([&self.sag_arcsec]).chain(&self.base_tilt_arcsec).flatten().any(|size| *size != 0.0)
    }

    /// Rotation vector of the base and of the outer axis at this outer angle, rad, and its derivative by the angle.
    pub fn base_bent(&self, outer_rad: f64) -> [Vec3; 2] {
        let [once, twice] = self.outer_wobble_arcsec;
        let [tilt_x, tilt_y] = self.base_tilt_arcsec.map(|wave| value_and_slope(wave, 1.0, outer_rad));
        let of = |axis: usize| {
            sum([value_and_slope(once[axis], 1.0, outer_rad), value_and_slope(twice[axis], 2.0, outer_rad)])
        };
        let ([x, y, z], [dx, dy, dz]) = components([tilt_x, sum([of(0), tilt_y]), of(1)]);
        [[x, y, z], [dx, dy, dz]]
    }

    /// Rotation vector of the inner axis against the outer gimbal, rad, and its derivatives by the outer and by the
    /// inner angle.
    pub fn gimbal_bent(&self, outer_rad: f64, inner_rad: f64) -> [Vec3; 3] {
        let [once, twice] = self.inner_wobble_arcsec;
        let of = |axis: usize| {
            sum([value_and_slope(once[axis], 1.0, inner_rad), value_and_slope(twice[axis], 2.0, inner_rad)])
        };
        let ([x, y], [sag, sag_slope]) = ([of(0), of(1)], value_and_slope(self.sag_arcsec, 1.0, outer_rad));
        [[x[0], y[0] + sag, 0.0], [0.0, sag_slope, 0.0], [x[1], y[1], 0.0]]
    }

    /// Whether the sensors are anything but linear, or their scale factors warm up.
    pub fn distorts(&self) -> bool {
        let rows = self.accel_cross_quadratic_ug_g2.iter().chain(&self.gyro_g_sensitivity_deg_h_g);
        let rows = rows.chain([
            &self.accel_quadratic_ug_g2,
            &self.accel_asymmetry_ppm,
            &self.gyro_asymmetry_ppm,
            &self.gyro_rate_scale_ppm,
            &self.warm_up.accel_ug,
            &self.warm_up.gyro_deg_h,
            &self.warm_up.accel_scale_ppm,
            &self.warm_up.gyro_scale_ppm,
        ]);
        rows.flatten().any(|size| *size != 0.0)
    }

    /// What the accelerometers and the gyros add to their linear outputs, m/s^2 and rad/s, at this time after power-up.
    /// The biases are not part of `force_a` and `omega_g`.
    pub fn distortion(&self, force_a: Vec3, omega_g: Vec3, time_s: f64) -> [Vec3; 2] {
        let left = self.warm_up.left(time_s);
        let in_g = scale(force_a, STANDARD_GRAVITY_M_S2.recip());
        let [x, y, z] = in_g;
        let products = [y * z, z * x, x * y];
        let dot = |a: &Vec3, b: &Vec3| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let force = std::array::from_fn(|axis| {
            let quadratic = self.accel_quadratic_ug_g2[axis] * in_g[axis] * in_g[axis];
            let cross = dot(&self.accel_cross_quadratic_ug_g2[axis], &products);
            let warm_up = self.warm_up.accel_ug[axis] * left;
            let scale_ppm = self.warm_up.accel_scale_ppm[axis] * left * force_a[axis]
                + self.accel_asymmetry_ppm[axis] * force_a[axis].abs();
            (quadratic + cross + warm_up) * MICRO_G + scale_ppm * PPM
        });
        let omega = std::array::from_fn(|axis| {
            let rate = omega_g[axis];
            let by_g = dot(&self.gyro_g_sensitivity_deg_h_g[axis], &in_g);
            let warm_up = self.warm_up.gyro_deg_h[axis] * left;
            let scale_ppm = self.warm_up.gyro_scale_ppm[axis] * left * rate
                + self.gyro_asymmetry_ppm[axis] * rate.abs()
                + self.gyro_rate_scale_ppm[axis] * rate * rate.abs() / REFERENCE_RATE_RAD_S;
            (by_g + warm_up) * DEG_H + scale_ppm * PPM
        });
        [force, omega]
    }

    /// Error of an encoder at a true angle, rad, that follows from the angle alone. It vanishes at the encoder's zero, which
    /// defines the rotation frame.
    pub fn encoder_rad(&self, axis: usize, angle_rad: f64) -> f64 {
        let waves = self.encoder_harmonics_arcsec[axis].iter().zip([1.0, 2.0, 3.0, 4.0]);
        let harmonics: f64 = waves.map(|(wave, n)| value_and_slope(*wave, n, angle_rad)[0]).sum();
        let phase_rad = self.encoder_subdivision_phase_rad[axis];
        let fine = ((4096.0 * angle_rad + phase_rad).sin() - phase_rad.sin()) * SQRT_2;
        harmonics + self.encoder_subdivision_arcsec[axis] * ARCSEC * fine
    }

    /// True latitude, rad, and gravity, m/s^2, at a configured site.
    pub fn true_site(&self, site: &Site) -> Site {
        let truth = Site {
            latitude_rad: site.latitude_rad + self.latitude_error_deg * DEG,
            height_m: site.height_m + self.height_error_m,
            measured_gravity_m_s2: None,
        };
        let gravity = site.measured_gravity_m_s2.unwrap_or_else(|| truth.gravity_m_s2());
        let anomaly = self.gravity_anomaly_mgal * 1e-5;
        let changed = site.measured_gravity_m_s2.is_some() || anomaly != 0.0;
        Site { measured_gravity_m_s2: changed.then_some(gravity + anomaly), ..truth }
    }
}

/// Value, rad, and slope of a wave of the n-fold angle.
fn value_and_slope([cos_part, sin_part]: Wave, n: f64, angle_rad: f64) -> [f64; 2] {
    let (sin, cos) = (n * angle_rad).sin_cos();
    [ARCSEC * (cos_part * (cos - 1.0) + sin_part * sin), n * ARCSEC * (sin_part * cos - cos_part * sin)]
}

fn sum([[a, da], [b, db]]: [[f64; 2]; 2]) -> [f64; 2] {
    [a + b, da + db]
}

fn components([x, y, z]: [[f64; 2]; 3]) -> (Vec3, Vec3) {
    ([x[0], y[0], z[0]], [x[1], y[1], z[1]])
}

/// Random numbers of one unit.
struct Draw(Xoshiro256PlusPlus);

impl Draw {
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    fn uniform(&mut self) -> f64 {
        Uniform::new(0.0, 1.0).expect("a range").sample(&mut self.0)
    }

    fn many<const N: usize>(&mut self, sigma: f64) -> [f64; N] {
        std::array::from_fn(|_| sigma * self.normal())
    }
}

/// Number of octaves of the flicker.
const OCTAVES: usize = 20;
/// Shortest time constant of the flicker, s.
const SHORTEST_S: f64 = 0.05;

/// Processes that are slower begin at zero: the bias is defined at power-up, s.
const TURN_ON_S: f64 = 500.0;

/// 1/f noise of six channels: for each octave a process with exponential correlation.
pub struct Flicker {
    rng: Xoshiro256PlusPlus,
    values: [[f64; OCTAVES]; 6],
    decays: [f64; OCTAVES],
    kicks: [[f64; OCTAVES]; 6],
}

impl Flicker {
    /// Flicker of these Allan floors: accelerometers, m/s^2, and gyros, rad/s; `None` if both are zero.
    pub fn new(imperfections: &Imperfections, interval_s: f64, seed: u64) -> Option<Self> {
        let floors = [imperfections.accel_floor_ug * MICRO_G, imperfections.gyro_floor_deg_h * DEG_H];
        if floors == [0.0; 2] {
            return None;
        }
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let decays: [f64; OCTAVES] =
            std::array::from_fn(|octave| (-interval_s / (SHORTEST_S * 2_f64.powi(octave as i32))).exp());
        // The power density h / f gives the Allan floor sqrt(2 ln 2 h). Each octave has the variance h ln 2.
        let sigmas = floors.map(|floor| floor * FRAC_1_SQRT_2);
        let of_channel = |channel: usize| sigmas[channel / 3];
        let values = std::array::from_fn(|channel| {
            std::array::from_fn(|octave| {
                let drawn: f64 = StandardNormal.sample(&mut rng);
                if SHORTEST_S * 2_f64.powi(octave as i32) < TURN_ON_S { of_channel(channel) * drawn } else { 0.0 }
            })
        });
        let kicks =
            std::array::from_fn(|channel| decays.map(|decay| of_channel(channel) * (1.0 - decay * decay).sqrt()));
        Some(Self { rng, values, decays, kicks })
    }

    /// The flicker of the next sample: accelerometers, then gyros.
    pub fn step(&mut self) -> [Vec3; 2] {
        let mut sums = [0.0; 6];
        for ((sum, values), kicks) in sums.iter_mut().zip(&mut self.values).zip(&self.kicks) {
            for ((value, decay), kick) in values.iter_mut().zip(&self.decays).zip(kicks) {
                let drawn: f64 = StandardNormal.sample(&mut self.rng);
                *value = *value * decay + kick * drawn;
                *sum += *value;
            }
        }
        let [a, b, c, d, e, f] = sums;
        [[a, b, c], [d, e, f]]
    }
}

/// Rocking of the base about x and y: the sum of waves from 0.1 to 5 Hz whose phases are random.
pub struct Rocking {
    waves: Vec<[f64; 4]>,
}

impl Rocking {
    const WAVES: usize = 24;

    /// Rocking of this root mean square; `None` if it is zero.
    pub fn new(imperfections: &Imperfections, seed: u64) -> Option<Self> {
        let rms_rad = imperfections.base_rocking_arcsec * ARCSEC;
        let mut draw = Draw(Xoshiro256PlusPlus::seed_from_u64(seed));
        let amplitude = rms_rad * (2.0 / Self::WAVES as f64).sqrt();
        let wave = |number: usize| {
            let part = (number as f64 + draw.uniform()) / Self::WAVES as f64;
            [TAU * 0.1 * 50_f64.powf(part), amplitude, TAU * draw.uniform(), TAU * draw.uniform()]
        };
        let waves = (0..Self::WAVES).map(wave).collect();
        (rms_rad > 0.0).then_some(Self { waves })
    }

    /// Rotation vector of the base, rad, and its mean rate over the interval of this length about this time, rad/s.
    pub fn at(&self, time_s: f64, interval_s: f64) -> [Vec3; 2] {
        let angle = |time_s: f64| {
            self.waves.iter().fold([0.0; 3], |sum, [omega, amplitude, x, y]| {
                let at = |phase: &f64| amplitude * (omega * time_s + phase).sin();
                add(sum, [at(x), at(y), 0.0])
            })
        };
        let [before, after] = [-0.5, 0.5].map(|part| angle(time_s + part * interval_s));
        [angle(time_s), scale(add_scaled(after, before, -1.0), interval_s.recip())]
    }
}

/// Outputs in whole pulses: what does not fill a pulse is left for the next sample.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pulses {
    rest: [f64; 6],
}

impl Pulses {
    /// Quantizes the outputs over an interval, s. `pulse` is in m/s and rad; 0 for none.
    pub fn quantized(&mut self, [force, omega]: [Vec3; 2], pulse: [f64; 2], interval_s: f64) -> [Vec3; 2] {
        let mut channel = 0;
        [(force, pulse[0]), (omega, pulse[1])].map(|(values, pulse)| {
            values.map(|value| {
                let rest = &mut self.rest[channel];
                channel += 1;
                if pulse == 0.0 {
                    return value;
                }
                let filled = *rest + value * interval_s;
                let whole = (filled / pulse).floor() * pulse;
                *rest = filled - whole;
                whole / interval_s
            })
        })
    }
}

/// The senses in which the axes last turned, and so the backlash of the encoders.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arrival {
    sense: [f64; 2],
    since_rad: [f64; 2],
}

impl Arrival {
    /// Turn beyond which the teeth touch on the other side, rad.
    const PLAY_RAD: f64 = 5.0 * ARCSEC;

    /// Follows the axes by their turns, rad.
    pub fn follow(&mut self, turned_rad: [f64; 2]) {
        for (axis, turned) in turned_rad.into_iter().enumerate() {
            let since = &mut self.since_rad[axis];
            *since = (*since + turned).clamp(-Self::PLAY_RAD, Self::PLAY_RAD);
            if since.abs() >= Self::PLAY_RAD {
                self.sense[axis] = since.signum();
            }
        }
    }

    /// The sense in which an axis last turned: -1, 0 or 1.
    pub fn sense(&self, axis: usize) -> f64 {
        self.sense[axis]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flicker_has_its_allan_floor() {
        // Allan variance of the mean over 2 s, from 400 pairs for each of 6 channels: 2400 squares, so 3 % of standard
        // error for independent pairs; the floor of a finite number of octaves differs by some percent.
        let imperfections = Imperfections { accel_floor_ug: 2.0, gyro_floor_deg_h: 0.002, ..Imperfections::default() };
        let interval_s = 0.05;
        let mut flicker = Flicker::new(&imperfections, interval_s, 3).expect("a floor");
        let mut mean = || {
            let mut sums = [[0.0; 3]; 2];
            for _ in 0..40 {
                let [force, omega] = flicker.step();
                sums = [add(sums[0], force), add(sums[1], omega)];
            }
            sums.map(|sum| scale(sum, 1.0 / 40.0))
        };
        let mut allan = [0.0; 2];
        for _ in 0..400 {
            let (first, second) = (mean(), mean());
            for (sum, (a, b)) in allan.iter_mut().zip(first.iter().zip(&second)) {
                *sum += a.iter().zip(b).map(|(a, b)| 0.5 * (a - b) * (a - b)).sum::<f64>();
            }
        }
        let [accel, gyro] = allan.map(|sum| (sum / 1200.0).sqrt());
        assert!((accel / (2.0 * MICRO_G) - 1.0).abs() < 0.12, "{}", accel / MICRO_G);
        assert!((gyro / (0.002 * DEG_H) - 1.0).abs() < 0.12, "{}", gyro / DEG_H);
    }

    #[test]
    fn pulses_lose_nothing() {
        let mut pulses = Pulses::default();
        let mut sum = 0.0;
        for _ in 0..1000 {
            let [force, _] = pulses.quantized([[0.123, 0.0, 0.0], [0.0; 3]], [0.02, 0.0], 0.005);
            assert!((force[0] * 0.005 / 0.02).fract().abs() < 1e-9);
            sum += force[0] * 0.005;
        }
        assert!((sum - 0.123 * 5.0).abs() < 0.02);
    }

    #[test]
    fn a_typical_unit_has_the_sizes_of_its_profile() {
        let of = |seed| Imperfections::draw(&Hardware::NAVIGATION, 1.0, seed);
        // 900 normal numbers: the sum of their squares has a standard error of 4.7 %. Five of them are allowed.
        let squares: f64 = (0..300).flat_map(|seed| of(seed).accel_quadratic_ug_g2).map(|k| (k / 6.0).powi(2)).sum();
        assert!((squares / 900.0 - 1.0).abs() < 0.24, "{squares}");
        assert!(!Imperfections::draw(&Hardware::IDEAL, 0.0, 7).bends());
        assert!(of(1).bends() && of(1).distorts() && !Imperfections::default().distorts());
    }
}
