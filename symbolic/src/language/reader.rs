//! Checks a document's tree and makes a [`Model`] of it, or returns all its faults.

mod faults;
pub(crate) mod formulas_of_model;
mod likelihood_of_model;
mod roles;
mod stages;
mod tables;

use std::collections::BTreeMap;

use sha2::{Digest, Sha256};

use crate::graph::Graph;
use crate::language::document::{Entry, Item, Key, places, read_json, read_toml, to_json};
use crate::language::elaborate::{Binding, Matrix};
use crate::language::formulas::{Definition, FormulaReader};
use crate::model::estimator::Estimator;
use crate::model::{Constant, Model, Parameter, Start};
use crate::program::{ChannelId, ConstantId, CoordinateId, Input, ParameterId};
pub(crate) use faults::Faults;
use faults::get;
use formulas_of_model::read_model;
use isophote_syntax::diagnostic::{Diagnostics, Span, quoted};
use isophote_syntax::limits::LIMITS;
use roles::read_roles;
use stages::read_stages;
use tables::read_tables;

const TOP: [&str; 10] = [
    "name",
    "description",
    "coordinates",
    "channels",
    "parameters",
    "roles",
    "definitions",
    "model",
    "constants",
    "tables",
];
const MODEL: [&str; 9] =
    ["intensity", "observed", "domain", "constraint", "noise", "saturated", "loss", "quadrature", "deviation"];

impl Model {
    /// Reads a TOML document; on failure returns all its faults.
    pub fn from_toml(text: &str) -> Result<Model, Diagnostics> {
        read(text, read_toml(text)?)
    }
    /// Reads a JSON document; on failure returns all its faults.
    pub fn from_json(text: &str) -> Result<Model, Diagnostics> {
        read(text, read_json(text)?)
    }
}

/// Checks a document.
fn read(text: &str, (root, of_syntax): (Entry, Diagnostics)) -> Result<Model, Diagnostics> {
    let mut faults = Faults::after(text, of_syntax);
    let Some(top) = faults.table("", &root).map(<[_]>::to_vec) else { return Err(faults.finish()) };
    let mut keys = TOP.to_vec();
    keys.push("stages");
    faults.known("", &top, &keys);

    let name = required_text(&mut faults, &top, "name", root.span, "give the model a name: `name = \"spot\"`");
    if let Some(text) = get(&top, "name").and_then(|e| if let Item::Text(t) = &e.item { Some(t) } else { None })
        && !is_slug(&text.value)
    {
        let message = format!("{} is not a model's name", quoted(&text.value));
        faults.tell("bad-name", "name", text.span(0, text.value.len()), message, "names match [a-z0-9][a-z0-9-]{0,63}");
    }
    let description = get(&top, "description").and_then(|e| faults.text("description", e)).map(|t| t.value.to_string());
    let mut names = Names::default();
    let coordinates = names.list(&mut faults, &top, "coordinates", root.span, LIMITS.coordinates);
    let channels = names.list(&mut faults, &top, "channels", root.span, LIMITS.channels);
    let parameters = read_parameters(&mut faults, &top, root.span, &mut names, coordinates.len());
    let mut constants = read_constants(&mut faults, &top, &mut names);
    let definitions = read_definitions(&mut faults, &top, &mut names);
    let roles = read_roles(&mut faults, &top, &parameters, coordinates.len());
    let stages = read_stages(&mut faults, &top, &parameters);

    let defects = defects(&top, &mut constants, &names);
    let mut graph = Graph::default();
    let mut bindings = bind(&mut graph, &coordinates, &channels, &parameters, &constants, names.faulty);
    graph.tables = read_tables(&mut faults, &top, &mut bindings);
    let mut reader = FormulaReader::new(graph, bindings, &mut faults);
    // Without one of these every formula would repeat the fault.
    if coordinates.is_empty()
        || channels.is_empty()
        || parameters.is_empty()
        || names.lacking
        || reader.faults.is_partial()
    {
        reader.lacks_names();
    }
    reader.definitions(definitions);
    let formulas = match get(&top, "model") {
        None => {
            faults.tell(
                "missing-key",
                "model",
                root.span,
                "the table [model] is missing",
                "add `[model]` with `intensity = \"…\"`",
            );
            None
        }
        Some(entry) => match &entry.item {
            Item::Table(model) => {
                reader.faults.known("model", model, &MODEL);
                read_model(reader, model, entry.span, &channels, coordinates.len(), defects)
            }
            _ => {
                faults.wrong_type("model", entry, "a table");
                None
            }
        },
    };
    let document = to_json(&root);
    let digest = Sha256::digest(document.to_string().as_bytes());
    let digest = format!("sha256:{}", digest.iter().map(|b| format!("{b:02x}")).collect::<String>());
    match (formulas, faults.is_empty()) {
        (Some(formulas), true) => Ok(Model {
            reading: formulas.graph.budget().work(),
            name: name.unwrap_or_default(),
            description: description.unwrap_or_default(),
            text: text.into(),
            coordinates,
            channels,
            parameters,
            constants,
            roles,
            stages,
            places: places(&root),
            document: document.into(),
            digest,
            formulas,
        }),
        _ => Err(faults.finish()),
    }
}

