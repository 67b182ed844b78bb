//! A template: a document's image of a target at one size, as a correlation kernel.
//!
//! It is the predicted intensity over the domain, minus the background, minus its mean over the disc around it. The kernel
//! determines the effect of noise on the sum of products: its standard deviation, the covariance of its gradient, its
//! skewness.

use isophote_symbolic::{Estimator, Model, Parameter, Start};

/// Half the side of a template, in pixels of its octave.
pub(super) const HALF_PX: i32 = 20;
/// Radius of the background around a target, in its sizes.
const GROUND: f64 = 10.0;
/// Brightness for rendering, typical of an 8-bit camera; only ratios to it matter.
const AMPLITUDE: f64 = 100.0;
/// A target does not fit if more than this share of its energy lies outside the rim.
const CUT_OFF: f64 = 0.01;
/// Radius of the rim as a share of the template.
const RIM_SHARE: f64 = 0.95;

/// A template; see the module.
#[derive(Clone, Debug)]
pub(crate) struct Template {
    /// Halvings of the picture.
    pub level: usize,
    /// Half the target's width, px of the frame.
    pub size_px: f64,
    /// (2 HALF_PX + 1)² numbers, row by row, of unit norm.
    pub kernel: Vec<f32>,
    /// The target's brightness where the sum of products is 1.
    pub height: f64,
    /// √det Λ per pixel of the frame: see [`super::alarm`].
    roughness: f64,
    /// Σ K³, the skewness of the sum for pixels of skewness 1.
    pub skewness: f64,
}

impl Template {
    /// Renders a target of half width `size_px` for a picture halved `level` times; `None` where the model has no such
    /// size, or the image is empty or does not fit.
    pub fn render(model: &Model, constants: &[f64], size_px: f64, level: usize) -> Option<Template> {
        let parameters = parameters(model, size_px)?;
        if !model.constraints_hold(&parameters, constants) {
            return None;
        }
        let roles = model.roles().first()?;
        let centre: Vec<f64> = roles.centre.iter().map(|id| parameters[id.index()]).collect();
        let (pitch, side) = (f64::from(1 << level), (2 * HALF_PX + 1) as usize);
        let place = |i: usize| [(i % side) as i32 - HALF_PX, (i / side) as i32 - HALF_PX];
        let at = |i: usize| -> [f64; 2] {
            let offset = place(i);
            std::array::from_fn(|axis| centre[axis] + pitch * f64::from(offset[axis]))
        };
        let is_inside: Vec<bool> =
            (0..side * side).map(|i| model.domain_holds(&at(i), &parameters, constants)).collect();
        let value = |i: usize| if is_inside[i] { model.predicted(&at(i), &parameters, constants) } else { 0.0 };
        let mut image: Vec<f64> = (0..side * side).map(value).collect();
        let distance = |i: usize| place(i).iter().map(|at| f64::from(*at).powi(2)).sum::<f64>().sqrt();
        let background = match roles.background {
            Some(background) => parameters[background.index()],
            None => rim(&image, &is_inside, distance),
        };
        image
            .iter_mut()
            .zip(&is_inside)
            .filter(|(_, is_inside)| **is_inside)
            .for_each(|(value, _)| *value -= background);
        let energy = |of: &dyn Fn(usize) -> bool| -> f64 {
            (0..side * side).filter(|&i| of(i)).map(|i| image[i] * image[i]).sum()
        };
        let (all, farthest) = (energy(&|_| true), RIM_SHARE * f64::from(HALF_PX));
        let is_cut = energy(&|i| distance(i) > farthest) > CUT_OFF * all;
        if !(all > 0.0 && all.is_finite()) || is_cut {
            return None;
        }
        let height = roles.brightness.map_or(1.0, |id| parameters[id.index()]);
        Template::of_image(&image, distance, height, size_px, level)
    }

