#![allow(clippy::unwrap_used)]
use std::f64::consts::PI;
use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::{PixelFormat, Window};
use isophote_symbolic::{Model, Precision};

use super::around::Around;
use super::asymmetry;
use super::prominence;
use super::window::Margin;
use crate::picture::Noise;
use crate::solve::fit::Begin;
use crate::solve::stage_kernels::Control;
use crate::{CONFIDENCE_MIN, Compiled, Rejection, TrackState, Tracker, TrackerOptions};

const SIZE: [usize; 2] = [320, 240];
const CENTRE: [f64; 2] = [160.3, 119.6];

/// An 8-bit frame with noise of 2 DN.
fn frame(light: impl Fn(f64, f64) -> f64) -> Frame {
    let mut noise = Noise(7);
    let value = |i: usize| {
        let (x, y) = ((i % SIZE[0]) as f64 - CENTRE[0], (i / SIZE[0]) as f64 - CENTRE[1]);
        (20.0 + light(x, y) + 2.0 * noise.normal()).round().clamp(0.0, 255.0) as u8
    };
    let bytes = (0..SIZE[0] * SIZE[1]).map(value).collect();
    Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, SIZE[0])]).unwrap()
}

fn gaussian(x: f64, y: f64) -> f64 {
    150.0 * (-2.0 * (x * x + 0.4 * x * y + 1.5 * y * y) / 300.0).exp()
}

fn square(x: f64, y: f64) -> f64 {
    if x.abs().max(y.abs()) < 12.0 { 150.0 } else { 0.0 }
}

/// Bumps of 60 DN, 24 px apart, one of them at the centre.
fn bumps(x: f64, y: f64) -> f64 {
    let wave = |u: f64| (u * std::f64::consts::TAU / 24.0).cos();
    30.0 + 30.0 * wave(x) * wave(y)
}

fn tracker() -> Tracker {
    tracker_of(include_str!("../../../models/gaussian.toml"))
}

fn tracker_of(text: &str) -> Tracker {
    let model = Model::from_toml(text).unwrap();
    let compiled = Compiled::new(Arc::new(model), Precision::F32).unwrap();
    Tracker::new(Arc::new(compiled), TrackerOptions::default()).unwrap()
}

/// What shape and prominence of a fit that begins at the centre, with a radius of so many px, take of the log odds.
fn against(frame: &Frame, radius: f64) -> [f64; 2] {
    let tracker = tracker();
    let solver = &tracker.solver;
    let look = solver.look(frame).unwrap();
    let a = radius.powi(-2);
    let start = [CENTRE[0], CENTRE[1], a, 0.0, a, 20.0, 120.0];
    let margin = Margin::even(0.5, 6.0);
    let fit = solver.attempt(&look, &start, Begin::Anywhere, Control::Plain, margin).unwrap().fit.unwrap();
    let around = Around::of(solver, &look, &fit).unwrap();
    let shape = asymmetry::against(asymmetry::of(&around, 255.0).unwrap());
    [shape, prominence::against(prominence::of(solver, &look, &fit).unwrap())]
}

#[test]
fn a_target_in_noise_has_nothing_against_it() {
    assert_eq!(against(&frame(gaussian), 17.0), [0.0, 0.0]);
}

#[test]
fn corners_are_held_against_a_thing_and_a_frame_full_of_bumps_against_one_of_them() {
    let [shape, prominence] = against(&frame(square), 17.0);
    assert!(shape > 10.0 && prominence == 0.0, "{shape} {prominence}");
    let [_, prominence] = against(&frame(bumps), 8.0);
    assert!(prominence > 4.0, "{prominence}");
}

/// A rough model is better than none.
#[test]
fn a_disc_that_is_alone_may_be_taken_for_a_gaussian() {
    let disc = |x: f64, y: f64| if x.hypot(1.3 * y) < 14.0 { 150.0 } else { 0.0 };
    assert_eq!(against(&frame(disc), 17.0), [0.0, 0.0]);
}

