//! `[[stages]]`: the schedule.

use crate::language::document::{Entry, Item, Key};
use crate::language::reader::faults::{Faults, get, parameters_named};
use crate::model::{Method, Parameter, Stage};
use crate::program::ParameterId;
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::limits::LIMITS;

/// Without the list, one stage of all parameters.
pub(crate) fn read_stages(faults: &mut Faults, top: &[(Key, Entry)], parameters: &[Parameter]) -> Vec<Stage> {
    let every = (0..parameters.len() as u32).map(ParameterId).collect();
    let whole = Stage { parameters: every, method: Method::LevenbergMarquardt, iterations: 50, tolerance: 1e-3 };
    let Some(entry) = get(top, "stages") else { return vec![whole] };
    let Some(list) = faults.list("stages", entry, "a list of tables") else { return Vec::new() };
    if list.is_empty() || list.len() > LIMITS.stages {
        let message = format!("a model has 1 to {} stages, this one {}", LIMITS.stages, list.len());
        faults.tell(
            if list.is_empty() { "bad-range" } else { "limit" },
            "stages",
            entry.span,
            message,
            "leave `stages` out for one stage of all parameters",
        );
    }
    let mut stages = Vec::new();
    for (i, item) in list.iter().enumerate().take(LIMITS.stages) {
        let path = format!("stages[{i}]");
        let Some(fields) = faults.table(&path, item) else { continue };
        faults.known(&path, fields, &["parameters", "method", "iterations", "tolerance"]);
        let key = format!("{path}.parameters");
        let before = faults.count();
        let mut free = Vec::new();
        if let Some(list) = get(fields, "parameters") {
            free = parameters_named(faults, &key, list, parameters);
            if free.is_empty() && !faults.is_partial() && faults.count() == before {
                let message = "a stage frees at least one parameter";
                faults.tell("bad-range", &key, list.span, message, "name one, or remove the stage");
            }
        } else {
            faults.tell(
                "missing-key",
                &key,
                item.span,
                "a stage names its free parameters",
                "add `parameters = [\"bx\", \"by\"]`",
            );
        }
        let method =
            get(fields, "method").map_or(Some(Method::Newton), |e| read_method(faults, &format!("{path}.method"), e));
        let iterations =
            get(fields, "iterations").map_or(Some(50), |e| read_iterations(faults, &format!("{path}.iterations"), e));
        let tolerance = get(fields, "tolerance").map_or(Some(1e-3), |e| {
            let key = format!("{path}.tolerance");
            let value = faults.number(&key, e)?;
            if value <= 0.0 {
                faults.tell(
                    "bad-range",
                    &key,
                    e.span,
                    format!("the tolerance {value} is not positive"),
                    "1e-3 ends a stage at a thousandth of a standard deviation",
                );
            }
            Some(value)
        });
        if let (Some(method), Some(iterations), Some(tolerance)) = (method, iterations, tolerance) {
            stages.push(Stage { parameters: free, method, iterations, tolerance });
        }
    }
    stages
}

fn read_method(faults: &mut Faults, key: &str, entry: &Entry) -> Option<Method> {
    let text = faults.text(key, entry)?;
    let methods = [Method::Newton, Method::GaussNewton, Method::LevenbergMarquardt];
    let found = methods.into_iter().find(|m| m.name() == &*text.value);
    if found.is_none() {
        let help = match faults.nearest(&text.value, methods.map(Method::name)) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => "newton, gauss-newton or levenberg-marquardt".to_string(),
        };
        faults.tell("unknown-name", key, entry.span, format!("{} is not a method", quoted(&text.value)), help);
    }
    found
}

fn read_iterations(faults: &mut Faults, key: &str, entry: &Entry) -> Option<u32> {
    match entry.item {
        Item::Integer(value) if (1..=i64::from(LIMITS.iterations)).contains(&value) => Some(value as u32),
        Item::Integer(value) => {
            faults.tell(
                "bad-range",
                key,
                entry.span,
                format!("{value} iterations"),
                format!("a stage has 1 to {} iterations", LIMITS.iterations),
            );
            None
        }
        _ => {
            faults.wrong_type(key, entry, "a whole number");
            None
        }
    }
}
