//! Writes the marked parts of pages of docs/.

use std::path::PathBuf;
use std::process::Command;

/// The path of a page.
pub(crate) fn docs(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "..", "docs", name].iter().collect()
}

/// The page with one marked part replaced.
pub(crate) fn with(page: &str, part: &str, text: &str) -> String {
    let (begin, end) = (format!("<!-- {part}: written by the benchmark -->\n"), format!("<!-- end of {part} -->"));
    let (before, rest) = page.split_once(&begin).unwrap_or_else(|| panic!("the page has no marker {begin}"));
    let (_, after) = rest.split_once(&end).unwrap_or_else(|| panic!("the page has no marker {end}"));
    format!("{before}{begin}\n{text}\n{end}{after}")
}

/// Writes a part of a page.
pub fn write_to(name: &str, part: &str, text: &str) {
    let page = std::fs::read_to_string(docs(name)).unwrap();
    std::fs::write(docs(name), with(&page, part, text)).unwrap();
}

/// Writes a figure.
pub fn write_svg(name: &str, svg: &str) {
    std::fs::write(docs(name), svg).unwrap();
}

/// Machine, benchmark and commit; states whether `sources` have changed since.
pub fn provenance(bench: &str, sources: &[&str]) -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split(": ").nth(1));
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        command.args(arguments).current_dir(env!("CARGO_MANIFEST_DIR"));
        let output = command.output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    let commit = git(&["rev-parse", "--short", "HEAD"]).unwrap_or_else(|| "unknown".into());
    let changed = git(&[&["status", "--porcelain", "--"], sources].concat()).is_none_or(|files| !files.is_empty());
    format!(
        "{}, {cores} cores, one thread; `cargo bench -p isophote-benches --bench {bench}`; commit {commit}{}.",
        model.unwrap_or("an unnamed processor"),
        if changed { " with changes" } else { "" }
    )
}
