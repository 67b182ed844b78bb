//! Fixtures of whole-system tests: the repository's folder, the `isophote` program built from these sources, services
//! on ports of their own, a [`rig`] with cameras: [`uvccam`], a USB camera, and [`loopback`], frames of known truth.
//!
//! Tests use the service as users do, without its internals.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::SystemTime;

pub mod loopback;
pub mod rig;
mod service;
pub mod uvccam;

pub use service::{Finished, Service, finish};

/// The repository root.
pub fn repository() -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().unwrap_or(tests).to_path_buf()
}

/// The program `isophote` of the profile under test, built first if missing or older than a source file. Cargo passes
/// a program's path only to tests of its own package, hence this search.
pub fn program() -> io::Result<PathBuf> {
    static PROGRAM: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    PROGRAM.get_or_init(|| find_or_build().map_err(|e| e.to_string())).clone().map_err(io::Error::other)
}

fn find_or_build() -> io::Result<PathBuf> {
    let test = std::env::current_exe()?;
    let missing = || io::Error::other("a test's executable lies in target/PROFILE/deps");
    let profile = test.parent().and_then(Path::parent).ok_or_else(missing)?;
    let target = profile.parent().ok_or_else(missing)?;
    let program = profile.join(format!("isophote{}", std::env::consts::EXE_SUFFIX));
    if rig::is_inside() {
        return Ok(program); // built before the machine was started
    }
    let built = fs::metadata(&program).and_then(|file| file.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    if newest_source(&repository())? < built {
        return Ok(program);
    }
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut build = Command::new(cargo);
    build.args(["build", "--package", "isophote", "--target-dir"]).arg(target).current_dir(repository());
    if profile.ends_with("release") {
        build.arg("--release");
    }
    if build.status()?.success() {
        Ok(program)
    } else {
        Err(io::Error::other("`cargo build --package isophote` failed"))
    }
}

/// Modification time of the newest file that the program is built from.
fn newest_source(repository: &Path) -> io::Result<SystemTime> {
    let folders = ["symbolic", "jit", "tracker", "capture", "server", "client", "models"];
    let mut files = vec![repository.join("Cargo.toml"), repository.join("Cargo.lock")];
    for folder in folders {
        files_below(&repository.join(folder), &mut files)?;
    }
    let tests_only = |file: &Path| file.components().any(|part| part.as_os_str() == "tests");
    files.retain(|file| !tests_only(file.strip_prefix(repository).unwrap_or(file)));
    let times = files.iter().filter_map(|file| fs::metadata(file).and_then(|data| data.modified()).ok());
    Ok(times.max().unwrap_or(SystemTime::UNIX_EPOCH))
}

/// Adds every file below `folder`, in name order, except hidden folders and build output.
pub fn files_below(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let mut entries = fs::read_dir(&folder)?.collect::<Result<Vec<_>, _>>()?;
        entries.sort_by_key(fs::DirEntry::file_name);
        for entry in entries {
            let name = entry.file_name();
            let kind = entry.file_type()?;
            if kind.is_dir()
                && !matches!(name.to_str(), Some(".git" | "target" | "out" | "node_modules" | "__pycache__"))
            {
                folders.push(entry.path());
            } else if kind.is_file() {
                files.push(entry.path());
            }
        }
    }
    files.sort();
    Ok(())
}
