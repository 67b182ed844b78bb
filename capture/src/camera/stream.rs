//! A streaming device: cycles buffers with the driver and returns the newest picture.
//!
//! Every buffer is dequeued at once, even if its picture is not wanted: a driver without free buffers drops the newest
//! pictures, not the oldest.

use std::io;
use std::ops::RangeInclusive;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::BorrowedFd;

use super::ioctl::{DeviceNode, Filled, Mapping};
use super::sequence::Sequence;

/// Requested buffers: one is being read, the others keep the driver streaming while this thread is late.
const BUFFERS: u32 = 6;

/// Streams until dropped.
pub(super) struct Stream {
    mappings: Vec<Mapping>,
    node: DeviceNode,
    sequence: Sequence,
    /// Allowed bytes per picture.
    bytes: RangeInclusive<usize>,
    /// Error from requeueing the last picture's buffer, returned by the next call.
    fault: Option<io::Error>,
}

/// Result of a wait.
pub(super) enum StreamEvent<'a> {
    /// A picture.
    Picture(NewestPicture<'a>),
    /// No picture yet.
    Nothing,
    /// The signal has changed its format.
    SourceChanged,
}

/// The newest picture.
pub(super) struct NewestPicture<'a> {
    pub bytes: &'a [u8],
    /// Capture time on CLOCK_MONOTONIC, if the driver reports it.
    pub monotonic: Option<Duration>,
}

/// Pictures that are not delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LostPictures {
    /// Sequence numbers that the driver skipped.
    pub gaps: u64,
    /// Flagged as erroneous by the driver, or too short.
    pub damaged: u64,
    /// Valid, but superseded by a newer one.
    pub overtaken: u64,
}

impl LostPictures {
    /// Sum of all kinds.
    pub fn all(&self) -> u64 {
        self.gaps + self.damaged + self.overtaken
    }
}

impl Stream {
    /// Starts streaming. Pictures with fewer bytes are damaged; with more bytes the device has changed its format.
    pub fn start(node: DeviceNode, bytes: RangeInclusive<usize>, sequence: Sequence) -> io::Result<Stream> {
        let count = node.request_buffers(BUFFERS)?;
        let mut stream = Stream { mappings: Vec::new(), node, sequence, bytes, fault: None };
        for index in 0..count {
            stream.mappings.push(stream.node.map(index)?);
            stream.node.queue(index)?;
        }
        stream.node.start()?;
        Ok(stream)
    }

    /// The device.
    pub fn node(&self) -> &DeviceNode {
        &self.node
    }

    /// Waits for a picture, at most `limit`, less if `wake` becomes readable, and passes the newest one to `with`; its
    /// buffer is then requeued. Losses are added to `lost`.
    pub fn newest<T>(
        &mut self,
        wake: BorrowedFd,
        limit: Duration,
        lost: &mut LostPictures,
        with: impl FnOnce(StreamEvent) -> T,
    ) -> io::Result<T> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let mut newest = self.drain(lost)?;
        if newest.is_none() {
            if self.wait(wake, limit)? {
                return Ok(with(StreamEvent::SourceChanged));
            }
            newest = self.drain(lost)?;
        }
        let Some(filled) = newest else { return Ok(with(StreamEvent::Nothing)) };
        let Some(mapping) = self.mappings.get(filled.index as usize) else {
            return Err(io::Error::other(format!("the driver filled a buffer {} that it does not have", filled.index)));
        };
        let picture = NewestPicture { bytes: mapping.bytes(&filled), monotonic: filled.monotonic };
        let result = with(StreamEvent::Picture(picture));
        self.fault = self.node.queue(filled.index).err();
        Ok(result)
    }

    /// Dequeues all filled buffers; returns the last valid one.
    fn drain(&mut self, lost: &mut LostPictures) -> io::Result<Option<Filled>> {
        let mut newest: Option<Filled> = None;
        // A driver faster than this loop must not keep it running forever.
        for _ in 0..4 * BUFFERS {
            let Some(filled) = self.node.dequeue()? else { break };
            lost.gaps += self.sequence.step(filled.sequence);
            if filled.bytes > *self.bytes.end() {
                return Err(io::Error::other("pictures are larger now"));
            }
            if filled.is_error || filled.bytes < *self.bytes.start() {
                lost.damaged += 1;
                self.node.queue(filled.index)?;
            } else if let Some(older) = newest.replace(filled) {
                lost.overtaken += 1;
                self.node.queue(older.index)?;
            }
        }
        Ok(newest)
    }

    /// Waits for the device or `wake`; true if the signal has changed.
    fn wait(&self, wake: BorrowedFd, limit: Duration) -> io::Result<bool> {
        let mut waited =
            [PollFd::new(&self.node, PollFlags::IN | PollFlags::PRI), PollFd::from_borrowed_fd(wake, PollFlags::IN)];
        match poll(&mut waited, Some(&timespec(limit))) {
            Err(rustix::io::Errno::INTR) | Ok(0) => return Ok(false),
            done => done?,
        };
        let seen = waited[0].revents();
        if seen.contains(PollFlags::PRI) && self.node.has_source_changed() {
            return Ok(true);
        }
        if seen.intersects(PollFlags::ERR | PollFlags::HUP | PollFlags::NVAL) {
            // `dequeue` returns the actual error; if it has none, polling again would only spin.
            return match self.node.dequeue()? {
                Some(filled) => self.node.queue(filled.index).map(|()| false),
                None => Err(io::Error::other("the driver has stopped streaming")),
            };
        }
        Ok(false)
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        // A lost device refuses; it is closed anyway.
        drop(self.node.stop());
        self.mappings.clear();
        drop(self.node.request_buffers(0));
    }
}

/// Waits until one of `fds` becomes readable.
pub(super) fn wait(fds: &[BorrowedFd], limit: Duration) -> io::Result<()> {
    let mut waited: Vec<PollFd> = fds.iter().map(|fd| PollFd::from_borrowed_fd(*fd, PollFlags::IN)).collect();
    match poll(&mut waited, Some(&timespec(limit))) {
        Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

fn timespec(limit: Duration) -> Timespec {
    Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: limit.subsec_nanos().into() }
}
