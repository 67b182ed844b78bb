//! Parses `--source` into a session's source document.

use std::path::Path;

use serde_json::{Map, Value, json};

use crate::failure::Failure;

/// `@FILE`, `synthetic:MODEL`, `file:PATH` or a path, `recording:PATH` as the service sees it, `/dev/video0` or
/// `camera:IDENTITY`, `pushed:WIDTHxHEIGHT`, or the name of a source. Keys after `?` (`rate_hz=30&loop=true`) are
/// copied into the document; the service validates them.
pub fn document(text: &str) -> Result<Value, Failure> {
    if let Some(file) = text.strip_prefix('@') {
        return read_json(Path::new(file));
    }
    if let Some(rest) = text.strip_prefix("synthetic:") {
        let (model, keys) = keys(rest)?;
        return Ok(of_kind("synthetic", [("model", json!(model.trim_start_matches("//")))], keys));
    }
    if let Some(rest) = text.strip_prefix("file:") {
        let (path, keys) = keys(rest)?;
        return Ok(of_kind("recording", [("path", absolute(path.strip_prefix("//").unwrap_or(path))?)], keys));
    }
    if let Some(rest) = text.strip_prefix("recording:") {
        let (path, keys) = keys(rest)?;
        return Ok(of_kind("recording", [("path", json!(path))], keys));
    }
    if let Some(rest) = text.strip_prefix("pushed:") {
        let (size, keys) = keys(rest)?;
        let crate::arguments::Size(sides) = size.trim_start_matches("//").parse().map_err(Failure::Usage)?;
        let [width, height] = sides[..] else {
            return Err(Failure::Usage(format!("pushed:{size} is not pushed:WIDTHxHEIGHT; clients push pictures")));
        };
        return Ok(of_kind("pushed", [("width", json!(width)), ("height", json!(height))], keys));
    }
    if let Some(rest) = text.strip_prefix("camera:").or_else(|| Some(text).filter(|text| text.starts_with("/dev/"))) {
        let (device, keys) = keys(rest)?;
        return Ok(of_kind("camera", [("device", json!(device.trim_start_matches("//")))], keys));
    }
    if text.contains(['/', '.']) {
        return Ok(of_kind("recording", [("path", absolute(text)?)], Map::new()));
    }
    Ok(json!(text))
}

/// The document of a named source: `FILE.json` is read like `@FILE`; a mere name is refused.
pub fn own_document(text: &str) -> Result<Value, Failure> {
    let is_json = Path::new(text).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
    if is_json && !text.contains(['@', ':']) {
        return read_json(Path::new(text));
    }
    let document = document(text)?;
    let named = || {
        let wanted = "give FILE.json or @FILE, a JSON document, or a URI such as synthetic:spot";
        Failure::Usage(format!("`{text}` is no source: {wanted}"))
    };
    if document.is_string() { Err(named()) } else { Ok(document) }
}

/// Reads a JSON file.
pub fn read_json(path: &Path) -> Result<Value, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| Failure::Usage(format!("{}: cannot be read: {error}", path.display())))?;
    serde_json::from_str(&text).map_err(|error| Failure::Usage(format!("{}: not JSON: {error}", path.display())))
}

fn of_kind<const N: usize>(kind: &str, own: [(&str, Value); N], mut keys: Map<String, Value>) -> Value {
    keys.insert("kind".into(), json!(kind));
    keys.extend(own.map(|(name, value)| (name.to_string(), value)));
    Value::Object(keys)
}

/// Makes a path absolute: the service may have another working directory.
fn absolute(path: &str) -> Result<Value, Failure> {
    let absolute =
        std::path::absolute(path).map_err(|error| Failure::Usage(format!("`{path}` is no path: {error}")))?;
    let text = absolute.to_str().ok_or_else(|| Failure::Usage(format!("`{path}` is not UTF-8")))?;
    Ok(json!(text))
}

/// Parses `rest?key=value&…`: JSON values such as numbers, `true` and `false` keep their types, everything else is
/// text.
fn keys(text: &str) -> Result<(&str, Map<String, Value>), Failure> {
    let Some((rest, query)) = text.split_once('?') else { return Ok((text, Map::new())) };
    let mut keys = Map::new();
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (name, value) =
            pair.split_once('=').ok_or_else(|| Failure::Usage(format!("`{pair}` of `{text}` is not key=value")))?;
        let value = serde_json::from_str(value).ok().filter(|v: &Value| !v.is_string()).unwrap_or_else(|| json!(value));
        keys.insert(name.to_string(), value);
    }
    Ok((rest, keys))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn forms() {
        let here = std::env::current_dir().unwrap();
        let local = here.join("frames/a").to_str().unwrap().to_string();
        let cases = [
            ("demo", json!("demo")),
            ("synthetic:spot", json!({"kind": "synthetic", "model": "spot"})),
            (
                "synthetic:spot?rate_hz=60&pace=fit",
                json!({"kind": "synthetic", "model": "spot", "rate_hz": 60, "pace": "fit"}),
            ),
            ("frames/a", json!({"kind": "recording", "path": local})),
            ("file:frames/a?loop=true", json!({"kind": "recording", "path": local, "loop": true})),
            (
                "recording:a/run.mcap#/left?loop=true",
                json!({"kind": "recording", "path": "a/run.mcap#/left", "loop": true}),
            ),
            ("file:///data/x", json!({"kind": "recording", "path": "/data/x"})),
            ("pushed:64x48?format=u16le", json!({"kind": "pushed", "width": 64, "height": 48, "format": "u16le"})),
            ("/dev/video0", json!({"kind": "camera", "device": "/dev/video0"})),
            (
                "camera:rig-camera-0001?format=GREY&rate_hz=25",
                json!({"kind": "camera", "device": "rig-camera-0001", "format": "GREY", "rate_hz": 25}),
            ),
        ];
        for (text, expected) in cases {
            assert_eq!(document(text).unwrap(), expected, "{text}");
        }
        assert!(matches!(document("pushed:64"), Err(Failure::Usage(_))));
        assert!(matches!(document("@/no/such/file"), Err(Failure::Usage(_))));
        assert_eq!(own_document("synthetic:spot").unwrap(), json!({"kind": "synthetic", "model": "spot"}));
        assert_eq!(own_document("frames/a").unwrap(), json!({"kind": "recording", "path": local}));
        assert!(own_document("demo").unwrap_err().to_string().contains("`demo` is no source"));
        for text in ["none.json", "@none.json"] {
            assert!(own_document(text).unwrap_err().to_string().starts_with("error: none.json: cannot be read"));
        }
    }
}
