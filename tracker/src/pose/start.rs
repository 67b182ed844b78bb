//! Cold start of a pose: assigns the outlines in a window to the target's spots and finds the matching poses.
//!
//! Poses are returned likeliest first. Outlines from moments are rough: known to a fifth in size, to a twentieth in
//! shape. That is enough to tell tilts; only the fit itself may tell similar spots apart, so several poses are
//! returned.

use nalgebra::{DMatrix, Vector3};

use super::direct::Geometry;
use super::joint::{Joint, Minimum, SpotSeen};
use super::p3p::p3p;
use super::rigid::Rigid;
use super::seen::{Five, outline};
use crate::budget::{Spend, Stop};
use crate::statistics::chi_square_exceeded;

/// A start pose.
#[derive(Clone, Debug)]
pub(crate) struct PoseStart {
    pub pose: Rigid,
    /// Outline index of each spot of the target; `None` for an unseen one.
    pub outlines: Vec<Option<usize>>,
}

/// Largest number of start poses.
const STARTS_MAX: usize = 8;
/// Largest number of start poses when spots are being named.
const NAMINGS_MAX: usize = 16;
/// Largest excess of χ² over the best.
const WORSE_MAX: f64 = 60.0;
/// Budget: outlines of a window that are considered; they have 12,144 ordered triples.
pub(crate) const OUTLINES_MAX: usize = 24;
/// Error of centroids of tilted, clipped spots, px, and as a share of their size.
const CENTROID: (f64, f64) = (0.3, 0.01);
/// Relative error of the outlines' size, common to all spots.
const SIZE: f64 = 0.2;
/// Relative error of each outline's shape.
const SHAPE: f64 = 0.05;

/// Poses that match the outlines, the likeliest first. Outlines are in the order of their mass, in frame coordinates.
/// Empty when `spend` stops the search.
pub(crate) fn starts(geometry: &Geometry, outlines: &[Five], spend: Spend) -> Vec<PoseStart> {
    suiting(geometry, outlines, STARTS_MAX, spend)
}

/// The same for outlines that are a target's spots, with a larger limit so that no assignment is missing.
pub(crate) fn namings(geometry: &Geometry, outlines: &[Five], spend: Spend) -> Vec<PoseStart> {
    suiting(geometry, outlines, NAMINGS_MAX, spend)
}

fn suiting(geometry: &Geometry, outlines: &[Five], most: usize, spend: Spend) -> Vec<PoseStart> {
    let spots = &geometry.target.spots;
    let mut found: Vec<(Minimum, Assignment)> = Vec::new();
    let Ok(assignments) = assignments(geometry, outlines, spend) else { return Vec::new() };
    for assignment in assignments {
        let seen: Vec<SpotSeen> = spots
            .iter()
            .zip(&assignment)
            .filter_map(|(spot, outline)| Some(SpotSeen { spot, ellipse: outlines[(*outline)?], profile: None }))
            .collect();
        let Some(joint) = Joint::new(&geometry.lens, &seen, &rough(&seen)) else { continue };
        let Ok(minima) = joint.minima(spend) else { return Vec::new() };
        let unseen = other() * (spots.len() - seen.len()) as f64;
        found.extend(
            minima
                .into_iter()
                .filter(|minimum| is_facing(geometry, &minimum.pose))
                .map(|minimum| (Minimum { chi_square: minimum.chi_square + unseen, ..minimum }, assignment.clone())),
        );
    }
    found.sort_by(|a, b| a.0.chi_square.total_cmp(&b.0.chi_square));
    let best = found.first().map_or(0.0, |(minimum, _)| minimum.chi_square);
    found.retain(|(minimum, _)| minimum.chi_square <= best + WORSE_MAX);
    found.truncate(most);
    found.into_iter().map(|(minimum, outlines)| PoseStart { pose: minimum.pose, outlines }).collect()
}

/// True when all spots are seen from the front.
fn is_facing(geometry: &Geometry, pose: &Rigid) -> bool {
    geometry.target.spots.iter().all(|spot| pose.rotation.column(2).dot(&pose.apply(spot.centre())) > 0.0)
}

/// The covariance of rough ellipses.
fn rough(seen: &[SpotSeen]) -> DMatrix<f64> {
    let n = 5 * seen.len();
    let mut covariance = DMatrix::zeros(n, n);
    let mut sizes = nalgebra::DVector::zeros(n);
    for (index, spot) in seen.iter().enumerate() {
        let e = &spot.ellipse;
        let size = (e[2] * e[4] - e[3] * e[3]).max(f64::MIN_POSITIVE).powf(-0.25);
        let typical = 0.5 * (e[2] + e[4]);
        for k in 0..5 {
            let deviation = if k < 2 { CENTROID.0 + CENTROID.1 * size } else { SHAPE * typical };
            covariance[(5 * index + k, 5 * index + k)] = deviation * deviation;
            sizes[5 * index + k] = if k < 2 { 0.0 } else { 2.0 * SIZE * e[k] };
        }
    }
    covariance + &sizes * sizes.transpose()
}

/// The index of each spot's outline.
type Assignment = Vec<Option<usize>>;

