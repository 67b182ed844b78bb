//! Starts at given distances from an answer, inside bounds and constraints; the direction is determined by a number.

use isophote_symbolic::{Model, ParameterId};
use serde::Serialize;

/// How far a start is from the answer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Offset {
    /// Of each target's centre, px.
    pub centre_px: f64,
    /// Of everything else, as a share: of semi-axes, of brightness (a background is off by half of that share of the
    /// brightness), of other values.
    pub share: f64,
}

/// Largest number of times that an infeasible start is moved half way to the answer.
const HALVINGS: usize = 30;

/// A point that is `offset` away from `answer` in the parameters `varied`; deterministic in `number`. Of all values
/// that a share applies to, the one that moves most moves by the full share.
pub(super) fn start(
    model: &Model,
    constants: &[f64],
    answer: &[f64],
    varied: &[ParameterId],
    offset: Offset,
    number: u64,
) -> Vec<f64> {
    let mut moved = answer.to_vec();
    let directions = directions(answer.len(), varied, model, number);
    let share = |parameter: ParameterId| offset.share * directions[parameter.index()];
    for parameter in varied {
        let value = answer[parameter.index()];
        moved[parameter.index()] = value * (1.0 + share(*parameter));
    }
    for roles in model.roles() {
        for parameter in &roles.centre {
            moved[parameter.index()] = answer[parameter.index()] + offset.centre_px * directions[parameter.index()];
        }
        move_shape(&mut moved, answer, &roles.shape, model.coordinates().len(), &share);
        if let Some(parameter) = roles.brightness {
            moved[parameter.index()] = answer[parameter.index()] * share(parameter).exp();
        }
        if let (Some(background), Some(brightness)) = (roles.background, roles.brightness) {
            let off = 0.5 * share(background) * answer[brightness.index()].abs();
            moved[background.index()] = answer[background.index()] + off;
        }
    }
    for (index, value) in moved.iter_mut().enumerate() {
        if !varied.iter().any(|parameter| parameter.index() == index) {
            *value = answer[index];
        }
    }
    for _ in 0..HALVINGS {
        if model.constraints_hold(&moved, constants) {
            return moved;
        }
        moved.iter_mut().zip(answer).for_each(|(value, answer)| *value = 0.5 * (*value + answer));
    }
    answer.to_vec()
}

/// A′ = D A D with D diagonal: each semi-axis changes by its own share, and A stays positive definite; the entries beside
/// the diagonal turn it a little more.
fn move_shape(
    moved: &mut [f64],
    answer: &[f64],
    shape: &[ParameterId],
    dimensions: usize,
    share: &dyn Fn(ParameterId) -> f64,
) {
    if shape.len() != dimensions * (dimensions + 1) / 2 {
        return;
    }
    let entries: Vec<(usize, usize)> =
        (0..dimensions).flat_map(|row| (row..dimensions).map(move |column| (row, column))).collect();
    let entry = |row: usize, column: usize| {
        entries.iter().zip(shape).find(|(entry, _)| **entry == (row, column)).map(|(_, parameter)| *parameter)
    };
    let diagonal: Vec<ParameterId> = (0..dimensions).filter_map(|axis| entry(axis, axis)).collect();
    for ((row, column), parameter) in entries.iter().zip(shape) {
        let factor = (-share(diagonal[*row]) - share(diagonal[*column])).exp();
        let turn = match row == column {
            true => 0.0,
            false => {
                let of = |axis: usize| answer[diagonal[axis].index()].abs();
                0.5 * share(*parameter) * (of(*row) * of(*column)).sqrt()
            }
        };
        moved[parameter.index()] = (answer[parameter.index()] + turn) * factor;
    }
}

/// A number in −1 … 1 for each parameter: along the centres a unit vector for each target, of the others the largest is ±1.
fn directions(count: usize, varied: &[ParameterId], model: &Model, number: u64) -> Vec<f64> {
    let mut directions: Vec<f64> = (0..count).map(|index| signed_unit(number, index as u64)).collect();
    let centres = model.roles().iter().map(|roles| &roles.centre).filter(|centre| !centre.is_empty());
    for centre in centres.clone() {
        let length = centre.iter().map(|p| directions[p.index()].powi(2)).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        centre.iter().for_each(|p| directions[p.index()] /= length);
    }
    let centre_parameters: Vec<&ParameterId> = centres.flatten().collect();
    let others: Vec<usize> = varied
        .iter()
        .filter(|parameter| !centre_parameters.contains(parameter))
        .map(|parameter| parameter.index())
        .collect();
    let largest = others.iter().map(|&index| directions[index].abs()).fold(f64::MIN_POSITIVE, f64::max);
    others.iter().for_each(|&index| directions[index] /= largest);
    directions
}

/// Uniform over −1 … 1: the finaliser of SplitMix64 (Steele, Lea and Flood 2014) of the two numbers.
fn signed_unit(number: u64, index: u64) -> f64 {
    let mut z = number.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(index.wrapping_mul(0xd1b5_4a32_d192_ed03));
    for multiplier in [0xbf58_476d_1ce4_e5b9, 0x94d0_49bb_1331_11eb] {
        z = (z ^ (z >> 30)).wrapping_mul(multiplier);
        z ^= z >> 27;
    }
    (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