/// `[a-z0-9][a-z0-9-]{0,63}`
pub(crate) fn is_slug(name: &str) -> bool {
    let allowed = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit();
    name.len() <= 64 && name.bytes().next().is_some_and(allowed) && name.bytes().all(|b| allowed(b) || b == b'-')
}

fn required_text(faults: &mut Faults, top: &[(Key, Entry)], key: &str, whole: Span, help: &str) -> Option<String> {
    match get(top, key) {
        Some(entry) => faults.text(key, entry).map(|t| t.value.to_string()),
        None => {
            let at = Span { start: whole.start, end: whole.start };
            faults.tell("missing-key", key, at, format!("the key `{key}` is missing"), help);
            None
        }
    }
}

/// All names of the document, to detect duplicates.
#[derive(Default)]
struct Names {
    seen: BTreeMap<String, String>,
    /// Invalid names and their parts, as formulas may refer to them.
    faulty: Vec<String>,
    /// Some names could not be read.
    lacking: bool,
}

impl Names {
    /// True when the name is well-formed and new.
    fn declare(&mut self, faults: &mut Faults, key: &str, name: &str, span: Span) -> bool {
        if !faults.name(key, name, span) {
            // A formula reads `my-name` as two.
            self.faulty.push(name.to_string());
            let parts = name.split(|c: char| !(c.is_alphanumeric() || c == '_'));
            self.faulty.extend(parts.filter(|p| !p.is_empty()).map(String::from));
            return false;
        }
        if let Some(first) = self.seen.get(name) {
            let message = format!("{} is already declared as `{first}`", quoted(name));
            faults.tell("duplicate", key, span, message, "every name has one meaning; rename one of them");
            return false;
        }
        self.seen.insert(name.to_string(), key.to_string());
        true
    }

    fn list(&mut self, faults: &mut Faults, top: &[(Key, Entry)], key: &str, whole: Span, most: usize) -> Vec<String> {
        let Some(entry) = get(top, key) else {
            let at = Span { start: whole.start, end: whole.start };
            let help =
                if key == "coordinates" { "add `coordinates = [\"x\", \"y\"]`" } else { "add `channels = [\"phi\"]`" };
            faults.tell("missing-key", key, at, format!("the key `{key}` is missing"), help);
            return Vec::new();
        };
        let Some(list) = faults.list(key, entry, "a list of names") else { return Vec::new() };
        self.lacking |= list.iter().any(|item| !matches!(item.item, Item::Text(_)));
        if list.is_empty() || list.len() > most {
            let code = if list.is_empty() { "bad-range" } else { "limit" };
            let help = if key == "coordinates" {
                "columns, rows, slices, volumes: the first is the inner loop"
            } else {
                "name the raw planes that formulas use"
            };
            faults.tell(code, key, entry.span, format!("`{key}` has 1 to {most} names, not {}", list.len()), help);
            return Vec::new();
        }
        let mut names = Vec::new();
        for (i, item) in list.iter().enumerate() {
            let key = format!("{key}[{i}]");
            if let Some(text) = faults.text(&key, item)
                && self.declare(faults, &key, &text.value, item.span)
            {
                names.push(text.value.to_string());
            }
        }
        names
    }
}

