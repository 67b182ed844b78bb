//! Peaks of a filtered picture, in standard deviations of its noise: each target once, at its best size.

use super::Strength;
use super::alarm::Thresholds;
use super::level::{Octave, deviation};
use super::template::Template;
use crate::sight::start::Detection;

/// Side of a noise cell, pixels, about.
const CELL_PX: usize = 128;
/// A cell has the whole map's noise unless it differs by more than this many of its own standard errors.
const ALIKE: f64 = 3.0;
/// Relative standard error of a median of magnitudes of n values, times √n.
const MEDIAN_SPREAD: f64 = 1.17;
/// Values of a cell that are sampled, about.
const CELL_SAMPLES: usize = 2048;
/// Margin below the threshold at which maxima of pixels are evaluated: the true top is higher than the pixels beside it.
const BELOW: f64 = 0.8;
/// On a background whose bumps grow with their size the tip of a large thing is more significant than the whole: a peak
/// this many times larger than a stronger one, two sizes of the bank, is kept as well.
const LARGER: f64 = 1.9;
/// A budget: peaks kept per map, for each detection that is wanted.
const PEAKS_PER_DETECTION: usize = 12;

/// The kind of background.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BackgroundKind {
    /// Noise alone.
    Even,
    /// Bumps of all sizes.
    Uneven,
}

/// A possible target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    pub strength: Strength,
    /// Signed brightness.
    amplitude: f64,
    background: f64,
}

/// All peaks of a picture.
#[derive(Debug, Default)]
pub(super) struct Peaks {
    found: Vec<Peak>,
    strongest: Option<Peak>,
}

impl Peak {
    /// The starting values for a fit.
    pub fn detection(&self) -> Detection {
        let Strength { place: [x, y], size_px, .. } = self.strength;
        let mut extent = [[0.0; 4]; 4];
        (extent[0][0], extent[1][1]) = (size_px.powi(-2), size_px.powi(-2));
        Detection {
            centre: [x, y, 0.0, 0.0],
            extent,
            size: [size_px, size_px, 0.0, 0.0],
            background: self.background,
            amplitude: self.amplitude,
            saturated: 0,
        }
    }

    /// Excess over the threshold.
    fn excess(&self) -> f64 {
        self.strength.score - self.strength.threshold
    }

    /// True when one of the two may be a part of the other, unless this one is so much larger that the other may be its
    /// tip.
    fn is_same(&self, other: &Peak, apart: f64, background_kind: BackgroundKind) -> bool {
        let ([x, y], [u, v]) = (self.strength.place, other.strength.place);
        let (own, others) = (self.strength.size_px, other.strength.size_px);
        let is_whole = background_kind == BackgroundKind::Uneven && own >= LARGER * others;
        (x - u).hypot(y - v) < apart * own.max(others) && !is_whole
    }
}

impl Peaks {
    /// The strongest peaks up to a count, at least `apart` sizes from each other, on uneven background also those they may
    /// be the tip of; and the strongest of all, above its threshold or not.
    pub fn strongest(
        mut self,
        count_max: usize,
        apart: f64,
        background_kind: BackgroundKind,
    ) -> (Vec<Peak>, Option<Peak>) {
        self.found.sort_by(|a, b| b.strength.score.total_cmp(&a.strength.score));
        let mut kept: Vec<Peak> = Vec::new();
        for peak in self.found {
            if kept.len() == count_max {
                break;
            }
            if !kept.iter().any(|other| peak.is_same(other, apart, background_kind)) {
                kept.push(peak);
            }
        }
        (kept, self.strongest)
    }

    /// Adds the peaks of a map, of which `count_max` detections are wanted.
    pub fn collect(&mut self, map: &[f32], template: &Template, level: &Octave, limits: Thresholds, count_max: usize) {
        let (width, height) = (level.width, level.height);
        if width < 3 || height < 3 {
            return;
        }
        let cells = Cells::of(map, width, height, level.least);
        let already = self.found.len();
        for (sign, limit) in [(1.0_f32, Some(limits.upright)), (-1.0, limits.reversed)] {
            let Some(limit) = limit else { continue };
            let mut highest = f64::NEG_INFINITY;
            for (row, column) in (0..cells.down).flat_map(|row| (0..cells.across).map(move |column| (row, column))) {
                let noise = cells.noise[row * cells.across + column];
                if !(noise > 0.0 && noise.is_finite()) {
                    continue;
                }
                let bar = |highest: f64| (highest.min(limit - BELOW) * noise) as f32;
                let mut least = bar(highest);
                for y in cells.rows(row, height) {
                    let columns = cells.columns(column, width);
                    for (x, value) in columns.clone().zip(&map[y * width..][columns]) {
                        if sign * value < least {
                            continue;
                        }
                        let Some((place, top)) = summit(map, [x, y], [width, height], sign) else { continue };
                        let score = top / noise;
                        highest = highest.max(f64::from(sign * value) / noise);
                        least = bar(highest);
                        let size_px = template.size_px;
                        let strength = Strength { score, threshold: limit, place: level.in_frame(place), size_px };
                        let amplitude = f64::from(sign) * top * template.height;
                        let peak = Peak { strength, amplitude, background: level.background(place) };
                        if self.strongest.is_none_or(|best| score - limit > best.excess()) {
                            self.strongest = Some(peak);
                        }
                        if score >= limit {
                            self.found.push(peak);
                        }
                    }
                }
            }
        }
        let most = PEAKS_PER_DETECTION * count_max;
        if self.found.len() > already + most {
            self.found[already..].sort_by(|a, b| b.strength.score.total_cmp(&a.strength.score));
            self.found.truncate(already + most);
        }
    }
}

