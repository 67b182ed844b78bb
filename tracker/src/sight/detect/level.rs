//! `Mended` and `Octave`: a picture without single bad pixels, halved repeatedly, and its difference from the local
//! background, with noise and skewness, at each octave.

use crate::sight::background::Background;
use crate::sight::grey::Grey;
use crate::sight::mask::Mask;
use crate::statistics::DEVIATION_OF_MEDIAN;

/// Side of a block whose median is the background, pixels.
const BLOCK_PX: usize = 32;
/// Sampling of a block's pixels along x and y.
const EVERY: usize = 2;
/// A bad pixel differs from all its neighbours by at least this many standard deviations.
const BAD: f32 = 6.0;
/// At most one of a bad pixel's eight neighbours differs by more than this share of that. For the image of a point spread
/// by 0.7 px and more, several do.
const NEIGHBOUR: f32 = 0.2;
/// Outlier limit in standard deviations.
const NOISE: f64 = 5.0;
/// A deviation of fewer times that of rounding is not measurable by the median.
const ROUNDED: f64 = 2.5;
/// Pixels sampled for the noise, about.
const SAMPLES: usize = 60_000;
/// Fewest pixels that determine their noise, including that of sums over a few of them.
const PIXELS_RELIABLE: usize = 10_000;
/// Fewest pixels that show whether noise falls between octaves as expected.
const PIXELS_RELIABLE_BUMPS: usize = 2_500;
/// Tolerance of the fall of the noise's variance between octaves, as a factor.
const EVEN: f64 = 1.1;

/// One picture without bad pixels.
#[derive(Clone, Debug)]
pub(super) struct Mended {
    pub values: Vec<f32>,
    pub width: usize,
    pub height: usize,
    /// Least standard deviation of a pixel, from rounding, or as found where there are more pixels.
    least: f64,
}

/// A picture minus its background.
#[derive(Clone, Debug)]
pub(super) struct Octave {
    /// Number of halvings.
    pub number: usize,
    /// Differences from the background.
    pub values: Vec<f32>,
    pub width: usize,
    pub height: usize,
    /// Standard deviation of a pixel, and its lower limit.
    pub noise: f64,
    pub least: f64,
    /// RMS of the pixels without outliers.
    spread: f64,
    pub skewness: f64,
    background: BlockBackground,
}

/// The background at the centre of each block, row by row.
#[derive(Clone, Debug)]
struct BlockBackground {
    values: Vec<f32>,
    across: usize,
    down: usize,
}

impl Mended {
    /// Full resolution, with bad pixels and masked regions replaced by background.
    pub fn of(grey: &Grey, masks: &[Mask]) -> Mended {
        let [width, height, ..] = grey.size;
        let mut values: Vec<f32> = grey.values.iter().map(|value| *value as f32).collect();
        if !masks.is_empty() {
            // Masks clear to 0: that marks the pixels to replace by the plane through the border.
            let background = Background::fit(grey);
            let mut marks = vec![1.0; values.len()];
            masks.iter().for_each(|mask| mask.clear(&mut marks, grey.size));
            for (i, value) in values.iter_mut().enumerate().filter(|(i, _)| marks[*i] == 0.0) {
                *value = background.at(grey.place(i)) as f32;
            }
        }
        // Floats are rounded, too: their sums relative to the brightest adjacent pixels. A lone bright pixel is mended.
        let rounding = (grey.step / 12.0_f64.sqrt()).max(f64::from(f32::EPSILON) * grey.reached());
        let mut picture = Mended { values, width, height, least: rounding };
        picture.mend();
        picture
    }

    /// Half the resolution along x and y, each pixel the mean of four.
    pub fn halved(&self) -> Mended {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut values = Vec::with_capacity(width * height);
        for rows in self.values.chunks_exact((2 * self.width).max(1)).take(height) {
            let (upper, lower) = rows.split_at(self.width);
            let cells = upper.chunks_exact(2).zip(lower.chunks_exact(2));
            values.extend(cells.map(|(above, below)| 0.25 * (above[0] + above[1] + below[0] + below[1])));
        }
        Mended { values, width, height, least: 0.5 * self.least }
    }

