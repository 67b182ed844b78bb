//! `isophote tune`: benchmarks schedules of stages, and reports where the model's F is convex. Needs no service.
//!
//! The result is the document with the best schedule, a table of all schedules tried, and the convexity report.

mod arguments;
mod report;
mod rewrite;
mod scenes;

use std::io::Write;
use std::time::Instant;

pub use arguments::TuneArgs;
use isophote_symbolic::{Method, Model, Precision};
use isophote_tracker::tune::{
    Bench, Convexity, Goal, Grid, Offset, Run, Schedule, Subset, figures, newton_of_each, schedules, subsets,
};
use isophote_tracker::{CompileFailure, TrackerOptions};

use crate::failure::Failure;
use crate::offline::compile;
use crate::{model_files, output};
use rewrite::Document;
use scenes::{TrialFrame, TrialFrames, scenes};

/// Offsets of starts: px of the centre, share of everything else.
const LEVELS: [Offset; 3] = [
    Offset { centre_px: 1.0, share: 0.05 },
    Offset { centre_px: 3.0, share: 0.15 },
    Offset { centre_px: 10.0, share: 0.5 },
];
/// Offsets of the convexity report, px; `SHARE_OF_PX` (5 %) of the other parameters go with each pixel.
const CONVEX_PX: [f64; 10] = [0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0];
const SHARE_OF_PX: f64 = 0.05;
const DIRECTIONS: u64 = 16;
/// Schedules count as equally reliable if their success rates differ by at most this.
const RATE_SLACK: f64 = 0.01;
/// Schedules count as equally fast if their median times differ by at most this share: the earlier in the list wins.
const TIME_SLACK: f64 = 0.05;

/// A schedule and the results of its fits.
struct TriedSchedule {
    schedule: Schedule,
    bench: Bench,
    runs: Vec<Run>,
    times_us: Vec<f64>,
}

impl TriedSchedule {
    /// Share of fits that reached the answer.
    fn rate(&self) -> f64 {
        self.runs.iter().filter(|run| run.reached).count() as f64 / self.runs.len().max(1) as f64
    }

    fn time_us(&self) -> f64 {
        figures::median(&self.times_us).unwrap_or(f64::INFINITY)
    }

    fn median(&self, of: impl Fn(&Run) -> u32) -> f64 {
        let values: Vec<f64> = self.runs.iter().map(|run| f64::from(of(run))).collect();
        figures::median(&values).unwrap_or(0.0)
    }
}

/// Result of tuning.
struct Tuned<'a> {
    model: &'a Model,
    candidates: Vec<TriedSchedule>,
    chosen: usize,
    convexity: Vec<(Subset, Convexity)>,
    frames: usize,
    lost: usize,
}

/// `isophote tune`.
pub fn run(args: &TuneArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    let text = model_files::text(&args.model)?.0;
    let is_json = args.model.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    let source = Document { model: &model, text: &text, is_json };
    let TrialFrames { scenes, options, lost } = scenes(args, &model)?;
    let mut candidates = candidates(args, &source, &options)?;
    let goals = goals(&candidates, &model, &scenes)?;
    let tries = goals.len() * LEVELS.len() * args.starts as usize;
    eprintln!("tune: {} schedules, {} frames, {tries} starts each", candidates.len(), goals.len());
    race(args, &goals, &mut candidates)?;
    let chosen = choose(&candidates);
    let (frames, lost) = (goals.len(), lost + scenes.len() - goals.len());
    let convexity = convexity(args, &source, &options, &goals)?;
    let found = Tuned { model: &model, candidates, chosen, convexity, frames, lost };
    let stages = &found.candidates[chosen].schedule.stages;
    let document = source.rewritten((chosen > 0).then_some(&stages[..]), &report::sentences(&found));
    let document = document.ok_or_else(|| not_understood(args))?;
    if let Some(path) = &args.out {
        output::file(path, document.as_bytes())?;
    }
    match (args.json, &args.out) {
        (true, out_path) => output::json(out, &report::json(&found, out_path.is_none().then_some(document.as_str()))),
        (false, Some(_)) => report::tables(out, &found),
        (false, None) => {
            report::tables(&mut std::io::stderr().lock(), &found)?;
            out.write_all(document.as_bytes()).map_err(Failure::output)
        }
    }
}

fn no_kernel(error: CompileFailure) -> Failure {
    Failure::Other(error.to_string())
}

fn candidates(args: &TuneArgs, source: &Document, options: &TrackerOptions) -> Result<Vec<TriedSchedule>, Failure> {
    let bench = |schedule: Schedule| -> Result<TriedSchedule, Failure> {
        let changed = source.with_stages(&schedule.stages).ok_or_else(|| not_understood(args))?;
        let compiled = compile(&args.model, changed, options.precision)?;
        let bench = Bench::new(compiled, options.clone()).map_err(|error| Failure::Usage(error.to_string()))?;
        Ok(TriedSchedule { schedule, bench, runs: Vec::new(), times_us: Vec::new() })
    };
    // The document's own schedule comes first and is required; others that are too large to derive are skipped.
    let mut all = schedules(source.model).into_iter().map(bench);
    let own = all.next().ok_or_else(|| not_understood(args))??;
    Ok(std::iter::once(own).chain(all.filter_map(Result::ok)).collect())
}

