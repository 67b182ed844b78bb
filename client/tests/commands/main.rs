//! The commands that need no service, run as a user runs them.
#![allow(clippy::unwrap_used)]

mod colours;
mod deviation;
mod manual;
mod noise;
mod offline;
mod pixels;
mod profile;
mod response;
mod tune;
mod volumes;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A shipped document.
fn model(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../models").join(name)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn isophote(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isophote")).args(arguments).output().unwrap()
}

/// Standard output of a run that must succeed.
fn output(arguments: &[&str]) -> String {
    outputs(arguments)[0].clone()
}

/// Standard output and standard error of a run that must succeed.
fn outputs(arguments: &[&str]) -> [String; 2] {
    let run = isophote(arguments);
    let [out, errors] = [run.stdout, run.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(run.status.success(), "{arguments:?}: {errors}");
    [out, errors]
}

/// Exit status and standard error of a run that must fail without results.
fn failure(arguments: &[&str]) -> (i32, String) {
    let run = isophote(arguments);
    assert!(!run.status.success(), "{arguments:?}");
    assert_eq!(String::from_utf8(run.stdout).unwrap(), "", "{arguments:?}");
    (run.status.code().unwrap(), String::from_utf8(run.stderr).unwrap())
}

fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}
