//! Results of all rounds: table and figure.

use std::fmt::Write;

use super::sequence::{Case, FrameSequence};
use super::{Answer, Answers};
use crate::accuracy::trial::ASTRAY_PX;
use crate::plot::panel::{Axis, COLOURS, Label, Panel, Series, Style, svg};
use crate::tracked::{SETTLING, quantile};

/// Colours of the figure by the prefix of a method's name.
const FAMILIES: [(&str, &str); 4] =
    [("isophote", COLOURS[0]), ("Ceres", COLOURS[1]), ("Python", COLOURS[2]), ("OpenCV", COLOURS[3])];

/// Result of a method over all frames that count.
pub struct MethodResult {
    /// Name in the tables.
    pub name: String,
    /// Microseconds per frame, median and 99th percentile.
    pub took_us: [f64; 2],
    /// RMSE of a coordinate of the centre over the bound, without failures.
    pub ratio: f64,
    /// Share of failures: no answer, or an astray one.
    pub failed: f64,
}

/// A case with all methods.
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// px
    pub bound_px: f64,
    /// Isophote's first.
    pub results: Vec<MethodResult>,
}

impl Outcome {
    /// Evaluates all rounds, which have the same methods in the same order.
    pub fn new(case: Case, sequence: &FrameSequence, rounds: &[Answers]) -> Outcome {
        let result = |(method, (name, _)): (usize, &(String, Vec<Answer>))| {
            let after_settling =
                || rounds.iter().flat_map(|round| round[method].1.iter().zip(&sequence.frames).skip(SETTLING));
            let times: Vec<f64> = after_settling().map(|(answer, _)| answer.took_us).collect();
            let error = |(answer, frame): (&Answer, &super::sequence::SequenceFrame)| {
                let [x, y] = [0, 1].map(|axis| answer.centre[axis] - frame.centre[axis]);
                x.hypot(y)
            };
            let good: Vec<f64> = after_settling().map(error).filter(|error| *error < ASTRAY_PX).collect();
            let square = good.iter().map(|error| error * error).sum::<f64>() / (2 * good.len()) as f64;
            MethodResult {
                name: name.clone(),
                took_us: [quantile(&times, 0.5), quantile(&times, 0.99)],
                ratio: square.sqrt() / sequence.bound_px,
                failed: 1.0 - good.len() as f64 / times.len() as f64,
            }
        };
        let results = rounds[0].iter().enumerate().map(result).collect();
        Outcome { case, bound_px: sequence.bound_px, results }
    }

    /// A table with a title.
    pub fn table(&self) -> String {
        let mut table = format!(
            "### {}\n\nBound: {:.4} px.\n\n| method | a frame, µs | p99 | times `spot` | RMSE/CRLB | failed |\n|---|---|---|---|---|---|\n",
            self.case.title(),
            self.bound_px
        );
        for s in &self.results {
            let times = s.took_us[0] / self.results[0].took_us[0];
            let failed = if s.failed > 0.0 { format!("{:.1} %", 100.0 * s.failed) } else { "–".to_string() };
            let [median, p99] = s.took_us;
            writeln!(table, "| {} | {median:.0} | {p99:.0} | {times:.2} | {:.2} | {failed} |", s.name, s.ratio)
                .unwrap();
        }
        table
    }

    fn panel(&self) -> Panel {
        let times = [20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0];
        let errors = [1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 8.0];
        let of = |head: &'static str| self.results.iter().filter(move |s| s.name.starts_with(head));
        let place = |s: &MethodResult| [s.took_us[0], s.ratio];
        let dots = FAMILIES.map(|(head, colour)| Series {
            name: head.to_string(),
            colour,
            style: Style::Dots,
            points: of(head).map(place).collect(),
        });
        let label = |(s, head, colour): (&MethodResult, &str, &'static str)| {
            let text = s.name.trim_start_matches(head).trim_start_matches([',', ' ']);
            let text = if text.is_empty() { head } else { text }.to_string();
            Label { place: place(s), text, colour }
        };
        let labelled = FAMILIES.into_iter().flat_map(|(head, colour)| of(head).map(move |s| (s, head, colour)));
        Panel {
            title: self.case.title(),
            x: Axis::logarithmic("µs a frame", [20.0, 20000.0], &times),
            y: Axis::logarithmic("RMSE/CRLB of the centre", [0.6, 10.0], &errors),
            series: dots.into(),
            labels: labelled.map(label).collect(),
            ..Panel::default()
        }
    }
}

/// Time and error of every method, one panel per case.
pub fn figure(outcomes: &[Outcome]) -> String {
    let panels: Vec<Panel> = outcomes.iter().map(Outcome::panel).collect();
    svg("Time and error of a tracked frame by method", &panels)
}
