//! Error as a function of saturation, a lobe of glare, and occlusion.

use std::fmt::Write;

use super::condition::{Condition, Glare, Task, condition, lamp, nothing};
use super::run::{Documents, Measured, measure};
use super::summary::Summary;
use crate::plot::panel::{Axis, COLOURS, Panel, Series, Style, svg};

/// The points of a curve.
pub struct Curve {
    /// The document.
    pub document: &'static str,
    /// Abscissa and measurement, in ascending order.
    pub points: Vec<(f64, Measured)>,
}

const SATURATED: [f64; 9] = [0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.9];
const LOBES: [f64; 6] = [0.0, 20.0, 50.0, 100.0, 140.0, 200.0];
const HIDDEN: [f64; 7] = [0.0, 0.05, 0.1, 0.2, 0.25, 0.35, 0.5];
/// Saturation, and errors of a plain least-squares fit of all pixels, %: of the notes' prototypes, 60 frames each.
const IGNORED: [(f64, f64, f64); 3] = [(10.0, 1.4, -4.3), (30.0, 9.0, -28.9), (60.0, 23.6, -72.3)];

fn curve(
    documents: &mut Documents,
    frames: usize,
    document: &'static str,
    bad: &[f64],
    of: impl Fn(f64) -> Condition,
) -> Curve {
    let known = if document == "spot-lobe" { lamp } else { nothing };
    let point = |&value: &f64| {
        let task = Task { condition: of(value), document, known };
        (value, measure(&task, documents.get(document), frames))
    };
    Curve { document, points: bad.iter().map(point).collect() }
}

/// Saturation from none to nine tenths of the spot.
pub fn saturation(documents: &mut Documents, frames: usize) -> Curve {
    let of = |saturated| Condition { saturated, ..condition("S0") };
    curve(documents, frames, "spot-plane", &SATURATED, of)
}

/// A lobe of growing height, by each candidate document.
pub fn glare(documents: &mut Documents, frames: usize) -> Vec<Curve> {
    let of = |height| match condition("glareLobe") {
        Condition { glare: Glare::Lobe { centre, width, .. }, .. } if height > 0.0 => {
            Condition { glare: Glare::Lobe { height, centre, width }, ..condition("glareLobe") }
        }
        other => Condition { glare: Glare::None, ..other },
    };
    let skip = |document: &str| usize::from(document == "spot-lobe"); // without a lobe there is nothing to fit
    ["spot-plane", "spot-quadratic", "spot-lobe"]
        .map(|document| curve(documents, frames, document, &LOBES[skip(document)..], of))
        .into()
}

/// Occlusion by a dark half plane of growing share.
pub fn occlusion(documents: &mut Documents, frames: usize) -> Curve {
    let of = |occluded| Condition { occluded, ..condition("S10") };
    curve(documents, frames, "spot-plane", &HIDDEN, of)
}

/// RMSE/CRLB, or NaN if more than half of the frames failed.
fn ratio(summary: &Summary, bound_px: f64) -> f64 {
    if summary.failed > 0.5 { f64::NAN } else { summary.rmse_px / bound_px }
}

fn series(name: &str, colour: usize, style: Style, points: Vec<[f64; 2]>) -> Series {
    Series { name: name.to_string(), colour: COLOURS[colour], style, points }
}

