//! Shipped pose documents on images rendered independently: a homography of the tests, 8 × 8 samples.

#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::*;
use crate::estimate::{Estimate, TrackState};
use crate::options::{MotionOptions, TrackError, TrackerOptions};
use crate::picture::Noise;
use crate::pose::joint::tests::lens;
use crate::solve::compiled::Compiled;
use crate::track::tracker::Tracker;
use crate::{Camera, Pose};
use isophote_frame::{Frame, Plane};

const SIZE: [usize; 2] = [640, 480];
const FLAT: [[f64; 3]; 3] = [[0.0, 80.0, 0.0], [-70.0, -40.0, 0.0], [70.0, -40.0, 0.0]];

fn model(name: &str) -> Arc<Compiled> {
    let text = match name {
        "three-spots-pose" => include_str!("../../../models/three-spots-pose.toml"),
        "three-spots-pose-lens" => include_str!("../../../models/three-spots-pose-lens.toml"),
        "raised-spot-pose" => include_str!("../../../models/raised-spot-pose.toml"),
        _ => include_str!("../../../models/spot-pose.toml"),
    };
    Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap())
}

fn pose(turn: [f64; 3], at: [f64; 3]) -> Rigid {
    Rigid { rotation: Rotation3::new(Vector3::from(turn)).into_inner(), translation: Vector3::from(at) }
}

/// Spots of radius 30 mm and brightness 200 over a background of 20, noise of 1; k1 = −0.5, k2 = −0.3.
fn frame(pose: &Rigid, spots: &[[f64; 3]], lens: &Intrinsics, seed: u64) -> Frame {
    veiled(pose, spots, lens, seed, &|_, value| value)
}

/// Maps a pixel's position and value to the value that is read.
type Veil<'a> = &'a dyn Fn([f64; 2], f64) -> f64;

/// Renders spots through a veil.
fn veiled(pose: &Rigid, spots: &[[f64; 3]], lens: &Intrinsics, seed: u64, veil: Veil) -> Frame {
    let mut values = vec![20.0; SIZE[0] * SIZE[1]];
    for spot in spots {
        let centre = pose.apply(Vector3::from(*spot));
        let back = Matrix3::from_columns(&[pose.rotation.column(0).into(), pose.rotation.column(1).into(), centre]);
        let back = back.try_inverse().unwrap();
        let middle = lens.project(centre.into()).unwrap();
        let reach = 1.3 * lens.fx * 30.0 / centre.z;
        for y in (middle[1] - reach) as usize..=(middle[1] + reach) as usize {
            for x in (middle[0] - reach) as usize..=(middle[0] + reach) as usize {
                for k in 0..64 {
                    let at = [k % 8, k / 8].map(|i| (f64::from(i) + 0.5) / 8.0 - 0.5);
                    let [u, v] = lens.normalised([x as f64 + at[0], y as f64 + at[1]]).unwrap();
                    let p = back * Vector3::new(u, v, 1.0);
                    let s = (p.x * p.x + p.y * p.y) / (p.z * 30.0).powi(2);
                    if s < 1.0 {
                        values[y * SIZE[0] + x] += 200.0 / 64.0 * (1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s);
                    }
                }
            }
        }
    }
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15 ^ seed);
    let at = |i: usize| [(i % SIZE[0]) as f64, (i / SIZE[0]) as f64];
    let bytes = values
        .iter()
        .enumerate()
        .map(|(i, v)| (veil(at(i), *v) + noise.normal()).round().clamp(0.0, 255.0) as u8)
        .collect();
    Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, SIZE[0])]).unwrap()
}

fn options(lens: &Intrinsics) -> TrackerOptions {
    // Noise of one pixel value.
    let constants = [("gain".to_string(), 0.0), ("read_noise".to_string(), 1.0)].into();
    TrackerOptions {
        camera: Camera { intrinsics: Some(lens.clone()), ..Camera::default() },
        constants,
        ..TrackerOptions::default()
    }
}

