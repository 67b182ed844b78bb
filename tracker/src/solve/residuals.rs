//! `Residuals`: whitened residuals of a model with given parameters, pixel by pixel over its domain.

use std::sync::Arc;

use isophote_jit::{Kernel, KernelCache, KernelOptions, Window};
use isophote_symbolic::{Bindings, Model, Precision, Prediction, Summand};

use crate::sight::grey::{Grey, Mixture};
use crate::sight::view::View;
use crate::solve::pixel_handling::{CompileFailure, PixelHandling, lowering};
use crate::statistics::{MEDIAN_SQUARE, median};

/// Predictions of one observed value.
struct Observed {
    summand: Summand,
    intensity: Arc<Kernel>,
    unbounded: Arc<Kernel>,
    variance: Arc<Kernel>,
}

/// The predictions of a model, compiled.
pub(crate) struct Predictions {
    entries: Vec<Observed>,
}

/// The pixels of a window to evaluate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    /// Those of the domain.
    Domain,
    /// All.
    Everything,
}

/// A pixel of the domain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residual {
    /// Index in the window.
    pub pixel: usize,
    /// Predicted intensity.
    pub predicted: f64,
    /// (observed − predicted)/σ; for a saturated pixel (limit − predicted)/σ, at least 0.
    pub whitened: f64,
    /// σ; 1 where the model does not state it.
    pub deviation: f64,
    pub saturated: bool,
}

/// The residuals of one observed value.
pub(crate) struct ObservedResiduals {
    /// In the order of the window's pixels.
    pub residuals: Vec<Residual>,
    /// The saturation limit, in units of the observed value.
    pub limit: f64,
}

/// Fewest pixels of a row that determine its offset.
const ROW_PIXELS_MIN: usize = 8;
/// Fewest pairs of adjacent rows that determine the offsets' variance.
const STEPS_MIN: usize = 12;
/// Rows have offsets where their means scatter by more than this many times the variance that their pixels explain.
const ROW_SCATTER_MIN: f64 = 4.0;
/// Residuals beyond this many standard deviations are outliers: noise exceeds that in one of two million pixels.
pub(crate) const OUTLIER: f64 = 5.0;

impl ObservedResiduals {
    /// The least predicted value: the level without a target.
    pub fn floor(&self) -> f64 {
        self.residuals.iter().map(|residual| residual.predicted).fold(f64::INFINITY, f64::min)
    }

    /// The variance of row offsets, where it is significant, in a picture of this width. From the median squared difference
    /// of adjacent row means: a model's misfit spans adjacent rows, or ends at a few of them.
    pub fn row_variance(&self, width: usize) -> Option<f64> {
        let mut means: Vec<(usize, f64, f64)> = Vec::new();
        let (mut scatter, mut freedom) = (0.0, 0.0);
        for row in self.residuals.chunk_by(|a, b| a.pixel / width == b.pixel / width) {
            let clear = row.iter().filter(|residual| !residual.saturated);
            let (mut count, mut sum, mut weights, mut squares) = (0, 0.0, 0.0, 0.0);
            for residual in clear {
                count += 1;
                sum += residual.whitened / residual.deviation;
                weights += residual.deviation.powi(-2);
                squares += residual.whitened * residual.whitened;
            }
            if count >= ROW_PIXELS_MIN {
                means.push((row[0].pixel / width, sum / weights, 1.0 / weights));
                scatter += squares - sum * sum / weights;
                freedom += (count - 1) as f64;
            }
        }
        let pairs = means.windows(2).filter(|two| two[0].0 + 1 == two[1].0);
        let mut steps: Vec<f64> = pairs.clone().map(|two| (two[0].1 - two[1].1).powi(2)).collect();
        if steps.len() < STEPS_MIN {
            return None;
        }
        let by_pixels = pairs.map(|two| two[0].2 + two[1].2).sum::<f64>() / steps.len() as f64 * scatter / freedom;
        let found = median(&mut steps)? / MEDIAN_SQUARE;
        (found > ROW_SCATTER_MIN * by_pixels).then_some(0.5 * (found - by_pixels))
    }

