//! The thread that writes a recording, with rotation of its files.
//!
//! An exhausted budget, a full disk or frames that are no images end the recording with a reason; what was written is kept.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use isophote_machine::{monotonic_ns, rfc3339, unix_ms};
use isophote_symbolic::Model;
use isophote_tracker::{Frame, Snapshot};
use isophote_wire::{CameraStatus, LoggedSession, LoggedSwap, RecordDocument, RecordedFrames, RecordingState};

use super::csv::EstimateTable;
use super::folder::{FileName, FolderFault, RecordingFolder, WantedFile};
use super::log::{LogFault, SessionLog};
use super::progress::{SharedProgress, locked};
use super::tap::{Due, FitNote, ModelNote, Note, Tap};

/// Time between flushes: the most that a killed process loses.
const FLUSH_TIME: Duration = Duration::from_millis(500);
/// Time between syncs: the most that a power failure loses.
const SYNC_TIME: Duration = Duration::from_secs(1);
/// Upper bound of a chunk's bytes.
const CHUNK_BYTES: u64 = 4 << 20;
/// Time between snapshots.
const SNAPSHOT_TIME: Duration = Duration::from_secs(10);
/// Number of recent frames remembered, to tell whether a fitted one's pixels were written.
const FRAMES_KNOWN: usize = 256;
/// Bytes reserved on the disk for a note, beside its pixels and estimates; most take less.
const NOTE_BYTES: u64 = 16 << 10;
/// Bytes reserved for one estimate; most take less.
const ESTIMATE_BYTES: usize = 4 << 10;
const MB: u64 = 1_000_000;

/// The wall clock at the begin, advanced by the monotonic clock: it never goes back.
pub struct RecordingClock {
    unix_ms: u64,
    monotonic_ns: u64,
}

impl RecordingClock {
    /// Starts the clock.
    pub fn now() -> RecordingClock {
        RecordingClock { unix_ms: unix_ms(), monotonic_ns: monotonic_ns() }
    }

    /// Begin of the recording, ms since 1970.
    pub fn begin_unix_ms(&self) -> u64 {
        self.unix_ms
    }

    /// Begin of the recording in RFC 3339.
    pub fn begin(&self) -> String {
        rfc3339(self.unix_ms)
    }

    fn unix_ns(&self, monotonic_ns: u64) -> u64 {
        (self.unix_ms * 1_000_000).saturating_add_signed(monotonic_ns.wrapping_sub(self.monotonic_ns) as i64)
    }
}

/// Why the writer stopped.
enum Stopped {
    /// As planned.
    Ended(String),
    /// By a fault.
    Failed(String),
}

impl From<LogFault> for Stopped {
    fn from(fault: LogFault) -> Stopped {
        match fault {
            LogFault::Disk(error) => Stopped::Failed(format!("the disk: {error}")),
            LogFault::Frames(reason) => Stopped::Failed(reason),
        }
    }
}

impl From<std::io::Error> for Stopped {
    fn from(error: std::io::Error) -> Stopped {
        LogFault::Disk(error).into()
    }
}

impl From<FolderFault> for Stopped {
    fn from(fault: FolderFault) -> Stopped {
        Stopped::Failed(match fault {
            FolderFault::Full(fault) => return Stopped::Ended(fault.to_string()),
            FolderFault::Disk(error) => format!("the disk: {error}"),
            FolderFault::Taken(file) => format!("there is a file {file} already"),
            FolderFault::Missing(file) => format!("the file {file} is gone"),
            FolderFault::None | FolderFault::Unfinished | FolderFault::Open => {
                "the folder of recordings is gone".into()
            }
        })
    }
}

/// State owned by the thread.
pub struct Writer {
    folder: RecordingFolder,
    stem: String,
    document: RecordDocument,
    session: LoggedSession,
    tap: Arc<Tap>,
    progress: SharedProgress,
    clock: RecordingClock,
    camera: Box<dyn Fn() -> Option<CameraStatus> + Send>,
    /// The open file.
    log: Option<SessionLog>,
    table: Option<EstimateTable>,
    /// Bytes up to which the open file and its table may grow without another request.
    granted: u64,
    number: u32,
    opened: Instant,
    flushed: Instant,
    synced: Instant,
    snapshot: Instant,
    model: Option<(Arc<Model>, LoggedSwap)>,
    /// Numbers of the last written frames.
    known: VecDeque<u64>,
    /// The newest frame, which may still be fitted.
    newest: Option<(Frame, u64)>,
    fits: u64,
    last_camera: Option<CameraStatus>,
}

