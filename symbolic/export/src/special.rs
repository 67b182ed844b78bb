//! Functions that a language's library lacks; the file contains those that a program calls.

use isophote_symbolic::{Function1, Instruction, Opcode};

use crate::body::Statements;
use crate::lines::File;
use crate::options::{ExportSubject, Language};

/// A function's text in both languages, and the program functions that need it.
struct Special {
    of: &'static [Function1],
    c: &'static str,
    rust: &'static str,
}

const SPECIAL: [Special; 4] = [
    Special {
        of: &[Function1::Erf, Function1::Erfc],
        c: "",
        rust: "\
/// erf: a series of terms of one sign near 0, beyond from erfc.
#[allow(dead_code)]
fn erf(x: f64) -> f64 {
    let t = x.abs();
    if t < 3.0 {
        let (mut term, mut sum) = (t, t);
        for n in 1..80 {
            term *= 2.0 * t * t / f64::from(2 * n + 1);
            sum += term;
        }
        return (2.0 / core::f64::consts::PI.sqrt() * (-t * t).exp() * sum).copysign(x);
    }
    if x.is_nan() { x } else { (1.0 - erfc(t)).copysign(x) }
}

/// erfc: 1 - erf up to 1, a continued fraction beyond.
#[allow(dead_code)]
fn erfc(x: f64) -> f64 {
    if x < 1.0 {
        return 1.0 - erf(x);
    }
    let mut fraction = x;
    for n in (1..200).rev() {
        fraction = x + f64::from(n) / 2.0 / fraction;
    }
    (-x * x).exp() / core::f64::consts::PI.sqrt() / fraction
}
",
    },
    Special {
        of: &[Function1::BesselJ0, Function1::BesselJ1, Function1::BesselRatio1, Function1::BesselRatio2],
        c: "\
#ifndef BESSEL_RATIO
#define BESSEL_RATIO
/* J_n(x) / x^n, n = 0, 1 or 2: by its series, by recurrence from far above, by Hankel's series. */
static double bessel_ratio(int n, double x) {
    const double a = fabs(x), quarter = a * a / 4.0;
    double j[3] = { 1.0, 0.5, 0.125 };
    if (isnan(x)) return x;
    if (isinf(x)) return 0.0;
    if (a < 1.0) {
        double term = j[n], total = term;
        for (int k = 1; k < 20; k++) {
            term *= -quarter / (k * (k + n));
            total += term;
        }
        return total;
    }
    if (a < 40.0) {
        double above = 0.0, value = 1e-200, total = 0.0;
        for (int k = 120; k > 0; k--) {
            const double below = 2.0 * k / a * value - above;
            if (k % 2 == 0) total += 2.0 * value;
            above = value;
            value = below;
        }
        j[0] = value / (total + value);
        j[1] = above / (total + value);
    } else {
        for (int order = 0; order < 2; order++) {
            double p = 1.0, q = 0.0, term = 1.0;
            for (int k = 1; k < 20; k++) {
                const double odd = 2.0 * k - 1.0;
                term *= (4.0 * order - odd * odd) / (8.0 * k) / a;
                if (k % 2 == 1) q += k % 4 < 2 ? term : -term;
                else p += k % 4 < 2 ? term : -term;
            }
            j[order] = order == 0 ? (p + q) * cos(a) + (p - q) * sin(a) : (p + q) * sin(a) - (p - q) * cos(a);
            j[order] *= 0.56418958354775628695 / sqrt(a);
        }
    }
    if (n == 0) return j[0];
    return n == 1 ? j[1] / a : (2.0 * j[1] / a - j[0]) / a / a;
}
#endif
",
        rust: "\
/// J_n(x) / x^n, n = 0, 1 or 2: by its series, by recurrence from far above, by Hankel's series.
fn bessel_ratio(n: usize, x: f64) -> f64 {
    let a = x.abs();
    let mut j = [1.0, 0.5, 0.125];
    if x.is_nan() || x.is_infinite() {
        return if x.is_nan() { x } else { 0.0 };
    }
    if a < 1.0 {
        let (mut term, mut total) = (j[n], j[n]);
        for k in 1..20 {
            term *= -a * a / 4.0 / (k * (k + n)) as f64;
            total += term;
        }
        return total;
    }
    if a < 40.0 {
        let (mut above, mut value, mut total) = (0.0, 1e-200, 0.0);
        for k in (1..=120).rev() {
            let below = f64::from(2 * k) / a * value - above;
            if k % 2 == 0 {
                total += 2.0 * value;
            }
            (above, value) = (value, below);
        }
        (j[0], j[1]) = (value / (total + value), above / (total + value));
    } else {
        let (sin, cos) = a.sin_cos();
        for order in 0..2 {
            let (mut p, mut q, mut term) = (1.0, 0.0, 1.0);
            for k in 1..20 {
                let odd = f64::from(2 * k - 1);
                term *= (4.0 * order as f64 - odd * odd) / f64::from(8 * k) / a;
                let part = if k % 4 < 2 { term } else { -term };
                if k % 2 == 1 { q += part } else { p += part }
            }
            let wave = if order == 0 { (p + q) * cos + (p - q) * sin } else { (p + q) * sin - (p - q) * cos };
            j[order] = wave / (core::f64::consts::PI * a).sqrt();
        }
    }
    match n {
        0 => j[0],
        1 => j[1] / a,
        _ => (2.0 * j[1] / a - j[0]) / a / a,
    }
}
",
    },
    Special {
        of: &[Function1::Sinc, Function1::SincRatio],
        c: "\
#ifndef SINC_RATIO
#define SINC_RATIO
/* sin(x) / x for n = 0; (sin(x) / x - cos x) / x^2 for n = 1. */
static double sinc_ratio(int n, double x) {
    const double value = x == 0.0 ? 1.0 : sin(x) / x;
    double term = 1.0 / 3.0, total = term;
    if (isinf(x)) return 0.0;
    if (n == 0) return value;
    if (!(fabs(x) < 2.0)) return (value - cos(x)) / x / x;
    for (int k = 1; k < 20; k++) {
        term *= -x * x / (2.0 * k * (2.0 * k + 3.0));
        total += term;
    }
    return total;
}
#endif
",
        rust: "\
/// sin(x) / x for n = 0; (sin(x) / x - cos x) / x^2 for n = 1.
fn sinc_ratio(n: usize, x: f64) -> f64 {
    if x.is_infinite() {
        return 0.0;
    }
    let value = if x == 0.0 { 1.0 } else { x.sin() / x };
    if n == 0 || !(x.abs() < 2.0) {
        return if n == 0 { value } else { (value - x.cos()) / x / x };
    }
    let (mut term, mut total) = (1.0 / 3.0, 1.0 / 3.0);
    for k in 1..20 {
        let k = f64::from(k);
        term *= -x * x / (2.0 * k * (2.0 * k + 3.0));
        total += term;
    }
    total
}
",
    },
    Special {
        of: &[Function1::Fraction],
        c: "\
#ifndef FRACTION
#define FRACTION
/* How far x is from the whole number below. */
static double fraction(double x) {
    return fabs(x) > 2251799813685248.0 ? 0.0 : x - floor(x);
}
#endif
",
        rust: "\
/// How far x is from the whole number below.
fn fraction(x: f64) -> f64 {
    if x.abs() > 2251799813685248.0 { 0.0 } else { x - x.floor() }
}
",
    },
];

