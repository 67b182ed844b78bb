//! Finds objects written as lists. Serde's derived readers accept a list for an object anywhere in a document, its values for
//! those of the keys in their order, which nobody means.

use std::collections::BTreeMap;
use std::rc::Rc;

use isophote_symbolic::{Diagnostic, Span};
use isophote_tracker::Target;
use jsonc_parser::ast::Value as Node;
use jsonc_parser::common::Ranged;
use jsonc_parser::{CollectOptions, ParseOptions, parse_to_ast};
use serde_json::Value;
use utoipa::{PartialSchema, ToSchema};

use crate::http::documents::property_name;

/// A diagnostic at the first list where a document of that type has an object.
pub fn list_for_object<T: ToSchema>(text: &str) -> Option<Diagnostic> {
    if !text.contains('[') {
        return None;
    }
    // The reader of the document reports malformed JSON.
    let parsed = parse_to_ast(text, &CollectOptions::default(), &ParseOptions::default()).ok()?;
    let description = Described::of::<T>()?;
    let mut steps = vec![Step::Whole];
    // Lists and objects to visit, with the schemas of each and the step that leads to it.
    let mut open = vec![(parsed.value.as_ref()?, Rc::new(description.choices(vec![&description.whole])), 0)];
    let mut first: Option<(Span, usize)> = None;
    while let Some((node, schemas, at)) = open.pop() {
        match node {
            Node::Array(list) if is_object(&schemas) => {
                let span = Span { start: list.range().start as u32, end: list.range().end as u32 };
                if first.is_none_or(|(first, _)| span.start < first.start) {
                    first = Some((span, at));
                }
            }
            Node::Array(list) => {
                let items = schemas.iter().filter_map(|schema| schema.get("items")).collect();
                let items = Rc::new(description.choices(items));
                for (n, item) in list.elements.iter().enumerate().filter(|(_, item)| is_open(item)) {
                    open.push((item, items.clone(), steps.len()));
                    steps.push(Step::Item(at, n));
                }
            }
            Node::Object(object) => {
                for property in object.properties.iter().filter(|property| is_open(&property.value)) {
                    let name = property_name(&property.name);
                    let values = schemas.iter().filter_map(|schema| value_of(schema, name)).collect();
                    open.push((&property.value, Rc::new(description.choices(values)), steps.len()));
                    steps.push(Step::Key(at, name));
                }
            }
            _ => {}
        }
    }
    let (span, at) = first?;
    let key = key_of(&steps, at);
    let what = if key.is_empty() { "the document" } else { &key };
    let diagnostic = Diagnostic::error(text, "wrong-value", &key, span, format!("{what} is a list, not an object"));
    Some(diagnostic.help("write keys and values: {\"key\": value}"))
}

/// A step from one part of a document to a part of it.
enum Step<'a> {
    Whole,
    Item(usize, usize),
    Key(usize, &'a str),
}

fn key_of(steps: &[Step<'_>], mut at: usize) -> String {
    let mut parts = Vec::new();
    loop {
        at = match steps[at] {
            Step::Whole => break,
            Step::Item(around, n) => {
                parts.push(format!("[{n}]"));
                around
            }
            Step::Key(around, name) => {
                parts.push(format!(".{name}"));
                around
            }
        };
    }
    parts.reverse();
    parts.concat().trim_start_matches('.').to_string()
}

/// Whether it has parts: it is a list, or has keys.
fn is_open(node: &Node<'_>) -> bool {
    match node {
        Node::Array(_) => true,
        Node::Object(object) => !object.properties.is_empty(),
        _ => false,
    }
}

/// The schema of a type, and those it refers to.
struct Described {
    whole: Value,
    parts: BTreeMap<String, Value>,
}

impl Described {
    fn of<T: ToSchema>() -> Option<Described> {
        let mut parts = Vec::new();
        T::schemas(&mut parts);
        // A session's target may also be null, which hides the schemas of its parts.
        parts.push((Target::name().into_owned(), Target::schema()));
        Target::schemas(&mut parts);
        let parts = parts.into_iter().filter_map(|(name, schema)| Some((name, serde_json::to_value(schema).ok()?)));
        Some(Described { whole: serde_json::to_value(T::schema()).ok()?, parts: parts.collect() })
    }

    /// All schemas that a value may match; `oneOf`, `anyOf` and `allOf` are treated alike.
    fn choices<'a>(&'a self, schemas: Vec<&'a Value>) -> Vec<&'a Value> {
        let (mut open, mut choices) = (schemas, Vec::new());
        // A type may be recursive.
        let mut left = 4 * (self.parts.len() + open.len() + 1);
        while let (Some(schema), true) = (open.pop(), left > 0) {
            left -= 1;
            let name = schema["$ref"].as_str().and_then(|reference| reference.rsplit('/').next());
            open.extend(name.and_then(|name| self.parts.get(name)));
            let members = ["oneOf", "anyOf", "allOf"].map(|key| schema[key].as_array());
            open.extend(members.into_iter().flatten().flatten());
            if members.iter().all(|members| members.is_none()) && name.is_none() {
                choices.push(schema);
            }
        }
        choices
    }
}

fn value_of<'a>(schema: &'a Value, name: &str) -> Option<&'a Value> {
    schema["properties"].get(name).or_else(|| schema.get("additionalProperties").filter(|values| values.is_object()))
}

