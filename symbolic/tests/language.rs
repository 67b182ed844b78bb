//! The formula language: values, precedence, shapes, branches, and how faults read.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::interpreter::{Pixels, Slices, Window, run};
use isophote_symbolic::{Bindings, Formula, Lanes, Lowering, Method, Model, ParameterId, Precision};

/// Of which of two numbers there is none at a place must not matter, nor in which order they stand.
#[test]
fn min_and_max_leave_out_nan_in_any_order() {
    let at = |formula: &str, x: f64| {
        let text = format!(
            "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\np = {{ start = 1.0 }}\n[model]\nintensity = \"p * {formula}\"\n"
        );
        Model::from_toml(&text).unwrap().predicted(&[x], &[1.0], &[])
    };
    // log(x − 5) is NaN below 5, √(9 − x) above 9.
    let cases = [
        (["log(x - 5)", "1"], 2.0, [1.0, 1.0]),
        (["log(x - 5)", "1"], 6.0, [0.0, 1.0]),
        (["log(x - 5)", "p"], 2.0, [1.0, 1.0]),
        (["log(x - 5)", "sqrt(9 - x)"], 1.0, [8.0_f64.sqrt(), 8.0_f64.sqrt()]),
        (["log(x - 5)", "sqrt(9 - x)"], 6.0, [0.0, 3.0_f64.sqrt()]),
        (["log(x - 5)", "sqrt(9 - x)"], 12.0, [7.0_f64.ln(), 7.0_f64.ln()]),
    ];
    for ([a, b], x, expected) in cases {
        for (name, expected) in ["min", "max"].into_iter().zip(expected) {
            let found = [format!("{name}({a}, {b})"), format!("{name}({b}, {a})")].map(|formula| at(&formula, x));
            assert!(found.iter().all(|found| (found - expected).abs() < 1e-12), "{name}({a}, {b}) at {x}: {found:?}");
        }
        let three = [format!("max({a}, {b}, 0.5)"), format!("max(0.5, {a}, {b})"), format!("max({b}, 0.5, {a})")];
        let found = three.map(|formula| at(&formula, x));
        assert!(
            found.iter().all(|value| (value - expected[1].max(0.5)).abs() < 1e-12),
            "{a}, {b}, 0.5 at {x}: {found:?}"
        );
    }
}

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
        ("2e-3*1E+3", 2.0),
        ("+t - -t", 1.5),
        ("-t^2^0.5 + 2^-2^2", -(0.75_f64.powf(2.0_f64.sqrt())) + 0.0625),
        ("-2^2*3 - -2^2", -8.0),
        ("8/2/2*3", 6.0),
        ("2^3'", 8.0),
        ("tan(t)*cos(t)/sin(t)", 1.0),
        ("asin(sin(t)) + acos(cos(t)) + atan(tan(t))", 2.25),
        ("cosh(t)^2 - sinh(t)^2 + tanh(0) + erf(0)", 1.0),
        ("log(exp(t))", 0.75),
        ("erf(t) + erfc(t) + sinc(0) + bessel_j0(0) + bessel_j1(0)", 3.0),
        ("atan2(0, 0) + atan2(-0, t - 0.75)", 0.0),
        // Vectors and matrices.
        ("([1, 2] + [3, 4] - 2*[1, 1])[1]", 4.0),
        ("([1, 2]/2)[0]", 0.5),
        ("(-[1, 2])[1]", -2.0),
        ("([1, 2]*[3, 4]')[1, 0]", 6.0),
        ("([1, 2]'*[[1, 2], [3, 4]]*[5, 6])", 95.0),
        ("([[1, 2], [3, 4]]*[[0, 1], [1, 0]])[0, 0]", 2.0),
        ("[[1, 2], [3, 4]]'[0][1]", 3.0),
        ("[[1, 2, 3]][0, 2]", 3.0),
        ("[1, 2, 3]'[2] + [1, 2, 3]'[0, 1]", 5.0),
        ("[7][0]", 7.0),
        ("[1, 2][1 - 1]", 1.0),
        ("if(t < 1, [1, 2], [3, 4])[1]", 2.0),
        // Sums and products.
        ("sum(i*t, i, -2, 2)", 0.0),
        ("sum(t, i, 1, 10)", 7.5),
        ("product(2*t, i, 1, 3)", 3.375),
        ("product(i, i, 3, 2)", 1.0),
        ("sum([i, i^2], i, 1, 3)' * [1, 1]", 20.0),
        ("sum([i, 1], i, 3, 2)[0] + 1", 1.0),
        ("product([[1, i], [0, 1]], i, 1, 3)[0, 1]", 6.0),
        ("product([[1, i], [0, 1]], i, 3, 1)[1, 1]", 1.0),
        ("sum([10, 20, 30][i]*[1, 2, 3][2 - i], i, 0, 2)", 100.0),
        ("sum(t^i, i, 0, 1 + 1)", 2.3125),
        ("sum(sum(1, j, 1, i), i, 1, 4)", 10.0),
        ("product(sum(j, j, 0, i), i, 1, 3)", 18.0),
        ("sum(if(i < 2, [1, 2, 3][i + 1], 0), i, 0, 3)", 5.0),
        ("sum(if(i > 0, 1/i, 0), i, 0, 2)", 1.5),
        ("sum(piecewise(i == 0, t, i == 1, 2*t, 0), i, 0, 5)", 2.25),
        ("sum(i, i, 0, 2) + sum(i, i, 0, 2)", 6.0),
        // Conditions.
        ("if(t >= 0.75 and t != 1, 1, 0)", 1.0),
        ("if(not t == 1 and not (t > 1 or t < 0), 1, 0)", 1.0),
        ("if(1 < 2 or t > 5, 1, 0) + if(1 > 2 and t > 5, 1, 0)", 1.0),
        ("min(1, 2) + max(1, t, 3)", 4.0),
        ("sqrt(t^2) + abs(1 - 3)", 2.75),
    ];
    for (formula, expected) in table {
        let value = Formula::parse(formula, &["t"]).unwrap_or_else(|d| panic!("{formula}: {d:?}")).evaluate(&[0.75]);
        assert!((value - expected).abs() <= 1e-14 * expected.abs().max(1.0), "{formula} = {value}, not {expected}");
    }
}

