#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::{Falloff, Spot, TestPicture};
use crate::sight::grey::Mixture;
use isophote_jit::Window;

fn find_in(picture: &TestPicture, options: &FindOptions) -> Vec<Detection> {
    let frame = picture.frame();
    find(
        &Grey::read(
            &[frame.plane_view(0)],
            Window::whole(picture.width, picture.height),
            &[picture.saturation],
            &Mixture::mean(1),
        ),
        options,
        &|_| Ok(()),
    )
    .unwrap()
    .detections
}

/// xx, xy, yy.
fn upper(extent: [[f64; 4]; 4]) -> [f64; 3] {
    [extent[0][0], extent[0][1], extent[1][1]]
}

/// Half axes and angle of a detected outline.
fn axes(extent: [[f64; 4]; 4]) -> (f64, f64) {
    let [a, b, c] = upper(extent);
    let (mean, root) = (0.5 * (a + c), (0.25 * (a - c).powi(2) + b * b).sqrt());
    (1.0 / (mean - root).sqrt(), 1.0 / (mean + root).sqrt())
}

#[test]
fn spots_of_every_size_in_a_noisy_full_frame() {
    // Half axes, amplitude, noise, tolerance of the centre.
    for (half, amplitude, noise, off) in [
        ([5.0, 3.5], 150.0, 0.0, 0.3),
        ([5.0, 5.0], 150.0, 3.0, 0.7),
        ([20.0, 14.0], 30.0, 3.0, 1.5),
        ([60.0, 42.0], 150.0, 0.0, 0.1),
        ([60.0, 42.0], 60.0, 5.0, 1.0),
        ([200.0, 140.0], 150.0, 5.0, 1.0),
        ([20.0, 20.0], -15.0, 1.0, 1.0),
        ([200.0, 200.0], 400.0, 2.0, 1.0), // saturated
        ([20.0, 14.0], 900.0, 2.0, 0.3),   // heavily
    ] {
        for seed in 0..4 {
            let spot = Spot { half, angle: 0.7, ..Spot::at(330.3, 238.6, 1.0, amplitude) };
            let picture = TestPicture { noise, seed, ..TestPicture::new(640, 480, vec![spot]) };
            let found = find_in(&picture, &FindOptions::default());
            let case = format!("{half:?} {amplitude} {noise} seed {seed}: {found:?}");
            assert_eq!(found.len(), 1, "{case}");
            let found = &found[0];
            assert!((found.centre[0] - 330.3).hypot(found.centre[1] - 238.6) < off, "{case}");
            let (long, short) = axes(found.extent);
            assert!(long > 0.6 * half[0] && long < 1.7 * half[0] + 1.0, "{long} {case}");
            assert!(short > 0.6 * half[1] && short < 1.7 * half[1] + 1.0, "{short} {case}");
            let visible = amplitude.min(235.0);
            assert!((found.amplitude / visible - 1.0).abs() < 0.35, "{case}");
            assert!((found.background - 20.0).abs() < 1.0 + noise, "{case}");
        }
    }
}

#[test]
fn tilted_outlines_keep_their_angle() {
    let spot = Spot { half: [40.0, 15.0], angle: 0.5, ..Spot::at(100.0, 90.0, 1.0, 150.0) };
    let found = &find_in(&TestPicture::new(200, 180, vec![spot]), &FindOptions::default())[0];
    for (is, should) in upper(found.extent).iter().zip(spot.extent()) {
        assert!((is / should - 1.0).abs() < 0.4, "{is} {should}");
    }
}

#[test]
fn a_dark_disc_on_bright_ground() {
    let disc = Spot { profile: Falloff::Disc, ..Spot::at(400.0, 200.0, 30.0, -120.0) };
    let picture =
        TestPicture { ground: 200.0, noise: 4.0, slope: [0.02, -0.03], ..TestPicture::new(640, 480, vec![disc]) };
    let found = &find_in(&picture, &FindOptions::default())[0];
    assert!((found.centre[0] - 400.0).hypot(found.centre[1] - 200.0) < 0.3, "{found:?}");
    assert!((found.amplitude + 120.0).abs() < 15.0 && (found.background - 202.0).abs() < 3.0, "{found:?}");
    assert!(find_in(&picture, &FindOptions { sign: Some(Sign::Bright), ..FindOptions::default() }).is_empty());
}

