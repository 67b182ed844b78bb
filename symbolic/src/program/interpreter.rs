//! Reference interpreter of a [`LoopNest`]: native code must equal its results bit for bit. Written for clarity, not
//! speed.

use std::marker::PhantomData;

use isophote_elementary::MAGIC;

use crate::program::arithmetic::{Double, Number, Single};
use crate::program::walk::{ByLevel, Place, Walk, Walked, folded, walk};
pub use crate::program::window::{Slices, Window};
use crate::program::{Bindings, ChannelId, CoordinateId, InputId, Lanes, LoopNest, Precision, Sink, Summation};

/// Source of pixels. Coordinates are those of the whole plane.
pub trait Pixels {
    /// A channel's pixel as stored; f32 and integers are exact in f64.
    fn at(&self, channel: usize, x: usize, y: usize) -> f64;

    /// The pixel at (x, y, z, w); by default the same in all slices.
    fn at_place(&self, channel: usize, [x, y, ..]: [usize; 4]) -> f64 {
        self.at(channel, x, y)
    }
}

/// Result of a run.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Outcome {
    /// The program's outputs; empty for a plane.
    pub outputs: Vec<f64>,
    /// Pixels used.
    pub pixels: u64,
    /// Saturated pixels left out of the set.
    pub saturated: u64,
}

/// Rounds to the nearest integer, ties to even, for magnitudes below 2⁵¹; larger ones come back nearly as they are.
pub fn nearest(x: f64) -> f64 {
    (x + MAGIC) - MAGIC
}

/// Runs a program over a window, in the order of a [`Summation`] or of [`Lanes`]. `plane` is the output of a plane
/// program: adds a value to each pixel of the window.
pub fn run(
    program: &LoopNest,
    precision: Precision,
    order: impl Into<Summation>,
    bindings: &Bindings<'_>,
    pixels: &dyn Pixels,
    window: Window,
    plane: Option<&mut [f32]>,
) -> Outcome {
    if window.width == 0 {
        return Outcome::default();
    }
    let inputs: Vec<f64> = program.gather(bindings).collect();
    let [depth, length] = match program.coordinates {
        0..=2 => [1, 1],
        3 => [window.slices.count[0], 1],
        _ => window.slices.count,
    };
    let order: Summation = order.into();
    let sums = matches!(program.sink, Sink::Sums { .. });
    let narrow = order.narrow_in(window, window.height * depth * length).filter(|_| sums).map(Lanes::count);
    let (lanes, apart) = (narrow.unwrap_or(order.lanes.count()), order.rows);
    macro_rules! run {
        ($number:ty) => {{
            let inner = PhantomData::<$number>;
            let is_narrow = narrow.is_some();
            let mut groups = Groups { inner, lanes, apart, is_narrow, inputs, pixels, window, depth, length, plane };
            walk(&ByLevel::of(program), &program.pixel_set, &mut groups)
        }};
    }
    let Walked { outputs, pixels, saturated } = match (precision, program.fused) {
        (Precision::F32, false) => run!(Single<false>),
        (Precision::F32, true) => run!(Single<true>),
        (Precision::F64, false) => run!(Double<false>),
        (Precision::F64, true) => run!(Double<true>),
    };
    Outcome { outputs: outputs.into_iter().map(f64::from).collect(), pixels, saturated }
}

/// The number type of all levels but the pixel level.
type Scalar = Double<false>;

/// Groups of pixels, one per lane; all other levels run in f64.
struct Groups<'a, N> {
    inner: PhantomData<N>,
    lanes: usize,
    /// Rows of a block.
    apart: usize,
    is_narrow: bool,
    inputs: Vec<f64>,
    pixels: &'a dyn Pixels,
    window: Window,
    /// Slices of a volume, volumes.
    depth: usize,
    length: usize,
    plane: Option<&'a mut [f32]>,
}

impl<N> Groups<'_, N> {
    /// The coordinates y, z, w of a row.
    fn outer(&self, row: usize) -> [usize; 3] {
        let Window { y, height, slices, .. } = self.window;
        let slice = row / height;
        [y + row % height, slices.first[0] + slice % self.depth, slices.first[1] + slice / self.depth]
    }
}

