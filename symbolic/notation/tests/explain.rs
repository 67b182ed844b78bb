//! Output of `explain` in each notation: snapshot files, well-formed XML, distinct typesetting of names.
//! `UPDATE_EXPECT=1 cargo test -p isophote-notation --test explain` rewrites the snapshots.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../../tests/common/mod.rs"]
mod common;

use std::path::Path;

use common::expect;
use isophote_notation::{Show, explain};
use isophote_symbolic::{Method, Model, ParameterId};

fn explained(model: &Model, parameters: &[ParameterId], show: Show) -> String {
    explain(&model.objective(parameters, Method::Newton).unwrap(), show)
}

fn shipped() -> Vec<Model> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap()).collect()
}

/// A model of one formula over `x`, `y`, a channel `phi` and parameters of these names.
fn model(names: &str, intensity: &str) -> Model {
    let parameters: String = names.split(' ').map(|name| format!("{name} = {{ start = 1.0 }}\n")).collect();
    Model::from_toml(&format!(
        "name = \"m\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{parameters}[model]\nintensity = \"{intensity}\"\n"
    ))
    .unwrap()
}

fn all(model: &Model) -> Vec<ParameterId> {
    model.parameters().iter().map(|p| model.parameter(&p.name).unwrap()).collect()
}

#[test]
fn thesis_spot_matches_its_snapshots() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("../../models/thesis-spot.toml")).unwrap();
    let spot = Model::from_toml(&text).unwrap();
    let centre = [spot.parameter("bx").unwrap(), spot.parameter("by").unwrap()];
    for (show, name) in [(Show::Derivative, "txt"), (Show::Latex, "tex"), (Show::MathMl, "mathml")] {
        let text = explained(&spot, &centre, show);
        let expected = root.join("tests/explained/thesis-spot").with_extension(name);
        expect(&expected, &text);
    }
}

#[test]
fn spans_point_into_the_document() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("../../models/thesis-spot.toml")).unwrap();
    let spot = Model::from_toml(&text).unwrap();
    let shown = explained(&spot, &[spot.parameter("bx").unwrap()], Show::MathMl);
    let places: Vec<&str> = shown.split("data-span=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    let pieces: Vec<&str> = places
        .iter()
        .map(|place| {
            let (start, end) = place.split_once('-').unwrap();
            &text[start.parse().unwrap()..end.parse().unwrap()]
        })
        .collect();
    for piece in ["x - bx", "k[i] * s^i", "X' * A * X", "v0 + v1 * f"] {
        assert!(pieces.contains(&piece), "{piece} is not among {pieces:?}");
    }
    assert!(!pieces.contains(&"s <= 1"), "the domain is in no derivative: {pieces:?}");
}

#[test]
fn names_are_typeset_distinctly() {
    let shown = |names: &str, intensity: &str, show| {
        let model = model(names, intensity);
        explained(&model, &all(&model), show)
    };
    let latex = shown("bx beta1 wide a_1 a1 a01 nu sigmay", "bx*beta1*wide*a_1*a1*a01*nu*sigmay*x", Show::Latex);
    for look in
        ["b_{x}", "\\beta_{1}", "\\mathrm{wide}", "\\mathrm{a\\_1}", "a_{1}", "a_{01}", "\\mathrm{nu}", "\\sigma_{y}"]
    {
        assert!(latex.contains(look), "no {look} in {latex}");
    }
    // Generated names avoid the document's.
    let text = shown("t0 S1 F", "t0 * exp(S1 * x^2) + F", Show::Derivative);
    assert!(text.contains("tt0 = ") && text.contains("FF = SS0") && text.contains("dFF/dF"), "{text}");
    let latex = shown("t0 S1 F", "t0 * exp(S1 * x^2) + F", Show::Latex);
    assert!(latex.contains("\\mathrm{tt}_{0} &="), "{latex}");
}