#[test]
fn a_lone_square_is_no_target() {
    let estimate = tracker().track(&frame(square));
    assert_eq!((estimate.state, estimate.rejection), (TrackState::Searching, Some(Rejection::Unlikely)));
    assert!(estimate.confidence.unwrap() < 0.01, "{estimate:?}");
    let estimate = tracker().track(&frame(gaussian));
    assert!(estimate.state == TrackState::Tracking && estimate.confidence.unwrap() > 0.93, "{estimate:?}");
}

/// A rough model is better than none, but beside something else nobody knows which is meant.
#[test]
fn of_several_things_that_are_hardly_the_target_none_is_taken() {
    let dome = |x: f64, y: f64| 150.0 * (1.0 - (x * x + 1.7 * y * y) / 500.0).max(0.0);
    let two = |x: f64, y: f64| dome(x, y) + dome(x - 70.0, y + 40.0);
    let alone = tracker().track(&frame(dome));
    let confidence = alone.confidence.unwrap();
    assert!(alone.state == TrackState::Tracking && (CONFIDENCE_MIN..0.88).contains(&confidence), "{alone:?}");
    let estimate = tracker().track(&frame(two));
    assert_eq!((estimate.state, estimate.rejection), (TrackState::Searching, Some(Rejection::OneOfSeveral)));
    // A speck is none of several.
    let speck = |x: f64, y: f64| dome(x, y) + 20.0 * (-0.5 * ((x - 70.0).powi(2) + (y + 40.0).powi(2))).exp();
    assert_eq!(tracker().track(&frame(speck)).state, TrackState::Tracking);
    // A square beside it, of which no fit is good, is another thing as well.
    let beside = |x: f64, y: f64| dome(x, y) + square(x - 90.0, y);
    assert_eq!(tracker().track(&frame(beside)).state, TrackState::Searching);
    // What looks like the target is taken, whatever else there is.
    let clear = |x: f64, y: f64| gaussian(x, y) + square(x - 90.0, y) + dome(x + 70.0, y + 40.0);
    let estimate = tracker().track(&frame(clear));
    let off = (estimate.parameters[0] - CENTRE[0]).hypot(estimate.parameters[1] - CENTRE[1]);
    assert!(estimate.state == TrackState::Tracking && off < 1.0, "{estimate:?}");
}

/// A square that is blurred by a Gaussian of 4 px.
fn blurred(x: f64, y: f64, half: f64) -> f64 {
    let along = |u: f64| {
        let places = (0..40).map(|i| half * (f64::from(i) + 0.5) / 20.0 - half);
        places.map(|place| (-(u - place).powi(2) / 32.0).exp()).sum::<f64>() * half / 20.0 / (32.0 * PI).sqrt()
    };
    200.0 * along(x) * along(y)
}

/// Alone it may be the target, of which the document is a rough model; beside others that are no targets it is one of them.
#[test]
fn what_is_nearly_like_the_target_is_no_target_among_things_that_are_not() {
    let small = |x: f64, y: f64| 2.0 * blurred(x, y, 5.0);
    assert_eq!(tracker().track(&frame(small)).state, TrackState::Tracking);
    let beside = |x: f64, y: f64| small(x, y) + blurred(x - 90.0, y, 14.0);
    let estimate = tracker().track(&frame(beside));
    assert_eq!(
        (estimate.state, estimate.rejection),
        (TrackState::Searching, Some(Rejection::OneOfSeveral)),
        "{estimate:?}"
    );
    // What the border of a window cuts off is not among what was asked for.
    let [x, y] = [CENTRE[0] as usize - 40, CENTRE[1] as usize - 40];
    let window = Window { x, y, width: 132, height: 80, ..Window::whole(1, 1) };
    let options = TrackerOptions { window: Some(window), ..TrackerOptions::default() };
    let mut within = Tracker::new(tracker().solver.compiled.clone(), options).unwrap();
    assert_eq!(within.track(&frame(beside)).state, TrackState::Tracking);
    // The target itself is found there, and so is one of several things of its own kind.
    let target = |x: f64, y: f64| gaussian(x, y) + blurred(x - 90.0, y, 14.0) + small(x + 70.0, y + 40.0);
    let estimate = tracker().track(&frame(target));
    let off = (estimate.parameters[0] - CENTRE[0]).hypot(estimate.parameters[1] - CENTRE[1]);
    assert!(estimate.state == TrackState::Tracking && off < 1.0, "{estimate:?}");
    let two = |x: f64, y: f64| small(x, y) + 0.8 * small(x + 70.0, y + 40.0);
    assert_eq!(tracker().track(&frame(two)).state, TrackState::Tracking);
}

