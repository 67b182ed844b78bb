//! Tables and figures of the outcomes.

use isophote_tracker::{CONFIDENCE_MIN, Signs};

use super::logistic::{area_under_curve, classes, gap, log_loss, wrong_at};
use super::things::Kind;
use super::{AcceptedFit, Example, JudgedFit, crossed, documents};
use crate::plot::panel::{Axis, COLOURS, Panel, Series, Style, svg};

/// Boundaries of the classes of signal-to-noise ratio.
const RATIOS: [f64; 5] = [0.0, 20.0, 45.0, 100.0, f64::INFINITY];

fn percent(count: usize, all: usize) -> String {
    match all {
        0 => "–".to_string(),
        _ => format!("{:.1} %", 100.0 * count as f64 / all as f64),
    }
}

/// Rates of `tracking` by default options: a row per kind of object, document and class of signal-to-noise ratio. Lone
/// objects accepted below the confidence limit are counted separately.
pub fn accepted(examples: &[Example]) -> String {
    let mut text = "| frames with | without a target, with one | without: tracking, + lone things | with: tracking something else, + lone things | with: tracking the target | of those whose fit is right |\n|---|---|---|---|---|---|\n".to_string();
    let mut line = |name: &str, is: &dyn Fn(&Example) -> bool| {
        let (with, without): (Vec<&Example>, Vec<&Example>) =
            examples.iter().filter(|one| is(one)).partition(|one| one.snr.is_some());
        let count = |of: &[&Example], is: &dyn Fn(AcceptedFit) -> bool| {
            of.iter().filter(|one| one.accepted.is_some_and(is)).count()
        };
        let wrong = |of: &[&Example]| {
            let [sure, lone] =
                [false, true].map(|lone| count(of, &|accepted| !accepted.is_right && accepted.is_lone == lone));
            format!("{} + {}", percent(sure, of.len()), percent(lone, of.len()))
        };
        let is_found = |one: &&&Example| one.fit.as_ref().is_some_and(|fit| fit.is_right);
        let found: Vec<&Example> = with.iter().filter(is_found).copied().collect();
        text += &format!(
            "| {name} | {}, {} | {} | {} | {} | {} of {} |\n",
            without.len(),
            with.len(),
            wrong(&without),
            wrong(&with),
            percent(count(&with, &|accepted| accepted.is_right), with.len()),
            percent(count(&found, &|accepted| accepted.is_right), found.len()),
            found.len(),
        );
    };
    line("anything", &|_| true);
    for pair in RATIOS.windows(2) {
        let name = match pair[1].is_finite() {
            true => format!("a target of SNR {} to {}", pair[0], pair[1]),
            false => format!("a target of SNR {} and more", pair[0]),
        };
        line(&name, &|one| one.snr.is_some_and(|snr| (pair[0]..pair[1]).contains(&snr)));
    }
    for kind in Kind::ALL {
        line(&kind.name(), &|one| one.kind == kind);
    }
    for (number, document) in documents().iter().enumerate() {
        line(&format!("`{}`", document.name), &|one| one.document == number);
    }
    text
}

/// Discrimination of right and wrong fits: with the present weights, and with weights learned without the kind of
/// object or the document at hand.
pub fn discrimination(examples: &[Example]) -> String {
    let mut text =
        "| fits of | fits, right | weights | area under the curve | log loss | wrong ones taken where 95 % of the right ones are | gap |\n|---|---|---|---|---|---|---|\n".to_string();
    let fits = fits(examples);
    let count = Signs::NAMES.len();
    let ways = [
        ("as they are", fits.iter().map(|(_, fit)| fit.signs.probability()).collect::<Vec<f64>>()),
        ("without the kind", crossed(&fits, count, kind)),
        ("without the document", crossed(&fits, count, |one| one.document)),
        ("the evidence alone", crossed(&fits, 1, kind)),
    ];
    let mut line = |name: &str, is: &dyn Fn(&Example) -> bool| {
        for (way, predictions) in &ways {
            let own: Vec<(f64, bool)> = fits
                .iter()
                .zip(predictions)
                .filter(|((one, _), _)| is(one))
                .map(|((_, fit), p)| (*p, fit.is_right))
                .collect();
            text += &format!(
                "| {name} | {}, {} | {way} | {:.3} | {:.3} | {:.1} % | {:.3} |\n",
                own.len(),
                own.iter().filter(|(_, is)| *is).count(),
                area_under_curve(&own),
                log_loss(&own),
                100.0 * wrong_at(&own, 0.95),
                gap(&own),
            );
        }
    };
    line("all", &|_| true);
    for (number, document) in documents().iter().enumerate() {
        line(&format!("`{}`", document.name), &|one| one.document == number);
    }
    for kind in Kind::ALL {
        line(&kind.name(), &|one| one.kind == kind);
    }
    text
}

/// Frames with lone targets are the only source of noise fits: of those leave out one document at a time.
fn kind(one: &Example) -> (Kind, usize) {
    (one.kind, if one.kind == Kind::Nothing { one.document } else { 0 })
}

fn fits(examples: &[Example]) -> Vec<(&Example, &JudgedFit)> {
    examples.iter().filter_map(|one| Some((one, one.fit.as_ref()?))).collect()
}

/// Calibration: frequency of right fits by probability; and ROC curves, for each document over all confidence limits.
pub fn figure(examples: &[Example]) -> String {
    let ticks = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
    let fits = fits(examples);
    let predictions = |is: &dyn Fn(&Example) -> bool| -> Vec<(f64, bool)> {
        fits.iter().filter(|(one, _)| is(one)).map(|(_, fit)| (fit.confidence, fit.is_right)).collect()
    };
    let series = |name: &str, colour: usize, style: Style, points: Vec<[f64; 2]>| Series {
        name: name.to_string(),
        colour: COLOURS[colour % COLOURS.len()],
        style,
        points,
    };
    let curve = |predictions: &[(f64, bool)]| -> Vec<[f64; 2]> {
        let of = |wanted: bool, least: f64| {
            let all = predictions.iter().filter(|(_, is)| *is == wanted);
            all.clone().filter(|(p, _)| *p >= least).count() as f64 / all.count().max(1) as f64
        };
        (0..=40).map(|step| f64::from(step) / 40.0).map(|least| [of(false, least), of(true, least)]).collect()
    };
    let reliability = Panel {
        title: "Fits that are right".to_string(),
        x: Axis::linear("confidence", [0.0, 1.0], &ticks),
        y: Axis::linear("share that is right", [0.0, 1.0], &ticks),
        series: vec![
            series("as it should be", 2, Style::Dashed, vec![[0.0, 0.0], [1.0, 1.0]]),
            series(
                "ten equal classes",
                0,
                Style::Dots,
                classes(&predictions(&|_| true)).iter().map(|c| c.point()).collect(),
            ),
        ],
        ..Panel::default()
    };
    let by_document = documents().into_iter().enumerate().map(|(number, document)| {
        let style = if number < COLOURS.len() { Style::Line } else { Style::Dashed };
        series(&document.name, number, style, curve(&predictions(&|one| one.document == number)))
    });
    let accepted = Panel {
        title: format!("Taken from a confidence on ({CONFIDENCE_MIN} by default)"),
        x: Axis::linear("share of wrong fits", [0.0, 1.0], &ticks),
        y: Axis::linear("share of right fits", [0.0, 1.0], &ticks),
        series: by_document.collect(),
        ..Panel::default()
    };
    svg("Reliability of the confidence", &[reliability, accepted])
}
