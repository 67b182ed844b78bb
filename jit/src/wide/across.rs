//! From a vector a row to a lane a row, and back.
//!
//! What comes in: as many vectors of f64 as one of them has lanes. What goes out: the lanes of each added together, or a vector
//! of the first lanes, one of the second … It must never know: what the lanes mean.

use super::block::{Block, Id};
use super::operation::{Element, Operation, pieces};
use crate::options::VectorWidth;

impl Block<'_> {
    fn pair(&mut self, [first, second]: [Operation; 2], [a, b]: [Id; 2]) -> [Id; 2] {
        [first, second].map(|operation| self.compute(operation, Element::Double, [a, b]))
    }

    /// The sum of each vector's lanes: the upper half is added to the lower one until one is left.
    pub fn totals_of(&mut self, rows: &[Id]) -> Id {
        let folds: &[[u8; 2]] = match self.width {
            VectorWidth::Bits512 => &[pieces::HALVES, pieces::EVERY_OTHER],
            _ => &[pieces::OF_TWO],
        };
        let folds = folds.iter().map(|fold| fold.map(Operation::Pieces));
        // Each fold brings the sums of two vectors together, so that in this order they end in that of the rows.
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

    /// The first lanes of all, the second lanes of all …
    pub fn transposed(&mut self, rows: &[Id]) -> Vec<Id> {
        let across = |block: &mut Self, by, pairs: &[[Id; 2]]| -> Vec<[Id; 2]> {
            pairs.iter().map(|pair| block.pair(by, *pair)).collect()
        };
        let pairs: Vec<[Id; 2]> = rows.chunks(2).map(|pair| [pair[0], pair[1]]).collect();
        // Lanes 0, 2 … and lanes 1, 3 … of two rows, pair by pair.
        let pairs = across(self, [Operation::Firsts, Operation::Seconds], &pairs);
        if self.width != VectorWidth::Bits512 {
            let by = pieces::OF_TWO.map(Operation::Pieces);
            let [even, odd] = [0, 1].map(|lane| self.pair(by, [pairs[0][lane], pairs[1][lane]]));
            return vec![even[0], odd[0], even[1], odd[1]];
        }
        let by = pieces::EVERY_OTHER.map(Operation::Pieces);
        let [even, odd] = [0, 1].map(|lane| {
            // Lanes 0 and 4, lanes 2 and 6 of four rows, and of the four behind them.
            let [first, second] = [0, 2].map(|at| self.pair(by, [pairs[at][lane], pairs[at + 1][lane]]));
            [0, 1].map(|i| self.pair(by, [first[i], second[i]]))
        });
        let lane = |i: usize| if i.is_multiple_of(2) { even } else { odd }[i % 4 / 2][i / 4];
        (0..8).map(lane).collect()
    }
}
