//! One fit of one frame, with names.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_jit::Window;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Camera, Compiled, Estimate, Frame, TrackState, Tracker, TrackerOptions};

use crate::accuracy::document::semi_axes;

/// Parameters by name, of a fit that was believed.
pub type Fitted = BTreeMap<String, f64>;

/// A document, ready.
pub fn compiled(text: &str) -> Arc<Compiled> {
    Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap())
}

/// What a fresh tracker says of a frame, and its standard deviation of the centre's first coordinate.
pub fn fit(
    document: &Arc<Compiled>,
    frame: &Frame,
    window: Option<Window>,
    limit: f64,
    start: &Fitted,
) -> Option<Fitted> {
    let camera = Camera { saturation: Some(limit), ..Camera::default() };
    let options = TrackerOptions { window, start: start.clone(), camera, ..TrackerOptions::default() };
    let estimate: Estimate = Tracker::new(document.clone(), options).unwrap().track(frame);
    let names = document.model().parameters().iter().map(|parameter| parameter.name.clone());
    (estimate.state == TrackState::Tracking).then(|| names.zip(estimate.parameters).collect())
}

/// Semi-axes of the outline, px.
pub fn axes(fitted: &Fitted) -> [f64; 2] {
    semi_axes([fitted["a1"], fitted["a2"], fitted["a3"]])
}