/// Assignments of distinct outlines to spots: all of them where they are few. Else the poses of each three outlines by P3P
/// predict the outlines of all spots, the nearest ones are assigned, and the assignments of least χ² are returned.
fn assignments(geometry: &Geometry, outlines: &[Five], spend: Spend) -> Result<Vec<Assignment>, Stop> {
    let spots = &geometry.target.spots;
    let count = spots.len().min(outlines.len());
    if count < 3 {
        // A pose suits any one or two outlines: only the first of others is tried.
        return Ok(injections(spots.len(), outlines.len().min(spots.len() + 1), count));
    }
    if outlines.len() <= ASSIGNED_EXHAUSTIVELY && spots.len() == 3 {
        return Ok(injections(spots.len(), outlines.len(), count));
    }
    let rays: Option<Vec<Vector3<f64>>> =
        outlines.iter().map(|at| geometry.lens.ray([at[0], at[1]]).map(Vector3::from)).collect();
    let Some(rays) = rays else { return Ok(Vec::new()) };
    let mut found: Vec<(f64, Assignment)> = Vec::new();
    for spots_of_three in triples(spots.len().min(BASE_SPOTS)) {
        for outlines_of_three in injections(3, outlines.len(), 3) {
            spend(P3P_COST)?;
            let mut named = vec![None; spots.len()];
            spots_of_three.iter().zip(&outlines_of_three).for_each(|(spot, outline)| named[*spot] = *outline);
            let points = spots_of_three.map(|spot| spots[spot].centre());
            let seen = spots_of_three.map(|spot| named[spot].map_or(Vector3::zeros(), |outline| rays[outline]));
            for pose in p3p(&points, &seen).into_iter().filter(|pose| is_facing(geometry, pose)) {
                found.extend(completed(geometry, &pose, outlines, named.clone()));
            }
        }
    }
    found.sort_by(|a, b| a.1.cmp(&b.1).then(a.0.total_cmp(&b.0)));
    found.dedup_by(|a, b| a.1 == b.1);
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.truncate(ASSIGNMENTS_MAX);
    Ok(found.into_iter().map(|(_, assignment)| assignment).collect())
}

/// Assigns the nearest outlines to the other spots' projections, `None` beyond [`other`]; with the χ² of all spots.
fn completed(geometry: &Geometry, pose: &Rigid, outlines: &[Five], mut named: Assignment) -> Option<(f64, Assignment)> {
    let projections = geometry.target.spots.iter().map(|spot| outline(&geometry.lens, pose, spot));
    let projections: Vec<Five> = projections.collect::<Option<_>>()?;
    let distance = |spot: usize, seen: usize| {
        let off = outlines[seen] - projections[spot];
        let terms = off.iter().zip(deviations(&projections[spot])).map(|(off, deviation)| (off / deviation).powi(2));
        terms.sum::<f64>()
    };
    let mut distances = Vec::new();
    for spot in (0..named.len()).filter(|spot| named[*spot].is_none()) {
        let free = (0..outlines.len()).filter(|seen| !named.contains(&Some(*seen)));
        distances.extend(free.map(|seen| (distance(spot, seen), spot, seen)));
    }
    distances.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, spot, seen) in distances.into_iter().filter(|(distance, ..)| *distance < other()) {
        if named[spot].is_none() && !named.contains(&Some(seen)) {
            named[spot] = Some(seen);
        }
    }
    let chi_square = |(spot, seen): (usize, &Option<usize>)| seen.map_or(other(), |seen| distance(spot, seen));
    Some((named.iter().enumerate().map(chi_square).sum(), named))
}

/// χ² of an outline that is another thing: the five numbers of a spot exceed it once in a thousand.
fn other() -> f64 {
    chi_square_exceeded(1e-3, 5)
}

/// Standard deviations of a rough ellipse's numbers.
fn deviations(e: &Five) -> [f64; 5] {
    let size = (e[2] * e[4] - e[3] * e[3]).max(f64::MIN_POSITIVE).powf(-0.25);
    let (centre, shape) = (CENTROID.0 + CENTROID.1 * size, SHAPE.hypot(2.0 * SIZE) * 0.5 * (e[2] + e[4]));
    [centre, centre, shape, shape, shape]
}

/// Every three of `count` numbers.
fn triples(count: usize) -> impl Iterator<Item = [usize; 3]> {
    (2..count).flat_map(move |k| (1..k).flat_map(move |j| (0..j).map(move |i| [i, j, k])))
}

/// Budget: outlines whose assignments to up to three spots are all tried.
const ASSIGNED_EXHAUSTIVELY: usize = 4;
/// Budget: assignments whose poses are refined, as many as three spots and four outlines have.
const ASSIGNMENTS_MAX: usize = 24;
/// Budget: spots of which three are assumed seen.
const BASE_SPOTS: usize = 4;
/// Cost of a P3P solution with its projections, in pixels of a pass that take as long.
const P3P_COST: u64 = 20_000;

