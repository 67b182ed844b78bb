//! Objects beside or in front of a target do not move its estimate, once the plain fit shows a misfit.

use std::cell::Cell;
use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};

use crate::options::TrackerOptions;
use crate::picture::{Spot, TestPicture};
use crate::sight::view::PlaneLayout;
use crate::solve::compiled::Compiled;
use crate::{Estimate, Preparing, TrackState, Tracker};
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

/// The estimate of the second of two frames; the first is clear.
fn tracked(change: impl Fn(usize, usize, f64) -> f64) -> Estimate {
    tracked_by(&mut tracker(&compiled(), Preparing::AtOnce), change)
}

fn compiled() -> Arc<Compiled> {
    let model = Model::from_toml(MODEL).expect("a model");
    Arc::new(Compiled::new(Arc::new(model), Precision::F32).expect("kernels"))
}

fn tracker(compiled: &Arc<Compiled>, preparing: Preparing) -> Tracker {
    let options = TrackerOptions { preparing, ..TrackerOptions::default() };
    Tracker::new(compiled.clone(), options).expect("options")
}

fn tracked_by(tracker: &mut Tracker, change: impl Fn(usize, usize, f64) -> f64) -> Estimate {
    let mut spot = Spot::at(CENTRE[0], CENTRE[1], 18.0, 200.0);
    spot.half = [20.0, 14.0];
    let frame = |seed, change: &dyn Fn(usize, usize, f64) -> f64| {
        let picture = TestPicture { noise: 1.2, seed, ..TestPicture::new(96, 96, vec![spot]) };
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
fn a_clear_frame_has_no_substitute() {
    let estimate = tracked(|_, _, v| v);
    assert!(error(&estimate) < 0.03 && estimate.substitute.is_none(), "{estimate:?}");
}

#[test]
fn an_occluder_is_left_out() {
    let estimate = tracked(|x, _, v| if x > 54 { 5.0 } else { v });
    let alternative = estimate.substitute.expect("an alternative");
    assert!(error(&estimate) < 0.1, "{}", error(&estimate));
    assert!(alternative.robust && alternative.hidden > 0.1, "{alternative:?}");
}

#[test]
fn a_white_out_beside_a_target_is_left_out() {
    // It fades over some pixels, which are neither defects nor fitted by a target.
    let veil = |x: usize| 600.0 / (1.0 + (-(x as f64 - 68.0) / 2.0).exp());
    let estimate = tracked(|x, _, v| v + veil(x));
    assert!(error(&estimate) < 0.3, "{}", error(&estimate));
    assert!(estimate.substitute.expect("an alternative").hidden > 0.1);
    // With a sharp edge its pixels are defects, and the rest of the target is fitted as it is.
    let estimate = tracked(|x, _, v| if x > 58 { 255.0 } else { v });
    assert!(error(&estimate) < 0.1 && estimate.substitute.is_none(), "{} {estimate:?}", error(&estimate));
}

#[test]
fn curved_glare_becomes_part_of_the_background() {
    let glare = |x: usize, y: usize| 60.0 * (-((x as f64 - 8.0).powi(2) + (y as f64 - 12.0).powi(2)) / 2450.0).exp();
    let estimate = tracked(|x, y, v| v + glare(x, y));
    assert!(error(&estimate) < 0.1, "{}", error(&estimate));
    assert!(estimate.substitute.expect("an alternative").degree >= 2);
}

/// eᵀC⁻¹e of the centre: 2 on average when the covariance is honest.
fn nees(estimate: &Estimate) -> f64 {
    let c = estimate.covariance.as_ref().expect("a covariance");
    let [x, y] = [0, 1].map(|axis| estimate.parameters[axis] - CENTRE[axis]);
    (c[1][1] * x * x - 2.0 * c[0][1] * x * y + c[0][0] * y * y) / (c[0][0] * c[1][1] - c[0][1] * c[1][0])
}

/// Twelve positions of an edge, whose pixels are covered in part.
#[test]
fn uncovered_pixels_are_fitted_by_the_model_itself() {
    let compiled = compiled();
    let mut sum = 0.0;
    for position in 0..12 {
        let edge = 52.0 + f64::from(position) * 0.37;
        let covered = |x: usize, _: usize, v: f64| {
            let share = (x as f64 + 0.5 - edge).clamp(0.0, 1.0);
            v * (1.0 - share) + 5.0 * share
        };
        let estimate = tracked_by(&mut tracker(&compiled, Preparing::AtOnce), covered);
        let substitute = estimate.substitute.expect("an alternative");
        assert!(substitute.degree == 0 && substitute.robust && substitute.hidden > 0.1, "{edge}: {substitute:?}");
        assert!(error(&estimate) < 0.15, "{edge}: {}", error(&estimate));
        sum += nees(&estimate);
    }
    assert!((0.5..4.0).contains(&(sum / 12.0)), "{}", sum / 12.0); // one noise for all, so not twelve independent samples
}

/// A lobe without outliers, which moves the centre by several standard deviations.
#[test]
fn smooth_stray_light_becomes_part_of_the_background() {
    let lobe = |x: usize, y: usize| 16.0 * (-((x as f64 - 8.0).powi(2) + (y as f64 - 12.0).powi(2)) / 2450.0).exp();
    let mut spot = Spot::at(CENTRE[0], CENTRE[1], 18.0, 200.0);
    spot.half = [20.0, 14.0];
    let picture = TestPicture { noise: 1.2, seed: 3, ..TestPicture::new(96, 96, vec![spot]) };
    let pixels = picture.pixels().into_iter().enumerate();
    let bytes = pixels.map(|(i, v)| (v + lobe(i % 96, i / 96)).round().clamp(0.0, 255.0) as u8).collect();
    let frame = Frame::new(&[96, 96], vec![Plane::owned(PixelFormat::U8, bytes, 96)]).expect("the buffer fits");
    let estimate = tracker(&compiled(), Preparing::AtOnce).track(&frame);
    let substitute = estimate.substitute.expect("another background");
    assert!(substitute.degree >= 1 && !substitute.robust, "{substitute:?}");
    assert!(error(&estimate) < 0.05 && nees(&estimate) < 12.0, "{} {}", error(&estimate), nees(&estimate));
}

fn hidden(x: usize, _: usize, v: f64) -> f64 {
    if x > 54 { 5.0 } else { v }
}

#[test]
fn frames_have_no_alternatives_until_they_are_prepared() {
    let compiled = compiled();
    let mut first = tracker(&compiled, Preparing::Beside);
    let estimate = tracked_by(&mut first, hidden);
    assert!(estimate.substitute.is_none(), "{estimate:?}");
    let preparation = first.wanted().expect("they were asked for");
    assert!(first.wanted().is_none(), "once a frame");
    let kernels = compiled.cache().counts();
    assert!(compiled.prepared_backgrounds().ready(&PlaneLayout::of_format(PixelFormat::U8, 1)).is_none());
    preparation.run(&|| true).expect("kernels");
    let prepared = compiled.cache().counts();
    assert!(prepared.misses > kernels.misses, "{prepared:?}");
    // A later tracker finds them, compiles nothing, and agrees with one that waits for them.
    let mut later = tracker(&compiled, Preparing::Beside);
    let beside = tracked_by(&mut later, hidden);
    assert!(beside.substitute.is_some() && later.wanted().is_none(), "{beside:?}");
    assert_eq!(compiled.cache().counts().misses, prepared.misses);
    assert_eq!(beside, tracked_by(&mut tracker(&compiled, Preparing::AtOnce), hidden));
    assert_eq!(beside, tracked(hidden), "by kernels of its own");
}

#[test]
fn an_aborted_preparation_can_be_resumed() {
    let compiled = compiled();
    let mut asking = tracker(&compiled, Preparing::Beside);
    for pieces in [0, 2, 5] {
        assert!(tracked_by(&mut asking, hidden).substitute.is_none(), "{pieces}");
        let asked = Cell::new(0);
        let should_continue = || asked.replace(asked.get() + 1) < pieces;
        asking.wanted().expect("asked for again").run(&should_continue).expect("no failure");
        assert_eq!(asked.get(), pieces + 1, "ends at once");
    }
    asking = tracker(&compiled, Preparing::Beside);
    tracked_by(&mut asking, hidden);
    asking.wanted().expect("asked for again").run(&|| true).expect("kernels");
    assert!(tracked_by(&mut tracker(&compiled, Preparing::Beside), hidden).substitute.is_some());
}