    /// A picture of few pixels has at least the noise expected from the finer octave of many: its own estimate would be
    /// random.
    pub fn learned(self, before: &Octave) -> Mended {
        let is_reliable = before.values.len() < PIXELS_RELIABLE || self.values.len() >= PIXELS_RELIABLE;
        if is_reliable { self } else { Mended { least: self.least.max(0.5 * before.noise), ..self } }
    }

    /// Replaces each bad pixel by the median of its neighbours.
    fn mend(&mut self) {
        let width = self.width;
        if width < 3 || self.height < 3 {
            return;
        }
        let stride = (self.values.len() / SAMPLES).max(1);
        let steps = self.values.windows(2).step_by(stride).map(|two| two[1] - two[0]);
        let noise = (deviation(steps) / 2.0_f64.sqrt()).max(self.least) as f32;
        let mut mended = Vec::new();
        let off = BAD * noise;
        for (y, row) in self.values.chunks_exact(width).enumerate() {
            let mut repair =
                |x: usize| mended.extend(self.bad(x, y, off).map(|background| (y * width + x, background)));
            repair(0);
            repair(width - 1);
            for (x, three) in row.windows(3).enumerate() {
                // A bad pixel has at most one bad neighbour.
                if (three[1] - three[0]).abs() > off || (three[1] - three[2]).abs() > off {
                    repair(x + 1);
                }
            }
        }
        mended.into_iter().for_each(|(i, background)| self.values[i] = background);
    }

    /// The median of the neighbours of a bad pixel; `None` for a good one.
    fn bad(&self, x: usize, y: usize, off: f32) -> Option<f32> {
        let value = self.values[y * self.width + x];
        let mut near = [0.0; 8];
        let mut count = 0;
        for row in y.saturating_sub(1)..(y + 2).min(self.height) {
            for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                if (row, column) != (y, x) {
                    near[count] = self.values[row * self.width + column];
                    count += 1;
                }
            }
        }
        let near = &mut near[..count];
        near.sort_by(f32::total_cmp);
        let middle = 0.5 * (near[count / 2] + near[(count - 1) / 2]);
        let height = (value - middle).abs();
        let second = (near[count - 2] - middle).max(middle - near[1]);
        (height > off && second < NEIGHBOUR * height).then_some(middle)
    }
}

impl Octave {
    /// The differences from the background in a picture halved `number` times.
    pub fn of(picture: Mended, number: usize) -> Octave {
        let background = BlockBackground::of(&picture);
        let Mended { mut values, width, height, least } = picture;
        let columns: Vec<_> = (0..width).map(|x| BlockBackground::among(x as f32, width, background.across)).collect();
        for (y, row) in values.chunks_exact_mut(width.max(1)).enumerate() {
            background.take_from(row, y, height, &columns);
        }
        let stride = values.len() / SAMPLES + 1;
        let sample = || values.iter().step_by(stride).copied();
        let noise = deviation(sample()).max(least);
        let near = || sample().map(|value| f64::from(value) / noise).filter(|value| value.abs() < NOISE);
        let (count, cubes) = near().fold((0.0, 0.0), |(count, cubes), value| (count + 1.0, cubes + value.powi(3)));
        let skewness = if noise > 0.0 && count > 0.0 { cubes / count } else { 0.0 };
        let limit = NOISE * noise.max(ROUNDED * least);
        let near = sample().map(f64::from).filter(|value| value.abs() < limit);
        let (count, squares) =
            near.fold((0.0_f64, 0.0), |(count, squares), value| (count + 1.0, squares + value * value));
        let spread = (squares / count.max(1.0)).sqrt();
        Octave { number, values, width, height, noise, spread, least, skewness, background }
    }

