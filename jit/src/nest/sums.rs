//! Horizontal sums: the lanes that the pixel loop leaves become an f64 per row, the totals of the rows an f64 per total.
//!
//! The upper half is added to the lower one until one lane is left.

use isophote_symbolic::Precision;

use super::places::{Homes, parts};
use crate::options::{KernelOptions, VectorWidth};
use crate::vector::{Block, Element, Id, Integer, MemoryPlace, Operation, Portion, VectorCode};

const DOUBLE: Element = Element::Double;

fn lanes(width: VectorWidth) -> usize {
    width.bytes() / DOUBLE.bytes()
}

/// The sum of the lanes of a vector of 128 bits, in the first lane of f64.
pub(super) fn of_vector(block: &mut Block<'_>, precision: Precision, sum: Id) -> Id {
    let lanes = match precision {
        Precision::F64 => sum,
        Precision::F32 => {
            let high = block.compute(Operation::UpperHalf, Element::Single, [sum]);
            let [low, high] = [sum, high].map(|half| block.compute(Operation::Widen, DOUBLE, [half]));
            block.compute(Operation::Add, DOUBLE, [low, high])
        }
    };
    let second = block.compute(Operation::Seconds, DOUBLE, [lanes, lanes]);
    block.compute(Operation::Add, DOUBLE, [lanes, second])
}

/// Adds the lanes of each row's sums, for rows with a vector each.
pub(super) fn of_vectors(options: &KernelOptions, places: &Homes, code: &mut VectorCode) {
    let (bytes, lanes) = (options.width.bytes(), lanes(options.width));
    let pitch = places.sums.len() * bytes;
    let mut block = Block::new(&mut code.constants, options.width);
    for (sums, row_sums) in places.sums.iter().zip(&places.row_sums) {
        for part in 0..parts(options.width) {
            let rows: Vec<Id> = (0..lanes)
                .map(|row| in_f64(&mut block, options.precision, sums.plus((part * lanes + row) * pitch)))
                .collect();
            let totals = block.totals_of(&rows);
            block.store(DOUBLE, Portion::Whole, totals, row_sums.plus(part * bytes));
        }
    }
    let parts = block.into_parts();
    code.append(parts, 0);
}

/// A vector of sums as f64; for f32 the sum of both halves.
fn in_f64(block: &mut Block<'_>, precision: Precision, sum: MemoryPlace) -> Id {
    if precision == Precision::F64 {
        return block.kept(sum);
    }
    let [low, high] = [sum, sum.plus(block.width.bytes() / 2)].map(|half| widened(block, half));
    block.compute(Operation::Add, DOUBLE, [low, high])
}

/// Half a vector of f32 in memory, as f64.
fn widened(block: &mut Block<'_>, half: MemoryPlace) -> Id {
    let half = block.fleeting(half);
    block.compute(Operation::Widen, DOUBLE, [half])
}

/// Widens the sums of rows with a lane each, or with one in each half of an f32 vector.
pub(super) fn of_lanes(options: &KernelOptions, places: &Homes, code: &mut VectorCode) {
    let bytes = options.width.bytes();
    let mut block = Block::new(&mut code.constants, options.width);
    for (sums, row_sums) in places.sums.iter().zip(&places.row_sums) {
        let sums = &sums.indexed(Integer::Block, 8);
        let row_sums = row_sums.indexed(Integer::Block, DOUBLE.bytes() as u32);
        if parts(options.width) == 1 {
            let totals = in_f64(&mut block, Precision::F32, *sums);
            block.store(DOUBLE, Portion::Whole, totals, row_sums);
            continue;
        }
        for part in 0..parts(options.width) {
            let totals = widened(&mut block, sums.plus(part * bytes / 2));
            block.store(DOUBLE, Portion::Whole, totals, row_sums.plus(part * bytes));
        }
    }
    let parts = block.into_parts();
    code.append(parts, 0);
}

/// Adds the totals of a block's rows.
pub(super) fn of_pass(options: &KernelOptions, places: &Homes, code: &mut VectorCode) {
    let (bytes, lanes) = (options.width.bytes(), lanes(options.width));
    let mut block = Block::new(&mut code.constants, options.width);
    for (totals, to) in places.totals.chunks(lanes).zip(places.pass_totals.chunks(lanes)) {
        let mut rows: Vec<Id> = totals
            .iter()
            .map(|total| {
                let lower = block.kept(*total);
                (1..parts(options.width)).fold(lower, |sum, part| {
                    let upper = block.kept(total.plus(part * bytes));
                    block.compute(Operation::Add, DOUBLE, [sum, upper])
                })
            })
            .collect();
        let zero = block.number(DOUBLE, 0.0);
        rows.resize(lanes, zero);
        let totals = block.totals_of(&rows);
        block.store(DOUBLE, Portion::Whole, totals, to[0]);
    }
    let parts = block.into_parts();
    code.append(parts, 0);
}
