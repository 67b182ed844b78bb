//! Log of the service on standard error, as text or JSON.
//!
//! A thread of its own writes the lines, so that logging never blocks: while nobody reads, lines are dropped, and
//! their number is logged once reading resumes.

use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use isophote_machine::{rfc3339, unix_ms};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;

/// Format of log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Plain text.
    Text,
    /// One JSON object per line.
    Json,
}

/// Minimum level of log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LogLevel {
    /// Faults of the service itself.
    Error,
    /// Problems during which the service continues.
    Warn,
    /// Every change of state.
    Info,
    /// Details for troubleshooting.
    Debug,
}

impl LogLevel {
    fn level(self) -> tracing_subscriber::filter::LevelFilter {
        use tracing_subscriber::filter::LevelFilter;
        match self {
            LogLevel::Error => LevelFilter::ERROR,
            LogLevel::Warn => LevelFilter::WARN,
            LogLevel::Info => LevelFilter::INFO,
            LogLevel::Debug => LevelFilter::DEBUG,
        }
    }
}

/// Capacity of the queue, in lines.
const LINES: usize = 4096;
/// Time to flush the queue at the end.
const END: Duration = Duration::from_millis(500);

/// Flushes the log on drop.
pub struct Log {
    written: Receiver<()>,
    lines: SyncSender<Option<Vec<u8>>>,
}

impl Log {
    /// Installs the log as the global subscriber. Call once.
    ///
    /// # Errors
    /// The writer thread cannot be started.
    pub fn start(format: LogFormat, level: LogLevel) -> io::Result<Log> {
        let (lines, waiting) = sync_channel(LINES);
        let prefix = if is_journal() { Prefix::Bare } else { Prefix::Timed };
        let (done, written) = sync_channel(0);
        let lost = Arc::new(AtomicU64::new(0));
        let theirs = lost.clone();
        let write = move || {
            write_lines(&waiting, &theirs, (format, prefix));
            drop(done);
        };
        Builder::new().name("log".into()).spawn(write)?;
        let writer = Lines { lines: lines.clone(), lost };
        let builder = tracing_subscriber::fmt().with_max_level(level.level()).with_target(false).with_writer(writer);
        match format {
            LogFormat::Text => builder.with_ansi(false).with_timer(prefix).init(),
            LogFormat::Json => builder.json().flatten_event(true).init(),
        }
        Ok(Log { written, lines })
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        if self.lines.try_send(None).is_ok() {
            // The channel closes once all lines are written; a blocked reader delays the exit by `END` at most.
            self.written.recv_timeout(END).ok();
        }
    }
}

fn write_lines(waiting: &Receiver<Option<Vec<u8>>>, lost: &AtomicU64, format: (LogFormat, Prefix)) {
    while let Ok(Some(line)) = waiting.recv() {
        let count = lost.swap(0, Ordering::Relaxed);
        let mut text = Vec::new();
        if count > 0 {
            text.extend_from_slice(left_out(count, format).as_bytes());
        }
        text.extend_from_slice(&line);
        io::stderr().lock().write_all(&text).ok(); // a failed log has no other output
    }
}

fn left_out(count: u64, (format, prefix): (LogFormat, Prefix)) -> String {
    let message = "lines of the log were left out, because nobody read them";
    match format {
        LogFormat::Text => format!("{prefix}  WARN {message} count={count}\n"),
        LogFormat::Json => {
            let timestamp = rfc3339(unix_ms());
            let line = serde_json::json!({"timestamp": timestamp, "level": "WARN", "message": message, "count": count});
            format!("{line}\n")
        }
    }
}

/// Prefix of a text line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Prefix {
    /// The time, RFC 3339 in UTC, and the program's name.
    Timed,
    /// The name alone: systemd's journal timestamps each line.
    Bare,
}

impl std::fmt::Display for Prefix {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Prefix::Timed => write!(formatter, "{} isophote:", rfc3339(unix_ms())),
            Prefix::Bare => formatter.write_str("isophote:"),
        }
    }
}

impl FormatTime for Prefix {
    fn format_time(&self, writer: &mut Writer<'_>) -> std::fmt::Result {
        write!(writer, "{self}")
    }
}

/// Whether standard error is the journal stream of systemd: `JOURNAL_STREAM` is its device and inode, and is also
/// inherited by processes whose standard error is redirected.
fn is_journal() -> bool {
    let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    let standard_error = io::stderr().as_fd().try_clone_to_owned().and_then(|fd| File::from(fd).metadata());
    standard_error.is_ok_and(|about| stream == format!("{}:{}", about.dev(), about.ino()))
}

/// Queues lines for the writer thread.
struct Lines {
    lines: SyncSender<Option<Vec<u8>>>,
    lost: Arc<AtomicU64>,
}

/// One line, sent when complete.
struct Line<'a> {
    bytes: Vec<u8>,
    to: &'a Lines,
}

impl<'a> MakeWriter<'a> for Lines {
    type Writer = Line<'a>;
    fn make_writer(&'a self) -> Line<'a> {
        Line { bytes: Vec::new(), to: self }
    }
}

impl Write for Line<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line<'_> {
    fn drop(&mut self) {
        if let Err(TrySendError::Full(_)) = self.to.lines.try_send(Some(std::mem::take(&mut self.bytes))) {
            self.to.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn full_queues_drop_lines_without_blocking() {
        let (lines, waiting) = sync_channel(1);
        let to = Lines { lines, lost: Arc::default() };
        for line in ["one\n", "two\n", "three\n"] {
            to.make_writer().write_all(line.as_bytes()).unwrap();
        }
        assert_eq!((waiting.recv().unwrap(), to.lost.load(Ordering::Relaxed)), (Some(b"one\n".to_vec()), 2));
        let line: serde_json::Value = serde_json::from_str(&left_out(2, (LogFormat::Json, Prefix::Bare))).unwrap();
        assert_eq!(line["count"], 2);
        assert!(line["timestamp"].is_string());
        assert!(left_out(2, (LogFormat::Text, Prefix::Bare)).ends_with("count=2\n"));
    }
}
