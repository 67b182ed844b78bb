//! Inserts samples of measured profiles from files into a document.
//!
//! A table may name a file (`[tables.psf]` with `file = "psf.csv"`), or a formula may read one without a table
//! (`table("psf.csv", s)`). New tables are appended, so that all other lines keep their numbers.

use std::ops::Range;
use std::path::Path;

use isophote_capture::{FrameSource, Recording, read_regular};
use isophote_symbolic::LIMITS;
use serde_json::{Value, json};
use toml::de::{DeTable, DeValue};

use crate::failure::Failure;

/// Maximum size of a file of samples.
const FILE_BYTES_MAX: u64 = 16 << 20;

/// Samples of a file, and their positions if the file has them.
#[derive(Debug, PartialEq)]
struct Samples {
    first: Value,
    step: Value,
    values: Value,
}

/// A table that refers to a file, with the positions given by the document.
struct Wanted {
    name: String,
    file: String,
    first: Option<Value>,
    step: Option<Value>,
}

/// Syntax of a document.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DocumentSyntax {
    Toml,
    Json,
}

/// Inserts the samples of all files. Faults of the document itself are left to its parser.
pub fn put_in(text: &str, syntax: DocumentSyntax, folder: &Path) -> Result<String, Failure> {
    let is_json = syntax == DocumentSyntax::Json;
    let found = if is_json { Ok(of_json(text)) } else { of_toml(text) };
    let (mut kept, mut wanted, declared) = found.map_err(|reason| Failure::Model(format!("error: {reason}")))?;
    for name in read_by_formulas(text).into_iter().filter(|name| !declared.contains(name)) {
        if folder.join(&name).is_file() && wanted.iter().all(|other| other.name != name) {
            wanted.push(Wanted { file: name.clone(), name, first: None, step: None });
        }
    }
    for table in wanted {
        let samples = read(&folder.join(&table.file))?;
        let (first, step) = (table.first.unwrap_or(samples.first), table.step.unwrap_or(samples.step));
        if is_json {
            let entry = json!({"first": first, "step": step, "values": samples.values});
            kept = json_with(&kept, &table.name, &entry);
        } else {
            let name = Value::from(table.name);
            kept += &format!("\n[tables.{name}]\nfirst = {first}\nstep = {step}\nvalues = {}\n", samples.values);
        }
    }
    Ok(kept)
}

/// The files that formulas name in `table(…)`.
fn read_by_formulas(text: &str) -> Vec<String> {
    let calls = text.match_indices("table").filter_map(|(at, word)| {
        let rest = text[at + word.len()..].trim_start().strip_prefix('(')?.trim_start();
        let rest = rest.strip_prefix("\\\"").or_else(|| rest.strip_prefix('"'))?;
        rest.find(['"', '\\', '\n']).map(|end| rest[..end].to_string())
    });
    calls.filter(|name| !name.is_empty()).collect()
}

/// The document without the tables that refer to files, those tables, and the names of all others. Fails on a table
/// that cannot be cut out on its own, or that has invalid values.
fn of_toml(text: &str) -> Result<(String, Vec<Wanted>, Vec<String>), String> {
    let (mut kept, mut wanted, mut declared) = (text.to_string(), Vec::new(), Vec::new());
    let Ok(document) = DeTable::parse(text) else { return Ok((kept, wanted, declared)) };
    let tables = document.get_ref().iter().find(|(key, _)| key.get_ref() == "tables");
    let Some((_, all)) = tables else { return Ok((kept, wanted, declared)) };
    let DeValue::Table(tables) = all.get_ref() else { return Ok((kept, wanted, declared)) };
    let is_in_braces = text[all.span()].starts_with('{');
    for (key, value) in tables {
        let name = key.get_ref().to_string();
        let DeValue::Table(fields) = value.get_ref() else { continue };
        let field = |name: &str| fields.iter().find(|(key, _)| key.get_ref() == name).map(|(_, value)| value);
        let Some(DeValue::String(file)) =
            field("file").map(|file| file.get_ref()).filter(|_| field("values").is_none())
        else {
            declared.push(name);
            continue;
        };
        let number = |field_name: &str| {
            let Some(value) = field(field_name) else { return Ok(None) };
            let wrong = || format!("tables.{name}: `{field_name} = {}` is no finite number", &text[value.span()]);
            number(value.get_ref()).map(Some).ok_or_else(wrong)
        };
        wanted.push(Wanted {
            first: number("first")?,
            step: number("step")?,
            name: name.clone(),
            file: file.to_string(),
        });
        let line = text[..key.span().start].rfind('\n').map_or(0, |at| at + 1);
        let before = text[line..key.span().start].trim_start();
        let is_header = before.starts_with('[');
        let behind = text[key.span().end..].trim_start();
        let is_entry = before.is_empty() && behind.strip_prefix('=').is_some_and(|v| v.trim_start().starts_with('{'));
        if is_in_braces || !(is_header || is_entry) {
            let form = if is_in_braces { "`tables = { … }`" } else { "a dotted key" };
            let quoted = Value::from(name.as_str());
            let header = if name.bytes().all(|b| b.is_ascii_alphanumeric()) { &name } else { &quoted.to_string() };
            return Err(format!(
                "tables.{name}: {form} cannot take the samples of a file; write a table of its own, `[tables.{header}]` with \
                 `file = {}` on the next line",
                Value::from(file.as_ref())
            ));
        }
        let mut left_out = vec![if is_header {
            line..text[line..].find('\n').map_or(text.len(), |at| line + at)
        } else {
            key.span().start..value.span().end
        }];
        if is_header {
            left_out.extend(fields.iter().map(|(key, value)| key.span().start..value.span().end));
        }
        for range in left_out {
            let blank: String = text[range.clone()].bytes().map(|b| if b == b'\n' { '\n' } else { ' ' }).collect();
            kept.replace_range(range, &blank);
        }
    }
    Ok((kept, wanted, declared))
}

