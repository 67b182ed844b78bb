//! A device that streams: buffers go round between driver and us, and the newest picture comes out.
//!
//! What comes in: a device whose format is set. What goes out: [`Taken`], the newest picture that the driver has, and how
//! many others are lost. Every buffer is dequeued at once, also when nobody wants its picture: a driver
//! without free buffers loses the newest pictures, not the oldest. It knows no format, no identity, and nothing of time but
//! how long it may wait.

use std::io;
use std::ops::RangeInclusive;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::BorrowedFd;

use super::ioctl::{DeviceNode, Filled, Mapping};
use super::sequence::Sequence;

/// Buffers asked for: one is with us, the others let the driver go on when this thread is late.
const BUFFERS: u32 = 6;

/// Streams until it is dropped.
pub(super) struct Stream {
    mappings: Vec<Mapping>,
    node: DeviceNode,
    sequence: Sequence,
    /// Of a picture.
    bytes: RangeInclusive<usize>,
    /// What went wrong after the last picture was handed on.
    fault: Option<io::Error>,
}

/// What came of waiting.
pub(super) enum Taken<'a> {
    /// A picture.
    Picture(NewestPicture<'a>),
    /// None yet.
    Nothing,
    /// The signal has another format now.
    SourceChanged,
}

/// The newest picture.
pub(super) struct NewestPicture<'a> {
    pub bytes: &'a [u8],
    /// When it was taken, CLOCK_MONOTONIC, where the driver says so.
    pub monotonic: Option<Duration>,
}

/// Pictures that are not handed on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Lost {
    /// Numbers that the driver left out.
    pub gaps: u64,
    /// Flagged as wrong by the driver, or too short.
    pub damaged: u64,
    /// Sound, but a newer one was there.
    pub overtaken: u64,
}

impl Lost {
    /// Of any kind.
    pub fn all(&self) -> u64 {
        self.gaps + self.damaged + self.overtaken
    }
}

impl Stream {
    /// Starts streaming. Pictures of fewer bytes are damaged; where they have more, the device has another format now.
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

    /// Waits `limit` at most, less when `wake` can be read, for a picture; gives `with` the newest one. The buffer is the
    /// driver's again afterwards. What is lost meanwhile is added to `lost`.
    pub fn newest<T>(
        &mut self,
        wake: BorrowedFd,
        limit: Duration,
        lost: &mut Lost,
        with: impl FnOnce(Taken) -> T,
    ) -> io::Result<T> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let mut newest = self.drain(lost)?;
        if newest.is_none() {
            if self.wait(wake, limit)? {
                return Ok(with(Taken::SourceChanged));
            }
            newest = self.drain(lost)?;
        }
        let Some(filled) = newest else { return Ok(with(Taken::Nothing)) };
        let Some(mapping) = self.mappings.get(filled.index as usize) else {
            return Err(io::Error::other(format!("the driver filled a buffer {} that it does not have", filled.index)));
        };
        let picture = NewestPicture { bytes: mapping.bytes(&filled), monotonic: filled.monotonic };
        let result = with(Taken::Picture(picture));
        self.fault = self.node.queue(filled.index).err();
        Ok(result)
    }

    /// Takes all that the driver has filled; the last sound one.
    fn drain(&mut self, lost: &mut Lost) -> io::Result<Option<Filled>> {
        let mut newest: Option<Filled> = None;
        // A driver that is faster than this loop must not hold it for ever.
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

    /// Whether the signal has changed.
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
            // `dequeue` says which error it is; where it has none to tell, polling again would only spin.
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
        // A lost device refuses, and is closed all the same.
        drop(self.node.stop());
        self.mappings.clear();
        drop(self.node.request_buffers(0));
    }
}

/// Waits until `wake` or `watch` can be read.
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
