//! Evaluates a [`LoopNest`](crate::program::LoopNest) in any arithmetic ([`Number`]: f64, double-double, residues),
//! without lanes: the real-number formulas of its instructions. It shares the walk ([`crate::program::walk`]) and the
//! table of operations with the interpreter, which adds the rounding of a run.

pub(crate) use crate::program::arithmetic::Number;
pub(crate) use crate::program::walk::ByLevel;
use crate::program::walk::{Place, Walk, walk};
use crate::program::{ChannelId, CoordinateId, InputId, PixelSet};

/// Input of an evaluation: numbers for a program's inputs, coordinates and pixels.
pub(crate) struct Raster<'a, N> {
    /// In the order of [`LoopNest::inputs`].
    pub inputs: Vec<N>,
    /// Values of the inner coordinate.
    pub columns: Vec<N>,
    /// Values of the outer coordinates, one list a row.
    pub rows: Vec<Vec<N>>,
    /// The pixel of a channel, at an index into the columns and one into the rows.
    pub pixel: &'a dyn Fn(usize, usize, usize) -> N,
    /// Takes every pixel, ignoring the program's pixel set.
    pub every_pixel: bool,
}

/// Result of an evaluation.
pub(crate) struct Evaluated<N> {
    /// Empty for a plane program.
    pub outputs: Vec<N>,
    /// The pixels taken, row by row.
    pub taken: Vec<bool>,
}

/// Evaluates a program.
pub(crate) fn evaluate_at<N: Number>(loops: &ByLevel<'_>, sample: &Raster<'_, N>) -> Evaluated<N> {
    let set = if sample.every_pixel { PixelSet::default() } else { *loops.program().pixel_set() };
    let mut exactly = Exactly { sample, taken: vec![false; sample.rows.len() * sample.columns.len()] };
    let outputs = walk(loops, &set, &mut exactly).outputs;
    Evaluated { outputs, taken: exactly.taken }
}

/// A walk over a sample: one lane, and every column as it is.
struct Exactly<'s, 'p, N> {
    sample: &'s Raster<'p, N>,
    taken: Vec<bool>,
}

impl<N: Number> Walk for Exactly<'_, '_, N> {
    type Outer = N;
    type Inner = N;

    fn lanes(&self) -> usize {
        1
    }
    fn rows(&self) -> usize {
        self.sample.rows.len()
    }
    fn rows_apart(&self) -> usize {
        1
    }
    fn places(&self, bounds: Option<[N; 2]>) -> Vec<Place> {
        let inside = |(_, x): &(usize, &N)| bounds.is_none_or(|[lo, hi]| lo <= **x && **x <= hi);
        let columns = self.sample.columns.iter().enumerate().filter(inside);
        columns.map(|(column, _)| Place { column, lane: 0 }).collect()
    }
    fn input(&self, input: InputId) -> N {
        self.sample.inputs[input.index()]
    }
    fn coordinate(&self, coordinate: CoordinateId, row: usize) -> N {
        self.sample.rows[row][coordinate.index() - 1]
    }
    fn offset(&self, places: &[Place], c: N) -> Vec<N> {
        places.iter().map(|place| self.sample.columns[place.column] + c).collect()
    }
    fn pixel(&self, channel: ChannelId, column: usize, row: usize) -> N {
        (self.sample.pixel)(channel.index(), column, row)
    }
    fn rounded(&self, x: N) -> N {
        x
    }
    fn total(&self, lanes: &[N]) -> N {
        lanes[0]
    }
    fn takes(&mut self, column: usize, row: usize, _: Option<N>) {
        self.taken[row * self.sample.columns.len() + column] = true;
    }
}
