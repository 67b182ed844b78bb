//! `Gaps`: a camera's defective pixels as disjoint rectangles, and frames with interpolated values there.
//!
//! Everything that analyses whole images uses the interpolated frame; a fit subtracts the sums over the rectangles inside
//! its window.

use std::collections::VecDeque;

use isophote_frame::{Frame, Mend};
use isophote_jit::{Slices, Window};

use crate::camera::DefectMap;

/// Largest distance of pixels that replace a gap, px; deeper inside wide gaps those at the rim are used.
const FAR_PX: i64 = 8;

/// A horizontal run of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Run {
    y: usize,
    x: usize,
    width: usize,
}

/// A prepared map of defects.
pub(crate) struct Gaps {
    /// Whole columns, by their x.
    columns: Vec<usize>,
    height: usize,
    /// All other gaps as runs, sorted.
    runs: Vec<Run>,
    mends: Vec<Mend>,
}

impl Gaps {
    /// `None` for an empty map. The map has been checked.
    pub fn of(map: &DefectMap) -> Option<Gaps> {
        let size = [map.width as usize, map.height as usize];
        let columns = sorted(map.columns.iter().map(|x| *x as usize));
        let rows = sorted(map.rows.iter().map(|y| *y as usize));
        let single = sorted(map.pixels.iter().map(|[x, y]| [*y as usize, *x as usize]));
        let is_line = |[y, x]: [usize; 2]| columns.binary_search(&x).is_ok() || rows.binary_search(&y).is_ok();
        let is_gap = |place: [usize; 2]| is_line(place) || single.binary_search(&place).is_ok();
        let of_rows = rows.iter().flat_map(|y| (0..size[0]).map(move |x| [*y, x]));
        let of_rows = of_rows.filter(|[_, x]| columns.binary_search(x).is_err());
        let mut apart: Vec<[usize; 2]> = single.iter().copied().filter(|place| !is_line(*place)).collect();
        apart.extend(of_rows);
        apart.sort_unstable();
        let of_columns = columns.iter().flat_map(|x| (0..size[1]).map(move |y| [y, *x]));
        let all = apart.iter().copied().chain(of_columns);
        let mut mends: Vec<Mend> =
            all.map(|[y, x]| Mend { at: [x, y], from: nearest([x, y], size, &is_gap) }).collect();
        fill_inwards(&mut mends, size);
        let runs = runs(&apart);
        (!mends.is_empty()).then_some(Gaps { columns, height: size[1], runs, mends })
    }

    /// A copy of the frame with each gap replaced by the mean of its neighbours.
    pub fn mended(&self, frame: &Frame) -> Frame {
        frame.mended(&self.mends)
    }

    /// The gaps inside a window.
    pub fn inside(&self, window: Window) -> Vec<Window> {
        let line = |x: usize, y: usize, width: usize, height: usize| {
            overlap(Window { x, y, width, height, slices: window.slices }, window)
        };
        let first = self.runs.partition_point(|run| run.y < window.y);
        let last = self.runs.partition_point(|run| run.y < window.y + window.height);
        let runs = self.runs[first..last].iter().filter_map(|run| line(run.x, run.y, run.width, 1));
        let columns = self.columns.iter().filter_map(|x| line(*x, 0, 1, self.height));
        columns.chain(runs).collect()
    }
}

/// Sets these parts of a window to one value, in all slices.
pub(crate) fn fill_parts<T: Copy>(pixels: &mut [T], window: Window, parts: &[Window], value: T) {
    for slice in pixels.chunks_mut(window.width * window.height) {
        for part in parts {
            for row in slice.chunks_mut(window.width).skip(part.y - window.y).take(part.height) {
                row[part.x - window.x..][..part.width].fill(value);
            }
        }
    }
}

/// The intersection of two windows.
pub(crate) fn overlap(a: Window, b: Window) -> Option<Window> {
    let common = |first: [usize; 2], count: [usize; 2]| {
        let first_edge = first[0].max(first[1]);
        let end = first[0].saturating_add(count[0]).min(first[1].saturating_add(count[1]));
        (first_edge < end).then(|| (first_edge, end - first_edge))
    };
    let (x, width) = common([a.x, b.x], [a.width, b.width])?;
    let (y, height) = common([a.y, b.y], [a.height, b.height])?;
    let along = |axis: usize| {
        common([a, b].map(|window| window.slices.first[axis]), [a, b].map(|window| window.slices.count[axis]))
    };
    let (z, depth) = along(0)?;
    let (w, length) = along(1)?;
    Some(Window { x, y, width, height, slices: Slices { first: [z, w], count: [depth, length] } })
}

fn sorted<T: Ord>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut all: Vec<T> = all.collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Sorted positions (y, x) as runs.
fn runs(places: &[[usize; 2]]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for &[y, x] in places {
        match runs.last_mut() {
            Some(run) if run.y == y && run.x + run.width == x => run.width += 1,
            _ => runs.push(Run { y, x, width: 1 }),
        }
    }
    runs
}

/// The nearest sound pixels, all at one Chebyshev distance; empty beyond [`FAR_PX`].
fn nearest([x, y]: [usize; 2], [width, height]: [usize; 2], is_gap: &dyn Fn([usize; 2]) -> bool) -> Vec<[usize; 2]> {
    let inside = |dx: i64, dy: i64| {
        let (x, y) = (x as i64 + dx, y as i64 + dy);
        let is_inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
        is_inside.then_some([x as usize, y as usize]).filter(|[x, y]| !is_gap([*y, *x]))
    };
    for far in 1..=FAR_PX {
        let beside: Vec<[usize; 2]> =
            [(far, 0), (-far, 0), (0, far), (0, -far)].into_iter().filter_map(|(dx, dy)| inside(dx, dy)).collect();
        if !beside.is_empty() {
            return beside;
        }
        let corners = [(far, far), (-far, far), (far, -far), (-far, -far)];
        let corners: Vec<[usize; 2]> = corners.into_iter().filter_map(|(dx, dy)| inside(dx, dy)).collect();
        if !corners.is_empty() {
            return corners;
        }
    }
    Vec::new()
}

