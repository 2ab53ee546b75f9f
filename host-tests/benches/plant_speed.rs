//! Time per sample of the virtual RINS, at rest and turning: `cargo bench --bench plant_speed`.

use host_tests::plant::Plant;
use host_tests::presets::real;
use host_tests::unit::Noise;
use host_tests::virtual_rins::{Effects, VirtualRins, VirtualUnit};
use std::hint::black_box;
use std::time::Instant;

const SAMPLES: u32 = 4_000_000;

fn ns_per_sample(unit: &VirtualUnit, rates_rad_s: [f64; 2]) -> f64 {
    let mut rins = VirtualRins::new(unit, 1);
    let start = Instant::now();
    for _ in 0..SAMPLES {
        rins.command_rates(rates_rad_s);
        black_box(rins.advance());
    }
    start.elapsed().as_secs_f64() * 1e9 / f64::from(SAMPLES)
}

fn main() {
    let effects = Effects { lever_arm_m: [0.02, -0.01, 0.03], ..Effects::default() };
    let unit = VirtualUnit { errors: real(1), noise: Noise::bai(), effects, ..VirtualUnit::default() };
    for (name, rates) in [("at rest", [0.0; 2]), ("one axis turning", [0.35, 0.0]), ("both turning", [0.35, 0.3])] {
        println!("{name}: {:.0} ns per sample", ns_per_sample(&unit, rates));
    }
}