    /// Subtracts each row's maximum a posteriori offset, given the offsets' variance.
    pub fn without_offsets(&mut self, width: usize, variance: f64) {
        for row in self.residuals.chunk_by_mut(|a, b| a.pixel / width == b.pixel / width) {
            let offset = offset(row, variance);
            row.iter_mut().for_each(|residual| residual.whitened -= offset / residual.deviation);
        }
    }
}

/// The maximum a posteriori offset of a row.
fn offset(row: &[Residual], variance: f64) -> f64 {
    let clear = row.iter().filter(|residual| !residual.saturated);
    let value = |residual: &Residual| residual.whitened * residual.deviation;
    let mut values: Vec<f64> = clear.clone().map(value).collect();
    let Some(middle) = median(&mut values) else { return 0.0 };
    let (mut sum, mut weights) = (0.0, 1.0 / variance);
    for residual in clear.filter(|one| (value(one) - middle).abs() <= OUTLIER * one.deviation) {
        sum += residual.whitened / residual.deviation;
        weights += residual.deviation.powi(-2);
    }
    sum / weights
}

impl Predictions {
    /// `None` for a model whose variance has no prediction.
    pub fn new(
        model: &Model,
        precision: Precision,
        cache: &KernelCache,
    ) -> Result<Option<Predictions>, CompileFailure> {
        let options = KernelOptions { width: cache.width(), precision, formats: Vec::new(), packed: true };
        let kernel = |summand: &Summand, what| -> Result<Option<Arc<Kernel>>, CompileFailure> {
            let Some(program) = summand.prediction(what, lowering(PixelHandling::All)) else { return Ok(None) };
            let program = program.map_err(CompileFailure::Model)?;
            let kernel = cache.get_or_compile_wide(&program, &options);
            kernel.map(Some).map_err(|error| CompileFailure::Kernel(Arc::new(error)))
        };
        let mut entries = Vec::new();
        for summand in model.summands().into_iter().filter(|summand| !summand.is_clipped()) {
            let [intensity, unbounded, variance] =
                [Prediction::Intensity, Prediction::Unbounded, Prediction::Variance].map(|what| kernel(&summand, what));
            let (Some(intensity), Some(unbounded), Some(variance)) = (intensity?, unbounded?, variance?) else {
                return Ok(None);
            };
            entries.push(Observed { summand, intensity, unbounded, variance });
        }
        Ok(Some(Predictions { entries }))
    }

    /// The predicted intensity of every pixel of a window, NaN outside the domain with [`Over::Domain`]; `None` for a model
    /// of more than one observed value, when a kernel fails, or when the budget is used up or the caller has cancelled.
    pub fn intensity(&self, view: &View, parameters: &[f64], constants: &[f64], over: Over) -> Option<Vec<f32>> {
        view.spend(view.window.pixels()).ok()?;
        let [entry] = &self.entries[..] else { return None };
        let saturation = &view.saturation;
        let bindings = Bindings { parameters, entry: parameters, constants, saturation, shift: &[] };
        plane(entry.kernel(over), &bindings, view.window)
    }

    /// The value of every pixel of a window, by observed value; NaN in gaps.
    pub fn observed(&self, view: &View, constants: &[f64]) -> Option<Vec<Vec<f64>>> {
        view.spend(self.entries.len() * view.window.pixels()).ok()?;
        self.entries.iter().map(|entry| Some(entry.observed(view, constants)?.values)).collect()
    }

