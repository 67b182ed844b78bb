//! Accepts connections, serves their requests by the routes, and shuts down.
//!
//! It has an accept loop of its own because axum 0.8 sets no timeout for a request's head.

#[cfg(test)]
mod autobahn;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::pin::pin;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use isophote_jit::VectorWidth;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpSocket};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_rustls::TlsAcceptor;
use tower::util::MapRequest;

use crate::access::{Access, AccessError, AccessOptions, LocalAddress};
use crate::http::app::App;
use crate::http::guard;
use crate::http::routes::{full, router};
use crate::http::tenants::Tenants;
use crate::limits::LIMITS;
use crate::net::connection_limits::{Admission, ConnectionLimits};
use crate::net::gate::GatedSocket;
use crate::net::socket::{ClientLink, ClientSocket, raise_bound_on_files};
use crate::problem::Problem;
use crate::recording::{RecordingFolder, RecordingSpace};
use crate::service::demo;
use crate::service::machine::Machine;
use crate::service::{OpenError, Service};
use crate::thread::beside;

/// Options of a start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Listen address; port 0 picks a free one.
    pub listen: SocketAddr,
    /// Data folder of models, sources and sessions; in memory only when absent.
    pub data: Option<PathBuf>,
    /// Folder of model documents, put at startup under their file names.
    pub models: Option<PathBuf>,
    /// Starts a synthetic source and a session, both named `demo`.
    pub demo: bool,
    /// Vector width of all kernels; the processor must support it.
    pub width: VectorWidth,
    /// Access control.
    pub access: AccessOptions,
}

/// Why the service does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Tokens or encryption.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The address.
    #[error("cannot listen on {address}: {reason}")]
    Listen {
        /// As configured.
        address: SocketAddr,
        /// The system's error.
        reason: std::io::Error,
    },
    /// The data folder or the compile thread.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The folder of models.
    #[error("{}: {reason}", folder.display())]
    Models {
        /// As configured.
        folder: PathBuf,
        /// The system's error.
        reason: std::io::Error,
    },
    /// The runtime's threads.
    #[error("no threads for the network: {0}")]
    Runtime(std::io::Error),
}

/// A running service.
pub struct Server {
    address: SocketAddr,
    tenants: Arc<Tenants>,
    stop: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens and serves on threads of its own.
    pub fn start(options: &Options) -> Result<Server, StartError> {
        let access = Arc::new(options.access.open(options.listen, options.data.as_deref())?);
        let machine = Arc::new(Machine::of_machine(options.width));
        let service = Service::open(options.data.as_deref(), &machine)?;
        // A start that fails here counts as no early death: declared sessions are not its cause.
        Server::begin(options, access, machine, &service).inspect_err(|_| service.lived())
    }

    fn begin(
        options: &Options,
        access: Arc<Access>,
        machine: Arc<Machine>,
        service: &Arc<Service>,
    ) -> Result<Server, StartError> {
        if let Some(folder) = &options.models {
            let wrong = |reason| StartError::Models { folder: folder.clone(), reason };
            service.put_folder(folder).map_err(wrong)?;
        }
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .thread_name("http")
            .enable_io()
            .enable_time()
            .build()
            .map_err(StartError::Runtime)?;
        let listen = |reason| StartError::Listen { address: options.listen, reason };
        let listener = runtime.block_on(async { bound(options.listen) }).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        if options.demo {
            let demo_service = service.clone();
            let started = runtime.block_on(service.compiler.run(move |owner| demo::start(&demo_service, owner)));
            // A failed demo does not stop the service.
            started.unwrap_or_else(|problem: Problem| tracing::warn!("--demo: no session `demo`: {}", problem.detail));
        }
        let space = RecordingSpace::new(options.access.quota);
        let folder = RecordingFolder::of(options.access.recordings.as_deref(), options.data.as_deref(), &space);
        let unfinished = folder.clone();
        drop(beside("of recordings", move || unfinished.mend_all())); // nobody waits for it
        let (stop, stopped) = watch::channel(false);
        let (limits, streams) = (ConnectionLimits::default(), mpsc::channel(1));
        let app = App::new(service.clone(), limits.sockets(), (access.recordings.clone(), folder));
        let ends = (streams.0.downgrade(), stopped.clone());
        let tenants = Arc::new(Tenants::new(machine, (options.data.clone(), space), access.clone(), app, ends));
        let serving = tenants.clone();
        let thread = std::thread::Builder::new()
            .name("listener".into())
            .spawn(move || {
                runtime.block_on(serve(listener, serving, access, limits, streams, stopped));
                runtime.shutdown_timeout(Duration::from_millis(500));
            })
            .map_err(StartError::Runtime)?;
        Ok(Server { address, tenants, stop, thread: Some(thread) })
    }

