//! Comparison of the virtual RINS with closed forms, statistics, the core's model, and the log of another simulator.
//!
//! Statistical bounds are five standard deviations of the statistic, which are derived in the test. Seeds are fixed.

use host_tests::files::truth::Truth;
use host_tests::files::unit_file::{Noise, UnitConfig};
use host_tests::log::{LogReader, LogRow};
use host_tests::virtual_unit::drive::{SchemeDrive, move_durations_s};
use host_tests::virtual_unit::imperfections::Imperfections;
use host_tests::virtual_unit::kinematics::{Motion, RigidTruth};
use host_tests::virtual_unit::plant::Reading;
use host_tests::virtual_unit::presets::{RandomErrors, real};
use host_tests::virtual_unit::unit::{Effects, VirtualUnit};
use host_tests::virtual_unit::vec3::{Vec3, add_scaled};
use host_tests::virtual_unit::virtual_rins::VirtualRins;
use rins_selfcal::base::angle::Angle;
use rins_selfcal::base::linear::Vector3;
use rins_selfcal::base::site::Site;
use rins_selfcal::base::units::{ARCSEC, DEG, DEG_H, MICRO_G};
use rins_selfcal::model::error_model::InstrumentErrors;
use rins_selfcal::scheme::Scheme;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::Path;

const SILENT: Noise = Noise::NONE;

fn silent_unit(errors: InstrumentErrors<f64>) -> VirtualUnit {
    VirtualUnit { errors, noise: SILENT, ..VirtualUnit::default() }
}

fn assert_close(value: Vec3, expected: Vec3, bound: f64) {
    let worst = value.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst <= bound, "{value:?} is off {expected:?} by {worst:e}, bound {bound:e}");
}

/// Turns one axis at a constant rate for a whole number of samples, without ramps; the sum of gyro readings times dt.
fn turned(rins: &mut VirtualRins, rates: [f64; 2], samples: u32) -> Vec3 {
    let mut sum = [0.0; 3];
    for sample in 1..=samples {
        // The first and the last interval are the ramps: together they turn as much as one interval at full rate.
        rins.command_rates(if sample < samples { rates } else { [0.0; 2] });
        sum = add_scaled(sum, rins.advance().omega_g, rins.interval_s());
    }
    sum
}

#[test]
fn an_hour_at_rest_has_the_mean_of_the_closed_form() {
    let (roll, pitch) = (0.03_f64, -0.02_f64);
    let errors = InstrumentErrors {
        accel_non_orthogonality: [1e-3, -2e-3, 3e-3],
        accel_bias_a: [3e-4, -2e-4, 1e-4],
        accel_scale: [1e-4, -2e-4, 3e-4],
        gyro_bias_g: [1e-7, -2e-7, 3e-7],
        base_roll: roll,
        base_pitch: pitch,
        heading: 90.0 * DEG,
        ..Default::default()
    };
    let unit = VirtualUnit { errors, ..VirtualUnit::default() };
    let mut rins = VirtualRins::new(&unit, 1);
    let samples = 3600 * 200;
    let mut mean = ([0.0; 3], [0.0; 3]);
    for reading in (0..samples).map(|_| rins.advance()) {
        mean.0 = add_scaled(mean.0, reading.force_a, 1.0 / f64::from(samples));
        mean.1 = add_scaled(mean.1, reading.omega_g, 1.0 / f64::from(samples));
    }
    let g = unit.site.gravity_m_s2();
    let [fx, fy, fz] = [-g * pitch.sin(), g * roll.sin() * pitch.cos(), g * roll.cos() * pitch.cos()];
    // Inverse of the triangular rot_sa by substitution. (1)
    let y = fy - 1e-3 * fx;
    let z = fz + 3e-3 * fx + 2e-3 * y;
    let force_a = [fx * (1.0 + 1e-4) + 3e-4, y * (1.0 - 2e-4) - 2e-4, z * (1.0 + 3e-4) + 1e-4];
    assert_close(mean.0, force_a, 5.0 * 10.0 * MICRO_G / 60.0);
    // y points east: x points south; then pitch about y, then roll about x.
    let [_, north, up] = unit.site.earth_rate_n();
    let [x, up] = [-north * pitch.cos() - up * pitch.sin(), up * pitch.cos() - north * pitch.sin()];
    let omega_g = [x + 1e-7, up * roll.sin() - 2e-7, up * roll.cos() + 3e-7];
    assert_close(mean.1, omega_g, 5.0 * 0.001 * DEG / 60.0 / 60.0);
}

