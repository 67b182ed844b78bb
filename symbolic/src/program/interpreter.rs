//! The meaning of a [`Program`]: what comes in is a program, numbers and pixels; what goes out are the sums that native
//! code must equal bit for bit. It is written to be read, not to be fast.

use crate::program::arithmetic::{Arithmetic, Double, Single};
use crate::program::elementary::{MAGIC, Plain};
use crate::program::walk::{Place, Walk, Walked, walk};
use crate::program::{Bindings, ChannelId, CoordinateId, InputId, Precision, Program};

/// Where pixels come from. Coordinates are those of the whole plane.
pub trait Pixels {
    /// The pixel of a channel of a picture, as stored; f32 and integers are exact in f64.
    fn at(&self, channel: usize, x: usize, y: usize) -> f64;

    /// The pixel at (x, y, z, w). What has no slices is the same in all of them.
    fn at_place(&self, channel: usize, [x, y, ..]: [usize; 4]) -> f64 {
        self.at(channel, x, y)
    }
}

/// The third and fourth coordinate of a window: which slices of which volumes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Slices {
    /// First slice, first volume.
    pub first: [usize; 2],
    /// How many slices of each volume, how many volumes.
    pub count: [usize; 2],
}

impl Slices {
    /// The one slice of a picture.
    pub const ONE: Slices = Slices { first: [0, 0], count: [1, 1] };
    /// As many as there are.
    pub const ALL: Slices = Slices { first: [0, 0], count: [usize::MAX, usize::MAX] };
}

/// A rectangle of pixels, in one slice or in several.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Window {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Slices; more than one only for a program of more than two coordinates.
    pub slices: Slices,
}

/// What a run hands back.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Outcome {
    /// The program's outputs; empty for a plane.
    pub outputs: Vec<f64>,
    /// Pixels used.
    pub pixels: u64,
    /// Pixels of the set that were left out as saturated.
    pub saturated: u64,
}

/// Rounds to the nearest integer, ties to even, for magnitudes below 2⁵¹; larger ones come back nearly as they are.
pub fn nearest(x: f64) -> f64 {
    (x + MAGIC) - MAGIC
}

/// Runs a program over a window. `plane` is the output of a plane program: a value for each pixel of the window, added to.
pub fn run(
    program: &Program,
    precision: Precision,
    bindings: &Bindings<'_>,
    pixels: &dyn Pixels,
    window: Window,
    plane: Option<&mut [f32]>,
) -> Outcome {
    in_lanes(program, precision, precision.lanes(), bindings, pixels, window, plane)
}

/// The same with another number of lanes, which exported source may have: 1, 2, 4, 8 or 16; `None` for any other.
pub fn run_in_lanes(
    program: &Program,
    precision: Precision,
    lanes: usize,
    bindings: &Bindings<'_>,
    pixels: &dyn Pixels,
    window: Window,
    plane: Option<&mut [f32]>,
) -> Option<Outcome> {
    let is_known = matches!(lanes, 1 | 2 | 4 | 8 | 16);
    is_known.then(|| in_lanes(program, precision, lanes, bindings, pixels, window, plane))
}

fn in_lanes(
    program: &Program,
    precision: Precision,
    lanes: usize,
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
    let machine = Plain { fused: program.fused };
    macro_rules! run {
        ($arithmetic:ident) => {{
            let inner = $arithmetic(machine);
            let mut lanes = Lanes { inner, lanes, inputs, pixels, window, depth, length, plane };
            walk(program, &program.pixel_set, &mut lanes)
        }};
    }
    let Walked { outputs, pixels, saturated } = match precision {
        Precision::F32 => run!(Single),
        Precision::F64 => run!(Double),
    };
    Outcome { outputs, pixels, saturated }
}

/// Groups of pixels, one a lane; everything outside of the pixel loop in f64.
struct Lanes<'a, A> {
    inner: A,
    lanes: usize,
    inputs: Vec<f64>,
    pixels: &'a dyn Pixels,
    window: Window,
    /// Slices of a volume, volumes.
    depth: usize,
    length: usize,
    plane: Option<&'a mut [f32]>,
}

impl<A> Lanes<'_, A> {
    /// Where a row is: y, z, w.
    fn outer(&self, row: usize) -> [usize; 3] {
        let Window { y, height, slices, .. } = self.window;
        let slice = row / height;
        [y + row % height, slices.first[0] + slice % self.depth, slices.first[1] + slice / self.depth]
    }
}

impl<A: Arithmetic<Number: Into<f64>>> Walk for Lanes<'_, A> {
    type Outer = Double;
    type Inner = A;

    fn arithmetic(&self) -> (Double, A) {
        (Double(Plain { fused: false }), self.inner)
    }
    fn lanes(&self) -> usize {
        self.lanes
    }
    fn rows(&self) -> usize {
        self.window.height * self.depth * self.length
    }
    /// All groups but the last are full. The last one has the pixels that are left; where it would leave the window it
    /// begins further left, and lanes in front of them take no part either.
    fn places(&self, bounds: Option<[f64; 2]>) -> Vec<Place> {
        let Some((start, end)) = row_range(bounds, self.window) else { return Vec::new() };
        let rest = start + (end - start) / self.lanes * self.lanes;
        let last = rest.min(self.window.width.saturating_sub(self.lanes));
        let lane = |column| if column < rest { (column - start) % self.lanes } else { column - last };
        (start..=end).map(|column| Place { column, lane: lane(column) }).collect()
    }
    fn input(&self, input: InputId) -> f64 {
        self.inputs[input.index()]
    }
    fn coordinate(&self, coordinate: CoordinateId, row: usize) -> f64 {
        self.outer(row)[coordinate.index() - 1] as f64
    }
    fn offset(&self, places: &[Place], c: f64) -> Vec<A::Number> {
        let m = self.inner;
        let Some(first) = places.first() else { return Vec::new() };
        let n = nearest(-c);
        let base = m.constant((self.window.x + first.column) as f64 - n);
        let (step, fraction) = (m.constant(self.lanes as f64), m.constant(c + n));
        let mut running: Vec<A::Number> = (0..self.lanes).map(|l| m.add(base, m.constant(l as f64))).collect();
        let mut values = Vec::with_capacity(places.len());
        let groups = places.chunks(self.lanes);
        let last = groups.len() - 1;
        for (at, group) in groups.enumerate() {
            let shift = m.constant(0.0 - group[0].lane as f64);
            let here = |lane: usize| if at == last { m.add(running[lane], shift) } else { running[lane] };
            values.extend(group.iter().map(|place| m.add(here(place.lane), fraction)));
            running.iter_mut().for_each(|t| *t = m.add(*t, step));
        }
        values
    }
    fn pixel(&self, channel: ChannelId, column: usize, row: usize) -> A::Number {
        let [y, z, w] = self.outer(row);
        self.inner.constant(self.pixels.at_place(channel.index(), [self.window.x + column, y, z, w]))
    }
    fn rounded(&self, x: f64) -> A::Number {
        self.inner.constant(x)
    }
    /// The upper half of the lanes is added to the lower one until one is left.
    fn total(&self, lanes: &[A::Number]) -> f64 {
        let mut sum: Vec<f64> = lanes.iter().map(|x| (*x).into()).collect();
        let mut half = sum.len() / 2;
        while half > 0 {
            (0..half).for_each(|l| sum[l] += sum[l + half]);
            half /= 2;
        }
        sum[0]
    }
    fn takes(&mut self, column: usize, row: usize, shown: Option<A::Number>) {
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
