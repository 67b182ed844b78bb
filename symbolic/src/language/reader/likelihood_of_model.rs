//! `[model]`: saturated pixels, outliers, the sampling of a pixel, and the deviation of the profile.

use crate::language::document::{Entry, Item, Key};
use crate::language::reader::faults::{Faults, get};
use crate::model::{Loss, Model, Quadrature, Saturated};
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::limits::LIMITS;

/// `saturated`, `loss`, `quadrature` and `deviation`.
#[derive(Default)]
pub(crate) struct Likelihood {
    pub saturated: Saturated,
    pub loss: Loss,
    pub quadrature: Quadrature,
    pub deviation: Option<f64>,
}

/// `None` when a key is invalid.
pub(crate) fn read_likelihood(faults: &mut Faults, model: &[(Key, Entry)], coordinates: usize) -> Option<Likelihood> {
    let saturated = get(model, "saturated").map_or(Some(Saturated::Dropped), |entry| read_saturated(faults, entry));
    let loss = get(model, "loss").map_or(Some(Loss::Squares), |entry| read_loss(faults, entry));
    let quadrature = get(model, "quadrature");
    let quadrature =
        quadrature.map_or(Some(Quadrature::default()), |entry| read_quadrature(faults, entry, coordinates));
    let deviation = get(model, "deviation").map_or(Some(None), |entry| read_deviation(faults, entry).map(Some));
    Some(Likelihood { saturated: saturated?, loss: loss?, quadrature: quadrature?, deviation: deviation? })
}

fn read_deviation(faults: &mut Faults, entry: &Entry) -> Option<f64> {
    let deviation = faults.number("model.deviation", entry)?;
    if Model::DEVIATION.contains(&deviation) {
        return Some(deviation);
    }
    let help = "a share of the target's height, from 0.001 to 0.2: `isophote calibrate model` measures it";
    faults.tell("bad-range", "model.deviation", entry.span, format!("a deviation of {deviation}"), help);
    None
}

fn read_saturated(faults: &mut Faults, entry: &Entry) -> Option<Saturated> {
    let text = faults.text("model.saturated", entry)?;
    match &*text.value {
        "dropped" => Some(Saturated::Dropped),
        "predicted" => Some(Saturated::Predicted),
        "censored" => Some(Saturated::Censored),
        other => {
            let message = format!("{} is not a way to treat saturated pixels", quoted(other));
            let help = "write \"dropped\" (they are left out), \"predicted\" (those predicted to be at the limit are) or \"censored\" (they say \"at least that\")";
            faults.tell("unknown-name", "model.saturated", entry.span, message, help);
            None
        }
    }
}

/// Allowed constants of a loss; beyond these it is least squares, or ignores all residuals.
const DEVIATIONS: std::ops::RangeInclusive<f64> = 0.1..=100.0;

/// `least-squares`, `huber(c)`, `tukey(c)`.
fn read_loss(faults: &mut Faults, entry: &Entry) -> Option<Loss> {
    const NAMES: [&str; 3] = ["least-squares", "huber", "tukey"];
    let text = faults.text("model.loss", entry)?.value.trim().to_string();
    if text == NAMES[0] {
        return Some(Loss::Squares);
    }
    let (name, rest) = text.split_once('(').map_or((text.as_str(), None), |(name, rest)| (name.trim(), Some(rest)));
    if !NAMES[1..].contains(&name) {
        let message = format!("{} is not a robust loss", quoted(name));
        let help = match faults.nearest(name, NAMES) {
            Some(near) => format!("did you mean `{near}`?"),
            None => "write \"tukey(5)\", \"huber(1.345)\", or remove the key for least squares".into(),
        };
        faults.tell("unknown-name", "model.loss", entry.span, message, help);
        return None;
    }
    let number = rest.and_then(|rest| rest.strip_suffix(')')).and_then(|text| text.trim().parse::<f64>().ok());
    match number {
        Some(c) if DEVIATIONS.contains(&c) => Some(if name == "huber" { Loss::Huber(c) } else { Loss::Tukey(c) }),
        _ => {
            let message = format!("{} takes one number between 0.1 and 100", quoted(name));
            let help = format!("how many standard deviations a residual may have: \"{name}(5)\"");
            faults.tell("bad-range", "model.loss", entry.span, message, help);
            None
        }
    }
}

fn read_quadrature(faults: &mut Faults, entry: &Entry, coordinates: usize) -> Option<Quadrature> {
    let key = "model.quadrature";
    let points = match &entry.item {
        Item::Integer(points) => *points,
        Item::Text(text) if &*text.value == "auto" => return Some(Quadrature::Auto),
        Item::Text(text) => {
            let message = format!("{} is not a number of Gauss points", quoted(&text.value));
            let help = "write \"auto\" (chosen for each fit), or how many Gauss points a pixel is sampled at a side";
            faults.tell("unknown-name", key, entry.span, message, help);
            return None;
        }
        _ => {
            faults.wrong_type(key, entry, "a whole number or \"auto\"");
            return None;
        }
    };
    let most = LIMITS.gauss_points;
    let fits = |points: i64| {
        let points = usize::try_from(points).ok().filter(|n| (1..=most).contains(n))?;
        let all = points.checked_pow(coordinates as u32)?;
        (all <= most * most).then_some(points)
    };
    let found = fits(points);
    if found.is_none() {
        let message = format!("{points} Gauss points a side");
        let help = format!("a pixel is sampled at 1 to {most} points a side, and at {} in all at most", most * most);
        faults.tell("bad-range", key, entry.span, message, help);
    }
    found.map(Quadrature::Points)
}
