//! A check of a model's compiled derivatives against its compiled values, on a picture made up for it.
//!
//! The gradient g of each stage is compared with the difference quotient of F on the same pixel set (that of the entry
//! parameters): `(F(u + h) − F(u − h)) / 2h`, at h and h/2, extrapolated to h = 0.

use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Window};
use isophote_symbolic::{Bindings, Estimator, Lowering, Model, Parameter, Precision, Program, Start, ValueKind};

use crate::compiled::{CompileFailure, value_kind};

/// The picture's size by the number of coordinates, px.
const SIZES: [[usize; 4]; 4] = [[40, 1, 1, 1], [40, 30, 1, 1], [16, 12, 10, 1], [10, 9, 8, 6]];
/// Difference steps over √(F / H_ii), the step that would change F by about itself.
const STEP: f64 = 1e-5;

/// The largest error over all parameters of all stages, relative to `√(2 F H_ii) ≥ |g_i|`; `None` when F, a derivative or
/// a constraint fails at the made-up parameters.
pub(crate) fn self_check(model: &Model) -> Result<Option<f64>, CompileFailure> {
    let size = SIZES[model.coordinates().len().clamp(1, 4) - 1];
    let channels = model.channels().len();
    let pictures: Vec<Vec<u8>> = (0..channels).map(|channel| picture(channel, size)).collect();
    let mut strides = [PixelFormat::F64.bytes_per_pixel(); 4];
    for axis in 1..4 {
        strides[axis] = size[axis - 1] * strides[axis - 1];
    }
    let planes: Result<Vec<PlaneView>, _> =
        pictures.iter().map(|bytes| PlaneView::stack(PixelFormat::F64, bytes, size, strides)).collect();
    let Ok(planes) = planes else { return Ok(None) };
    let parameters: Vec<f64> = model.parameters().iter().map(|parameter| made_up(parameter, size)).collect();
    let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
    let run = |kernel: &Kernel, parameters: &[f64], entry: &[f64]| {
        let saturation = vec![f64::INFINITY; channels];
        let bindings = Bindings { parameters, entry, constants: &constants, saturation: &saturation, shift: &[] };
        kernel.sums(&bindings, &planes, Window::of_size(size)).ok().map(|sums| sums.outputs)
    };
    let value_of = |kind: ValueKind| {
        let program = model.value_objective(kind).and_then(|objective| objective.program(Lowering::default()));
        compile(&program.map_err(CompileFailure::Model)?, channels)
    };
    let mut worst: f64 = 0.0;
    for stage in model.stages() {
        let value = value_of(value_kind(model, stage.method))?;
        let at = |parameters: &[f64], entry: &[f64]| run(&value, parameters, entry)?.first().copied();
        let objective = model.objective(&stage.parameters, stage.method).map_err(CompileFailure::Model)?;
        let program = objective.program(Lowering::default()).map_err(CompileFailure::Model)?;
        let Some(outputs) = run(&compile(&program, channels)?, &parameters, &parameters) else { return Ok(None) };
        let n = stage.parameters.len();
        let (f, gradient, upper) = (outputs[0], &outputs[1..=n], &outputs[n + 1..]);
        let mut diagonal = 0;
        for (i, id) in stage.parameters.iter().enumerate() {
            let second = upper[diagonal].abs();
            diagonal += n - i;
            let bound = (2.0 * f * second).sqrt();
            if bound == 0.0 {
                continue; // the parameter has no effect on this picture
            }
            let quotient = |h: f64| {
                let moved = |by: f64| {
                    let mut point = parameters.clone();
                    point[id.index()] += by;
                    at(&point, &parameters)
                };
                Some((moved(h)? - moved(-h)?) / (2.0 * h))
            };
            let h = STEP * (f / second).sqrt();
            let (Some(wide), Some(narrow)) = (quotient(h), quotient(0.5 * h)) else { return Ok(None) };
            let error = (gradient[i] - (4.0 * narrow - wide) / 3.0).abs() / bound;
            if !error.is_finite() {
                return Ok(None);
            }
            worst = worst.max(error);
        }
    }
    Ok(Some(worst))
}

fn compile(program: &Program, channels: usize) -> Result<Kernel, CompileFailure> {
    let options = KernelOptions { precision: Precision::F64, formats: vec![PixelFormat::F64; channels], packed: true };
    Kernel::compile(program, &options).map_err(|error| CompileFailure::Kernel(error.into()))
}

/// Values between 20 and 200 without any order: a residual that vanishes nowhere.
fn picture(channel: usize, size: [usize; 4]) -> Vec<u8> {
    let value = |i: usize| 110.0 + 90.0 * (12.9898 * (i + 7919 * channel) as f64).sin();
    (0..size.iter().product()).flat_map(|i| value(i).to_le_bytes()).collect()
}

/// A target in the middle of the picture; numbers as the document has them.
fn made_up(parameter: &Parameter, size: [usize; 4]) -> f64 {
    let half = |axis: usize| 0.3 * size[axis].max(2) as f64;
    match parameter.start {
        Start::Number(number) => number,
        Start::Estimator(estimator) => match estimator {
            Estimator::Centroid(axis) => 0.5 * size[axis] as f64 - [0.2, 0.7, 0.4, 0.6][axis],
            Estimator::Extent(row, column) if row == column => half(row).powi(-2),
            Estimator::Extent(row, column) => 0.2 / (half(row) * half(column)),
            Estimator::Size(axis) => half(axis),
            Estimator::Background => 20.0,
            Estimator::Amplitude if parameter.max.is_some_and(|max| max <= 0.0) => -150.0,
            Estimator::Amplitude => 150.0,
        },
    }
}