#[test]
fn a_full_turn_sums_to_two_pi_about_its_axis() {
    let (gamma, d) = (2e-3_f64, 1e-3_f64);
    let mounted = InstrumentErrors { mounting: [0.0, 0.0, gamma], ..real(5) };
    let plain = InstrumentErrors { gyro_non_orthogonality: [0.0; 6], gyro_scale: [0.0; 3], ..mounted };
    let tilted = InstrumentErrors { mounting: [0.0; 3], axis_non_perpendicularity: d, ..plain };
    let outer_axis_s = [gamma.cos(), -gamma.sin(), 0.0];
    let inner_axis_s = [d.sin(), 0.0, d.cos()];
    for (errors, direction, axis_s) in [(plain, [1.0, 0.0], outer_axis_s), (tilted, [0.0, 1.0], inner_axis_s)] {
        // Full turns at 0.36 rad/s there and back: Earth rate and bias do the same both times and drop out. The ramps
        // at both ends are one interval long, so n samples turn as far as n - 1 intervals at full rate.
        let samples = 3601;
        let rate = TAU / (f64::from(samples - 1) * 0.005);
        let mut rins = VirtualRins::new(&silent_unit(errors), 1);
        let there = turned(&mut rins, direction.map(|sign: f64| sign * rate), samples);
        assert!((rins.true_angles_rad()[0] + rins.true_angles_rad()[1] - TAU).abs() < 1e-11);
        let back = turned(&mut rins, direction.map(|sign: f64| -sign * rate), samples);
        assert_close(add_scaled(there, back, -1.0), axis_s.map(|x| 2.0 * TAU * x), 1e-10);
    }
}

#[test]
fn noise_has_its_sigma_at_both_rates() {
    for rate_hz in [100.0, 200.0] {
        let unit = VirtualUnit { rate_hz, noise: Noise::tactical(), ..VirtualUnit::default() };
        let mut noisy = VirtualRins::new(&unit, 7);
        let mut silent = VirtualRins::new(&VirtualUnit { noise: SILENT, ..unit.clone() }, 7);
        let (sigma_f, sigma_w) = (60.0 * MICRO_G * rate_hz.sqrt(), 0.05 * DEG / 60.0 * rate_hz.sqrt());
        let mut chi_square = [0.0; 2];
        for _ in 0..20_000 {
            let (reading, mean) = (noisy.advance(), silent.advance());
            for axis in 0..3 {
                chi_square[0] += ((reading.force_a[axis] - mean.force_a[axis]) / sigma_f).powi(2);
                chi_square[1] += ((reading.omega_g[axis] - mean.omega_g[axis]) / sigma_w).powi(2);
            }
        }
        // 60 000 degrees of freedom: sigma sqrt(2 n) = 346.
        assert!(chi_square.iter().all(|sum| (sum - 60_000.0).abs() < 5.0 * 346.5), "{chi_square:?}");
    }
}

/// Encoder errors of every sample of a run, and whether the axes are at rest.
fn encoder_errors(noise: Noise, scheme: &Scheme) -> Vec<([f64; 2], bool)> {
    let unit = VirtualUnit { noise, rate_hz: 100.0, ..VirtualUnit::default() };
    let mut drive = SchemeDrive::new(VirtualRins::new(&unit, 3), scheme, 0.0);
    let mut errors = Vec::new();
    while let Some(reading) = drive.next() {
        let [outer, inner] = drive.rins().true_angles_at_stamp_rad();
        let error = [reading.outer_rad - outer, reading.inner_rad - inner];
        errors.push((error, drive.rins().true_rates_rad_s() == [0.0; 2]));
    }
    errors
}

