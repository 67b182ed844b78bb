//! How much the fits of a search may cost.
//!
//! What comes in: a picture, and what is to be fitted. What goes out: units of work, pixels of passes of a usual document. It never
//! knows what a fit came to.

use super::solver::{Look, Solver};
use crate::budget::WORK_MAX;
use crate::sight::cold::Starts;

/// Fits of things that stand out, and of what the document's image finds, may use every pixel of the picture so many times each;
/// the likeliest things come first. What is left is not looked at. …
const PASSES: u64 = 4;
/// … and so many pixels of passes at least: in a small picture a target is most of it.
const WORK_MIN: u64 = 2_000_000;
/// So many things are fitted in any case, and take nothing from the others: each may take as long as so many passes of a usual
/// document over the picture, or fewer of its own, …
pub(super) const SIGHTS_MIN: usize = 2;
const PASSES_FIRST: [u64; 2] = [256, 24];
/// … and so many pixels of passes at least.
const WORK_FIRST: u64 = 1 << 27;
/// Each of the others may use one part of what is left, of so many: one that is large and fits badly must not be the last.
pub(super) const SHARE: u64 = 2;

/// For all fits of one kind of things but the first ones.
pub(super) fn of_all(look: &Look) -> u64 {
    (PASSES * look.window.pixels() as u64).max(WORK_MIN)
}

/// For each of the first ones. What is said in numbers is not searched for, and has the whole frame.
pub(super) fn of_first(solver: &Solver, look: &Look, starts: &Starts) -> u64 {
    let [usual, own] = PASSES_FIRST;
    let first = usual.max(own * solver.compiled.weight() as u64) * look.window.pixels() as u64;
    starts.energy.map_or(WORK_MAX, |_| first.max(WORK_FIRST))
}