fn read_parameters(
    faults: &mut Faults,
    top: &[(Key, Entry)],
    whole: Span,
    names: &mut Names,
    coordinates: usize,
) -> Vec<Parameter> {
    let Some(entry) = get(top, "parameters") else {
        let at = Span { start: whole.start, end: whole.start };
        faults.tell(
            "missing-key",
            "parameters",
            at,
            "the table [parameters] is missing",
            "declare what the fit is to find",
        );
        return Vec::new();
    };
    let Some(table) = faults.table("parameters", entry) else { return Vec::new() };
    if (table.is_empty() && !faults.is_partial()) || table.len() > LIMITS.parameters {
        let message = format!("a model has 1 to {} parameters, this one {}", LIMITS.parameters, table.len());
        faults.tell(
            if table.is_empty() { "bad-range" } else { "limit" },
            "parameters",
            entry.span,
            message,
            "declare what the fit is to find",
        );
    }
    let mut parameters = Vec::new();
    for (key, entry) in table {
        let path = format!("parameters.{}", key.name);
        names.declare(faults, &path, &key.name, key.span);
        // An invalid parameter still counts as declared.
        let parameter = |(start, others), min, max, unit| {
            let name = key.name.clone();
            Parameter { name, start, others, min, max, unit, span: key.span }
        };
        let unread = parameter((Start::Number(f64::NAN), Vec::new()), None, None, None);
        let Some(fields) = faults.table(&path, entry) else {
            parameters.push(unread);
            continue;
        };
        faults.known(&path, fields, &["start", "min", "max", "unit"]);
        let bound = |faults: &mut Faults, name: &str| {
            get(fields, name).and_then(|e| faults.number(&format!("{path}.{name}"), e))
        };
        let (min, max) = (bound(faults, "min"), bound(faults, "max"));
        let unit =
            get(fields, "unit").and_then(|e| faults.text(&format!("{path}.unit"), e)).map(|t| t.value.to_string());
        let starts = read_starts(faults, &path, fields, key.span, coordinates);
        if let (Some(min), Some(max)) = (min, max)
            && min >= max
        {
            faults.tell(
                "bad-range",
                &path,
                entry.span,
                format!("min = {min} is not below max = {max}"),
                "a parameter lies between them: min < max",
            );
        }
        let is_outside = |value: &f64| min.is_some_and(|m| *value <= m) || max.is_some_and(|m| *value >= m);
        if let Some((Start::Number(first), others)) = &starts
            && !matches!((min, max), (Some(min), Some(max)) if min >= max)
            && let Some(value) = [first].into_iter().chain(others).find(|value| is_outside(value))
        {
            let at = get(fields, "start").map_or(entry.span, |e| e.span);
            faults.tell(
                "bad-range",
                &format!("{path}.start"),
                at,
                format!("the start {value} is outside the bounds"),
                "a start lies between them: min < start < max",
            );
        }
        parameters.push(starts.map_or(unread, |starts| parameter(starts, min, max, unit)));
        let count = || parameters.iter().map(|p: &Parameter| 1 + p.others.len()).product::<usize>();
        let is_list = parameters.last().is_some_and(|p| !p.others.is_empty());
        if let Some(count) = is_list.then(count).filter(|count| *count > LIMITS.starts) {
            let at = get(fields, "start").map_or(entry.span, |e| e.span);
            let message =
                format!("the starts have {count} combinations up to here, at most {} are tried", LIMITS.starts);
            faults.tell("limit", &format!("{path}.start"), at, message, "give fewer numbers");
            parameters.iter_mut().for_each(|p| p.others.clear());
        }
    }
    parameters
}

