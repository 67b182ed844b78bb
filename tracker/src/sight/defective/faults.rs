//! Detects pixels, columns and rows that deviate by more than noise and scene explain.

use super::contrast::{Contrast, median};

/// Largest ratio of a pixel's difference to the third largest around it for light spread over several pixels, where a scene
/// is sharp and static. Two of those around it may be defects themselves.
const SHARPER: f64 = 6.0;
/// Radius of the surroundings in pixels.
const SURROUNDINGS: i64 = 3;
/// Fewest frames for a scatter.
const FRAMES_OF_SCATTER: usize = 8;
/// Standard deviation of the mean of the middle half, relative to that of the mean.
const MIDDLE: f64 = 1.09;
/// A column with less than this share of its neighbour's difference is only shifted by that neighbour, which gives three of
/// its eight neighbours.
const BESIDE: f64 = 0.5;
/// Least difference of a column's mean, DN, where pixels are whole numbers: less is negligible.
const LINE_DN: f64 = 0.1;

/// The kind of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DefectScene {
    /// Dark frames, or frames of even light.
    Dark,
    /// Frames of something out of focus or moving.
    Running,
}

/// The fault of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// It reads too much.
    Hot,
    /// It reads too little, or is not finite.
    Dead,
    /// It scatters too much.
    Noisy,
}

/// The faults of a plane.
pub(super) struct PlaneFaults {
    /// Pixel indices with their faults.
    pub pixels: Vec<(usize, Fault)>,
    /// x of the columns.
    pub columns: Vec<usize>,
    /// y of the rows.
    pub rows: Vec<usize>,
}

impl PlaneFaults {
    /// `deviations`: threshold in standard deviations of the sound pixels.
    pub fn of(contrast: &Contrast, scene: DefectScene, deviations: f64) -> PlaneFaults {
        let [width, height] = contrast.size;
        let (columns, rows) = (lines(contrast, scene, deviations, 0), lines(contrast, scene, deviations, 1));
        let mut found = PlaneFaults { pixels: Vec::new(), columns, rows };
        let offset = Deviations::of(contrast.present(&contrast.location));
        let typical = median(&mut contrast.present(&contrast.scatter).collect::<Vec<f64>>());
        let ratios = tells_noisy(scene, contrast.frames).then(|| restlessness(contrast));
        let restless = ratios.as_ref().map(|ratios| Deviations::of(contrast.present(ratios)));
        // Standard error of ln s², and of the median of eight others.
        let least = (2.4 / (contrast.frames.max(2) - 1) as f64).sqrt();
        for pixel in 0..width * height {
            if contrast.absent[pixel] {
                found.pixels.push((pixel, Fault::Dead));
                continue;
            }
            let location = contrast.location[pixel] - offset.middle;
            let local = local(contrast, pixel, scene, typical);
            let deviation = offset.deviation.max(local).max(contrast.rounding).max(f64::MIN_POSITIVE);
            let around =
                || contrast.within(pixel, SURROUNDINGS).map(|near| (contrast.location[near] - offset.middle).abs());
            let is_sharp = || scene == DefectScene::Dark || location.abs() > SHARPER * third(around());
            if location.abs() > deviations * deviation && is_sharp() {
                found.pixels.push((pixel, if location > 0.0 { Fault::Hot } else { Fault::Dead }));
                continue;
            }
            let (Some(restless), Some(ratios)) = (&restless, &ratios) else { continue };
            let ratio = ratios[pixel] - restless.middle;
            // Rounding alone makes one pixel constant and the next one not.
            let is_seen = contrast.variance_ln[pixel].exp().sqrt() > deviations * contrast.rounding;
            if ratio > deviations * restless.deviation.max(least) && is_seen {
                found.pixels.push((pixel, Fault::Noisy));
            }
        }
        found.take_lines(width, height);
        found
    }

    /// Marks each pixel that has a fault, or is in a faulty line.
    pub fn pixels_of(&self, [width, height]: [usize; 2]) -> Vec<bool> {
        let mut faulty = vec![false; width * height];
        self.pixels.iter().for_each(|(pixel, _)| faulty[*pixel] = true);
        for x in &self.columns {
            faulty.iter_mut().skip(*x).step_by(width).for_each(|pixel| *pixel = true);
        }
        for y in &self.rows {
            faulty[y * width..][..width].fill(true);
        }
        faulty
    }

    /// Assigns faults shared by most of a column or row to that line, and drops its pixels.
    fn take_lines(&mut self, width: usize, height: usize) {
        let (mut of_column, mut of_row) = (vec![0; width], vec![0; height]);
        for (pixel, _) in &self.pixels {
            of_column[pixel % width] += 1;
            of_row[pixel / width] += 1;
        }
        // A short line does not count.
        let most = |counts: &[usize], length: usize| {
            let counts = counts.iter().enumerate().filter(move |(_, count)| length >= 8 && 2 * **count > length);
            counts.map(|(line, _)| line).collect::<Vec<usize>>()
        };
        for (lines, more) in [(&mut self.columns, most(&of_column, height)), (&mut self.rows, most(&of_row, width))] {
            lines.extend(more);
            lines.sort_unstable();
            lines.dedup();
        }
        let (columns, rows) = (&self.columns, &self.rows);
        self.pixels.retain(|(pixel, _)| {
            columns.binary_search(&(pixel % width)).is_err() && rows.binary_search(&(pixel / width)).is_err()
        });
    }
}