/// Ranges of samples of the moves, each from the last sample of the stop before to the first sample of the stop after.
fn moves_of(errors: &[([f64; 2], bool)]) -> Vec<(usize, usize)> {
    let starts = (1..errors.len()).filter(|&i| errors[i - 1].1 && !errors[i].1).map(|i| i - 1);
    let ends = (1..errors.len()).filter(|&i| !errors[i - 1].1 && errors[i].1);
    starts.zip(ends).collect()
}

#[test]
fn encoder_errors_are_drawn_per_stop_and_axis_and_blend_linearly() {
    let scheme = Scheme::bai(0.5, 20);
    let errors = encoder_errors(Noise::navigation(), &scheme);
    let moves = moves_of(&errors);
    assert_eq!(moves.len(), 360);
    let mut chi_square = 0.0;
    let mut correlations = [0.0; 3];
    for &(start, end) in &moves {
        let (before, after) = (errors[start].0, errors[end].0);
        let sigma = 0.5 * ARCSEC;
        chi_square += (after[0] / sigma).powi(2) + (after[1] / sigma).powi(2);
        correlations[0] += before[0] * after[0] / (sigma * sigma);
        correlations[1] += before[1] * after[1] / (sigma * sigma);
        correlations[2] += after[0] * after[1] / (sigma * sigma);
        for (sample, (error, _)) in errors.iter().enumerate().take(end).skip(start) {
            let part = (sample - start) as f64 / (end - start) as f64;
            for axis in 0..2 {
                let difference = after[axis] - before[axis];
                // The first 20 arcsec, which the axis passes in 24 ms, do not count as a move yet.
                let late = if sample - start <= 3 { difference.abs() * part } else { 0.0 };
                assert!((error[axis] - before[axis] - difference * part).abs() < 1e-11 + late);
            }
        }
    }
    // 720 squares: mean 720, sigma sqrt(1440) = 38; 360 products of independent normals: sigma sqrt(360) = 19.
    assert!((chi_square - 720.0).abs() < 5.0 * 38.0, "{chi_square}");
    assert!(correlations.iter().all(|sum| sum.abs() < 5.0 * 19.0), "{correlations:?}");
}

#[test]
fn rate_reference_noise_is_a_bridge_between_the_stops() {
    let noise = Noise { encoder_repeatability_arcsec: 0.0, ..Noise::bai() };
    let errors = encoder_errors(noise, &Scheme::bai(0.5, 20));
    let moves = moves_of(&errors);
    let mut chi_square = 0.0;
    for &(start, end) in &moves {
        assert!(errors[start].0.iter().chain(&errors[end].0).all(|error| error.abs() < 1e-12));
        let middle = errors[(start + end) / 2].0;
        // The axis at rest has no error of the reference, so that the sum is the error of the turning axis. A Brownian
        // bridge of duration T has the variance psd^2 T/4 in its middle.
        let sigma = 0.7 * ARCSEC / 200.0_f64.sqrt() * (5.5_f64 / 4.0).sqrt();
        chi_square += ((middle[0] + middle[1]) / sigma).powi(2);
    }
    // 360 degrees of freedom, sigma sqrt(720) = 27.
    assert!((chi_square - 360.0).abs() < 5.0 * 27.0, "{chi_square}");
}

#[test]
fn encoder_errors_do_not_depend_on_the_length_of_the_stops() {
    let stops = |stop_s| {
        let errors = encoder_errors(Noise::navigation(), &Scheme::bai(stop_s, 1));
        moves_of(&errors).iter().map(|&(_, end)| errors[end].0).collect::<Vec<_>>()
    };
    for (short, long) in stops(0.5).iter().zip(&stops(3.0)) {
        assert!((short[0] - long[0]).abs() < 1e-12 && (short[1] - long[1]).abs() < 1e-12);
    }
}

