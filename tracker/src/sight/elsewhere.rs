//! Other places of a frame, to measure how a linear function of pixels scatters without a target.

use isophote_jit::Window;

/// A budget: places that are sampled.
pub(crate) const WINDOWS_MAX: usize = 12;
/// A definition: fewer places do not determine a scatter.
pub(crate) const SAMPLES_MIN: usize = 5;

/// At most `most` windows of the size of `target` over all of `frame`, a quarter of the smaller side apart or more, whose offset
/// from `target` in px is far enough for `is_apart`.
pub(crate) fn elsewhere(
    frame: Window,
    target: Window,
    most: usize,
    is_apart: impl Fn([f64; 2]) -> bool,
) -> Vec<Window> {
    let step = (target.width.min(target.height) / 4).max(2);
    let along =
        |first: usize, length: usize, target: usize| (first..(first + length + 1).saturating_sub(target)).step_by(step);
    let windows: Vec<Window> = along(frame.y, frame.height, target.height)
        .flat_map(|y| along(frame.x, frame.width, target.width).map(move |x| Window { x, y, ..target }))
        .filter(|window| is_apart([window.x as f64 - target.x as f64, window.y as f64 - target.y as f64]))
        .collect();
    let every = windows.len().div_ceil(most).max(1);
    windows.into_iter().skip(every / 2).step_by(every).collect()
}