/// The first start, and the numbers that follow it in a list.
fn read_starts(
    faults: &mut Faults,
    path: &str,
    fields: &[(Key, Entry)],
    at: Span,
    coordinates: usize,
) -> Option<(Start, Vec<f64>)> {
    let Some(Item::List(list)) = get(fields, "start").map(|entry| &entry.item) else {
        return Some((read_start(faults, path, fields, at, coordinates)?, Vec::new()));
    };
    let path = format!("{path}.start");
    if list.is_empty() {
        faults.tell("bad-range", &path, at, "the list of starts is empty", "give a number, or several");
        return None;
    }
    let numbers: Vec<Option<f64>> = list.iter().take(LIMITS.starts + 1).map(|e| faults.number(&path, e)).collect();
    let numbers = numbers.into_iter().collect::<Option<Vec<f64>>>()?;
    Some((Start::Number(numbers[0]), numbers[1..].to_vec()))
}

fn read_start(faults: &mut Faults, path: &str, fields: &[(Key, Entry)], at: Span, coordinates: usize) -> Option<Start> {
    let path = format!("{path}.start");
    let Some(entry) = get(fields, "start") else {
        faults.tell(
            "missing-key",
            &path,
            at,
            "the key `start` is missing",
            "give a number, or an estimator such as \"centroid.x\"",
        );
        return None;
    };
    let Item::Text(text) = &entry.item else { return faults.number(&path, entry).map(Start::Number) };
    let found = Estimator::ALL.into_iter().find(|e| e.name() == &*text.value);
    let known = || Estimator::ALL.into_iter().filter(|e| e.coordinates() <= coordinates.max(1)).map(Estimator::name);
    if found.is_none() {
        let help = match faults.nearest(&text.value, known()) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => format!("estimators: {}", known().collect::<Vec<_>>().join(", ")),
        };
        faults.tell("unknown-name", &path, entry.span, format!("{} is not an estimator", quoted(&text.value)), help);
    }
    if let Some(needed) = found.map(Estimator::coordinates).filter(|needed| coordinates > 0 && *needed > coordinates) {
        let ordinal = ["first", "second", "third", "fourth"][needed - 1];
        let message = format!("{} needs a {ordinal} coordinate", quoted(&text.value));
        let count = ["one coordinate", "two coordinates", "three coordinates"][coordinates - 1];
        let help = format!("with {count}: {}", known().collect::<Vec<_>>().join(", "));
        faults.tell("unknown-name", &path, entry.span, message, help);
    }
    found.map(Start::Estimator)
}

/// Default constant for the share of pixels at their limit whatever the light: name and value.
const DEFECTS: (&str, f64) = ("defects", 1e-3);

/// The constant of that name, where pixels at their limit are censored and weighed by their noise; added unless the
/// name has another meaning. Without noise there is no scale for how much less light would be implausible, and a `loss`
/// bounds the influence of a pixel by itself.
fn defects(top: &[(Key, Entry)], constants: &mut Vec<Constant>, names: &Names) -> Option<ConstantId> {
    let Some(Item::Table(model)) = get(top, "model").map(|entry| &entry.item) else { return None };
    let saturated = get(model, "saturated")?;
    let is_censored = matches!(&saturated.item, Item::Text(text) if &*text.value == "censored");
    if !is_censored || get(model, "noise").is_none() || get(model, "loss").is_some() {
        return None;
    }
    if !names.seen.contains_key(DEFECTS.0) && constants.len() < LIMITS.constants {
        constants.push(Constant { name: DEFECTS.0.into(), value: DEFECTS.1, span: saturated.span });
    }
    let place = constants.iter().position(|constant| constant.name == DEFECTS.0)?;
    Some(ConstantId(place as u32))
}