#[test]
fn lever_arm_feels_centripetal_and_tangential_acceleration() {
    let site = Site { measured_gravity_m_s2: Some(0.0), ..Site::default() };
    let effects = Effects { lever_arm_m: [0.02, 0.05, -0.03], ..Effects::default() };
    let unit = VirtualUnit { site, effects, ..silent_unit(InstrumentErrors::default()) };
    let mut rins = VirtualRins::new(&unit, 1);
    let rate = 20.0 * DEG;
    rins.command_rates([0.0, rate]);
    let ramp = rins.advance();
    let tangential = rate / 0.005;
    // Over the ramp the mean of the squared rate is a third of its end value.
    let expected = [-tangential * 0.05 - rate * rate / 3.0 * 0.02, tangential * 0.02 - rate * rate / 3.0 * 0.05, 0.0];
    assert_close(ramp.force_a, expected, 1e-12);
    assert_close(rins.advance().force_a, [-rate * rate * 0.02, -rate * rate * 0.05, 0.0], 1e-12);
}

#[test]
fn lever_arm_acceleration_is_the_second_derivative_of_the_position() {
    // Both axes turn and accelerate; position of the IMU in b by the core's (3), differentiated numerically.
    let errors = InstrumentErrors { axis_non_perpendicularity: 0.1, ..Default::default() };
    let site = Site { measured_gravity_m_s2: Some(0.0), ..Site::default() };
    let lever = [0.4, -0.3, 0.5];
    let effects = Effects { lever_arm_m: lever, ..Effects::default() };
    let truth = RigidTruth::new(&VirtualUnit { site, effects, ..silent_unit(errors) });
    let motion =
        Motion { angles_rad: [0.3, -0.8], from_rad_s: [0.5, 0.9], to_rad_s: [0.502, 0.897], duration_s: 1.0 / 1024.0 };
    let rot_br = |part: f64| {
        let [outer, inner] = motion.angles_at(part).map(Angle::from_rad);
        errors.rot_rr0(outer, inner).transpose()
    };
    let position_b = |part: f64| rot_br(part) * Vector3::from(lever);
    let second_difference = |steps: f64| {
        (position_b(0.5 + steps) + position_b(0.5 - steps) - position_b(0.5) * 2.0) * (1024.0 / steps).powi(2)
    };
    // Extrapolated from steps of 1/64 and 1/32 s. What is left is the ticks of two angles, 4 * 0.7e-9 * 64^2 * 1.8.
    let second = (second_difference(16.0) * 4.0 - second_difference(32.0)) / 3.0;
    let expected = rot_br(0.5).transpose() * second;
    let mean = truth.mean_over(&motion, 0.0).force_a;
    assert_close(mean, expected.into(), 2.1e-5);
}

#[test]
fn rigid_truth_agrees_with_the_core_at_rest() {
    // Equations (M1) to (M5), implemented a second time. The angles are multiples of the resolution of the core.
    let sizes = RandomErrors::default().with_installation_deg(1.0);
    for seed in 0..50 {
        let errors = sizes.draw(seed);
        let unit = silent_unit(errors);
        let ticks = [87_654_321, 198_765_431].map(|step: u32| Angle::from_ticks(step.wrapping_mul(seed as u32)));
        let at_rest = RigidTruth::new(&unit).at_rest(ticks.map(|angle| angle.rad()));
        let rot_sn = errors.rot_sr() * errors.rot_rr0(ticks[0], ticks[1]) * errors.rot_nb().transpose();
        let up_n = Vector3::new(0.0, 0.0, unit.site.gravity_m_s2());
        let (force_a, omega_g) = errors.corrupt(&(rot_sn * up_n), &(rot_sn * Vector3::from(unit.site.earth_rate_n())));
        assert_close(at_rest.force_a.start, force_a.into(), 1e-13);
        assert_close(at_rest.omega_g.start, omega_g.into(), 1e-17);
    }
}

