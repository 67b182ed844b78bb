//! A pixel that is at the camera's limit whatever the light, in models that censor such pixels.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::picture::{Falloff, Spot, TestPicture};
use isophote_frame::Plane;
use isophote_jit::PixelFormat;
use isophote_symbolic::Precision;

/// A hundred spots of which a pixel, anywhere in the domain, is stuck at the camera's limit.
#[test]
fn a_hot_pixel_takes_nothing_from_an_estimate() {
    let model = Arc::new(Model::from_toml(include_str!("../../../models/spot.toml")).unwrap());
    let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
    let ask = |defects: f64, frame: &Frame| {
        let constants = [("gain", 0.0), ("read_noise", (9.0 + 1.0 / 12.0_f64).sqrt()), ("defects", defects)];
        let constants = constants.map(|(name, value)| (name.to_string(), value)).into();
        let options = TrackerOptions { constants, ..TrackerOptions::default() };
        let mut tracker = Tracker::new(compiled.clone(), options).unwrap();
        let estimate = tracker.track(frame);
        assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
        let model = tracker.compiled().model();
        let centre = ["bx", "by"].map(|name| estimate.parameters[model.parameter(name).unwrap().index()]);
        (centre, estimate.covariance.unwrap())
    };
    let error_of = |[x, y]: [f64; 2], c: &[Vec<f64>]| {
        (c[1][1] * x * x - 2.0 * c[0][1] * x * y + c[0][0] * y * y) / (c[0][0] * c[1][1] - c[0][1] * c[1][0])
    };
    let (mut moved, mut nees, mut fooled) = (0.0, 0.0, 0.0);
    let frames = 100;
    for seed in 0..frames {
        let turn = 0.7 * seed as f64;
        // In every other frame nearly a third of the spot is at the limit.
        let amplitude = if seed % 2 == 0 { 150.0 } else { 290.0 };
        let centre = [39.6 + 0.37 * (seed % 7) as f64, 40.9];
        let profile = Falloff::Cubic(-0.5, -0.3);
        let truth = Spot { centre, half: [20.0, 14.0], angle: 0.3, amplitude, profile };
        let picture = TestPicture { noise: 3.0, seed, samples: 4, ..TestPicture::new(80, 80, vec![truth]) };
        // From the middle to beyond the rim.
        let far = 19.0 * ((seed % 10) as f64 + 0.5) / 10.0;
        let hot =
            [truth.centre[0] + far * turn.cos(), truth.centre[1] + far * turn.sin()].map(|at| at.round() as usize);
        let mut bytes: Vec<u8> = picture.pixels().iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect();
        bytes[hot[1] * 80 + hot[0]] = 255;
        let frame = Frame::new(&[80, 80], vec![Plane::owned(PixelFormat::U8, bytes, 80)]).unwrap();
        let (clean, covariance) = ask(1e-3, &picture.frame());
        let way = |centre: [f64; 2]| error_of([centre[0] - clean[0], centre[1] - clean[1]], &covariance) / 2.0;
        let (centre, worth) = ask(1e-3, &frame);
        moved += way(centre) / frames as f64;
        fooled += way(ask(0.0, &frame).0) / frames as f64;
        nees += error_of([centre[0] - truth.centre[0], centre[1] - truth.centre[1]], &worth) / frames as f64;
    }
    // A pixel less is what a hot one costs; taken for light it moves the centre by a standard deviation and more.
    assert!(moved.sqrt() < 0.1 && fooled.sqrt() > 0.5, "{moved} {fooled}");
    assert!((1.4..2.6).contains(&nees), "{nees}"); // 2 ± 3 · 2/√100
}
