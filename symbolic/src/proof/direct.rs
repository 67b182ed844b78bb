//! Evaluates a document's formulas on a picture, for tests of running programs: each sum and the sum of its absolute
//! terms, pixel by pixel from the formulas as they were read, as in the check.

use crate::graph::random::Random;
use crate::model::points::Point;
use crate::program::interpreter::{Pixels, Window};
use crate::program::{Bindings, ChannelId};
use crate::proof::pixels::Windowed;
use crate::proof::referee::Referee;

/// Sums over the pixels of a window that take part.
#[derive(Clone, Debug)]
pub struct DirectSums {
    /// In the order of a program's outputs: a sum, and the sum of its absolute terms. `None` where one is not finite.
    pub sums: Option<Vec<[f64; 2]>>,
    /// Number of those pixels.
    pub pixels: u64,
}

impl Referee {
    /// `nudge`: relative perturbation of parameters, constants and coordinates, of random sign and size, to find outcomes
    /// that rounding may decide.
    pub fn direct(
        &self,
        dropped: &[ChannelId],
        bindings: &Bindings<'_>,
        pixels: &dyn Pixels,
        window: Window,
        nudge: f64,
    ) -> DirectSums {
        let mut random = Random(0);
        let mut near = |x: f64| x + nudge * random.signed() * x.abs().max(1.0);
        let Window { x, y, width, height, slices } = window;
        let coordinates = self.subject.model().coordinates.len();
        let [[z, w], [depth, length]] = [slices.first, slices.count];
        let volumes = (w..w + length).flat_map(|w| (z..z + depth).map(move |z| [z, w]));
        let rows: Vec<[usize; 3]> = volumes.flat_map(|[z, w]| (y..y + height).map(move |y| [y, z, w])).collect();
        let mut all = |numbers: &[f64]| numbers.iter().map(|x| near(*x)).collect::<Vec<f64>>();
        let columns: Vec<f64> = (x..x + width).map(|x| x as f64).collect();
        let mut shown = Vec::new();
        for channel in 0..self.subject.model().channels.len() {
            let row =
                |[y, z, w]: &[usize; 3]| (x..x + width).map(|x| pixels.at_place(channel, [x, *y, *z, *w])).collect();
            shown.extend(rows.iter().flat_map(|place| -> Vec<f64> { row(place) }));
        }
        let point = Point {
            parameters: all(bindings.parameters),
            entry: all(bindings.entry),
            constants: all(bindings.constants),
            limits: bindings.saturation.to_vec(),
            shift: vec![0.0; coordinates],
            columns: all(&columns),
            rows: rows.iter().map(|row| all(&row.map(|place| place as f64)[..coordinates - 1])).collect(),
            pixels: shown,
        };
        let window = Windowed::at(&self.subject, dropped, point);
        let pixels = window.taken.iter().filter(|taken| **taken).count() as u64;
        let sums = window.sums.map(|sums| sums.iter().map(|sum| [sum.value, sum.terms]).collect());
        DirectSums { sums, pixels }
    }
}