#[test]
fn moves_land_on_the_grid_at_any_rate() {
    let mut odd = Scheme::bai(0.333, 1);
    odd.rate_rad_s = 7.1 * DEG;
    odd.acceleration_rad_s2 = 13.0 * DEG;
    odd.legs[0].inner_rad = 0.01 * DEG;
    odd.legs[1].inner_rad = 45.0 * DEG;
    for (scheme, rate_hz) in [(Scheme::bai(1.0, 1), 200.0), (Scheme::bai(1.0, 2), 100.0), (odd, 200.0)] {
        let unit = VirtualUnit { rate_hz, ..silent_unit(InstrumentErrors::default()) };
        let mut drive = SchemeDrive::new(VirtualRins::new(&unit, 1), &scheme, 0.0);
        let total = drive.total_samples();
        assert!((total as f64 / rate_hz - scheme.duration_s()).abs() < 0.02 * scheme.moves() as f64);
        let mut stood = true;
        let mut reached = Vec::new();
        let mut count = 0;
        while drive.next().is_some() {
            count += 1;
            let stands = drive.rins().true_rates_rad_s() == [0.0; 2];
            if stands && !stood {
                reached.push(drive.rins().true_angles_rad());
            }
            assert!(drive.rins().true_rates_rad_s().iter().all(|rate| rate.abs() < scheme.rate_rad_s * 1.001));
            stood = stands;
        }
        assert_eq!((count, reached.len()), (total, scheme.moves()));
        for (index, angles) in reached.iter().enumerate() {
            let leg = scheme.leg(index).unwrap();
            assert!((angles[0] - leg.outer_rad).abs() < 1e-11 && (angles[1] - leg.inner_rad).abs() < 1e-11);
        }
    }
    assert!(move_durations_s(&Scheme::bai(1.0, 1), 200.0).iter().all(|duration| (duration - 5.5).abs() < 1e-9));
}

#[test]
fn settling_makes_every_stop_longer() {
    let scheme = Scheme::bai(1.0, 1);
    let samples = |settling_s| {
        let rins = VirtualRins::new(&VirtualUnit::default(), 1);
        SchemeDrive::new(rins, &scheme, settling_s).total_samples()
    };
    assert_eq!(samples(0.3), samples(0.0) + 19 * 60);
}

#[test]
fn drifts_and_harmonics_do_what_they_say() {
    let effects = Effects {
        accel_bias_ramp_ug_h: [10.0, 0.0, 0.0],
        gyro_bias_ramp_deg_h_h: [0.0, 0.0, 0.02],
        base_tilt_drift_arcsec_h: [3600.0, -1800.0],
        // The first harmonic of the outer encoder is 2 (sin(angle + 30 deg) - sin 30 deg).
        hardware: Imperfections {
            encoder_harmonics_arcsec: [
                [[1.0, 3.0_f64.sqrt()], [0.0; 2], [0.0; 2], [0.0; 2]],
                [[0.0; 2], [-3.0, 0.0], [0.0; 2], [0.0; 2]],
            ],
            ..Imperfections::default()
        },
        temperature_c: Some(20.0),
        temperature_ramp_c_h: 6.0,
        ..Effects::default()
    };
    let unit = VirtualUnit { effects, rate_hz: 1.0, ..silent_unit(InstrumentErrors::default()) };
    let mut rins = VirtualRins::new(&unit, 1);
    let last = (0..3600).map(|_| rins.advance()).last().unwrap();
    let g = unit.site.gravity_m_s2();
    // A tilt by one degree about x lifts the y axis, and one by minus half a degree about y lifts the x axis. To first
    // order, the force along an axis grows by gravity times its tilt. The middle of the last interval is half a second
    // before the hour.
    let hour = 1.0 - 0.5 / 3600.0;
    let expected = [g * 0.5 * DEG * hour + 10.0 * MICRO_G * hour, g * DEG * hour, g];
    assert_close(last.force_a, expected, 1e-12);
    let [_, north, up] = unit.site.earth_rate_n();
    // The gyros also measure the rate at which the base tilts.
    let tilted = [0.5 * DEG * hour * up, north + DEG * hour * up, up - DEG * hour * north + 0.02 * DEG_H * hour];
    let expected = [tilted[0] + ARCSEC, tilted[1] - 0.5 * ARCSEC, tilted[2]];
    assert_close(last.omega_g, expected, 1e-15);
    assert!((f64::from(last.temperature_c) - 26.0).abs() < 1e-2);
    assert_eq!([last.outer_rad, last.inner_rad], [0.0; 2]);
    rins.command_rates([FRAC_PI_2, FRAC_PI_2]);
    rins.advance();
    rins.command_rates([0.0; 2]);
    rins.advance();
    let quarter = rins.advance();
    assert!((quarter.outer_rad - FRAC_PI_2 - 2.0 * ARCSEC * ((120.0 * DEG).sin() - 0.5)).abs() < 1e-14);
    assert!((quarter.inner_rad - FRAC_PI_2 - 6.0 * ARCSEC).abs() < 1e-14);
}

