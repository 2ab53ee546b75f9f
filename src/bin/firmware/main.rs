//! The firmware: samples in, rates out, records in the store.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod bit_bang_i2c;
mod mps2_an500;

use cortex_m_rt::entry;
use heapless::String;
use mps2_an500::Board;
use rins_selfcal::error_model::{InstrumentErrors, PARAMETERS};
use rins_selfcal::method::Method;
use rins_selfcal::site::Site;
use rins_selfcal::store::{Loaded, StoredCalibration};
use rins_selfcal::telemetry::{MAX_FRAME_BYTES, Message, encode};

/// The scalar of this image.
#[cfg(not(feature = "single-precision"))]
pub type Scalar = f64;
/// The scalar of this image.
#[cfg(feature = "single-precision")]
pub type Scalar = f32;

#[entry]
fn main() -> ! {
    let mut board = Board::start();
    let mut configuration = [0; 512];
    let length = board.configuration(&mut configuration).map_or(0, <[u8]>::len);
    defmt::info!("configuration of {=usize} bytes", length);
    report_store(&mut board);
    let (mut samples, mut time_us) = (0, 0);
    loop {
        while let Some(sample) = board.samples.pop() {
            samples += 1;
            time_us = sample.time_us;
            for drive in &mut board.drives {
                let _ = drive.command(0);
            }
            if samples % 200 == 0 {
                report_progress(&mut board, samples, time_us);
            }
        }
        if !board.powered() {
            break;
        }
        board.wait();
    }
    report_progress(&mut board, samples, time_us);
    defmt::info!("{=u32} samples, switched off after {=u64} us", samples, board.now_us());
    let saved = board.store.save(&record(samples)).map_err(|_| defmt::error!("the record was not saved"));
    board.finish(saved)
}

fn send(board: &mut Board, message: &Message) {
    let mut buffer = [0; MAX_FRAME_BYTES];
    if let Some(frame) = encode(message, &mut buffer) {
        board.telemetry(frame);
    }
}

fn report_progress(board: &mut Board, samples: u32, time_us: u64) {
    let losses = board.samples.losses();
    send(board, &Message::Progress { samples, time_us, losses });
}

fn report_store(board: &mut Board) {
    let (found, damaged) = match board.store.load() {
        Ok(Loaded::Empty) => (None, false),
        Ok(Loaded::Found { record, damage }) => (Some(record.degrees_of_freedom), damage.is_some()),
        Ok(Loaded::Corrupt { .. }) => (None, true),
        Err(_) => (None, true),
    };
    defmt::info!("record in store: {=bool}, damaged: {=bool}", found.is_some(), damaged);
    let degrees_of_freedom = found.unwrap_or(0);
    send(board, &Message::Store { found: found.is_some(), damaged, degrees_of_freedom });
}

fn record(samples: u32) -> StoredCalibration {
    StoredCalibration {
        errors: InstrumentErrors::default(),
        sigmas: [0.0; PARAMETERS],
        method: Method::Joint,
        scheme: String::new(),
        site: Site::default(),
        temperature_c: f32::NAN,
        chi_square: 0.0,
        degrees_of_freedom: samples,
        software_version: String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default(),
    }
}
