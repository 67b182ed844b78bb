//! A large window by some of its rows: a long way to a large target is no longer than one to a small target.
//!
//! What comes in: a window. What goes out: rows of it, as windows without a common pixel. It never knows what is fitted to them.
//!
//! A fit that begins far off takes dozens of passes, and what decides where it ends is the shape of the picture, not its noise. So
//! the way is gone over evenly spaced rows first, and then over all pixels from where it has led to: nothing is estimated from
//! fewer pixels than there are.

use std::ops::RangeInclusive;

use isophote_jit::Window;

use crate::estimate::{Ending, StageReport, TracePoint};

/// So many pixels are enough to find the way, …
const PIXELS: usize = 4096;
/// … in so many rows.
const ROWS: usize = 32;
/// A target whose domain has fewer in the rows where the way begins, …
const PIXELS_FIRST: u64 = 1024;
/// … or fewer where it ends, may have lost most of its light between them.
const PIXELS_LEFT: u64 = 384;
/// A domain that has more than this share of the pixels does not say where the target is.
const BOUNDED: f64 = 0.95;
/// Steps over all pixels at most, where those over some of the rows have led nowhere.
const STEPS: u32 = 4;

/// Some of the rows of a window.
pub(super) struct Thinned {
    pub rows: Vec<Window>,
    /// As many pixels are in the window for each in the rows.
    step: f64,
}

impl Thinned {
    /// `None` where the window has no more rows than the way needs.
    pub fn of(window: Window) -> Option<Thinned> {
        let step = (window.pixels() / PIXELS).min(window.height / ROWS);
        let rows = (window.y..window.y + window.height).skip(step / 2).step_by(step.max(1));
        let rows: Vec<Window> = rows.map(|y| Window { y, height: 1, ..window }).collect();
        let step_in_fact = window.height as f64 / rows.len().max(1) as f64;
        (step > 1).then_some(Thinned { rows, step: step_in_fact })
    }

    /// Pixel values of the domain with which the way may begin: enough of them, and not those of a domain that does not say where the
    /// target is. `entries`: those that the model observes in each pixel.
    pub fn begins_with(&self, entries: usize) -> RangeInclusive<u64> {
        let all = (entries * self.rows.iter().map(|row| row.pixels()).sum::<usize>()) as f64;
        entries as u64 * PIXELS_FIRST..=(BOUNDED * all) as u64
    }

    /// How many steps may follow over all pixels, of `most`, where those over the rows have come to that; `None` where it has to begin
    /// anew.
    pub fn steps_left(&self, report: &StageReport, most: u32, entries: usize) -> Option<u32> {
        let steps = match report.ending {
            Ending::SmallStep | Ending::Budget => most,
            Ending::IterationLimit => most.min(STEPS),
            _ => return None,
        };
        (report.pixels_last >= entries as u64 * PIXELS_LEFT).then_some(steps)
    }

    /// The report of a stage over the rows in terms of all pixels: as many passes are one as have the pixels of one together.
    pub fn in_full(&self, report: StageReport) -> StageReport {
        let pixels = |count: u64| (count as f64 * self.step) as u64;
        let point = |point: &TracePoint| TracePoint { objective: point.objective * self.step, ..*point };
        StageReport {
            passes: (f64::from(report.passes) / self.step).ceil() as u32,
            pixels_first: pixels(report.pixels_first),
            pixels_least: pixels(report.pixels_least),
            pixels_last: pixels(report.pixels_last),
            trace: report.trace.iter().map(point).collect(),
            ..report
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(y: usize, width: usize, height: usize) -> Window {
        Window { y, ..Window::whole(width, height) }
    }

    #[test]
    fn some_rows_of_a_large_window_and_none_of_a_small_one() {
        let thinned = Thinned::of(window(10, 300, 400)).expect("it is large");
        let rows: Vec<usize> = thinned.rows.iter().map(|row| row.y).collect();
        assert!(thinned.rows.iter().all(|row| row.height == 1 && row.width == 300));
        assert!(rows.windows(2).all(|pair| pair[1] - pair[0] == 12), "{rows:?}"); // 400 rows / 32
        assert!(rows[0] - 10 == 6 && 410 - rows[rows.len() - 1] <= 12, "{rows:?}");
        for (width, height) in [(91, 91), (92, 92), (101, 99)] {
            assert!(Thinned::of(window(0, width, height)).is_some(), "{width} {height}");
        }
        for small in [window(0, 80, 80), window(0, 4000, 40), window(0, 100_000, 1)] {
            assert!(Thinned::of(small).is_none(), "{small:?}");
        }
    }

    #[test]
    fn a_way_that_misses_its_target_is_not_gone_on_from() {
        let thinned = Thinned::of(window(0, 300, 400)).expect("it is large");
        let begins = thinned.begins_with(1);
        assert!(begins.contains(&4000) && !begins.contains(&(PIXELS_FIRST - 1)));
        assert!(!begins.contains(&(33 * 300)), "a model without domain");
        let of = |ending, pixels_last| {
            let report = StageReport { ending, pixels_last, ..StageReport::default() };
            thinned.steps_left(&report, 50, 1)
        };
        assert_eq!(of(Ending::SmallStep, 3000), Some(50));
        assert_eq!(of(Ending::IterationLimit, 3000), Some(STEPS));
        assert_eq!(of(Ending::SmallStep, PIXELS_LEFT - 1), None);
        assert_eq!(of(Ending::DomainVanished, 3000), None);
    }

    #[test]
    fn passes_over_some_rows_count_by_their_pixels() {
        let thinned = Thinned::of(window(0, 300, 384)).expect("it is large");
        let point = TracePoint { objective: 10.0, radius: None, ratio: None };
        let (pixels_first, pixels_least, trace) = (2_000, 1_000, vec![point]);
        let told =
            StageReport { passes: 25, iterations: 24, pixels_first, pixels_least, trace, ..StageReport::default() };
        let told = thinned.in_full(told);
        assert_eq!((told.passes, told.iterations, told.pixels_first, told.pixels_least), (3, 24, 24_000, 12_000));
        assert_eq!(told.trace[0].objective, 120.0);
    }
}
