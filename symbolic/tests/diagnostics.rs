//! What a user is shown of documents with many faults: each document of tests/diagnostics/ and beside it, as text, all that
//! is told of it. `UPDATE_EXPECT=1 cargo test -p isophote-symbolic --test diagnostics` writes the texts anew.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeSet;
use std::path::Path;

use common::expect;
use isophote_symbolic::{Diagnostic, Diagnostics, Formula, LIMITS, Model, Span};

fn shown(faults: &Diagnostics, name: &str) -> String {
    faults.iter().map(|d| d.render(name) + "\n").collect()
}

#[test]
fn documents_with_many_faults() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/diagnostics");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "toml"));
    paths.sort();
    assert!(paths.len() >= 3, "{paths:?}");
    for path in paths {
        let faults = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap_err();
        let text = shown(&faults, &path.file_name().unwrap().to_string_lossy());
        let expected = path.with_extension("txt");
        expect(&expected, &text);
    }
}

/// At least a dozen kinds of faults in one go, in the order of the document, none twice.
#[test]
fn all_kinds_in_one_go() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/diagnostics/many-faults.toml");
    let faults = Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap_err();
    let codes: BTreeSet<&str> = faults.iter().map(|d| d.code.as_str()).collect();
    assert!(codes.len() >= 12, "{codes:?}");
    assert!(faults.windows(2).all(|pair| pair[0].span <= pair[1].span));
    let distinct: BTreeSet<_> = faults.iter().map(|d| (d.span, &d.code, &d.message)).collect();
    assert_eq!(distinct.len(), faults.len());
}

/// Carets stand under the fault in a terminal's columns, whatever stands before it.
#[test]
fn carets_line_up() {
    let table = [
        ("a\tb + cc\td", "cc", "a b + cc d", 6, 2),
        ("größe + cc", "cc", "größe + cc", 8, 2),
        ("größe + ccß", "größe", "größe + ccß", 0, 5),
        ("明るさ + cc", "cc", "明るさ + cc", 9, 2),
        ("x + 明るさ", "明るさ", "x + 明るさ", 4, 6),
        ("e\u{301}e + cc", "cc", "e\u{301}e + cc", 5, 2),
        ("a \u{202e}b cc", "cc", "a �b cc", 5, 2),
    ];
    for (line, fault, shown, before, width) in table {
        let document = format!("first\r\n{line}\r\nlast");
        let start = document.find(fault).unwrap() as u32;
        let span = Span { start, end: start + fault.len() as u32 };
        let diagnostic = Diagnostic::error(&document, "code", "key", span, "message");
        let column = line[..line.find(fault).unwrap()].chars().count() + 1;
        let caret = " ".repeat(before) + &"^".repeat(width);
        let expected = format!("error[code]: message\n --> d:2:{column} (key)\n  |\n2 | {shown}\n  | {caret}\n");
        assert_eq!(diagnostic.render("d"), expected, "{line}");
    }
}

/// A fault of several lines is shown as far as its first; what is long is cut on both sides.
#[test]
fn long_faults_are_cut() {
    let document = "ab(c\nd)";
    let shown = Diagnostic::error(document, "code", "", Span { start: 2, end: 7 }, "message").render("d");
    assert_eq!(shown, "error[code]: message\n --> d:1:3\n  |\n1 | ab(c\n  |   ^^\n");
    let formula = format!("{}zz + {}", "t + ".repeat(100), "t + ".repeat(100));
    let faults = Formula::parse(&(formula + "t"), &["t"]).unwrap_err();
    let shown = faults[0].render("formula");
    let lines: Vec<&str> = shown.lines().collect();
    assert!(lines[3].starts_with("1 | …") && lines[3].ends_with('…') && lines[3].chars().count() < 100, "{shown}");
    let at = lines[4].find('^').unwrap();
    assert_eq!(lines[3].chars().skip(at).take(2).collect::<String>(), "zz", "{shown}");
}

/// Faults told end at their limit, at −1, 0 and +1; how many more there are is told as well.
#[test]
fn faults_end_at_their_limit() {
    for count in LIMITS.diagnostics - 1..=LIMITS.diagnostics + 1 {
        let formula: Vec<String> = (0..count).map(|i| format!("unknown{i:03}")).collect();
        let faults = Formula::parse(&formula.join(" + "), &[]).unwrap_err();
        let names = faults.iter().filter(|d| d.code == "unknown-name").count();
        assert_eq!(names, count.min(LIMITS.diagnostics));
        assert_eq!(faults.len() - names, usize::from(count > LIMITS.diagnostics));
    }
}

/// A fault in a formula that is spelled in an unusual way stands at the characters that spell it.
#[test]
fn faults_stand_where_they_are_spelled() {
    let before = "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"y\"]\n[parameters]\nv = { start = 1.0 }\n[model]\nintensity = ";
    for (literal, name) in [
        ("\"\"\"\\\n\\\n  v + g\\u0072\\xf6\\U000000dfe*x\"\"\"", "g\\u0072\\xf6\\U000000dfe"),
        ("\"\"\"\r\nv*x\\\r\n \t \r\n + größe\\\n\n\"\"\"", "größe"),
        ("'''\nv*x + größe'''", "größe"),
        ("\"v*x\\t+\\u00a0größe\"", "größe"),
    ] {
        let document = format!("{before}{literal}\n");
        let faults = Model::from_toml(&document).unwrap_err();
        assert_eq!(faults.len(), 1, "{faults:?}");
        let (start, end) = (faults[0].span.start as usize, faults[0].span.end as usize);
        assert_eq!(&document[start..end], name, "{document}");
        assert_eq!(faults[0].line as usize, document[..start].split('\n').count(), "{document}");
    }
    let json = "{\"name\": \"m\", \"coordinates\": [\"x\"], \"channels\": [\"y\"], \"parameters\": {\"v\": {\"start\": 1}},\n\
                \"model\": {\"intensity\": \"v\\/x + \\ud835\\udefc\"}}";
    let faults = Model::from_json(json).unwrap_err();
    assert_eq!(&json[faults[0].span.start as usize..faults[0].span.end as usize], "\\ud835\\udefc", "{faults:?}");
}