impl<N: Number + Into<f64>> Walk for Groups<'_, N> {
    type Outer = Scalar;
    type Inner = N;

    fn lanes(&self) -> usize {
        self.lanes
    }
    fn rows(&self) -> usize {
        self.window.height * self.depth * self.length
    }
    fn rows_apart(&self) -> usize {
        self.apart
    }
    /// In a narrow window see [`Summation::narrow_in`]. Otherwise all groups but the last are full; the last has the
    /// remaining pixels, starts further left where it would leave the window, and its lanes before them take no part.
    fn places(&self, bounds: Option<[Scalar; 2]>) -> Vec<Place> {
        let Some((start, end)) = row_range(bounds.map(|both| both.map(f64::from)), self.window) else {
            return Vec::new();
        };
        if self.is_narrow {
            return (start..=end).map(|column| Place { column, lane: column % self.lanes }).collect();
        }
        let rest = start + (end - start) / self.lanes * self.lanes;
        let last = rest.min(self.window.width.saturating_sub(self.lanes));
        let lane = |column| if column < rest { (column - start) % self.lanes } else { column - last };
        (start..=end).map(|column| Place { column, lane: lane(column) }).collect()
    }
    fn input(&self, input: InputId) -> Scalar {
        self.inputs[input.index()].into()
    }
    fn coordinate(&self, coordinate: CoordinateId, row: usize) -> Scalar {
        (self.outer(row)[coordinate.index() - 1] as f64).into()
    }
    fn offset(&self, places: &[Place], c: Scalar) -> Vec<N> {
        let Some(first) = places.first() else { return Vec::new() };
        let c = f64::from(c);
        let n = nearest(-c);
        let base = N::from((self.window.x + first.column) as f64 - n);
        let (step, fraction) = (N::from(self.lanes as f64), N::from(c + n));
        if self.is_narrow {
            let along = |place: &Place| N::from((place.column - first.column) as f64);
            return places.iter().map(|place| base + along(place) + fraction).collect();
        }
        let mut running: Vec<N> = (0..self.lanes).map(|l| base + N::from(l as f64)).collect();
        let mut values = Vec::with_capacity(places.len());
        let groups = places.chunks(self.lanes);
        let last = groups.len() - 1;
        for (at, group) in groups.enumerate() {
            let shift = N::from(0.0 - group[0].lane as f64);
            let here = |lane: usize| if at == last { running[lane] + shift } else { running[lane] };
            values.extend(group.iter().map(|place| here(place.lane) + fraction));
            running.iter_mut().for_each(|t| *t = *t + step);
        }
        values
    }
    fn pixel(&self, channel: ChannelId, column: usize, row: usize) -> N {
        let [y, z, w] = self.outer(row);
        N::from(self.pixels.at_place(channel.index(), [self.window.x + column, y, z, w]))
    }
    fn rounded(&self, x: Scalar) -> N {
        N::from(x.into())
    }
    fn total(&self, lanes: &[N]) -> Scalar {
        let lanes: Vec<Scalar> = lanes.iter().map(|x| Scalar::from((*x).into())).collect();
        folded(&lanes)
    }
    fn takes(&mut self, column: usize, row: usize, shown: Option<N>) {
        if let (Some(value), Some(plane)) = (shown, self.plane.as_deref_mut()) {
            plane[row * self.window.width + column] += value.into() as f32;
        }
    }
}

/// First and last pixel of the row, relative to the window.
fn row_range(bounds: Option<[f64; 2]>, window: Window) -> Option<(usize, usize)> {
    let Some([lo, hi]) = bounds else { return Some((0, window.width - 1)) };
    let (first, last) = (window.x as f64, (window.x + window.width - 1) as f64);
    // A NaN fails the comparison and empties the row.
    let ordered = |a: f64, b: f64| a <= b;
    if !ordered(lo, hi) {
        return None;
    }
    let lo = if lo > first { lo } else { first };
    let hi = if hi < last { hi } else { last };
    if !ordered(lo, hi) {
        return None;
    }
    let distance = lo - first;
    let mut start = distance as i64;
    start += i64::from((start as f64) < distance);
    let end = (hi - first) as i64;
    (start <= end).then_some((start as usize, end as usize))
}
