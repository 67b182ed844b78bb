//! `table("name", s)`: what a document makes of it is the spline through its samples, in every order.
#![allow(clippy::unwrap_used, missing_docs)]

use isophote_symbolic::interpreter::{Pixels, Slices, Window, run};
use isophote_symbolic::{
    Axis, Bindings, Lanes, Lowering, Method, Model, ParameterId, Precision, Sink, Table, ValueKind,
};

const VALUES: [f64; 7] = [0.0, 0.2, 0.9, 1.0, 0.55, 0.1, 0.0];

fn document(formula: &str) -> Model {
    let text = text(formula);
    Model::from_toml(&text).unwrap_or_else(|d| panic!("{}", d.iter().map(|d| d.render("m")).collect::<String>()))
}

fn text(formula: &str) -> String {
    format!(
        r#"
name = "measured"
coordinates = ["x"]
channels = ["phi"]
[tables.psf]
first = -3.0
step = 0.9
values = {VALUES:?}
[tables."a file.csv"]
first = 0
step = 1
values = [[0, 1, 2, 3], [1, 2, 3, 5], [2, 3, 4, 7], [3, 4, 5, 9]]
[parameters]
b = {{ start = 10.3 }}
v = {{ start = 2.0 }}
[model]
intensity = '{formula}'
"#
    )
}

struct Dark;
impl Pixels for Dark {
    fn at(&self, _: usize, _: usize, _: usize) -> f64 {
        0.0
    }
}

/// The sums over one pixel.
fn sums(program: &isophote_symbolic::Program, x: usize, p: &[f64]) -> Vec<f64> {
    assert!(matches!(program.sink(), Sink::Sums { .. }));
    let bindings = Bindings { parameters: p, entry: p, saturation: &[f64::INFINITY], ..Bindings::default() };
    run(
        program,
        Precision::F64,
        Lanes::Two,
        &bindings,
        &Dark,
        Window { x, width: 1, height: 1, slices: Slices { first: [0, 0], count: [1, 1] }, y: 0 },
        None,
    )
    .outputs
}

#[test]
fn its_value_and_slopes_are_the_splines() {
    let model = document("v * table(\"psf\", x - b)");
    let table = Table::through(&[Axis { first: -3.0, step: 0.9, count: 7 }], &VALUES).unwrap();
    let lowering = Lowering { fma: false, drop_saturated: false };
    let value = model.value_objective(ValueKind::Full).unwrap().program(lowering).unwrap();
    let all = [ParameterId(0), ParameterId(1)];
    let newton = model.objective(&all, Method::Newton).unwrap().program(lowering).unwrap();
    assert!(newton.looks_up());
    for i in 0..400 {
        let b = 8.0 + 0.01 * f64::from(i);
        let p = [b, 2.0];
        let at = |b: f64| 2.0 * table.value(&[10.0 - b]);
        let f = sums(&value, 10, &p)[0];
        assert!((f - at(b).powi(2)).abs() < 1e-12, "{b}: {f} {}", at(b).powi(2));
        let found = sums(&newton, 10, &p);
        let h = 1e-5;
        let slope = (at(b + h).powi(2) - at(b - h).powi(2)) / (2.0 * h);
        assert!((found[1] - slope).abs() < 1e-7, "{b}: {} {slope}", found[1]);
        // At a knot the third derivative jumps.
        let bend = (at(b + h).powi(2) - 2.0 * at(b).powi(2) + at(b - h).powi(2)) / (h * h);
        assert!((found[3] - bend).abs() < 1e-3, "{b}: {} {bend}", found[3]);
    }
}

#[test]
fn far_out_and_at_what_is_no_number_it_is_level_or_nothing() {
    let model = document("v * table(psf, x - b) + table(\"a file.csv\", x, b)");
    let lowering = Lowering { fma: false, drop_saturated: false };
    let newton = model.objective(&[ParameterId(0)], Method::Newton).unwrap().program(lowering).unwrap();
    for b in [-1e300, -50.0, 50.0, 1e300] {
        let found = sums(&newton, 10, &[b, 2.0]);
        assert_eq!(found[1..], [0.0, 0.0], "{b}");
        assert!((found[0] - if b < 0.0 { 9.0 } else { 81.0 }).abs() < 1e-12, "{b}: {found:?}");
    }
    assert!(sums(&newton, 10, &[f64::NAN, 2.0])[0].is_nan());
}

#[test]
fn samples_are_a_part_of_the_digest() {
    let [one, other] = ["0.55", "0.56"].map(|sample| {
        let text = text("v * table(\"psf\", x - b)").replace("0.55", sample);
        Model::from_toml(&text).unwrap().digest().to_string()
    });
    assert_ne!(one, other);
}

#[test]
fn a_table_may_be_as_large_as_the_limits_say() {
    let of = |count: usize| {
        let values = vec!["1.25"; count].join(",");
        let old = format!("{VALUES:?}");
        text("v * table(\"psf\", x - b)").replace(&old, &format!("[{values}]"))
    };
    // Those of the other table count as well.
    let most = isophote_symbolic::LIMITS.samples - 16;
    assert!(Model::from_toml(&of(most)).is_ok());
    let faults = Model::from_toml(&of(most + 1)).map(|_| ()).unwrap_err();
    assert_eq!(faults[0].code, "limit");
}

#[test]
fn places_that_are_too_large_for_numbers_are_a_fault() {
    let faults = |text: &str| Model::from_toml(text).map(drop).unwrap_err();
    let steep = faults(&text("v*table(\"psf\", x/10)").replace("step = 0.9", "step = 1e-310"));
    assert_eq!((steep[0].code.as_str(), steep[0].key.as_str()), ("bad-number", "tables.psf.step"), "{steep:?}");
    let far =
        faults(&text("v*table(\"psf\", x/10)").replace("first = -3.0\nstep = 0.9", "first = 1e300\nstep = 1e-10"));
    assert_eq!((far[0].code.as_str(), far[0].key.as_str()), ("bad-number", "tables.psf.step"), "{far:?}");
    let scaled = faults(&text("v*table(\"psf\", 1e300*x)").replace("step = 0.9", "step = 1e-10"));
    assert_eq!((scaled[0].code.as_str(), scaled[0].key.as_str()), ("bad-number", "model.intensity"), "{scaled:?}");
    // Nor may a sum that a product takes in.
    let hidden = faults(&text("v*sum(1e308*i*x + i, i, 1, 10)"));
    assert_eq!(hidden[0].code, "bad-number", "{hidden:?}");
}
