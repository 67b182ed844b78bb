//! Runs the examples of README.md and docs/.
//!
//! - A block marked `toml model` (or `json model`) is a model document and must check. With a third word, a file name,
//!   it is also written to the folder in which the document's commands run.
//! - The commands of a block marked `sh` run in that folder, one after another: `isophote …` (also written `cargo run
//!   --release -- …`) with the program built from these sources, `curl …` if installed. `# exits 3` after a command is
//!   its expected status, when not 0. A long-running `isophote serve` is started on a port of its own and becomes the
//!   service of the following commands; where a document starts none, commands that need a service get one with
//!   `--demo`. Every other command must be in [`NOT_RUN`].
//! - The same holds for `python3 FILE` and `node FILE`, if installed (Node with built-in WebSocket, version 22 or
//!   newer).
//! - `../shared` (test data outside the repository) is used if it exists beside the repository.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use isophote_symbolic::Model;
use isophote_tests::{Service, finish, program, repository};

use crate::markdown::{Block, blocks};
use crate::{File, expect_none, files};

/// Prefixes of commands that only readers run.
const NOT_RUN: [&str; 9] = [
    "git clone",
    "cd ",
    "cargo test",
    "cargo bench",
    "cargo build",
    "cargo run -p",
    "cargo install",
    ".ci/run",
    "book/build",
];
/// External programs, run if installed, and a command that tests for each.
const INTERPRETERS: [(&str, &str); 3] = [
    ("curl ", "curl --version"),
    ("python3 ", "python3 --version"),
    ("node ", "node -e 'new WebSocket(\"ws://127.0.0.1:9\").onerror = () => 0'"),
];
/// Commands of `isophote` that need no service.
pub const OFFLINE: [&str; 16] = [
    "model check",
    "model explain",
    "model export",
    "fit",
    "render",
    "tune",
    "compare",
    "replay",
    "calibrate",
    "token",
    "config show",
    "serve --check",
    "completions",
    "man",
    "--help",
    "--version",
];
/// Timeout of one command.
const COMMAND_S_MAX: u64 = 300;
/// The address used in the documents.
const DOCUMENTED: &str = "127.0.0.1:7240";

/// How to run one command of a document.
#[derive(Debug, PartialEq)]
enum Step {
    /// Skipped.
    Left,
    /// `isophote serve …`, with its arguments except `--listen`.
    Serve(Vec<String>),
    /// Run by the shell; whether it needs a service, and the expected status.
    Run { shell: String, online: bool, exit: i32 },
    /// Not recognised.
    Unknown,
}

fn step(command: &str) -> Step {
    let (shell, comment) = command.split_once(" #").unwrap_or((command, ""));
    let exit =
        comment.split("exits ").nth(1).and_then(|rest| rest.split_whitespace().next()?.parse().ok()).unwrap_or(0);
    let shell = shell.trim().replace("cargo run --release -- ", "isophote ");
    if NOT_RUN.iter().any(|head| shell.starts_with(head)) {
        return Step::Left;
    }
    let Some(arguments) = shell.strip_prefix("isophote ") else {
        let online = INTERPRETERS.iter().any(|(head, _)| shell.starts_with(head));
        return if online { Step::Run { shell, online, exit } } else { Step::Unknown };
    };
    if let Some(arguments) = arguments.strip_prefix("serve").filter(|rest| !rest.starts_with(" --check")) {
        let words: Vec<String> = arguments.split_whitespace().map(String::from).collect();
        let listen = words.iter().position(|word| word == "--listen");
        let kept = words.iter().enumerate().filter(|(i, _)| listen.is_none_or(|at| *i != at && *i != at + 1));
        return Step::Serve(kept.map(|(_, word)| word.clone()).collect());
    }
    let online = !OFFLINE.iter().any(|head| arguments.starts_with(head)) || arguments.contains(" --live ");
    let endless = arguments.starts_with("watch ") && !arguments.contains("--count");
    let shell = if endless { format!("{shell} --count 3") } else { shell };
    Step::Run { shell, online, exit }
}