/// Within five standard deviations in every direction, by the reported covariance.
fn assert_close(found: &Pose, truth: &Rigid) {
    let is = Rigid::of_quaternion(found.position_mm, found.orientation_xyzw);
    let off = truth.to(&is);
    let covariance = Matrix6::from_row_slice(found.covariance.as_ref().unwrap());
    for i in 0..6 {
        let deviation = covariance[(i, i)].sqrt();
        assert!(off[i].abs() < 5.0 * deviation, "{i}: {} is {} σ off", off[i], off[i] / deviation);
    }
    assert!(covariance[(2, 2)].sqrt() < 0.3 && covariance[(5, 5)].sqrt() < 1e-3, "{covariance}");
}

#[test]
fn cold_start_finds_the_pose_and_tracks_it() {
    let lens = lens(Distortion::None, &[]);
    for (name, raised) in [("three-spots-pose", 0.0), ("raised-spot-pose", -40.0)] {
        let mut spots = FLAT;
        spots[0][2] = raised;
        let compiled = model(name);
        for (turn, at) in [([0.4, -0.3, 0.5], [60.0, -30.0, 900.0]), ([-0.1, 0.5, -2.6], [-90.0, 40.0, 1200.0])] {
            let mut tracker = Tracker::new(compiled.clone(), options(&lens)).unwrap();
            for step in 0..3_u32 {
                let truth = pose(turn, at).moved(&(Vector6::new(3.0, -2.0, 8.0, 0.01, 0.02, 0.03) * f64::from(step)));
                let estimate = tracker.track(&frame(&truth, &spots, &lens, u64::from(step)));
                assert_eq!(estimate.state, TrackState::Tracking, "{name} {step} {:?}", estimate.rejection);
                assert!((estimate.reduced_chi_square.unwrap() - 1.0).abs() < 0.1);
                assert_close(estimate.pose.as_ref().unwrap(), &truth);
            }
        }
    }
}

#[test]
fn a_pose_is_found_among_other_things() {
    let lens = lens(Distortion::None, &[]);
    let compiled = model("three-spots-pose");
    let truth = pose([0.3, -0.4, 0.5], [30.0, -20.0, 1200.0]);
    let spots = FLAT.map(|spot| lens.project(truth.apply(Vector3::from(spot)).into()).unwrap());
    for seed in 0..4_u64 {
        // Gaussians, discs and rings of 5 to 20 px and a brightness of 40 to 230.
        let mut random = Noise(0x1234_5678 ^ (seed << 32));
        let mut uniform = |low: f64, high: f64| low + (high - low) * random.uniform();
        let mut things = Vec::new();
        while things.len() < 20 {
            let at = [uniform(20.0, 620.0), uniform(20.0, 460.0)];
            let thing = (at, uniform(5.0, 20.0), uniform(40.0, 230.0), things.len() % 3);
            if spots.iter().all(|spot| (spot[0] - at[0]).hypot(spot[1] - at[1]) > 50.0) {
                things.push(thing);
            }
        }
        let veil = |at: [f64; 2], value: f64| {
            let light = |&(centre, size, height, kind): &([f64; 2], f64, f64, usize)| {
                let r = (at[0] - centre[0]).hypot(at[1] - centre[1]) / size;
                height * [(-2.0 * r * r).exp(), f64::from(r < 1.0), f64::from((r - 0.8).abs() < 0.2)][kind]
            };
            value + things.iter().map(light).sum::<f64>()
        };
        let track = |spots: &[[f64; 3]]| {
            let frame = veiled(&truth, spots, &lens, seed, &veil);
            Tracker::new(compiled.clone(), options(&lens)).unwrap().track(&frame)
        };
        let estimate = track(&FLAT);
        assert_eq!(estimate.state, TrackState::Tracking, "{seed} {:?}", estimate.rejection);
        let off = (Vector3::from(estimate.pose.unwrap().position_mm) - truth.translation).norm();
        assert!(off < 2.0, "{seed}: {off} mm");
        assert_eq!(track(&[]).state, TrackState::Searching, "{seed}");
    }
}

