//! The pixels of a target and a margin around it, with the residuals of a fit, from which its [`Signs`] are computed.

use isophote_jit::Window;
use isophote_symbolic::{ParameterId, Roles};
use nalgebra::{DMatrix, DVector, Matrix2, SymmetricEigen, Vector2};

use super::modes::{DeviationLikelihood, Modes};
use super::{DEVIATION, FittedModel, Signs, VerdictContext, zernike};
use crate::outline::shape;
use crate::sight::elsewhere::{SAMPLES_MIN, WINDOWS_MAX, elsewhere};
use crate::sight::grey::{Grey, Mixture};
use crate::sight::view::View;
use crate::solve::residuals::{Over, Residual};
use crate::statistics::{MEDIAN_SQUARE, ln_chi_square_beyond, median};

/// A definition: a target's light ends where its profile has fallen to this share of its height.
const LIGHT_ENDS: f64 = 0.1;
/// A budget: width of the patch over that of the light.
const MARGIN: f64 = 1.4;
/// A budget: samples of the profile to find where the light ends.
const STEPS: usize = 64;
/// A budget: pixels of a patch that are used.
const PIXELS: usize = 1_000;
/// A definition: least number of pixels.
const PIXELS_MIN: usize = 16;
/// A budget: share of a place's pixels that may be saturated.
const SATURATED_MOST: f64 = 0.02;
/// A pixel is an outlier beyond this many standard deviations of noise and [`ROUGH`] together.
const OFF: f64 = 4.0;
/// Deviation of a rough model, as a share of its height.
const ROUGH: f64 = 0.05;
/// A pixel is covered when this many of the nine around it are outliers.
const NEIGHBOURS: usize = 5;
/// A definition: patches are apart where their centres are farther apart than this many radii.
const APART: f64 = 1.6;
/// A budget: places that are looked at among other targets, for each that is sampled.
const LOOKED_AT: usize = 4;
/// A budget: pairs of pixels for the estimate of the frame's noise.
const PAIRS: usize = 20_000;
/// A budget: step of central differences, as a share of a large change, between rounding in f32 and the third derivative.
const STEP: f64 = 1e-2;

/// A target's pixels.
pub(crate) struct Patch<'a> {
    roles: &'a Roles,
    centre: Vector2<f64>,
    /// Maps offsets from the centre so that the patch is the unit disc.
    turned: Matrix2<f64>,
    window: Window,
}

/// Its pixels, possibly subsampled.
struct Measured {
    pixels: Vec<Pixel>,
    /// Pixel values are saturated from here on.
    limit: f64,
    /// The variance of the frame's noise.
    noise: f64,
}

/// The picture without the target's light.
enum Unlit {
    /// The prediction with these parameters.
    Dark(Vec<f64>),
    /// A constant.
    Even(f64),
}

/// One pixel of it.
struct Pixel {
    /// Index in the window.
    number: usize,
    /// Position; the patch is the unit disc.
    place: Vector2<f64>,
    residual: f64,
    predicted: f64,
    /// The target's part of the prediction.
    light: f64,
    variance: f64,
    saturated: bool,
    covered: bool,
}