#[test]
fn the_most_massive_target_is_first_unless_a_position_is_given() {
    let spots = vec![
        Spot::at(100.0, 100.0, 12.0, 120.0),
        Spot::at(450.0, 300.0, 40.0, 110.0),
        Spot::at(300.0, 60.0, 6.0, 235.0),
        Spot::at(550.0, 100.0, 25.0, 60.0),
    ];
    let picture = TestPicture { noise: 3.0, ..TestPicture::new(640, 480, spots.clone()) };
    let all = find_in(&picture, &FindOptions { targets_max: 9, ..FindOptions::default() });
    assert_eq!(all.len(), 4, "{all:?}");
    assert!((all[0].centre[0] - 450.0).abs() < 1.0, "{all:?}");
    for (spot, off) in spots.iter().zip([[8.0, -3.0], [40.0, 20.0], [0.0, 15.0], [-30.0, 20.0]]) {
        let near = Some([spot.centre[0] + off[0], spot.centre[1] + off[1], 0.0, 0.0]);
        let found = find_in(&picture, &FindOptions { near, ..FindOptions::default() });
        assert_eq!(found.len(), 1);
        assert!((found[0].centre[0] - spot.centre[0]).abs() < 1.0, "{spot:?} {found:?}");
        assert!((found[0].size[0] / spot.half[0] - 1.0).abs() < 0.5, "{spot:?} {found:?}");
    }
}

#[test]
fn on_a_slanting_ground() {
    let picture = TestPicture {
        slope: [0.8, 0.5],
        noise: 2.0,
        ..TestPicture::new(96, 96, vec![Spot::at(40.0, 50.0, 20.0, 120.0)])
    };
    let found = &find_in(&picture, &FindOptions::default())[0];
    assert!((found.centre[0] - 40.0).hypot(found.centre[1] - 50.0) < 1.0, "{found:?}");
    assert!((found.background - (20.0 + 32.0 + 25.0)).abs() < 4.0, "{found:?}");
}

#[test]
fn noise_and_hot_pixels_are_no_targets() {
    for seed in 0..10 {
        assert!(
            find_in(&TestPicture { noise: 5.0, seed, ..TestPicture::new(640, 480, vec![]) }, &FindOptions::default())
                .is_empty(),
            "{seed}"
        );
    }
    let hot = vec![Spot { profile: Falloff::Disc, ..Spot::at(20.0, 20.0, 0.9, 200.0) }];
    assert!(find_in(&TestPicture { noise: 1.0, ..TestPicture::new(64, 64, hot) }, &FindOptions::default()).is_empty());
    assert!(find_in(&TestPicture::new(64, 64, vec![]), &FindOptions::default()).is_empty());
    assert!(find_in(&TestPicture::new(1, 1, vec![]), &FindOptions::default()).is_empty());
}

#[test]
fn one_dimension() {
    for noise in [0.0, 3.0] {
        let picture = TestPicture { noise, ..TestPicture::new(400, 1, vec![Spot::at(170.4, 0.0, 30.0, 120.0)]) };
        let found = &find_in(&picture, &FindOptions::default())[0];
        assert!((found.centre[0] - 170.4).abs() < 1.0 && found.centre[1] == 0.0, "{found:?}");
        assert!(
            (found.size[0] / 30.0 - 1.0).abs() < 0.3 && (found.extent[0][0] * 900.0 - 1.0).abs() < 0.6,
            "{found:?}"
        );
        assert!((found.amplitude - 120.0).abs() < 15.0, "{found:?}");
    }
}

#[test]
fn saturated_pixels_are_counted_and_do_not_change_the_extent() {
    let sizes: Vec<f64> = [200.0, 400.0, 800.0]
        .iter()
        .map(|&amplitude| {
            let found = find_in(
                &TestPicture::new(200, 200, vec![Spot::at(100.0, 100.0, 40.0, amplitude)]),
                &FindOptions::default(),
            )
            .remove(0);
            assert_eq!(found.saturated > 10, amplitude > 235.0, "{found:?}");
            found.size[0]
        })
        .collect();
    assert!(sizes.iter().all(|size| (size / 40.0 - 1.0).abs() < 0.35), "{sizes:?}");
}