    fn of_image(
        image: &[f64],
        distance: impl Fn(usize) -> f64,
        height: f64,
        size_px: f64,
        level: usize,
    ) -> Option<Template> {
        let side = (2 * HALF_PX + 1) as usize;
        let pitch = f64::from(1 << level);
        let reach = image.iter().enumerate().filter(|(_, value)| **value != 0.0).map(|(i, _)| distance(i));
        let radius = (GROUND * size_px / pitch).max(1.4 * reach.fold(0.0, f64::max)).min(f64::from(HALF_PX));
        let disc: Vec<bool> = (0..image.len()).map(|i| distance(i) <= radius).collect();
        let mean = image.iter().sum::<f64>() / disc.iter().filter(|is| **is).count() as f64;
        let flat: Vec<f64> = image.iter().zip(&disc).map(|(value, is)| if *is { value - mean } else { 0.0 }).collect();
        let norm = flat.iter().map(|value| value * value).sum::<f64>().sqrt();
        if !(norm > 0.0 && norm.is_finite()) {
            return None;
        }
        let kernel: Vec<f64> = flat.iter().map(|value| value / norm).collect();
        // The variances of the field's differences between adjacent pixels, 2 (1 − ρ), for those of the gradient.
        let shifted = |dx: usize, dy: usize| -> f64 {
            let rows = 0..side - dy;
            let of_row = |y: usize| (0..side - dx).map(move |x| (y * side + x, (y + dy) * side + x + dx));
            rows.flat_map(of_row).map(|(a, b)| kernel[a] * kernel[b]).sum()
        };
        let (xx, yy) = (2.0 * (1.0 - shifted(1, 0)), 2.0 * (1.0 - shifted(0, 1)));
        let diagonal = 2.0 * (1.0 - shifted(1, 1));
        let xy = 0.5 * (diagonal - xx - yy);
        Some(Template {
            level,
            size_px,
            height: height / norm,
            roughness: (xx * yy - xy * xy).max(0.0).sqrt() / (pitch * pitch),
            skewness: kernel.iter().map(|value| value.powi(3)).sum(),
            kernel: kernel.iter().map(|value| *value as f32).collect(),
        })
    }

    /// Number of independent places in this many pixels of the frame.
    pub fn independent_positions(&self, pixels: usize) -> f64 {
        self.roughness * pixels as f64
    }
}

/// The mean of the pixels farthest from the centre.
fn rim(image: &[f64], is_inside: &[bool], distance: impl Fn(usize) -> f64) -> f64 {
    let inside = || (0..image.len()).filter(|&i| is_inside[i]);
    let farthest = inside().map(&distance).fold(0.0, f64::max);
    let (sum, count) = inside()
        .filter(|&i| distance(i) >= farthest - 1.0)
        .fold((0.0, 0.0), |(sum, count), i| (sum + image[i], count + 1.0));
    sum / count
}

/// Parameters of a target of this size somewhere; `None` where there is no such size.
fn parameters(model: &Model, size_px: f64) -> Option<Vec<f64>> {
    let value = |parameter: &Parameter| {
        let is_inside =
            |value: f64| parameter.min.is_none_or(|min| value > min) && parameter.max.is_none_or(|max| value < max);
        let sized = |value: f64| is_inside(value).then_some(value);
        match parameter.start {
            Start::Number(number) => Some(number),
            Start::Estimator(estimator) => match estimator {
                Estimator::Extent(row, column) if row == column => sized(size_px.powi(-2)),
                Estimator::Extent(..) => sized(0.0),
                Estimator::Size(_) => sized(size_px),
                Estimator::Centroid(_) | Estimator::Background | Estimator::Angle => Some(inside(parameter, 0.0)),
                Estimator::Amplitude if parameter.max.is_some_and(|max| max <= 0.0) => {
                    Some(inside(parameter, -AMPLITUDE))
                }
                Estimator::Amplitude => Some(inside(parameter, AMPLITUDE)),
                _ => None,
            },
        }
    };
    model.parameters().iter().map(value).collect()
}

/// The value, or one within the bounds.
fn inside(parameter: &Parameter, value: f64) -> f64 {
    match (parameter.min, parameter.max) {
        (Some(min), Some(max)) if !(value > min && value < max) => 0.5 * (min + max),
        (Some(min), _) if value <= min => min + min.abs().max(1.0),
        (_, Some(max)) if value >= max => max - max.abs().max(1.0),
        _ => value,
    }
}
