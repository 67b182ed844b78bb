//! The basin of convergence: starts from which a fit finds the spot.
//!
//! The start is round, offset in a random direction, and as bright as the brightest pixel over the background.
//! Success: the centre within 0.1 px and the longer semi-axis within 5 %.

use std::fmt::Write;

use super::condition::{Condition, Task, condition, nothing};
use super::document::Document;
use super::light::shape;
use super::run::{each, shot};
use super::scene::Scene;
use super::sensor::{FULL, Random};
use super::trial::ask;
use crate::plot::panel::{Axis, Cell, Panel, svg};

/// Start radii, px.
const RADII: [f64; 4] = [10.0, 17.0, 34.0, 68.0];
/// Offsets of the start, px.
const OFFSETS: [f64; 4] = [0.0, 5.0, 10.0, 20.0];
/// Conditions of light.
const LIGHTS: [&str; 3] = ["S0", "S30", "S60"];

/// Success rates for one light, by radius and offset.
pub struct Basin {
    /// The condition's name.
    pub light: &'static str,
    /// Rows are radii.
    pub found: [[f64; 4]; 4],
}

/// All lights, with that many frames per cell.
pub fn measure(document: &Document, frames: usize) -> Vec<Basin> {
    LIGHTS
        .map(|light| Basin { light, found: RADII.map(|r| OFFSETS.map(|o| found(document, light, [r, o], frames))) })
        .into()
}

fn found(document: &Document, light: &'static str, [radius, offset]: [f64; 2], frames: usize) -> f64 {
    let task = Task { condition: condition(light), document: "spot-plane", known: nothing };
    let hits = each(frames, |number| {
        let (scene, image, camera, mut random) = shot(&task, number);
        let outcome = ask(document, (&image, camera), &scene, &start(&scene, [radius, offset], &mut random));
        outcome.trial.is_some_and(|trial| trial.error[0].hypot(trial.error[1]) < 0.1 && trial.size.abs() < 0.05)
    });
    hits.iter().filter(|hit| **hit).count() as f64 / frames as f64
}

fn start(scene: &Scene, [radius, offset]: [f64; 2], random: &mut Random) -> Vec<(&'static str, f64)> {
    let (sine, cosine) = random.uniform(0.0, std::f64::consts::TAU).sin_cos();
    let Condition { background, .. } = scene.condition;
    let [a1, a2, a3] = shape([radius, radius], 0.0);
    let v1 = scene.brightness.min(FULL - background);
    let [bx, by] = [scene.centre[0] + offset * cosine, scene.centre[1] + offset * sine];
    vec![("bx", bx), ("by", by), ("a1", a1), ("a2", a2), ("a3", a3), ("v0", background), ("v1", v1)]
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

/// The table.
pub fn table(basins: &[Basin]) -> String {
    let mut text = String::from("| light | start radius, px |");
    OFFSETS.iter().for_each(|offset| write!(text, " {offset} px off |").unwrap());
    text += "\n|---|---|---|---|---|---|\n";
    for basin in basins {
        for (radius, row) in RADII.iter().zip(basin.found) {
            let cells: Vec<String> = row.iter().map(|share| percent(*share)).collect();
            writeln!(text, "| {} | {radius} | {} |", basin.light, cells.join(" | ")).unwrap();
        }
    }
    text
}

/// The figure.
pub fn figure(basins: &[Basin]) -> String {
    let axis = |name: &str, values: [f64; 4]| {
        let ticks = values.iter().enumerate().map(|(i, value)| (i as f64, value.to_string())).collect();
        Axis { name: name.to_string(), range: [-0.5, 3.5], ticks, logarithmic: false }
    };
    let panel = |basin: &Basin| {
        let place = |i: usize| [(i % 4) as f64, (i / 4) as f64];
        let cell = |i: usize| {
            let share = basin.found[i / 4][i % 4];
            Cell { place: place(i), shade: share, text: percent(share) }
        };
        Panel {
            title: format!("{}: found from a start", basin.light),
            x: axis("px off", OFFSETS),
            y: axis("start radius, px (the spot: 20 × 14)", RADII),
            cells: (0..16).map(cell).collect(),
            ..Panel::default()
        }
    };
    svg("Basin of convergence", &basins.iter().map(panel).collect::<Vec<Panel>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::condition::CONDITIONS;

    #[test]
    fn lights_are_conditions() {
        assert!(LIGHTS.iter().all(|light| CONDITIONS.iter().any(|condition| condition.name == *light)));
    }
}