impl Writer {
    /// Opens the first file.
    pub fn begin(
        (folder, stem): (RecordingFolder, String),
        document: RecordDocument,
        session: LoggedSession,
        (tap, progress, clock): (Arc<Tap>, SharedProgress, RecordingClock),
        camera: Box<dyn Fn() -> Option<CameraStatus> + Send>,
    ) -> Result<Writer, FolderFault> {
        let now = Instant::now();
        let mut writer = Writer {
            folder,
            stem,
            document,
            session,
            tap,
            progress,
            clock,
            camera,
            log: None,
            table: None,
            granted: 0,
            number: 0,
            opened: now,
            flushed: now,
            synced: now,
            snapshot: now,
            model: None,
            known: VecDeque::new(),
            newest: None,
            fits: 0,
            last_camera: None,
        };
        writer.open()?;
        Ok(writer)
    }

    /// Opens the next file.
    fn open(&mut self) -> Result<(), FolderFault> {
        let is_first = self.log.is_none() && self.number == 0;
        let (name, file) = loop {
            self.number += 1;
            let none = || FolderFault::Taken(self.stem.clone());
            let name = FileName::of(&self.stem, self.number).ok_or_else(none)?;
            match self.folder.begin(&name) {
                // An earlier recording of that name, whose first files were deleted, may have left later ones.
                Err(FolderFault::Taken(_)) if !is_first => {}
                Err(FolderFault::Full(_)) if self.remove_oldest()? => self.number -= 1,
                begun => break (name, begun?),
            }
        };
        let begun = SessionLog::begin(file, &self.session, self.clock.unix_ns(monotonic_ns()));
        let log = begun.inspect_err(|_| drop(self.folder.give_up(&name)))?;
        if self.document.csv {
            let table = self.folder.table(&name).inspect_err(|_| drop(self.folder.give_up(&name)))?;
            self.table = Some(EstimateTable::new(table));
        }
        self.log = Some(log);
        (self.opened, self.last_camera, self.granted) = (Instant::now(), None, 0);
        locked(&self.progress).files.push((name, 0));
        Ok(())
    }

    /// Runs until the recording is ended or stops by itself.
    pub fn run(mut self) {
        let stopped = loop {
            let until = self.flushed + FLUSH_TIME;
            let done = match self.tap.next(until) {
                Due::Note(note, bytes) => {
                    let room = self.make_room(written(&note, bytes));
                    room.and_then(|()| self.write(note)).and_then(|()| self.tend())
                }
                Due::Nothing => self.tend(),
                Due::End(reason) => Err(Stopped::Ended(reason)),
            };
            if let Err(stopped) = done {
                break stopped;
            }
        };
        self.tap.close();
        let closed = self.close();
        let (state, reason) = match (stopped, closed) {
            (Stopped::Failed(reason), _)
            | (Stopped::Ended(_), Err(Stopped::Failed(reason) | Stopped::Ended(reason))) => {
                (RecordingState::Failed, reason)
            }
            (Stopped::Ended(reason), Ok(())) => (RecordingState::Ended, reason),
        };
        let (session, frames) = (self.session.session.as_str(), locked(&self.progress).frames);
        match state {
            RecordingState::Failed => tracing::warn!(session, frames, reason, "a recording has failed"),
            _ => tracing::info!(session, frames, reason, "a recording has ended"),
        }
        let mut progress = locked(&self.progress);
        (progress.state, progress.reason) = (state, Some(reason));
    }

    fn write(&mut self, note: Note) -> Result<(), Stopped> {
        match note {
            Note::Frame(frame, at_ns) => self.frame(frame, at_ns),
            Note::Begin(begin) => self.begun(begin.0, &begin.1),
            Note::Fit(fit) => self.fitted(*fit),
        }
    }

