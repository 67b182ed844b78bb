//! Consistency of the covariance: the normalised estimation error squared (NEES) of the centre, eᵀC⁻¹e.
//!
//! With a consistent covariance it is χ² with two degrees of freedom: 2 on average, and a share p of frames lies below
//! −2 ln(1 − p).

use std::fmt::Write;

use super::run::Measured;
use super::summary::SHARES;
use crate::plot::panel::{Axis, COLOURS, Panel, Series, Style, svg};

/// Half width of the 95 % band of the mean over `count` frames: χ² of two degrees of freedom has variance 4.
pub fn band(count: usize) -> f64 {
    1.96 * 2.0 / (count as f64).sqrt()
}

/// The table.
pub fn table(all: &[Measured]) -> String {
    let mut text = String::from("| condition | document | frames | NEES, mean (95 % band about 2) |");
    SHARES.iter().for_each(|share| write!(text, " {:.0} % |", 100.0 * share).unwrap());
    text += "\n|---|---|---|---|---|---|---|---|---|---|---|\n";
    for measured in all {
        let nees = &measured.tracking.nees;
        let shares: Vec<String> =
            measured.tracking.inside.iter().map(|share| format!("{:.1}", 100.0 * share)).collect();
        let (name, document) = (measured.task.condition.name, measured.task.document);
        let band = band(nees.count);
        let verdict = if (nees.mean - 2.0).abs() <= band { "" } else { ", **outside**" };
        writeln!(
            text,
            "| {name} | {document} | {} | {:.3} (± {band:.3}{verdict}) | {} |",
            nees.count,
            nees.mean,
            shares.join(" | ")
        )
        .unwrap();
    }
    text
}

/// The figure: means of all rows, and shares of some.
pub fn figure(rows: &[&Measured], long: &[Measured]) -> String {
    let reliable: Vec<&Measured> = rows.iter().copied().filter(|measured| measured.tracking.failed < 0.5).collect();
    let label = |(i, measured): (usize, &&Measured)| (i as f64, measured.task.condition.name.to_string());
    let ticks: Vec<(f64, String)> = reliable.iter().enumerate().map(label).collect();
    let last = reliable.len().max(2) as f64 - 0.5;
    let limit = |value: f64| Series {
        name: format!("{value}"),
        colour: COLOURS[1],
        style: Style::Dashed,
        points: vec![[-0.5, value], [last, value]],
    };
    let dots = reliable.iter().enumerate().map(|(i, measured)| [i as f64, measured.tracking.nees.mean]).collect();
    let means = Panel {
        title: "Mean NEES of the centre, tracking".to_string(),
        x: Axis { name: String::new(), range: [-0.5, last], ticks, logarithmic: false },
        y: Axis::linear("eᵀC⁻¹e", [1.5, 4.0], &[1.5, 2.0, 2.5, 3.0, 3.5, 4.0]),
        series: vec![
            Series { name: "all rows of the table".to_string(), colour: COLOURS[0], style: Style::Dots, points: dots },
            limit(1.8),
            limit(2.2),
        ],
        ..Panel::default()
    };
    let line = |(i, measured): (usize, &Measured)| Series {
        name: measured.task.condition.name.to_string(),
        colour: COLOURS[i + 2 - 2 * (i / 3)],
        style: Style::Line,
        points: SHARES.iter().zip(&measured.tracking.inside).map(|(p, seen)| [100.0 * p, 100.0 * seen]).collect(),
    };
    let ideal = Series {
        name: "honest".to_string(),
        colour: COLOURS[1],
        style: Style::Dashed,
        points: vec![[0.0; 2], [100.0; 2]],
    };
    let ticks = [0.0, 20.0, 40.0, 60.0, 80.0, 100.0];
    let shares = Panel {
        title: "Share of frames inside their ellipse".to_string(),
        x: Axis::linear("should be, %", [0.0, 100.0], &ticks),
        y: Axis::linear("is, %", [0.0, 100.0], &ticks),
        series: std::iter::once(ideal).chain(long.iter().enumerate().map(line)).collect(),
        ..Panel::default()
    };
    svg("Covariance consistency", &[means, shares])
}