/// A number, or a list of them.
fn number(value: &DeValue<'_>) -> Option<Value> {
    match value {
        DeValue::Integer(integer) => i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(Value::from),
        DeValue::Float(float) => float.as_str().parse().ok().filter(|x: &f64| x.is_finite()).map(Value::from),
        DeValue::Array(list) => list.iter().map(|value| number(value.get_ref())).collect(),
        _ => None,
    }
}

/// The same for JSON, where such a table stays until its samples replace it.
fn of_json(text: &str) -> (String, Vec<Wanted>, Vec<String>) {
    let (mut wanted, mut declared) = (Vec::new(), Vec::new());
    let document: Value = serde_json::from_str(text).unwrap_or_default();
    for (name, table) in document["tables"].as_object().into_iter().flatten() {
        let (file, field) = (table["file"].as_str(), |name: &str| table.get(name).cloned());
        let Some(file) = file.filter(|_| table.get("values").is_none()) else {
            declared.push(name.clone());
            continue;
        };
        wanted.push(Wanted { name: name.clone(), file: file.to_string(), first: field("first"), step: field("step") });
    }
    (text.to_string(), wanted, declared)
}

/// Inserts or replaces one table. Edits the text, since a `Value` sorts its keys, and parameters are numbered in
/// document order.
fn json_with(text: &str, name: &str, table: &Value) -> String {
    let put = |range: Range<usize>, new: &str| {
        // Lines that follow keep their numbers.
        let lines = "\n".repeat(text[range.clone()].matches('\n').count());
        format!("{}{new}{lines}{}", &text[..range.start], &text[range.end..])
    };
    let added = |object: Range<usize>, entry: String| {
        let comma = if members(text, object.clone()).is_empty() { "" } else { "," };
        let end = object.start + text[object].trim_end().len() - 1;
        put(end..end, &format!("{comma}{entry}"))
    };
    let named = |object: Range<usize>, name: &str| members(text, object).into_iter().rfind(|(key, _)| key == name);
    let (root, entry) = (0..text.len(), format!("{}:{table}", Value::from(name)));
    match named(root.clone(), "tables") {
        None => added(root, format!("\"tables\":{{{entry}}}")),
        Some((_, tables)) if !text[tables.clone()].starts_with('{') => text.to_string(),
        Some((_, tables)) => match named(tables.clone(), name) {
            Some((_, old)) => put(old, &table.to_string()),
            None => added(tables, entry),
        },
    }
}

/// The keys of a JSON object, and the ranges of their values.
fn members(text: &str, object: Range<usize>) -> Vec<(String, Range<usize>)> {
    let Some(open) = text[object.clone()].find('{').map(|at| object.start + at) else { return Vec::new() };
    let (mut pieces, mut start, mut depth) = (Vec::new(), open + 1, 0);
    let (mut is_text, mut is_escaped) = (false, false);
    for (at, byte) in text.bytes().enumerate().take(object.end).skip(open + 1) {
        match byte {
            _ if is_escaped => is_escaped = false,
            b'\\' => is_escaped = true,
            b'"' => is_text = !is_text,
            _ if is_text => {}
            b'{' | b'[' => depth += 1,
            b'}' | b']' if depth > 0 => depth -= 1,
            b',' | b'}' if depth == 0 => {
                pieces.push(start..at);
                start = at + 1;
            }
            _ => {}
        }
    }
    let member = |piece: Range<usize>| {
        let mut keys = serde_json::Deserializer::from_str(&text[piece.clone()]).into_iter::<String>();
        let key = keys.next()?.ok()?;
        let colon = piece.start + keys.byte_offset();
        let value = text[colon..piece.end].trim_start().strip_prefix(':')?.trim_start();
        let first = piece.end - value.len();
        Some((key, first..first + value.trim_end().len()))
    };
    pieces.into_iter().filter_map(member).collect()
}