/// Whether the schemas allow an object, but no list.
fn is_object(choices: &[&Value]) -> bool {
    let is = |schema: &Value, kind: &str| match &schema["type"] {
        Value::Array(kinds) => kinds.iter().any(|one| one == kind),
        one => one == kind,
    };
    let is_any = |schema: &&Value| schema["type"].is_null() && schema["properties"].is_null();
    choices.iter().any(|schema| is(schema, "object"))
        && !choices.iter().any(|schema| is(schema, "array") || is_any(schema) && schema["enum"].is_null())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use isophote_wire::{
        ControlDocument, CreditDocument, FrameTime, PlaybackDocument, RecordDocument, RollbackDocument, SceneDocument,
        SessionDocument, ShadowDocument, SourceDocument, SwapDocument,
    };

    fn key_of<T: ToSchema>(text: &str) -> Option<String> {
        list_for_object::<T>(text).map(|fault| fault.key)
    }

    /// Covers every object in a document of a session or source.
    #[test]
    fn lists_in_place_of_objects_are_found() {
        let camera = r#"{"saturation": 255, "intrinsics": [640, 480], "defect_map": {}}"#;
        let cases = [
            (r#"["s", "m"]"#.to_string(), ""),
            (r#"{"source": "s", "model": "m", "window": [1, 2, 3, 4]}"#.into(), "window"),
            (r#"{"source": "s", "model": "m", "camera": [255]}"#.into(), "camera"),
            (r#"{"source": "s", "model": "m", "camera": []}"#.into(), "camera"),
            (format!(r#"{{"source": "s", "model": "m", "camera": {camera}}}"#), "camera.intrinsics"),
            (r#"{"source": "s", "model": "m", "camera": {"defect_map": [1, 1, ""]}}"#.into(), "camera.defect_map"),
            (r#"{"source": "s", "model": "m", "camera": {"response": [2.2]}}"#.into(), "camera.response"),
            (r#"{"source": "s", "model": "m", "options": ["f32"]}"#.into(), "options"),
            (r#"{"source": "s", "model": "m", "options": {"motion": [1, 2]}}"#.into(), "options.motion"),
            (r#"{"source": "s", "model": "m", "options": {"exposure": ["centre"]}}"#.into(), "options.exposure"),
            (r#"{"source": "s", "model": "m", "options": {"predict": [1, 2]}}"#.into(), "options.predict"),
            (r#"{"source": "s", "model": "m", "target": {"spots": [["a", [0, 0, 0], 3]]}}"#.into(), "target.spots[0]"),
            (r#"{"source": ["synthetic", "m"], "model": "m"}"#.into(), "source"),
            (r#"{"source": {"kind": "synthetic", "model": "m", "light": [[]]}, "model": "m"}"#.into(), "source.light"),
            (
                r#"{"source": {"kind": "synthetic", "model": "m", "response": [1]}, "model": "m"}"#.into(),
                "source.response",
            ),
        ];
        for (text, key) in cases {
            assert_eq!(key_of::<SessionDocument>(&text).as_deref(), Some(key), "{text}");
        }
        let light = r#"{"kind": "synthetic", "model": "m", "light": {"occluders": [{"x": 1}, [1, 2]]}}"#;
        assert_eq!(key_of::<SourceDocument>(light).as_deref(), Some("light.occluders[1]"));
        assert_eq!(key_of::<SceneDocument>(r#"{"light": []}"#).as_deref(), Some("light"));
    }

    #[test]
    fn no_document_is_a_list() {
        let found = [
            key_of::<SourceDocument>("[1]"),
            key_of::<SwapDocument>("[1]"),
            key_of::<ShadowDocument>("[1]"),
            key_of::<RecordDocument>("[1]"),
            key_of::<RollbackDocument>("[1]"),
            key_of::<ControlDocument>("[1]"),
            key_of::<SceneDocument>("[1]"),
            key_of::<PlaybackDocument>("[1]"),
            key_of::<CreditDocument>("[1]"),
            key_of::<FrameTime>("[1]"),
        ];
        assert_eq!(found, [const { Some(String::new()) }; 10]);
    }

    /// Lists that the schema has, including those that one of several kinds allows.
    #[test]
    fn lists_of_the_schema_are_accepted() {
        let target = r#"{"name": "t", "spots": [{"name": "r", "position_mm": [0, 80, 0], "radius_mm": 3}],
                         "mixing": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}"#;
        let intrinsics = r#"{"width": 6, "height": 4, "fx": 1, "fy": 1, "cx": 1, "cy": 1, "model": "plumb_bob",
                            "coefficients": [1, 2], "covariance": [[1, 2], [3, 4]]}"#;
        let light = r#"{"glare": [{"sigma_px": "t", "height": 2}], "slope": [0, "t"], "occluders": []}"#;
        let text = format!(
            r#"{{"source": {{"kind": "synthetic", "model": "m", "light": {light}}}, "model": "m", "window": null,
                "camera": {{"intrinsics": {intrinsics}}}, "target": {target}}}"#
        );
        assert_eq!(key_of::<SessionDocument>(&text), None);
        assert_eq!(key_of::<SessionDocument>(r#"{"source": ["#), None, "no JSON at all");
    }
}