    /// Increase of Σ min(z², `most`) from the first point to the second, over the domains of both entries and with the
    /// variances of the second, in units of `variance`; `None` when a kernel fails, or there is no budget left.
    pub fn capped_change(
        &self,
        view: &View,
        constants: &[f64],
        points: [&[f64]; 2],
        entries: [&[f64]; 2],
        [most, variance]: [f64; 2],
    ) -> Option<f64> {
        // Five predictions and the picture.
        view.spend(6 * self.entries.len() * view.window.pixels()).ok()?;
        let saturation = &view.saturation;
        let bindings = |parameters| Bindings { parameters, entry: parameters, constants, saturation, shift: &[] };
        let mut change = 0.0;
        for one in &self.entries {
            let domains = entries.map(|entry| plane(&one.intensity, &bindings(entry), view.window));
            let predicted = points.map(|point| plane(&one.unbounded, &bindings(point), view.window));
            let ([old, new], [before, after]) = ([domains[0].as_ref()?, domains[1].as_ref()?], predicted);
            let (before, after) = (before?, after?);
            let variances = plane(&one.variance, &bindings(entries[1]), view.window)?;
            let observed = one.observed(view, constants)?;
            for (pixel, value) in observed.values.iter().enumerate() {
                let domains = [old, new].iter().filter(|domain| !domain[pixel].is_nan()).count();
                if domains == 0 {
                    continue;
                }
                let weight = (variance * f64::from(variances[pixel])).recip();
                let [before, after] = [&before, &after].map(|predicted| {
                    let square = weight * difference(*value, f64::from(predicted[pixel]), observed.saturation).powi(2);
                    // NaN: no number in the picture, or a gap.
                    if square.is_nan() { 0.0 } else { square.min(most) }
                });
                change += domains as f64 * (after - before);
            }
        }
        Some(change)
    }

    /// The residuals of each observed value; `None` when a kernel fails, or there is no budget left.
    pub fn residuals(
        &self,
        view: &View,
        parameters: &[f64],
        constants: &[f64],
        over: Over,
    ) -> Option<Vec<ObservedResiduals>> {
        // Two predictions and the picture.
        view.spend(3 * self.entries.len() * view.window.pixels()).ok()?;
        let saturation = &view.saturation;
        let bindings = Bindings { parameters, entry: parameters, constants, saturation, shift: &[] };
        let one = |entry: &Observed| {
            let predicted = plane(entry.kernel(over), &bindings, view.window)?;
            let variance = plane(&entry.variance, &bindings, view.window)?;
            let observed = entry.observed(view, constants)?;
            let limit = observed.saturation;
            let pixels = observed.values.iter().zip(predicted).zip(variance).enumerate();
            let residual = |(pixel, ((&value, predicted), variance)): (usize, ((&f64, f32), f32))| {
                let predicted = f64::from(predicted);
                let deviation = f64::from(variance).sqrt();
                let saturated = value >= limit;
                let whitened = difference(value, predicted, limit) / deviation;
                // NaN: outside the domain, no number in the picture, or a gap.
                (!whitened.is_nan()).then_some(Residual { pixel, predicted, whitened, deviation, saturated })
            };
            Some(ObservedResiduals { residuals: pixels.filter_map(residual).collect(), limit })
        };
        let mut seen: Vec<ObservedResiduals> = self.entries.iter().map(one).collect::<Option<_>>()?;
        for (seen, variance) in seen.iter_mut().zip(&view.row_variances) {
            seen.without_offsets(view.window.width, *variance);
        }
        Some(seen)
    }
}

/// Observed minus predicted; for a saturated pixel the limit minus the prediction, at least 0. NaN without a prediction.
fn difference(value: f64, predicted: f64, limit: f64) -> f64 {
    let observed = if value >= limit { limit } else { value };
    if value >= limit && predicted >= limit { 0.0 } else { observed - predicted }
}

impl Observed {
    fn kernel(&self, over: Over) -> &Kernel {
        match over {
            Over::Domain => &self.intensity,
            Over::Everything => &self.unbounded,
        }
    }

    fn observed(&self, view: &View, constants: &[f64]) -> Option<Grey> {
        let mixture = Mixture::of_summand(&self.summand, constants)?;
        let mut observed = Grey::read_with_nan(&view.planes, view.window, &view.saturation, &mixture);
        observed.blank(view.window, &view.gaps);
        Some(observed)
    }
}

fn plane(kernel: &Kernel, bindings: &Bindings, window: Window) -> Option<Vec<f32>> {
    let mut plane = vec![0.0; window.pixels()];
    kernel.render(bindings, window, &mut plane).ok()?;
    Some(plane)
}
