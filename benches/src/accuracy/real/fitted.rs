//! A fit of one frame, by parameter names.

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_jit::Window;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{CONFIDENCE_MIN, Camera, Compiled, Frame, TrackState, Tracker, TrackerOptions};

use crate::accuracy::document::semi_axes;

/// Parameters by name.
pub type Fitted = BTreeMap<String, f64>;

/// A compiled document.
pub fn compiled(text: &str) -> Arc<Compiled> {
    Arc::new(Compiled::new(Arc::new(Model::from_toml(text).unwrap()), Precision::F32).unwrap())
}

/// A fit, whether likely to be the target or not.
pub struct Seen {
    /// All parameters of the model.
    pub fitted: Fitted,
    /// Whether it is `tracking` with default options.
    pub is_tracked: bool,
}

/// Fits a frame of a camera with that limit, with fresh trackers.
pub fn fit(
    document: &Arc<Compiled>,
    frame: &Frame,
    window: Option<Window>,
    limit: f64,
    start: &Fitted,
) -> Option<Seen> {
    let track = |confidence_min: f64| {
        let camera = Camera { saturation: Some(limit), ..Camera::default() };
        let options =
            TrackerOptions { window, start: start.clone(), camera, confidence_min, ..TrackerOptions::default() };
        Tracker::new(document.clone(), options).unwrap().track(frame)
    };
    let estimate = track(0.0);
    if estimate.state != TrackState::Tracking {
        return None;
    }
    let names = document.model().parameters().iter().map(|parameter| parameter.name.clone());
    let is_tracked = track(CONFIDENCE_MIN).state == TrackState::Tracking;
    Some(Seen { fitted: names.zip(estimate.parameters).collect(), is_tracked })
}

/// Semi-axes of the outline, px.
pub fn axes(fitted: &Fitted) -> [f64; 2] {
    semi_axes([fitted["a1"], fitted["a2"], fitted["a3"]])
}
