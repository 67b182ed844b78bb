//! Hot pixels, bad columns and defect maps, in models that censor saturated pixels.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::camera::DefectMap;
use crate::picture::{Falloff, Spot, TestPicture};
use isophote_frame::Plane;
use isophote_jit::PixelFormat;
use isophote_symbolic::Precision;

/// A hundred spots with one pixel, anywhere in the domain, stuck at the camera's limit.
#[test]
fn a_hot_pixel_does_not_shift_an_estimate() {
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
        let (centre, summary) = ask(1e-3, &frame);
        moved += way(centre) / frames as f64;
        fooled += way(ask(0.0, &frame).0) / frames as f64;
        nees += error_of([centre[0] - truth.centre[0], centre[1] - truth.centre[1]], &summary) / frames as f64;
    }
    // A hot pixel costs no more than a missing one; taken for light it shifts the centre significantly.
    assert!(moved.sqrt() < 0.1 && fooled.sqrt() > 0.5, "{moved} {fooled}");
    assert!((1.4..2.6).contains(&nees), "{nees}"); // 2 ± 3 · 2/√100
}

/// Pixels with dark charge below the limit, and a bad column: taken for light they shift an estimate; with the map they have no
/// effect.
#[test]
fn mapped_defects_are_excluded() {
    let model = Arc::new(Model::from_toml(include_str!("../../../models/spot.toml")).unwrap());
    let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
    let ask = |map: Option<DefectMap>, frame: &Frame, start: bool| {
        let constants = [("gain", 0.0), ("read_noise", (9.0 + 1.0 / 12.0_f64).sqrt())];
        let constants = constants.map(|(name, value)| (name.to_string(), value)).into();
        let camera = crate::Camera { defect_map: map, ..crate::Camera::default() };
        let options = TrackerOptions { constants, camera, ..TrackerOptions::default() };
        let mut tracker = Tracker::new(compiled.clone(), options).unwrap();
        // Cold or, with `start`, after an earlier frame.
        (0..if start { 2 } else { 1 }).map(|_| tracker.track(frame)).last().unwrap()
    };
    let (mut fooled, mut nees) = (0, 0.0);
    let frames = 60;
    for seed in 0..frames {
        let centre = [39.6 + 0.37 * (seed % 7) as f64, 40.9];
        let profile = Falloff::Cubic(-0.5, -0.3);
        let amplitude = if seed % 2 == 0 { 120.0 } else { 290.0 };
        let truth = Spot { centre, half: [20.0, 14.0], angle: 0.3, amplitude, profile };
        let picture = TestPicture { noise: 3.0, seed, samples: 4, ..TestPicture::new(80, 80, vec![truth]) };
        let mut bytes: Vec<u8> = picture.pixels().iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect();
        let mut at = seed.wrapping_mul(7_919) as usize;
        let mut pixels: Vec<[u32; 2]> = Vec::new();
        for number in 0..32_usize {
            at = (at + 2_311) % 6_400;
            pixels.push([(at % 80) as u32, (at / 80) as u32]);
            bytes[at] = (bytes[at] as usize + 40 + 5 * number).min(254) as u8;
        }
        (0..80).for_each(|y| bytes[y * 80 + 33] = 7);
        let map = DefectMap { width: 80, height: 80, pixels, columns: vec![33], ..DefectMap::default() };
        let frame = Frame::new(&[80, 80], vec![Plane::owned(PixelFormat::U8, bytes, 80)]).unwrap();
        let away = |estimate: &Estimate| {
            let c = estimate.covariance.as_ref().unwrap();
            let [x, y] = ["bx", "by"].map(|name| compiled.model().parameter(name).unwrap().index());
            let (x, y) = (estimate.parameters[x] - centre[0], estimate.parameters[y] - centre[1]);
            (c[1][1] * x * x - 2.0 * c[0][1] * x * y + c[0][0] * y * y) / (c[0][0] * c[1][1] - c[0][1] * c[1][0])
        };
        let estimate = ask(Some(map.clone()), &frame, seed % 3 == 0);
        assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
        // Some 1,900 pixels in the domain, up to 50 of them in the column.
        assert!(estimate.left_out.is_some_and(|count| (30..90).contains(&count)), "{estimate:?}");
        let whole = estimate.pixels + estimate.left_out.unwrap();
        let fits = (0.9..1.2).contains(&estimate.reduced_chi_square.unwrap());
        assert!(fits && (1_500..2_500).contains(&whole), "{estimate:?}");
        nees += away(&estimate) / frames as f64;
        let without = ask(None, &frame, false);
        assert_eq!(without.left_out, None);
        let misfits = without.substitute.is_some() || without.reduced_chi_square.is_some_and(|reduced| reduced > 1.5);
        fooled += usize::from(without.state != TrackState::Tracking || misfits);
    }
    assert_eq!(fooled, frames as usize, "without the map nothing fits");
    assert!((1.3..2.8).contains(&nees), "{nees}"); // 2 ± 3 · 2/√60
}

