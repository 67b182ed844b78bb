//! Runs tests that need a camera on a small virtual machine beside the repository (`../shared/v4l-rig`), whose kernel
//! has a virtual webcam (vivid), a loopback device (v4l2loopback) and software USB devices (vhci-hcd).
//!
//! The test runs its own executable again inside; the machine sees this file system and discards all writes.

use std::any::type_name;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::Command;
use std::sync::{Condvar, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use crate::{finish, repository};

/// Set for programs inside the rig.
const INSIDE: &str = "V4L_RIG";
/// The rig's exit status for its own failures.
const RIG_FAILED: i32 = 125;
/// Timeout of the first fetch of packages and build of modules.
const PREPARE_S_MAX: u64 = 600;
/// Grace period for the rig to end by itself after its own limit.
const END_S_MAX: u64 = 30;
/// Where the kernel waits for the software USB host controller, as [`blocked`] shows it.
const HOST_WAITS: [&str; 3] = ["usb_kill_urb", "usb_poison_urb", "vhci_"];
/// Polling interval.
const LOOK_MS: u64 = 20;

/// One vivid webcam at `/dev/video0`, its output at `/dev/video1`.
pub const WEBCAM: &str = "n_devs=1 node_types=0x101 vid_cap_nr=0 vid_out_nr=1";
/// One loopback device at `/dev/video0`.
pub const LOOPBACK: &str = "video_nr=0 card_label=rig max_buffers=8";
/// Modules for a camera of [`crate::uvccam`].
pub const USB: &[&str] = &["vhci-hcd", "uvcvideo"];

/// Configuration of the machine; nothing by default.
#[derive(Clone, Copy, Debug)]
pub struct Rig<'a> {
    /// vivid's parameters, if wanted: [`WEBCAM`].
    pub vivid: Option<&'a str>,
    /// v4l2loopback's parameters, if wanted: [`LOOPBACK`].
    pub loopback: Option<&'a str>,
    /// Further modules with their parameters: [`USB`].
    pub modules: &'a [&'a str],
    /// Shell commands before the test.
    pub pre: &'a str,
    /// Total timeout, including the start of the machine (some 5 to 10 s).
    pub timeout_s: u64,
}

impl Default for Rig<'_> {
    fn default() -> Self {
        Rig { vivid: None, loopback: None, modules: &[], pre: "", timeout_s: 60 }
    }
}

/// Result of a test in the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The body ran without a panic.
    Passed,
    /// There is no rig here; the reason was printed.
    Skipped,
}

/// Runs `body` inside the rig. Without a rig it prints `skipped: …` with the reason, and passes.
///
/// `body` must be a closure in the test itself: its type name selects the test to run inside. Code before this call
/// runs twice, here and inside; anything it needs built (see [`crate::program`]) is built outside.
///
/// # Panics
/// The body panics or times out, or the rig fails after it was prepared.
pub fn in_rig<F: FnOnce()>(rig: Rig, body: F) {
    if let Err(failure) = try_in_rig(rig, body) {
        panic!("{failure}");
    }
}

/// The same for tests of failures.
///
/// # Errors
/// Outside, if the body failed inside. Inside, a body's panic propagates.
pub fn try_in_rig<F: FnOnce()>(rig: Rig, body: F) -> Result<Outcome, String> {
    if is_inside() {
        body();
        return Ok(Outcome::Passed);
    }
    outside(rig, &test_of(type_name::<F>()))
}

/// Whether this process runs in the rig.
pub(crate) fn is_inside() -> bool {
    std::env::var_os(INSIDE).is_some()
}

/// Extracts `cameras::unplug` from a closure's `crate::cameras::unplug::{{closure}}`.
fn test_of(closure: &str) -> String {
    let path = closure.split("::{{closure}}").next().unwrap_or(closure);
    path.split_once("::").map_or(path, |(_, path)| path).to_string()
}

fn outside(rig: Rig, test: &str) -> Result<Outcome, String> {
    let script = match prepared(rig.loopback.is_some()) {
        Ok(script) => script,
        Err(reason) => {
            // `eprintln!` is shown for failing tests only.
            writeln!(io::stderr(), "skipped: {test}: {reason}").map_err(|error| error.to_string())?;
            return Ok(Outcome::Skipped);
        }
    };
    let message = |error: io::Error| error.to_string();
    let executable = std::env::current_exe().map_err(message)?;
    let lock = File::create(std::env::temp_dir().join("isophote-rig.lock")).map_err(message)?;
    lock.lock().map_err(message)?; // one machine at a time; closing the file unlocks
    let mut command = Command::new(script);
    command.arg(executable).args(["--exact", test, "--include-ignored", "--nocapture", "--test-threads", "1"]);
    command.env("V4L_RIG_VIVID", rig.vivid.unwrap_or("no")).env("V4L_RIG_LOOPBACK", rig.loopback.unwrap_or_default());
    command.env("V4L_RIG_MODULES", rig.modules.join(";")).env("V4L_RIG_PRE", rig.pre);
    command.env("V4L_RIG_TIMEOUT", rig.timeout_s.to_string());
    let mut finished = finish(&mut command, Duration::from_secs(rig.timeout_s + END_S_MAX)).map_err(message)?;
    // A crashed emulator, or the rig's host controller that never returns a transfer, does not decide the test: run it
    // again.
    let is_stuck = HOST_WAITS.iter().any(|function| finished.stderr.contains(function));
    if finished.status == Some(RIG_FAILED) || finished.status != Some(0) && is_stuck {
        eprintln!("the machine failed under {test}, once more: {}{}", finished.stdout, finished.stderr);
        finished = finish(&mut command, Duration::from_secs(rig.timeout_s + END_S_MAX)).map_err(message)?;
    }
    eprintln!("{}{}", finished.stdout, finished.stderr);
    // Status 0 alone could mean that no test has this name.
    match finished.status {
        Some(0) if finished.stdout.contains("test result: ok. 1 passed") => Ok(Outcome::Passed),
        Some(0) => Err(format!("no test called {test} ran in the rig")),
        status => Err(format!("{test} failed in the rig, status {status:?}; its output stands above")),
    }
}

