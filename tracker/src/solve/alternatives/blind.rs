//! What hides a target: saturated pixels that it does not explain, what lies near them, and what stands in front of it are
//! taken out of the picture.
//!
//! What comes in: a picture and residuals. What goes out: a copy of the picture in which blind pixels are NaN. It never
//! knows a fit.

use isophote_jit::{PixelFormat, PlaneView};
use isophote_symbolic::Precision;

use crate::sight::view::View;
use crate::solve::residuals::Seen;

/// A saturated pixel is the target's where this share of the way from the background to the limit is predicted, while
/// parameters are those of a start …
const EXPLAINED_FIRST: f64 = 0.02;
/// … and later.
const EXPLAINED: f64 = 0.77;
/// Glare dies away over so many px, in every direction.
const SPREAD_PX: usize = 12;
/// The edge of what is in front of a target covers pixels in part: beside those that are far off, and no farther from them
/// than so many px, …
const EDGE_PX: usize = 3;
/// … those that are this many standard deviations off.
const DOUBTFUL: f64 = 2.0;
/// Fewer blind pixels than this are a hot pixel or a rim.
const PIXELS_MIN: usize = 12;

/// How well a target's parameters are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    /// They are those of a start.
    Roughly,
    /// They are those of a fit.
    Well,
}

/// Which pixels of a window are blind.
pub(crate) struct BlindMask {
    pub pixels: Vec<bool>,
}

impl BlindMask {
    /// What the residuals of a model say: `None` when nothing is hidden. With `outlier`, residuals of that many standard
    /// deviations that hang together are of something in front of the target.
    pub fn of(view: &View, seen: &[Seen], known: Known, outlier: Option<f64>) -> Option<BlindMask> {
        let [width, height, ..] = view.window.size();
        let glare = glaring(view, seen, known).map(|area| widened(&area, width, height, SPREAD_PX));
        let hidden = outlier.and_then(|limit| hidden(view, seen, limit));
        let pixels = match (glare, hidden) {
            (Some(glare), Some(hidden)) => glare.iter().zip(hidden).map(|(a, b)| *a || b).collect(),
            (glare, hidden) => glare.or(hidden)?,
        };
        Some(BlindMask { pixels })
    }
}

/// Saturated pixels that a target does not explain.
fn glaring(view: &View, seen: &[Seen], known: Known) -> Option<Vec<bool>> {
    let [width, height, ..] = view.window.size();
    let mut blind = vec![false; view.window.pixels()];
    for one in seen {
        let (Seen { residuals, limit }, floor) = (one, one.floor());
        let share = match known {
            Known::Roughly => EXPLAINED_FIRST,
            Known::Well => EXPLAINED,
        };
        let explained = floor + share * (limit - floor);
        for residual in residuals.iter().filter(|r| r.saturated && r.predicted < explained) {
            blind[residual.pixel] = true;
        }
    }
    opened(&blind, width, height)
}

/// What stands in front of a target: residuals far off that hang together, and what hangs on to them.
fn hidden(view: &View, seen: &[Seen], limit: f64) -> Option<Vec<bool>> {
    let [width, height, ..] = view.window.size();
    let residuals = || seen.iter().flat_map(|seen| &seen.residuals).filter(|residual| !residual.saturated);
    let mut far = vec![false; view.window.pixels()];
    residuals().filter(|r| r.whitened.abs() > limit).for_each(|r| far[r.pixel] = true);
    let mut hidden = opened(&far, width, height)?;
    for _ in 0..EDGE_PX {
        let around = dilated(&hidden, width, height, 1);
        residuals().filter(|r| around[r.pixel] && r.whitened.abs() > DOUBTFUL).for_each(|r| hidden[r.pixel] = true);
    }
    Some(hidden)
}

/// Without lines one or two pixels wide, which are rims: 3 × 3 opening. `None` when hardly a pixel is left.
fn opened(truth: &[bool], width: usize, height: usize) -> Option<Vec<bool>> {
    let opened = dilated(&eroded(truth, width, height, 1), width, height, 1);
    (opened.iter().filter(|holds| **holds).count() >= PIXELS_MIN).then_some(opened)
}

/// For each pixel whether any of those within `radius` along both axes holds.
pub(super) fn dilated(truth: &[bool], width: usize, height: usize, radius: usize) -> Vec<bool> {
    spread(truth, [width, height], radius, false)
}

/// For each pixel whether any of those no farther away than `radius` holds.
fn widened(truth: &[bool], width: usize, height: usize, radius: usize) -> Vec<bool> {
    // How far the nearest is in the same column, then in all of them.
    let mut distance = vec![usize::MAX; truth.len()];
    for x in 0..width {
        let mut since = |rows: &mut dyn Iterator<Item = usize>| {
            let mut last = None;
            for y in rows {
                let here = y * width + x;
                last = if truth[here] { Some(y) } else { last };
                distance[here] = last.map_or(distance[here], |last| distance[here].min(last.abs_diff(y)));
            }
        };
        since(&mut (0..height));
        since(&mut (0..height).rev());
    }
    let is_near = |(here, row): (usize, &[usize])| {
        let near = here.saturating_sub(radius)..(here + radius + 1).min(width);
        near.into_iter().any(|x| row[x] <= radius && row[x].pow(2) + x.abs_diff(here).pow(2) <= radius.pow(2))
    };
    distance.chunks(width).flat_map(|row| (0..width).map(move |here| is_near((here, row)))).collect()
}

