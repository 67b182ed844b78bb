//! `MessageGate`: a client's message takes room from its first bytes on, and gives it back when it is there.
//!
//! What comes in: a connection, and the room that one of its messages may need. What goes out: the connection's bytes, no more than
//! the head of a message before there is room for all of it. A client that is silent holds nothing; one that begins a message and
//! does not end it is left.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

use crate::limits::LIMITS;
use crate::room::{RoomTaken, SharedRoom};

/// Bytes of a message that come without room for it: its head is no longer.
const HEAD_BYTES: usize = 16;

/// Of one connection.
#[derive(Default)]
pub struct MessageGate(Mutex<State>);

/// What the connection's bytes are held against.
#[derive(Default)]
enum State {
    /// Nothing: it is no socket for frames.
    #[default]
    Open,
    /// Whatever comes next begins a message.
    Between(Bound),
    /// A message has begun, and waits for room.
    Waiting(Bound, Acquiring),
    /// It has room, until then.
    Receiving { bound: Bound, _room: RoomTaken, patience: Pin<Box<Sleep>> },
}

type Acquiring = Pin<Box<dyn Future<Output = RoomTaken> + Send>>;

/// What a message may need.
#[derive(Clone)]
struct Bound {
    room: SharedRoom,
    permits: u32,
}

impl MessageGate {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on each message takes so many permits of that room.
    pub fn close(&self, room: SharedRoom, permits: u32) {
        *self.lock() = State::Between(Bound { room, permits });
    }

    /// A message is there.
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
    /// With the gate, which is open.
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
            let room = ready!(waiting.as_mut().poll(context));
            let patience = Box::pin(sleep(LIMITS.body_time));
            *state = State::Receiving { bound: bound.clone(), _room: room, patience };
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
                    let waiting = Box::pin(bound.room.clone().take(bound.permits));
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

    /// Nothing is held between messages; of a message without room only the head is read.
    #[tokio::test]
    async fn a_message_takes_room_from_its_beginning_to_its_end() {
        let room = SharedRoom::new(10);
        let (mut client, socket) = duplex(1024);
        let (mut socket, gate) = GatedSocket::new(socket);
        let mut bytes = [0; 1024];
        client.write_all(&[1; 100]).await.unwrap();
        assert_eq!(socket.read(&mut bytes).await.unwrap(), 100, "an open gate");

        gate.close(room.clone(), 6);
        assert_eq!(room.taken(), 0);
        client.write_all(&[2; 100]).await.unwrap();
        assert_eq!(socket.read(&mut bytes).await.unwrap(), HEAD_BYTES);
        assert_eq!(socket.read(&mut bytes).await.unwrap(), 100 - HEAD_BYTES);
        assert_eq!(room.taken(), 6);
        gate.message_over();
        assert_eq!(room.taken(), 0);

        let others = room.try_take(5).unwrap();
        client.write_all(&[3; 100]).await.unwrap();
        assert_eq!(socket.read(&mut bytes).await.unwrap(), HEAD_BYTES);
        assert!(timeout(Duration::from_millis(1), socket.read(&mut bytes)).await.is_err(), "no room");
        drop(others);
        assert_eq!(socket.read(&mut bytes).await.unwrap(), 100 - HEAD_BYTES);
        // Whoever hangs up in the middle of a message gives all of it back.
        drop((client, socket, gate));
        assert_eq!(room.taken(), 0);
    }
}
