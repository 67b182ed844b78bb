//! `[model]`: its formulas, and the slots that this build refuses.

use crate::diagnostic::{Span, quoted};
use crate::document::{Entry, Item, Key};
use crate::formulas::FormulaReader;
use crate::model::Formulas;
use crate::program::ChannelId;
use crate::reader::faults::{Faults, get};

/// The table `[model]`: its formulas, and the slots that this build refuses.
pub(crate) fn read_model(
    mut reader: FormulaReader<'_, '_>,
    model: &[(Key, Entry)],
    at: Span,
    channels: &[String],
) -> Option<Formulas> {
    refuse(reader.faults, model);
    let intensity = match get(model, "intensity") {
        Some(entry) => reader.number("model.intensity", entry),
        None => {
            reader.faults.tell(
                "missing-key",
                "model.intensity",
                at,
                "the key `intensity` is missing",
                "write what a pixel's value is predicted to be",
            );
            None
        }
    };
    let observed = match get(model, "observed") {
        Some(entry) => reader.number("model.observed", entry),
        None if channels.len() > 1 => {
            let message =
                format!("with {} channels the key `observed` says which formula over them is fitted", channels.len());
            reader.faults.tell(
                "missing-key",
                "model.observed",
                at,
                message,
                format!("add `observed = \"{}\"`", channels[0]),
            );
            None
        }
        None => Some(reader.graph.channel(ChannelId(0))),
    };
    let domain = get(model, "domain").map(|e| reader.truth("model.domain", e));
    reader.name_intensity(intensity);
    let noise = get(model, "noise").map(|e| reader.number("model.noise", e));
    let mut constraints = Vec::new();
    if let Some(entry) = get(model, "constraint") {
        let single = std::slice::from_ref(entry);
        let list = if let Item::List(list) = &entry.item { list.as_slice() } else { single };
        for (i, item) in list.iter().enumerate() {
            constraints.push(reader.truth(&format!("model.constraint[{i}]"), item));
        }
    }
    reader.check_levels(model, intensity, observed, domain.flatten(), &constraints);
    // A fault inside any formula is already told; the model stands only when all are whole.
    let whole = (domain.is_none() || domain.flatten().is_some()) && (noise.is_none() || noise.flatten().is_some());
    let constraints = constraints.into_iter().collect::<Option<Vec<_>>>()?;
    match (intensity, observed, whole) {
        (Some(intensity), Some(observed), true) => {
            let mut graph = reader.graph;
            graph.set_span(graph.span(intensity)); // what has no formula of its own, such as the residual, comes from it
            Some(Formulas { graph, observed, intensity, domain: domain.flatten(), noise: noise.flatten(), constraints })
        }
        _ => None,
    }
}

/// Slots of the document that a later build fills.
fn refuse(faults: &mut Faults, model: &[(Key, Entry)]) {
    let later = "this build fits (weighted) least squares at pixel centres; remove the key";
    if let Some(entry) = get(model, "saturated")
        && let Some(text) = faults.text("model.saturated", entry)
        && &*text.value != "dropped"
    {
        let (code, message) = match &*text.value {
            "censored" => ("unsupported", "censored pixels are not supported yet".to_string()),
            other => ("unknown-name", format!("{} is not a way to treat saturated pixels", quoted(other))),
        };
        faults.tell(code, "model.saturated", entry.span, message, "write \"dropped\", or remove the key");
    }
    if let Some(entry) = get(model, "loss")
        && faults.text("model.loss", entry).is_some()
    {
        faults.tell("unsupported", "model.loss", entry.span, "robust losses are not supported yet", later);
    }
    if let Some(entry) = get(model, "quadrature") {
        match entry.item {
            Item::Integer(1) => {}
            Item::Integer(n) if n > 1 => {
                faults.tell("unsupported", "model.quadrature", entry.span, "quadrature is not supported yet", later)
            }
            Item::Integer(_) => {
                faults.tell("bad-range", "model.quadrature", entry.span, "quadrature counts points: 1 or more", later)
            }
            _ => faults.wrong_type("model.quadrature", entry, "a whole number"),
        }
    }
}