#[test]
fn distorted_lens_is_modelled_or_refused() {
    let lens = lens(Distortion::PlumbBob, &[-0.28, 0.08, 0.001, -0.0008, 0.0]);
    let truth = pose([0.3, 0.4, 0.2], [150.0, 90.0, 900.0]);
    let picture = frame(&truth, &FLAT, &lens, 3);
    let mut tracker = Tracker::new(model("three-spots-pose-lens"), options(&lens)).unwrap();
    assert_close(&tracker.track(&picture).pose.unwrap(), &truth);
    // The planted fault: a pinhole instead.
    let refused = Tracker::new(model("three-spots-pose"), options(&lens));
    assert_eq!(refused.err(), Some(TrackError::Lens { wanted: "lens_k1".into() }));
    let pinhole = Intrinsics { model: Distortion::None, coefficients: Vec::new(), ..lens };
    let mut tracker = Tracker::new(model("three-spots-pose"), options(&pinhole)).unwrap();
    let wrong = tracker.track(&picture);
    let far = wrong.pose.map(|p| (Vector3::from(p.position_mm) - truth.translation).norm());
    assert!(far.is_none_or(|far| far > 2.0), "{far:?}");
}

#[test]
fn one_spot_has_tilt_but_no_spin() {
    let lens = lens(Distortion::None, &[]);
    let truth = pose([0.5, -0.4, 0.0], [40.0, 20.0, 500.0]);
    let estimate =
        Tracker::new(model("spot-pose"), options(&lens)).unwrap().track(&frame(&truth, &[[0.0; 3]], &lens, 5));
    let found = estimate.pose.unwrap();
    let is = Rigid::of_quaternion(found.position_mm, found.orientation_xyzw);
    assert_eq!(found.degrees_of_freedom, 5);
    assert!((is.rotation.column(2) - truth.rotation.column(2)).norm() < 0.02);
    assert!((is.translation - truth.translation).norm() < 1.0);
    let covariance = Matrix6::from_row_slice(&found.covariance.unwrap());
    let axis = is.rotation.column(2).into_owned();
    let spin = (axis.transpose() * covariance.fixed_view::<3, 3>(3, 3) * axis)[0];
    assert!((spin - std::f64::consts::PI.powi(2) / 3.0).abs() < 1e-2, "{spin}");
}

#[test]
fn target_document_overrides_constants() {
    let lens = lens(Distortion::None, &[]);
    let shifted: Vec<[f64; 3]> = FLAT.iter().map(|[x, y, z]| [x + 25.0, y - 10.0, *z]).collect();
    let names = ["red", "green", "blue"];
    let spot = |(name, at): (&&str, &[f64; 3])| TargetSpot { name: (*name).into(), position_mm: *at, radius_mm: 30.0 };
    let target = Target { spots: names.iter().zip(&shifted).map(spot).collect(), ..Target::default() };
    let truth = pose([0.3, 0.2, -0.4], [10.0, 20.0, 900.0]);
    let options = TrackerOptions { target: Some(target), ..options(&lens) };
    let mut tracker = Tracker::new(model("three-spots-pose"), options).unwrap();
    assert_close(&tracker.track(&frame(&truth, &shifted, &lens, 9)).pose.unwrap(), &truth);
}

#[test]
fn given_starts_are_used_and_missing_constants_reported() {
    let lens = lens(Distortion::None, &[]);
    let truth = pose([0.3, 0.2, -0.4], [10.0, 20.0, 900.0]);
    let names = ["tx", "ty", "tz", "m1", "m2", "m3"];
    let near: Vec<f64> = truth.translation.iter().chain(truth.rodrigues().iter()).map(|v| v * 1.002).collect();
    let start = names.iter().map(|name| (*name).to_string()).zip(near).collect();
    let mut tracker = Tracker::new(model("three-spots-pose"), TrackerOptions { start, ..options(&lens) }).unwrap();
    assert_close(&tracker.track(&frame(&truth, &FLAT, &lens, 9)).pose.unwrap(), &truth);

    let text = include_str!("../../../models/spot-pose.toml").replace("spot_radius", "size");
    let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(&text).unwrap()), Precision::F32).unwrap());
    let refused = Tracker::new(compiled, options(&lens));
    assert_eq!(refused.err(), Some(TrackError::NoGeometry { name: "tx".into() }));
}

