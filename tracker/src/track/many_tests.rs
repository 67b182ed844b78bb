//! Many targets of one document in a picture.

use std::collections::BTreeSet;
use std::sync::Arc;

use isophote_symbolic::{Model, Precision};

use crate::picture::{Spot, TestPicture};
use crate::{Compiled, Estimate, TrackState, Tracker, TrackerOptions};

/// Estimates of the first frame of a picture of these spots.
fn estimates(spots: Vec<Spot>, options: TrackerOptions) -> Vec<Estimate> {
    let text = include_str!("../../../models/gaussian.toml");
    let compiled = Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap());
    let frame = TestPicture { noise: 1.5, ..TestPicture::new(320, 320, spots) }.frame();
    Tracker::new(compiled, options).unwrap().track_all(&frame)
}

/// Eight by eight spots, 40 px apart.
fn grid(half: impl Fn(usize) -> f64, amplitude: impl Fn(usize) -> f64) -> Vec<Spot> {
    let place = |at: usize| 20.3 + 40.0 * at as f64;
    (0..64).map(|i| Spot::at(place(i % 8), place(i / 8), half(i), amplitude(i))).collect()
}

/// The cells of the grid in which targets are tracked.
fn cells(estimates: &[Estimate]) -> BTreeSet<usize> {
    let tracked = estimates.iter().filter(|estimate| estimate.state == TrackState::Tracking);
    let cell = |at: f64| ((at - 0.3) / 40.0) as usize;
    tracked.map(|estimate| cell(estimate.parameters[0]) + 8 * cell(estimate.parameters[1])).collect()
}

#[test]
fn all_targets_of_a_picture_are_found_in_its_first_frame() {
    let options = TrackerOptions { targets: 64, ..TrackerOptions::default() };
    let found = estimates(grid(|_| 8.0, |_| 120.0), options);
    assert_eq!(cells(&found).len(), 64);
    let all = TrackerOptions { targets: 200, snr_min: Some(8.0), ..TrackerOptions::default() };
    let found = estimates(grid(|_| 8.0, |_| 120.0), all);
    let tracked = found.iter().filter(|estimate| estimate.state == TrackState::Tracking).count();
    assert_eq!((cells(&found).len(), tracked), (64, 64));
}

#[test]
fn targets_have_a_wanted_size_and_brightness() {
    // Every other row and column: noise is measured between targets.
    let is_kept = |i: usize| i.is_multiple_of(2) && (i / 8).is_multiple_of(2);
    let is_large = |i: usize| i.is_multiple_of(8);
    let is_faint = |i: usize| i / 8 == 0;
    let half = |i: usize| if is_large(i) { 16.0 } else { 6.0 };
    let amplitude = |i: usize| if is_faint(i) { 8.0 } else { 90.0 };
    let kept = || (0..64).filter(|i| is_kept(*i));
    let spots = || kept().map(|i| grid(half, amplitude)[i]).collect();
    let options = |snr_min, sizes_px| TrackerOptions { targets: 64, snr_min, sizes_px, ..TrackerOptions::default() };
    let small = estimates(spots(), options(Some(8.0), Some([2.0, 6.0])));
    assert_eq!(cells(&small), kept().filter(|i| !is_large(*i)).collect());
    let bright = estimates(spots(), options(Some(50.0), Some([2.0, 6.0])));
    assert_eq!(cells(&bright), kept().filter(|i| !is_large(*i) && !is_faint(*i)).collect());
}