/// Every assignment of distinct outlines to `count` of `spots` spots.
fn injections(spots: usize, outlines: usize, count: usize) -> Vec<Assignment> {
    let mut partial = vec![Vec::new()];
    for left in (0..spots).rev() {
        let mut longer = Vec::new();
        for assignment in &partial {
            let choices = (0..outlines).map(Some).chain([None]);
            for choice in choices.filter(|choice| choice.is_none() || !assignment.contains(choice)) {
                let mut next = assignment.clone();
                next.push(choice);
                let named = next.iter().flatten().count();
                if named <= count && named + left >= count {
                    longer.push(next);
                }
            }
        }
        partial = longer;
    }
    partial
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use isophote_symbolic::Model;
    use nalgebra::Rotation3;

    use super::*;
    use crate::budget::Stop;
    use crate::pose::seen::outline;
    use crate::pose::target::TargetSpot;

    /// Six indistinguishable spots, and one distractor.
    fn six() -> (Geometry, Vec<Five>) {
        let model = include_str!("../../../models/three-spots-pose.toml");
        let model = Model::from_toml(model).expect("a shipped model");
        let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
        let mut geometry = Geometry::of(&model, &constants).expect("a pose");
        let places = [[0.0, 90.0], [-80.0, -40.0], [75.0, -45.0], [-60.0, 55.0], [70.0, 60.0], [5.0, -95.0]];
        let spot = |(i, [x, y]): (usize, [f64; 2])| TargetSpot {
            name: format!("spot{i}"),
            position_mm: [x, y, 0.0],
            radius_mm: 20.0,
        };
        geometry.target.spots = places.into_iter().enumerate().map(spot).collect();
        let turn = Rotation3::new(Vector3::new(0.4, -0.3, 0.2)).into_inner();
        let pose = Rigid { rotation: turn, translation: Vector3::new(40.0, -30.0, 900.0) };
        let seen = |spot: &TargetSpot| outline(&geometry.lens, &pose, spot).expect("in front of the camera");
        let outlines = geometry.target.spots.iter().map(seen).collect();
        (geometry, outlines)
    }

    #[test]
    fn six_alike_spots_are_searched_within_a_bound() {
        let (geometry, outlines) = six();
        // After a stop, no more work is requested.
        for last in [0, 1, 1000] {
            let asked = Cell::new(0);
            let found = starts(&geometry, &outlines, &|_| {
                asked.set(asked.get() + 1);
                if asked.get() > last { Err(Stop::Cancelled) } else { Ok(()) }
            });
            assert!(found.is_empty() && asked.get() == last + 1, "{} steps", asked.get());
        }
    }

    #[test]
    fn five_spots_are_named_in_every_order_beside_a_distractor() {
        let (mut geometry, mut outlines) = six();
        geometry.target.spots.truncate(5);
        outlines[5] += Five::new(40.0, 25.0, 0.0, 0.0, 0.0); // no longer a spot
        for first in 0..6 {
            let order: Vec<usize> = (0..6).map(|i| (i * 5 + first) % 6).collect();
            assert_is_named(&geometry, &outlines, &order);
        }
    }

    #[test]
    fn three_spots_are_named_among_nine_other_things() {
        let (mut geometry, mut outlines) = six();
        geometry.target.spots.truncate(3);
        let spot = outlines[0];
        for (number, outline) in outlines.iter_mut().enumerate().skip(3) {
            *outline += Five::new(17.0 * number as f64 - 60.0, 25.0, 0.0, 0.0, 0.0);
        }
        let others = (0..6).map(|number| {
            let (angle, size) = (f64::from(number).sin(), 1.0 + 0.3 * f64::from(number));
            let at = Five::new(330.0 * angle, 210.0 * (5.0 * angle).cos(), 0.0, 0.0, 0.0);
            Five::new(0.0, 0.0, size * spot[2], 0.5 * spot[3], size * spot[4]) + at
        });
        outlines.extend(others);
        assert_is_named(&geometry, &outlines, &[7, 3, 0, 9, 4, 1, 11, 5, 8, 2, 6, 10]);
    }

    /// The first outlines are the spots: these are found in that order of all.
    fn assert_is_named(geometry: &Geometry, outlines: &[Five], order: &[usize]) {
        let shuffled: Vec<Five> = order.iter().map(|&index| outlines[index]).collect();
        let found = starts(geometry, &shuffled, &|_| Ok(()));
        let spots = 0..geometry.target.spots.len();
        let truth: Vec<Option<usize>> = spots.map(|spot| order.iter().position(|&index| index == spot)).collect();
        assert_eq!(found.first().map(|start| &start.outlines), Some(&truth), "{order:?}");
    }

    #[test]
    fn every_assignment_of_three_occurs_once() {
        assert_eq!(injections(3, 3, 3).len(), 6);
        assert_eq!(injections(3, 4, 3).len(), 24);
        assert_eq!(injections(3, 2, 2).len(), 6);
        assert_eq!(injections(3, 1, 1).len(), 3);
        assert_eq!(injections(1, 2, 1), [vec![Some(0)], vec![Some(1)]]);
        for assignment in injections(3, 4, 3) {
            let mut named: Vec<_> = assignment.iter().flatten().collect();
            named.sort();
            named.dedup();
            assert_eq!(named.len(), 3);
        }
    }
}