/// Functions of one's own: in each other, of scalars, vectors and matrices, over names of the document.
#[test]
fn functions_of_ones_own() {
    let text = r#"
name = "m"
coordinates = ["x"]
channels = ["phi"]
[parameters]
p = { start = 2.0 }
[definitions]
"twice(t)" = "2*t"
"norm(v)" = "sqrt(v' * v)"
"f(a, b)" = "twice(a) + norm([a, b])*p"
"row(A, i)" = "A[i]"
"poly(k, t)" = "sum(k[i]*t^i, i, 0, 2)"
M = "[[3, 4], [6, 8]]"
n = "7"
[model]
intensity = "p*x + f(3, 4) + norm(row(M, 1)) + norm(twice([0, 1.5])) + poly([1, 2, 3], 2) + n"
"#;
    let model = Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("m")));
    let program = model.rendering(Lowering::default()).unwrap();
    let p = [2.0];
    let bindings = Bindings { parameters: &p, entry: &p, ..Bindings::default() };
    let mut plane = [0.0_f32; 1];
    run(
        &program,
        Precision::F64,
        Lanes::Two,
        &bindings,
        &Flat,
        Window { x: 0, y: 0, width: 1, height: 1, slices: Slices::ONE },
        Some(&mut plane),
    );
    assert_eq!(plane[0], 6.0 + 10.0 + 10.0 + 3.0 + 17.0 + 7.0);
}

