//! Reads a recording (MCAP) in order: its session, then swaps, snapshots, and fits with their pictures and estimates.
//!
//! Holds only pictures that may still have a fit.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use isophote_capture::{LogMessage, LogReader};
use isophote_wire::{EstimateView, LOG_VERSION, LoggedFit, LoggedSession, LoggedSnapshot, LoggedSwap};
use serde::de::DeserializeOwned;

use crate::failure::Failure;

/// Maximum bytes of pictures without a fit yet.
const WAITING_BYTES: usize = 256 << 20;

/// A fitted frame.
pub struct RecordedFit {
    /// Circumstances of the fit.
    pub fit: LoggedFit,
    /// Its picture, if recorded.
    pub picture: Option<LogMessage>,
    /// Its estimates, one per target.
    pub estimates: Vec<EstimateView>,
}

/// An event of a recording.
pub enum Recorded {
    /// A model took over, or the first one started.
    Swap(Box<LoggedSwap>),
    /// The tracker's state.
    Snapshot(Box<LoggedSnapshot>),
    /// A frame was fitted.
    Fit(Box<RecordedFit>),
}

/// An open recording.
pub struct RecordedLog {
    path: PathBuf,
    reader: LogReader,
    /// The session recorded.
    pub session: LoggedSession,
    pictures: VecDeque<LogMessage>,
    bytes: usize,
    /// A fit whose estimates are not complete.
    fit: Option<Box<RecordedFit>>,
    /// An event read ahead.
    next: Option<Recorded>,
}

impl RecordedLog {
    /// Opens a file and reads its session.
    pub fn open(path: &Path) -> Result<RecordedLog, Failure> {
        let mut reader = LogReader::open(path).map_err(Failure::other)?;
        let foreign = || {
            let path = path.display();
            Failure::Usage(format!(
                "{path}: no recording of a session; `isophote fit --frames {path}` fits its pictures"
            ))
        };
        let (mut pictures, mut bytes) = (VecDeque::new(), 0);
        loop {
            let message = reader.next_message().map_err(Failure::other)?.ok_or_else(foreign)?;
            if &*message.schema != "isophote.Session" {
                if message.schema.starts_with("foxglove.") && bytes < WAITING_BYTES {
                    bytes += message.payload.len();
                    pictures.push_back(message);
                    continue;
                }
                return Err(foreign());
            }
            let version = parsed::<serde_json::Value>(path, &message)?["version"].clone();
            if version != LOG_VERSION {
                let path = path.display();
                return Err(Failure::Other(format!(
                    "{path}: its messages are of version {version}, this program reads version {LOG_VERSION}: take the program \
                     that recorded it"
                )));
            }
            let session = parsed(path, &message)?;
            return Ok(RecordedLog { path: path.into(), reader, session, pictures, bytes, fit: None, next: None });
        }
    }

    /// The next event; `None` at the end.
    pub fn next(&mut self) -> Result<Option<Recorded>, Failure> {
        if let Some(next) = self.next.take() {
            return Ok(Some(next));
        }
        while let Some(message) = self.reader.next_message().map_err(Failure::other)? {
            let happened = match &*message.schema {
                "isophote.Estimate" => {
                    let estimate = parsed(&self.path, &message)?;
                    if let Some(fit) = &mut self.fit {
                        fit.estimates.push(estimate);
                    }
                    continue;
                }
                "isophote.Fit" => {
                    let fit = parsed(&self.path, &message)?;
                    let picture = self.picture(message.log_time);
                    let fit = RecordedFit { fit, picture, estimates: Vec::new() };
                    match self.fit.replace(Box::new(fit)) {
                        Some(before) => return Ok(Some(Recorded::Fit(before))),
                        None => continue,
                    }
                }
                "isophote.Swap" => Recorded::Swap(Box::new(parsed(&self.path, &message)?)),
                "isophote.Snapshot" => Recorded::Snapshot(Box::new(parsed(&self.path, &message)?)),
                "foxglove.RawImage" | "foxglove.CompressedImage" => {
                    self.keep(message);
                    continue;
                }
                _ => continue,
            };
            return Ok(Some(match self.fit.take() {
                Some(before) => {
                    self.next = Some(happened);
                    Recorded::Fit(before)
                }
                None => happened,
            }));
        }
        Ok(self.fit.take().map(Recorded::Fit))
    }

    fn keep(&mut self, message: LogMessage) {
        self.bytes += message.payload.len();
        self.pictures.push_back(message);
        while self.bytes > WAITING_BYTES {
            let Some(oldest) = self.pictures.pop_front() else { return };
            self.bytes -= oldest.payload.len();
        }
    }

    /// Takes the picture of a log time; drops earlier ones, which were not fitted.
    fn picture(&mut self, log_time: u64) -> Option<LogMessage> {
        let found = self.pictures.iter().position(|picture| picture.log_time == log_time);
        let found = found.and_then(|at| self.pictures.remove(at));
        self.pictures.retain(|picture| picture.log_time > log_time);
        self.bytes = self.pictures.iter().map(|picture| picture.payload.len()).sum();
        found
    }
}

fn parsed<T: DeserializeOwned>(path: &Path, message: &LogMessage) -> Result<T, Failure> {
    let wrong = |error| Failure::Other(format!("{}: a message on {}: {error}", path.display(), message.topic));
    serde_json::from_slice(&message.payload).map_err(wrong)
}