#[test]
fn conditions_roots_and_powers_render_in_latex() {
    let model = model("a b c", "if(x < a, sqrt(abs(b*x)), if(x < 2*a and y > 1e-9, -3, 2^(c*x))) / (x^2 + 1)");
    let latex = explained(&model, &all(&model), Show::Latex);
    for piece in ["\\begin{cases}", "\\text{if } x < a", "\\text{otherwise}", "\\sqrt{", "10^{-9}", "\\land", "\\frac{"]
    {
        assert!(latex.contains(piece), "no {piece} in {latex}");
    }
    assert!(latex.starts_with("\\begin{align*}\n") && latex.ends_with("\\end{align*}\n"));
    braces(&latex);
}

#[test]
fn every_shipped_model_is_well_formed() {
    for model in shipped() {
        let parameters: Vec<ParameterId> = model.stages()[0].parameters.clone();
        // Some exceed the limits with second derivatives; these use the document's own method.
        let own = model.stages()[0].method;
        let objective = model.objective(&parameters, Method::Newton);
        let objective = objective.or_else(|_| model.objective(&parameters, own)).unwrap();
        let mathml = explain(&objective, Show::MathMl);
        assert!(mathml.lines().all(|line| line.starts_with("<math display=\"block\"") && line.ends_with("</math>")));
        for line in mathml.lines() {
            well_formed(line);
        }
        braces(&explain(&objective, Show::Latex));
    }
}

/// Braces, and `\left` with `\right`, match on each row; `%` only starts comments.
fn braces(latex: &str) {
    for line in latex.lines() {
        let line = line.split(" % ").next().unwrap().replace("\\{", "").replace("\\}", "");
        assert!(line.is_ascii(), "{line}");
        let count = |piece: &str| line.matches(piece).count();
        assert_eq!(count("{"), count("}"), "{line}");
        assert_eq!(count("\\left"), count("\\right"), "{line}");
    }
}

/// One element: tags match, attributes are quoted, no stray `<` or `&`, and fixed arities hold.
fn well_formed(xml: &str) {
    let mut open: Vec<(String, usize)> = vec![("the fragment".into(), 0)];
    let mut rest = xml;
    while let Some(at) = rest.find('<') {
        characters(&rest[..at], &open, xml);
        let end = at + rest[at..].find('>').unwrap_or_else(|| panic!("an open tag in {xml}"));
        let tag = &rest[at + 1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            let (opened, children) = open.pop().unwrap();
            assert_eq!(opened, name, "in {xml}");
            let arity = match name {
                "mfrac" | "msup" | "msub" | "munder" => Some(2),
                "mi" | "mn" | "mo" | "mtext" => Some(0),
                _ => None,
            };
            assert!(arity.is_none_or(|arity| arity == children), "<{name}> of {children} in {xml}");
            continue;
        }
        let (name, attributes) = tag.split_once(' ').unwrap_or((tag, ""));
        assert!(!name.is_empty() && name.bytes().all(|b| b.is_ascii_lowercase()), "<{tag}> in {xml}");
        assert!(attributes.matches('"').count() % 2 == 0, "<{tag}> in {xml}");
        for attribute in attributes.split_terminator("\" ") {
            let (key, value) = attribute.split_once("=\"").unwrap_or_else(|| panic!("<{tag}> in {xml}"));
            assert!(key.bytes().all(|b| b.is_ascii_lowercase() || b == b'-') && !value.contains('<'), "<{tag}>");
        }
        open.last_mut().unwrap().1 += 1;
        open.push((name.to_string(), 0));
    }
    assert!(rest.is_empty() && open.len() == 1 && open[0].1 == 1, "not one element: {xml}");
}

fn characters(text: &str, open: &[(String, usize)], xml: &str) {
    let tokens = ["mi", "mn", "mo", "mtext"];
    assert!(text.is_empty() || tokens.contains(&open.last().unwrap().0.as_str()), "`{text}` stands bare in {xml}");
    let entities = text.matches("&lt;").count() + text.matches("&amp;").count();
    assert_eq!(text.matches('&').count(), entities, "{text}");
}

#[test]
#[should_panic(expected = "in <math><mrow></math>")]
fn unclosed_tag_is_detected() {
    well_formed("<math><mrow></math>");
}

#[test]
#[should_panic(expected = "<mfrac> of 3")]
fn fraction_of_three_is_detected() {
    well_formed("<mfrac><mi>a</mi><mi>b</mi><mi>c</mi></mfrac>");
}
