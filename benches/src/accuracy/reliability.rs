//! Whether a confidence of p is right in p of all cases: over frames full of other things, with and without a target.
//!
//! What comes in: shipped documents, and the frames of [`super::clutter`] and [`super::search`]. What goes out: pairs of a
//! confidence and whether the target was there, and how many of them agree. Every estimate of a cold start counts that has a
//! confidence, also one that a session with default options would not track.

use std::fmt::Write as _;
use std::sync::Arc;

use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Frame, Tracker, TrackerOptions};

use super::clutter::{self, DOCUMENTS, scene::Edges, scene::Kind};
use super::search::scene::{Profile, Scene};
use crate::plot::panel::{Axis, COLOURS, Panel, Series, Style, svg};

/// A fit that ends this near to the target's centre is right, px.
const RIGHT_PX: f64 = 2.0;
/// Classes of the diagram, where each has enough estimates.
const CLASSES: usize = 10;
/// A class has so many estimates at least.
const COUNT_MIN: usize = 400;
/// Of an interval that holds 19 of 20 cases, in standard deviations.
const INTERVAL: f64 = 1.96;
/// Confidences are told from 0 and 1 by this much.
const CERTAIN: f64 = 1e-6;

/// One estimate.
#[derive(Clone, Debug)]
pub struct Said {
    /// What else was in the frame.
    pub kind: &'static str,
    /// Said to be right with this probability.
    pub confidence: f64,
    /// The target was there.
    pub is_right: bool,
}

/// Of all documents, so many frames of each kind with a target and as many without; `first` is the first seed.
pub fn said(frames: usize, first: u64) -> Vec<Said> {
    let mut all = Vec::new();
    for document in DOCUMENTS {
        let model = Arc::new(Model::from_toml(&crate::text(document)).unwrap());
        let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
        let mut add = |kind: &'static str, scene: &(dyn Fn(u64) -> (Frame, Option<[f64; 2]>) + Sync)| {
            let look = |seed: u64| look(&compiled, scene(first + seed));
            let seen = clutter::shared_out(frames, look).into_iter().flatten().flatten();
            all.extend(seen.map(|(confidence, is_right)| Said { kind, confidence, is_right }));
        };
        for with_target in [true, false] {
            for (kind, edges) in Kind::ALL.into_iter().flat_map(|kind| [(kind, Edges::Sharp), (kind, Edges::Blurred)]) {
                add(kind.name(), &|seed| clutter::picture(document, (kind, edges), with_target, seed));
            }
            add("ten discs, rings, cones and bars", &|seed| {
                let mut scene = Scene::new(4_000_000 + seed, 150.0, 10);
                scene.clutter.retain(|thing| thing.profile != Profile::Spot);
                let scene = if with_target { scene } else { scene.without_target() };
                (scene.frame(), scene.target.map(|target| target.centre))
            });
        }
    }
    all
}

/// The confidence of a cold start, and whether it ended at the target.
fn look(compiled: &Arc<Compiled>, (frame, target): (Frame, Option<[f64; 2]>)) -> Option<(f64, bool)> {
    let options = TrackerOptions { confidence_min: 0.0, ..TrackerOptions::default() };
    let estimate = Tracker::new(compiled.clone(), options).unwrap().track(&frame);
    let is_at = |[x, y]: [f64; 2]| (estimate.parameters[0] - x).hypot(estimate.parameters[1] - y) < RIGHT_PX;
    Some((estimate.confidence?, target.is_some_and(is_at)))
}

