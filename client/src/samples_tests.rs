//! Samples are inserted wherever a document names their file, and everything else is unchanged.
#![allow(clippy::unwrap_used)]

use std::process::Command;

use isophote_symbolic::Model;

use super::*;

const REST: &str =
    "name = \"m\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\nb = { start = 1.0 }\n[model]\n";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("psf.csv"), "s,value\n-1.0,0\n-0.5, 0.5\n0,1\n0.5,0.25 # measured\n1,0\n")
        .unwrap();
    std::fs::write(folder.path().join("square.csv"), "1,2,3,4\n2,3,4,5\n3,4,5,6\n4,5,6,7\n").unwrap();
    folder
}

/// A document that names files equals one with the samples inline.
fn same(with_file: &str, whole: &str) {
    let folder = folder();
    let text = put_in(with_file, DocumentSyntax::Toml, folder.path()).unwrap();
    let [a, b] =
        [&text, whole].map(|text| Model::from_toml(text).unwrap_or_else(|d| panic!("{}\n{text}", d[0].render("m"))));
    assert_eq!(a.digest(), b.digest(), "{text}");
    assert!(with_file.lines().zip(text.lines()).all(|(a, b)| a == b || b.trim().is_empty() || b.starts_with("first")));
}

#[test]
fn tables_of_every_spelling_get_their_samples() {
    let whole = format!(
        "{REST}intensity = 'table(\"psf\", x - b)'\n[tables.psf]\nfirst = -1.0\nstep = 0.5\nvalues = [0.0, 0.5, 1.0, 0.25, 0.0]\n"
    );
    let formula = format!("{REST}intensity = 'table(\"psf\", x - b)'\n");
    same(&format!("{formula}[tables.psf] # of March\nfile = \"psf.csv\"\n"), &whole);
    same(&format!("{formula}[tables]\npsf = {{ file = \"psf.csv\" }}\n"), &whole);
    let moved = whole.replace("first = -1.0", "first = 3");
    same(&format!("{formula}[tables.psf]\nfirst = 3\nfile = \"psf.csv\"\n"), &moved);
}

#[test]
fn files_named_in_formulas_become_tables() {
    let formula = format!("{REST}intensity = 'b * table(\"psf.csv\", x) + table(\"square.csv\", x, b)'\n");
    let whole = format!(
        "{formula}[tables.\"psf.csv\"]\nfirst = -1.0\nstep = 0.5\nvalues = [0.0, 0.5, 1.0, 0.25, 0.0]\n\
         [tables.\"square.csv\"]\nfirst = [-1.5, -1.5]\nstep = [1, 1]\n\
         values = [[1.0, 2.0, 3.0, 4.0], [2.0, 3.0, 4.0, 5.0], [3.0, 4.0, 5.0, 6.0], [4.0, 5.0, 6.0, 7.0]]\n"
    );
    same(&formula, &whole);
    let folder = folder();
    let unknown = formula.replace("psf.csv", "dot.csv");
    let text = put_in(&unknown, DocumentSyntax::Toml, folder.path()).unwrap();
    assert_eq!(Model::from_toml(&text).unwrap_err()[0].code, "unknown-name");
}