#[test]
fn biases_walk_as_far_as_they_should() {
    let effects = Effects { accel_bias_walk_ug_sqrt_h: 5.0, gyro_bias_walk_deg_h_sqrt_h: 0.01, ..Effects::default() };
    let unit = VirtualUnit { effects, rate_hz: 1.0, ..silent_unit(InstrumentErrors::default()) };
    let at_rest = VirtualRins::new(&VirtualUnit { effects: Effects::default(), ..unit.clone() }, 0).advance();
    let mut chi_square = 0.0;
    for seed in 0..100 {
        let mut rins = VirtualRins::new(&unit, seed);
        // The bias of a sample includes the steps before it: 3600 of them.
        let last = (0..=3600).map(|_| rins.advance()).last().unwrap();
        for axis in 0..3 {
            chi_square += ((last.force_a[axis] - at_rest.force_a[axis]) / (5.0 * MICRO_G)).powi(2);
            chi_square += ((last.omega_g[axis] - at_rest.omega_g[axis]) / (0.01 * DEG_H)).powi(2);
        }
    }
    // 600 degrees of freedom, sigma sqrt(1200) = 35.
    assert!((chi_square - 600.0).abs() < 5.0 * 35.0, "{chi_square}");
}

#[test]
fn drives_keep_their_limits() {
    let effects = Effects { max_rate_deg_s: Some(10.0), max_acceleration_deg_s2: Some(20.0), ..Effects::default() };
    let mut rins = VirtualRins::new(&VirtualUnit { effects, ..silent_unit(InstrumentErrors::default()) }, 1);
    rins.command_rates([1.0, -1.0]);
    rins.advance();
    assert!((rins.true_rates_rad_s()[0] - 0.1 * DEG).abs() < 1e-15);
    assert_eq!((0..200).map(|_| rins.advance()).count(), 200);
    assert_eq!(rins.true_rates_rad_s(), [10.0 * DEG, -10.0 * DEG]);
}

#[test]
fn seeds_repeat_and_differ() {
    let run = |seed| {
        let unit = VirtualUnit { errors: real(1), ..VirtualUnit::default() };
        SchemeDrive::new(VirtualRins::new(&unit, seed), &Scheme::bai(0.5, 1), 0.0).take(2000).collect::<Vec<Reading>>()
    };
    let same = |a: &[Reading], b: &[Reading]| a.iter().zip(b).all(|(a, b)| a.omega_g == b.omega_g);
    assert!(same(&run(1), &run(1)) && !same(&run(1), &run(2)));
    assert_eq!(run(1)[1999].time_us, 9_997_500);
}

/// The log of an independent simulator, and the unit that it has simulated.
fn sample() -> (Vec<Reading>, VirtualUnit) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let rows = LogReader::open(&data.join("sample.csv.gz")).unwrap();
    let readings = rows.map(|row: Result<LogRow, _>| row.unwrap().reading).collect();
    let config = UnitConfig::read(&data.join("sample.toml")).unwrap();
    let errors = Truth::read(&data.join("sample.truth.json")).unwrap().parameters.to_errors();
    (readings, VirtualUnit { errors, site: config.site(), noise: config.noise, ..VirtualUnit::default() })
}

