//! `SessionRecording`: a recording as the rest of the service sees it: begun, asked about, ended.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use isophote_wire::{LoggedSession, RecordDocument, RecordingState, RecordingView};

use super::folder::{FileName, FolderFault, RecordingFolder};
use super::tap::Tap;
use super::writer::{RecordingClock, Writer};
use crate::thread::NamedThread;

/// What its thread has done.
#[derive(Clone, Debug)]
pub struct Progress {
    /// What it does.
    pub state: RecordingState,
    /// Why it does no more.
    pub reason: Option<String>,
    /// Its files with their bytes, the oldest first.
    pub files: Vec<(FileName, u64)>,
    /// Frames whose pixels were written.
    pub frames: u64,
    /// Frames that were fitted.
    pub fits: u64,
}

/// What the thread and the rest of the service share.
pub type SharedProgress = Arc<Mutex<Progress>>;

/// The progress, to be read or changed.
pub fn locked(progress: &SharedProgress) -> MutexGuard<'_, Progress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Nothing more is taken; what is whole of the open file is kept.
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

/// A recording that goes on, or has ended.
pub struct SessionRecording {
    session: String,
    document: RecordDocument,
    tap: Arc<Tap>,
    progress: SharedProgress,
    thread: NamedThread,
    started_at: String,
}

impl SessionRecording {
    /// Opens its first file, and begins when the session's fit thread sends a snapshot. `camera` says how the source is set.
    ///
    /// # Errors
    /// When there is no folder, the name is taken, or the disk refuses.
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

    /// Where the session's threads put what is to be written.
    pub fn tap(&self) -> &Arc<Tap> {
        &self.tap
    }

    /// As put.
    pub fn document(&self) -> &RecordDocument {
        &self.document
    }

    /// Whether it goes on.
    pub fn is_running(&self) -> bool {
        locked(&self.progress).state == RecordingState::Recording
    }

    /// What it does.
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

    /// Takes nothing more; its file gets its end.
    pub fn end(&self, reason: &str) {
        self.tap.end(reason);
    }

    /// Waits for the end of its file, after [`SessionRecording::end`].
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
    fn a_writer_that_panics_has_failed() {
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
        // It is asked when the first chunk is written.
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
