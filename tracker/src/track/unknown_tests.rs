//! Pixels without a value, and pixels far larger than all others.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::picture::Noise;
use crate::{Compiled, Estimate, Frame, Plane, TrackState, Tracker, TrackerOptions};

/// One of four points is NaN: three are enough for two parameters.
#[test]
fn nan_points_are_left_out() {
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

const GAUSSIAN: &str = include_str!("../../../models/gaussian.toml");
const MOFFAT: &str = include_str!("../../../models/moffat.toml");
const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const CORNER: usize = 5 * WIDTH + 5;
const CORE: usize = 21 * WIDTH + 31;

/// A spot at 30.3, 21.7 in noise of 1, with some pixels overwritten.
fn pixels(spoiled: &[(usize, f64)]) -> Vec<f64> {
    let mut noise = Noise(0x5EED);
    let value = |i: usize| {
        let (x, y) = ((i % WIDTH) as f64 - 30.3, (i / WIDTH) as f64 - 21.7);
        let s = 0.0085 * x * x - 0.00666 * x * y + 0.01408 * y * y;
        40.0 + 180.0 * (-2.0 * s).exp()
    };
    let mut pixels: Vec<f64> = (0..WIDTH * HEIGHT).map(|i| value(i) + noise.normal()).collect();
    spoiled.iter().for_each(|(i, value)| pixels[*i] = *value);
    pixels
}

fn fitted(document: &str, format: PixelFormat, precision: Precision, spoiled: &[(usize, f64)]) -> Estimate {
    let bytes: Vec<u8> = match format {
        PixelFormat::F32 => pixels(spoiled).iter().flat_map(|value| (*value as f32).to_ne_bytes()).collect(),
        _ => pixels(spoiled).iter().flat_map(|value| value.to_ne_bytes()).collect(),
    };
    let frame = Frame::new(&[WIDTH, HEIGHT], vec![Plane::owned(format, bytes, WIDTH)]).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(document).unwrap()), precision).unwrap());
    Tracker::new(compiled, TrackerOptions { precision, ..TrackerOptions::default() }).unwrap().track(&frame)
}

fn deviations(estimate: &Estimate) -> Vec<f64> {
    let covariance = estimate.covariance.as_ref().unwrap();
    (0..covariance.len()).map(|i| covariance[i][i].sqrt()).collect()
}

#[test]
fn infinite_and_huge_pixels_are_treated_as_unknown() {
    for document in [GAUSSIAN, MOFFAT] {
        for at in [CORNER, CORE] {
            let unknown = fitted(document, PixelFormat::F32, Precision::F32, &[(at, f64::NAN)]);
            assert_eq!(unknown.state, TrackState::Tracking, "{unknown:?}");
            let infinite = [f64::INFINITY, f64::NEG_INFINITY];
            for value in [1e8, 1e9, -1e9, 1e15, 1e30, -1e30, f64::from(f32::MAX), f64::from(f32::MIN)]
                .into_iter()
                .chain(infinite)
            {
                let estimate = fitted(document, PixelFormat::F32, Precision::F32, &[(at, value)]);
                assert_eq!(estimate.parameters, unknown.parameters, "{value} at {at}");
                assert_eq!(estimate.covariance, unknown.covariance, "{value} at {at}");
            }
        }
    }
    for precision in [Precision::F32, Precision::F64] {
        let unknown = fitted(GAUSSIAN, PixelFormat::F64, precision, &[(CORE, f64::NAN)]);
        for value in [f64::INFINITY, f64::NEG_INFINITY, 1.7e308, -1.7e308] {
            let estimate = fitted(GAUSSIAN, PixelFormat::F64, precision, &[(CORE, value)]);
            assert_eq!(estimate.parameters, unknown.parameters, "{value}");
        }
    }
}

#[test]
fn a_picture_of_values_that_cannot_be_summed_is_refused() {
    let all = |value: f64| (0..WIDTH * HEIGHT).map(|i| (i, value * (1.0 + 1e-3 * (i % 7) as f64))).collect::<Vec<_>>();
    for (format, value) in [(PixelFormat::F32, 3e38), (PixelFormat::F64, 1.7e308), (PixelFormat::F64, f64::INFINITY)] {
        for precision in [Precision::F32, Precision::F64] {
            let estimate = fitted(GAUSSIAN, format, precision, &all(value));
            assert_ne!(estimate.state, TrackState::Tracking, "{value} {precision:?}: {estimate:?}");
        }
    }
}

/// A sentinel outside of the spot that f32 can still sum.
#[test]
fn one_huge_pixel_outside_of_the_spot_changes_no_error_bars() {
    for format in [PixelFormat::F32, PixelFormat::F64] {
        for precision in [Precision::F32, Precision::F64] {
            let clean = fitted(GAUSSIAN, format, precision, &[]);
            assert_eq!(clean.state, TrackState::Tracking, "{clean:?}");
            for value in [1e8, 1e9, -1e9, 1e15] {
                let estimate = fitted(GAUSSIAN, format, precision, &[(CORNER, value)]);
                let case = format!("{value} {format:?} {precision:?}: {estimate:?}");
                assert_eq!(estimate.state, TrackState::Tracking, "{case}");
                for (i, (own, clean_own)) in deviations(&estimate).iter().zip(deviations(&clean)).enumerate() {
                    assert!((own / clean_own - 1.0).abs() < 0.02, "{i} {case}");
                    let off = (estimate.parameters[i] - clean.parameters[i]).abs() / clean_own;
                    assert!(off < 0.05, "{i} is {off} deviations off, {case}");
                }
            }
        }
    }
}
