//! A session's recordings: one at a time, started and ended by clients.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use isophote_wire::{LoggedSession, RecordDocument, RecordingView};

use super::inbox::{Inbox, Waiting};
use crate::http::preconditions::{EntityTag, Preconditions};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::recording::{FileName, FolderFault, RecordingFolder, SessionRecording};
use crate::source::Source;

/// The last recording.
#[derive(Default)]
pub struct LastRecording {
    state: Mutex<State>,
    /// Notified when the first file of a recording was created, or creating it failed.
    begun: Condvar,
}

#[derive(Default)]
struct State {
    last: Option<(EntityTag, Arc<SessionRecording>)>,
    /// The first file of another one is being created.
    is_beginning: bool,
}

/// Marks a recording's first file as being created; cleared on drop.
struct Beginning<'a>(&'a LastRecording);

impl Drop for Beginning<'_> {
    fn drop(&mut self) {
        self.0.lock().is_beginning = false;
        self.0.begun.notify_all();
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

/// A running recording.
pub struct BegunRecording {
    /// Whether this request started it; else it was already running.
    pub is_new: bool,
    /// Its tag, unique to this recording.
    pub tag: EntityTag,
    /// Its state.
    pub view: RecordingView,
}

impl State {
    fn tag(&self) -> Option<EntityTag> {
        self.last.as_ref().map(|(tag, _)| tag.clone())
    }
}

impl LastRecording {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self) -> Option<Arc<SessionRecording>> {
        self.lock().last.as_ref().map(|(_, recording)| recording.clone())
    }

    /// Starts recording, unless a recording with that document runs already. Blocks while the first file is created; the lock
    /// is not held meanwhile, so that only other `begin` calls wait.
    pub fn begin(
        &self,
        folder: &RecordingFolder,
        (document, preconditions): (RecordDocument, &Preconditions),
        session: LoggedSession,
        (inbox, source): (&Inbox, Arc<Source>),
    ) -> Result<BegunRecording, Problem> {
        check(&document)?;
        let name = session.session.clone();
        let over = || Problem::conflict("not-applicable", format!("the session `{name}` has ended"));
        let _beginning = {
            let is_beginning = |state: &mut State| state.is_beginning;
            let waited = self.begun.wait_timeout_while(self.lock(), LIMITS.recording_end_time, is_beginning);
            let (mut state, timeout) = waited.unwrap_or_else(PoisonError::into_inner);
            if timeout.timed_out() {
                return Err(Problem::late("the disk is slow: the file of another recording is still being made"));
            }
            if inbox.waiting() == Waiting::End {
                return Err(over());
            }
            preconditions.check("the recording", state.tag().as_slice())?;
            match &state.last {
                Some((tag, running)) if running.is_running() && *running.document() == document => {
                    return Ok(BegunRecording { is_new: false, tag: tag.clone(), view: running.view() });
                }
                Some((_, running)) if running.is_running() => {
                    let detail = format!(
                        "the session `{name}` is being recorded by another document; DELETE its recording first"
                    );
                    return Err(Problem::conflict("in-use", detail));
                }
                _ => state.is_beginning = true,
            }
            Beginning(self)
        };
        let begun = SessionRecording::begin(folder.clone(), document, session, move || source.camera());
        let recording = Arc::new(begun.map_err(FolderFault::problem)?);
        let mut state = self.lock();
        // An ending session closes its inbox before it takes this lock.
        if inbox.waiting() == Waiting::End {
            recording.end("the session has ended");
            return Err(over());
        }
        inbox.record(Some(recording.tap().clone()));
        tracing::info!(session = name, "a recording has begun");
        let (tag, view) = (EntityTag::unique(), recording.view());
        state.last = Some((tag.clone(), recording));
        Ok(BegunRecording { is_new: true, tag, view })
    }

    /// Its state, with its tag.
    pub fn view(&self) -> Option<(EntityTag, RecordingView)> {
        let last = self.lock().last.clone();
        last.map(|(tag, recording)| (tag, recording.view()))
    }

    /// Ends and forgets the recording; the caller may wait for its file to be closed.
    ///
    /// # Errors
    /// 412.
    pub fn stop(&self, inbox: &Inbox, preconditions: &Preconditions) -> Result<Option<Arc<SessionRecording>>, Problem> {
        let mut state = self.lock();
        if state.last.is_some() {
            preconditions.check("the recording", state.tag().as_slice())?;
        }
        let Some((_, recording)) = state.last.take() else { return Ok(None) };
        drop(state);
        inbox.record(None);
        recording.end("it was ended");
        Ok(Some(recording))
    }

    /// Ends the recording and closes its file; its state remains available.
    pub fn end(&self, inbox: &Inbox, reason: &str) {
        if let Some(recording) = self.get() {
            inbox.record(None);
            recording.end(reason);
        }
    }

    /// Waits for its file to be closed.
    pub fn wait(&self, until: Instant) {
        if let Some(recording) = self.get() {
            recording.wait(until);
        }
    }
}