#[test]
fn faults_read_well() {
    let table = [
        ("2t", "bad-number", "write the multiplication"),
        ("t t", "syntax", "no implicit multiplication"),
        ("(1 + t", "syntax", "add `)`"),
        ("T + 1", "unknown-name", "did you mean"),
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
        ("2t^2", "bad-number", "`2*t`, not `2t`"),
        ("2(t + 1)", "syntax", "no implicit multiplication"),
        ("(t)(t)", "syntax", "no implicit multiplication"),
        ("sin t", "syntax", "write `sin("),
        ("1.2.3", "bad-number", "finite number"),
        ("1e", "bad-number", "finite number"),
        ("t²", "unknown-name", "`t^2`"),
        ("t ≤ 1", "syntax", "write `<=`"),
        ("t − 1", "syntax", "write `-`"),
        ("t =< 1", "syntax", "`<=`"),
        ("t % 2", "syntax", "no remainder"),
        ("|t|", "syntax", "abs(x)"),
        ("!t", "syntax", "write `not`"),
        ("[1, 2; 3, 4]", "syntax", "[[a, b], [c, d]]"),
        ("(1, 2)", "syntax", "square brackets"),
        ("1, 2", "syntax", "[a, b]"),
        ("1 + 2)", "syntax", "open the bracket"),
        ("[1, 2)", "syntax", "`)` stands where"),
        ("exp(t,)", "syntax", "remove it"),
        ("ln(t)", "unknown-name", "natural logarithm is `log`"),
        ("pow(t, 2)", "unknown-name", "x^y"),
        ("dot(t, t)", "unknown-name", "u' * v"),
        ("Pi", "unknown-name", "did you mean `pi`?"),
        ("sqrtt(t)", "unknown-name", "did you mean `sqrt`?"),
        ("e^t", "unknown-name", "exp(1)"),
        ("[1, 2]^2", "shape", "u' * v"),
        ("1/[1, 2]", "shape", "sqrt(v' * v)"),
        ("[[1, 2], [3]]", "shape", "one length"),
        ("[[1, 2], [3, 4]]*[1, 2, 3]", "shape", "columns of the left"),
        ("[[1, 2], [3, 4]][0, 2]", "bad-range", "count from 0"),
        ("[1, 2][0.5]", "bad-range", "whole number"),
        ("[1, 2][0, 0, 0]", "shape", "[i, j]"),
        ("[]", "shape", "[a, b]"),
        ("sum([1, 2], i, 0, 1)", "shape", "index it"),
        ("sum(t, 0, 3)", "arguments", "sum(e, i, lo, hi)"),
        ("sum(t, 2, 0, 3)", "syntax", "sum(e, i, lo, hi)"),
        ("sum(t, t, 0, 3)", "duplicate", "another name"),
        ("sum(if(i < 1, [1, 2], 3), i, 0, 1)", "shape", "one shape"),
        ("if(t < 1, [1, 2], 3)", "shape", "one shape"),
        ("if(t < 1, 2)", "arguments", "if(condition, a, b)"),
        ("t < 1 < 2 < 3", "syntax", "a < b and b < c"),
        ("1/0", "bad-number", "division by zero"),
        ("log(0)", "bad-number", "logarithm"),
        ("t^65", "limit", "exp(n*log(x))"),
        ("pi(2)", "syntax", "write `*`"),
        ("min(t)", "arguments", "min(a, b)"),
        ("if(t and t < 1, 1, 2)", "truth-value", "compare it"),
    ];
    for (formula, code, words) in table {
        let faults = Formula::parse(formula, &["t"]).err().unwrap_or_else(|| panic!("{formula} was accepted"));
        let text = faults[0].render("formula");
        assert!(faults[0].code == code && text.contains(words), "{formula}: {code}, {words}\n{text}");
        assert!(text.contains("formula:1:") && text.contains('^'), "{text}");
        assert_eq!(faults.len(), 1, "{formula}: one slip, one fault: {faults:?}");
    }
}

/// Reading goes on behind each slip: the codes and columns of all faults of one formula.
#[test]
fn all_faults_of_a_formula() {
    let table: [(&str, &[(&str, u32)]); 16] = [
        ("aa + bb*cc", &[("unknown-name", 1), ("unknown-name", 6), ("unknown-name", 9)]),
        ("aa + aa + aa", &[("unknown-name", 1)]),
        ("t + * 2 - / 3", &[("syntax", 5), ("syntax", 11)]),
        ("2x + 3y", &[("bad-number", 1), ("bad-number", 6)]),
        ("exp(aa, 1) + [1, 2][5]", &[("arguments", 1), ("unknown-name", 5), ("bad-range", 21)]),
        (
            "sum(aa*i, i, 0, 2) + if(t, bb, cc)",
            &[("unknown-name", 5), ("truth-value", 25), ("unknown-name", 28), ("unknown-name", 32)],
        ),
        ("sum(aa, i, 0, bb)", &[("unknown-name", 5), ("unknown-name", 15)]),
        ("sum(aa*i, i, 3, 2)", &[("unknown-name", 5)]),
        ("(aa + (t]", &[("syntax", 1), ("unknown-name", 2), ("syntax", 9)]),
        ("t ** 2 && t || t = 1", &[("syntax", 3), ("syntax", 8), ("syntax", 13), ("syntax", 18)]),
        ("[t, aa; 3] + $ + ([1, 2] + 1)", &[("unknown-name", 5), ("syntax", 7), ("syntax", 14), ("shape", 28)]),
        ("t t t t", &[("syntax", 3)]),
        ("gg(aa, 2t)", &[("unknown-name", 1), ("unknown-name", 4), ("bad-number", 8)]),
        ("([1, 2] + 1) * ([1, 2] * [3, 4]) + 1", &[("shape", 11), ("shape", 26)]),
        (
            "if(t < 1, 1/0, aa) + (t < 1) + (0 < t < 1)",
            &[("bad-number", 11), ("unknown-name", 16), ("truth-value", 22), ("syntax", 39)],
        ),
        ("((((t + (aa", &[("syntax", 9), ("unknown-name", 10)]),
    ];
    for (formula, expected) in table {
        let faults = Formula::parse(formula, &["t"]).unwrap_err();
        let found: Vec<(&str, u32)> = faults.iter().map(|d| (d.code.as_str(), d.column)).collect();
        assert_eq!(found, expected, "{formula}\n{}", faults.iter().map(|d| d.render("formula")).collect::<String>());
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
    let declare = "declare it under [parameters], [constants] or [definitions]";
    let expected =
        [("model.intensity", 8, 24, "did you mean `bx`?".into()), ("model.intensity", 8, 35, declare.to_string())];
    assert_eq!(found, expected);
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
            Lanes::Two,
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
        Lanes::Four,
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
