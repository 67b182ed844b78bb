//! What stands beside or in front of a target does not move its estimate, once the plain fit has shown that something does.

use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::options::TrackerOptions;
use crate::picture::{Picture, Spot};
use crate::solve::compiled::Compiled;
use crate::{Estimate, TrackState, Tracker};
use isophote_frame::{Frame, Plane};

const MODEL: &str = r#"
name = "spot"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = "centroid.x" }
by = { start = "centroid.y" }
a1 = { start = "extent.xx", min = 0 }
a2 = { start = "extent.xy" }
a3 = { start = "extent.yy", min = 0 }
v0 = { start = "background" }
v1 = { start = "amplitude", min = 0 }
[definitions]
s = "a1 * (x - bx)^2 + 2 * a2 * (x - bx) * (y - by) + a3 * (y - by)^2"
[model]
intensity = "v0 + v1 * if(s <= 1, (1 - s)^2 * (1 + s/2), 0)"
domain = "s <= 2.2"
constraint = ["a1*a3 - a2^2 > 0"]
noise = "1.5"
saturated = "censored"
"#;

const CENTRE: [f64; 2] = [47.3, 48.8];

/// What the second of two frames is said to show; the first is clear.
fn tracked(change: impl Fn(usize, usize, f64) -> f64) -> Estimate {
    let compiled = Compiled::new(Arc::new(Model::from_toml(MODEL).expect("a model")), Precision::F32).expect("kernels");
    let mut tracker = Tracker::new(Arc::new(compiled), TrackerOptions::default()).expect("options");
    let mut spot = Spot::at(CENTRE[0], CENTRE[1], 18.0, 200.0);
    spot.half = [20.0, 14.0];
    let frame = |seed, change: &dyn Fn(usize, usize, f64) -> f64| {
        let picture = Picture { noise: 1.2, seed, ..Picture::new(96, 96, vec![spot]) };
        let pixels = picture.pixels().into_iter().enumerate();
        let bytes = pixels.map(|(i, v)| change(i % 96, i / 96, v).round().clamp(0.0, 255.0) as u8).collect();
        Frame::new(&[96, 96], vec![Plane::owned(PixelFormat::U8, bytes, 96)]).expect("the buffer fits")
    };
    assert_eq!(tracker.track(&frame(1, &|_, _, v| v)).state, TrackState::Tracking);
    tracker.track(&frame(2, &change))
}

fn error(estimate: &Estimate) -> f64 {
    assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
    (estimate.parameters[0] - CENTRE[0]).hypot(estimate.parameters[1] - CENTRE[1])
}

#[test]
fn a_clear_frame_is_fitted_as_it_is() {
    let estimate = tracked(|_, _, v| v);
    assert!(error(&estimate) < 0.03 && estimate.substitute.is_none(), "{estimate:?}");
}

#[test]
fn what_stands_in_front_of_a_target_is_left_out() {
    let estimate = tracked(|x, _, v| if x > 54 { 5.0 } else { v });
    let alternative = estimate.substitute.expect("an alternative");
    assert!(error(&estimate) < 0.1, "{}", error(&estimate));
    assert!(alternative.robust && alternative.hidden > 0.1, "{alternative:?}");
}

#[test]
fn a_white_out_beside_a_target_is_blind_and_not_bright() {
    let estimate = tracked(|x, _, v| if x > 58 { 255.0 } else { v });
    assert!(error(&estimate) < 0.3, "{}", error(&estimate));
    assert!(estimate.substitute.expect("an alternative").hidden > 0.1);
}

#[test]
fn glare_that_bends_becomes_part_of_the_background() {
    let glare = |x: usize, y: usize| 60.0 * (-((x as f64 - 8.0).powi(2) + (y as f64 - 12.0).powi(2)) / 2450.0).exp();
    let estimate = tracked(|x, y, v| v + glare(x, y));
    assert!(error(&estimate) < 0.1, "{}", error(&estimate));
    assert!(estimate.substitute.expect("an alternative").degree >= 2);
}
