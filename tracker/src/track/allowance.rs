//! Work budgets of a search's fits, in units: pixels of passes of a usual document.

use super::solver::{FrameContext, Solver};
use crate::budget::WORK_MAX;
use crate::sight::cold::CandidateStarts;

/// Passes over the whole picture for all later fits of one kind (objects that stand out, or matches of the document's own image).
/// The likeliest objects come first; those beyond this limit are not fitted.
const PASSES: u64 = 4;
/// Least such work for each wanted target, pixels of passes: a target fills most of a small picture.
const WORK_MIN: u64 = 2_000_000;
/// First fits: always made, with budgets of their own.
pub(super) const CANDIDATES_MIN: usize = 2;
/// Work of each first fit, in passes over the picture: of a usual document, or of the document itself, whichever is more.
const PASSES_FIRST: [u64; 2] = [256, 24];
/// Least work of each first fit, pixels of passes.
const WORK_FIRST: u64 = 1 << 27;
/// Each later fit may use the remaining work divided by this, so that a large object that fits badly is not the last.
pub(super) const SHARE: u64 = 2;

/// Work of all later fits of one kind.
pub(super) fn later_work(solver: &Solver, context: &FrameContext) -> u64 {
    (PASSES * context.window.pixels() as u64).max(WORK_MIN * solver.options.targets as u64)
}

/// Work of each first fit; unlimited for starts without an energy, such as given numbers, which are not searched for.
pub(super) fn first_work(solver: &Solver, context: &FrameContext, starts: &CandidateStarts) -> u64 {
    let [usual, own] = PASSES_FIRST;
    let first = usual.max(own * solver.compiled.weight() as u64) * context.window.pixels() as u64;
    starts.energy.map_or(WORK_MAX, |_| first.max(WORK_FIRST))
}
