//! The pages of the book that are made from the program: its command line and the gallery of its models. Each stands in
//! docs/ as it must be; `UPDATE_EXPECT=1` writes it anew.
#![allow(clippy::unwrap_used)]

mod commands;
mod gallery;

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use isophote_tests::{finish, program, repository};

/// What `isophote` prints when it is run with `arguments` at the repository's top, if all goes well.
fn printed(arguments: &[&str]) -> Result<String, String> {
    let mut command = Command::new(program().unwrap());
    let finished = finish(command.args(arguments).current_dir(repository()), Duration::from_secs(60)).unwrap();
    if finished.status == Some(0) { Ok(finished.stdout) } else { Err(finished.stderr) }
}

/// Compares a file of the repository with what it should be, or writes it.
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
