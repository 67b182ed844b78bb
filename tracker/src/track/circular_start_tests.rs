//! The thesis' first guess (section 4.2.2): a circular spot that covers the whole 640 × 480 fragment, a1 = a3 = 6.25e-6, i.e.
//! a radius of 400 px, with the fragment's centre. Stages that start there:
//!
//! - The thesis' stages, {b} and then {a}, fail: with a spot as large as the fragment, b diverges from the target. The
//!   tracker reports it.
//! - {b, a, v} at once fails: as a → 0 and v1 → ∞ the cubic becomes a paraboloid, which fits a small spot better than the
//!   wide cubic does, so F decreases that way. The tracker reports it.
//! - {b, a} at once with v from the histogram, then {b, a, v}, converges from the fragment's centre, if the domain extends past
//!   the rim and the method is Levenberg–Marquardt.
//! - {a} alone with b at the centroid, then {b, a, v}, converges, with the thesis' own model and Newton.

#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::{Falloff, Spot, TestPicture};
use isophote_symbolic::{Model, Precision};

const SPOT: &str = include_str!("../../../tests/documents/plain-spot.toml");
const THESIS: &str = include_str!("../../../models/thesis-spot.toml");
const FRAGMENT: [(&str, f64); 2] = [("bx", 319.5), ("by", 239.5)];
const TRUTH: Spot = Spot {
    centre: [330.0, 236.0],
    half: [72.0, 52.0],
    angle: 0.3,
    amplitude: 150.0,
    profile: Falloff::Cubic(-0.5, -0.3),
};

/// The document with other stages; `None` keeps its own.
fn fitted(document: &str, stages: Option<&[(&str, &str)]>, centre: &[(&str, f64)]) -> (Tracker, Estimate) {
    let mut text = document.to_string();
    if let Some(stages) = stages {
        text.truncate(text.find("[[stages]]").unwrap());
        for (parameters, method) in stages {
            let names = parameters.replace(' ', "\", \"");
            text += &format!("[[stages]]\nparameters = [\"{names}\"]\nmethod = \"{method}\"\niterations = 100\n");
        }
    }
    let model = Model::from_toml(&text).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let circle = [("a1", 6.25e-6), ("a2", 0.0), ("a3", 6.25e-6)];
    let start = circle.iter().chain(centre).map(|(name, value)| (name.to_string(), *value)).collect();
    let mut tracker = Tracker::new(compiled, TrackerOptions { start, ..TrackerOptions::default() }).unwrap();
    let estimate = tracker.track(&TestPicture::new(640, 480, vec![TRUTH]).frame());
    (tracker, estimate)
}

/// The error of the centre, px, and the relative error of the area.
fn errors((tracker, estimate): &(Tracker, Estimate)) -> (f64, f64) {
    assert_eq!((estimate.state, estimate.ending), (TrackState::Tracking, Ending::SmallStep), "{estimate:?}");
    let value = |name: &str| estimate.parameters[tracker.compiled().model().parameter(name).unwrap().index()];
    let area = 1.0 / (value("a1") * value("a3") - value("a2").powi(2)).sqrt();
    ((value("bx") - TRUTH.centre[0]).hypot(value("by") - TRUTH.centre[1]), area / (TRUTH.half[0] * TRUTH.half[1]) - 1.0)
}

#[test]
fn position_and_shape_then_all_converge_from_the_fragment_centre() {
    let stages = [("bx by a1 a2 a3", "levenberg-marquardt"), ("bx by a1 a2 a3 v0 v1", "levenberg-marquardt")];
    let (off, area) = errors(&fitted(SPOT, Some(&stages), &FRAGMENT));
    assert!(off < 0.01 && area.abs() < 0.002, "{off} {area}");
}

#[test]
fn shape_alone_converges_from_the_centroid() {
    let stages = [("a1 a2 a3", "newton"), ("bx by a1 a2 a3 v0 v1", "levenberg-marquardt")];
    for (document, size) in [(SPOT, 0.002), (THESIS, 0.02)] {
        let (off, area) = errors(&fitted(document, Some(&stages), &[]));
        assert!(off < 0.01 && area.abs() < size, "{off} {area}");
    }
}

#[test]
fn failing_stages_are_reported() {
    let all = [("bx by a1 a2 a3 v0 v1", "levenberg-marquardt")];
    for (document, stages) in [(THESIS, None), (THESIS, Some(&all[..])), (SPOT, Some(&all[..]))] {
        for centre in [&FRAGMENT[..], &[]] {
            let (_, estimate) = fitted(document, stages, centre);
            assert_eq!(estimate.state, TrackState::Searching, "{estimate:?}");
            assert!(estimate.parameters.is_empty() || !estimate.converged, "{estimate:?}");
        }
    }
}