/// What is sharp leaves much unexplained in single pixels, and nothing in its neighbours.
#[test]
fn what_noise_as_stated_does_not_explain_is_no_target_however_small_it_is() {
    let spot = include_str!("../../../models/spot.toml");
    for half in [[3.1, 0.5], [5.7, 0.8]] {
        let bar = |x: f64, y: f64| {
            let (along, across) = (0.9 * x + 0.436 * y, 0.9 * y - 0.436 * x);
            if along.abs() < half[0] && across.abs() < half[1] { 190.0 } else { 0.0 }
        };
        let estimate = tracker_of(spot).track(&frame(bar));
        assert_ne!(estimate.state, TrackState::Tracking, "{half:?}: {estimate:?}");
    }
}

/// A substitute says what is hidden; what it leaves unexplained even so is another thing.
#[test]
fn a_large_square_is_no_spot_with_something_in_front_of_it() {
    let spot = include_str!("../../../models/spot.toml");
    for half in [16.0, 24.0] {
        let square = |x: f64, y: f64| {
            let soft = |u: f64| 1.0 / (1.0 + ((u.abs() - half) / 1.5).exp());
            190.0 * soft(0.94 * x + 0.34 * y) * soft(0.94 * y - 0.34 * x)
        };
        let estimate = tracker_of(spot).track(&frame(square));
        assert_ne!(estimate.state, TrackState::Tracking, "{half}: {estimate:?}");
    }
}

/// Sixty waves of 8 to 20 px in all directions, 12 DN together.
fn texture() -> impl Fn(f64, f64) -> f64 {
    let mut noise = Noise(5);
    let wave = |_| [8.0 + 12.0 * noise.uniform(), 2.0 * PI * noise.uniform(), 2.0 * PI * noise.uniform()];
    let waves: Vec<[f64; 3]> = (0..60).map(wave).collect();
    let height = 12.0 * (2.0 / waves.len() as f64).sqrt();
    move |x, y| {
        let one = |[length, direction, phase]: &[f64; 3]| {
            let along = x * direction.cos() + y * direction.sin();
            (2.0 * PI * along / length + phase).cos()
        };
        height * waves.iter().map(one).sum::<f64>()
    }
}

/// What the ground leaves in residuals is no misfit, and makes a place less sure by as much as it does.
#[test]
fn a_target_on_texture_is_one_and_is_as_uncertain_as_the_texture_makes_it() {
    let ground = texture();
    let on_texture = frame(|x, y| 40.0 + gaussian(x, y) + ground(x, y));
    let [even, uneven] = [frame(|x, y| 40.0 + gaussian(x, y)), on_texture].map(|frame| tracker().track(&frame));
    assert!(uneven.state == TrackState::Tracking && uneven.substitute.is_none(), "{uneven:?}");
    assert!(uneven.confidence.unwrap() > 0.5, "{uneven:?}");
    let variance = |estimate: &crate::Estimate| estimate.covariance.as_ref().unwrap()[0][0];
    let off = uneven.parameters[0] - CENTRE[0];
    assert!(off * off < 9.0 * variance(&uneven), "{off}, variance {}", variance(&uneven));
    assert!(variance(&uneven) > 30.0 * variance(&even), "{} {}", variance(&uneven), variance(&even));
    // A disc on the same ground leaves more than that.
    let disc = |x: f64, y: f64| if x.hypot(y) < 20.0 { 150.0 } else { 0.0 };
    let other = tracker().track(&frame(|x, y| 40.0 + disc(x, y) + ground(x, y)));
    assert!(other.confidence.unwrap() < 0.5 * uneven.confidence.unwrap(), "{other:?}");
}

