//! Composes the schemas of documents that refuse unknown keys. `"additionalProperties": false` counts only the properties
//! beside it, so a view made of a document and more would refuse its own fields.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

const CLOSED: &str = "additionalProperties";
const CLOSED_WHOLE: &str = "unevaluatedProperties";
const PREFIX: &str = "#/components/schemas/";
/// Suffix of the name of a document's open copy.
const OPEN: &str = "Fields";

/// Makes composed schemas refer to an open copy of a closed one; each kind of a document is closed as a whole.
pub fn compose(schemas: &mut Map<String, Value>) {
    let is_closed = |schema: &Value| schema[CLOSED] == false;
    let mut closed: BTreeSet<String> =
        schemas.iter().filter(|(_, schema)| is_closed(schema)).map(|(name, _)| name.clone()).collect();
    let mut copied = BTreeSet::new();
    for schema in schemas.values_mut() {
        refer(schema, &closed, &mut copied);
    }
    // A choice between closed documents is closed as well, and other schemas are composed of it.
    for (name, schema) in schemas.iter_mut() {
        for kind in members(schema, "oneOf") {
            let Some(members) = kind["allOf"].as_array() else { continue };
            if members.iter().any(|member| name_of(member).is_some_and(|name| copied.contains(name))) {
                kind[CLOSED_WHOLE] = false.into();
                closed.insert(name.clone());
            }
        }
    }
    for schema in schemas.values_mut() {
        refer(schema, &closed, &mut copied);
    }
    for name in copied {
        let name = name.trim_end_matches(OPEN).to_string();
        let mut copy = schemas[&name].clone();
        open(&mut copy);
        schemas.insert(name + OPEN, copy);
    }
}

fn name_of(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.strip_prefix(PREFIX)
}

fn members<'a>(schema: &'a mut Value, key: &str) -> impl Iterator<Item = &'a mut Value> {
    schema.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten()
}

/// Makes the members of every `allOf` that name a closed document name its open copy.
fn refer(schema: &mut Value, closed: &BTreeSet<String>, copied: &mut BTreeSet<String>) {
    for member in members(schema, "allOf") {
        let Some(name) = name_of(member).filter(|name| closed.contains(*name)) else { continue };
        let copy = format!("{name}{OPEN}");
        member["$ref"] = format!("{PREFIX}{copy}").into();
        copied.insert(copy);
    }
    match schema {
        Value::Object(fields) => fields.values_mut().for_each(|one| refer(one, closed, copied)),
        Value::Array(items) => items.iter_mut().for_each(|one| refer(one, closed, copied)),
        _ => {}
    }
}

fn open(schema: &mut Value) {
    if let Some(fields) = schema.as_object_mut() {
        fields.remove(CLOSED);
        fields.remove(CLOSED_WHOLE);
    }
    members(schema, "oneOf").for_each(open);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serde_json::json;

    #[test]
    fn views_are_open_and_documents_closed() {
        let reference = |name: &str| json!({"$ref": format!("{PREFIX}{name}")});
        let mut schemas = json!({
            "Dot": {"type": "object", "properties": {"x": {}}, "additionalProperties": false},
            "Any": {"oneOf": [{"allOf": [reference("Dot"), {"properties": {"kind": {}}}]}]},
            "View": {"allOf": [reference("Any"), {"properties": {"name": {}}}]},
            "List": {"properties": {"items": {"items": {"allOf": [reference("Any")]}}}},
        });
        compose(schemas.as_object_mut().unwrap());
        assert_eq!(schemas["Dot"]["additionalProperties"], false);
        assert_eq!(schemas["DotFields"], json!({"type": "object", "properties": {"x": {}}}));
        let kind = json!({"allOf": [reference("DotFields"), {"properties": {"kind": {}}}]});
        let mut closed_kind = kind.clone();
        closed_kind["unevaluatedProperties"] = false.into();
        assert_eq!(schemas["Any"], json!({"oneOf": [closed_kind]}));
        assert_eq!(schemas["AnyFields"], json!({"oneOf": [kind]}));
        assert_eq!(schemas["View"]["allOf"][0], reference("AnyFields"));
        assert_eq!(schemas["List"]["properties"]["items"]["items"]["allOf"][0], reference("AnyFields"));
    }
}
