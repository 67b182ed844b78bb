//! Horizontal sums and transposition: from a vector per row to a lane per row.
//!
//! The input is as many vectors of f64 as one has lanes, or eight of f32.

use crate::options::{ROWS, VectorWidth};
use crate::vector::{Block, Element, Id, Operation, pieces};

impl Block<'_> {
    fn pair(&mut self, [first, second]: [Operation; 2], [a, b]: [Id; 2]) -> [Id; 2] {
        [first, second].map(|operation| self.compute(operation, Element::Double, [a, b]))
    }

    /// The sum of each vector's lanes: adds the upper half to the lower one until one lane is left.
    pub fn totals_of(&mut self, rows: &[Id]) -> Id {
        let folds: &[[u8; 2]] = match self.width {
            VectorWidth::Bits512 => &[pieces::HALVES, pieces::EVERY_OTHER],
            VectorWidth::Bits256 => &[pieces::OF_TWO],
            VectorWidth::Bits128 => &[],
        };
        let folds = folds.iter().map(|fold| fold.map(Operation::Pieces));
        // Each fold combines the sums of two vectors; in this order they end up in the order of the rows.
        let [even, odd] = [0, 1].map(|first| rows.iter().skip(first).step_by(2));
        let mut left: Vec<Id> = even.chain(odd).copied().collect();
        for fold in folds.chain([[Operation::Firsts, Operation::Seconds]]) {
            let sum = |pair: &[Id]| {
                let [lower, upper] = self.pair(fold, [pair[0], pair[1]]);
                self.compute(Operation::Add, Element::Double, [lower, upper])
            };
            left = left.chunks(2).map(sum).collect();
        }
        left[0]
    }

    /// Transposes eight rows of pixels into a vector per step: at 256 bits the first pixels of all rows, the second ones …, at
    /// 512 bits the first pixels followed by the second ones, then the third and the fourth …
    pub fn columns_of(&mut self, rows: &[Id; ROWS]) -> [Id; ROWS] {
        let single = |block: &mut Self, operation, [a, b]: [Id; 2]| block.compute(operation, Element::Single, [a, b]);
        let double = |block: &mut Self, operation, [a, b]: [Id; 2]| block.compute(operation, Element::Double, [a, b]);
        // In each 128 bits: the first pixels of four rows, the second ones …
        let [upper, lower] = [0, 4].map(|first| {
            let [a, b] = [0, 2].map(|at| {
                let pair = [rows[first + at], rows[first + at + 1]];
                [Operation::Lows, Operation::Highs].map(|operation| single(self, operation, pair))
            });
            let of = |block: &mut Self, half: usize| {
                let pair = [a[half], b[half]];
                [Operation::Firsts, Operation::Seconds].map(|operation| double(block, operation, pair))
            };
            let [[first, second], [third, fourth]] = [0, 1].map(|half| of(self, half));
            [first, second, third, fourth]
        });
        if self.width != VectorWidth::Bits512 {
            let [near, far] = pieces::OF_TWO.map(|by| {
                [0, 1, 2, 3].map(|column| double(self, Operation::Pieces(by), [upper[column], lower[column]]))
            });
            return std::array::from_fn(|column| if column < 4 { near[column] } else { far[column - 4] });
        }
        // Both columns of a step, of the first and the second 128 bits, of the third and the fourth.
        let [even, odd] = [0, 2].map(|column| {
            let [near, far] = pieces::HALVES.map(|half| {
                [column, column + 1].map(|column| double(self, Operation::Pieces(half), [upper[column], lower[column]]))
            });
            [near, far].map(|both| pieces::EVERY_OTHER.map(|by| double(self, Operation::Pieces(by), both)))
        });
        std::array::from_fn(|step| if step % 2 == 0 { even } else { odd }[step / 4][step / 2 % 2])
    }
}