/// Values inside a wide gap have no effect: 20 columns at the limit, through the target.
#[test]
fn values_inside_a_wide_gap_are_ignored() {
    let model = Arc::new(Model::from_toml(include_str!("../../../models/spot.toml")).unwrap());
    let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
    let profile = Falloff::Cubic(-0.5, -0.3);
    let truth = Spot { centre: [40.3, 40.9], half: [20.0, 14.0], angle: 0.3, amplitude: 150.0, profile };
    let picture = TestPicture { noise: 3.0, seed: 1, samples: 4, ..TestPicture::new(80, 80, vec![truth]) };
    let columns = 36..56;
    let ask = |reads: &dyn Fn(usize) -> u16| {
        let value = |(pixel, value): (usize, f64)| match columns.contains(&(pixel % 80)) {
            true => reads(pixel),
            false => value.round().clamp(0.0, 65_535.0) as u16,
        };
        let bytes = picture.pixels().into_iter().enumerate().map(value).flat_map(u16::to_le_bytes).collect();
        let frame = Frame::new(&[80, 80], vec![Plane::owned(PixelFormat::U16, bytes, 80)]).unwrap();
        let map = DefectMap {
            width: 80,
            height: 80,
            columns: columns.clone().map(|x| x as u32).collect(),
            ..DefectMap::default()
        };
        let camera = crate::Camera { saturation: Some(4_095.0), defect_map: Some(map), ..crate::Camera::default() };
        let constants = [("gain", 0.0), ("read_noise", (9.0 + 1.0 / 12.0_f64).sqrt())];
        let constants = constants.map(|(name, value)| (name.to_string(), value)).into();
        let options = TrackerOptions { constants, camera, ..TrackerOptions::default() };
        Tracker::new(compiled.clone(), options).unwrap().track(&frame)
    };
    let estimate = ask(&|_| 65_535);
    assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
    assert!((0.9..1.15).contains(&estimate.reduced_chi_square.unwrap()), "{estimate:?}");
    for (name, should) in [("bx", 40.3), ("by", 40.9)] {
        let parameter = compiled.model().parameter(name).unwrap();
        let error = estimate.parameters[parameter.index()] - should;
        assert!(error.abs() < 4.0 * estimate.deviation(parameter).unwrap(), "{name}: {error}");
    }
    let others: [&dyn Fn(usize) -> u16; 2] = [&|_| 0, &|pixel| (pixel * 40_503 % 65_536) as u16];
    for reads in others {
        let other = ask(reads);
        assert_eq!((&other.parameters, &other.covariance), (&estimate.parameters, &estimate.covariance));
        assert_eq!(other.reduced_chi_square, estimate.reduced_chi_square);
    }
}

/// A map of another frame size is an error, and such frames are not fitted.
#[test]
fn a_map_of_another_size_is_rejected() {
    let model = Arc::new(Model::from_toml(include_str!("../../../models/spot.toml")).unwrap());
    let compiled = Arc::new(Compiled::new(model.clone(), Precision::F32).unwrap());
    let map = DefectMap { width: 90, height: 80, pixels: vec![[3, 3]], ..DefectMap::default() };
    let camera = crate::Camera { defect_map: Some(map), ..crate::Camera::default() };
    let options = TrackerOptions { camera, ..TrackerOptions::default() };
    let frame = TestPicture::new(80, 80, vec![Spot::at(40.0, 40.0, 20.0, 150.0)]).frame();
    let message = options.check_size(&model, frame.size()).unwrap_err().to_string();
    assert!(message.contains("90 × 80 px") && message.contains("80 × 80 px"), "{message}");
    let mut tracker = Tracker::new(compiled, options).unwrap();
    assert_eq!(tracker.track(&frame).ending, Ending::WrongFrame);
}
