//! `ClientSocket`: a socket whose client has to take what it is sent.
//!
//! What comes in: a connection and its place among all of them. What goes out: bytes, both ways, whatever is spoken: plain answers,
//! streams, and WebSockets, which keep the socket and with it its place. A client that takes nothing while there is something to
//! send is left.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

use crate::limits::LIMITS;
use crate::places::SocketPlace;

/// One connection.
pub struct ClientSocket {
    stream: TcpStream,
    /// Since something waits to be sent: when the client is left.
    patience: Option<Pin<Box<Sleep>>>,
    _place: SocketPlace,
}

impl ClientSocket {
    /// A connection that has just begun.
    pub fn new(stream: TcpStream, place: SocketPlace) -> ClientSocket {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
        ClientSocket { stream, patience: None, _place: place }
    }

    /// The address of this machine that was connected to.
    pub fn local_address(&self) -> Result<std::net::SocketAddr> {
        self.stream.local_addr()
    }

    /// What became of an attempt to send.
    fn sent<T>(&mut self, attempt: Poll<Result<T>>, context: &mut Context<'_>) -> Poll<Result<T>> {
        if attempt.is_ready() {
            self.patience = None;
            return attempt;
        }
        let patience = self.patience.get_or_insert_with(|| Box::pin(sleep(LIMITS.send_time)));
        ready!(patience.as_mut().poll(context));
        let client = self.stream.peer_addr().map(|address| address.to_string()).unwrap_or_default();
        tracing::info!(client, "a client is left: it takes nothing of what is sent");
        Poll::Ready(Err(Error::new(ErrorKind::TimedOut, "the client takes nothing")))
    }
}

impl AsyncRead for ClientSocket {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for ClientSocket {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let attempt = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.sent(attempt, context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let attempt = Pin::new(&mut self.stream).poll_write_vectored(context, parts);
        self.sent(attempt, context)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

/// As many files as this machine allows: every socket is one, and a shell's usual bound is as low as that on sockets.
pub fn raise_bound_on_files() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let bound = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: bound.maximum, maximum: bound.maximum };
    if bound.current.is_some() && bound.current != wanted.current && setrlimit(Resource::Nofile, wanted).is_err() {
        tracing::warn!("no more than {} files and sockets can be open", bound.current.unwrap_or_default());
    }
}
