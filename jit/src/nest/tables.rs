//! Table lookups: finds each lane's cell and gathers a number per lane.
//!
//! The cell is computed in lane arithmetic, as by [`isophote_symbolic::Table`]. Right before the gather it is clamped to the
//! last cell, unsigned, which proves to the verifier that no number leads outside the table.

use isophote_symbolic::{Axis, Lookup, Tables};
use smallvec::{SmallVec, smallvec};

use crate::vector::{Act, Block, Element, Id, Operation, comparison};

impl Block<'_> {
    /// Looks up a number for each lane.
    pub fn looked_up(&mut self, element: Element, tables: &Tables, lookup: Lookup, places: [Id; 2]) -> Id {
        let Some(table) = tables.all().get(usize::from(lookup.table)) else {
            unreachable!("the check refuses tables that do not exist")
        };
        let first = tables.start(lookup.table) + usize::from(lookup.coefficient);
        let offset = (size_of::<f64>() * first) as i32;
        let key = (lookup.table, places);
        let cells = match self.cells.get(&key) {
            Some(cells) => cells.clone(),
            None => {
                let cells = self.cells_at(element, table.axes(), table.coefficients(), places);
                self.cells.insert(key, cells.clone());
                cells
            }
        };
        let bound = self.pattern((table.numbers().len() - table.coefficients()) as u64);
        let numbers: SmallVec<[Id; 2]> = cells
            .into_iter()
            .map(|cells| {
                let result = self.new_value();
                self.act(Act::Gather { cells, bound, offset, result });
                result
            })
            .collect();
        match numbers[..] {
            [low, high] => {
                let halves = [low, high].map(|half| self.compute(Operation::Narrow, Element::Double, [half]));
                self.compute(Operation::Join, Element::Single, halves)
            }
            _ => numbers[0],
        }
    }

    /// The index of the first number of each lane's cell, as 64-bit integers: for f32 of the lower and of the upper half.
    fn cells_at(&mut self, element: Element, axes: &[Axis], coefficients: usize, places: [Id; 2]) -> SmallVec<[Id; 2]> {
        let mut cell = self.cell(element, axes[0], places[0]);
        if let Some(axis) = axes.get(1) {
            let row = self.cell(element, *axis, places[1]);
            let width = self.number(element, axes[0].cells() as f64);
            let before = self.compute(Operation::Mul, element, [row, width]);
            cell = self.compute(Operation::Add, element, [before, cell]);
        }
        let coefficients = self.number(element, coefficients as f64);
        let begin = self.compute(Operation::Mul, element, [cell, coefficients]);
        let doubles: SmallVec<[Id; 2]> = match element {
            Element::Double => smallvec![begin],
            Element::Single => {
                let upper = self.compute(Operation::UpperHalf, element, [begin]);
                [begin, upper].map(|half| self.compute(Operation::Widen, Element::Double, [half])).into()
            }
        };
        doubles.into_iter().map(|begin| self.nearest(begin)[1]).collect()
    }

    /// The cell index along an axis, as a number; 0 before the first sample and for NaN.
    fn cell(&mut self, element: Element, axis: Axis, t: Id) -> Id {
        // A whole number added to it appears in its low bits.
        let whole = match element {
            Element::Single => f64::from(1.0 / f32::EPSILON),
            Element::Double => 1.0 / f64::EPSILON,
        };
        let [zero, one, last, whole] = [0.0, 1.0, (axis.count - 1) as f64, whole].map(|x| self.number(element, x));
        let is_inside = self.compute(Operation::Compare(comparison::AT_MOST), element, [zero, t]);
        let is_less = self.compute(Operation::Compare(comparison::LESS), element, [t, last]);
        let t = self.compute(Operation::Select, element, [is_less, t, last]);
        let shifted = self.compute(Operation::Add, element, [t, whole]);
        let nearest = self.compute(Operation::Sub, element, [shifted, whole]);
        let is_above = self.compute(Operation::Compare(comparison::LESS), element, [t, nearest]);
        let above = self.compute(Operation::And, element, [is_above, one]);
        let floor = self.compute(Operation::Sub, element, [nearest, above]);
        let cell = self.compute(Operation::Add, element, [floor, one]);
        self.compute(Operation::And, element, [cell, is_inside])
    }
}
