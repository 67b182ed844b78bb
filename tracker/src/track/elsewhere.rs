//! Places of a frame where a target is not.
//!
//! What comes in: the window of the target, and the whole of what may be looked at. What goes out: first pixels of windows of that
//! size, on a grid, that do not touch it. It never knows what is looked at there.

use isophote_jit::Window;

/// Of so many places along each side, in two dimensions.
pub(super) fn places(whole: Window, window: Window, along: usize) -> Vec<[usize; 2]> {
    let (first, size) = (whole.first(), window.size());
    let room = [0, 1].map(|axis| whole.size()[axis].saturating_sub(size[axis]));
    let place = |number: usize| {
        let steps = [number % along, number / along];
        [0, 1].map(|axis| first[axis] + steps[axis] * room[axis] / (along - 1))
    };
    let is_apart = |place: &[usize; 2]| (0..2).any(|axis| place[axis].abs_diff(window.first()[axis]) >= size[axis]);
    let mut places: Vec<[usize; 2]> = (0..along * along).map(place).filter(is_apart).collect();
    // Where there is no room all steps are one.
    places.sort_unstable();
    places.dedup();
    places
}
