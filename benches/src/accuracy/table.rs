//! The tables of docs/accuracy.md.

use std::fmt::Write;

use super::condition::Row;
use super::peers;
use super::run::Measured;
use super::summary::{Spread, Summary};

/// Head of the table of all rows, also printed.
pub const HEAD: &str = "| condition | document | CRLB, px | cold: RMSE/CRLB | tracking | to reach | best peer |\n|---|---|---|---|---|---|---|";

/// Formats a ratio.
fn ratio(value: f64) -> String {
    if value.is_finite() { format!("{value:.*}", if value < 10.0 { 2 } else { 1 }) } else { "–".to_string() }
}

fn share(value: f64) -> String {
    format!("{:.*} %", if value > 0.0 && value < 0.01 { 2 } else { 1 }, 100.0 * value)
}

/// A ratio with the share of failures, in bold if the goal is missed.
fn reached(summary: &Summary, bound_px: f64, goal: Option<f64>) -> String {
    let value = summary.rmse_px / bound_px;
    let missed = goal.is_some_and(|goal| value.is_nan() || value > goal);
    let text = if missed { format!("**{}**", ratio(value)) } else { ratio(value) };
    match summary.failed > 0.0 {
        true => format!("{text}, {} failed", share(summary.failed)),
        false => text,
    }
}

/// One line of the first table.
pub fn centre_line(row: &Row, measured: &Measured) -> String {
    let goal = |goal: Option<f64>| goal.map_or("an answer".to_string(), |goal| format!("{goal:.2}"));
    let goals = match row.goal {
        [cold, tracking] if cold == tracking => goal(cold),
        [cold, tracking] => format!("{} / {}", goal(cold), goal(tracking)),
    };
    format!(
        "| {} | {} | {:.4} | {} | {} | {goals} | {} |",
        row.condition,
        row.document,
        measured.bound_px,
        reached(&measured.cold, measured.bound_px, row.goal[0]),
        reached(&measured.tracking, measured.bound_px, row.goal[1]),
        peers::best(row.condition)
    )
}

fn percent(spread: &Spread) -> String {
    format!("{:+.3} ± {:.3}, {:.2}", 100.0 * spread.mean, 100.0 * spread.error(), 100.0 * spread.deviation)
}

/// Size, brightness, covariance and time, from the tracking start.
pub fn frame_worth(all: &[&Measured]) -> String {
    let mut table = String::from(
        "| condition | document | semi-axis: bias, sd, % | brightness: bias, sd, % | NEES of the centre | χ²/ν | cold, µs | tracking, µs |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for measured in all {
        let t = &measured.tracking;
        writeln!(
            table,
            "| {} | {} | {} | {} | {:.2} ± {:.2} | {:.3} | {:.0} | {:.0} |",
            measured.task.condition.name,
            measured.task.document,
            percent(&t.size),
            percent(&t.brightness),
            t.nees.mean,
            t.nees.error(),
            t.reduced,
            measured.cold.time_us,
            t.time_us
        )
        .unwrap();
    }
    table
}
