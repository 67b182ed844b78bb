//! Synthetic points: deterministic values for all parameters of a model, near a typical start, and the window around them.

use isophote_jit::Window;
use isophote_symbolic::{Estimator, Model, Parameter, Start};

use crate::track::window::{Margin, Reach};

/// Half widths of targets with up to two and with more dimensions, px; reports are for the first.
const SIZES_PX: [[f64; 3]; 2] = [[12.0, 4.0, 40.0], [4.0, 3.0, 6.0]];
/// Positions of the targets, px.
const MIDDLES_PX: [[f64; 4]; 2] = [[100.3, 80.7, 0.0, 0.0], [20.3, 18.7, 8.3, 4.7]];
/// End of a picture of unknown reach beyond the middle, in sizes.
const BEYOND: f64 = 4.0;
/// Least side of such a picture, px.
const SIDES_PX: [[f64; 4]; 2] = [[128.0, 96.0, 1.0, 1.0], [36.0, 32.0, 16.0, 8.0]];
/// Distance between targets of one model, in sizes.
const APART: f64 = 3.0;
/// Background and amplitude for an 8-bit camera, pixel values.
const BACKGROUND: f64 = 20.0;
const AMPLITUDE: f64 = 160.0;
/// Frequency of a wave, cycles per pixel.
const FREQUENCY: f64 = 0.08;
/// Least distance from a bound, relative to the bound or to one.
const INSIDE: f64 = 0.05;

/// Values of all parameters of a model, and the window around its targets.
#[derive(Clone, Debug)]
pub(crate) struct ModelPoint {
    pub parameters: Vec<f64>,
    pub window: Window,
}

/// Values of parameters that start at numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Numbers {
    /// Unchanged.
    AsStarted,
    /// All perturbed by up to a tenth of themselves plus this number.
    Shaken(f64),
    /// One perturbed, by its index.
    Moved(usize),
}

/// Sizes to try, px.
pub(crate) fn sizes(model: &Model) -> [f64; 3] {
    SIZES_PX[usize::from(model.coordinates().len() > 2)]
}

impl ModelPoint {
    /// `None` when constraints do not hold, or the domain is outside the picture.
    pub fn made_up(model: &Model, constants: &[f64], reach: &Reach, size: f64, numbers: Numbers) -> Option<ModelPoint> {
        let parameters = parameters(model, size, numbers);
        if !model.constraints_hold(&parameters, constants) {
            return None;
        }
        let whole = Window::of_size(sides(model, &parameters, size));
        let window = reach.window(model, &parameters, Margin::even(0.1, 2.0), whole)?;
        Some(ModelPoint { parameters, window })
    }
}

/// Distance of a target with a synthetic pose, mm.
const DISTANCE_MM: f64 = 1000.0;

/// Sides of the picture.
fn sides(model: &Model, parameters: &[f64], size: f64) -> [usize; 4] {
    let n = model.coordinates().len();
    let kind = usize::from(n > 2);
    std::array::from_fn(|axis| {
        if axis >= n {
            return 1;
        }
        let centres = model.roles().iter().filter_map(|roles| roles.centre.get(axis)).map(|p| parameters[p.index()]);
        let farthest = centres.fold(MIDDLES_PX[kind][axis], f64::max).min(1024.0);
        (farthest + BEYOND * size).max(SIDES_PX[kind][axis]).ceil() as usize
    })
}

fn parameters(model: &Model, size: f64, numbers: Numbers) -> Vec<f64> {
    let n = model.coordinates().len();
    let middle = MIDDLES_PX[usize::from(n > 2)];
    let target = |index: usize| model.roles().iter().position(|roles| roles.centre.iter().any(|p| p.index() == index));
    let made_up = |(index, parameter): (usize, &Parameter)| {
        let off = off(index, size);
        let value = match parameter.start {
            Start::Number(value) => match numbers {
                Numbers::Shaken(by) => value + off * (0.1 * value + by),
                Numbers::Moved(moved) if moved == index => value + 0.1 * value.abs().max(1.0),
                _ => value,
            },
            Start::Estimator(estimator) => match estimator {
                Estimator::Centroid(0) => middle[0] + APART * size * target(index).unwrap_or(0) as f64 + off,
                Estimator::Centroid(axis) => middle[axis] + off,
                Estimator::Extent(row, column) if row == column => (1.0 + 0.3 * off) / (size * size),
                Estimator::Extent(..) => (0.1 + 0.1 * off) / (size * size),
                Estimator::Size(_) => size * (1.0 + 0.2 * off),
                Estimator::Background => BACKGROUND + off,
                Estimator::Angle | Estimator::Direction | Estimator::Phase => 0.5 * off,
                Estimator::Frequency => FREQUENCY * (1.0 + 0.1 * off),
                Estimator::Position(2) => DISTANCE_MM * (1.0 + 0.1 * off),
                Estimator::Position(_) => 10.0 * off,
                Estimator::Orientation(_) => 0.1 * off,
                Estimator::Amplitude if parameter.max.is_some_and(|max| max <= 0.0) => -AMPLITUDE * (1.0 + 0.1 * off),
                Estimator::Amplitude => AMPLITUDE * (1.0 + 0.1 * off),
            },
        };
        inside(parameter, value)
    };
    model.parameters().iter().enumerate().map(made_up).collect()
}

/// A quasi-random number between −1 and 1 for each parameter and size: multiples of the golden ratio.
fn off(index: usize, size: f64) -> f64 {
    let turns = 0.618_033_988_749_895 * (index as f64 + 1.0) + 0.37 * size;
    2.0 * turns.fract() - 1.0
}

fn inside(parameter: &Parameter, value: f64) -> f64 {
    let least = parameter.min.map(|min| min + INSIDE * min.abs().min(1.0));
    let most = parameter.max.map(|max| max - INSIDE * max.abs().min(1.0));
    match (parameter.min, parameter.max) {
        (Some(min), Some(max)) if !(value > min && value < max) => 0.5 * (min + max),
        (Some(min), _) if value <= min => least.filter(|least| *least > min).unwrap_or(min + INSIDE),
        (_, Some(max)) if value >= max => most.filter(|most| *most < max).unwrap_or(max - INSIDE),
        _ => value,
    }
}