    fn log(&mut self) -> Result<&mut SessionLog, Stopped> {
        self.log.as_mut().ok_or_else(|| Stopped::Failed("bug: no file is open".into()))
    }

    fn frame(&mut self, frame: Frame, at_ns: u64) -> Result<(), Stopped> {
        let unix_ns = self.clock.unix_ns(at_ns);
        self.log()?.frame(unix_ns, &frame)?;
        self.written(&frame);
        if self.newest.as_ref().is_none_or(|(newest, _)| newest.sequence < frame.sequence) {
            self.newest = Some((frame, at_ns));
        }
        Ok(())
    }

    fn written(&mut self, frame: &Frame) {
        if self.known.len() == FRAMES_KNOWN {
            self.known.pop_front();
        }
        self.known.push_back(frame.sequence);
        locked(&self.progress).frames += 1;
    }

    /// Writes a snapshot; if the file is full, begins the next one with it.
    fn begun(&mut self, note: ModelNote, snapshot: &Snapshot) -> Result<(), Stopped> {
        let is_first = self.model.is_none();
        let is_rotated = !is_first && !note.is_swap && self.is_full();
        if is_rotated {
            self.close()?;
            self.open()?;
            // A frame that waits for its fit belongs to the new file.
            self.known.clear();
            if let Some((frame, at_ns)) = self.newest.take().filter(|(frame, _)| frame.sequence >= note.swap.frame) {
                let at_ns = self.clock.unix_ns(at_ns);
                self.log()?.frame(at_ns, &frame)?;
                self.known.push_back(frame.sequence);
            }
        }
        let (unix_ns, fits) = (self.clock.unix_ns(monotonic_ns()), self.fits);
        let log = self.log()?;
        if is_first || is_rotated || note.is_swap {
            log.swap(unix_ns, &note.swap)?;
        }
        log.snapshot(unix_ns, fits, snapshot)?;
        if let Some(table) = &mut self.table {
            table.begin(&note.model)?;
        }
        (self.model, self.snapshot) = (Some((note.model, note.swap)), Instant::now());
        Ok(())
    }

    fn fitted(&mut self, note: FitNote) -> Result<(), Stopped> {
        let FitNote { mut fit, at_ns, estimates } = note;
        let Some((model, _)) = self.model.clone() else { return Ok(()) };
        fit.fit = self.fits;
        fit.has_pixels = self.known.contains(&fit.frame);
        self.fits += 1;
        let (unix_ns, keeps_pixels) = (self.clock.unix_ns(at_ns), self.document.frames != RecordedFrames::None);
        if !fit.has_pixels && keeps_pixels {
            // Without its pixels the fit cannot be repeated; replay resumes at the next snapshot.
            self.tap.want_snapshot();
        }
        self.log()?.fit(unix_ns, &fit, &estimates, &model)?;
        if let Some(table) = &mut self.table {
            estimates.iter().try_for_each(|estimate| table.row(unix_ns, estimate))?;
        }
        locked(&self.progress).fits = self.fits;
        Ok(())
    }

    /// Whether the open file is due for rotation.
    fn is_full(&self) -> bool {
        let bytes = locked(&self.progress).files.last().map_or(0, |(_, bytes)| *bytes);
        self.document.rotate_mb.is_some_and(|mb| bytes >= mb * MB)
            || self.document.rotate_s.is_some_and(|s| self.opened.elapsed() >= Duration::from_secs(s))
    }

    /// Chunk size: small files have small chunks.
    fn chunk_bytes(&self) -> u64 {
        let file = self.document.rotate_mb.unwrap_or(self.document.disk_budget_mb).min(self.document.disk_budget_mb);
        CHUNK_BYTES.min(file * MB / 8)
    }

