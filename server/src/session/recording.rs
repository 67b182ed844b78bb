//! A session's recording: one at a time, begun and ended by whoever asks.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use isophote_wire::{LoggedSession, RecordDocument, RecordingView};

use super::inbox::{Inbox, Waiting};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::recording::{FileName, FolderFault, RecordingFolder, SessionRecording};
use crate::source::Source;

/// The last one.
#[derive(Default)]
pub struct LastRecording(Mutex<Option<Arc<SessionRecording>>>);

fn check(document: &RecordDocument) -> Result<(), Problem> {
    let limit = LIMITS.recording_mb;
    let out_of_range = |key: &str| Problem::wrong_key("out-of-range", key, format!("must be 1 to {limit}"));
    let inside = |number: u64| (1..=limit).contains(&number);
    if !inside(document.disk_budget_mb) {
        return Err(out_of_range("disk_budget_mb"));
    }
    if !document.rotate_mb.is_none_or(inside) {
        return Err(out_of_range("rotate_mb"));
    }
    if !document.rotate_s.is_none_or(inside) {
        return Err(out_of_range("rotate_s"));
    }
    let is_name = |name: &String| name.len() <= 64 && FileName::of(name, 1).is_some();
    if !document.name.as_ref().is_none_or(is_name) {
        let message =
            "a name is made of 1 to 64 of a-z, 0-9 and -, and does not begin with -; the service chooses the folder";
        return Err(Problem::wrong_key("wrong-name", "name", message));
    }
    Ok(())
}

impl LastRecording {
    fn get(&self) -> Option<Arc<SessionRecording>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Begins to record. It takes no longer than a file does to be made.
    pub fn begin(
        &self,
        folder: &RecordingFolder,
        document: RecordDocument,
        session: LoggedSession,
        (inbox, source): (&Inbox, Arc<Source>),
    ) -> Result<RecordingView, Problem> {
        check(&document)?;
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let name = session.session.clone();
        // A session that ends closes its inbox before it asks for this lock.
        if inbox.waiting() == Waiting::End {
            return Err(Problem::conflict("not-applicable", format!("the session `{name}` has ended")));
        }
        if last.as_ref().is_some_and(|recording| recording.is_running()) {
            let detail = format!("the session `{name}` is being recorded; DELETE its recording first");
            return Err(Problem::conflict("in-use", detail));
        }
        let begun = SessionRecording::begin(folder.clone(), document, session, move || source.camera());
        let recording = Arc::new(begun.map_err(FolderFault::problem)?);
        inbox.record(Some(recording.tap().clone()));
        tracing::info!(session = name, "a recording has begun");
        let view = recording.view();
        *last = Some(recording);
        Ok(view)
    }

    /// What it does, or did.
    pub fn view(&self) -> Option<RecordingView> {
        Some(self.get()?.view())
    }

    /// Ends it, and forgets it; whoever asked may wait for the end of its file.
    pub fn stop(&self, inbox: &Inbox) -> Option<Arc<SessionRecording>> {
        let recording = self.0.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        inbox.record(None);
        recording.end("it was ended");
        Some(recording)
    }

    /// Its file gets its end; what was recorded can still be asked for.
    pub fn end(&self, inbox: &Inbox, reason: &str) {
        if let Some(recording) = self.get() {
            inbox.record(None);
            recording.end(reason);
        }
    }

    /// Waits for that.
    pub fn wait(&self, until: Instant) {
        if let Some(recording) = self.get() {
            recording.wait(until);
        }
    }
}
