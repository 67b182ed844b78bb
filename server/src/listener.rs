//! The network: sockets in, requests to the routes; and the way down.
//!
//! It accepts by itself because axum 0.8 gives a client for ever to finish a request's head.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::pin::pin;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use isophote_jit::VectorWidth;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc, watch};

use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::routes::{App, router};
use crate::service::{OpenError, Service};
use crate::{demo, guard};

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
        let listener = runtime.block_on(TcpListener::bind(options.listen)).map_err(listen)?;
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
                runtime.shutdown_timeout(Duration::from_secs(1));
            })
            .map_err(StartError::Runtime)?;
        Ok(Server { address, service, stop, thread: Some(thread) })
    }

    /// Where it listens, port filled in.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Blocks until SIGINT or SIGTERM, then stops.
    pub fn run_until_signal(self) -> std::io::Result<()> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let signalled = runtime.block_on(async {
            use tokio::signal::unix::{SignalKind, signal};
            let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            Ok(())
        });
        self.stop();
        signalled
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

async fn serve(listener: TcpListener, service: Arc<Service>, mut stopped: watch::Receiver<bool>) {
    let (held, mut all_held) = mpsc::channel(1);
    let router = router(App { service, stream: held.clone() }).layer(axum::middleware::from_fn(guard::guard));
    let sockets = Arc::new(Semaphore::new(LIMITS.sockets));
    let stops = stopped.clone();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopped.wait_for(|stopped| *stopped) => break,
        };
        match (accepted, sockets.clone().try_acquire_owned()) {
            (Ok((socket, _)), Ok(permit)) => {
                let connection = serve_socket(socket, router.clone(), stops.clone());
                let held = held.clone();
                tokio::spawn(async move {
                    connection.await;
                    drop((permit, held));
                });
            }
            (Ok(_), Err(_)) => {} // over the limit: closed at once
            // out of descriptors, or the peer has gone already: the next one may do better
            (Err(_), _) => tokio::time::sleep(Duration::from_millis(10)).await,
        }
    }
    drop((listener, router, held));
    let all_ended = async { while all_held.recv().await.is_some() {} };
    if tokio::time::timeout(LIMITS.drain_time, all_ended).await.is_err() {
        eprintln!("isophote: some clients did not hang up in time");
    }
}

/// One connection, until the client leaves or the service stops: then after the answer that is under way.
async fn serve_socket(socket: TcpStream, router: Router, mut stops: watch::Receiver<bool>) {
    if let Err(error) = socket.set_nodelay(true) {
        eprintln!("isophote: no TCP_NODELAY: {error}");
    }
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