    /// Flushes and requests snapshots when due by time or size.
    fn tend(&mut self) -> Result<(), Stopped> {
        let waiting = self.log()?.waiting_bytes();
        if waiting >= self.chunk_bytes() || self.flushed.elapsed() >= FLUSH_TIME {
            self.flush()?;
        }
        if self.model.is_some() && (self.snapshot.elapsed() >= SNAPSHOT_TIME || self.is_full()) {
            self.snapshot = Instant::now();
            self.tap.want_snapshot();
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Stopped> {
        let camera = (self.camera)().filter(|camera| self.last_camera.as_ref() != Some(camera));
        if let Some(camera) = camera {
            let unix_ns = self.clock.unix_ns(monotonic_ns());
            self.log()?.camera(unix_ns, &camera)?;
            self.last_camera = Some(camera);
        }
        let bytes = self.log()?.flush()?;
        self.flushed = Instant::now();
        if self.synced.elapsed() >= SYNC_TIME {
            self.log()?.sync()?;
            self.synced = Instant::now();
        }
        let table = self.table.as_mut().map_or(Ok(0), EstimateTable::flush)?;
        self.has(bytes + table);
        Ok(())
    }

    /// Sets the bytes of the open file and its table.
    fn has(&self, bytes: u64) {
        if let Some((_, known)) = locked(&self.progress).files.last_mut() {
            *known = bytes;
        }
    }

    /// Ensures space for a note of `bytes`: deletes the recording's oldest files at a bound, or ends the recording.
    fn make_room(&mut self, bytes: u64) -> Result<(), Stopped> {
        let most = self.document.disk_budget_mb * MB;
        let table = self.table.as_ref().map_or(0, EstimateTable::waiting_bytes);
        let log = self.log()?;
        // The end of the file must fit as well.
        let next = log.waiting_bytes() + table + log.end_bytes() + bytes + NOTE_BYTES;
        loop {
            let (all, open) = {
                let progress = locked(&self.progress);
                (progress.files.iter().map(|(_, bytes)| bytes).sum::<u64>(), progress.files.last().cloned())
            };
            let Some((name, written)) = open else { return Ok(()) };
            let full = match all + next > most {
                true => Stopped::Ended(format!("its budget of {} MB is used up", self.document.disk_budget_mb)),
                false if written + next <= self.granted => return Ok(()),
                false => match self.folder.grow(&name, written, next) {
                    Ok(granted) => {
                        self.granted = granted;
                        return Ok(());
                    }
                    Err(fault) => fault.into(),
                },
            };
            if matches!(full, Stopped::Failed(_)) || !self.remove_oldest()? {
                return Err(full);
            }
        }
    }

    /// Deletes the recording's oldest file, but never the open one; false if there is none.
    fn remove_oldest(&self) -> Result<bool, FolderFault> {
        let oldest = {
            let progress = locked(&self.progress);
            progress.files.first().filter(|_| progress.files.len() > 1).map(|(name, _)| name.clone())
        };
        let Some(oldest) = oldest else { return Ok(false) };
        match self.folder.remove(&WantedFile::Recording(oldest)) {
            Ok(()) | Err(FolderFault::Missing(_)) => drop(locked(&self.progress).files.remove(0)),
            Err(fault) => return Err(fault),
        }
        Ok(true)
    }

    /// Closes the open file and its table; a fault of one does not keep the other from being closed.
    fn close(&mut self) -> Result<(), Stopped> {
        let Some(log) = self.log.take() else { return Ok(()) };
        let name = locked(&self.progress).files.last().map(|(name, _)| name.clone());
        let Some(name) = name else { return Ok(()) };
        let table = self.table.take().map_or(Ok(0), |mut table| table.flush());
        let ended = match log.finish() {
            Ok(bytes) => self.folder.finish(&name).map(|()| bytes).map_err(Stopped::from),
            Err(error) => {
                let kept = self.folder.give_up(&name).and_then(|_| self.folder.open(&WantedFile::Recording(name)));
                self.has(kept.map_or(0, |(_, about)| about.len()));
                Err(error.into())
            }
        };
        let (bytes, table) = (ended?, table?);
        self.has(bytes + table);
        Ok(())
    }
}

/// Upper bound of a note's bytes on the disk; `counted`: its pixels.
fn written(note: &Note, counted: usize) -> u64 {
    let bytes = match note {
        Note::Frame(..) => counted,
        // The document is also attached as a file.
        Note::Begin(begin) => 2 * begin.0.swap.text.len(),
        Note::Fit(fit) => ESTIMATE_BYTES * fit.estimates.len(),
    };
    bytes as u64
}