/// The third spot is covered while the target is tracked; then all of them are.
#[test]
fn two_spots_carry_the_pose_on() {
    let lens = lens(Distortion::None, &[]);
    let mut tracker = Tracker::new(model("three-spots-pose"), options(&lens)).unwrap();
    let at = |step: f64| pose([0.3, 0.2, -0.4], [10.0, 20.0, 900.0]).moved(&(Vector6::repeat(0.004) * step));
    assert_close(&tracker.track(&frame(&at(0.0), &FLAT, &lens, 1)).pose.unwrap(), &at(0.0));
    for step in 1..4_u32 {
        let truth = at(f64::from(step));
        let estimate = tracker.track(&frame(&truth, &FLAT[..2], &lens, 10 + u64::from(step)));
        assert_eq!(estimate.state, TrackState::Tracking, "{step} {:?}", estimate.rejection);
        assert_close(&estimate.pose.unwrap(), &truth);
    }
    let seen = variances(&tracker.track(&frame(&at(4.0), &FLAT, &lens, 19)));
    let estimate = tracker.track(&frame(&at(5.0), &[], &lens, 20));
    assert_eq!(estimate.state, TrackState::Coasting);
    assert!(estimate.pose.as_ref().unwrap().alternatives.is_empty());
    let predicted = variances(&estimate);
    assert!(predicted.iter().zip(seen).take(3).all(|(later, sooner)| *later > sooner), "{predicted:?} {seen:?}");
}

/// Variances of the position and the small rotation.
fn variances(estimate: &Estimate) -> [f64; 6] {
    let covariance = estimate.pose.as_ref().unwrap().covariance.as_ref().unwrap();
    std::array::from_fn(|i| covariance[7 * i])
}

/// An unseen pose coasts with its velocity, then is lost.
#[test]
fn a_pose_coasts() {
    let lens = lens(Distortion::None, &[]);
    let motion = MotionOptions { coast_s: 0.05, ..MotionOptions::default() }; // three frames
    let mut tracker = Tracker::new(model("three-spots-pose"), TrackerOptions { motion, ..options(&lens) }).unwrap();
    let step = Vector6::new(2.0, -1.0, 5.0, 0.0, 0.0, 0.0);
    let at = |n: u64| pose([0.3, 0.2, -0.4], [10.0, 20.0, 900.0]).moved(&(step * n as f64));
    let numbered = |n: u64, spots: &[[f64; 3]]| {
        let mut frame = frame(&at(n), spots, &lens, 30 + n);
        frame.sequence = n;
        frame
    };
    for n in 0..8 {
        let estimate = tracker.track(&numbered(n, &FLAT));
        assert_eq!(estimate.state, TrackState::Tracking, "{n} {:?}", estimate.rejection);
    }
    for n in 8..10 {
        let estimate = tracker.track(&numbered(n, &[]));
        assert_eq!(estimate.state, TrackState::Coasting);
        let variances = variances(&estimate);
        let off = at(n).translation - Vector3::from(estimate.pose.unwrap().position_mm);
        assert!(off.norm() < 1.5, "{n}: {off:?}");
        assert!(off.iter().zip(variances).all(|(off, variance)| off * off < 16.0 * variance), "{off:?} {variances:?}");
    }
    let back = tracker.track(&numbered(10, &FLAT));
    assert_eq!(back.state, TrackState::Tracking);
    assert_close(&back.pose.unwrap(), &at(10));
    let states: Vec<_> = (11..16).map(|n| tracker.track(&numbered(n, &[]))).collect();
    assert_eq!(states[0].state, TrackState::Coasting);
    assert!(states[4].state == TrackState::Lost && states[4].pose.is_none());
}

