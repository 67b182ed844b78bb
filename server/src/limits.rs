//! The one table of bounds of the service.

use std::time::Duration;

/// Bounds of the service; those on a document are in [`isophote_symbolic::LIMITS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServiceLimits {
    /// Bytes of a document's body.
    pub document_bytes: usize,
    /// Bytes of a frame's body.
    pub frame_bytes: usize,
    /// Bytes of a wrong body that are read and thrown away, so that the sender gets to read the answer.
    pub drain_bytes: usize,
    /// Models of the registry.
    pub models: usize,
    /// Sources with a name.
    pub sources: usize,
    /// Sessions.
    pub sessions: usize,
    /// Subscribers of one session.
    pub subscribers: usize,
    /// Estimates that wait for one subscriber in mode `all`.
    pub queue: usize,
    /// Messages that a subscriber may have open.
    pub credit: u32,
    /// Jobs that wait for the compile thread.
    pub compile_jobs: usize,
    /// Pushed frames that wait for their source.
    pub pushed_frames: usize,
    /// Pushed frames of one socket that are on their way: the next is read when one of them is answered.
    pub pushed_window: usize,
    /// Frames a second.
    pub rate_hz: f64,
    /// … and at least, where there is a rate.
    pub rate_hz_least: f64,
    /// Pixels of a frame or window.
    pub window_pixels: usize,
    /// Sockets.
    pub sockets: usize,
    /// Until a request's head is complete.
    pub header_time: Duration,
    /// Until a request's body is complete.
    pub body_time: Duration,
    /// Bytes of a message from a subscriber.
    pub message_bytes: usize,
    /// Until a subscriber in mode `latest` takes a message.
    pub send_time: Duration,
    /// Until a subscriber in mode `all` takes a message: it asked for every frame, and its queue holds them meanwhile.
    pub send_time_all: Duration,
    /// Between pings.
    pub ping_time: Duration,
    /// Without any sign of life from a subscriber.
    pub silence_time: Duration,
    /// For streams to end when the service stops.
    pub drain_time: Duration,
    /// What a client may say of a frame's time, s: 300 years.
    pub frame_time_s: f64,
    /// For a pushed frame's estimate.
    pub push_time: Duration,
    /// For a session's last fit, when it is stopped.
    pub fit_time: Duration,
    /// For one frame's fits; then the estimate says that there was too much to do. The search for a pose of six alike spots is
    /// the longest that there is.
    pub frame_time: Duration,
    /// A swap waits for a fit that has begun for so long; then the fit is given up.
    pub swap_time: Duration,
}

/// The bounds in force.
pub const LIMITS: ServiceLimits = ServiceLimits {
    document_bytes: 128 * 1024,
    frame_bytes: 64 * 1024 * 1024,
    drain_bytes: 16 * 1024 * 1024,
    models: 256,
    sources: 64,
    sessions: 64,
    subscribers: 32,
    queue: 16_384,
    credit: 65_536,
    compile_jobs: 64,
    pushed_frames: 8,
    pushed_window: 4,
    rate_hz: 10_000.0,
    rate_hz_least: 1e-3,
    window_pixels: 16 * 1024 * 1024,
    sockets: 1024,
    header_time: Duration::from_secs(10),
    body_time: Duration::from_secs(30),
    message_bytes: 4096,
    send_time: Duration::from_secs(10),
    send_time_all: Duration::from_secs(60),
    ping_time: Duration::from_secs(15),
    silence_time: Duration::from_secs(60),
    drain_time: Duration::from_secs(5),
    frame_time_s: 1e10,
    push_time: Duration::from_secs(20),
    fit_time: Duration::from_millis(500),
    frame_time: Duration::from_secs(15),
    swap_time: Duration::from_millis(100),
};

// Whoever pushed a frame hears what became of its fit.
const _: () = assert!(LIMITS.frame_time.as_nanos() < LIMITS.push_time.as_nanos());