/// The commands of a block with their lines; a backslash joins lines, comments and blank lines are skipped.
fn commands(block: &Block) -> Vec<(usize, String)> {
    let mut commands: Vec<(usize, String)> = Vec::new();
    let mut joining = false;
    for (i, line) in block.text.lines().enumerate() {
        let (part, more) = line.strip_suffix('\\').map_or((line, false), |part| (part, true));
        match commands.last_mut() {
            Some((_, command)) if joining => *command += part.trim_start(),
            _ if part.trim().is_empty() || part.starts_with('#') => {}
            _ => commands.push((block.line + i, part.to_string())),
        }
        joining = more;
    }
    commands
}

/// The folder in which a document's commands run, and their service.
struct Sandbox {
    folder: PathBuf,
    service: Option<Service>,
}

impl Sandbox {
    /// Creates a folder that resembles the repository root: with `models/` and `docs/`, and `../shared` if the
    /// repository has it.
    fn new(name: &str) -> Sandbox {
        let parent = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name.replace('/', "-"));
        if parent.exists() {
            fs::remove_dir_all(&parent).unwrap();
        }
        let folder = parent.join("repository");
        fs::create_dir_all(&folder).unwrap();
        let top = repository();
        copy(&top.join("models"), &folder.join("models"));
        copy(&top.join("docs"), &folder.join("docs"));
        if let Some(shared) = shared() {
            std::os::unix::fs::symlink(shared, parent.join("shared")).unwrap();
        }
        Sandbox { folder, service: None }
    }

    fn serve(&mut self, arguments: &[String]) {
        self.service = None;
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        self.service = Some(Service::start(&program().unwrap(), &arguments, &self.folder).unwrap());
    }

    /// Runs one command; fails with a description.
    fn run(&mut self, command: &str) -> Result<(), String> {
        let (shell, online, exit) = match step(command) {
            Step::Left => return Ok(()),
            Step::Unknown => {
                return Err("is neither run by this test nor in its list of commands left to the reader".into());
            }
            Step::Serve(arguments) => {
                self.serve(&arguments);
                return Ok(());
            }
            Step::Run { shell, online, exit } => (shell, online, exit),
        };
        if shell.contains("../shared") && shared().is_none() {
            eprintln!("skipped, ../shared is not here: {shell}");
            return Ok(());
        }
        if INTERPRETERS.iter().any(|(head, check)| shell.starts_with(head) && !runs(check)) {
            eprintln!("skipped, what runs it is not here: {shell}");
            return Ok(());
        }
        if online && self.service.is_none() {
            self.serve(&["--demo".into()]);
        }
        let mut process = Command::new("sh");
        let address = self.service.as_ref().map_or(DOCUMENTED, Service::address);
        process.arg("-c").arg(shell.replace(DOCUMENTED, address)).current_dir(&self.folder);
        let inherited = std::env::var("PATH").unwrap_or_default();
        process.env("PATH", format!("{}:{inherited}", program().unwrap().parent().unwrap().display()));
        process.env("ISOPHOTE_SERVER", format!("http://{address}"));
        let finished = finish(&mut process, Duration::from_secs(COMMAND_S_MAX)).map_err(|e| e.to_string())?;
        let tail = |text: &str| {
            text.lines().rev().take(8).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n    ")
        };
        eprintln!("ran, status {:?}: {shell}", finished.status);
        match finished.status {
            Some(status) if status == exit => Ok(()),
            status => Err(format!(
                "ended with {status:?}, not {exit}\n    {}\n    {}",
                tail(&finished.stdout),
                tail(&finished.stderr)
            )),
        }
    }
}

/// The folder of test data beside the repository.
fn shared() -> Option<PathBuf> {
    let folder = repository().parent()?.join("shared");
    folder.is_dir().then_some(folder)
}