fn read_constants(faults: &mut Faults, top: &[(Key, Entry)], names: &mut Names) -> Vec<Constant> {
    let Some(table) = get(top, "constants").and_then(|e| faults.table("constants", e)) else { return Vec::new() };
    let mut constants = Vec::new();
    for (i, (key, entry)) in table.iter().enumerate() {
        let path = format!("constants.{}", key.name);
        if i == LIMITS.constants {
            let message = format!("a model has at most {} constants, this one {}", LIMITS.constants, table.len());
            faults.tell("limit", &path, key.span, message, "remove some");
        }
        names.declare(faults, &path, &key.name, key.span);
        let value = faults.number(&path, entry).unwrap_or(f64::NAN);
        constants.push(Constant { name: key.name.clone(), value, span: key.span });
    }
    constants
}

fn read_definitions(faults: &mut Faults, top: &[(Key, Entry)], names: &mut Names) -> Vec<Definition> {
    let Some(entry) = get(top, "definitions") else { return Vec::new() };
    let Some(table) = faults.table("definitions", entry) else { return Vec::new() };
    let mut definitions = Vec::new();
    for (i, (key, entry)) in table.iter().enumerate() {
        let path = format!("definitions.{}", key.name);
        if i == LIMITS.definitions {
            let message = format!("a model has at most {} definitions, this one {}", LIMITS.definitions, table.len());
            faults.tell("limit", &path, key.span, message, "merge some");
            names.lacking = true;
            break;
        }
        let (name, arguments): (_, Vec<String>) = match key.name.split_once('(') {
            Some((name, rest)) if rest.trim_end().ends_with(')') => {
                let inner = rest.trim_end().trim_end_matches(')');
                (name.trim(), inner.split(',').map(|a| a.trim().to_string()).collect())
            }
            _ => (key.name.as_str(), Vec::new()),
        };
        let is_function = !arguments.is_empty();
        let mut declared = names.declare(faults, &path, name, key.span);
        if arguments.len() > LIMITS.arguments {
            let message = format!("a function has at most {} arguments, not {}", LIMITS.arguments, arguments.len());
            faults.tell("limit", &path, key.span, message, "gather them in vectors");
            declared = false;
        }
        for (j, argument) in arguments.iter().enumerate().take(LIMITS.arguments) {
            declared &= faults.name(&path, argument, key.span);
            if arguments[..j].contains(argument) {
                faults.tell(
                    "duplicate",
                    &path,
                    key.span,
                    format!("the argument {} stands twice", quoted(argument)),
                    "rename one of them",
                );
            }
        }
        if let Some(text) = faults.text(&path, entry) {
            let (name, text) = (name.to_string(), text.clone());
            definitions.push(Definition { name, arguments, is_function, key: path, text, declared });
        } else {
            names.faulty.push(name.to_string());
        }
    }
    definitions
}

fn bind(
    graph: &mut Graph,
    coordinates: &[String],
    channels: &[String],
    parameters: &[Parameter],
    constants: &[Constant],
    faulty: Vec<String>,
) -> BTreeMap<String, Binding> {
    let mut bindings = BTreeMap::new();
    // Of duplicate names the first counts.
    let mut add = |name: &String, node| {
        bindings.entry(name.clone()).or_insert(Binding::Value(Matrix::scalar(node)));
    };
    for (i, name) in coordinates.iter().enumerate() {
        add(name, graph.coordinate(CoordinateId(i as u32)));
    }
    for (i, name) in channels.iter().enumerate() {
        add(name, graph.channel(ChannelId(i as u32)));
    }
    for (i, parameter) in parameters.iter().enumerate() {
        graph.set_span(Some(parameter.span));
        let id = ParameterId(i as u32);
        if parameter.min.is_some_and(|min| min >= 0.0) {
            graph.declare_positive(id);
        }
        add(&parameter.name, graph.input(Input::Parameter(id)));
    }
    for (i, constant) in constants.iter().enumerate() {
        graph.set_span(Some(constant.span));
        add(&constant.name, graph.input(Input::Constant(ConstantId(i as u32))));
    }
    for name in faulty {
        bindings.entry(name).or_insert(Binding::Poisoned);
    }
    bindings
}
