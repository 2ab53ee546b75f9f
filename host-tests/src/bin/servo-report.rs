//! Prints how the servo moves and holds an axis whose load differs from the servo's model.

use comfy_table::{Table, presets};
use host_tests::bench::servo_bench::{MoveFigures, ServoBench};
use host_tests::virtual_unit::motor::Mechanics;
use rins_selfcal::base::profile::Point;
use rins_selfcal::base::units::{ARCSEC, DEG};
use rins_selfcal::gimbal::servo::MotorAndLoad;

/// Loads: name, factors of inertia and friction relative to the servo's model, bits of the encoder.
const LOADS: [(&str, f64, f64, u8); 9] = [
    ("as assumed", 1.0, 1.0, 26),
    ("32-bit encoder", 1.0, 1.0, 32),
    ("20-bit encoder", 1.0, 1.0, 20),
    ("inertia +30 %", 1.3, 1.0, 26),
    ("inertia -30 %", 0.7, 1.0, 26),
    ("friction x 2", 1.0, 2.0, 26),
    ("friction / 2", 1.0, 0.5, 26),
    ("no friction", 1.0, 0.0, 26),
    ("+30 %, friction x 2", 1.3, 2.0, 26),
];

fn main() {
    for (encoder_bits, name) in [(26, "26"), (20, "20")] {
        let data = MotorAndLoad { encoder_bits, ..MotorAndLoad::default() };
        let bandwidth = data.bandwidth_rad_s();
        println!(
            "encoder with {name} bits: the bandwidth of the rate loop is {bandwidth:.0} rad/s, that of the position loop a quarter"
        );
    }
    println!(
        "moves at 20 deg/s, ramps of 1 s, 1000 deg/s^3; settled within 2 arcsec; held from 0.5 s after the end on"
    );
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    let head =
        ["load", "way deg", "following arcsec", "overshoot arcsec", "settling ms", "hold arcsec RMS", "highest duty"];
    table.set_header(head);
    for (name, inertia, friction, encoder_bits) in LOADS {
        let assumed = MotorAndLoad { encoder_bits, ..MotorAndLoad::default() };
        let mut bench = ServoBench::<f64>::new(&assumed, load(&assumed, inertia, friction));
        for way_deg in [90.0, -180.0, 1.0] {
            let (end_s, trace) = bench.move_by(way_deg, 2.0);
            table.add_row(row(name, way_deg, &MoveFigures::new(way_deg, end_s, &trace)));
        }
    }
    println!("{table}");
    print_step();
}

fn load(assumed: &MotorAndLoad, inertia: f64, friction: f64) -> Mechanics {
    Mechanics::of(MotorAndLoad {
        inertia_kg_m2: inertia * assumed.inertia_kg_m2,
        coulomb_nm: friction * assumed.coulomb_nm,
        viscous_nm_s: friction * assumed.viscous_nm_s,
        ..*assumed
    })
}

fn row(name: &str, way_deg: f64, figures: &MoveFigures) -> [String; 7] {
    [
        name.into(),
        format!("{way_deg:.0}"),
        format!("{:.1}", figures.following_arcsec),
        format!("{:.2}", figures.overshoot_arcsec),
        format!("{:.0}", figures.settling_s * 1e3),
        format!("{:.3}", figures.hold_rms_arcsec),
        format!("{:.2}", figures.duty),
    ]
}

/// Steps without a profile: one within the torque, one far beyond it.
fn print_step() {
    for step_deg in [0.02, 5.0] {
        let data = MotorAndLoad::default();
        let mut bench = ServoBench::<f64>::new(&data, Mechanics::of(data));
        let step = bench.follow(3.0, |_| Point { angle_rad: step_deg * DEG, ..Point::default() });
        let beyond = step.iter().map(|at| at.error_rad).fold(0.0, f64::max) / DEG;
        let late = step.iter().rev().find(|at| at.error_rad.abs() > 2.0 * ARCSEC).map_or(0.0, |at| at.time_s);
        let percent = 100.0 * beyond / step_deg;
        println!("step of {step_deg} deg: overshoot {percent:.1} %, within 2 arcsec after {:.0} ms", late * 1e3);
    }
}
