//! A session's recording: one at a time, begun and ended by whoever asks.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use isophote_wire::{LoggedSession, RecordDocument, RecordingView};

use super::inbox::{Inbox, Waiting};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::recording::{FileName, FolderFault, RecordingFolder, SessionRecording};
use crate::source::Source;

/// The last one.
#[derive(Default)]
pub struct LastRecording(Mutex<State>);

#[derive(Default)]
struct State {
    last: Option<Arc<SessionRecording>>,
    /// The first file of another one is being made.
    is_beginning: bool,
}

/// Whoever makes the first file of a recording, until it is there or cannot be made.
struct Beginning<'a>(&'a LastRecording);

impl Drop for Beginning<'_> {
    fn drop(&mut self) {
        self.0.lock().is_beginning = false;
    }
}

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
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self) -> Option<Arc<SessionRecording>> {
        self.lock().last.clone()
    }

    /// Begins to record. It takes no longer than a file does to be made; nobody else waits for that.
    pub fn begin(
        &self,
        folder: &RecordingFolder,
        document: RecordDocument,
        session: LoggedSession,
        (inbox, source): (&Inbox, Arc<Source>),
    ) -> Result<RecordingView, Problem> {
        check(&document)?;
        let name = session.session.clone();
        let over = || Problem::conflict("not-applicable", format!("the session `{name}` has ended"));
        let _beginning = {
            let mut state = self.lock();
            if inbox.waiting() == Waiting::End {
                return Err(over());
            }
            if state.is_beginning || state.last.as_ref().is_some_and(|recording| recording.is_running()) {
                let detail = format!("the session `{name}` is being recorded; DELETE its recording first");
                return Err(Problem::conflict("in-use", detail));
            }
            state.is_beginning = true;
            Beginning(self)
        };
        let begun = SessionRecording::begin(folder.clone(), document, session, move || source.camera());
        let recording = Arc::new(begun.map_err(FolderFault::problem)?);
        let mut state = self.lock();
        // A session that ends closes its inbox before it asks for this lock.
        if inbox.waiting() == Waiting::End {
            recording.end("the session has ended");
            return Err(over());
        }
        inbox.record(Some(recording.tap().clone()));
        tracing::info!(session = name, "a recording has begun");
        let view = recording.view();
        state.last = Some(recording);
        Ok(view)
    }

    /// What it does, or did.
    pub fn view(&self) -> Option<RecordingView> {
        Some(self.get()?.view())
    }

    /// Ends it, and forgets it; whoever asked may wait for the end of its file.
    pub fn stop(&self, inbox: &Inbox) -> Option<Arc<SessionRecording>> {
        let recording = self.lock().last.take()?;
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
