//! The generated pages of the book: command line and model gallery. docs/ must match; `UPDATE_EXPECT=1` rewrites it.
#![allow(clippy::unwrap_used)]

mod commands;
mod gallery;

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use isophote_tests::{finish, program, repository};

/// Standard output of `isophote` with `arguments` in the repository root, if it succeeds.
fn printed(arguments: &[&str]) -> Result<String, String> {
    let mut command = Command::new(program().unwrap());
    let finished = finish(command.args(arguments).current_dir(repository()), Duration::from_secs(60)).unwrap();
    if finished.status == Some(0) { Ok(finished.stdout) } else { Err(finished.stderr) }
}

/// Compares a file of the repository with its expected contents, or writes it.
fn expect(path: &str, wanted: &[u8]) {
    let place = repository().join(path);
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        fs::create_dir_all(place.parent().unwrap_or(Path::new("."))).unwrap();
        fs::write(place, wanted).unwrap();
        return;
    }
    let found = fs::read(&place).unwrap_or_default();
    assert!(
        found == wanted,
        "{path} is stale: UPDATE_EXPECT=1 cargo test -p isophote-tests --test book, then book/build"
    );
}
