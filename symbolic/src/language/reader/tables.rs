//! `[tables]`: measured profiles.

use std::collections::BTreeMap;

use isophote_elementary::{Axis, Table, Tables};

use crate::language::document::{Entry, Item, Key};
use crate::language::elaborate::Binding;
use crate::language::reader::faults::{Faults, get};
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::limits::LIMITS;

/// Reads the tables and binds them to their names in quotes.
pub(super) fn read_tables(
    faults: &mut Faults,
    top: &[(Key, Entry)],
    bindings: &mut BTreeMap<String, Binding>,
) -> Tables {
    let Some(list) = get(top, "tables").and_then(|entry| faults.table("tables", entry)) else {
        return Tables::default();
    };
    let (mut tables, mut left) = (Vec::new(), LIMITS.samples);
    for (i, (key, entry)) in list.iter().enumerate() {
        if i == LIMITS.tables {
            let message = format!("a model has at most {} tables, this one {}", LIMITS.tables, list.len());
            faults.tell("limit", "tables", key.span, message, "merge some");
        }
        let table = read_table(faults, key, entry, &mut left);
        let binding = table.as_ref().map_or(Binding::Poisoned, |_| Binding::Table(tables.len() as u16));
        bindings.insert(format!("\"{}\"", key.name), binding);
        tables.extend(table);
    }
    Tables::of(tables)
}

fn read_table(faults: &mut Faults, key: &Key, entry: &Entry, left: &mut usize) -> Option<Table> {
    let path = format!("tables.{}", key.name);
    let fields = faults.table(&path, entry)?;
    faults.known(&path, fields, &["first", "step", "values", "file"]);
    let Some(values) = get(fields, "values") else {
        let message = match get(fields, "file").map(|file| &file.item) {
            Some(Item::Text(file)) => format!("the samples of {} are not in the document", quoted(&file.value)),
            _ => "the key `values` is missing".into(),
        };
        let help =
            "no file is opened here: `isophote` puts the samples of `file` into the document before it hands it on";
        faults.tell("missing-key", &format!("{path}.values"), key.span, message, help);
        return None;
    };
    let at = format!("{path}.values");
    let list = faults.list(&at, values, "a list of samples, or a list of such rows")?;
    let rows: Vec<&[Entry]> = match list.first().map(|first| &first.item) {
        Some(Item::List(_)) => {
            list.iter().map(|row| faults.list(&at, row, "a row of samples")).collect::<Option<_>>()?
        }
        _ => vec![list],
    };
    let is_flat = matches!(list.first().map(|first| &first.item), Some(Item::List(_)));
    let (width, height) = (rows[0].len(), rows.len());
    let Some(rest) = left.checked_sub(rows.iter().map(|row| row.len()).sum()) else {
        let message = format!("the tables of a document have at most {} samples", LIMITS.samples);
        faults.tell("limit", &at, values.span, message, "take every second one");
        return None;
    };
    *left = rest;
    if width < Axis::COUNT_MIN || is_flat && height < Axis::COUNT_MIN || rows.iter().any(|row| row.len() != width) {
        let message = format!("a table has at least {} samples along each axis, all rows as many", Axis::COUNT_MIN);
        faults.tell("shape", &at, values.span, message, "the spline through them is of third order");
        return None;
    }
    let samples =
        rows.iter().flat_map(|row| row.iter()).map(|e| faults.number(&at, e)).collect::<Option<Vec<f64>>>()?;
    let mut pair = |name: &str| {
        let at = format!("{path}.{name}");
        let Some(entry) = get(fields, name) else {
            let message = format!("the key `{name}` is missing");
            faults.tell("missing-key", &at, key.span, message, "say where the samples are: `first = -5.0, step = 0.1`");
            return None;
        };
        let both = match (&entry.item, is_flat) {
            (Item::List(both), true) if both.len() == 2 => both.as_slice(),
            _ => std::slice::from_ref(entry),
        };
        let numbers = both.iter().map(|e| faults.number(&at, e)).collect::<Option<Vec<f64>>>()?;
        if name == "step" && numbers.iter().any(|step| *step <= 0.0) {
            faults.tell("bad-range", &at, entry.span, "a step is above 0", "turn the samples round");
            return None;
        }
        Some([numbers[0], numbers[numbers.len() - 1]])
    };
    let (first, step) = (pair("first"), pair("step"));
    let (first, step) = (first?, step?);
    // Lookups divide by the step.
    if first.iter().zip(step).any(|(first, step)| !(1.0 / step).is_finite() || !(first / step).is_finite()) {
        let span = get(fields, "step").map_or(key.span, |entry| entry.span);
        let message = "so small a step makes places in the table larger than numbers can be";
        faults.tell("bad-number", &format!("{path}.step"), span, message, "give the places in another unit");
        return None;
    }
    let axis = |i: usize, count: usize| Axis { first: first[i], step: step[i], count };
    let axes = [axis(0, width), axis(1, height)];
    let table = Table::through(if is_flat { &axes } else { &axes[..1] }, &samples);
    if table.is_none() {
        let message = "the spline through these samples is not finite";
        faults.tell("bad-number", &at, values.span, message, "make them smaller, and multiply in the formula");
    }
    table
}
