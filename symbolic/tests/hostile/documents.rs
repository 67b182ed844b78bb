//! Documents that try to cost more than they should, and how each must end. The test and the example share them.

#[path = "names.rs"]
mod names;
#[path = "schedules.rs"]
mod schedules;

use isophote_symbolic::{Diagnostics, Model};

/// How a document must end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Ending {
    /// Refused by the reader with this code.
    Refused(&'static str),
    /// Honest mathematics: admitted and derived, or refused as too much.
    Honest,
}
use Ending::{Honest, Refused};

/// A document and how it must end.
pub struct Hostile {
    pub name: &'static str,
    pub text: String,
    pub is_json: bool,
    #[allow(dead_code)] // the example only prints
    pub ending: Ending,
}

impl Hostile {
    /// What stops the reader, if anything does.
    pub fn read(&self) -> Result<Model, Diagnostics> {
        if self.is_json { Model::from_json(&self.text) } else { Model::from_toml(&self.text) }
    }
}

fn document(parameters: usize, definitions: &[(String, String)], intensity: &str) -> String {
    let parameters: String = (0..parameters).map(|i| format!("p{i} = {{ start = 1.5 }}\n")).collect();
    let definitions: String = definitions.iter().map(|(name, text)| format!("\"{name}\" = \"{text}\"\n")).collect();
    format!(
        "name = \"bomb\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n{parameters}[definitions]\n{definitions}[model]\nintensity = \"{intensity}\"\n"
    )
}

/// Definitions d0, d1, … each made of the one before.
fn chain(count: usize, first: &str, next: impl Fn(&str) -> String) -> Vec<(String, String)> {
    let text = |i: usize| if i == 0 { first.to_string() } else { next(&format!("d{}", i - 1)) };
    (0..count).map(|i| (format!("d{i}"), text(i))).collect()
}

/// Σᵢ (Σⱼ pⱼ xʲ + i)^64.
fn many_powers() -> String {
    let inner: Vec<String> = (0..64).map(|j| format!("p{j}*x^{j}")).collect();
    format!("sum(({} + i)^64, i, 0, 300)", inner.join(" + "))
}

/// Functions f0(t), f1(t), … each made of the one before.
fn functions(count: usize, first: &str, next: impl Fn(&str) -> String) -> Vec<(String, String)> {
    let text = |i: usize| if i == 0 { first.to_string() } else { next(&format!("f{}", i - 1)) };
    (0..count).map(|i| (format!("f{i}(t)"), text(i))).collect()
}

fn fraction(parameters: usize) -> String {
    // Nested no deeper than a formula may be: d_k = p + 1/d_(k−1), one a definition.
    document(
        parameters.min(64),
        &(0..parameters.min(127))
            .map(|i| {
                let inner = if i == 0 { "x".to_string() } else { format!("d{}", i - 1) };
                (format!("d{i}"), format!("p{} + 1/({inner})", i % 64))
            })
            .collect::<Vec<_>>(),
        &format!("d{} + y", parameters.min(127) - 1),
    )
}

/// A formula repeated `count` times around its middle.
fn wrapped(before: &str, middle: &str, after: &str, count: usize) -> String {
    before.repeat(count) + middle + &after.repeat(count)
}