/// Reads samples from columns of numbers or an image.
fn read(path: &Path) -> Result<Samples, Failure> {
    let wrong = |reason: String| Failure::Other(format!("{}: {reason}", path.display()));
    let is_csv =
        path.extension().is_some_and(|e| ["csv", "txt", "tsv"].iter().any(|known| e.eq_ignore_ascii_case(known)));
    let samples = if is_csv {
        let bytes = read_regular(path, FILE_BYTES_MAX).map_err(|error| wrong(format!("cannot be read: {error}")))?;
        let text = String::from_utf8(bytes).map_err(|_| wrong("not UTF-8 text".into()))?;
        of_columns(&text).map_err(wrong)?
    } else {
        of_image(path)?
    };
    let count: usize =
        samples.values.as_array().into_iter().flatten().map(|row| row.as_array().map_or(1, Vec::len)).sum();
    if count > LIMITS.samples {
        return Err(wrong(format!("{count} samples; the tables of a document have at most {}", LIMITS.samples)));
    }
    Ok(samples)
}

/// One column: values; two: positions and values; more: rows of a table over two axes.
fn of_columns(text: &str) -> Result<Samples, String> {
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for (i, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        let cells: Vec<&str> =
            line.split([',', ';', '\t', ' ']).map(str::trim).filter(|cell| !cell.is_empty()).collect();
        let numbers: Option<Vec<f64>> =
            cells.iter().map(|cell| cell.parse().ok().filter(|x: &f64| x.is_finite())).collect();
        match numbers {
            Some(numbers) if numbers.is_empty() => {}
            Some(numbers) if rows.first().is_none_or(|first| first.len() == numbers.len()) => rows.push(numbers),
            Some(numbers) => {
                return Err(format!("line {} has {} numbers, the first {}", i + 1, numbers.len(), rows[0].len()));
            }
            // A heading.
            None if rows.is_empty() => {}
            None => return Err(format!("line {} is not made of finite numbers: `{line}`", i + 1)),
        }
    }
    let column = |i: usize| rows.iter().map(|row| row[i]).collect::<Vec<f64>>();
    match rows.first().map(Vec::len) {
        None => Err("no numbers".into()),
        Some(1) => Ok(Samples { first: 0.into(), step: 1.into(), values: column(0).into() }),
        Some(2) => {
            let places = column(0);
            let step = (places[places.len() - 1] - places[0]) / (places.len() - 1).max(1) as f64;
            let is_even = |(i, s): (usize, &f64)| (s - places[0] - step * i as f64).abs() <= 1e-3 * step;
            if step.is_nan() || step <= 0.0 || !places.iter().enumerate().all(is_even) {
                return Err("the places in the first column are not evenly spaced, from the lowest up".into());
            }
            Ok(Samples { first: places[0].into(), step: step.into(), values: column(1).into() })
        }
        Some(width) => Ok(centred(width, rows.len(), json!(rows))),
    }
}

/// A table over two axes centred at 0.
fn centred(width: usize, height: usize, values: Value) -> Samples {
    let first = [width, height].map(|count| -0.5 * (count as f64 - 1.0));
    Samples { first: json!(first), step: json!([1, 1]), values }
}

fn of_image(path: &Path) -> Result<Samples, Failure> {
    let mut recording = Recording::open(path).map_err(Failure::other)?;
    let frame = recording.next().map_err(Failure::other)?;
    let Some(frame) = frame.map(|captured| captured.frame.luma()) else {
        return Err(Failure::Other(format!("{}: there is no picture in it", path.display())));
    };
    let plane = frame.plane_view(0);
    let row = |y: usize| (0..plane.width()).map(|x| plane.pixel(x, y)).collect::<Vec<f64>>();
    let rows: Vec<Vec<f64>> = (0..plane.height()).map(row).collect();
    Ok(centred(plane.width(), plane.height(), json!(rows)))
}

#[cfg(test)]
#[path = "samples_tests.rs"]
mod tests;