/// The same with confidences that a line through their log odds gives, which was fitted to all other kinds of frames.
pub fn mapped(all: &[Said]) -> Vec<Said> {
    let odds = |said: &Said| {
        let p = said.confidence.clamp(CERTAIN, 1.0 - CERTAIN);
        (p / (1.0 - p)).ln()
    };
    let mut kinds: Vec<&str> = all.iter().map(|said| said.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let without = |kind: &str| -> Vec<(f64, f64)> {
        let others = all.iter().filter(|said| said.kind != kind);
        others.map(|said| (odds(said), f64::from(u8::from(said.is_right)))).collect()
    };
    let lines: Vec<(&str, [f64; 2])> = kinds.into_iter().map(|kind| (kind, line(&without(kind)))).collect();
    let with = |said: &Said| {
        let [slope, constant] = lines.iter().find(|(kind, _)| *kind == said.kind).map_or([1.0, 0.0], |(_, line)| *line);
        let confidence = 1.0 / (1.0 + (-(slope * odds(said) + constant)).exp());
        Said { confidence, ..said.clone() }
    };
    all.iter().map(with).collect()
}

/// Slope and constant of the log odds, by Newton's method with a little ridge.
fn line(points: &[(f64, f64)]) -> [f64; 2] {
    let [mut slope, mut constant] = [1.0, 0.0];
    for _ in 0..50 {
        let mut gradient = [1e-3 * (1.0 - slope), -1e-3 * constant];
        let mut hessian = [[1e-3, 0.0], [0.0, 1e-3]];
        for (x, label) in points {
            let p = 1.0 / (1.0 + (-(slope * x + constant)).exp());
            let weight = p * (1.0 - p);
            gradient = [gradient[0] + (label - p) * x, gradient[1] + label - p];
            hessian = [[hessian[0][0] + weight * x * x, hessian[0][1] + weight * x], [0.0, hessian[1][1] + weight]];
        }
        let [[a, b], [_, d]] = hessian;
        let determinant = a * d - b * b;
        slope += ((d * gradient[0] - b * gradient[1]) / determinant).clamp(-1.0, 1.0);
        constant += ((a * gradient[1] - b * gradient[0]) / determinant).clamp(-2.0, 2.0);
    }
    [slope, constant]
}

/// A class of confidences.
struct Class {
    limits: [f64; 2],
    count: usize,
    /// Mean confidence, and the share that is right, with the interval in which it lies.
    mean: f64,
    right: f64,
    interval: [f64; 2],
}

impl Class {
    fn of(limits: [f64; 2], members: &[&Said]) -> Class {
        let n = members.len().max(1) as f64;
        let right = members.iter().filter(|said| said.is_right).count() as f64 / n;
        // Wilson's.
        let z2 = INTERVAL * INTERVAL / n;
        let middle = (right + 0.5 * z2) / (1.0 + z2);
        let half = (z2 * (right * (1.0 - right) + 0.25 * z2)).sqrt() / (1.0 + z2);
        let mean = members.iter().map(|said| said.confidence).sum::<f64>() / n;
        Class { limits, count: members.len(), mean, right, interval: [middle - half, middle + half] }
    }
}

/// Tenths, each with the next ones until it has `count_min` members; what is left at the top belongs to the last class.
fn classes(all: &[Said], count_min: usize) -> Vec<Class> {
    let tenth = |said: &Said| ((said.confidence * CLASSES as f64) as usize).min(CLASSES - 1);
    let limit = |number: usize| number as f64 / CLASSES as f64;
    let mut ends: Vec<usize> = Vec::new();
    let mut members = 0;
    for number in 0..CLASSES {
        members += all.iter().filter(|said| tenth(said) == number).count();
        if members >= count_min {
            ends.push(number + 1);
            members = 0;
        }
    }
    match ends.last_mut() {
        Some(last) => *last = CLASSES,
        None => ends.push(CLASSES),
    }
    let starts = std::iter::once(0).chain(ends.clone());
    let class = |(start, end): (usize, usize)| {
        let members: Vec<&Said> = all.iter().filter(|said| (start..end).contains(&tenth(said))).collect();
        Class::of([limit(start), limit(end)], &members)
    };
    starts.zip(ends).map(class).collect()
}

/// The tables of both.
pub fn table(all: &[Said]) -> String {
    let right = all.iter().filter(|said| said.is_right).count() as f64 / all.len().max(1) as f64;
    let mut text = format!("{} estimates, of which {:.1} % are right.\n", all.len(), 100.0 * right);
    for (name, all) in [("confidence", all), ("mapped", &mapped(all)[..])] {
        write!(text, "\n| {name} | estimates | mean | right | 19 of 20 |\n|---|---|---|---|---|\n").unwrap();
        for Class { limits: [low, high], count, mean, right, interval: [least, most] } in classes(all, COUNT_MIN) {
            writeln!(text, "| {low:.1}–{high:.1} | {count} | {mean:.3} | {right:.3} | {least:.2}–{most:.2} |").unwrap();
        }
    }
    text
}

/// The diagram: how many are right of those that say so with a probability.
pub fn figure(all: &[Said]) -> String {
    let ticks = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
    let series = |name: &str, colour: usize, style: Style, points: Vec<[f64; 2]>| Series {
        name: name.to_string(),
        colour: COLOURS[colour],
        style,
        points,
    };
    let of =
        |all: &[Said]| classes(all, COUNT_MIN).into_iter().map(|class| [class.mean, class.right]).collect::<Vec<_>>();
    let panel = Panel {
        title: "Estimates that are right".to_string(),
        x: Axis::linear("confidence", [0.0, 1.0], &ticks),
        y: Axis::linear("share that is right", [0.0, 1.0], &ticks),
        series: vec![
            series("as it should be", 2, Style::Dashed, vec![[0.0, 0.0], [1.0, 1.0]]),
            series("as it is", 0, Style::Dots, of(all)),
            series("mapped, other kinds of frames", 1, Style::Dots, of(&mapped(all))),
        ],
        ..Panel::default()
    };
    svg("Reliability of the confidence", &[panel])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_confidence_that_is_off_by_a_line_is_put_right_by_the_other_kinds() {
        let mut all = Vec::new();
        for i in 0..4000 {
            let truth = (f64::from(i) + 0.5) / 4000.0;
            let odds = (truth / (1.0 - truth)).ln();
            let confidence = 1.0 / (1.0 + (-(2.0 * odds + 3.0)).exp());
            // Of every ten in a row as many are right as should be.
            let is_right = f64::from(i * 7 % 10) + 0.5 < 10.0 * truth;
            all.push(Said { kind: ["bars", "rings"][i as usize / 10 % 2], confidence, is_right });
        }
        let worst = |all: &[Said]| classes(all, 100).iter().map(|c| (c.mean - c.right).abs()).fold(0.0, f64::max);
        assert!(worst(&all) > 0.3 && worst(&mapped(&all)) < 0.05, "{} {}", worst(&all), worst(&mapped(&all)));
    }

    #[test]
    fn classes_are_as_wide_as_they_must_be() {
        let said = |confidence: f64| Said { kind: "bars", confidence, is_right: true };
        let all: Vec<Said> = [0.05, 0.05, 0.15, 0.35, 0.55, 0.95, 0.97, 1.0].map(said).to_vec();
        let told = |count_min| classes(&all, count_min).iter().map(|c| (c.limits, c.count)).collect::<Vec<_>>();
        assert_eq!(told(2), [([0.0, 0.1], 2), ([0.1, 0.4], 2), ([0.4, 1.0], 4)]);
        assert_eq!(told(9), [([0.0, 1.0], 8)]);
        assert_eq!(classes(&[], 2)[0].count, 0);
    }
}