    /// The bound address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Blocks until a signal, then stops; a second signal makes this return at once.
    pub fn run_until(self, mut signals: Signals) -> Stopped {
        signals.wait();
        let (done, mut stopped) = oneshot::channel();
        let stop = move || {
            self.stop();
            done.send(()).ok(); // a second signal may have come before
        };
        match std::thread::Builder::new().name("stop".into()).spawn(stop) {
            Ok(_) => signals.wait_unless(&mut stopped),
            Err(_) => Stopped::AtOnce, // the server was dropped with the closure, which stopped it
        }
    }

    /// Closes streams (WebSockets with 1001) and connections, and joins all threads.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        let Some(thread) = self.thread.take() else { return };
        self.tenants.drain();
        self.stop.send_replace(true);
        if thread.join().is_err() {
            tracing::error!("the listener panicked");
        }
        self.tenants.stop();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.end();
    }
}

/// Handlers of SIGINT and SIGTERM.
pub struct Signals {
    runtime: tokio::runtime::Runtime,
    interrupt: Signal,
    terminate: Signal,
}

/// How the shutdown ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// All threads ended.
    InOrder,
    /// A second signal came first.
    AtOnce,
}

impl Signals {
    /// Installs the handlers. Call this before announcing the service, so that a signal then stops it in order.
    pub fn handle() -> std::io::Result<Signals> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let (interrupt, terminate) = {
            let _entered = runtime.enter();
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
        };
        Ok(Signals { runtime, interrupt, terminate })
    }

    /// Blocks until a signal.
    pub fn wait(&mut self) {
        let Signals { runtime, interrupt, terminate } = self;
        runtime.block_on(next(interrupt, terminate));
    }

    fn wait_unless(&mut self, stopped: &mut oneshot::Receiver<()>) -> Stopped {
        let Signals { runtime, interrupt, terminate } = self;
        let first = Instant::now();
        // A parent that forwards a signal which the terminal sends as well delivers it twice.
        let is_another = async {
            loop {
                next(interrupt, terminate).await;
                if first.elapsed() >= LIMITS.signal_time {
                    break;
                }
            }
        };
        runtime.block_on(async {
            tokio::select! {
                _ = stopped => Stopped::InOrder,
                () = is_another => Stopped::AtOnce,
            }
        })
    }
}

async fn next(interrupt: &mut Signal, terminate: &mut Signal) {
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
}

/// Binds with small send buffers: stalled clients are noticed, and many clients take little memory.
fn bound(address: SocketAddr) -> std::io::Result<TcpListener> {
    raise_bound_on_files();
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?; // else the port stays taken for a minute after a service that ended
    socket.set_send_buffer_size(LIMITS.socket_bytes)?;
    socket.bind(address)?;
    socket.listen(LIMITS.sockets as u32)
}

