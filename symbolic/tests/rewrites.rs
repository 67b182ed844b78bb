//! The table of rewrites in docs/derivation.md: an example of each, and one where its condition fails.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::interpreter::{self, Pixels, Slices, Window};
use isophote_symbolic::{Bindings, Lanes, Lowering, Method, Model, Objective, Precision, Program, ValueKind};

/// A model of two coordinates over given parameters.
fn model(parameters: &str, intensity: &str, domain: &str) -> Model {
    let parameters: String = parameters
        .split(' ')
        .map(|p| match p.strip_suffix('+') {
            Some(positive) => format!("{positive} = {{ start = 1.25, min = 0 }}\n"),
            None => format!("{p} = {{ start = 0.75 }}\n"),
        })
        .collect();
    let domain = if domain.is_empty() { String::new() } else { format!("domain = \"{domain}\"\n") };
    let text = format!(
        "name = \"rewrites\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{parameters}[model]\nintensity = \"{intensity}\"\n{domain}"
    );
    Model::from_toml(&text).unwrap_or_else(|faults| panic!("{}", faults[0].render("model")))
}

fn program(model: &Model, subset: &str, method: Method) -> Program {
    let subset: Vec<_> = subset.split(' ').map(|p| model.parameter(p.trim_end_matches('+')).unwrap()).collect();
    let objective = model.objective(&subset, method).unwrap();
    assert!(objective.proof().unwrap().exact);
    objective.program(Lowering { fma: true, drop_saturated: false }).unwrap()
}

/// Flops a pixel and sums kept, F included.
fn cost(parameters: &str, intensity: &str) -> (u32, u32) {
    let cost = program(&model(parameters, intensity, ""), parameters, Method::Newton).cost();
    (cost.flops_per_pixel, cost.accumulators)
}

/// The part of a program's text that is done for every pixel.
fn pixel_level(parameters: &str, intensity: &str) -> String {
    let text = program(&model(parameters, intensity, ""), parameters, Method::GaussNewton).to_string();
    let (_, pixel) = text.split_once("pixel:\n").unwrap();
    pixel.split_once("row end:").unwrap().0.to_string()
}

fn count(text: &str, what: &str) -> usize {
    text.matches(what).count()
}

