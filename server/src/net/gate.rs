//! `MessageGate`: reads a message's payload only while it holds permits for all of it.
//!
//! Before the permits are granted, at most the head of a message is read. An idle client holds no permits; a connection whose
//! message is not complete in time is closed.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

use crate::limits::LIMITS;
use crate::net::quota::{QuotaPermit, SharedQuota};

/// Bytes that are read before permits are granted: the largest head of a message.
const HEAD_BYTES: usize = 16;

/// The gate of one connection.
#[derive(Default)]
pub struct MessageGate(Mutex<State>);

/// The state of a connection.
#[derive(Default)]
enum State {
    /// Not gated: the connection carries no frames.
    #[default]
    Open,
    /// The next bytes begin a message.
    Between(Bound),
    /// The head of a message was read; waiting for permits.
    Waiting(Bound, Acquiring),
    /// Permits are held until the message is complete or times out.
    Receiving { bound: Bound, _permit: QuotaPermit, patience: Pin<Box<Sleep>> },
}

type Acquiring = Pin<Box<dyn Future<Output = QuotaPermit> + Send>>;

/// The permits that one message takes.
#[derive(Clone)]
struct Bound {
    quota: SharedQuota,
    permits: u32,
}

impl MessageGate {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes each further message take permits of a quota.
    pub fn close(&self, quota: SharedQuota, permits: u32) {
        *self.lock() = State::Between(Bound { quota, permits });
    }

    /// Notes that a message is complete, which returns its permits.
    pub fn message_over(&self) {
        let mut state = self.lock();
        let bound = match &*state {
            State::Open => return,
            State::Between(bound) | State::Waiting(bound, _) | State::Receiving { bound, .. } => bound.clone(),
        };
        *state = State::Between(bound);
    }
}

/// A connection behind its gate.
pub struct GatedSocket<S> {
    socket: S,
    gate: Arc<MessageGate>,
}

impl<S> GatedSocket<S> {
    /// Wraps a socket; the gate is open.
    pub fn new(socket: S) -> (GatedSocket<S>, Arc<MessageGate>) {
        let gate = Arc::<MessageGate>::default();
        (GatedSocket { socket, gate: gate.clone() }, gate)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for GatedSocket<S> {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        let GatedSocket { socket, gate } = self.get_mut();
        let mut state = gate.lock();
        if let State::Waiting(bound, waiting) = &mut *state {
            let quota = ready!(waiting.as_mut().poll(context));
            let patience = Box::pin(sleep(LIMITS.body_time));
            *state = State::Receiving { bound: bound.clone(), _permit: quota, patience };
        }
        match &mut *state {
            State::Between(bound) => {
                let mut first = [0; HEAD_BYTES];
                let wanted = buffer.remaining().min(HEAD_BYTES);
                let mut head = ReadBuf::new(&mut first[..wanted]);
                ready!(Pin::new(socket).poll_read(context, &mut head))?;
                let read = head.filled().len();
                buffer.put_slice(&first[..read]);
                if read > 0 {
                    let waiting = Box::pin(bound.quota.clone().take(bound.permits));
                    *state = State::Waiting(bound.clone(), waiting);
                }
                Poll::Ready(Ok(()))
            }
            State::Receiving { patience, .. } => match patience.as_mut().poll(context) {
                Poll::Ready(()) => Poll::Ready(Err(Error::new(ErrorKind::TimedOut, "the message does not end"))),
                Poll::Pending => Pin::new(socket).poll_read(context, buffer),
            },
            State::Open | State::Waiting(..) => Pin::new(socket).poll_read(context, buffer),
        }
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for GatedSocket<S> {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        Pin::new(&mut self.get_mut().socket).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.get_mut().socket).poll_write_vectored(context, parts)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.get_mut().socket).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.get_mut().socket).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
    use tokio::time::timeout;

    /// Nothing is held between messages; without quota only the head of a message is read.
    #[tokio::test]
    async fn a_message_holds_permits_until_it_is_complete() {
        let quota = SharedQuota::new(10);
        let (mut client, socket) = duplex(1024);
        let (mut socket, gate) = GatedSocket::new(socket);
        let mut bytes = [0; 1024];
        client.write_all(&[1; 100]).await.unwrap();
        assert_eq!(socket.read(&mut bytes).await.unwrap(), 100, "an open gate");

        gate.close(quota.clone(), 6);
        assert_eq!(quota.taken(), 0);
        client.write_all(&[2; 100]).await.unwrap();
        assert_eq!(socket.read(&mut bytes).await.unwrap(), HEAD_BYTES);
        assert_eq!(socket.read(&mut bytes).await.unwrap(), 100 - HEAD_BYTES);
        assert_eq!(quota.taken(), 6);
        gate.message_over();
        assert_eq!(quota.taken(), 0);

        let others = quota.try_take(5).unwrap();
        client.write_all(&[3; 100]).await.unwrap();
        assert_eq!(socket.read(&mut bytes).await.unwrap(), HEAD_BYTES);
        assert!(timeout(Duration::from_millis(1), socket.read(&mut bytes)).await.is_err(), "no quota");
        drop(others);
        assert_eq!(socket.read(&mut bytes).await.unwrap(), 100 - HEAD_BYTES);
        // A disconnect in the middle of a message returns all permits.
        drop((client, socket, gate));
        assert_eq!(quota.taken(), 0);
    }
}