/// First and last sample of each stop in a log whose encoders are constant while the axes are at rest.
fn stops_of(readings: &[Reading]) -> Vec<(usize, usize)> {
    let mut stops: Vec<(usize, usize)> = Vec::new();
    for (index, pair) in readings.windows(2).enumerate() {
        if (pair[0].outer_rad, pair[0].inner_rad) != (pair[1].outer_rad, pair[1].inner_rad) {
            continue;
        }
        match stops.last_mut() {
            Some((_, last)) if *last == index => *last = index + 1,
            _ => stops.push((index, index + 1)),
        }
    }
    stops.retain(|(first, last)| last - first > 200);
    stops
}

#[test]
fn sample_log_agrees_at_every_stop() {
    let (readings, unit) = sample();
    let truth = RigidTruth::new(&unit);
    let stops = stops_of(&readings);
    assert_eq!(stops.len(), 19);
    for (first, last) in stops {
        let inside = &readings[first + 1..last];
        let mean = |vector: fn(&Reading) -> Vec3| {
            let part = (inside.len() as f64).recip();
            inside.iter().fold([0.0; 3], |sum, reading| add_scaled(sum, vector(reading), part))
        };
        let predicted = truth.at_rest([inside[0].outer_rad, inside[0].inner_rad]);
        // White noise over 10 s: 3.2 ug and 0.019 arcsec/s; 0.5 arcsec of either axis: 2.4 ug. Five sigma of 4.7 ug.
        assert_close(mean(|reading| reading.force_a), predicted.force_a.start, 5.0 * 4.7 * MICRO_G);
        assert_close(mean(|reading| reading.omega_g), predicted.omega_g.start, 5.0 * 0.019 * ARCSEC);
    }
}

#[test]
fn sample_log_agrees_over_every_move() {
    let (readings, unit) = sample();
    let truth = RigidTruth::new(&unit);
    let stops = stops_of(&readings);
    let mut sum_of_squares = 0.0;
    // White noise over 5.5 s: 0.14 arcsec. 0.5 arcsec at both ends of the turning axis: 0.71 arcsec. The mean error of
    // the other axis, 0.35 arcsec, over a quarter turn: 0.55 arcsec. Together 0.91 arcsec at most.
    let sigma = 0.91 * ARCSEC;
    for pair in stops.windows(2) {
        let mut difference = [0.0; 3];
        for index in pair[0].1..=pair[1].0 {
            let measured = readings[index].omega_g;
            let predicted = truth.mean_over(&around(&readings, index), 0.0).omega_g;
            difference = add_scaled(add_scaled(difference, measured, 0.005), predicted, -0.005);
        }
        assert_close(difference, [0.0; 3], 5.0 * sigma);
        sum_of_squares += difference.iter().map(|x| (x / sigma).powi(2)).sum::<f64>();
    }
    // At most 54 degrees of freedom, sigma sqrt(108) = 10.4.
    assert!(sum_of_squares < 54.0 + 5.0 * 10.4, "{sum_of_squares}");
}

/// Motion over the interval around a reading, from the encoders. The samples of that simulator are means over the
/// interval around their stamps.
fn around(readings: &[Reading], index: usize) -> Motion {
    let angles = |reading: &Reading| [reading.outer_rad, reading.inner_rad];
    let [before, here, after] = [index - 1, index, index + 1].map(|index| angles(&readings[index]));
    let start = [0, 1].map(|axis| 0.5 * (before[axis] + here[axis]));
    let rates = [0, 1].map(|axis| 0.5 * (after[axis] - before[axis]) / 0.005);
    Motion { angles_rad: start, from_rad_s: rates, to_rad_s: rates, duration_s: 0.005 }
}