/// The noise of a map, by cells.
struct Cells {
    across: usize,
    down: usize,
    noise: Vec<f64>,
}

impl Cells {
    /// For a kernel of unit norm; no noise is less than `least`.
    fn of(map: &[f32], width: usize, height: usize, least: f64) -> Cells {
        let (across, down) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let mut cells = Cells { across, down, noise: Vec::new() };
        // Strided: neighbours in a row are correlated.
        let every = |count: usize, target: usize| (count as f64 / target as f64).sqrt().ceil().max(1.0) as usize;
        let mut deviations = Vec::with_capacity(across * down);
        let mut samples = 0;
        for (row, column) in (0..down).flat_map(|row| (0..across).map(move |column| (row, column))) {
            let (rows, columns) = (cells.rows(row, height), cells.columns(column, width));
            let step = every(rows.len() * columns.len(), CELL_SAMPLES);
            let of_row = |y: usize| map[y * width..][columns.clone()].iter().step_by(step).copied();
            samples = rows.clone().step_by(step).len() * columns.clone().step_by(step).len();
            deviations.push(deviation(rows.step_by(step).flat_map(of_row)));
        }
        let mut sorted = deviations.clone();
        sorted.sort_by(f64::total_cmp);
        let typical = sorted[sorted.len() / 2];
        // Neighbours are correlated, so there are fewer independent values.
        let spread = ALIKE * MEDIAN_SPREAD / (0.25 * samples as f64).sqrt().max(1.0);
        let settled = |own: f64| if (own / typical - 1.0).abs() <= spread { typical } else { own };
        cells.noise = deviations.into_iter().map(|own| settled(own).max(least)).collect();
        cells
    }

    fn rows(&self, row: usize, height: usize) -> std::ops::Range<usize> {
        row * height / self.down..(row + 1) * height / self.down
    }

    fn columns(&self, column: usize, width: usize) -> std::ops::Range<usize> {
        column * width / self.across..(column + 1) * width / self.across
    }
}

/// Position and value of the top of a Gaussian through a pixel and its neighbours, if none of these is higher. Near its top
/// a correlation of two images of a few pixels is a Gaussian, and its logarithm a parabola. At the border the pixel itself.
fn summit(map: &[f32], [x, y]: [usize; 2], [width, height]: [usize; 2], sign: f32) -> Option<([f64; 2], f64)> {
    let at = |x: usize, y: usize| f64::from(sign * map[y * width + x]);
    let here = at(x, y);
    for row in y.saturating_sub(1)..(y + 2).min(height) {
        for column in x.saturating_sub(1)..(x + 2).min(width) {
            let is_before = (row, column) < (y, x);
            let done = at(column, row);
            if done > here || (is_before && done == here) {
                return None;
            }
        }
    }
    // Offset of the top, and the factor by which it is higher.
    let along = |before: f64, after: f64| -> (f64, f64) {
        if before.min(after) <= 0.0 || here <= 0.0 {
            return (0.0, 1.0);
        }
        let [before, after] = [before / here, after / here].map(f64::ln);
        let (slope, bend) = (0.5 * (after - before), before + after);
        if bend < 0.0 { (-slope / bend, (-0.5 * slope * slope / bend).exp()) } else { (0.0, 1.0) }
    };
    let is_inside = |at: usize, count: usize| at > 0 && at + 1 < count;
    let (dx, along_x) = if is_inside(x, width) { along(at(x - 1, y), at(x + 1, y)) } else { (0.0, 1.0) };
    let (dy, along_y) = if is_inside(y, height) { along(at(x, y - 1), at(x, y + 1)) } else { (0.0, 1.0) };
    Some(([x as f64 + dx, y as f64 + dy], here * along_x * along_y))
}