/// The rig's script, with packages fetched and modules built; else why there is none.
fn prepared(loopback: bool) -> Result<PathBuf, String> {
    static PREPARED: [OnceLock<Result<PathBuf, String>>; 2] = [const { OnceLock::new() }; 2];
    PREPARED[usize::from(loopback)].get_or_init(|| prepare(loopback)).clone()
}

fn prepare(loopback: bool) -> Result<PathBuf, String> {
    let script = repository().join("../shared/v4l-rig/run.sh");
    if !script.is_file() {
        return Err("the rig is not beside the repository".into());
    }
    if !cfg!(all(target_os = "linux", target_arch = "x86_64")) {
        return Err("the rig's kernel is one for Linux on x86-64".into());
    }
    let user = Command::new("id").arg("-u").output().map_err(|error| format!("who runs this? {error}"))?;
    if user.stdout.trim_ascii() != b"0" {
        return Err("the rig needs root".into());
    }
    let mut command = Command::new(&script);
    command.arg("--prepare").env("V4L_RIG_LOOPBACK", if loopback { LOOPBACK } else { "" });
    let finished = finish(&mut command, Duration::from_secs(PREPARE_S_MAX)).map_err(|error| error.to_string())?;
    match finished.status {
        Some(0) => Ok(script),
        Some(RIG_FAILED) => Err(format!("the rig cannot be prepared: {}", finished.stderr.trim())),
        status => Err(format!("preparing the rig ended with {status:?}: {}", finished.stderr.trim())),
    }
}

/// Polls `look` until it returns something.
///
/// # Errors
/// Timed out after `limit`; the message names `what`.
pub fn until<T>(what: &str, limit: Duration, mut look: impl FnMut() -> Option<T>) -> io::Result<T> {
    let end = Instant::now() + limit;
    loop {
        if let Some(seen) = look() {
            return Ok(seen);
        }
        if Instant::now() > end {
            return Err(io::Error::new(io::ErrorKind::TimedOut, format!("no {what} within {limit:?}")));
        }
        wait(Duration::from_millis(LOOK_MS));
    }
}

/// Waits: for pictures at a rate, and between polls.
pub fn wait(time: Duration) {
    let (never, changed) = (Mutex::new(()), Condvar::new());
    let guard = never.lock().unwrap_or_else(PoisonError::into_inner);
    let waited = changed.wait_timeout_while(guard, time, |()| true);
    drop(waited.unwrap_or_else(PoisonError::into_inner));
}

/// Threads of programs, and busy or uninterruptible kernel threads, each with its state and kernel stack position:
/// shows a hanging driver.
pub fn threads() -> String {
    let entries = |folder: PathBuf| fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let of_process = |process: fs::DirEntry| {
        let is_program = fs::read(process.path().join("cmdline")).is_ok_and(|line| !line.is_empty());
        entries(process.path().join("task")).map(move |thread| (is_program, thread.path()))
    };
    let one = |(is_program, thread): (bool, PathBuf)| {
        let read = |file| fs::read_to_string(thread.join(file)).unwrap_or_default();
        let status = read("status");
        let state = status.lines().find_map(|line| line.strip_prefix("State:")).unwrap_or_default().trim();
        let is_listed = is_program || !state.starts_with(['S', 'I']);
        is_listed.then(|| format!("{}: {state}\n{}", read("comm").trim(), read("stack")))
    };
    entries("/proc".into()).flat_map(of_process).filter_map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closure_knows_its_test() {
        fn name<F: FnOnce()>(_: F) -> String {
            test_of(type_name::<F>())
        }
        assert_eq!(name(|| ()), "rig::tests::a_closure_knows_its_test");
    }

    #[test]
    fn waiting_ends() {
        let mut looks = 0;
        let third = || {
            looks += 1;
            (looks == 3).then_some(looks)
        };
        assert_eq!(until("third look", Duration::from_secs(5), third).ok(), Some(3));
        let error = until("wonder", Duration::from_millis(30), || None::<()>).err();
        assert!(error.is_some_and(|error| error.to_string().contains("no wonder within 30ms")));
    }
}
