//! Checks at compile time that the generic types that a firmware logs implement `defmt::Format`. The derive alone shows
//! nothing: it requires the trait of every field, and a field without it makes an implementation that never applies.

use crate::acquisition::queue::SampleWithGimbal;
use crate::base::profile::{Point, Profile};
use crate::base::sample::{CorrectedSample, RawSample};
use crate::drivers::adis16495::StartFault;
use crate::drivers::biss::BissFault;
use crate::drivers::{ImuFault, ImuReading};
use crate::estimator::filter::{Innovation, Measurement, Update};
use crate::gimbal::servo::{Drive, Setpoint};
use crate::keep::slots::StoreError;
use crate::link::Frame;
use crate::model::correction::Calibration;
use crate::model::error_model::{InstrumentErrors, PARAMETERS};
use crate::model::measurement::Prediction;
use crate::run::self_calibration::Step;
use crate::segment::scatter::BlockMeans;
use crate::segment::{AngleIntegrals, Course, Segment, Standing, Turned};

const fn is_logged<T: defmt::Format>() {}

const _: () = {
    is_logged::<SampleWithGimbal<f64>>();
    is_logged::<Point<f64>>();
    is_logged::<Profile<f64>>();
    is_logged::<RawSample<f64>>();
    is_logged::<CorrectedSample<f64>>();
    is_logged::<StartFault<()>>();
    is_logged::<BissFault<()>>();
    is_logged::<ImuFault<()>>();
    is_logged::<ImuReading<f64>>();
    is_logged::<Innovation<f64>>();
    is_logged::<Measurement<f64, PARAMETERS>>();
    is_logged::<Update<f64>>();
    is_logged::<Drive<f64>>();
    is_logged::<Setpoint<f64>>();
    is_logged::<StoreError<()>>();
    is_logged::<Frame<'static>>();
    is_logged::<Calibration<f64>>();
    is_logged::<InstrumentErrors<f64>>();
    is_logged::<Prediction<f64>>();
    is_logged::<Step<f64>>();
    is_logged::<BlockMeans<f64>>();
    is_logged::<AngleIntegrals<f64>>();
    is_logged::<Course<f64>>();
    is_logged::<Segment<f64>>();
    is_logged::<Standing<f64>>();
    is_logged::<Turned<f64>>();
};
