//! Which pixels, columns and rows stand out by more than noise and scene explain.
//!
//! What comes in: how every pixel differs from its neighbours. What goes out: those that no sound pixel of so many differs like.
//! It never knows a frame.

use super::contrast::{Contrast, median};

/// Light that spreads over several pixels does not differ by more than so many times what the third of those around it does, and
/// where a scene is sharp and stands still there is more like it. Two around it may be defects themselves.
const SHARPER: f64 = 6.0;
/// So many pixels to each side are around it.
const SURROUNDINGS: i64 = 3;
/// Frames from which a scatter is known.
const FRAMES_OF_SCATTER: usize = 8;
/// The standard deviation of the mean of the middle half, over that of the mean.
const MIDDLE: f64 = 1.09;
/// A column that differs by less than this share of what the one beside it does is moved by that: three neighbours of eight.
const BESIDE: f64 = 0.5;
/// A column's mean differs by more than this, DN, where pixels are whole numbers: less is nothing to leave out.
const LINE_DN: f64 = 0.1;

/// What frames show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DefectScene {
    /// Nothing: taken without light, or in even light.
    Dark,
    /// Something out of focus or moving.
    Running,
}

/// What a pixel has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// It reads too much.
    Hot,
    /// It reads too little, or is no number.
    Dead,
    /// It does not keep still.
    Noisy,
}

/// The faults of a plane.
pub(super) struct PlaneFaults {
    /// By the pixel's number.
    pub pixels: Vec<(usize, Fault)>,
    /// By x.
    pub columns: Vec<usize>,
    /// By y.
    pub rows: Vec<usize>,
}

impl PlaneFaults {
    /// `deviations`: so many of the sound ones' are too many.
    pub fn of(contrast: &Contrast, scene: DefectScene, deviations: f64) -> PlaneFaults {
        let [width, height] = contrast.size;
        let (columns, rows) = (lines(contrast, scene, deviations, 0), lines(contrast, scene, deviations, 1));
        let mut found = PlaneFaults { pixels: Vec::new(), columns, rows };
        let offset = Deviations::of(contrast.present(&contrast.place));
        let typical = median(&mut contrast.present(&contrast.scatter).collect::<Vec<f64>>());
        let ratios = tells_noisy(scene, contrast.frames).then(|| restlessness(contrast));
        let restless = ratios.as_ref().map(|ratios| Deviations::of(contrast.present(ratios)));
        // Of ln s², and of that of eight others' median.
        let least = (2.4 / (contrast.frames.max(2) - 1) as f64).sqrt();
        for pixel in 0..width * height {
            if contrast.absent[pixel] {
                found.pixels.push((pixel, Fault::Dead));
                continue;
            }
            let place = contrast.place[pixel] - offset.middle;
            let local = local(contrast, pixel, scene, typical);
            let deviation = offset.deviation.max(local).max(contrast.rounding).max(f64::MIN_POSITIVE);
            let around =
                || contrast.within(pixel, SURROUNDINGS).map(|near| (contrast.place[near] - offset.middle).abs());
            let is_sharp = || scene == DefectScene::Dark || place.abs() > SHARPER * third(around());
            if place.abs() > deviations * deviation && is_sharp() {
                found.pixels.push((pixel, if place > 0.0 { Fault::Hot } else { Fault::Dead }));
                continue;
            }
            let (Some(restless), Some(ratios)) = (&restless, &ratios) else { continue };
            let ratio = ratios[pixel] - restless.middle;
            // Rounding alone makes one pixel still and the next one not.
            let is_seen = contrast.variance_ln[pixel].exp().sqrt() > deviations * contrast.rounding;
            if ratio > deviations * restless.deviation.max(least) && is_seen {
                found.pixels.push((pixel, Fault::Noisy));
            }
        }
        found.take_lines(width, height);
        found
    }

    /// For every pixel whether it has a fault, or is in a line that has.
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

