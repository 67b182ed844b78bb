//! Tests that need a camera run on a machine that has one: a small virtual one beside the repository (`../shared/v4l-rig`),
//! whose kernel has a virtual webcam (vivid), a loopback device (v4l2loopback) and USB devices made of software (vhci-hcd).
//!
//! In: what the machine shall have, and a test's body. Out: the body's result, as if it had run here. The test runs its own
//! executable once more in there; the machine sees this file system and forgets what was written to it.

use std::any::type_name;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::Command;
use std::sync::{Condvar, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use crate::{finish, repository};

/// Set where a program runs inside the rig.
const INSIDE: &str = "V4L_RIG";
/// The rig's exit status when it could not do its work.
const RIG_FAILED: i32 = 125;
/// Time for fetching packages and building modules, the first time.
const PREPARE_S_MAX: u64 = 600;
/// Time that the rig gets to end by itself after its own limit.
const END_S_MAX: u64 = 30;
/// Where the kernel waits for the software USB host controller, as [`blocked`] shows it.
const HOST_WAITS: [&str; 3] = ["usb_kill_urb", "usb_poison_urb", "vhci_"];
/// Between two looks at something that is waited for.
const LOOK_MS: u64 = 20;

/// One webcam of vivid's at `/dev/video0`, its output at `/dev/video1`.
pub const WEBCAM: &str = "n_devs=1 node_types=0x101 vid_cap_nr=0 vid_out_nr=1";
/// One loopback device at `/dev/video0`.
pub const LOOPBACK: &str = "video_nr=0 card_label=rig max_buffers=8";
/// What a camera of [`crate::uvccam`] needs.
pub const USB: &[&str] = &["vhci-hcd", "uvcvideo"];

/// What the machine shall have; nothing by default.
#[derive(Clone, Copy, Debug)]
pub struct Rig<'a> {
    /// vivid's parameters, where it is wanted: [`WEBCAM`].
    pub vivid: Option<&'a str>,
    /// v4l2loopback's parameters, where it is wanted: [`LOOPBACK`].
    pub loopback: Option<&'a str>,
    /// Further modules with their parameters: [`USB`].
    pub modules: &'a [&'a str],
    /// Commands of a shell before the test.
    pub pre: &'a str,
    /// Time for it all, starting the machine included (some 5 to 10 s).
    pub timeout_s: u64,
}

impl Default for Rig<'_> {
    fn default() -> Self {
        Rig { vivid: None, loopback: None, modules: &[], pre: "", timeout_s: 60 }
    }
}

/// How a test in the rig went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Its body has run, and did not panic.
    Passed,
    /// There is no rig here; why was said.
    Skipped,
}

/// Runs `body` inside the rig. Where there is no rig, says `skipped: …` and why, and passes.
///
/// `body` must be a closure that stands in the test itself: its name says which test is run in there. What the test does
/// before this call happens twice, here and inside; what it needs built (see [`crate::program`]) is built there.
///
/// # Panics
/// When the body panics or is not over in time, and when the rig fails after it was prepared.
pub fn in_rig<F: FnOnce()>(rig: Rig, body: F) {
    if let Err(failure) = try_in_rig(rig, body) {
        panic!("{failure}");
    }
}

/// The same for tests of failures.
///
/// # Errors
/// Outside, when the body failed inside. Inside, a body's panic goes on its way.
pub fn try_in_rig<F: FnOnce()>(rig: Rig, body: F) -> Result<Outcome, String> {
    if is_inside() {
        body();
        return Ok(Outcome::Passed);
    }
    outside(rig, &test_of(type_name::<F>()))
}

/// Whether this runs in the rig.
pub(crate) fn is_inside() -> bool {
    std::env::var_os(INSIDE).is_some()
}

/// `cameras::unplug` of a closure's `crate::cameras::unplug::{{closure}}`.
fn test_of(closure: &str) -> String {
    let path = closure.split("::{{closure}}").next().unwrap_or(closure);
    path.split_once("::").map_or(path, |(_, path)| path).to_string()
}

fn outside(rig: Rig, test: &str) -> Result<Outcome, String> {
    let script = match prepared(rig.loopback.is_some()) {
        Ok(script) => script,
        Err(reason) => {
            // Not by `eprintln!`, which is only shown for tests that fail.
            writeln!(io::stderr(), "skipped: {test}: {reason}").map_err(|error| error.to_string())?;
            return Ok(Outcome::Skipped);
        }
    };
    let said = |error: io::Error| error.to_string();
    let executable = std::env::current_exe().map_err(said)?;
    let lock = File::create(std::env::temp_dir().join("isophote-rig.lock")).map_err(said)?;
    lock.lock().map_err(said)?; // one machine at a time; freed when the file is closed
    let mut command = Command::new(script);
    command.arg(executable).args(["--exact", test, "--nocapture", "--test-threads", "1"]);
    command.env("V4L_RIG_VIVID", rig.vivid.unwrap_or("no")).env("V4L_RIG_LOOPBACK", rig.loopback.unwrap_or_default());
    command.env("V4L_RIG_MODULES", rig.modules.join(";")).env("V4L_RIG_PRE", rig.pre);
    command.env("V4L_RIG_TIMEOUT", rig.timeout_s.to_string());
    let mut finished = finish(&mut command, Duration::from_secs(rig.timeout_s + END_S_MAX)).map_err(said)?;
    // An emulator that crashes says nothing about the test, which then has not ended; nor does a host controller, which is
    // the rig's, that never gives a transfer back.
    let is_stuck = HOST_WAITS.iter().any(|function| finished.stderr.contains(function));
    if finished.status == Some(RIG_FAILED) || finished.status != Some(0) && is_stuck {
        eprintln!("the machine failed under {test}, once more: {}{}", finished.stdout, finished.stderr);
        finished = finish(&mut command, Duration::from_secs(rig.timeout_s + END_S_MAX)).map_err(said)?;
    }
    eprintln!("{}{}", finished.stdout, finished.stderr);
    // Status 0 alone could mean that no test has this name.
    match finished.status {
        Some(0) if finished.stdout.contains("test result: ok. 1 passed") => Ok(Outcome::Passed),
        Some(0) => Err(format!("no test called {test} ran in the rig")),
        status => Err(format!("{test} failed in the rig, status {status:?}; its output stands above")),
    }
}

/// The rig's script, its packages fetched and its modules built; else why there is none.
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

/// Looks again and again until there is something to see.
///
/// # Errors
/// When there is nothing within `limit`; the message says `what` was waited for.
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

/// Lets time pass: for pictures at a rate, and for looking again.
pub fn wait(time: Duration) {
    let (never, changed) = (Mutex::new(()), Condvar::new());
    let guard = never.lock().unwrap_or_else(PoisonError::into_inner);
    let waited = changed.wait_timeout_while(guard, time, |()| true);
    drop(waited.unwrap_or_else(PoisonError::into_inner));
}

/// Threads of programs, and those of the kernel that are busy or cannot be interrupted, each with its state and where in the
/// kernel it is: a driver that hangs is seen here.
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
