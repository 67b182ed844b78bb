//! Hostile documents whose cost is in what they declare, name and call: near names, wide calls, long strings, many faults.

use super::Ending::{self, Honest, Refused};
use super::{document, wrapped};

/// Names of 55 letters that differ at their end.
fn near(word: &str, count: usize) -> Vec<String> {
    (0..count).map(|i| format!("{}{i:04}", word.repeat(52 / word.len()))).collect()
}

fn quoted(names: &[String]) -> String {
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}

/// Every document of this kind.
pub fn all(add: &mut impl FnMut(&'static str, String, Ending)) {
    let limit = Refused("limit");
    let plain = || document(1, &[], "p0*x");

    // Names that are nearly right.
    let declared: String = near("abcd", 430).iter().map(|name| format!("{name} = {{ start = 1.0 }}\n")).collect();
    let stage = |names: Vec<String>| format!("[[stages]]\nparameters = [{}]\n", quoted(&names));
    let with_declared = plain().replace("[definitions]", &format!("{declared}[definitions]"));
    add(
        "430 near names, 430 times in a stage",
        with_declared.clone() + &stage(near("dcba", 430)),
        Refused("unknown-name"),
    );
    add(
        "430 near names, in each of 8 stages",
        with_declared + &stage(near("bcda", 60)).repeat(8),
        Refused("unknown-name"),
    );
    let definitions: Vec<(String, String)> = near("abcd", 120).into_iter().map(|name| (name, "x".into())).collect();
    let unknown = near("abdc", 800).join(" + ");
    add("800 near names in a formula", document(1, &definitions, &unknown), Refused("unknown-name"));
    let unknown: Vec<String> = (0..8_000).map(|i| format!("z{i:04}")).collect();
    add("7 000 unknown parameters of a stage", plain() + &stage(unknown[..7_000].to_vec()), Refused("unknown-name"));
    let keys: String = (0..900).map(|i| format!("strat{i} = 1, ")).collect();
    add(
        "900 unknown keys of a parameter",
        plain().replace("start = 1.5", &format!("{keys}start = 1.5")),
        Refused("unknown-key"),
    );
    let roles: String = (0..1_500).map(|i| format!("[roles.t{i}]\ncentre = [\"p{i}\"]\n")).collect();
    add("1 500 targets", plain() + &roles, Refused("unknown-name"));
    let constants: String = (0..4_000).map(|i| format!("k{i} = 1\n")).collect();
    add("4 000 constants", plain() + "[constants]\n" + &constants, limit);
    let starts: String = (0..1_500).map(|i| format!("q{i} = {{ start = \"centroidx\" }}\n")).collect();
    add(
        "1 500 parameters with a wrong start",
        plain().replace("[definitions]", &(starts + "[definitions]")),
        Refused("unknown-name"),
    );

    // Definitions that wait for each other, or for nobody.
    let names = |from: usize| (from..128).map(|i| format!("d{i}")).collect::<Vec<_>>();
    let waiting: Vec<_> =
        (0..128).map(|i| (format!("d{i}"), [vec!["x".into()], names(i + 1)].concat().join("+"))).collect();
    add("128 definitions, last things first", document(1, &waiting, "d0*p0"), limit);
    let short: Vec<_> = (0..128)
        .map(|i| {
            (
                format!("d{i}"),
                [vec!["x".into()], names(i + 1)].concat().into_iter().take(20).collect::<Vec<_>>().join("+"),
            )
        })
        .collect();
    add("128 definitions, each of the 19 behind it", document(1, &short, "d0*p0"), Honest);
    let circles: Vec<_> = (0..128).map(|i| (format!("d{i}"), format!("d{} + x", i ^ 1))).collect();
    add("64 circles", document(1, &circles, "d0*p0"), Refused("cycle"));
    let circle: Vec<_> = (0..128).map(|i| (format!("d{i}"), format!("d{} + x", (i + 1) % 128))).collect();
    add("a circle of 128", document(1, &circle, "d0*p0"), Refused("cycle"));
    let unused: Vec<_> = (0..127).map(|i| (format!("d{i}"), format!("sum(sin(j*x*p0 + {i})^3, j, 0, 200)"))).collect();
    add("127 heavy definitions that nothing reads", document(1, &unused, "p0*x"), Honest);

    // Calls and matrices.
    let numbers = |count: usize| (0..count).map(|i| (i % 10).to_string()).collect::<Vec<_>>().join(", ");
    let matrix = format!("[{}]", vec![format!("[{}]", numbers(16)); 16].join(", "));
    let arguments: Vec<String> = (0..15).map(|i| format!("a{i}")).collect();
    let arguments = arguments.join(", ");
    let calls = |last: &str| {
        let sums = (0..11).map(|k| format!("sum(f({arguments}, {last}), k, {}, {})", 1024 * k, 1024 * k + 1023));
        sums.collect::<Vec<_>>().join(" + ")
    };
    let wide = |last: &str| {
        vec![
            ("A".to_string(), matrix.clone()),
            (format!("f({arguments}, t)"), "t".to_string()),
            (format!("g({arguments})"), calls(last)),
        ]
    };
    let call = format!("p0*g({})", vec!["A"; 15].join(", "));
    add("11 264 calls with 15 matrices each", document(1, &wide("k"), &call), Honest);
    add("the same call 11 264 times", document(1, &wide("1"), &call), Honest);
    let copies = vec![
        ("A".to_string(), matrix.clone()),
        ("f(a)".into(), "sum(sum((a)[i, j]*x, i, 0, 15), j, 0, 15) + sum((a)[0, 0]*i, i, 0, 1000)".into()),
    ];
    add("an argument copied again and again", document(1, &copies, "p0*sum(f(A*i), i, 0, 1000)"), Honest);
    let product = vec![("A".to_string(), matrix.replace('9', "x"))];
    add("a product of 1 000 matrices", document(1, &product, "p0*(product(A*i, i, 1, 1000))[0, 0]"), Honest);
    let nested = (0..16).fold("x".to_string(), |inner, i| format!("sum({inner} + p0*i{i}, i{i}, 0, 1)"));
    add("16 sums of two terms in each other", document(1, &[], &nested), Honest);
    let nested = (0..16).fold("sin(x)".to_string(), |inner, i| format!("product({inner} + i{i}, i{i}, 0, 2)"));
    add("16 products of three in each other", document(1, &[], &(nested + "*p0")), Honest);
    let deep = wrapped("-(", "p0*sin(i*x + j)", ")", 50);
    add("50 signs in a sum of sums", document(1, &[], &format!("sum(sum({deep}, j, 0, 900), i, 0, 900)")), Honest);
    let locals = (0..14).fold("x".to_string(), |inner, i| format!("sum(sin({inner} + i{i}), i{i}, 0, 3)"));
    add("14 locals, all read", document(1, &[], &format!("p0*({locals})")), Honest);
    let values = format!("[{}]", vec!["p0"; 256].join(", "));
    let observed = format!(
        "{}observed = \"[{}]\"\nnoise = \"1 + intensity\"\n",
        document(1, &[], &values),
        vec!["phi"; 256].join(", ")
    );
    add("256 observed values with noise", observed, limit);
    let constraints: String = (0..1_000).map(|i| format!("\"p0 > -{i}\", ")).collect();
    add("1 000 constraints", plain() + &format!("constraint = [{constraints}]\n"), Honest);
    let volume = plain().replace("\"y\"]", "\"y\", \"z\", \"w\"]").replace("p0*x", &sines(60));
    add("2⁴ points of a pixel", volume + "quadrature = 2\n", Honest);

    // Strings.
    let described = |text: &str| plain().replace("name =", &format!("description = {text}\nname ="));
    add("two continued lines", described("\"\"\"\\\n\\\néa\"\"\""), Refused("none"));
    add("a continued line and a no-break space", described("\"\"\"\\\n\u{a0}té\"\"\""), Refused("none"));
    add("10 000 escapes", described(&format!("\"{}\"", "\\u00e9".repeat(10_000))), Refused("none"));
    add("30 000 continued lines", described(&format!("\"\"\"{}é\"\"\"", "\\\n".repeat(30_000))), Refused("none"));
    let spelled: String = "+x*p0".chars().map(|c| format!("\\u{:04x}", u32::from(c))).collect();
    add("a formula of escapes", plain().replace("p0*x", &format!("x{}", spelled.repeat(1_500))), Refused("none"));
    let stray = plain().replace("p0*x", &format!("x{}", "\\u00a7".repeat(8_000)));
    add("8 000 escaped strays", stray, Refused("syntax"));
}

fn sines(count: usize) -> String {
    (0..count).map(|i| format!("p0*sin(x*y + z*w*{i})")).collect::<Vec<_>>().join(" + ")
}
