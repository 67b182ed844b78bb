//! A cold start of a pose: the spots that a window shows, every way to name them, and the poses that suit.
//!
//! What comes in: outlines of things that may be spots, and the geometry. What goes out: poses to begin a fit with, the likeliest
//! first. The moments are rough: an outline is known to a fifth in size, to a twentieth in shape. That is enough to tell
//! tilts; which of several alike spots is which only the fit itself may be able to tell, so several poses are handed on.

use nalgebra::DMatrix;

use super::direct::Geometry;
use super::joint::{Joint, Minimum, SpotSeen};
use super::rigid::Rigid;
use super::seen::Five;
use crate::budget::Spend;

/// A pose to begin with.
#[derive(Clone, Debug)]
pub(crate) struct PoseStart {
    pub pose: Rigid,
    /// The outline of each spot of the target; `None` for one that is not seen.
    pub outlines: Vec<Option<usize>>,
}

/// Poses handed on.
const STARTS_MAX: usize = 8;
/// … or, when it is sought which spot is which, …
const NAMINGS_MAX: usize = 16;
/// … whose χ² is larger by at most this.
const WORSE_MAX: f64 = 60.0;
/// Outlines beyond the target's spots that are considered: distractors.
pub(crate) const SPARE: usize = 1;
/// Centroids of tilted, clipped spots are off by so much, px, and this share of their size.
const CENTROID: (f64, f64) = (0.3, 0.01);
/// An outline's size, the same error for all spots, …
const SIZE: f64 = 0.2;
/// … and the shape of each.
const SHAPE: f64 = 0.05;

/// Poses that suit the outlines, the likeliest first. Outlines are in the order of their mass, in frame coordinates. None
/// when `spend` ends the search.
pub(crate) fn starts(geometry: &Geometry, outlines: &[Five], spend: Spend) -> Vec<PoseStart> {
    suiting(geometry, outlines, STARTS_MAX, spend)
}

/// The same of outlines that are a target's spots: more of them, so that no way to name these is missing.
pub(crate) fn namings(geometry: &Geometry, outlines: &[Five], spend: Spend) -> Vec<PoseStart> {
    suiting(geometry, outlines, NAMINGS_MAX, spend)
}

fn suiting(geometry: &Geometry, outlines: &[Five], most: usize, spend: Spend) -> Vec<PoseStart> {
    let spots = &geometry.target.spots;
    let count = spots.len().min(outlines.len());
    let mut found: Vec<(Minimum, Vec<Option<usize>>)> = Vec::new();
    for assignment in assignments(spots.len(), outlines.len().min(spots.len() + SPARE), count) {
        let seen: Vec<SpotSeen> = spots
            .iter()
            .zip(&assignment)
            .filter_map(|(spot, outline)| Some(SpotSeen { spot, ellipse: outlines[(*outline)?], profile: None }))
            .collect();
        let Some(joint) = Joint::new(&geometry.lens, &seen, &rough(&seen)) else { continue };
        let facing = |minimum: &Minimum| {
            spots.iter().all(|spot| minimum.pose.rotation.column(2).dot(&minimum.pose.apply(spot.centre())) > 0.0)
        };
        let Ok(minima) = joint.minima(spend) else { return Vec::new() };
        found.extend(minima.into_iter().filter(facing).map(|minimum| (minimum, assignment.clone())));
    }
    found.sort_by(|a, b| a.0.chi_square.total_cmp(&b.0.chi_square));
    let best = found.first().map_or(0.0, |(minimum, _)| minimum.chi_square);
    found.retain(|(minimum, _)| minimum.chi_square <= best + WORSE_MAX);
    found.truncate(most);
    found.into_iter().map(|(minimum, outlines)| PoseStart { pose: minimum.pose, outlines }).collect()
}

/// The covariance of rough ellipses, see above.
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

/// Every way to give `count` of `spots` spots an outline of their own.
fn assignments(spots: usize, outlines: usize, count: usize) -> Vec<Vec<Option<usize>>> {
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
        // Sixteen spots would have more ways than there is time: those that name the most massive outlines come first.
        longer.truncate(ASSIGNMENTS_MAX);
        partial = longer;
    }
    partial.retain(|assignment| assignment.iter().flatten().count() == count);
    partial
}

/// Ways that are tried.
const ASSIGNMENTS_MAX: usize = 400;

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::time::Instant;

    use isophote_symbolic::Model;
    use nalgebra::{Rotation3, Vector3};

    use super::*;
    use crate::budget::Stop;
    use crate::pose::seen::outline;
    use crate::pose::target::TargetSpot;

    /// Six spots, none of which has a name that a picture shows, and one thing more.
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
        // Minutes where the machine is busy: asked for by name.
        if std::env::var_os("ISOPHOTE_LONG").is_some() {
            let (begin, spent) = (Instant::now(), Cell::new(0_u64));
            let found = starts(&geometry, &outlines, &|units| {
                spent.set(spent.get() + units);
                Ok(())
            });
            eprintln!("six spots: {} units in {:?}", spent.get(), begin.elapsed());
            assert!(!found.is_empty() && spent.get() < crate::WORK_MAX / 4, "{} units", spent.get());
        }
        // Given up at some step, it asks no more.
        for last in [0, 1, 1000] {
            let (begin, asked) = (Instant::now(), Cell::new(0));
            let found = starts(&geometry, &outlines, &|_| {
                asked.set(asked.get() + 1);
                if asked.get() > last { Err(Stop::Cancelled) } else { Ok(()) }
            });
            eprintln!("given up after {last} steps: {:?}", begin.elapsed());
            assert!(found.is_empty() && asked.get() == last + 1, "{} steps", asked.get());
        }
    }

    #[test]
    fn every_assignment_once() {
        assert_eq!(assignments(3, 3, 3).len(), 6);
        assert_eq!(assignments(3, 4, 3).len(), 24);
        assert_eq!(assignments(3, 2, 2).len(), 6);
        assert_eq!(assignments(3, 1, 1).len(), 3);
        assert_eq!(assignments(1, 2, 1), [vec![Some(0)], vec![Some(1)]]);
        assert_eq!(assignments(5, 5, 5).len(), 120);
        assert_eq!(assignments(5, 4, 4).len(), 120);
        assert_eq!(assignments(16, 16, 16).len(), ASSIGNMENTS_MAX);
        for assignment in assignments(3, 4, 3) {
            let mut named: Vec<_> = assignment.iter().flatten().collect();
            named.sort();
            named.dedup();
            assert_eq!(named.len(), 3);
        }
    }
}