    /// The share of the next octave's variance that is not noise: that of independent pixels falls to a quarter. The
    /// smaller of the estimates by median and by mean square: whole pixel values bias the one, a few bright things the
    /// other. `None` with too few pixels.
    pub fn bumps(&self, coarser: &Octave) -> Option<f64> {
        let quarter = |here: f64, next: f64| (0.5 * here / next).powi(2);
        let [median, mean] = [quarter(self.noise, coarser.noise), quarter(self.spread, coarser.spread)];
        let is_reliable = coarser.values.len() >= PIXELS_RELIABLE_BUMPS && median.is_finite() && mean.is_finite();
        is_reliable.then(|| (1.0 - EVEN * median.max(mean)).max(0.0))
    }

    /// Pixels of the frame along one of its pixels.
    pub fn pitch(&self) -> f64 {
        (1_u64 << self.number) as f64
    }

    /// Position of one of its pixels in the frame.
    pub fn in_frame(&self, place: [f64; 2]) -> [f64; 2] {
        place.map(|at| (at + 0.5) * self.pitch() - 0.5)
    }

    /// The background at one of its pixels.
    pub fn background(&self, place: [f64; 2]) -> f64 {
        f64::from(self.background.at(place[0] as f32, place[1] as f32, self.width, self.height))
    }
}

impl BlockBackground {
    fn of(picture: &Mended) -> BlockBackground {
        let (across, down) = (picture.width.div_ceil(BLOCK_PX).max(1), picture.height.div_ceil(BLOCK_PX).max(1));
        let mut values = Vec::with_capacity(across * down);
        let mut block = Vec::with_capacity(BLOCK_PX * BLOCK_PX);
        let side = |number: usize, count: usize, length: usize| number * length / count..(number + 1) * length / count;
        for row in 0..down {
            for column in 0..across {
                block.clear();
                for y in side(row, down, picture.height).step_by(EVERY) {
                    let columns = side(column, across, picture.width);
                    let line = &picture.values[y * picture.width..][columns];
                    block.extend(line.iter().step_by(EVERY));
                }
                values.push(middle(&mut block));
            }
        }
        BlockBackground { values, across, down }
    }

    /// The two blocks whose centres enclose pixel `at` of `length`, and the interpolation weight. Extrapolates beyond the
    /// last centres.
    fn among(at: f32, length: usize, count: usize) -> (usize, usize, f32) {
        let place = (at + 0.5) * count as f32 / length as f32 - 0.5;
        let first = (place.max(0.0) as usize).min(count.saturating_sub(2));
        (first, (first + 1).min(count - 1), place - first as f32)
    }

    fn at(&self, x: f32, y: f32, width: usize, height: usize) -> f32 {
        let ((left, right, u), (upper, lower, v)) =
            (BlockBackground::among(x, width, self.across), BlockBackground::among(y, height, self.down));
        let row = |row: usize| {
            let (a, b) = (self.values[row * self.across + left], self.values[row * self.across + right]);
            a + u * (b - a)
        };
        let (above, below) = (row(upper), row(lower));
        above + v * (below - above)
    }

    fn take_from(&self, row: &mut [f32], y: usize, height: usize, columns: &[(usize, usize, f32)]) {
        let (upper, lower, v) = BlockBackground::among(y as f32, height, self.down);
        let (above, below) = (&self.values[upper * self.across..][..self.across], &self.values[lower * self.across..]);
        let knots: Vec<f32> = above.iter().zip(below).map(|(a, b)| a + v * (b - a)).collect();
        for (value, (left, right, u)) in row.iter_mut().zip(columns) {
            *value -= knots[*left] + u * (knots[*right] - knots[*left]);
        }
    }
}

/// The median; reorders the values; 0 if empty.
pub(super) fn middle(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// The standard deviation of normal values about 0 with few outliers: from the median of the magnitudes.
pub(super) fn deviation(values: impl Iterator<Item = f32>) -> f64 {
    let mut magnitudes: Vec<f32> = values.map(f32::abs).collect();
    DEVIATION_OF_MEDIAN * f64::from(middle(&mut magnitudes))
}