/// Finds the answers by one damped stage over all parameters, starting near them; skips frames without one.
fn goals<'a>(
    candidates: &[TriedSchedule],
    model: &Model,
    scenes: &'a [TrialFrame],
) -> Result<Vec<(&'a TrialFrame, Goal)>, Failure> {
    let all = subsets(model).pop().map_or(0, |all| all.parameters.len());
    let is_joint = |candidate: &&TriedSchedule| {
        let stages = &candidate.schedule.stages;
        stages.len() == 1 && stages[0].parameters.len() == all && stages[0].method == Method::LevenbergMarquardt
    };
    let joint = candidates.iter().find(is_joint).unwrap_or(&candidates[0]);
    let mut goals = Vec::new();
    for scene in scenes {
        goals.extend(joint.bench.goal(&scene.frame, &scene.start).map_err(no_kernel)?.map(|goal| (scene, goal)));
    }
    if goals.is_empty() {
        let message = "no frame has an answer: from the right start, all parameters together end in no good fit with a \
                       covariance; see what `isophote fit` says";
        return Err(Failure::Other(message.into()));
    }
    Ok(goals)
}

/// Runs all candidates in turn from each start, so that a slow machine slows all of them alike.
fn race(args: &TuneArgs, goals: &[(&TrialFrame, Goal)], candidates: &mut [TriedSchedule]) -> Result<(), Failure> {
    for (number, (scene, goal)) in goals.iter().enumerate() {
        eprintln!("tune: frame {} of {}", number + 1, goals.len());
        let frame = &scene.frame;
        // Kernels are compiled at first use: run once before timing.
        for candidate in candidates.iter() {
            candidate.bench.run(frame, goal, &goal.parameters, LEVELS[0]).map_err(no_kernel)?;
        }
        for (level, offset) in LEVELS.into_iter().enumerate() {
            for start in 0..args.starts {
                let place = (number * LEVELS.len() + level) as u64 * args.starts + start;
                let start =
                    candidates[0].bench.start(goal, offset, args.seed.wrapping_mul(1 << 32).wrapping_add(place));
                for candidate in candidates.iter_mut() {
                    let begin = Instant::now();
                    let run = candidate.bench.run(frame, goal, &start, offset).map_err(no_kernel)?;
                    candidate.times_us.push(begin.elapsed().as_nanos() as f64 / 1e3);
                    candidate.runs.push(run);
                }
            }
        }
    }
    Ok(())
}

/// The fastest of the most reliable schedules.
fn choose(candidates: &[TriedSchedule]) -> usize {
    let best = candidates.iter().map(TriedSchedule::rate).fold(0.0, f64::max);
    let reliable = |candidate: &&TriedSchedule| candidate.rate() >= best - RATE_SLACK;
    let by_time = |a: &&TriedSchedule, b: &&TriedSchedule| a.time_us().total_cmp(&b.time_us());
    let Some(fastest) = candidates.iter().filter(reliable).min_by(by_time) else { return 0 };
    // Identical steps from every start are the same computation, whatever the times.
    let is_as_fast = |candidate: &TriedSchedule| {
        let same_stages = candidate.schedule.stages.len() == fastest.schedule.stages.len();
        candidate.time_us() <= fastest.time_us() * (1.0 + TIME_SLACK) || same_stages && candidate.runs == fastest.runs
    };
    let is_it = |candidate: &TriedSchedule| reliable(&candidate) && is_as_fast(candidate);
    candidates.iter().position(is_it).unwrap_or(0)
}

/// The thesis' Table 4.1 for this model, in f64, so that rounding does not flip signs.
fn convexity(
    args: &TuneArgs,
    source: &Document,
    options: &TrackerOptions,
    goals: &[(&TrialFrame, Goal)],
) -> Result<Vec<(Subset, Convexity)>, Failure> {
    let precision = Precision::F64;
    let options = TrackerOptions { precision, ..options.clone() };
    let offset = |centre_px: f64| Offset { centre_px, share: SHARE_OF_PX * centre_px };
    let mut found = Vec::new();
    for (subset, stage) in subsets(source.model).into_iter().zip(newton_of_each(source.model)) {
        // A document per subset: all together would exceed the cost limit of one.
        let newton = source.with_stages(&[stage]).ok_or_else(|| not_understood(args))?;
        let bench = Bench::new(compile(&args.model, newton, precision)?, options.clone())
            .map_err(|error| Failure::Usage(error.to_string()))?;
        let mut together: Option<Convexity> = None;
        for (number, (scene, goal)) in goals.iter().enumerate() {
            let seed = args.seed.wrapping_add(number as u64).wrapping_mul(1 << 40);
            let grid = Grid { offsets: CONVEX_PX.map(offset).to_vec(), directions: DIRECTIONS, seed };
            let one = bench.convexity(&scene.frame, goal, 0, &grid).map_err(no_kernel)?;
            together = match (together, one) {
                (Some(before), Some(one)) => Some(before.and(&one)),
                (before, one) => before.or(one),
            };
        }
        found.extend(together.map(|together| (subset, together)));
    }
    Ok(found)
}

fn not_understood(args: &TuneArgs) -> Failure {
    Failure::Other(format!("{}: its stages cannot be replaced; write them as [[stages]]", args.model.display()))
}
