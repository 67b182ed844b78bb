//! Large windows by some of their rows: a long way to a large target is no longer than one to a small target.
//!
//! What comes in: windows. What goes out: rows of them, as windows without a common pixel. It never knows what is fitted to them.
//!
//! A fit that begins far off takes dozens of passes, and what decides where it ends is the shape of the picture, not its noise. So
//! the way is gone over evenly spaced rows first, and then over all pixels from where it has led to: nothing is estimated from
//! fewer pixels than there are.

use isophote_jit::Window;

use crate::estimate::{Ending, StageReport, TracePoint};

/// So many pixels are enough to find the way, …
const PIXELS: usize = 4096;
/// … in so many rows.
const ROWS: usize = 32;
/// A way that ends with fewer has lost most of its target between the rows.
const PIXELS_LEFT: u64 = 384;
/// Steps over all pixels at most, where those over some of the rows have led nowhere.
const STEPS: u32 = 2;

/// Some of the rows of each window; `None` where that would be no less.
pub(super) fn thinned(windows: &[Window]) -> Option<Vec<Window>> {
    let of = |window: &Window| {
        let step = (window.pixels() / PIXELS).min(window.height / ROWS).max(1);
        let first = window.y + (step - 1) / 2;
        let height = if step == 1 { window.height } else { 1 };
        let rows = (first..window.y + window.height).step_by(if step == 1 { window.height } else { step });
        let window = *window;
        rows.map(move |y| Window { y, height, ..window })
    };
    let thinned: Vec<Window> = windows.iter().flat_map(of).collect();
    let pixels = |windows: &[Window]| windows.iter().map(|window| window.pixels()).sum::<usize>();
    (2 * pixels(&thinned) <= pixels(windows)).then_some(thinned)
}

/// How many steps may follow over all pixels, of `most`, where those over some of the rows have come to that; `None` where it has
/// to begin anew.
pub(super) fn steps_left(report: &StageReport, most: u32) -> Option<u32> {
    let steps = match report.ending {
        Ending::SmallStep | Ending::Budget => most,
        Ending::IterationLimit => most.min(STEPS),
        _ => return None,
    };
    (report.pixels_last >= PIXELS_LEFT).then_some(steps)
}

/// The report of a stage over all pixels that went on from one over some of the rows: as many passes of that are one as have its
/// pixels together, and F of its points is in proportion.
pub(super) fn after(whole: StageReport, thinned: &StageReport) -> StageReport {
    let (some, all) = (thinned.pixels_first.max(1), whole.pixels_first.max(thinned.pixels_first).max(1));
    let passes = (u64::from(thinned.passes) * some).div_ceil(all);
    let scaled = |point: &TracePoint| TracePoint { objective: point.objective * all as f64 / some as f64, ..*point };
    let trace = thinned.trace.iter().map(scaled).collect();
    let (passes, pixels_first, pixels_least) = (passes as u32, all, all);
    whole.after(&StageReport { passes, pixels_first, pixels_least, trace, ..thinned.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(y: usize, width: usize, height: usize) -> Window {
        Window { y, ..Window::whole(width, height) }
    }

    #[test]
    fn some_rows_of_a_large_window_and_all_of_a_small_one() {
        let rows = thinned(&[window(10, 300, 400)]).expect("it is large");
        let steps: Vec<usize> = rows.windows(2).map(|pair| pair[1].y - pair[0].y).collect();
        assert!(rows.iter().all(|row| row.height == 1 && row.width == 300), "{rows:?}");
        assert!(steps.iter().all(|step| *step == 12), "{steps:?}"); // 400 rows / 32
        let (above, below) = (rows[0].y - 10, 410 - 1 - rows[rows.len() - 1].y);
        assert!(above < 12 && below < 12, "{above} {below}");
        for small in [window(0, 80, 80), window(0, 4000, 40), window(0, 100_000, 1)] {
            assert_eq!(thinned(&[small]), None);
        }
        // Beside a large one a small one stays whole.
        let both = thinned(&[window(0, 300, 400), window(500, 20, 20)]).expect("one is large");
        assert_eq!(both.last(), Some(&window(500, 20, 20)));
    }

    #[test]
    fn a_way_that_led_nowhere_is_not_gone_again_over_all_pixels() {
        let report = |ending, pixels_last| StageReport { ending, pixels_last, ..StageReport::default() };
        assert_eq!(steps_left(&report(Ending::SmallStep, 4000), 50), Some(50));
        assert_eq!(steps_left(&report(Ending::IterationLimit, 4000), 50), Some(STEPS));
        assert_eq!(steps_left(&report(Ending::SmallStep, PIXELS_LEFT - 1), 50), None);
        assert_eq!(steps_left(&report(Ending::DomainVanished, 4000), 50), None);
    }

    #[test]
    fn passes_over_some_rows_count_by_their_pixels() {
        let of = |passes, iterations, pixels| {
            let (pixels_first, pixels_least) = (pixels, pixels);
            StageReport { passes, iterations, pixels_first, pixels_least, ..StageReport::default() }
        };
        let told = after(of(3, 2, 10_000), &of(25, 24, 1_000));
        assert_eq!((told.passes, told.iterations, told.pixels_first), (3 + 3, 26, 10_000));
        // Where nothing was summed over all pixels.
        let told = after(of(0, 0, 0), &of(25, 24, 1_000));
        assert_eq!((told.passes, told.pixels_first), (25, 1_000));
    }
}