    /// What most of a column or row has is the column's; its pixels are not told again.
    fn take_lines(&mut self, width: usize, height: usize) {
        let (mut of_column, mut of_row) = (vec![0; width], vec![0; height]);
        for (pixel, _) in &self.pixels {
            of_column[pixel % width] += 1;
            of_row[pixel / width] += 1;
        }
        // A short line of some pixels is no line.
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

/// So many standard deviations that of `count` sound pixels no more than `alarms` are expected beyond, on either side: the
/// upper bound φ(z)/z of the normal distribution's tail.
pub(super) fn deviations(alarms: f64, count: f64) -> f64 {
    let share = (0.5 * alarms / count.max(1.0)).clamp(1e-300, 0.01);
    let mut z: f64 = 3.0;
    for _ in 0..50 {
        z = (-2.0 * (share * z * (2.0 * std::f64::consts::PI).sqrt()).ln()).max(1.0).sqrt();
    }
    z
}

/// Whether noisy pixels can be told: where a scene moves, sound ones scatter as well.
pub(super) fn tells_noisy(scene: DefectScene, frames: usize) -> bool {
    scene == DefectScene::Dark && frames >= FRAMES_OF_SCATTER
}

/// Whether nothing says what sound pixels differ by: neither noise, nor steps that pixels are rounded to.
pub(super) fn is_silent(contrast: &Contrast) -> bool {
    let is_even = contrast.rounding == 0.0 && Deviations::of(contrast.present(&contrast.place)).deviation == 0.0;
    is_even || contrast.absent.iter().all(|absent| *absent)
}

/// Where most of some values are, and how far they scatter.
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

/// The standard deviation of a pixel's place, from the scatter around it over the frames. Noise is another one in every frame;
/// what a scene has beyond that of most pixels may stay for many.
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

/// ln of each pixel's variance over that around it.
fn restlessness(contrast: &Contrast) -> Vec<f64> {
    let ratio = |pixel: usize| {
        let around = contrast.around(pixel).filter(|near| !contrast.absent[*near]);
        let mut around: Vec<f64> = around.map(|near| contrast.variance_ln[near]).collect();
        if around.is_empty() { f64::NAN } else { contrast.variance_ln[pixel] - median(&mut around) }
    };
    (0..contrast.variance_ln.len()).map(ratio).collect()
}

/// The third largest; 0 of fewer.
fn third(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(|a, b| b.total_cmp(a));
    values.get(2).copied().unwrap_or(0.0)
}

/// Columns (`axis` 0) or rows whose pixels stand out together.
fn lines(contrast: &Contrast, scene: DefectScene, deviations: f64, axis: usize) -> Vec<usize> {
    let [width, _] = contrast.size;
    let (count, length) = (contrast.size[axis], contrast.size[1 - axis]);
    let number = |line: usize, along: usize| if axis == 0 { along * width + line } else { line * width + along };
    // Shorter lines have no mean that would be better known than their pixels.
    if length < 32 || count < 8 {
        return Vec::new();
    }
    let of_line = |line: usize| {
        let present = (0..length).map(|along| number(line, along)).filter(|pixel| !contrast.absent[*pixel]);
        let mut values: Vec<f64> = present.map(|pixel| contrast.place[pixel]).collect();
        values.sort_unstable_by(f64::total_cmp);
        let middle = &values[values.len() / 4..values.len() - values.len() / 4];
        middle.iter().sum::<f64>() / middle.len() as f64
    };
    // NaN: there is nothing in a line, and it has told of its pixels one by one.
    let means: Vec<f64> = (0..count).map(of_line).collect();
    let all = Deviations::of(means.iter().copied());
    let own = Deviations::of(contrast.present(&contrast.place)).deviation * MIDDLE / (length as f64).sqrt();
    let least = if contrast.rounding > 0.0 { LINE_DN } else { f64::MIN_POSITIVE };
    let from = (deviations * all.deviation.max(own)).max(least);
    let far = |line: usize| (means[line] - all.middle).abs();
    let stands_out = |line: &usize| {
        let beside = |step: usize| {
            let step = step * contrast.spacing;
            let lines = [line.checked_sub(step), Some(line + step).filter(|line| *line < count)];
            lines.into_iter().flatten().map(far).filter(|far| !far.is_nan())
        };
        // Those beside a defect are compared with it.
        if means[*line].is_nan() || far(*line) <= from || beside(1).any(|other| far(*line) < BESIDE * other) {
            return false;
        }
        // One of them may be a defect itself.
        let mut near: Vec<f64> = beside(1).chain(beside(2)).collect();
        near.sort_unstable_by(|a, b| b.total_cmp(a));
        scene == DefectScene::Dark || far(*line) > SHARPER * near.get(1).copied().unwrap_or(0.0)
    };
    (0..count).filter(stands_out).collect()
}
