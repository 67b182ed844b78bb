//! Contours on a lattice of pixels by marching squares.
//!
//! Polylines close where the edge does, and are open where it leaves the window.

use std::collections::HashMap;

/// Largest number of edge crossings of one image; a more ragged one gets no contour.
const CROSSINGS_MAX: usize = 32_768;
/// Largest number of points of one image.
const POINTS_MAX: usize = 192;
/// Largest number of points of a single line.
const LINE_POINTS_MAX: usize = 96;
/// Lines with fewer crossings are single pixels; they are dropped when there are others.
const SPECK: usize = 5;

/// x, y of a pixel of the lattice.
pub(super) type Pixel = [usize; 2];
/// Points x, y, px of the lattice.
pub(super) type Polyline = Vec<[f64; 2]>;

/// A crossing between two neighbours: the left or upper one, and whether the other is below it.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Debug)]
struct Crossing {
    y: usize,
    x: usize,
    is_down: bool,
}

impl Crossing {
    fn ends(self) -> (Pixel, Pixel) {
        let Crossing { x, y, is_down } = self;
        ([x, y], if is_down { [x, y + 1] } else { [x + 1, y] })
    }
}

/// Traces the edge of `inside` (`width` pixels a row). `between` locates the edge between an inner and an outer pixel.
pub(super) fn trace(inside: &[bool], width: usize, between: &dyn Fn(Pixel, Pixel) -> [f64; 2]) -> Vec<Polyline> {
    let Some(segments) = segments(inside, width) else { return Vec::new() };
    let mut lines = joined(&segments);
    let longest = lines.iter().map(Vec::len).max().unwrap_or(0);
    lines.retain(|line| line.len() >= SPECK.min(longest));
    let most = LINE_POINTS_MAX.min(POINTS_MAX / lines.len().max(1)).max(8);
    lines.truncate(POINTS_MAX / 8);
    let at = |crossing: &Crossing| {
        let (one, other) = crossing.ends();
        match inside[one[1] * width + one[0]] {
            true => between(one, other),
            false => between(other, one),
        }
    };
    let drawn = |line: Vec<Crossing>| {
        let is_closed = line.len() > 2 && line.first() == line.last();
        let count = line.len() - usize::from(is_closed);
        let step = count.div_ceil(most).max(1);
        let mut points: Polyline = line[..count].iter().step_by(step).map(at).collect();
        if is_closed {
            points.extend(points.first().copied());
        } else if let (Some(last), true) = (line.last(), !(count - 1).is_multiple_of(step)) {
            points.push(at(last));
        }
        points
    };
    lines.into_iter().map(drawn).collect()
}

/// Edge segments, one or two per cell of four pixels; `None` when there are too many.
fn segments(inside: &[bool], width: usize) -> Option<Vec<(Crossing, Crossing)>> {
    let mut found = Vec::new();
    for (y, (upper, lower)) in inside.chunks_exact(width).zip(inside.chunks_exact(width).skip(1)).enumerate() {
        for x in 0..width.saturating_sub(1) {
            let corners = [upper[x], upper[x + 1], lower[x + 1], lower[x]];
            if corners == [corners[0]; 4] {
                continue;
            }
            let top = Crossing { y, x, is_down: false };
            let right = Crossing { y, x: x + 1, is_down: true };
            let bottom = Crossing { y: y + 1, x, is_down: false };
            let left = Crossing { y, x, is_down: true };
            let sides = [(top, 0, 1), (right, 1, 2), (bottom, 2, 3), (left, 3, 0)];
            let crossed: Vec<Crossing> =
                sides.into_iter().filter(|(_, a, b)| corners[*a] != corners[*b]).map(|(side, _, _)| side).collect();
            match crossed[..] {
                [a, b] => found.push((a, b)),
                // A saddle: inner corners stay separate.
                [..] if corners[0] => found.extend([(top, left), (right, bottom)]),
                [..] => found.extend([(top, right), (bottom, left)]),
            }
        }
        if found.len() > CROSSINGS_MAX {
            return None;
        }
    }
    Some(found)
}