/// The threshold in standard deviations that no more than `alarms` of `count` sound pixels are expected to exceed, on
/// either side: from the upper bound φ(z)/z of the normal distribution's tail.
pub(super) fn deviations(alarms: f64, count: f64) -> f64 {
    let share = (0.5 * alarms / count.max(1.0)).clamp(1e-300, 0.01);
    let mut z: f64 = 3.0;
    for _ in 0..50 {
        z = (-2.0 * (share * z * (2.0 * std::f64::consts::PI).sqrt()).ln()).max(1.0).sqrt();
    }
    z
}

/// Whether noisy pixels are detectable: in a running scene sound ones scatter as well.
pub(super) fn tells_noisy(scene: DefectScene, frames: usize) -> bool {
    scene == DefectScene::Dark && frames >= FRAMES_OF_SCATTER
}

/// Whether the scatter of sound pixels is unknown: without noise and without rounding steps.
pub(super) fn is_silent(contrast: &Contrast) -> bool {
    let is_even = contrast.rounding == 0.0 && Deviations::of(contrast.present(&contrast.location)).deviation == 0.0;
    is_even || contrast.absent.iter().all(|absent| *absent)
}

/// Robust location and scatter.
struct Deviations {
    middle: f64,
    deviation: f64,
}

impl Deviations {
    fn of(values: impl Iterator<Item = f64>) -> Deviations {
        let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        if values.is_empty() {
            return Deviations { middle: 0.0, deviation: 0.0 };
        }
        let middle = median(&mut values);
        let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
        Deviations { middle, deviation: 0.5 * (at(0.84) - at(0.16)) }
    }
}

/// The standard deviation of a pixel's location, from the scatter around it over the frames. Noise is independent between
/// frames; excess scatter of a scene may last for many.
fn local(contrast: &Contrast, pixel: usize, scene: DefectScene, typical: f64) -> f64 {
    let mut scatter = [0.0; 9];
    let all = contrast.around(pixel).filter(|near| !contrast.absent[*near]).chain([pixel]);
    let count = scatter.iter_mut().zip(all).map(|(scatter, near)| *scatter = contrast.scatter[near]).count();
    let scatter = median(&mut scatter[..count]);
    let noise = MIDDLE / (contrast.frames.max(1) as f64).sqrt();
    match scene {
        DefectScene::Dark => scatter * noise,
        DefectScene::Running => (typical * noise).hypot((scatter.powi(2) - typical.powi(2)).max(0.0).sqrt()),
    }
}

/// ln of each pixel's variance relative to that around it.
fn restlessness(contrast: &Contrast) -> Vec<f64> {
    let ratio = |pixel: usize| {
        let around = contrast.around(pixel).filter(|near| !contrast.absent[*near]);
        let mut around: Vec<f64> = around.map(|near| contrast.variance_ln[near]).collect();
        if around.is_empty() { f64::NAN } else { contrast.variance_ln[pixel] - median(&mut around) }
    };
    (0..contrast.variance_ln.len()).map(ratio).collect()
}

/// The third largest; 0 if there are fewer.
fn third(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(|a, b| b.total_cmp(a));
    values.get(2).copied().unwrap_or(0.0)
}

/// Columns (`axis` 0) or rows whose pixels deviate together.
fn lines(contrast: &Contrast, scene: DefectScene, deviations: f64, axis: usize) -> Vec<usize> {
    let [width, _] = contrast.size;
    let (count, length) = (contrast.size[axis], contrast.size[1 - axis]);
    let number = |line: usize, along: usize| if axis == 0 { along * width + line } else { line * width + along };
    // Means of shorter lines are hardly better known than their pixels.
    if length < 32 || count < 8 {
        return Vec::new();
    }
    let of_line = |line: usize| {
        let present = (0..length).map(|along| number(line, along)).filter(|pixel| !contrast.absent[*pixel]);
        let mut values: Vec<f64> = present.map(|pixel| contrast.location[pixel]).collect();
        values.sort_unstable_by(f64::total_cmp);
        let middle = &values[values.len() / 4..values.len() - values.len() / 4];
        middle.iter().sum::<f64>() / middle.len() as f64
    };
    // NaN: a line without finite pixels; these are reported one by one.
    let means: Vec<f64> = (0..count).map(of_line).collect();
    let all = Deviations::of(means.iter().copied());
    let own = Deviations::of(contrast.present(&contrast.location)).deviation * MIDDLE / (length as f64).sqrt();
    let least = if contrast.rounding > 0.0 { LINE_DN } else { f64::MIN_POSITIVE };
    let from = (deviations * all.deviation.max(own)).max(least);
    let far = |line: usize| (means[line] - all.middle).abs();
    let stands_out = |line: &usize| {
        let beside = |step: usize| {
            let step = step * contrast.spacing;
            let lines = [line.checked_sub(step), Some(line + step).filter(|line| *line < count)];
            lines.into_iter().flatten().map(far).filter(|far| !far.is_nan())
        };
        // Neighbours of a defect are compared with it.
        if means[*line].is_nan() || far(*line) <= from || beside(1).any(|other| far(*line) < BESIDE * other) {
            return false;
        }
        // One neighbour may be a defect itself.
        let mut near: Vec<f64> = beside(1).chain(beside(2)).collect();
        near.sort_unstable_by(|a, b| b.total_cmp(a));
        scene == DefectScene::Dark || far(*line) > SHARPER * near.get(1).copied().unwrap_or(0.0)
    };
    (0..count).filter(stands_out).collect()
}