/// Waves of 6 to 300 px in all directions, as high as they are long, 20 DN together.
fn growing_bumps(seed: u64) -> impl Fn(f64, f64) -> f64 {
    let mut noise = Noise(seed);
    let wave = |_| {
        let length = 6.0 * 50.0_f64.powf(noise.uniform());
        [length, 2.0 * PI * noise.uniform(), 2.0 * PI * noise.uniform()]
    };
    let waves: Vec<[f64; 3]> = (0..200).map(wave).collect();
    let height = 20.0 * (2.0 / waves.iter().map(|wave| wave[0] * wave[0]).sum::<f64>()).sqrt();
    move |x, y| {
        let one = |[length, direction, phase]: &[f64; 3]| {
            let along = x * direction.cos() + y * direction.sin();
            length * (2.0 * PI * along / length + phase).cos()
        };
        height * waves.iter().map(one).sum::<f64>()
    }
}

/// A slope that ends at a border is like a part of a target, and among bumps there are many.
#[test]
fn what_the_border_cuts_off_is_doubted_among_bumps() {
    let ground = texture();
    let half = |x: f64, y: f64| 40.0 + 0.4 * gaussian(x + CENTRE[0], y);
    let frames = [frame(half), frame(|x, y| half(x, y) + ground(x, y))];
    let [even, uneven] = frames.map(|frame| tracker().track(&frame).confidence.unwrap());
    assert!(even > 0.5 && uneven < 0.1, "{even} {uneven}");
}

/// Where bumps grow with their size the tip of a large target stands out more than all of it: fits that begin there stay there.
#[test]
fn a_large_target_is_found_on_bumps_that_grow_with_their_size() {
    let target = |x: f64, y: f64| {
        let s = (x * x + 0.2 * x * y + 1.3 * y * y) / 16.0_f64.powi(2);
        90.0 * (1.0 - 0.5 * s - 0.3 * s * s) * 0.5 * (1.0 - (40.0 * (s - 1.0)).tanh())
    };
    let lost: Vec<u64> = (1..=8)
        .filter(|seed| {
            let ground = growing_bumps(*seed);
            let frame = frame(|x, y| 60.0 + target(x, y) + ground(x, y));
            let estimate = tracker_of(include_str!("../../../models/spot.toml")).track(&frame);
            let off = || (estimate.parameters[0] - CENTRE[0]).hypot(estimate.parameters[1] - CENTRE[1]);
            estimate.state != TrackState::Tracking || off() > 2.0
        })
        .collect();
    assert!(lost.is_empty(), "{lost:?}");
}

/// What is hidden of a target lies anywhere: the hole of a ring is in its very middle.
#[test]
fn a_blurred_ring_is_no_spot_with_something_in_front_of_its_middle() {
    let soft = |off: f64| 1.0 / (1.0 + (-off / 1.5).exp());
    for (outer, inner) in [(28.0, 10.0), (25.0, 12.0), (34.0, 14.0)] {
        let ring = |x: f64, y: f64| 130.0 * soft(outer - x.hypot(y)) * soft(x.hypot(y) - inner);
        let estimate = tracker_of(include_str!("../../../models/spot.toml")).track(&frame(ring));
        assert_ne!(estimate.state, TrackState::Tracking, "{outer} {inner}: {estimate:?}");
    }
}

/// Three bars that are blurred until they are a few px wide, with next to nothing that hangs together in their residuals.
#[test]
fn among_other_things_what_leaves_more_than_its_noise_is_no_target() {
    let bar = |x: f64, y: f64, long: f64| 34.0 * (-0.5 * ((x / long).powi(2) + (y / 1.9).powi(2))).exp();
    let bars =
        |x: f64, y: f64| bar(x, y, 4.0) + 3.0 * bar(x - 70.0, y + 40.0, 9.0) + 3.0 * bar(y + 50.0, x + 90.0, 12.0);
    let estimate = tracker_of(include_str!("../../../models/spot.toml")).track(&frame(bars));
    assert_ne!(estimate.state, TrackState::Tracking, "{estimate:?}");
}