#[test]
fn json_documents_get_their_samples_as_well() {
    let of = |tables: &str, name: &str| {
        format!(
            r#"{{"name": "m", "coordinates": ["x"], "channels": ["phi"], {tables} "parameters": {{"b": {{"start": 1}}}},
            "model": {{"intensity": "table(\"{name}\", x - b)"}}}}"#
        )
    };
    let folder = folder();
    for (tables, name) in [
        (r#""tables": {"psf": {"file": "psf.csv"}},"#, "psf"),
        (r#""tables": {"other": {"first": 0, "step": 1, "values": [1, 2, 3, 4]}, "psf": {"file": "psf.csv"}},"#, "psf"),
        ("", "psf.csv"),
    ] {
        let text = put_in(&of(tables, name), DocumentSyntax::Json, folder.path()).unwrap();
        let model = Model::from_json(&text).unwrap_or_else(|d| panic!("{}\n{text}", d[0].render("m")));
        assert_eq!(model.document()["tables"][name]["values"], json!([0.0, 0.5, 1.0, 0.25, 0.0]), "{text}");
    }
}

#[test]
fn invalid_sample_files_are_rejected() {
    for (text, reason) in [
        ("", "no numbers"),
        ("1\n2\nthree\n", "line 3 is not made of finite numbers: `three`"),
        ("1,2,3\n1,2\n", "line 2 has 2 numbers, the first 3"),
        ("0,1\n1,2\n3,4\n", "the places in the first column are not evenly spaced, from the lowest up"),
        ("1,1\n0,2\n", "the places in the first column are not evenly spaced, from the lowest up"),
        ("1\nnan\n", "line 2 is not made of finite numbers: `nan`"),
    ] {
        assert_eq!(of_columns(text).unwrap_err(), reason);
    }
    let missing =
        put_in(&format!("{REST}[tables.psf]\nfile = \"none.csv\"\n"), DocumentSyntax::Toml, Path::new("/nowhere"))
            .unwrap_err();
    assert!(missing.to_string().contains("none.csv: cannot be read"), "{missing}");
}

#[test]
fn json_keeps_its_order_and_lines() {
    let folder = folder();
    let text = r#"{"name": "tables", "description": "\"tables\": {\"psf\": {}}", "coordinates": ["x"], "channels": ["phi"],
        "parameters": {"z": {"start": 1}, "b": {"start": 1}},
        "tables": {"other": {"first": 0, "step": 1, "values": [1, 2, 3, 4]},
                   "psf": {"file": "psf.csv",
                           "step": 2}},
        "model": {"intensity": "z + table(\"psf\", x - b) + table(\"square.csv\", x, b)"}}"#;
    let put = put_in(text, DocumentSyntax::Json, folder.path()).unwrap();
    let model = Model::from_json(&put).unwrap_or_else(|d| panic!("{}\n{put}", d[0].render("m")));
    let tables = &model.document()["tables"];
    assert_eq!((tables["psf"]["step"].as_f64(), tables["psf"]["first"].as_f64()), (Some(2.0), Some(-1.0)));
    assert_eq!((tables["psf"]["values"].as_array().unwrap().len(), tables.as_object().unwrap().len()), (5, 3));
    assert_eq!(model.parameters()[0].name, "z");
    assert!(put.contains(r#""description": "\"tables\": {\"psf\": {}}""#), "{put}");
    let line = |text: &str| text.lines().position(|line| line.contains("\"model\""));
    assert_eq!(line(&put), line(text), "{put}");
}

#[test]
fn unsupported_tables_are_rejected_with_the_remedy() {
    let folder = folder();
    let head = |top: &str| format!("{top}\n{REST}intensity = 'table(\"psf\", x - b)'\n");
    let remedy = "write a table of its own, `[tables.psf]` with `file = \"psf.csv\"` on the next line";
    for (text, expected) in [
        (head("tables = { psf = { file = \"psf.csv\" } }"), ["`tables = { … }`", remedy]),
        (head("tables.psf.file = \"psf.csv\""), ["a dotted key", remedy]),
        (head("tables.psf = { file = \"psf.csv\" }"), ["a dotted key", remedy]),
        (head("") + "[tables]\npsf.file = \"psf.csv\"\npsf.first = 3\n", ["a dotted key", remedy]),
        (head("") + "[tables]\npsf . file = \"psf.csv\"\n", ["a dotted key", remedy]),
        (head("") + "[tables.psf]\nfile = \"psf.csv\"\nfirst = inf\n", ["tables.psf: `first = inf`", "finite"]),
        (head("") + "[tables.psf]\nfile = \"psf.csv\"\nstep = [1, nan]\n", ["tables.psf: `step = [1, nan]`", "finite"]),
        (head("") + "[tables.psf]\nfile = \"psf.csv\"\nstep = \"1\"\n", ["tables.psf: `step = \"1\"`", "finite"]),
    ] {
        let error = put_in(&text, DocumentSyntax::Toml, folder.path()).unwrap_err();
        assert!(expected.iter().all(|part| error.to_string().contains(part)), "{text}\n{error}");
    }
}

#[test]
fn pipes_and_folders_are_rejected_without_waiting() {
    let folder = folder();
    std::fs::create_dir(folder.path().join("folder.csv")).unwrap();
    assert!(Command::new("mkfifo").arg(folder.path().join("pipe.csv")).status().unwrap().success());
    for (name, expected) in [("pipe.csv", "neither a file nor a folder"), ("folder.csv", "it is a folder")] {
        let text = format!("{REST}[tables.psf]\nfile = \"{name}\"\n");
        let error = put_in(&text, DocumentSyntax::Toml, folder.path()).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(expected), "{error}");
    }
}
