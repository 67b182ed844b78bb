//! Results of `isophote tune`: tables for people, JSON, and the comment in the document.

use std::io::Write;

use isophote_symbolic::Stage;
use isophote_tracker::tune::{Convexity, Offset};
use serde::Serialize;

use super::rewrite::names;
use super::{LEVELS, TriedSchedule, Tuned};
use crate::failure::Failure;
use crate::output;

/// JSON of `--json`.
#[derive(Serialize)]
pub struct Report<'a> {
    model: &'a str,
    digest: &'a str,
    /// Frames used, and frames skipped because no answer was found.
    frames: usize,
    frames_without_answer: usize,
    offsets: [Offset; LEVELS.len()],
    /// Name of the chosen schedule.
    chosen: &'a str,
    schedules: Vec<ScheduleRow<'a>>,
    convexity: Vec<Convex<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    document: Option<&'a str>,
}

#[derive(Serialize)]
struct ScheduleRow<'a> {
    name: &'a str,
    stages: Vec<StageRow<'a>>,
    fits: usize,
    success_rate: f64,
    time_us: f64,
    iterations: f64,
    passes: f64,
}

#[derive(Serialize)]
struct StageRow<'a> {
    parameters: Vec<&'a str>,
    method: &'a str,
    iterations: u32,
    tolerance: f64,
}

#[derive(Serialize)]
struct Convex<'a> {
    subset: &'a str,
    parameters: Vec<&'a str>,
    share: f64,
    #[serde(flatten)]
    figures: &'a Convexity,
}

/// The object of `--json`, with the document unless a file takes it.
pub fn json<'a>(found: &'a Tuned, document: Option<&'a str>) -> Report<'a> {
    let stage = |stage: &'a Stage| StageRow {
        parameters: names(found.model, stage),
        method: stage.method.name(),
        iterations: stage.iterations,
        tolerance: stage.tolerance,
    };
    let row = |candidate: &'a TriedSchedule| ScheduleRow {
        name: &candidate.schedule.name,
        stages: candidate.schedule.stages.iter().map(stage).collect(),
        fits: candidate.runs.len(),
        success_rate: candidate.rate(),
        time_us: candidate.time_us(),
        iterations: candidate.median(|run| run.iterations),
        passes: candidate.median(|run| run.passes),
    };
    let convex = found.convexity.iter().map(|(subset, figures)| Convex {
        subset: &subset.name,
        parameters: subset.parameters.iter().map(|id| found.model.parameters()[id.index()].name.as_str()).collect(),
        share: share(figures),
        figures,
    });
    Report {
        model: found.model.name(),
        digest: found.model.digest(),
        frames: found.frames,
        frames_without_answer: found.lost,
        offsets: LEVELS,
        chosen: &found.candidates[found.chosen].schedule.name,
        schedules: found.candidates.iter().map(row).collect(),
        convexity: convex.collect(),
        document,
    }
}

fn share(convexity: &Convexity) -> f64 {
    f64::from(convexity.convex) / f64::from(convexity.starts.max(1))
}

/// Prints both tables.
pub fn tables(out: &mut dyn Write, found: &Tuned) -> Result<(), Failure> {
    let row = |(number, candidate): (usize, &TriedSchedule)| {
        vec![
            if number == found.chosen { "*" } else { "" }.to_string(),
            candidate.schedule.name.clone(),
            format!("{:.1} %", 100.0 * candidate.rate()),
            format!("{:.3}", candidate.time_us() / 1e3),
            format!("{}", candidate.median(|run| run.iterations)),
            format!("{}", candidate.median(|run| run.passes)),
        ]
    };
    let rows: Vec<Vec<String>> = found.candidates.iter().enumerate().map(row).collect();
    output::table(out, &["", "SCHEDULE", "REACHED", "MS", "ITERATIONS", "PASSES"], &rows)?;
    writeln!(out).map_err(Failure::output)?;
    let row = |(subset, convexity): &(isophote_tracker::tune::Subset, Convexity)| {
        vec![
            subset.name.clone(),
            format!("{:.1} %", 100.0 * share(convexity)),
            convexity.radius.map_or("-".into(), |offset| distance(&subset.name, offset)),
            convexity.negative_max.to_string(),
            convexity.eigenvalues.map_or("-".into(), |[least, most]| format!("{least:.1e} … {most:.1e}")),
        ]
    };
    let rows: Vec<Vec<String>> = found.convexity.iter().map(row).collect();
    output::table(out, &["SUBSET", "CONVEX", "EVERYWHERE WITHIN", "NEGATIVE", "EIGENVALUES AT THE ANSWER"], &rows)
}

/// A distance in the parameters of the subset.
fn distance(subset: &str, offset: Offset) -> String {
    let (px, share) = (format!("{} px", offset.centre_px), format!("{:.1} %", 100.0 * offset.share));
    match subset {
        "centre" => px,
        "shape" | "illumination" => share,
        _ => format!("{px}, {share}"),
    }
}

/// Explains how the schedule was found.
pub fn sentences(found: &Tuned) -> Vec<String> {
    let (chosen, original) = (&found.candidates[found.chosen], &found.candidates[0]);
    let describe = |candidate: &TriedSchedule| {
        format!(
            "{:.1} % reached, {:.3} ms, {} iterations",
            100.0 * candidate.rate(),
            candidate.time_us() / 1e3,
            candidate.median(|run| run.iterations)
        )
    };
    let [first, .., last] = LEVELS;
    let mut sentences = vec![
        format!(
            "the fastest of {} schedules among those that find the answer most often (within 1 %);",
            found.candidates.len()
        ),
        format!(
            "{} starts on {} frames, {} to {} px and {:.0} to {:.0} % off: {}",
            chosen.runs.len(),
            found.frames,
            first.centre_px,
            last.centre_px,
            100.0 * first.share,
            100.0 * last.share,
            describe(chosen)
        ),
    ];
    if found.chosen > 0 {
        sentences.push(format!("the stages before: {}", describe(original)));
    }
    sentences
}
