//! Points that are no numbers.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::{Compiled, Frame, Plane, Tracker, TrackerOptions};

/// Of four points one is no number: three are enough for two parameters.
#[test]
fn points_that_are_no_numbers_are_not_asked_for() {
    let document = "name = \"line\"\ncoordinates = [\"i\"]\nchannels = [\"px\", \"py\"]\n[parameters]\na = { start = 1.0 }\n\
                    b = { start = 0.0 }\n[model]\nobserved = \"py\"\nintensity = \"a*px + b\"\n";
    let compiled = Compiled::new(Arc::new(Model::from_toml(document).unwrap()), Precision::F32).unwrap();
    let plane = |values: [f64; 4]| {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Plane::owned(PixelFormat::F64, bytes, 4)
    };
    let frame = Frame::new(&[4], vec![plane([1.0, 2.0, 3.0, 4.0]), plane([f64::NAN, 7.0, 9.0, 11.0])]).unwrap();
    let estimate = Tracker::new(Arc::new(compiled), TrackerOptions::default()).unwrap().track(&frame);
    assert!(estimate.ending.is_fit() && estimate.pixels == 3, "{estimate:?}");
    assert!((estimate.parameters[0] - 2.0).abs() < 1e-3, "{estimate:?}");
}
