//! Row subsampling of a large window, so that the way to a large target takes no longer than to a small one.
//!
//! A fit that starts far off takes dozens of passes, and the shape of the picture, not its noise, decides where it ends. So
//! the fit first runs over evenly spaced rows, then over all pixels from where that ended: no estimate uses fewer pixels
//! than there are.

use std::ops::RangeInclusive;

use isophote_jit::Window;

use crate::estimate::{Ending, StageReport, TracePoint};

/// Pixels that suffice to find the way.
const PIXELS: usize = 4096;
/// Rows that suffice to find the way.
const ROWS: usize = 32;
/// A target whose domain has fewer pixels in the rows at the start may have lost most of its light between them.
const PIXELS_FIRST: u64 = 1024;
/// The same where the way ends.
const PIXELS_LEFT: u64 = 384;
/// A domain with more than this share of the pixels does not locate the target.
const BOUNDED: f64 = 0.95;
/// Most steps over all pixels after the steps over rows have reached the iteration limit.
const STEPS: u32 = 4;

/// Evenly spaced rows of a window.
pub(super) struct Subsampled {
    pub rows: Vec<Window>,
    /// Pixels of the window per pixel of the rows.
    step: f64,
}

impl Subsampled {
    /// `None` where the window is too small to subsample.
    pub fn of(window: Window) -> Option<Subsampled> {
        let step = (window.pixels() / PIXELS).min(window.height / ROWS);
        let rows = (window.y..window.y + window.height).skip(step / 2).step_by(step.max(1));
        let rows: Vec<Window> = rows.map(|y| Window { y, height: 1, ..window }).collect();
        let step_in_fact = window.height as f64 / rows.len().max(1) as f64;
        (step > 1).then_some(Subsampled { rows, step: step_in_fact })
    }

    /// Range of pixel values in the domain at which the way may begin: enough of them, and not so many that the domain does
    /// not locate the target. `entries`: values that the model observes per pixel.
    pub fn begins_with(&self, entries: usize) -> RangeInclusive<u64> {
        let all = (entries * self.rows.iter().map(|row| row.pixels()).sum::<usize>()) as f64;
        entries as u64 * PIXELS_FIRST..=(BOUNDED * all) as u64
    }

    /// Steps left over all pixels, of `most`, after this report of the rows; `None` where the fit has to start anew.
    pub fn steps_left(&self, report: &StageReport, most: u32, entries: usize) -> Option<u32> {
        let steps = match report.ending {
            Ending::SmallStep | Ending::Budget => most,
            Ending::IterationLimit => most.min(STEPS),
            _ => return None,
        };
        (report.pixels_last >= entries as u64 * PIXELS_LEFT).then_some(steps)
    }

    /// Rescales a stage's report over the rows to all pixels: passes count by their pixels.
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
    fn only_large_windows_are_thinned() {
        let subsampled = Subsampled::of(window(10, 300, 400)).expect("it is large");
        let rows: Vec<usize> = subsampled.rows.iter().map(|row| row.y).collect();
        assert!(subsampled.rows.iter().all(|row| row.height == 1 && row.width == 300));
        assert!(rows.windows(2).all(|pair| pair[1] - pair[0] == 12), "{rows:?}"); // 400 rows / 32
        assert!(rows[0] - 10 == 6 && 410 - rows[rows.len() - 1] <= 12, "{rows:?}");
        for (width, height) in [(91, 91), (92, 92), (101, 99)] {
            assert!(Subsampled::of(window(0, width, height)).is_some(), "{width} {height}");
        }
        for small in [window(0, 80, 80), window(0, 4000, 40), window(0, 100_000, 1)] {
            assert!(Subsampled::of(small).is_none(), "{small:?}");
        }
    }

    #[test]
    fn a_thinned_fit_that_misses_the_target_is_discarded() {
        let subsampled = Subsampled::of(window(0, 300, 400)).expect("it is large");
        let begins = subsampled.begins_with(1);
        assert!(begins.contains(&4000) && !begins.contains(&(PIXELS_FIRST - 1)));
        assert!(!begins.contains(&(33 * 300)), "a model without domain");
        let of = |ending, pixels_last| {
            let report = StageReport { ending, pixels_last, ..StageReport::default() };
            subsampled.steps_left(&report, 50, 1)
        };
        assert_eq!(of(Ending::SmallStep, 3000), Some(50));
        assert_eq!(of(Ending::IterationLimit, 3000), Some(STEPS));
        assert_eq!(of(Ending::SmallStep, PIXELS_LEFT - 1), None);
        assert_eq!(of(Ending::DomainVanished, 3000), None);
    }

    #[test]
    fn thinned_passes_count_by_their_pixels() {
        let subsampled = Subsampled::of(window(0, 300, 384)).expect("it is large");
        let point = TracePoint { objective: 10.0, radius: None, ratio: None };
        let (pixels_first, pixels_least, trace) = (2_000, 1_000, vec![point]);
        let report =
            StageReport { passes: 25, iterations: 24, pixels_first, pixels_least, trace, ..StageReport::default() };
        let report = subsampled.in_full(report);
        assert_eq!(
            (report.passes, report.iterations, report.pixels_first, report.pixels_least),
            (3, 24, 24_000, 12_000)
        );
        assert_eq!(report.trace[0].objective, 120.0);
    }
}
