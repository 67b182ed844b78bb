//! `ClientSocket`: a socket that closes when a write times out.
//!
//! It holds the connection's permit, also after an upgrade to a WebSocket. `ClientLink` reads how many bytes the client has
//! acknowledged, for streams that send no more than it reads.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};

use isophote_machine::PeerProgress;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::time::{Instant, Sleep, sleep};

use crate::limits::LIMITS;
use crate::net::connection_limits::ConnectionPermit;

/// One connection.
pub struct ClientSocket {
    link: Arc<ClientLink>,
    writer: OwnedWriteHalf,
    patience: Option<Patience>,
    _permit: ConnectionPermit,
}

/// Counters of a connection, for those who pace its messages.
pub struct ClientLink {
    reader: Mutex<OwnedReadHalf>,
    written_bytes: AtomicU64,
}

/// Timeout of a pending write.
struct Patience {
    /// When the connection is closed.
    end: Pin<Box<Sleep>>,
    /// Bytes that the client had acknowledged when the timeout began.
    acknowledged_bytes: u64,
}

impl ClientLink {
    fn lock(&self) -> MutexGuard<'_, OwnedReadHalf> {
        self.reader.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The client's progress, if the system reports it.
    pub fn progress(&self) -> Option<PeerProgress> {
        let reader = self.lock();
        let stream: &TcpStream = reader.as_ref();
        PeerProgress::of(stream)
    }

    /// Bytes that the system has accepted since the connection began.
    pub fn written_bytes(&self) -> u64 {
        self.written_bytes.load(Ordering::Relaxed)
    }
}

impl ClientSocket {
    /// Wraps an accepted connection.
    pub fn new(stream: TcpStream, permit: ConnectionPermit) -> ClientSocket {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
        let (reader, writer) = stream.into_split();
        let link = Arc::new(ClientLink { reader: Mutex::new(reader), written_bytes: AtomicU64::new(0) });
        ClientSocket { link, writer, patience: None, _permit: permit }
    }

    /// The local address of the connection.
    pub fn local_address(&self) -> Result<SocketAddr> {
        self.writer.local_addr()
    }

    /// The client's progress, for senders.
    pub fn link(&self) -> Arc<ClientLink> {
        self.link.clone()
    }

    /// Handles the result of a write. The system reports free buffer space in steps of many kilobytes, so a client that has
    /// acknowledged anything in the meantime is not timed out.
    fn sent(&mut self, attempt: Poll<Result<usize>>, context: &mut Context<'_>) -> Poll<Result<usize>> {
        if let Poll::Ready(taken) = &attempt {
            self.patience = None;
            let bytes = taken.as_ref().map_or(0, |bytes| *bytes as u64);
            self.link.written_bytes.fetch_add(bytes, Ordering::Relaxed);
            return attempt;
        }
        let acknowledged = || self.link.progress().map_or(0, |peer| peer.acknowledged_bytes);
        let patience = self.patience.get_or_insert_with(|| Patience {
            end: Box::pin(sleep(LIMITS.send_time)),
            acknowledged_bytes: acknowledged(),
        });
        loop {
            ready!(patience.end.as_mut().poll(context));
            let before = std::mem::replace(&mut patience.acknowledged_bytes, acknowledged());
            if patience.acknowledged_bytes == before {
                break;
            }
            patience.end.as_mut().reset(Instant::now() + LIMITS.send_time);
        }
        let client = self.writer.peer_addr().map(|address| address.to_string()).unwrap_or_default();
        let after_s = LIMITS.send_time.as_secs();
        tracing::info!(client, after_s, "closing connection: the client takes nothing of what is sent");
        Poll::Ready(Err(Error::new(ErrorKind::TimedOut, "the client takes nothing")))
    }
}

impl AsyncRead for ClientSocket {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        Pin::new(&mut *self.link.lock()).poll_read(context, buffer)
    }
}

impl AsyncWrite for ClientSocket {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let attempt = Pin::new(&mut self.writer).poll_write(context, bytes);
        self.sent(attempt, context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let attempt = Pin::new(&mut self.writer).poll_write_vectored(context, parts);
        self.sent(attempt, context)
    }

    fn is_write_vectored(&self) -> bool {
        self.writer.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.writer).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.writer).poll_shutdown(context)
    }
}

/// Raises the limit on open files to the hard limit: every socket is a file, and a shell's usual limit is as low as the limit
/// on sockets.
pub fn raise_bound_on_files() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let bound = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: bound.maximum, maximum: bound.maximum };
    if bound.current.is_some() && bound.current != wanted.current && setrlimit(Resource::Nofile, wanted).is_err() {
        tracing::warn!("no more than {} files and sockets can be open", bound.current.unwrap_or_default());
    }
}