impl<'a> Patch<'a> {
    pub fn of(subject: &VerdictContext<'a>, fitted: &FittedModel) -> Option<Patch<'a>> {
        let [roles] = subject.model.roles() else { return None };
        if subject.model.coordinates().len() != 2 || roles.centre.len() != 2 || !roles.position.is_empty() {
            return None;
        }
        let outline = shape(roles, 2, fitted.parameters)?;
        let SymmetricEigen { eigenvectors, eigenvalues } = Matrix2::from_fn(|i, j| outline[(i, j)]).symmetric_eigen();
        if eigenvalues.iter().any(|value| value.is_nan() || *value <= 0.0) {
            return None;
        }
        let centre = Vector2::from_fn(|axis, _| fitted.parameters[roles.centre[axis].index()]);
        let circle = Matrix2::from_diagonal(&eigenvalues.map(f64::sqrt)) * eigenvectors.transpose();
        let reach = light_ends(subject, roles, fitted.parameters, centre, circle.try_inverse()?)?;
        let turned = circle / (MARGIN * reach);
        let spread = (turned.transpose() * turned).try_inverse()?;
        let half = [spread[(0, 0)].sqrt(), spread[(1, 1)].sqrt()];
        let window = cut_to(subject.region, centre, half)?;
        Some(Patch { roles, centre, turned, window })
    }

    pub fn signs(&self, subject: &VerdictContext, fitted: &FittedModel) -> Option<Signs> {
        let Measured { pixels, limit, noise } = self.measured(subject, fitted)?;
        let is_inside = |pixel: &&Pixel| pixel.place.norm() * MARGIN <= 1.0;
        let (mut lit, mut hidden) = (0.0, 0.0);
        for pixel in pixels.iter().filter(is_inside) {
            let light = pixel.light.abs();
            lit += light;
            hidden += if pixel.covered { light } else { 0.0 };
        }
        let clear: Vec<&Pixel> = pixels.iter().filter(|pixel| !pixel.saturated).collect();
        let uncovered: Vec<&Pixel> = clear.iter().copied().filter(|pixel| !pixel.covered).collect();
        let used = if uncovered.len() > fitted.free.len() + PIXELS_MIN { uncovered } else { clear };
        let white = match subject.model.has_noise() {
            true => used.iter().map(|pixel| pixel.variance).fold(f64::INFINITY, f64::min),
            false => noise,
        };
        let elsewhere = Elsewhere { samples: self.elsewhere(subject, &used, limit)?, white };
        let deviations = self.deviations(subject, fitted, &used, limit, &elsewhere);
        let right = subject.model.deviation().unwrap_or(DEVIATION);
        Some(Signs {
            evidence: deviations.map_or(0.0, |likelihood| likelihood.ln_bayes_factor(right)),
            deviations,
            noise: self.ln_places(subject)
                + ln_chi_square_beyond(square_score(&used, &elsewhere), fitted.free.len().saturating_sub(1)),
            others: subject.surroundings.others,
            unconverged: !fitted.is_converged,
            cut_off: self.cut_off(subject, fitted.parameters),
            covered: share(hidden, lit),
        })
    }

    fn measured(&self, subject: &VerdictContext, fitted: &FittedModel) -> Option<Measured> {
        let view = (subject.view)(self.window);
        let seen = subject.predictions.residuals(&view, fitted.parameters, subject.constants, Over::Everything)?;
        let [seen] = &seen[..] else { return None };
        let frame = frame_noise(subject, seen.limit)?.max(view.rounding_variance());
        let (width, has_noise) = (self.window.width, subject.model.has_noise());
        let mut own = vec![f64::NAN; self.window.pixels()];
        seen.residuals.iter().for_each(|one| own[one.pixel] = one.whitened * one.deviation);
        let steps = own.chunks(width).flat_map(|row| row.windows(2).map(|two| two[0] - two[1]));
        let noise = if has_noise { None } else { median_square(steps) };
        let noise = noise.map_or(frame, |square| frame.max(square / (2.0 * MEDIAN_SQUARE)));
        let pixel = |one: &Residual| Pixel {
            number: one.pixel,
            place: self.place(one.pixel),
            residual: one.whitened * one.deviation,
            predicted: one.predicted,
            light: 0.0,
            variance: if has_noise { one.deviation.powi(2) } else { noise },
            saturated: one.saturated && one.predicted >= seen.limit,
            covered: false,
        };
        let mut pixels: Vec<Pixel> =
            seen.residuals.iter().map(pixel).filter(|pixel| pixel.place.norm() <= 1.0).collect();
        let rough = ROUGH * height(pixels.iter(), seen.limit);
        let mut far = vec![false; self.window.pixels()];
        for pixel in &pixels {
            far[pixel.number] = pixel.residual.powi(2) > OFF * OFF * (pixel.variance + rough * rough);
        }
        for pixel in &mut pixels {
            let (x, y) = (pixel.number % width, pixel.number / width);
            let rows = y.saturating_sub(1)..(y + 2).min(self.window.height);
            let near = rows.flat_map(|row| (x.saturating_sub(1)..(x + 2).min(width)).map(move |x| row * width + x));
            pixel.covered = near.filter(|near| far[*near]).count() >= NEIGHBOURS;
        }
        let lights = self.lights(subject, &view, fitted.parameters)?;
        let every = pixels.len().div_ceil(PIXELS).max(1);
        let lit = |pixel: Pixel| Pixel { light: lights[pixel.number], ..pixel };
        let pixels = pixels.into_iter().step_by(every).map(lit).collect();
        Some(Measured { pixels, limit: seen.limit, noise: frame })
    }

    /// The target's light in every pixel of the window.
    fn lights(&self, subject: &VerdictContext, view: &View, parameters: &[f64]) -> Option<Vec<f64>> {
        let intensity =
            |parameters: &[f64], over| subject.predictions.intensity(view, parameters, subject.constants, over);
        let mut lights: Vec<f64> = intensity(parameters, Over::Domain)?.into_iter().map(f64::from).collect();
        match Unlit::of(self.roles, parameters) {
            Unlit::Dark(dark) => {
                let dark = intensity(&dark, Over::Everything)?;
                lights.iter_mut().zip(dark).for_each(|(light, dark)| *light -= f64::from(dark));
            }
            Unlit::Even(value) => lights.iter_mut().for_each(|light| *light -= value),
        }
        // NaN: outside of the domain.
        lights.iter_mut().filter(|light| !light.is_finite()).for_each(|light| *light = 0.0);
        Some(lights)
    }

    /// In the frame, px.
    fn at(&self, pixel: usize) -> Vector2<f64> {
        let Window { x, y, width, .. } = self.window;
        Vector2::new((x + pixel % width) as f64, (y + pixel / width) as f64)
    }

    /// Where the patch is the unit disc.
    fn place(&self, pixel: usize) -> Vector2<f64> {
        self.turned * (self.at(pixel) - self.centre)
    }

    /// `None` with too few pixels.
    fn deviations(
        &self,
        subject: &VerdictContext,
        fitted: &FittedModel,
        pixels: &[&Pixel],
        limit: f64,
        elsewhere: &Elsewhere,
    ) -> Option<DeviationLikelihood> {
        if pixels.len() < PIXELS_MIN {
            return None;
        }
        let jacobian = self.jacobian(subject, fitted, pixels)?;
        let height = height(pixels.iter().copied(), limit);
        let functions: Vec<[f64; zernike::COUNT]> =
            pixels.iter().map(|pixel| zernike::at(pixel.place.x, pixel.place.y)).collect();
        let basis = DMatrix::from_fn(pixels.len(), zernike::COUNT, |pixel, term| height * functions[pixel][term]);
        let variances: Vec<f64> = pixels.iter().map(|pixel| pixel.variance).collect();
        let modes = Modes::new(&jacobian, &basis, &variances)?;
        let own = modes.of(&DVector::from_iterator(pixels.len(), pixels.iter().map(|pixel| pixel.residual)));
        let found: Vec<DVector<f64>> = elsewhere.samples.iter().map(|values| modes.of(values)).collect();
        let noise = modes.variances(&vec![elsewhere.white; pixels.len()]);
        let scatter = DVector::from_fn(own.len(), |mode, _| {
            elsewhere.scatter(found.iter().map(|found| found[mode]), noise[mode])
        });
        Some(DeviationLikelihood::new(&own, &modes.response, &scatter))
    }

    /// Derivatives of the predictions by each free parameter and by the coefficients of the polynomial.
    fn jacobian(&self, subject: &VerdictContext, fitted: &FittedModel, pixels: &[&Pixel]) -> Option<DMatrix<f64>> {
        let view = (subject.view)(self.window);
        let degree = fitted.degree as i32;
        let powers: Vec<[i32; 2]> = (0..=degree).flat_map(|i| (0..=degree - i).map(move |j| [i, j])).collect();
        let mut jacobian = DMatrix::zeros(pixels.len(), powers.len() + fitted.free.len());
        for (row, pixel) in pixels.iter().enumerate() {
            for (column, [i, j]) in powers.iter().enumerate() {
                jacobian[(row, column)] = pixel.place.x.powi(*i) * pixel.place.y.powi(*j);
            }
        }
        let mut at = fitted.parameters.to_vec();
        for (column, &parameter) in fitted.free.iter().enumerate() {
            let here = at[parameter];
            let step = STEP * self.scale(fitted.parameters, parameter);
            let mut planes = [1.0, -1.0].map(|sign| {
                at[parameter] = here + sign * step;
                subject.predictions.intensity(&view, &at, subject.constants, Over::Everything)
            });
            at[parameter] = here;
            let [Some(above), Some(below)] = planes.each_mut().map(Option::take) else { return None };
            for (row, pixel) in pixels.iter().enumerate() {
                let slope = f64::from(above[pixel.number]) - f64::from(below[pixel.number]);
                jacobian[(row, powers.len() + column)] = if slope.is_finite() { slope / (2.0 * step) } else { 0.0 };
            }
        }
        Some(jacobian)
    }

    /// The scale of a parameter: a step that changes predictions by much.
    fn scale(&self, parameters: &[f64], parameter: usize) -> f64 {
        let is = |ids: &[ParameterId]| ids.iter().any(|id| id.index() == parameter);
        let entries = || self.roles.shape.iter().map(|id| parameters[id.index()].abs()).fold(0.0, f64::max);
        match () {
            () if is(&self.roles.centre) => self.turned.norm().recip(),
            () if is(&self.roles.shape) => entries(),
            () => parameters[parameter].abs().max(0.01),
        }
    }

    /// Image values under the same pixels at other places of the frame where few are saturated.
    fn elsewhere(&self, subject: &VerdictContext, pixels: &[&Pixel], limit: f64) -> Option<Vec<DVector<f64>>> {
        let is_apart = |offset| (self.turned * Vector2::from(offset)).norm() > APART;
        let mut found = Vec::new();
        let targets = &subject.surroundings.targets;
        let most = if targets.is_empty() { WINDOWS_MAX } else { LOOKED_AT * WINDOWS_MAX };
        let mut windows = elsewhere(subject.region, self.window, most, is_apart);
        let is_clear = |window: &Window| {
            let centre = |[x, y]: [f64; 2]| {
                let moved = [window.x as f64 - self.window.x as f64, window.y as f64 - self.window.y as f64];
                Vector2::from(moved) + self.centre - Vector2::new(x, y)
            };
            targets.iter().all(|target| (self.turned * centre(*target)).norm() > APART)
        };
        windows.retain(is_clear);
        windows.truncate(WINDOWS_MAX);
        for window in windows {
            let view = (subject.view)(window);
            let mixture = Mixture::linear(subject.model, subject.constants)?;
            let grey = Grey::read_with_nan(&view.planes, window, &view.saturation, &mixture);
            let values = pixels.iter().map(|pixel| grey.values[pixel.number]);
            let saturated = values.clone().filter(|value| value.is_nan() || *value >= limit).count();
            if (saturated as f64) < SATURATED_MOST * pixels.len() as f64 {
                let clear = values.map(|value| if value.is_finite() { value } else { limit });
                found.push(DVector::from_iterator(pixels.len(), clear));
            }
        }
        Some(found)
    }

    /// ln of the number of positions where a target of its size could be.
    fn ln_places(&self, subject: &VerdictContext) -> f64 {
        let light_px2 = std::f64::consts::PI / (MARGIN.powi(2) * self.turned.determinant().abs());
        (subject.region.pixels() as f64 / light_px2).max(1.0).ln()
    }

    /// The share of the light outside the region of interest.
    fn cut_off(&self, subject: &VerdictContext, parameters: &[f64]) -> f64 {
        let Some(inverse) = (self.turned * MARGIN).try_inverse() else { return 1.0 };
        let Window { x, y, width, height, .. } = subject.region;
        let is_between =
            |at: f64, first: usize, length: usize| at >= first as f64 - 0.5 && at <= (first + length) as f64 - 0.5;
        let is_inside = |at: Vector2<f64>| is_between(at.x, x, width) && is_between(at.y, y, height);
        let half = Vector2::new(inverse.row(0).norm(), inverse.row(1).norm());
        if is_inside(self.centre - half) && is_inside(self.centre + half) {
            return 0.0;
        }
        let unlit = Unlit::of(self.roles, parameters);
        let (mut outside, mut all) = (0.0, 0.0);
        let side = 25;
        for i in 0..side * side {
            let at = |i: i32| f64::from(2 * i) / f64::from(side - 1) - 1.0;
            let place = Vector2::new(at(i % side), at(i / side));
            if place.norm() > 1.0 {
                continue;
            }
            let at = self.centre + inverse * place;
            let light = light(subject, &unlit, parameters, at).abs();
            let light = if light.is_finite() { light } else { 0.0 };
            all += light;
            outside += if is_inside(at) { 0.0 } else { light };
        }
        share(outside, all)
    }
}

impl Unlit {
    fn of(roles: &Roles, parameters: &[f64]) -> Unlit {
        match (roles.brightness, roles.background) {
            (Some(brightness), _) => {
                let mut dark = parameters.to_vec();
                dark[brightness.index()] = 0.0;
                Unlit::Dark(dark)
            }
            (None, background) => Unlit::Even(background.map_or(0.0, |background| parameters[background.index()])),
        }
    }
}

/// Image values under a target's pixels at other places of the frame.
struct Elsewhere {
    samples: Vec<DVector<f64>>,
    /// The variance of a pixel's noise there.
    white: f64,
}

impl Elsewhere {
    /// The variance of a linear function of pixels, which has unit variance on a target, given its values `found`
    /// elsewhere and the noise variance there.
    fn scatter(&self, found: impl Iterator<Item = f64>, noise: f64) -> f64 {
        if self.samples.len() < SAMPLES_MIN {
            return 1.0;
        }
        1.0 + (median_square(found).unwrap_or(0.0) / MEDIAN_SQUARE - noise).max(0.0)
    }
}

/// The squared score of a matched filter: twice the log-likelihood ratio of a target against the background, given the
/// filter's scatter elsewhere.
fn square_score(pixels: &[&Pixel], elsewhere: &Elsewhere) -> f64 {
    let lights = DVector::from_iterator(pixels.len(), pixels.iter().map(|pixel| pixel.light));
    let weights = DVector::from_iterator(pixels.len(), pixels.iter().map(|pixel| pixel.variance.recip()));
    let mean = lights.dot(&weights) / weights.sum();
    let filter = lights.add_scalar(-mean).component_mul(&weights);
    let square = filter.dot(&lights);
    if square.is_nan() || square <= 0.0 {
        return 0.0;
    }
    let filter = filter / square.sqrt();
    let noise = elsewhere.white * filter.norm_squared();
    square / elsewhere.scatter(elsewhere.samples.iter().map(|values| filter.dot(values)), noise)
}

/// The target's light at a place.
fn light(subject: &VerdictContext, unlit: &Unlit, parameters: &[f64], at: Vector2<f64>) -> f64 {
    let place = [at.x, at.y];
    if !subject.model.domain_holds(&place, parameters, subject.constants) {
        return 0.0;
    }
    let predicted = |parameters: &[f64]| subject.model.predicted(&place, parameters, subject.constants);
    match unlit {
        Unlit::Dark(dark) => predicted(parameters) - predicted(dark),
        Unlit::Even(value) => predicted(parameters) - value,
    }
}

/// Reach of the light, in semi-axes of the outline: the mean over four directions cancels slopes.
fn light_ends(
    subject: &VerdictContext,
    roles: &Roles,
    parameters: &[f64],
    centre: Vector2<f64>,
    from_circle: Matrix2<f64>,
) -> Option<f64> {
    let directions = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]].map(|[x, y]| from_circle * Vector2::new(x, y));
    let unlit = Unlit::of(roles, parameters);
    let mean = |step: usize| {
        let at = subject.reach * step as f64 / STEPS as f64;
        directions.iter().map(|way| light(subject, &unlit, parameters, centre + way * at)).sum::<f64>() / 4.0
    };
    let lights: Vec<f64> = (0..=STEPS).map(|step| mean(step).abs()).collect();
    let most = lights.iter().copied().filter(|light| light.is_finite()).fold(0.0, f64::max);
    let last = lights.iter().rposition(|light| *light >= LIGHT_ENDS * most).filter(|_| most > 0.0)?;
    Some(subject.reach * last.max(1) as f64 / STEPS as f64)
}