/// Writes the tables that a program reads: their numbers, and a function that finds the cell.
fn tables(file: &mut File, source: &ExportSubject<'_>) {
    let is_read = |i: usize| {
        let reads = |x: &Instruction| matches!(x.op.code, Opcode::Gather(lookup) if usize::from(lookup.table) == i);
        source.program.instructions().iter().any(reads)
    };
    for (i, table) in source.program.tables().all().iter().enumerate().filter(|(i, _)| is_read(*i)) {
        let (numbers, coefficients) = (table.numbers(), table.coefficients());
        let (name, count, axes) = (&source.name, numbers.len(), table.axes());
        let (width, last) = (axes[0].cells(), axes[0].count - 1);
        let rows = axes.get(1).map(|axis| axis.count - 1);
        let is_c = source.options.language == Language::C;
        file.line(&match is_c {
            true => format!("static const double {name}_numbers_{i}[{count}] = {{"),
            false => format!("static NUMBERS_{i}: [f64; {count}] = ["),
        });
        for line in numbers.chunks(coefficients) {
            let line: Vec<String> = line.iter().map(|x| format!("{x:?}")).collect();
            file.line(&format!("    {},", line.join(", ")));
        }
        file.line(if is_c { "};" } else { "];" });
        let body = if is_c { TABLE_C } else { TABLE_RUST };
        let row = match (rows, is_c) {
            (None, _) => "0".to_string(),
            (Some(last), true) => format!("cell_of(b, {last}.0)").replace("cell_of", &format!("{name}_cell_{i}")),
            (Some(last), false) => format!("cell(b, {last}.0)"),
        };
        let marks = [
            ("NAME", name.clone()),
            ("NUMBER", i.to_string()),
            ("ROW", row),
            ("LAST", format!("{last}.0")),
            ("WIDTH", width.to_string()),
            ("COEFFICIENTS", coefficients.to_string()),
        ];
        let body = marks.iter().fold(body.to_string(), |body, (mark, text)| body.replace(&format!("@{mark}@"), text));
        body.lines().for_each(|line| file.line(line));
        file.line("");
    }
}

const TABLE_C: &str = "\
static size_t @NAME@_cell_@NUMBER@(double t, double last) {
    return t >= 0.0 ? 1 + (size_t)(t < last ? t : last) : 0;
}
static double @NAME@_table_@NUMBER@(size_t coefficient, double a, double b) {
    const size_t column = @NAME@_cell_@NUMBER@(a, @LAST@), row = @ROW@;
    (void)b;
    return @NAME@_numbers_@NUMBER@[(row * @WIDTH@ + column) * @COEFFICIENTS@ + coefficient];
}
#undef table_@NUMBER@
#define table_@NUMBER@ @NAME@_table_@NUMBER@";

const TABLE_RUST: &str = "\
#[allow(unused_variables)]
fn table_@NUMBER@(coefficient: usize, a: f64, b: f64) -> f64 {
    let cell = |t: f64, last: f64| if t >= 0.0 { 1 + t.min(last) as usize } else { 0 };
    let (column, row) = (cell(a, @LAST@), @ROW@);
    NUMBERS_@NUMBER@[(row * @WIDTH@ + column) * @COEFFICIENTS@ + coefficient]
}";

/// Writes the functions that a program calls.
pub(super) fn functions(file: &mut File, statements: &Statements<'_>, language: Language) {
    let instructions = statements.program().instructions().iter().zip(&statements.live);
    let called: Vec<Function1> = instructions
        .filter(|(_, live)| **live)
        .filter_map(|(x, _)| match x.op.code {
            Opcode::Call1(f) => Some(f),
            _ => None,
        })
        .collect();
    for special in SPECIAL.iter().filter(|special| special.of.iter().any(|f| called.contains(f))) {
        let text = if language == Language::C { special.c } else { special.rust };
        text.lines().for_each(|line| file.line(line));
        if !text.is_empty() {
            file.line("");
        }
    }
    tables(file, statements.source);
}
