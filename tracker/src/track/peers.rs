//! What else stands out in a frame, and looks otherwise: a scene of such things is one in which some look nearly like the target.
//!
//! What comes in: all fits of a search, and what it saw. What goes out: fits whose oddity has grown. It never knows a track.
//!
//! A rough model is better than none, so a lone thing may differ from the document by some percent of its height. Among things of
//! its brightness and size that are no targets one that is nearly like it is one of them: its [deviation](super::deviation) must not
//! be more than what a document is off by that describes its target, nor must what it leaves of the light. Things that are like the
//! target themselves speak for a rough model, and halos are too faint to count.

use super::around::Around;
use super::candidate::{Candidate, WHOLE, is_about};
use super::deviation;
use super::solver::{Look, Solver};
use super::window::share_inside;
use crate::sight::cold::Starts;

/// A peer has this share of the energy at least, …
const SHARE: f64 = 0.05;
/// … and what may be the target in this one's place that share: a speck beside a lamp is not.
const COMPARABLE: f64 = 0.01;
/// A deviation that is forgiven, …
const FORGIVEN: f64 = 0.0015;
/// … more of it by this over half the width squared, px², …
const COARSE: f64 = 0.08;
/// … what one of all of the height takes of the log odds, …
const WEIGHT: f64 = 2500.0;
/// … the share of the light's variance that may be left, of models that say nothing of noise and of others, …
const UNEXPLAINED: [f64; 2] = [0.014, 0.008];
/// … what all of it takes, …
const LEFT: f64 = 250.0;
/// … and how much they take at most.
const MOST: f64 = 15.0;

/// Something that stands out by itself.
#[derive(Clone, Debug)]
pub(super) struct Outstanding {
    /// Where a fit of it begins.
    pub start: Vec<f64>,
    /// The square of its height over its area.
    pub energy: f64,
}

impl Outstanding {
    /// What a fit may begin with. A thing that the border of a given window cuts off belongs to what the window leaves out.
    pub fn of(solver: &Solver, look: &Look, starts: &Starts) -> Option<Outstanding> {
        let (start, energy) = (starts.starts.first()?.clone(), starts.energy?);
        let is_left_out = solver.options.window.is_some() && share_inside(solver.model(), &start, look.window) < WHOLE;
        (!is_left_out).then_some(Outstanding { start, energy })
    }
}

/// Holds against each candidate by how much it differs from the document, where other things do by more.
pub(super) fn weigh(solver: &Solver, look: &Look, candidates: &mut [Candidate], things: &[Outstanding]) {
    let most = UNEXPLAINED[usize::from(solver.model().has_noise())];
    let against: Vec<f64> = candidates
        .iter()
        .map(|candidate| {
            let fit = candidate.attempt.fit.as_ref().filter(|fit| fit.choice.is_none() && candidate.is_likely());
            let fit = fit.filter(|_| candidate.evidence.is_some() && has_peer(solver, candidate, candidates, things));
            let Some(fit) = fit else { return 0.0 };
            let deviation = Around::of(solver, look, fit).and_then(|around| deviation::of(&around)).unwrap_or(0.0);
            // The fits of a search sample small things too coarsely for more.
            let coarse = solver.looks(&fit.parameters).0.map_or(0.0, |area| COARSE * (-area).exp());
            let left = candidate.ground.map_or(0.0, |ground| ground.unexplained(solver, fit));
            let against = WEIGHT * (deviation - FORGIVEN - coarse).max(0.0) + LEFT * (left - most).max(0.0);
            against.min(MOST)
        })
        .collect();
    for (candidate, against) in candidates.iter_mut().zip(against) {
        candidate.hold_against(against);
    }
}

/// There is something of its brightness and size that is not likely to be a target.
fn has_peer(solver: &Solver, candidate: &Candidate, candidates: &[Candidate], things: &[Outstanding]) -> bool {
    let (own, others): (Vec<&Outstanding>, Vec<&Outstanding>) =
        things.iter().partition(|thing| candidate.is_about(solver, &thing.start));
    let energy = own.iter().map(|thing| thing.energy).fold(0.0, f64::max);
    let is_like = |thing: &Outstanding| {
        let of_it = |other: &&Candidate| other.is_about(solver, &thing.start);
        candidates.iter().filter(of_it).any(|other| other.evidence.is_some() && other.is_likely())
    };
    others.into_iter().any(|thing| thing.energy >= SHARE * energy && !is_like(thing))
}

/// Things of at least that share of the energy of what has these parameters, beside it; what is as much larger and brighter at its place
/// is something else as well.
pub(super) fn beside<'a>(
    solver: &'a Solver,
    parameters: &'a [f64],
    things: &'a [Outstanding],
    share: f64,
) -> impl Iterator<Item = &'a Outstanding> {
    let (area, brightness) = solver.looks(parameters);
    // Of the box about the outline.
    let energy = area.zip(brightness).map(|(area, brightness)| 4.0 * (area + 2.0 * brightness).exp());
    things.iter().filter(move |thing| match is_about(solver, parameters, &thing.start) {
        true => energy.is_some_and(|energy| share * thing.energy > energy),
        false => energy.is_none_or(|energy| thing.energy >= share * energy),
    })
}

/// There is something else that noise does not explain and that the target is not far brighter than, whether a fit describes it or
/// not; what is far larger and brighter than a fit at its place is something else as well.
pub(super) fn has_others(
    solver: &Solver,
    candidate: &Candidate,
    candidates: &[Candidate],
    things: &[Outstanding],
) -> bool {
    let Some(fit) = &candidate.attempt.fit else { return false };
    let significance = |one: &Candidate| one.evidence.map(|evidence| evidence.significance);
    let least = significance(candidate).map(|own| own + COMPARABLE.ln());
    let is_other = |other: &Candidate| {
        let is_elsewhere = other.attempt.fit.as_ref().is_some_and(|fit| !candidate.is_about(solver, &fit.parameters));
        !other.is_faint && is_elsewhere && significance(other).is_none_or(|other| least.is_none_or(|own| other >= own))
    };
    candidates.iter().any(is_other) || beside(solver, &fit.parameters, things, COMPARABLE).next().is_some()
}
