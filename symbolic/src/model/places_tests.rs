//! Lookup of formulas by span.

use super::*;

const TOML: &str = "name = \"flat\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n\
                    v0 = { start = 0.0 }\n[definitions]\ns = \"v0 * x\"\n[model]\nintensity = \"s + y\"\n";
const JSON: &str = r#"{"name": "flat", "coordinates": ["x", "y"], "channels": ["phi"],
    "parameters": {"v0": {"start": 0.0}}, "definitions": {"s": "v0 * x"}, "model": {"intensity": "s + y"}}"#;

#[test]
fn quote_returns_the_key_of_a_span() -> Result<(), crate::Diagnostics> {
    for (model, text) in [(Model::from_toml(TOML)?, TOML), (Model::from_json(JSON)?, JSON)] {
        let span = |words: &str| {
            let start = text.find(words).map_or(0, |at| at as u32);
            Span { start, end: start + words.len() as u32 }
        };
        assert_eq!(model.quote(span("v0 * x")), Some(("definitions.s", "v0 * x")));
        assert_eq!(model.quote(span("s + y")), Some(("model.intensity", "s + y")));
        assert_eq!(model.quote(span("y\"]")).map(|(key, _)| key), None, "beyond the string");
        assert_eq!(model.quote(Span { start: 0, end: 1 }), None);
        assert_eq!(model.quote(Span { start: 1 << 20, end: 1 << 21 }), None, "beyond the document");
    }
    Ok(())
}