/// Gaussian blobs in three and four dimensions: the outline is the contour at 1/e² of the peak.
#[test]
fn blobs_in_volumes() {
    for size in [[40, 36, 24, 1], [24, 22, 16, 12]] {
        let dimensions = if size[3] > 1 { 4 } else { 3 };
        let (centre, half) = ([18.3, 14.8, 9.4, 5.2], [9.0, 7.0, 5.0, 4.0]);
        let count: usize = size.iter().product();
        let value = |i: usize| {
            let place = place_of(i, size);
            let s: f64 = (0..dimensions).map(|axis| ((place[axis] - centre[axis]) / half[axis]).powi(2)).sum();
            20.0 + 0.1 * place[2] + 150.0 * (-2.0 * s).exp()
        };
        let grey = Grey { values: (0..count).map(value).collect(), size, saturation: 255.0, step: 1.0 };
        let found = find(&grey, &FindOptions::default(), &|_| Ok(())).unwrap().detections;
        assert_eq!(found.len(), 1, "{found:?}");
        let found = &found[0];
        for axis in 0..4 {
            let (is, should) = (found.centre[axis], if axis < dimensions { centre[axis] } else { 0.0 });
            assert!((is - should).abs() < 0.5, "{found:?}");
            let size = found.size[axis] / half[axis];
            assert!(if axis < dimensions { (0.5..1.7).contains(&size) } else { size == 0.0 }, "{found:?}");
        }
        assert!((found.amplitude / 150.0 - 1.0).abs() < 0.35 && found.extent[0][2].abs() < 1e-3, "{found:?}");
        let far = FindOptions { near: Some([1.0, 2.0, 3.0, 4.0]), ..FindOptions::default() };
        assert_eq!(find(&grey, &far, &|_| Ok(())).unwrap().detections, std::slice::from_ref(found));
    }
}

/// Without noise and rounding no level is the lowest: their number is bounded, and each is charged.
#[test]
fn every_level_of_a_search_is_charged() {
    use std::sync::atomic::{AtomicU64, Ordering};
    let value = |i: usize| {
        let (x, y) = ((i % 64) as f64 - 30.0, (i / 64) as f64 - 20.0);
        1e9 * (1.0 - 0.01 * (x * x + y * y)).max(0.0)
    };
    let grey =
        Grey { values: (0..64 * 48).map(value).collect(), size: [64, 48, 1, 1], saturation: f64::INFINITY, step: 0.0 };
    let options = FindOptions { faint: true, targets_max: 24, ..FindOptions::default() };
    let asked = AtomicU64::new(0);
    let count = |_: u64| -> Result<(), Stop> {
        asked.fetch_add(1, Ordering::Relaxed);
        Ok(())
    };
    assert_eq!(find(&grey, &options, &count).unwrap().detections.len(), 1);
    let all = asked.load(Ordering::Relaxed);
    // Both signs, all levels, and the one target measured.
    assert_eq!(all, 2 + LEVELS_MAX as u64 + 1);
    for last in 0..all {
        let left = AtomicU64::new(last);
        let stop = |_: u64| {
            let more = left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
            more.map(drop).map_err(|_| Stop::Cancelled)
        };
        assert_eq!(find(&grey, &options, &stop), Err(Stop::Cancelled), "after {last}");
    }
}

#[test]
fn implausibly_bright_lone_pixels_and_lines_are_no_targets() {
    let spot = Spot { half: [9.0, 7.0], ..Spot::at(30.3, 21.7, 1.0, 150.0) };
    let picture = TestPicture { noise: 1.5, ..TestPicture::new(64, 48, vec![spot]) };
    let pixels = picture.pixels();
    let find_in = |spoiled: &[(usize, f32)], options: &FindOptions| {
        let mut values: Vec<f32> = pixels.iter().map(|value| *value as f32).collect();
        spoiled.iter().for_each(|(i, value)| values[*i] = *value);
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
        let plane = isophote_jit::PlaneView::new(isophote_jit::PixelFormat::F32, &bytes, 64, 48, 256, 4).unwrap();
        let grey = Grey::read(&[plane], Window::whole(64, 48), &[f64::INFINITY], &Mixture::mean(1));
        find(&grey, options, &|_| Ok(())).unwrap().detections
    };
    for faint in [false, true] {
        let options = FindOptions { faint, targets_max: 1, ..FindOptions::default() };
        let clean = find_in(&[], &options);
        assert_eq!(clean.len(), 1);
        let column: Vec<(usize, f32)> = (0..48).map(|y| (64 * y + 4, 1e15)).collect();
        let row: Vec<(usize, f32)> = (0..64).map(|x| (64 * 3 + x, -1e15)).collect();
        for spoiled in [&[(325, 1e9)][..], &[(325, -1e9), (2000, 1e14)], &column, &row, &[(325, f32::NAN), (326, 1e9)]]
        {
            let found = find_in(spoiled, &options);
            assert_eq!(found.len(), 1, "{spoiled:?}");
            let off = (found[0].centre[0] - clean[0].centre[0]).hypot(found[0].centre[1] - clean[0].centre[1]);
            assert!(off < 0.2, "{off} {spoiled:?}");
        }
    }
}