/// Joins segments to lines; a closed line ends where it begins.
fn joined(segments: &[(Crossing, Crossing)]) -> Vec<Vec<Crossing>> {
    let mut next: HashMap<Crossing, [Option<Crossing>; 2]> = HashMap::with_capacity(segments.len());
    for (a, b) in segments {
        for (from, to) in [(a, b), (b, a)] {
            let ends = next.entry(*from).or_default();
            let free = usize::from(ends[0].is_some());
            ends[free] = Some(*to);
        }
    }
    let mut lines = Vec::new();
    // Open lines first, from one of their ends, then the closed ones; both in order of position.
    let mut starts: Vec<(bool, Crossing)> = next.iter().map(|(at, ends)| (ends[1].is_some(), *at)).collect();
    starts.sort_unstable();
    for (is_closed, start) in starts {
        let mut line = vec![start];
        let mut at = start;
        while let Some(ends) = next.remove(&at) {
            let ahead = ends.into_iter().flatten().find(|to| next.contains_key(to));
            at = match ahead {
                Some(to) => to,
                None => break,
            };
            line.push(at);
        }
        if line.len() > 1 {
            line.extend(is_closed.then_some(start));
            lines.push(line);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn middle(a: Pixel, b: Pixel) -> [f64; 2] {
        [(a[0] + b[0]) as f64 / 2.0, (a[1] + b[1]) as f64 / 2.0]
    }

    fn lattice(width: usize, height: usize, holds: impl Fn(f64, f64) -> bool) -> Vec<bool> {
        (0..width * height).map(|i| holds((i % width) as f64, (i / width) as f64)).collect()
    }

    #[test]
    fn disc_has_one_closed_edge_and_ring_two() {
        let r = |x: f64, y: f64| (x - 20.2).hypot(y - 15.3);
        let disc = trace(&lattice(40, 30, |x, y| r(x, y) < 9.5), 40, &middle);
        assert_eq!(disc.len(), 1);
        assert_eq!(disc[0].first(), disc[0].last());
        assert!(disc[0].len() > 40 && disc[0].iter().all(|[x, y]| (r(*x, *y) - 9.5).abs() < 0.75));
        let ring = trace(&lattice(40, 30, |x, y| (5.0..9.5).contains(&r(x, y))), 40, &middle);
        assert_eq!(ring.len(), 2);
    }

    #[test]
    fn edge_that_leaves_the_window_is_open() {
        let half = trace(&lattice(20, 30, |x, _| x < 7.0), 20, &middle);
        assert_eq!(half.len(), 1);
        assert_eq!((half[0].first(), half[0].last()), (Some(&[6.5, 0.0]), Some(&[6.5, 29.0])));
        assert!(trace(&lattice(20, 30, |_, _| true), 20, &middle).is_empty());
        assert!(trace(&lattice(20, 1, |x, _| x < 7.0), 20, &middle).is_empty(), "a row has no outline");
    }

    #[test]
    fn touching_corners_stay_separate() {
        let two = lattice(12, 12, |x, y| (x < 6.0) == (y < 6.0) && x > 1.0 && y > 1.0 && x < 10.0 && y < 10.0);
        assert_eq!(trace(&two, 12, &middle).len(), 2);
    }

    #[test]
    fn ragged_images_have_no_contour() {
        let board = lattice(400, 400, |x, y| (x + y) % 2.0 == 0.0);
        assert!(trace(&board, 400, &middle).is_empty());
        let rows = trace(&lattice(300, 300, |_, y| y % 2.0 == 0.0), 300, &middle);
        assert!(rows.iter().map(Vec::len).sum::<usize>() <= 2 * POINTS_MAX, "{}", rows.len());
    }
}