/// Gives each gap without sound pixels nearby those of the nearest gap that has some, along a path through gaps.
///
/// Values in gaps are summed and subtracted again: a raw value far from all others would lose digits.
fn fill_inwards(mends: &mut [Mend], [width, height]: [usize; 2]) {
    if mends.iter().all(|mend| !mend.from.is_empty()) {
        return;
    }
    let mut number_at = vec![None; width * height];
    mends.iter().enumerate().for_each(|(number, mend)| number_at[mend.at[1] * width + mend.at[0]] = Some(number));
    let mut reached: VecDeque<usize> = (0..mends.len()).filter(|number| !mends[*number].from.is_empty()).collect();
    while let Some(number) = reached.pop_front() {
        let [x, y] = mends[number].at;
        let beside = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
        for (x, y) in beside.into_iter().filter(|(x, y)| *x < width && *y < height) {
            if let Some(next) = number_at[y * width + x].filter(|next| mends[*next].from.is_empty()) {
                mends[next].from = mends[number].from.clone();
                reached.push_back(next);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn map() -> DefectMap {
        let pixels = vec![[5, 4], [6, 4], [3, 1], [3, 7], [11, 2], [5, 4], [0, 0]];
        DefectMap { width: 12, height: 9, pixels, columns: vec![3], rows: vec![7, 7] }
    }

    #[test]
    fn rectangles_cover_each_gap_once() {
        let gaps = Gaps::of(&map()).unwrap();
        let is_gap =
            |x: usize, y: usize| x == 3 || y == 7 || [[5, 4], [6, 4], [11, 2], [0, 0]].contains(&[x as u32, y as u32]);
        for window in [Window::whole(12, 9), Window { x: 2, y: 1, width: 4, height: 7, ..Window::whole(1, 1) }] {
            let mut covered = [[0; 12]; 9];
            for gap in gaps.inside(window) {
                for (x, y) in (gap.x..gap.x + gap.width).flat_map(|x| (gap.y..gap.y + gap.height).map(move |y| (x, y)))
                {
                    covered[y][x] += 1;
                }
            }
            for (y, row) in covered.iter().enumerate() {
                for (x, count) in row.iter().enumerate() {
                    let inside = overlap(Window { x, y, ..Window::whole(1, 1) }, window).is_some();
                    assert_eq!(*count, u32::from(inside && is_gap(x, y)), "{window:?}: {x}, {y}");
                }
            }
        }
        assert_eq!(gaps.inside(Window { x: 7, y: 3, width: 4, height: 3, ..Window::whole(1, 1) }), []);
        assert!(Gaps::of(&DefectMap { width: 12, height: 9, ..DefectMap::default() }).is_none());
    }

    #[test]
    fn gaps_are_filled_from_the_nearest_sound_pixels() {
        let gaps = Gaps::of(&map()).unwrap();
        let from = |x: usize, y: usize| {
            let mend = gaps.mends.iter().find(|mend| mend.at == [x, y]).unwrap();
            sorted(mend.from.iter().copied())
        };
        assert_eq!(from(5, 4), [[4, 4], [5, 3], [5, 5]]);
        assert_eq!(from(3, 4), [[2, 4], [4, 4]]);
        assert_eq!(from(0, 0), [[0, 1], [1, 0]]);
        assert_eq!(from(3, 7), [[2, 6], [2, 8], [4, 6], [4, 8]]);
    }

    #[test]
    fn wide_gaps_are_filled_from_their_rim() {
        let columns = (0..40).collect();
        let wide = Gaps::of(&DefectMap { width: 60, height: 3, columns, ..DefectMap::default() }).unwrap();
        let rim = |mend: &Mend| mend.from.iter().all(|[x, _]| *x == 40) && !mend.from.is_empty();
        assert!(wide.mends.iter().all(rim), "{:?}", wide.mends);
        // No pixel is sound.
        let columns = (0..60).collect();
        let all = Gaps::of(&DefectMap { width: 60, height: 3, columns, ..DefectMap::default() }).unwrap();
        assert!(all.mends.len() == 180 && all.mends.iter().all(|mend| mend.from.is_empty()));
    }

    #[test]
    fn windows_intersect_in_all_dimensions() {
        let slices = |z: usize, depth: usize, w: usize, length: usize| Window {
            slices: Slices { first: [z, w], count: [depth, length] },
            ..Window::whole(12, 9)
        };
        assert_eq!(overlap(slices(0, 20, 0, 3), slices(5, 4, 1, 7)), Some(slices(5, 4, 1, 2)));
        assert_eq!(overlap(slices(0, 5, 0, 1), slices(5, 4, 0, 1)), None);
        let all = Window { slices: Slices::ALL, ..Window::whole(12, 9) };
        assert_eq!(overlap(all, slices(5, 4, 1, 7)), Some(slices(5, 4, 1, 7)));
        // A part of a stack has no more gap pixels than its own.
        let gaps = Gaps::of(&map()).unwrap();
        let narrow = slices(5, 4, 0, 1);
        let parts = gaps.inside(slices(0, 20, 0, 1)).into_iter().filter_map(|gap| overlap(gap, narrow));
        let left_out: usize = parts.map(|gap| gap.pixels()).sum();
        assert_eq!(left_out, gaps.inside(narrow).iter().map(|gap| gap.pixels()).sum::<usize>());
        assert_eq!(left_out, 4 * gaps.mends.len());
    }
}
