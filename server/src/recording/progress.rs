//! `SessionRecording`: starts, reports and ends a recording.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use isophote_wire::{LoggedSession, RecordDocument, RecordingState, RecordingView};

use super::folder::{FileName, FolderFault, RecordingFolder};
use super::tap::Tap;
use super::writer::{RecordingClock, Writer};
use crate::thread::NamedThread;

/// Progress of a recording's thread.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Its state.
    pub state: RecordingState,
    /// Why it ended.
    pub reason: Option<String>,
    /// Its files with their bytes, the oldest first.
    pub files: Vec<(FileName, u64)>,
    /// Frames whose pixels were written.
    pub frames: u64,
    /// Fitted frames.
    pub fits: u64,
}

/// Shared between the thread and the rest of the service.
pub type SharedProgress = Arc<Mutex<Progress>>;

/// Locks the progress.
pub fn locked(progress: &SharedProgress) -> MutexGuard<'_, Progress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

/// After a panic of the writer: takes nothing more, and keeps the readable part of the open file.
fn panicked(folder: &RecordingFolder, progress: &SharedProgress, tap: &Tap) {
    tap.close();
    let reason = "bug: the thread that writes it panicked";
    tracing::error!(reason, "a recording has failed");
    let open = locked(progress).files.last().map(|(name, _)| name.clone());
    if let Some(Err(fault)) = open.map(|name| folder.give_up(&name)) {
        tracing::warn!(?fault, "its last file gets its end at the next start");
    }
    let mut progress = locked(progress);
    (progress.state, progress.reason) = (RecordingState::Failed, Some(reason.to_string()));
}

/// A running or ended recording.
pub struct SessionRecording {
    session: String,
    document: RecordDocument,
    tap: Arc<Tap>,
    progress: SharedProgress,
    thread: NamedThread,
    started_at: String,
}

impl SessionRecording {
    /// Opens the first file; recording begins with the fit thread's first snapshot. `camera` reads the source's settings.
    ///
    /// # Errors
    /// No folder, a name that is taken, or a failing disk.
    pub fn begin(
        folder: RecordingFolder,
        document: RecordDocument,
        session: LoggedSession,
        camera: impl Fn() -> Option<isophote_wire::CameraStatus> + Send + 'static,
    ) -> Result<SessionRecording, FolderFault> {
        let clock = RecordingClock::now();
        let name = session.session.clone();
        let stem = document.name.clone();
        let stem = stem.unwrap_or_else(|| format!("{name}-{}-{}", session.epoch, clock.begin_unix_ms()));
        let tap = Arc::new(Tap::default());
        tap.want_snapshot();
        let progress =
            Progress { state: RecordingState::Recording, reason: None, files: Vec::new(), frames: 0, fits: 0 };
        let progress = Arc::new(Mutex::new(progress));
        let started_at = clock.begin();
        let writer = Writer::begin(
            (folder.clone(), stem),
            document.clone(),
            session,
            (tap.clone(), progress.clone(), clock),
            Box::new(camera),
        )?;
        let (theirs, taken) = (progress.clone(), tap.clone());
        let work = move || {
            if catch_unwind(AssertUnwindSafe(|| writer.run())).is_err() {
                panicked(&folder, &theirs, &taken);
            }
        };
        let thread = NamedThread::start(format!("record {name}"), work)?;
        Ok(SessionRecording { session: name, document, tap, progress, thread, started_at })
    }

    /// Queue for frames and notes of the session's threads.
    pub fn tap(&self) -> &Arc<Tap> {
        &self.tap
    }

    /// The document as put.
    pub fn document(&self) -> &RecordDocument {
        &self.document
    }

    /// Whether it is running.
    pub fn is_running(&self) -> bool {
        locked(&self.progress).state == RecordingState::Recording
    }

    /// Its state as published.
    pub fn view(&self) -> RecordingView {
        let progress = locked(&self.progress).clone();
        RecordingView {
            session: self.session.clone(),
            document: self.document.clone(),
            state: progress.state,
            reason: progress.reason,
            files: progress.files.iter().map(|(name, _)| name.as_str().to_string()).collect(),
            recorded_frames: progress.frames,
            fits: progress.fits,
            bytes: progress.files.iter().map(|(_, bytes)| bytes).sum(),
            dropped: self.tap.dropped(),
            started_at: self.started_at.clone(),
        }
    }

    /// Takes nothing more and closes its file.
    pub fn end(&self, reason: &str) {
        self.tap.end(reason);
    }

    /// After [`SessionRecording::end`]: waits for its file to be closed.
    pub fn wait(&self, until: Instant) {
        self.thread.wait(until);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    use super::super::space::{RecordingQuota, RecordingSpace};
    use isophote_wire::{LOG_VERSION, LoggedBuild};
    use serde_json::json;

    #[test]
    fn writer_panic_fails_the_recording() {
        let place = std::env::temp_dir().join(format!("isophote-recording-{}", std::process::id()));
        let folder = RecordingFolder::of(Some(&place), None, &RecordingSpace::new(RecordingQuota::default()));
        let session = LoggedSession {
            version: LOG_VERSION,
            session: "one".into(),
            node: "node".into(),
            epoch: 1,
            document: serde_json::from_value(json!({"source": "shared", "model": "spot"})).unwrap(),
            frames: isophote_wire::RecordedFrames::Raw,
            build: LoggedBuild { version: String::new(), checksum: None, processor: String::new() },
        };
        let document = serde_json::from_value(json!({"name": "cut"})).unwrap();
        // Called when the first chunk is written.
        let camera = || panic!("planted");
        let recording = SessionRecording::begin(folder.clone(), document, session, camera).unwrap();
        recording.wait(Instant::now() + Duration::from_secs(60));
        let view = recording.view();
        assert_eq!(view.state, RecordingState::Failed);
        assert!(view.reason.unwrap().starts_with("bug:"));
        assert!(
            matches!(folder.begin(&FileName::of("cut", 1).unwrap()), Err(FolderFault::Taken(_))),
            "what was written is kept"
        );
        std::fs::remove_dir_all(place).unwrap();
    }
}