/// For each pixel whether all of those within `radius` along both axes hold; beyond the border nothing does.
fn eroded(truth: &[bool], width: usize, height: usize, radius: usize) -> Vec<bool> {
    let fails: Vec<bool> = truth.iter().map(|holds| !holds).collect();
    spread(&fails, [width, height], radius, true).into_iter().map(|fails| !fails).collect()
}

/// For each pixel whether any of those within `radius` along both axes holds; `beyond` the border all do, or none.
fn spread(truth: &[bool], [width, height]: [usize; 2], radius: usize, beyond: bool) -> Vec<bool> {
    let mut rows = truth.to_vec();
    for (spread, row) in rows.chunks_mut(width).zip(truth.chunks(width)) {
        along(spread, row, 1, radius.min(width), beyond);
    }
    let mut all = rows.clone();
    along(&mut all, &rows, width, radius.min(height), beyond);
    all
}

/// The same along one axis, whose neighbours are `step` apart.
fn along(spread: &mut [bool], truth: &[bool], step: usize, radius: usize, beyond: bool) {
    let or = |(spread, holds): (&mut bool, &bool)| *spread |= *holds;
    for off in (1..=radius).map(|by| by * step) {
        spread[off..].iter_mut().zip(truth).for_each(or);
        spread.iter_mut().zip(&truth[off..]).for_each(or);
    }
    if beyond {
        let border = radius * step;
        spread[..border].fill(true);
        let end = spread.len() - border;
        spread[end..].fill(true);
    }
}

/// A copy of what a view looks at, in f32, with NaN where it is blind. Pixels outside of the window are not copied.
pub(crate) struct Painted {
    planes: Vec<Vec<u8>>,
    size: [usize; 2],
}

const BYTES: usize = PixelFormat::F32.bytes_per_pixel();

impl Painted {
    pub fn new(view: &View, blind: &BlindMask) -> Painted {
        let [x0, y0, ..] = view.window.first();
        let [width, height, ..] = view.window.size();
        let size = [x0 + width, y0 + height];
        let copy = |plane: &PlaneView| {
            let mut bytes = vec![0; size[0] * size[1] * BYTES];
            for (pixel, blind) in blind.pixels.iter().enumerate() {
                let (x, y) = (x0 + pixel % width, y0 + pixel / width);
                let value = if *blind { f32::NAN } else { plane.pixel_at([x, y, 0, 0]) as f32 };
                let at = (y * size[0] + x) * BYTES;
                bytes[at..at + BYTES].copy_from_slice(&value.to_ne_bytes());
            }
            bytes
        };
        Painted { planes: view.planes.iter().map(copy).collect(), size }
    }

    /// The same window of the copy.
    pub fn view<'a>(&'a self, view: &View<'a>, precision: Precision) -> Option<View<'a>> {
        let [width, height] = self.size;
        let plane =
            |bytes: &'a Vec<u8>| PlaneView::new(PixelFormat::F32, bytes, width, height, width * BYTES, BYTES).ok();
        let planes = self.planes.iter().map(plane).collect::<Option<_>>()?;
        Some(view.with_planes(planes, precision))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opening_removes_lines_and_keeps_areas() {
        let (width, height) = (20, 12);
        let truth: Vec<bool> = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                y == 2 || ((5..10).contains(&x) && (5..9).contains(&y))
            })
            .collect();
        let opened = opened(&truth, width, height).expect("25 pixels");
        for (i, opened) in opened.iter().enumerate() {
            let (x, y) = (i % width, i / width);
            assert_eq!(*opened, (5..10).contains(&x) && (5..9).contains(&y), "{x}, {y}");
        }
        let wide = dilated(&opened, width, height, 2);
        assert_eq!(wide.iter().filter(|w| **w).count(), 9 * 8);
    }

    #[test]
    fn glare_reaches_equally_far_in_every_direction() {
        let (width, height, radius) = (31, 27, 9_usize);
        let sources = [[12_usize, 10_usize], [29, 25]];
        let mut truth = vec![false; width * height];
        sources.iter().for_each(|[x, y]| truth[y * width + x] = true);
        for (i, near) in widened(&truth, width, height, radius).into_iter().enumerate() {
            let distance = |[x, y]: [usize; 2]| x.abs_diff(i % width).pow(2) + y.abs_diff(i / width).pow(2);
            assert_eq!(near, sources.into_iter().any(|source| distance(source) <= radius.pow(2)), "{i}");
        }
    }
}