/// Range of the prediction, clipped at `limit`.
fn height<'p>(pixels: impl Iterator<Item = &'p Pixel> + Clone, limit: f64) -> f64 {
    let heights = pixels.map(|pixel| pixel.predicted.min(limit));
    heights.clone().fold(f64::NEG_INFINITY, f64::max) - heights.fold(f64::INFINITY, f64::min)
}

fn share(part: f64, all: f64) -> f64 {
    if all > 0.0 { part / all } else { 0.0 }
}

/// The variance of the frame's noise, from differences of neighbours.
fn frame_noise(subject: &VerdictContext, limit: f64) -> Option<f64> {
    let mixture = Mixture::linear(subject.model, subject.constants)?;
    let Window { width, height, .. } = subject.region;
    let every = (width * height).div_ceil(PAIRS).max(1);
    let rows = (0..height).step_by(every).map(|row| Window { y: subject.region.y + row, height: 1, ..subject.region });
    let differences = rows.flat_map(|row| {
        let view = (subject.view)(row);
        let values = Grey::read_with_nan(&view.planes, row, &view.saturation, &mixture).values;
        let clear = |two: &[f64]| if two[0] < limit && two[1] < limit { two[0] - two[1] } else { f64::NAN };
        values.windows(2).map(clear).collect::<Vec<f64>>()
    });
    Some(median_square(differences).unwrap_or(0.0) / (2.0 * MEDIAN_SQUARE))
}

/// The median of the squares, non-finite values excluded.
fn median_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut squares: Vec<f64> = values.map(|value| value * value).filter(|square| square.is_finite()).collect();
    median(&mut squares)
}

/// The rectangle around a place, clipped to the frame.
fn cut_to(region: Window, centre: Vector2<f64>, half: [f64; 2]) -> Option<Window> {
    let range = |axis: usize, first: usize, length: usize| {
        let (low, high) = (centre[axis] - half[axis], centre[axis] + half[axis]);
        let (from, to) = (low.max(first as f64), high.min((first + length) as f64 - 1.0));
        let is_sound = half[axis] <= 2.0 * length as f64 && to - from >= 2.0;
        is_sound.then(|| (from.ceil() as usize, to.floor() as usize))
    };
    let (x, right) = range(0, region.x, region.width)?;
    let (y, bottom) = range(1, region.y, region.height)?;
    Some(Window { x, y, width: right - x + 1, height: bottom - y + 1, ..region })
}