/// Whether a command succeeds here.
fn runs(command: &str) -> bool {
    Command::new("sh").arg("-c").arg(command).output().is_ok_and(|output| output.status.success())
}

/// Copies the files of a folder: examples may write beside them.
fn copy(from: &Path, to: &Path) {
    let mut paths = Vec::new();
    isophote_tests::files_below(from, &mut paths).unwrap();
    for path in paths {
        let target = to.join(path.strip_prefix(from).unwrap());
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::copy(&path, target).unwrap();
    }
}

/// Checks a model document; fails with a description.
fn check_model(block: &Block) -> Result<(), String> {
    let result = match block.words[0].as_str() {
        "json" => Model::from_json(&block.text),
        _ => Model::from_toml(&block.text),
    };
    result.map(drop).map_err(|diagnostics| diagnostics.iter().map(|d| d.render("block")).collect())
}

fn is_model(block: &Block) -> bool {
    block.words.get(1).is_some_and(|word| word == "model") && matches!(block.words[0].as_str(), "toml" | "json")
}

/// Runs a whole document in its own folder.
fn faults(document: &File) -> Vec<String> {
    let blocks = blocks(&document.text);
    let mut found = Vec::new();
    let mut sandbox: Option<Sandbox> = None;
    for block in &blocks {
        if is_model(block) {
            found.extend(check_model(block).err().map(|fault| format!("{}:{}: {fault}", document.path, block.line)));
        }
        let shell = block.words.first().is_some_and(|word| word == "sh");
        if !shell && block.words.len() < 3 {
            continue;
        }
        let sandbox = sandbox.get_or_insert_with(|| Sandbox::new(&document.path));
        if let Some(name) = block.words.get(2) {
            fs::write(sandbox.folder.join(name), &block.text).unwrap();
        }
        for (line, command) in if shell { commands(block) } else { Vec::new() } {
            found.extend(
                sandbox.run(&command).err().map(|fault| format!("{}:{line}: `{command}` {fault}", document.path)),
            );
        }
    }
    found
}

#[test]
#[ignore = "long proof"]
fn readme_and_docs_run_as_written() {
    let documents = files(&[".md"]);
    let shown = documents.iter().filter(|document| document.path == "README.md" || document.path.starts_with("docs/"));
    let found: Vec<String> = shown.flat_map(faults).collect();
    expect_none("examples", &found);
}

#[test]
fn commands_are_parsed() {
    let block = |text: &str| Block { words: vec!["sh".into()], line: 1, text: text.into() };
    let joined = commands(&block("# a comment\nisophote fit a.toml \\\n  --frames out\n\nisophote watch demo\n"));
    assert_eq!(joined, [(2, "isophote fit a.toml --frames out".into()), (5, "isophote watch demo".into())]);
    let run = |shell: &str, online, exit| Step::Run { shell: shell.into(), online, exit };
    assert_eq!(
        step("cargo run --release -- model check a.toml   # exits 3"),
        run("isophote model check a.toml", false, 3)
    );
    assert_eq!(step("isophote watch demo"), run("isophote watch demo --count 3", true, 0));
    assert_eq!(step("isophote session stop demo"), run("isophote session stop demo", true, 0));
    assert_eq!(step("isophote serve --listen 127.0.0.1:7241 --demo"), Step::Serve(vec!["--demo".into()]));
    assert_eq!((step("git clone x"), step("rm -rf x")), (Step::Left, Step::Unknown));
}

#[test]
fn planted_faults_are_caught() {
    let bad = "```toml model\nname = \"m\"\n```\n```sh\nmake me a sandwich\nisophote model check none.toml\n\
               isophote model check models/spot.toml # exits 3\nisophote model check models/spot.toml\n```\n";
    let found = faults(&File { path: "planted.md".into(), text: bad.into() });
    let lines: Vec<&str> = found.iter().filter_map(|fault| fault.split(':').nth(1)).collect();
    assert_eq!(lines, ["2", "5", "6", "7"], "{found:?}");
}
