//! The network: sockets in, requests to the routes; and the way down.
//!
//! It accepts by itself because axum 0.8 gives a client for ever to finish a request's head.

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
use tokio::net::{TcpListener, TcpSocket};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{Semaphore, mpsc, oneshot, watch};

use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::routes::{App, full, router};
use crate::service::{OpenError, Service};
use crate::socket::{ClientSocket, raise_bound_on_files};
use crate::{demo, guard, watchdog};

/// How the service is started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// A loopback address; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Where models are kept; in memory only when absent.
    pub data: Option<PathBuf>,
    /// With a synthetic source and a running session, both named `demo`.
    pub demo: bool,
    /// The vectors of the kernels of all sessions; the processor must have them.
    pub width: VectorWidth,
}

/// Why the service does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Whoever reaches it may run models on this machine; until there are tokens that is this machine alone.
    #[error("{0} is not a loopback address; this build serves only 127.0.0.1 and [::1], since it has no tokens yet")]
    NotLoopback(SocketAddr),
    /// The address.
    #[error("cannot listen on {address}: {reason}")]
    Listen {
        /// As asked for.
        address: SocketAddr,
        /// The system's words.
        reason: std::io::Error,
    },
    /// The data folder or the compile thread.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The runtime's threads.
    #[error("no threads for the network: {0}")]
    Runtime(std::io::Error),
    /// The demo session.
    #[error("the demo does not start: {0}")]
    Demo(String),
}

/// A running service.
pub struct Server {
    address: SocketAddr,
    service: Arc<Service>,
    stop: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens and serves on threads of its own.
    pub fn start(options: &Options) -> Result<Server, StartError> {
        if !options.listen.ip().is_loopback() {
            return Err(StartError::NotLoopback(options.listen));
        }
        let service = Arc::new(Service::open(options.data.as_deref(), options.width)?);
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
            let started = runtime.block_on(service.compiler.run(move || demo::start(&demo_service)));
            started.map_err(|problem: Problem| StartError::Demo(problem.detail))?;
        }
        let (stop, stopped) = watch::channel(false);
        let serving = service.clone();
        let thread = std::thread::Builder::new()
            .name("listener".into())
            .spawn(move || {
                runtime.block_on(serve(listener, serving.clone(), stopped));
                runtime.shutdown_timeout(Duration::from_millis(500));
            })
            .map_err(StartError::Runtime)?;
        Ok(Server { address, service, stop, thread: Some(thread) })
    }

    /// Where it listens, port filled in.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Blocks until a signal, then stops; a second signal ends the wait for that at once.
    pub fn run_until(self, mut signals: Signals) -> Stopped {
        signals.wait();
        let (done, mut stopped) = oneshot::channel();
        let stop = move || {
            self.stop();
            done.send(()).ok(); // a second signal may have come before
        };
        match std::thread::Builder::new().name("stop".into()).spawn(stop) {
            Ok(_) => signals.wait_unless(&mut stopped),
            Err(_) => Stopped::AtOnce, // what it was to stop was dropped with it, and stopped by that
        }
    }

    /// Ends streams (WebSockets with 1001) and connections, then all threads; returns when they are gone.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        let Some(thread) = self.thread.take() else { return };
        self.service.drain();
        self.stop.send_replace(true);
        if thread.join().is_err() {
            eprintln!("isophote: the listener panicked");
        }
        self.service.stop();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.end();
    }
}

/// SIGINT and SIGTERM, from now on.
pub struct Signals {
    runtime: tokio::runtime::Runtime,
    interrupt: Signal,
    terminate: Signal,
}

/// How it came to an end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// All that ran has ended.
    InOrder,
    /// A second signal came before.
    AtOnce,
}

impl Signals {
    /// Whoever says that the service runs has these before: a signal then stops it in order.
    pub fn handle() -> std::io::Result<Signals> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let (interrupt, terminate) = {
            let _entered = runtime.enter();
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
        };
        Ok(Signals { runtime, interrupt, terminate })
    }

    fn wait(&mut self) {
        let Signals { runtime, interrupt, terminate } = self;
        runtime.block_on(next(interrupt, terminate));
    }

    fn wait_unless(&mut self, stopped: &mut oneshot::Receiver<()>) -> Stopped {
        let Signals { runtime, interrupt, terminate } = self;
        let first = Instant::now();
        // Those who forward a signal to a child whose terminal sends it as well send one twice.
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

/// Its connections have small buffers: a client that takes nothing is noticed, and many of them take little.
fn bound(address: SocketAddr) -> std::io::Result<TcpListener> {
    raise_bound_on_files();
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?; // else the port stays taken for a minute after a service that ended
    socket.set_send_buffer_size(LIMITS.socket_bytes)?;
    socket.bind(address)?;
    socket.listen(LIMITS.sockets as u32)
}

async fn serve(listener: TcpListener, service: Arc<Service>, mut stopped: watch::Receiver<bool>) {
    let (held, mut all_held) = mpsc::channel(1);
    let sockets = Arc::new(Semaphore::new(LIMITS.sockets));
    tokio::spawn(watchdog::watch(service.clone()));
    let router = router(App {
        service,
        stream: held.clone(),
        openings: Arc::new(Semaphore::new(LIMITS.openings)),
        frames: Arc::default(),
        images: Arc::default(),
        sockets: sockets.clone(),
    })
    .layer(axum::middleware::from_fn(guard::guard));
    let full = full().layer(axum::middleware::from_fn(guard::guard));
    let told = Arc::new(Semaphore::new(LIMITS.sockets_told));
    let stops = stopped.clone();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopped.wait_for(|stopped| *stopped) => break,
        };
        let Ok((socket, _)) = accepted else {
            // out of descriptors, or the peer has gone already: the next one may do better
            tokio::time::sleep(Duration::from_millis(10)).await;
            continue;
        };
        let held = held.clone();
        if let Ok(place) = sockets.clone().try_acquire_owned() {
            let connection = serve_socket(ClientSocket::new(socket, place), router.clone(), stops.clone());
            tokio::spawn(async move {
                connection.await;
                drop(held);
            });
            continue;
        }
        // Where even these are many, the next ones wait to be accepted.
        let place = tokio::select! {
            place = told.clone().acquire_owned() => place,
            _ = stopped.wait_for(|stopped| *stopped) => break,
        };
        let Ok(place) = place else { break };
        let connection = serve_socket(ClientSocket::new(socket, place), full.clone(), stops.clone());
        tokio::spawn(async move {
            drop(tokio::time::timeout(LIMITS.told_time, connection).await); // who is not told by then is left
            drop(held);
        });
    }
    drop((listener, router, full, held));
    let all_ended = async { while all_held.recv().await.is_some() {} };
    if tokio::time::timeout(LIMITS.drain_time, all_ended).await.is_err() {
        eprintln!("isophote: some clients did not hang up in time");
    }
}

/// One connection, until the client leaves or the service stops: then after the answer that is under way.
async fn serve_socket(socket: ClientSocket, router: Router, mut stops: watch::Receiver<bool>) {
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(LIMITS.header_time)
        .serve_connection(TokioIo::new(socket), TowerToHyperService::new(router))
        .with_upgrades();
    let mut connection = pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => Some(ended),
        _ = stops.wait_for(|stopped| *stopped) => None,
    };
    if ended.is_none() {
        connection.as_mut().graceful_shutdown();
        drop(connection.await); // an error is the client's fault, or its leaving
    }
}
