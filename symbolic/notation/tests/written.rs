//! Documents' own formulas as MathML: rendered text, and each node's span in the document.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::Path;

use isophote_notation::written;
use isophote_symbolic::{Model, Span};
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::parse;

fn model(definitions: &str, intensity: &str) -> Model {
    let parameters: String = ["a", "b", "c"].map(|name| format!("{name} = {{ start = 1.0 }}\n")).concat();
    Model::from_toml(&format!(
        "name = \"m\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{parameters}\
         [definitions]\n{definitions}\n[model]\nintensity = \"{intensity}\"\n"
    ))
    .unwrap()
}

/// The visible text of elements: no tags, no invisible operators.
fn seen(mathml: &str) -> String {
    let (mut text, mut is_tag) = (String::new(), false);
    for c in mathml.chars() {
        match c {
            '<' => is_tag = true,
            '>' => is_tag = false,
            '\u{2061}' | '\u{2062}' => {}
            c if !is_tag => text.push(c),
            _ => {}
        }
    }
    text.replace('\u{a0}', " ").replace("&lt;", "<").trim().to_string()
}

#[test]
fn brackets_appear_only_where_needed() {
    for (formula, wanted) in [
        ("a + b * c", "a+bc"),
        ("(a + b) * c", "(a+b)c"),
        ("a - (b - c)", "a−(b−c)"),
        ("a - b - c", "a−b−c"),
        ("-a + b", "−a+b"),
        ("a + -b", "a+(−b)"),
        ("-a * b + c", "−ab+c"),
        ("a * -b", "a(−b)"),
        ("exp(-a * x^2)", "exp(−ax2)"),
        ("(-a)^2", "(−a)2"),
        ("-a^2", "−a2"),
        ("(a * b)^2", "(ab)2"),
        ("2 * 3 * a", "2⋅3a"),
        ("if(x <= 1 and y <= 1, a, if(x <= 2, b, c))", "{aif x≤1∧y≤1bif x≤2cotherwise"),
        ("sum(a * x^i, i, 0, 3) * b", "(∑i=03axi)b"),
        ("abs(a - b)", "|a−b|"),
    ] {
        assert_eq!(seen(&written(&model("", formula))), format!("intensity={wanted}"), "{formula}");
    }
}

#[test]
fn definitions_are_shown_unevaluated() {
    let model = model("\"f(t)\" = \"a * t\"\nv = \"[a, b]\"\nM = \"[[a, b], [b, c]]\"", "f(x) + (v' * M * v) * v[0]");
    let lines: Vec<String> = written(&model).lines().map(seen).collect();
    assert_eq!(lines, ["f(t)=at", "v=(ab)", "M=(abbc)", "intensity=f(x)+v⊤Mvv[0]"]);
}

/// The spans of all nodes.
fn spans(mathml: &str) -> Vec<Span> {
    let found = mathml.split("data-span=\"").skip(1).filter_map(|rest| rest.split('"').next()?.split_once('-'));
    found.map(|(start, end)| Span { start: start.parse().unwrap(), end: end.parse().unwrap() }).collect()
}

#[test]
fn every_span_of_shipped_documents_parses() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let model = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let text = written(&model);
        assert!(text.contains("data-key=\"model.intensity\""), "{}", path.display());
        let spans = spans(&text);
        assert!(spans.len() > 10, "{}", path.display());
        for span in spans {
            // Each span is a formula by itself: not a byte too many or too few.
            let words = model.words(span).unwrap();
            let parsed = parse(words, &mut Some(LIMITS.tokens));
            assert!(
                parsed.faults.is_empty() && !words.is_empty(),
                "{}: `{words}`: {:?}",
                path.display(),
                parsed.faults
            );
        }
    }
}

#[test]
fn spans_account_for_escapes() {
    let text = r#"{"name": "m", "coordinates": ["x"], "channels": ["phi"], "parameters": {"a": {"start": 1}},
        "model": {"intensity": "\u0061 * x"}}"#;
    let model = Model::from_json(text).unwrap();
    let words: Vec<&str> = spans(&written(&model)).iter().map(|span| model.words(*span).unwrap()).collect();
    assert_eq!(words, [r"\u0061 * x", r"\u0061 * x", r"\u0061", "x"]);
}