/// The orientation of an unseen target is held, with growing variance.
#[test]
fn the_orientation_of_a_pose_that_coasts_is_within_its_covariance() {
    let lens = lens(Distortion::None, &[]);
    let mut tracker = Tracker::new(model("three-spots-pose"), options(&lens)).unwrap();
    let step = Vector6::new(2.0, -1.0, 5.0, 0.01, 0.015, -0.02);
    let at = |n: u64| pose([0.3, 0.2, -0.4], [10.0, 20.0, 900.0]).moved(&(step * n as f64));
    let mut before = [0.0; 6];
    for n in 0..22 {
        let spots = if n < 12 { &FLAT[..] } else { &[] };
        let estimate = tracker.track(&frame(&at(n), spots, &lens, 30 + n).with_sequence(n));
        assert_eq!(estimate.state, if n < 12 { TrackState::Tracking } else { TrackState::Coasting }, "{n}");
        let now = variances(&estimate);
        if n >= 12 {
            let found = estimate.pose.unwrap();
            let off = at(n).to(&Rigid::of_quaternion(found.position_mm, found.orientation_xyzw));
            let is_within = |axis: usize| off[axis].powi(2) < 16.0 * now[axis];
            assert!((0..6).all(is_within), "{n}: {off:?} {now:?}");
            assert!((0..6).all(|axis| now[axis] > before[axis]), "{n}: {now:?} {before:?}");
            let turned = |axis: usize| step[axis] * (n - 11) as f64;
            assert!((3..6).all(|axis| now[axis].sqrt() < 2.0 * turned(axis).abs()), "{n}: {now:?}");
        }
        before = now;
    }
}

#[test]
fn long_rodrigues_parameters_are_folded() {
    let compiled = model("three-spots-pose");
    let constants: Vec<f64> = compiled.model().constants().iter().map(|c| c.value).collect();
    let geometry = Geometry::of(compiled.model(), &constants).unwrap();
    let mut parameters = vec![0.0; compiled.model().parameters().len()];
    let long = Vector3::new(0.8, -1.0, 0.9);
    geometry.orientation.iter().enumerate().for_each(|(i, id)| parameters[id.index()] = long[i]);
    let before = geometry.pose(&parameters);
    geometry.fold(&mut parameters);
    assert!((geometry.pose(&parameters).rotation - before.rotation).norm() < 1e-12);
    assert!(parameters[geometry.orientation[0].index()].abs() < 0.8);
}

/// Far away, the two tilts of one spot differ by less than the noise: both are published, the true one among them,
/// until frames have decided; near by there is no ambiguity.
#[test]
fn ambiguous_tilts_are_both_published() {
    let lens = lens(Distortion::None, &[]);
    let compiled = model("spot-pose");
    let mut doubtful = 0;
    for seed in 0..4 {
        let truth = pose([0.25, -0.1, 0.0], [40.0, 20.0, 3000.0]);
        let mut tracker = Tracker::new(compiled.clone(), options(&lens)).unwrap();
        for frame_number in 0..3 {
            let estimate = tracker.track(&frame(&truth, &[[0.0; 3]], &lens, 100 * seed + frame_number));
            let found = estimate.pose.unwrap();
            let others = found.alternatives.iter().map(|a| (a.position_mm, a.orientation_xyzw));
            let all: Vec<Rigid> = std::iter::once((found.position_mm, found.orientation_xyzw))
                .chain(others)
                .map(|(position, q)| Rigid::of_quaternion(position, q))
                .collect();
            let off = |p: &Rigid| p.rotation.column(2).angle(&truth.rotation.column(2));
            assert!(all.iter().map(off).fold(f64::INFINITY, f64::min) < 0.05, "{seed}: {all:?}");
            assert!(found.alternatives.iter().all(|a| (0.0..10.0).contains(&a.delta_chi_square)));
            doubtful += found.alternatives.len();
        }
    }
    assert!(doubtful > 0);
    let truth = pose([0.5, -0.4, 0.0], [40.0, 20.0, 400.0]);
    let mut tracker = Tracker::new(compiled, options(&lens)).unwrap();
    assert!(tracker.track(&frame(&truth, &[[0.0; 3]], &lens, 7)).pose.unwrap().alternatives.is_empty());
}

