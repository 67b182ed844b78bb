//! Documents that try to cost more than they should: each ends in a diagnostic that names the bound.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::{Diagnostic, Method, Model, ParameterId};

fn document(parameters: usize, definitions: &[String], intensity: &str) -> String {
    let parameters: String = (0..parameters).map(|i| format!("p{i} = {{ start = 1.5 }}\n")).collect();
    let definitions: String = definitions.iter().enumerate().map(|(i, d)| format!("d{i} = \"{d}\"\n")).collect();
    format!(
        "name = \"bomb\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{parameters}[definitions]\n{definitions}[model]\nintensity = \"{intensity}\"\n"
    )
}

/// Reads, and derives for every parameter; what stops it.
fn stopped(text: &str) -> Vec<Diagnostic> {
    let model = match Model::from_toml(text) {
        Ok(model) => model,
        Err(faults) => return faults,
    };
    let all: Vec<ParameterId> = (0..model.parameters().len() as u32).map(ParameterId).collect();
    model.objective(&all, Method::Newton).and_then(|o| o.program(Default::default())).err().unwrap_or_default()
}

fn assert_limit(name: &str, text: &str) {
    let faults = stopped(text);
    assert!(faults.iter().any(|d| d.code == "limit" && d.line >= 1 && !d.message.is_empty()), "{name}: {faults:?}");
}

#[test]
fn bombs_end_in_a_limit() {
    let squaring: Vec<String> =
        (0..100).map(|i| if i == 0 { "x*p0 + p1".into() } else { format!("d{}^2 + d{}*p0", i - 1, i - 1) }).collect();
    let fraction = (0..40).fold("x".to_string(), |inner, i| format!("p{} + 1/({inner})", i % 40));
    let factors: Vec<String> = (0..64).map(|i| format!("(x + p{i} + y*p{})", (i * 7 + 3) % 64)).collect();
    assert_limit("parentheses", &document(1, &[], &format!("{}p0{}", "(".repeat(30_000), ")".repeat(30_000))));
    assert_limit("brackets", &document(1, &[], &"[".repeat(60_000)));
    assert_limit("minus", &document(1, &[], &format!("{}p0", "-".repeat(60_000))));
    assert_limit("nested sums", &document(1, &[], "sum(sum(sum(p0*x^i*j*k, i, 0, 900), j, 0, 900), k, 0, 900)"));
    assert_limit("long sum", &document(1, &[], "sum(p0*x, i, 0, 100000000)"));
    assert_limit("product of 64 factors", &document(64, &[], &factors.join("*")));
    assert_limit("document", &document(1, &[], &"p0 + ".repeat(20_000)));
    assert_limit("tokens", &document(1, &[], &format!("p0{}", "+1".repeat(5000))));
    // Fraction and squaring are honest mathematics: admitted or refused, never a hang or a panic.
    for (name, text) in [("fraction", document(40, &[], &fraction)), ("squaring", document(2, &squaring, "d99"))] {
        let faults = stopped(&text);
        assert!(faults.iter().all(|d| d.code == "limit"), "{name}: {faults:?}");
    }
}

#[test]
fn recursion_of_functions_is_bounded() {
    let text = document(1, &[], "p0")
        .replace("[definitions]", "[definitions]\n\"f(t)\" = \"g(t) + 1\"\n\"g(t)\" = \"f(t)*2\"");
    let faults = stopped(&text);
    assert!(faults.iter().any(|d| d.code == "cycle"), "{faults:?}");
}
