//! The formula language: values, precedence, shapes, branches, and how faults read.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::interpreter::{Pixels, Slices, Window, run};
use isophote_symbolic::{Bindings, Formula, Lowering, Method, Model, ParameterId, Precision};

#[test]
fn values() {
    // t = 0.75
    let table = [
        ("1 + 2*3 - 4/2", 5.0),
        ("-2^2", -4.0),
        ("2^-1", 0.5),
        ("2^3^2", 512.0),
        ("(1 + t)*2", 3.5),
        ("[1, 2]' * [3, 4]", 11.0),
        ("[[1, 2], [3, 4]][1][0]", 3.0),
        ("[[1, 2], [3, 4]][1, 0]", 3.0),
        ("([[1, 2], [3, 4]] * [5, 6])[1]", 39.0),
        ("[[1, 2], [3, 4]]'[0, 1]", 3.0),
        ("sum(i^2, i, 1, 4)", 30.0),
        ("product(i, i, 1, 5)", 120.0),
        ("sum(i, i, 3, 2)", 0.0),
        ("sum(sum(i*j, j, 0, i), i, 0, 3)", 25.0),
        ("if(t < 1, 2, 3)", 2.0),
        ("if(not (t < 1) or t > 0.9, 2, 3)", 3.0),
        ("piecewise(t > 1, 1, t > 0.5, 2, 3)", 2.0),
        ("min(3, t, 2) + max(1, t)", 1.75),
        ("abs(-t) + sqrt(4)", 2.75),
        ("4^1.5", 8.0),
        ("cos(pi)", -1.0),
        ("atan2(1, -1)", 3.0 * std::f64::consts::FRAC_PI_4),
        ("1e3 + .5", 1000.5),
    ];
    for (formula, expected) in table {
        let value = Formula::parse(formula, &["t"]).unwrap_or_else(|d| panic!("{formula}: {d:?}")).evaluate(&[0.75]);
        assert!((value - expected).abs() <= 1e-14 * expected.abs().max(1.0), "{formula} = {value}, not {expected}");
    }
}

#[test]
fn faults_read_well() {
    let table = [
        ("2t", "bad-number", "write the multiplication"),
        ("t t", "syntax", "no implicit multiplication"),
        ("(1 + t", "syntax", "add `)`"),
        ("T + u1", "unknown-name", "did you mean"),
        ("sinn(t)", "unknown-name", "did you mean `sin`?"),
        ("t ** 2", "syntax", "written `^`"),
        ("[1, 2] * [3, 4]", "shape", "dot product"),
        ("[1, 2] + 1", "shape", "elementwise"),
        ("1 < t < 2", "syntax", "a < b and b < c"),
        ("(t < 1) + 1", "truth-value", "if(condition"),
        ("if(t, 1, 2)", "truth-value", "compare it"),
        ("[1, 2][2]", "bad-range", "index 2"),
        ("sum(t, i, 0, t)", "bad-range", "index of an enclosing"),
        ("exp(1, 2)", "arguments", "exp(x)"),
        ("t(3)", "syntax", "write `*`"),
        ("t $ 2", "syntax", "+ - * / ^"),
    ];
    for (formula, code, words) in table {
        let faults = Formula::parse(formula, &["t"]).err().unwrap_or_else(|| panic!("{formula} was accepted"));
        let text = faults[0].render("formula");
        assert!(faults[0].code == code && text.contains(words), "{formula}: {code}, {words}\n{text}");
        assert!(text.contains("formula:1:") && text.contains('^'), "{text}");
    }
}

#[test]
fn a_diagnostic_names_key_line_column_and_the_near_miss() {
    let text = r#"
name = "spot"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = "centroid.x" }
[model]
intensity = "exp(-(x - bX)^2) + y*q"
"#;
    let faults = Model::from_toml(text).unwrap_err();
    let found: Vec<_> =
        faults.iter().map(|d| (d.key.as_str(), d.line, d.column, d.help.clone().unwrap_or_default())).collect();
    assert_eq!(found, [("model.intensity", 8, 24, "did you mean `bx`?".to_string())]);
    assert_eq!(&text[faults[0].span.start as usize..faults[0].span.end as usize], "bX");
}

#[test]
fn toml_and_json_give_the_same_model() {
    let toml = "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\np = { start = 0.5 }\n[model]\nintensity = \"p*x\"\n";
    let json = r#"{"channels":["phi"],"name":"m","coordinates":["x"],"parameters":{"p":{"start":0.5}},"model":{"intensity":"p\u002ax"}}"#;
    let (a, b) = (Model::from_toml(toml).unwrap(), Model::from_json(json).unwrap());
    assert_eq!(a.digest(), b.digest());
    assert_eq!(a.document(), b.document());
    let json = json.replace("p\\u002ax", "p\\u002ay");
    let fault = &Model::from_json(&json).unwrap_err()[0];
    assert_eq!(&json[fault.span.start as usize..fault.span.end as usize], "y");
}

struct Flat;
impl Pixels for Flat {
    fn at(&self, _: usize, _: usize, _: usize) -> f64 {
        1.0
    }
}

/// The branch not taken is singular, to second order; nothing of it may reach the sums.
#[test]
fn no_nan_from_the_branch_not_taken() {
    let formulas = [
        "if(x - b > 0, sqrt(x - b), 0)",
        "if(x < b, 0, (x - b)^1.5*log(x - b + 0.001))",
        "if(abs(x - b) > 2, 1/(x - b), x - b)",
    ];
    for formula in formulas {
        let text = format!(
            "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\nb = {{ start = 5.25 }}\nc = {{ start = 1.0 }}\n[model]\nintensity = \"c*({formula})\"\n"
        );
        let model = Model::from_toml(&text).unwrap();
        let all = [ParameterId(0), ParameterId(1)];
        let program = model.objective(&all, Method::Newton).unwrap().program(Lowering::default()).unwrap();
        let p = [5.25, 1.0];
        let bindings = Bindings { parameters: &p, entry: &p, saturation: &[f64::INFINITY], ..Bindings::default() };
        let out = run(
            &program,
            Precision::F64,
            &bindings,
            &Flat,
            Window { x: 0, y: 0, width: 11, height: 1, slices: Slices::ONE },
            None,
        );
        assert!(out.outputs.iter().all(|v| v.is_finite()), "{formula}: {:?}\n{program}", out.outputs);
    }
}

/// Rounding of bx to f32 must not limit the fit: x − bx is exact to f32 of the difference.
#[test]
fn offsets_are_taken_in_f64() {
    let text = "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\nb = { start = 1.0 }\n[model]\nintensity = \"x - b\"\n";
    let model = Model::from_toml(text).unwrap();
    let program = model.rendering(Lowering::default()).unwrap();
    let p = [3_000.123_456_789];
    let bindings = Bindings { parameters: &p, entry: &p, ..Bindings::default() };
    let mut plane = [0.0_f32; 9];
    run(
        &program,
        Precision::F32,
        &bindings,
        &Flat,
        Window { x: 2996, y: 0, width: 9, height: 1, slices: Slices::ONE },
        Some(&mut plane),
    );
    for (i, value) in plane.iter().enumerate() {
        let exact = (2996 + i) as f64 - p[0];
        assert!((f64::from(*value) - exact).abs() < 4e-7, "{i}: {value} against {exact}");
    }
}