/// A session starts near the target but with the mirrored tilt: the first frame finds the true one.
#[test]
fn mirrored_start_is_corrected_in_the_first_frame() {
    let lens = lens(Distortion::None, &[]);
    for (name, spots) in [("three-spots-pose", &FLAT[..]), ("spot-pose", &[[0.0; 3]][..])] {
        let compiled = model(name);
        let truth = pose([0.5, -0.4, 0.0], [40.0, 20.0, 800.0]);
        let constants: Vec<f64> = compiled.model().constants().iter().map(|c| c.value).collect();
        let geometry = Geometry::of(compiled.model(), &constants).unwrap();
        let mut parameters = vec![0.0; compiled.model().parameters().len()];
        geometry.put(&truth, &mut parameters);
        let mirrored = geometry.mirrored(&parameters).swap_remove(0);
        let named = geometry.position.iter().chain(&geometry.orientation);
        let start = named.map(|id| (compiled.model().parameters()[id.index()].name.clone(), mirrored[id.index()]));
        let begun = TrackerOptions { start: start.collect(), ..options(&lens) };
        let estimate = Tracker::new(compiled, begun).unwrap().track(&frame(&truth, spots, &lens, 40));
        let found = estimate.pose.unwrap_or_else(|| panic!("{name}: {:?}", estimate.rejection));
        let normal = Rigid::of_quaternion(found.position_mm, found.orientation_xyzw).rotation.column(2).into_owned();
        assert!(normal.angle(&truth.rotation.column(2).into_owned()) < 0.02, "{name}: {normal}");
    }
}

/// Half of a spot, glare beside it, and two spots are hidden while the target is tracked: hidden spots are left out and
/// named, or there is no pose.
#[test]
fn hidden_spots_do_not_move_the_pose() {
    let lens = lens(Distortion::None, &[]);
    let at = |step: f64| pose([0.3, 0.2, -0.4], [10.0, 20.0, 900.0]).moved(&(Vector6::repeat(0.004) * step));
    let spot = |number: usize| lens.project(at(3.0).apply(Vector3::from(FLAT[number])).into()).unwrap();
    let half = |[x, y]: [f64; 2], value: f64| {
        let is_near = (x - spot(0)[0]).hypot(y - spot(0)[1]) < 30.0 && x > spot(0)[0];
        if is_near && value > 20.0 { 20.0 } else { value }
    };
    let whole = |[x, y]: [f64; 2], value: f64| {
        let is_near = (x - spot(0)[0]).hypot(y - spot(0)[1]) < 30.0;
        if is_near { 90.0 } else { value }
    };
    let glare = |[x, y]: [f64; 2], value: f64| {
        let away = (x - spot(1)[0] - 20.0).hypot(y - spot(1)[1] - 15.0);
        value + 140.0 * (-0.5 * (away / 12.0).powi(2)).exp()
    };
    let two = |place: [f64; 2], value: f64| {
        let is_near = |number: usize| (place[0] - spot(number)[0]).hypot(place[1] - spot(number)[1]) < 30.0;
        if is_near(0) || is_near(1) { 20.0 } else { value }
    };
    let veils: [(Veil, Option<&[&str]>); 4] =
        [(&half, Some(&[])), (&whole, Some(&["red"])), (&glare, Some(&["green"])), (&two, None)];
    let compiled = model("three-spots-pose");
    for (number, (veil, left_out)) in veils.into_iter().enumerate() {
        let mut tracker = Tracker::new(compiled.clone(), options(&lens)).unwrap();
        for step in 0..3_u32 {
            assert_close(
                &tracker.track(&frame(&at(f64::from(step)), &FLAT, &lens, 50 + u64::from(step))).pose.unwrap(),
                &at(f64::from(step)),
            );
        }
        let estimate = tracker.track(&veiled(&at(3.0), &FLAT, &lens, 60, veil));
        let Some(left_out) = left_out else {
            assert_eq!(estimate.state, TrackState::Coasting, "{number}");
            continue;
        };
        assert_eq!(estimate.state, TrackState::Tracking, "{number}: {:?}", estimate.rejection);
        let found = estimate.pose.unwrap();
        assert_eq!(found.left_out, left_out, "{number}");
        assert!(estimate.substitute.is_some_and(|substitute| substitute.hidden > 0.0));
        assert_close(&found, &at(3.0));
    }
}

#[path = "names_tests.rs"]
mod names;