/// Name, and the check of its example and counterexample.
const REWRITES: [(&str, fn()); 18] = [
    ("collect", || assert_eq!(cost("a b", "3*a*x + b + 2*a*x"), cost("a b", "5*a*x + b"))),
    ("powers", || assert_eq!(cost("a b", "a*x^2*x^3 + b"), cost("a b", "a*x^5 + b"))),
    ("roots", || {
        let text = pixel_level("a b+", "a*(b + x^2)^2.5");
        assert!(count(&text, "sqrt") == 1 && count(&text, "pow") == 0, "{text}");
        assert_eq!(count(&pixel_level("a b+", "a*(b + x^2)^2.6"), "pow"), 1);
    }),
    ("polynomials", || {
        let s = "((x - c)^2 + y^2)";
        let horner = cost("a b c", &format!("{s}*(a + {s}*(b + {s}))"));
        assert_eq!(horner, cost("a b c", &format!("a*{s} + b*{s}^2 + {s}^3")));
    }),
    ("gather", || {
        assert_eq!(cost("a v+", "v + v*a*x + v*a^2*x^2"), cost("a v+", "v*(1 + a*x + a^2*x^2)"));
    }),
    ("absorb", || {
        // The factor 7 costs nothing in the sum that has coefficients, and one flop where every term would pay.
        assert_eq!(cost("a b", "7*(a*x + b*x^2)"), cost("a b", "a*x + b*x^2"));
    }),
    ("unify", || {
        let intensity = "d + v*(1 - 0.5*(a*(x - c)^2 + y^2) - 0.3*(a*(x - c)^2 + y^2)^2)";
        let ((unified, _), (plain, _)) = (cost("a c d v+", intensity), cost("a c d v", intensity));
        assert!(unified < plain, "{unified} against {plain}");
    }),
    ("power rule", || {
        let text = pixel_level("a+ b", "(a + x^2)^b");
        assert!(count(&text, "pow") == 1 && count(&text, "log") == 1, "{text}");
    }),
    ("cut", || {
        // One cut: L and Q times 1, d, d².
        let s = "(a*((x - b)^2 + y^2))";
        assert_eq!(
            cost("b a+", &format!("exp(-{s}) + {s}^3 + tanh({s})")).1,
            cost("b a+", &format!("exp(-{s})*tanh({s})")).1
        );
    }),
    ("expand", || {
        let text = pixel_level("b", "(x - b)^2*y + (x - b)*y^2");
        assert_eq!(count(&text, "x + "), 1, "{text}");
    }),
    ("rank", || {
        // ∂r/∂a = t, ∂r/∂b = 1 − t²; with 1 and t² summed, t⁴ … are new, 1 − t² is not.
        let of = |intensity: &str| {
            let model = model("a b c", intensity, "");
            program(&model, "a b c", Method::GaussNewton).cost().accumulators
        };
        assert!(of("a*tanh(x) + b*tanh(x)^2 + c*(1 - tanh(x)^2)") < of("a*tanh(x) + b*tanh(x)^2 + c*cos(x)^2"));
    }),
    ("features", || {
        let of = |parameters: &str, intensity: &str| {
            let model = model(parameters, intensity, "");
            program(&model, parameters, Method::GaussNewton).cost().accumulators
        };
        let (near, far) = ("tanh((x - b)^2)", "tanh((x - b - 1)^2)");
        assert_eq!(of("a b", &format!("a*{near}")), of("a b", &format!("a*({near} + {far})")));
        // Where a and c take different parts, both are features.
        assert!(of("a b", &format!("a*({near} + {far})")) < of("a b c", &format!("a*{near} + c*{far}")));
    }),
    ("vertex", || {
        let of = |parameters: &str| {
            let s = "(a*(x - c)^2 + 2*b*(x - c)*y + d*y^2)";
            let model = model(parameters, &format!("1 - 0.4*{s} - 0.3*{s}^2"), "");
            program(&model, "c", Method::Newton).cost().flops_per_pixel
        };
        assert!(of("a+ b c d") < of("a b c d"));
    }),
    ("bounds", || {
        let is_bounded = |parameters: &str, domain: &str| {
            let model = model(parameters, "a*x + b", domain);
            let set = *program(&model, "b", Method::Newton).pixel_set();
            assert_ne!(set.bounds.is_some(), set.mask.is_some());
            set.bounds.is_some()
        };
        assert!(is_bounded("a+ b", "a*x^2 + b*x*y <= 9"));
        assert!(!is_bounded("a b", "a*x^2 + b*x*y <= 9"));
        assert!(!is_bounded("a+ b", "a*x^2 <= if(x > 2, 30, 1)"));
    }),
    ("reciprocal", || {
        let text = pixel_level("a b+", "a/(b + x^2) + 1/(b + x^2)^2 + x/(b + x^2)^3");
        assert_eq!(count(&text, " / "), 1, "{text}");
    }),
    ("choice", || {
        assert_eq!(count(&pixel_level("a c+", "a/if(x > 3, c, 2)"), " / "), 0);
        assert_eq!(count(&pixel_level("a c+", "a/if(x > 3, x, 2)"), " / "), 1);
    }),
    ("share", || {
        let shared = cost("a", "a + y^2*(tanh(x) + tanh(2*x))");
        assert_eq!(cost("a", "a + y^2*tanh(x) + y^2*tanh(2*x)"), shared);
        assert!(cost("a", "a + y^2*tanh(x) + y^3*tanh(2*x)") > shared);
    }),
    ("contract", || {
        let model = model("a b", "a*x + b", "");
        let objective = model.objective(&[model.parameter("a").unwrap()], Method::Newton).unwrap();
        let of = |fma: bool| objective.program(Lowering { fma, drop_saturated: false }).unwrap();
        assert!(of(true).to_string().contains("fma(") && !of(false).to_string().contains("fma("));
        assert_eq!(of(true).cost().flops_per_pixel, of(false).cost().flops_per_pixel);
    }),
];

#[test]
fn every_rewrite_does_what_its_row_says() {
    for (name, check) in REWRITES {
        let outcome = std::panic::catch_unwind(check);
        assert!(outcome.is_ok(), "{name}");
    }
}

/// q − t·q: what is subtracted from is a factor of what is subtracted.
#[test]
fn contraction_keeps_signs_where_the_minuend_is_a_factor() {
    let text = "name = \"q\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\np = { start = 0.5 }\n\
        [definitions]\nu = \"sin(p*x)\"\nw = \"cos(p*x)\"\nt = \"tanh(x/20 + y/30)\"\nq = \"u + w\"\ns = \"t*u + t*w\"\n\
        [model]\nintensity = \"q - s\"\n";
    let model = Model::from_toml(text).unwrap();
    let sums = |fma: bool, objective: &Objective| {
        let program = objective.program(Lowering { fma, drop_saturated: false }).unwrap();
        let bindings = Bindings { parameters: &[0.5], entry: &[0.5], saturation: &[255.0], ..Bindings::default() };
        let window = Window { x: 0, y: 0, width: 9, height: 5, slices: Slices::ONE };
        interpreter::run(&program, Precision::F64, Lanes::Two, &bindings, &Flat, window, None).outputs
    };
    for objective in [
        model.value_objective(ValueKind::Entry).unwrap(),
        model.objective(&[model.parameter("p").unwrap()], Method::Newton).unwrap(),
    ] {
        for (with, without) in sums(true, &objective).into_iter().zip(sums(false, &objective)) {
            assert!((with - without).abs() <= 1e-12 * without.abs().max(1.0), "{with} {without}");
        }
    }
}

struct Flat;
impl Pixels for Flat {
    fn at(&self, _: usize, x: usize, y: usize) -> f64 {
        (3 * x + 5 * y) as f64
    }
}

#[test]
fn the_documented_table_is_this_one() {
    let text = include_str!("../../docs/derivation.md");
    let (_, table) = text.split_once("| rewrite | from | to | condition |").unwrap();
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    let names: Vec<&str> = rows.map(|row| row.split('|').nth(1).unwrap().trim()).collect();
    assert_eq!(names, REWRITES.map(|(name, _)| name));
}
