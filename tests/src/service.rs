//! A running `isophote serve`, and commands with a timeout.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

/// Timeout for a service to print its address.
const START_S_MAX: u64 = 120;
/// Maximum of buffered output lines; further ones are dropped, so the service never blocks.
const LINES_MAX: usize = 4096;

/// A service on its own port; it ends on drop.
pub struct Service {
    child: Child,
    address: String,
}

impl Service {
    /// Starts `program serve --listen 127.0.0.1:0 ARGUMENTS` in `folder` and waits for its address.
    pub fn start(program: &Path, arguments: &[&str], folder: &Path) -> io::Result<Service> {
        let mut command = Command::new(program);
        command.args(["serve", "--listen", "127.0.0.1:0"]).args(arguments).current_dir(folder);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn()?;
        let (lines, output_lines) = sync_channel(LINES_MAX);
        if let Some(stdout) = child.stdout.take() {
            listen("service stdout", stdout, lines.clone())?;
        }
        if let Some(stderr) = child.stderr.take() {
            listen("service stderr", stderr, lines)?;
        }
        let mut service = Service { child, address: String::new() };
        service.address = read_address(&output_lines)?;
        Ok(service)
    }

    /// Host and port, `127.0.0.1:49152`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The value for `ISOPHOTE_SERVER`.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The process, for tests that measure or kill it.
    pub fn child(&mut self) -> &mut Child {
        &mut self.child
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // It may have exited, which is fine.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Forwards every line; if nobody reads them, lines are dropped, so that the pipe never fills.
fn listen(name: &str, pipe: impl Read + Send + 'static, lines: SyncSender<String>) -> io::Result<()> {
    let read = move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            lines.try_send(line).ok();
        }
    };
    thread::Builder::new().name(name.into()).spawn(read).map(drop)
}

fn read_address(output_lines: &Receiver<String>) -> io::Result<String> {
    let mut output = String::new();
    loop {
        match output_lines.recv_timeout(Duration::from_secs(START_S_MAX)) {
            Ok(line) => match address_in(&line) {
                Some(address) => return Ok(address),
                None => output += &format!("{line}\n"),
            },
            Err(RecvTimeoutError::Timeout) => {
                return Err(io::Error::other(format!("no address within {START_S_MAX} s; it said:\n{output}")));
            }
            Err(RecvTimeoutError::Disconnected) => {
                return Err(io::Error::other(format!("the service ended; it said:\n{output}")));
            }
        }
    }
}

/// Finds `127.0.0.1:49152` in a line; ignores port 0.
fn address_in(line: &str) -> Option<String> {
    let host = "127.0.0.1:";
    let start = line.find(host)?;
    let digits: String = line[start + host.len()..].chars().take_while(char::is_ascii_digit).collect();
    (digits.parse::<u16>().ok()? > 0).then(|| format!("{host}{digits}"))
}

/// Result of a command.
#[derive(Clone, Debug)]
pub struct Finished {
    /// The exit status; `None` after a signal.
    pub status: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// Runs a command without input, and kills it after `limit`.
pub fn finish(command: &mut Command, limit: Duration) -> io::Result<Finished> {
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let (texts, output_lines) = sync_channel(2);
    let pipes: [(usize, Option<Box<dyn Read + Send>>); 2] = [
        (0, child.stdout.take().map(|pipe| Box::new(pipe) as _)),
        (1, child.stderr.take().map(|pipe| Box::new(pipe) as _)),
    ];
    for (which, pipe) in pipes {
        let (mut pipe, texts) = (pipe.ok_or_else(|| io::Error::other("no pipe"))?, texts.clone());
        let read = move || {
            let mut bytes = Vec::new();
            pipe.read_to_end(&mut bytes).ok();
            texts.send((which, String::from_utf8_lossy(&bytes).into_owned())).ok();
        };
        thread::Builder::new().name("command output".into()).spawn(read)?;
    }
    let mut both = [String::new(), String::new()];
    let mut ended = false;
    for _ in 0..2 {
        let next = output_lines.recv_timeout(limit).or_else(|_| {
            ended = true;
            child.kill().ok();
            output_lines.recv().map_err(io::Error::other)
        })?;
        both[next.0] = next.1;
    }
    let status = child.wait()?;
    let [stdout, stderr] = both;
    Ok(Finished { status: if ended { None } else { status.code() }, stdout, stderr })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn addresses_are_found_in_output() {
        assert_eq!(address_in("listening on http://127.0.0.1:49152/"), Some("127.0.0.1:49152".into()));
        assert_eq!(address_in("listening on http://127.0.0.1:0"), None);
        assert_eq!(address_in("hello"), None);
    }

    #[test]
    fn endless_commands_are_killed() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo begun; exec sleep 60"]);
        let finished = finish(&mut command, Duration::from_millis(500)).unwrap();
        assert_eq!((finished.status, finished.stdout.as_str()), (None, "begun\n"));
    }
}