/// RMSE/CRLB on a logarithmic axis.
fn ratios() -> Axis {
    Axis::logarithmic("RMSE/CRLB of the centre", [0.8, 200.0], &[1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
}

/// The figure of saturation.
pub fn saturation_figure(curve: &Curve) -> String {
    let along = |f: &dyn Fn(&Measured) -> f64| curve.points.iter().map(|(x, m)| [100.0 * x, f(m)]).collect::<Vec<_>>();
    let x = Axis::linear("% of the spot's area saturated", [0.0, 90.0], &[0.0, 10.0, 30.0, 45.0, 60.0, 75.0, 90.0]);
    let peers = vec![[0.0, 1.25], [10.0, 1.32], [30.0, 1.09], [60.0, 1.3]];
    let centre = Panel {
        title: "Centre".to_string(),
        x: x.clone(),
        y: Axis::linear("RMSE/CRLB", [0.9, 1.5], &[0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5]),
        series: vec![
            series("isophote, tracking", 0, Style::Line, along(&|m| ratio(&m.tracking, m.bound_px))),
            series("isophote, cold", 2, Style::Dots, along(&|m| ratio(&m.cold, m.bound_px))),
            series("best peer", 1, Style::Dots, peers),
        ],
        ..Panel::default()
    };
    let ignored = |pick: fn(&(f64, f64, f64)) -> f64| IGNORED.iter().map(|row| [row.0, pick(row)]).collect::<Vec<_>>();
    let information = Panel {
        title: "Size and brightness: mean error, %".to_string(),
        x,
        y: Axis::linear("%", [-80.0, 40.0], &[-80.0, -60.0, -40.0, -20.0, 0.0, 20.0, 40.0]),
        series: vec![
            series("semi-axis", 0, Style::Line, along(&|m| 100.0 * m.tracking.size.mean)),
            series("brightness", 3, Style::Line, along(&|m| 100.0 * m.tracking.brightness.mean)),
            series("semi-axis, all pixels fitted", 1, Style::Line, ignored(|row| row.1)),
            series("brightness, all pixels fitted", 4, Style::Line, ignored(|row| row.2)),
        ],
        ..Panel::default()
    };
    svg("Error against saturation", &[centre, information])
}

/// The figure of glare.
pub fn glare_figure(curves: &[Curve]) -> String {
    let x = Axis::linear("height of the lobe, DN", [0.0, 200.0], &LOBES);
    let each = |f: fn(&Measured) -> f64| -> Vec<Series> {
        let one = |(i, curve): (usize, &Curve)| {
            let points = curve.points.iter().map(|(x, m)| [*x, f(m)]).collect();
            series(curve.document, [1, 2, 0][i], Style::Line, points)
        };
        curves.iter().enumerate().map(one).collect()
    };
    let mut centre = each(|m| ratio(&m.tracking, m.bound_px));
    centre.push(series("best peer", 4, Style::Dots, vec![[140.0, 33.0]]));
    let panels = [
        Panel { title: "Centre, tracking".to_string(), x: x.clone(), y: ratios(), series: centre, ..Panel::default() },
        Panel {
            title: "Brightness: mean error, %".to_string(),
            x,
            y: Axis::linear("%", [-2.0, 2.0], &[-2.0, -1.0, 0.0, 1.0, 2.0]),
            series: each(|m| 100.0 * m.tracking.brightness.mean),
            ..Panel::default()
        },
    ];
    svg("Error against a lobe of glare", &panels)
}

/// The figure of occlusion.
pub fn occlusion_figure(curve: &Curve) -> String {
    let along = |f: &dyn Fn(&Measured) -> f64| curve.points.iter().map(|(x, m)| [100.0 * x, f(m)]).collect::<Vec<_>>();
    let x = Axis::linear("% of the spot's area hidden", [0.0, 50.0], &[0.0, 10.0, 20.0, 25.0, 35.0, 50.0]);
    let panels = [
        Panel {
            title: "Centre".to_string(),
            x: x.clone(),
            y: ratios(),
            series: vec![
                series("tracking", 0, Style::Line, along(&|m| ratio(&m.tracking, m.bound_px))),
                series("cold", 2, Style::Line, along(&|m| ratio(&m.cold, m.bound_px))),
                series("best peer", 1, Style::Dots, vec![[25.0, 49.0]]),
            ],
            ..Panel::default()
        },
        Panel {
            title: "Failures, %".to_string(),
            x,
            y: Axis::linear("% of the frames", [0.0, 100.0], &[0.0, 20.0, 40.0, 60.0, 80.0, 100.0]),
            series: vec![
                series("tracking", 0, Style::Line, along(&|m| 100.0 * m.tracking.failed)),
                series("cold", 2, Style::Line, along(&|m| 100.0 * m.cold.failed)),
            ],
            ..Panel::default()
        },
    ];
    svg("Error against occlusion", &panels)
}

/// A table of curves.
pub fn table(what: &str, curves: &[&Curve]) -> String {
    let mut text = format!(
        "| {what} | document | CRLB, px | cold: RMSE/CRLB, failed | tracking: RMSE/CRLB, failed | semi-axis, % | brightness, % |\n\
         |---|---|---|---|---|---|---|\n"
    );
    for curve in curves {
        for (value, m) in &curve.points {
            let cell = |summary: &Summary| match ratio(summary, m.bound_px) {
                ratio if ratio.is_finite() => format!("{ratio:.2}, {:.1} %", 100.0 * summary.failed),
                _ => format!("–, {:.1} %", 100.0 * summary.failed),
            };
            writeln!(
                text,
                "| {value} | {} | {:.4} | {} | {} | {:+.3} | {:+.3} |",
                curve.document,
                m.bound_px,
                cell(&m.cold),
                cell(&m.tracking),
                100.0 * m.tracking.size.mean,
                100.0 * m.tracking.brightness.mean
            )
            .unwrap();
        }
    }
    text
}
