//! `Bank`: the templates of a document for all sizes, each rendered on first use.

use std::sync::OnceLock;

use isophote_symbolic::{Estimator, Model, Start};

use super::template::Template;

/// The smallest half width, px: two pixels at full resolution; each next size is larger by √2.
const SIZE_MIN_PX: f64 = 2.0;
/// Sizes per octave.
const OF_LEVEL: usize = 2;
/// Number of sizes: up to 2 · 2^(17/2) px.
const SIZES: usize = 18;
/// Least width and height of a picture, in half widths.
const SIDE_MIN: f64 = 3.0;

/// The templates of a detector.
pub(crate) struct Bank {
    /// One per size; a single one for a document that states its target's size. `None`: cannot be rendered at that size.
    rendered: Vec<OnceLock<Option<Template>>>,
}

impl Bank {
    /// For documents of one target with a centre, in two dimensions; `None` for others.
    pub fn of(model: &Model) -> Option<Bank> {
        let [roles] = model.roles() else { return None };
        let is_suited = model.coordinates().len() == 2
            && roles.centre.len() == 2
            && roles.position.is_empty()
            && model.entries() == 1;
        let count = if is_sized(model) { SIZES } else { 1 };
        is_suited.then(|| Bank { rendered: (0..count).map(|_| OnceLock::new()).collect() })
    }

    /// The templates with a half width in a range, for pictures with this shorter side.
    pub(super) fn templates(
        &self,
        model: &Model,
        constants: &[f64],
        [low, high]: [f64; 2],
        side: usize,
    ) -> Vec<&Template> {
        let fits = |size: f64| SIDE_MIN * size <= side as f64;
        if let [only] = &self.rendered[..] {
            let levels = 0..SIZES / OF_LEVEL;
            let render = || levels.into_iter().find_map(|level| Template::render(model, constants, SIZE_MIN_PX, level));
            let is_seen = |template: &&Template| fits(template.size_px * 2.0_f64.powi(template.level as i32));
            return only.get_or_init(render).iter().filter(is_seen).collect();
        }
        let wanted = self.rendered.iter().enumerate().filter_map(|(number, rendered)| {
            let size = SIZE_MIN_PX * 2.0_f64.powf(number as f64 / OF_LEVEL as f64);
            let is_wanted = size >= low && size <= high && fits(size);
            let render = || Template::render(model, constants, size, number / OF_LEVEL);
            if is_wanted { rendered.get_or_init(render).as_ref() } else { None }
        });
        wanted.collect()
    }
}

/// True when a cold start has to estimate the target's size.
fn is_sized(model: &Model) -> bool {
    let is = |start: &Start| matches!(start, Start::Estimator(Estimator::Extent(..) | Estimator::Size(_)));
    model.parameters().iter().any(|parameter| is(&parameter.start))
}