/// Every hostile document.
pub fn all() -> Vec<Hostile> {
    let mut list = Vec::new();
    let mut add = |name, text: String, ending| list.push(Hostile { name, text, is_json: false, ending });
    let one = |intensity: &str| document(1, &[], intensity);
    let limit = Refused("limit");

    // Work that grows with the square of a document, each step of it short.
    let conditions =
        [("d0", "sum(sum(sin(i*x + j*p0), i, 1, 100), j, 1, 140)"), ("d1", "cos(x*7.3)"), ("d2", "sin(x*7.3)")];
    let conditions = conditions.map(|(name, formula)| (name.to_string(), formula.to_string()));
    let compared = "p0*x + sum(sum(if(d1 + 0*i*j < d2, 1, 0), i, 1, 300), j, 1, 300)";
    add("comparisons beside many nodes", document(1, &conditions, compared), limit);
    add("1 024 terms with a factor each", one("p0*sum((0.5 + 0.001*i)*abs(x - i), i, 1, 1024)"), Honest);
    let doubled = chain(60, "x < 30", |d| format!("{d} and ({d} and y < 20)"));
    add("conditions that name others twice", document(1, &doubled, "p0*x") + "domain = \"d59\"\n", Honest);

    // Numbers at the end of their range.
    let far = |start: &str| {
        let head = "name = \"far\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\n";
        format!(
            "{head}bx = {{ start = {start} }}\nby = {{ start = {start} }}\n[roles]\ncentre = [\"bx\", \"by\"]\n[model]\nintensity = \"exp(-(x-bx)^2-(y-by)^2)\"\ndomain = \"x <= {start}\"\n"
        )
    };
    add("a centre at 1e9", far("1e9"), Honest);
    add("a centre at -1e300", far("-1e300"), Honest);
    let powers =
        [("d1", "product(x, i, 0, 1023)"), ("d2", "d1^64"), ("d3", "product(d2, i, 0, 1023)"), ("d4", "d3^64")];
    let powers: Vec<(String, String)> = powers.map(|(name, text)| (name.to_string(), text.to_string())).into();
    add("an exponent beyond 32 bits", document(1, &powers, "p0*d4"), Honest);
    add("(x - p0)^900 by products", document(1, &[], "product(x - p0, i, 1, 900)"), Honest);
    let factors = "product(product(i*x + p0*j + 1, i, 0, 63), j, 0, 63)";
    add("a product of 4096 factors", document(3, &[], factors), Honest);
    let either = "sum(sum(max(i*x*p0, sin(p1*j*x)), i, 0, 63), j, 0, 63)";
    add("the larger of two, 4096 times", document(3, &[], either), Honest);
    let cases = "sum(sum(if(i*j < x*p0, p1*i*x, p2*j*y), i, 0, 63), j, 0, 63)";
    add("one of two, 4096 times", document(3, &[], cases), Honest);
    // Values everywhere, derivatives nowhere: the root's argument is 0 to f64.
    let waves: Vec<String> = (0..40).map(|i| format!("p{i}*exp(-((x - {i})^2 + y^2)/(9 + p{i}^2))")).collect();
    let rootless = format!("{} + sqrt(exp(-p0^2 - 1000))", waves.join(" + "));
    add("derivatives that have no value anywhere", document(40, &[], &rootless), Honest);
    add("powers of 64 in 64 parameters", document(64, &[], &many_powers()), Honest);

    // Growth of what is worked out and derived.
    add(
        "squaring, 127 definitions",
        document(2, &chain(127, "x*p0 + p1", |d| format!("{d}^2 + {d}*p0")), "d126"),
        Honest,
    );
    let squares = |calls: usize| (0..calls).fold("x*p0 + p1".to_string(), |inner, _| format!("q({inner})"));
    let q = [("q(t)".to_string(), "t^2 + t*p0".to_string())];
    add("squaring, 50 calls in one formula", document(2, &q, &squares(50)), Honest);
    let of_squares: Vec<_> = [q[0].clone(), ("r(t)".into(), squares(16).replace("x*p0 + p1", "t"))].into();
    add("squaring, 16 calls in each of 60 calls", document(2, &of_squares, &squares(60).replace("q(", "r(")), Honest);
    let of_sums = "sum(d{} * (i + 1) * (d{} + i*x), i, 0, 1000)";
    add(
        "squaring, 1000 terms in each of 40",
        document(2, &chain(40, "p0*p1 + x", |d| of_sums.replace("d{}", d)), "d39"),
        limit,
    );
    add(
        "product form of squaring ×1000",
        document(2, &chain(100, "x*p0 + p1", |d| format!("product({d} + p0, i, 1, 10)")), "d99"),
        Honest,
    );
    add("continued fraction, 64 parameters", fraction(64), Honest);
    add("continued fraction, 127 deep", fraction(127), Honest);
    add(
        "sin in sin, 127 definitions",
        document(2, &chain(127, "x*p0 + p1", |d| format!("sin({d}*p0 + y)")), "d126"),
        Honest,
    );
    let deep_sin = |d: &str| (0..10).fold(d.to_string(), |inner, _| format!("sin({inner} + p0)"));
    add("sin in sin, 10 in each of 126", document(2, &chain(126, "x*p0 + p1", deep_sin), "d125"), Honest);
    add(
        "sin in sin through calls",
        document(2, &functions(16, "sin(t*p0)", |f| format!("{f}({f}(t))")), "f15(x)"),
        limit,
    );
    let factors: Vec<String> = (0..64).map(|i| format!("(x + p{i} + y*p{})", (i * 7 + 3) % 64)).collect();
    add("product of 64 factors", document(64, &[], &factors.join("*")), Honest);
    let gaussian =
        |i: usize| format!("p{0}*exp(-((x - p{1})^2 + (y - p{2})^2)*p{3})", 4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3);
    let gaussians = (0..16).map(gaussian).collect::<Vec<_>>().join(" + ");
    add("16 Gaussians of 4 parameters", document(64, &[], &gaussians), Honest);
    let dense: String =
        (0..64).map(|i| format!("exp(p{i}*x*y + sin(p{i})*p{})", (i + 1) % 64)).collect::<Vec<_>>().join("*");
    add("product of 64 exponentials", document(64, &[], &dense), Honest);
    add(
        "pow tower of parameters",
        document(8, &chain(60, "x + p0", |d| format!("(1 + {d}^2)^(p1 + 1/{d})")), "d59"),
        Honest,
    );
    let cases: Vec<String> =
        (0..500).map(|i| format!("x < {i} + p{}, p{}*x^{}", i % 64, (i + 1) % 64, i % 9)).collect();
    add("piecewise of 500 branches", document(64, &[], &format!("piecewise({}, 0)", cases.join(", "))), Honest);
    let ifs = (0..60).fold("x".to_string(), |inner, i| format!("if({inner} < p0, x*p1 + {i}, y)"));
    add("if in the condition of if, 60 deep", document(2, &[], &ifs), Honest);
    let ifs = (0..11).fold("x".to_string(), |inner, i| format!("if(x<p{i},{inner},{inner}+y)"));
    add("if doubling its inside", document(11, &[], &ifs), limit);
    let doubling = chain(120, "x + p0", |d| format!("if({d} > p1, {d}*p0, {d} + p1)"));
    add("if in if, 120 definitions", document(2, &doubling, "d119"), Honest);
    add(
        "all 64 parameters in everything",
        document(
            64,
            &(0..64)
                .map(|i| {
                    (format!("d{i}"), (0..64).map(|j| format!("p{j}*x^{}", (i * j) % 60)).collect::<Vec<_>>().join("+"))
                })
                .take(20)
                .collect::<Vec<_>>(),
            "product(d0*d1*d2*d3*d4*d5*d6*d7*d8*d9*d10*d11*d12*d13*d14*d15*d16*d17*d18*d19, i, 0, 3)",
        ),
        Honest,
    );

    // Nesting.
    add("30 000 parentheses", one(&wrapped("(", "p0", ")", 30_000)), limit);
    add("4 000 parentheses", one(&wrapped("(", "p0", ")", 4_000)), limit);
    add("60 000 opening parentheses", one(&"(".repeat(60_000)), limit);
    add("8 000 opening brackets", one(&"[".repeat(8_000)), limit);
    add("8 000 calls", one(&"sin(".repeat(4_000)), limit);
    add("60 000 minus signs", one(&("-".repeat(60_000) + "p0")), limit);
    add("8 000 minus signs", one(&("-".repeat(8_000) + "p0")), limit);
    add("8 000 nots", one(&("not ".repeat(8_000) + "p0")), limit);
    add("4 000 powers", one(&("x^".repeat(4_000) + "p0")), limit);
    add("8 000 transpositions", one(&("p0".to_string() + &"'".repeat(8_000))), limit);
    add("8 000 unknown characters", one(&"$".repeat(8_000)), Refused("syntax"));
    add("4 000 stray brackets", one(&") ".repeat(4_000)), Refused("syntax"));
    add("4 000 bars", one(&"|x".repeat(4_000)), Refused("syntax"));
    add("4 000 exclamation marks", one(&("!".repeat(4_000) + "x")), Refused("syntax"));
    add("4 000 words", one(&"word ".repeat(4_000)), Refused("syntax"));
    add(
        "depth of formulas times depth of calls",
        document(1, &functions(16, "sin(t)", |f| wrapped("sin(-", &format!("{f}(t)"), ")", 29)), "f15(x*p0)"),
        limit,
    );
    add(
        "conditions of 100 definitions",
        document(1, &chain(100, "x < p0", |d| format!("not ({d} and x > p0) or {d}")), "if(d99, p0, 0)"),
        Honest,
    );

    // Length.
    add("a million parentheses", one(&wrapped("(", "p0", ")", 1_000_000)), limit);
    add("a million minus signs", one(&("-".repeat(1_000_000) + "p0")), limit);
    add("64 KiB of one formula", one(&("p0".to_string() + &"+x*p0".repeat(13_000))), limit);
    add("8 000 tokens", one(&("p0".to_string() + &"+x*p0".repeat(1_990))), Refused("none"));
    add(
        "1 000 terms, all different",
        one(&("p0".to_string() + &(0..1_000).map(|i| format!("+{i}*x^{}", i % 60)).collect::<String>())),
        Honest,
    );
    add(
        "2 000 different unknown names",
        one(&(0..2_000).map(|i| format!("unknown{i:07}")).collect::<Vec<_>>().join(" + ")),
        Refused("unknown-name"),
    );
    add("a name of 60 000 letters", one(&"a".repeat(60_000)), Refused("unknown-name"));
    add("a number of 60 000 digits", one(&("1".repeat(60_000) + "*p0")), Refused("bad-number"));
    add("a key of 60 000 letters", one("p0*x").replace("p0 =", &format!("\"{}\" =", "a".repeat(60_000))), limit);
    add(
        "7 000 unknown keys on one line",
        one("p0*x") + "[a]\nb = {" + &(0..7_000).map(|i| format!("k{i}=1,")).collect::<String>() + "}",
        Refused("unknown-key"),
    );
    let long = "n".repeat(25_000);
    add(
        "unknown keys under a long key",
        one("p0*x").replace(
            "[definitions]",
            &format!(
                "{long} = {{ start = 1.0, {}}}\n[definitions]",
                (0..4_000).map(|i| format!("k{i}=1,")).collect::<String>()
            ),
        ),
        limit,
    );
    add(
        "a description of 60 000 bytes",
        one("p0*x").replace("name =", &format!("description = \"{}\"\nname =", "d".repeat(60_000))),
        Refused("none"),
    );
    add(
        "4 000 definitions",
        document(1, &(0..4_000).map(|i| (format!("d{i}"), "x".to_string())).collect::<Vec<_>>(), "p0*x"),
        limit,
    );
    add("2 500 parameters", document(2_500, &[], "p0*x + p2000"), limit);
    add(
        "a function of 8 000 arguments",
        document(
            1,
            &[(format!("g({})", (0..8_000).map(|i| format!("a{i}")).collect::<Vec<_>>().join(",")), "a1".into())],
            "p0*x",
        ),
        limit,
    );
    add("1 000 stages", one("p0*x") + &"[[stages]]\nparameters = [\"p0\"]\n".repeat(1_000), limit);
    add(
        "10 000 parameters in a stage",
        one("p0*x") + "[[stages]]\nparameters = [" + &"\"p0\",".repeat(10_000) + "]\n",
        Refused("duplicate"),
    );

    // Sums, calls, matrices.
    add("three sums of 900 terms", one("sum(sum(sum(p0*x^(i/900)*j*k^i, i, 0, 900), j, 0, 900), k, 0, 900)"), limit);
    add("three sums that fall apart", one("sum(sum(sum(p0*x*i*j*k, i, 0, 900), j, 0, 900), k, 0, 900)"), Honest);
    let sums = (0..15).fold("x".to_string(), |inner, i| format!("sum({inner}*x^i{i} + p0, i{i}, 0, 9)"));
    add("15 sums in sums", one(&sums), Honest);
    add("a sum of 10⁸ terms", one("sum(p0*x^i, i, 0, 100000000)"), limit);
    add("an empty range of −10⁸", one("p0 + sum(x, i, 0, -100000000)"), Refused("none"));
    add(
        "2⁶⁴ expansions by calls",
        document(1, &functions(64, "x*t", |f| format!("{f}(t) + {f}(t + 1)")), "f63(p0)"),
        limit,
    );
    add(
        "2¹⁶ expansions by calls",
        document(1, &functions(16, "sin(x*t)", |f| format!("{f}(t) + {f}(t + x)")), "f15(p0)"),
        Honest,
    );
    add(
        "2¹⁶ different arguments",
        document(1, &functions(16, "sin(x*t)", |f| format!("{f}(sin(t)) + {f}(cos(t))")), "f15(p0)"),
        limit,
    );
    add(
        "functions in sums in functions",
        document(1, &functions(10, "sin(x*t)", |f| format!("sum({f}(t + i*x)*{f}(t), i, 0, 30)")), "f9(p0)"),
        Honest,
    );
    let wide = format!("[{}]", (0..256).map(|i| format!("x^{}*p0", i % 60)).collect::<Vec<_>>().join(","));
    add("dot products of 256", document(1, &[("v".into(), wide.clone())], "(v' * v)^60 + p0"), Honest);
    let square = format!("[{}]", vec![format!("[{}]", vec!["x*p0 + sin(y*p0)"; 16].join(",")); 16].join(","));
    add(
        "powers of a 16×16 matrix",
        document(1, &[("M".into(), square)], &format!("({})[0, 0]", vec!["M"; 100].join("*"))),
        Honest,
    );
    add("an outer product of 256", document(1, &[("v".into(), wide)], "(v * v')[0, 0]"), limit);
    add("1 000 × 1 000", one(&format!("([{0}] * [{0}]')[0,0]*p0", vec!["1"; 1_000].join(","))), limit);
    let thousand = "sum(p0*sin(x*i), i, 0, 999)";
    add(
        "a long sum taken into 1 000",
        document(1, &[("g(t)".into(), format!("{thousand} + t"))], "sum(cos(g(i*x)), i, 0, 999)"),
        Honest,
    );
    add("exponents of exponents", one("((((x + p0)^64)^64)^64)^64"), limit);
    add("a huge exponent", one("(x + p0)^1e300"), limit);
    add("a negative power of zero", one("p0*0^-1"), Refused("bad-number"));
    add("numbers that overflow", one("p0*exp(1e3)*1e308*10"), Refused("bad-number"));

    // The documents themselves.
    add("arrays in arrays", one("p0*x") + "a = " + &wrapped("[", "", "]", 20_000), limit);
    add("tables in tables", one("p0*x") + "a = " + &wrapped("{a=", "1", "}", 12_000), limit);
    add("dotted keys", one("p0*x") + &wrapped("a.", "a = 1", "", 20_000), limit);
    add("a header of dots", one("p0*x") + "[" + &wrapped("a.", "a", "", 20_000) + "]", limit);
    add("a NUL byte", one("p0*x\\u0000"), Refused("syntax"));
    add("a bare NUL byte", one("p0*x\0"), Refused("syntax"));
    add("marks that turn the text round", one("p0 \u{202e}* x"), Refused("syntax"));
    add("60 000 line ends", one("p0*x") + &"\n".repeat(60_000), Refused("none"));
    add("16 000 broken lines", one("p0*x") + &"a b\n".repeat(16_000), Refused("syntax"));
    add("14 000 open quotes", one("p0*x") + &"a='\n".repeat(14_000), Refused("syntax"));

    schedules::all(&mut add);
    names::all(&mut add);
    let mut add = |name, text: String, ending| list.push(Hostile { name, text, is_json: true, ending });
    add("JSON: arrays in arrays", wrapped("[", "", "]", 30_000), limit);
    add("JSON: open arrays", "[".repeat(60_000), limit);
    add("JSON: tables in tables", wrapped("{\"a\":", "1", "}", 10_000), limit);
    add("JSON: 8 000 keys twice", "{".to_string() + &"\"a\":1,".repeat(8_000) + "\"a\":1}", Refused("duplicate"));
    add(
        "JSON: 6 000 keys",
        "{".to_string() + &(0..6_000).map(|i| format!("\"{i}\":1,")).collect::<String>() + "\"a\":1}",
        Refused("unknown-key"),
    );
    add("JSON: a million brackets", "[".repeat(1_000_000), limit);
    list
}
