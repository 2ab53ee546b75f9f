//! The drivers on the bench, without the emulator.

use host_tests::bench::{AtRest, Bench, Chip, drivers};
use rins_selfcal::device::{DeviceError, STATUS_REFUSED, rate_nrad_s};
use rins_selfcal::queue::{Losses, SampleQueue};
use std::cell::RefCell;
use std::rc::Rc;

#[test]
fn samples_and_rates_go_through_the_drivers() {
    let bench = Rc::new(RefCell::new(Bench::new(AtRest::new(3))));
    let mut queue = SampleQueue::<f64, 4>::new();
    let (producer, mut consumer) = queue.split();
    let (mut acquisition, mut drives) = drivers(&bench, producer);
    for time_us in [0, 5000, 10_000] {
        let edge_us = bench.borrow_mut().next_edge().expect("an edge");
        assert_eq!((edge_us, acquisition.on_data_ready(edge_us)), (time_us + 2500, Ok(())));
        let sample = consumer.pop().expect("a sample");
        // Half a step of the IMU is 1.9e-8 m/s^2.
        assert!((sample.force_a.z - 9.8_f64).abs() < 2e-8);
        assert_eq!((sample.time_us, sample.temperature_c), (time_us, 20.0));
    }
    drives[0].command(rate_nrad_s(-0.349)).expect("an acknowledgement");
    drives[1].command(rate_nrad_s(0.1)).expect("an acknowledgement");
    let [outer, inner] = bench.borrow().plant().rates_rad_s;
    assert!((outer + 0.349).abs() < 1e-12 && (inner - 0.1).abs() < 1e-12, "{outer} {inner}");
    assert_eq!(bench.borrow_mut().next_edge(), None);
    assert_eq!(consumer.losses(), Losses::default());
}

#[test]
fn a_drive_refuses_a_damaged_command() {
    let mut bench = Bench::new(AtRest::new(1));
    let mut frame = [2, 1, 0, 0, 0, 0, 0, 0];
    bench.transfer(Chip::OuterDrive, &mut frame);
    assert_eq!(frame[6], STATUS_REFUSED);
    assert!(bench.plant().rates_rad_s[0].is_nan());
}

#[test]
fn a_damaged_acknowledgement_is_an_error() {
    let bench = Rc::new(RefCell::new(Bench::new(AtRest::new(1))));
    bench.borrow_mut().damage(|_, frame| frame[6] ^= 1);
    let mut queue = SampleQueue::<f32, 4>::new();
    let (producer, _consumer) = queue.split();
    let (_, mut drives) = drivers(&bench, producer);
    assert_eq!(drives[0].command(5), Err(DeviceError::Crc));
}

/// A log of two hours goes through three reads and two writes a sample in about a second.
#[test]
fn the_bench_is_fast() {
    let samples = 1_500_000;
    let bench = Rc::new(RefCell::new(Bench::new(AtRest::new(samples))));
    let mut queue = SampleQueue::<f64, 4>::new();
    let (producer, mut consumer) = queue.split();
    let (mut acquisition, mut drives) = drivers(&bench, producer);
    let start = std::time::Instant::now();
    let mut popped = 0;
    let next_edge = || bench.borrow_mut().next_edge();
    while let Some(edge_us) = next_edge() {
        acquisition.on_data_ready(edge_us).expect("a sample");
        popped += u32::from(consumer.pop().is_some());
        assert!(drives.iter_mut().all(|drive| drive.command(0).is_ok()));
    }
    println!("{samples} samples in {:.2} s", start.elapsed().as_secs_f64());
    assert_eq!(popped, samples);
}