async fn serve(
    listener: TcpListener,
    tenants: Arc<Tenants>,
    access: Arc<Access>,
    limits: ConnectionLimits,
    (held, mut all_held): (mpsc::Sender<()>, mpsc::Receiver<()>),
    mut stopped: watch::Receiver<bool>,
) {
    tokio::spawn(tenants.clone().begin());
    let router = router(tenants).layer(axum::middleware::from_fn_with_state(access.clone(), guard::guard));
    let full = full().layer(axum::middleware::from_fn_with_state(access.clone(), guard::guard));
    let following = [
        access.keyring.clone().map(|keyring| tokio::spawn(keyring.follow())),
        access.tls.clone().map(|certificates| tokio::spawn(certificates.follow())),
    ];
    let stops = stopped.clone();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopped.wait_for(|stopped| *stopped) => break,
        };
        let Ok((socket, peer)) = accepted else {
            // out of descriptors, or the peer is gone: try the next one
            tokio::time::sleep(Duration::from_millis(10)).await;
            continue;
        };
        let (held, tls) = (held.clone(), access.tls.as_ref().map(|certificates| certificates.acceptor()));
        match limits.take(peer.ip()) {
            Admission::Granted(permit) => {
                let connection = serve_client(ClientSocket::new(socket, permit), tls, router.clone(), stops.clone());
                tokio::spawn(async move {
                    connection.await;
                    drop(held);
                });
            }
            taken => {
                // At the limit of refusals, accepting waits; connections over the limit of their address are dropped instead.
                let permit = match taken {
                    Admission::AllOfAddress => limits.try_refusal(),
                    _ => tokio::select! {
                        permit = limits.refusal() => permit,
                        _ = stopped.wait_for(|stopped| *stopped) => break,
                    },
                };
                let Some(permit) = permit else { continue };
                let connection = serve_client(ClientSocket::new(socket, permit), tls, full.clone(), stops.clone());
                tokio::spawn(async move {
                    drop(tokio::time::timeout(LIMITS.told_time, connection).await);
                    drop(held);
                });
            }
        }
    }
    following.into_iter().flatten().for_each(|following| following.abort());
    drop((listener, router, full, held));
    let all_ended = async { while all_held.recv().await.is_some() {} };
    if tokio::time::timeout(LIMITS.drain_time, all_ended).await.is_err() {
        tracing::warn!("some clients did not hang up in time");
    }
}

/// Serves one connection, encrypted if configured. A TLS handshake has as long as a request's head.
async fn serve_client(
    socket: ClientSocket,
    tls: Option<TlsAcceptor>,
    router: Router,
    mut stops: watch::Receiver<bool>,
) {
    let Ok(address) = socket.local_address() else { return }; // the peer is gone
    let arrival = (LocalAddress { local: address.ip() }, socket.link());
    let Some(tls) = tls else { return serve_socket(socket, arrival, router, stops).await };
    let accepted = tokio::select! {
        accepted = tokio::time::timeout(LIMITS.header_time, tls.accept(socket)) => accepted,
        _ = stops.wait_for(|stopped| *stopped) => return,
    };
    if let Ok(Ok(encrypted)) = accepted {
        serve_socket(encrypted, arrival, router, stops).await;
    }
}

/// Serves until the client closes or the service stops; then finishes the answer in progress.
async fn serve_socket(
    socket: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    (arrival, link): (LocalAddress, Arc<ClientLink>),
    router: Router,
    mut stops: watch::Receiver<bool>,
) {
    let (socket, gate) = GatedSocket::new(socket);
    let arriving = MapRequest::new(router, move |mut request: hyper::Request<hyper::body::Incoming>| {
        request.extensions_mut().insert(arrival);
        request.extensions_mut().insert(link.clone());
        request.extensions_mut().insert(gate.clone());
        request
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(LIMITS.header_time)
        .max_buf_size(LIMITS.http_bytes)
        .serve_connection(TokioIo::new(socket), TowerToHyperService::new(arriving))
        .with_upgrades();
    let mut connection = pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => Some(ended),
        _ = stops.wait_for(|stopped| *stopped) => None,
    };
    if ended.is_none() {
        connection.as_mut().graceful_shutdown();
        drop(connection.await); // an error is a fault of the client or its disconnect
    }
}
