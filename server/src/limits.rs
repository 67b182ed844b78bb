//! The limits of the service, in one table.

use std::time::Duration;

/// Limits of the service; those on a document are in [`isophote_symbolic::LIMITS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServiceLimits {
    /// Bytes of a document's body: a model's tables and a camera's defect map are long.
    pub document_bytes: usize,
    /// Documents of all clients parsed at a time.
    pub parsers: usize,
    /// Bytes of a frame's body.
    pub frame_bytes: usize,
    /// Bytes of a refused body that are read and discarded, so that the sender can read the answer.
    pub drain_bytes: usize,
    /// Models of the registry.
    pub models: usize,
    /// Versions kept of a model.
    pub model_versions: usize,
    /// Bytes of the texts of these versions; the current version is kept regardless.
    pub model_bytes: u64,
    /// Sources with a name.
    pub sources: usize,
    /// Sessions.
    pub sessions: usize,
    /// Subscribers of one session.
    pub subscribers: usize,
    /// Bytes of a session's estimates kept for subscribers in mode `all`.
    pub ring_bytes: usize,
    /// Time for which estimates are kept for a reader of server-sent events that lost its connection.
    pub return_time: Duration,
    /// Largest credit of a subscriber, messages.
    pub credit: u32,
    /// Jobs queued for the compile thread.
    pub compile_jobs: usize,
    /// Pushed frames queued at their source.
    pub pushed_frames: usize,
    /// Pushed frames in flight of one socket: the next is read when one of them is answered.
    pub pushed_window: usize,
    /// Largest rate, frames per second.
    pub rate_hz: f64,
    /// Smallest rate, frames per second.
    pub rate_hz_least: f64,
    /// Range of a source's speed, times its rate.
    pub speed: (f64, f64),
    /// Characters of the name of a lease's owner.
    pub owner_characters: usize,
    /// Range of a lease on the controls of a source, s.
    pub lease_time_s: (f64, f64),
    /// Range of an exposure, times the initial one, if the source does not state one.
    pub exposure: (f64, f64),
    /// Frames that a paused source steps at once.
    pub steps: u64,
    /// Pixels of a frame or window.
    pub window_pixels: usize,
    /// Connections, including WebSockets.
    pub sockets: usize,
    /// Further connections, which get 503, or an answer of `/livez`.
    pub sockets_told: usize,
    /// Time for each of these refusals.
    pub told_time: Duration,
    /// Connections of one remote address; of IPv6, of one /64 network.
    pub sockets_per_address: usize,
    /// Tokens.
    pub tokens: usize,
    /// Tenants.
    pub tenants: usize,
    /// Documents compiled per minute and tenant.
    pub compiles_a_minute: u32,
    /// Bytes of the token file.
    pub token_file_bytes: u64,
    /// Interval between checks of the token and certificate files for changes.
    pub token_interval: Duration,
    /// Bytes of a certificate or key file.
    pub pem_bytes: u64,
    /// Send buffer of a socket, bytes; the system doubles it.
    pub socket_bytes: u32,
    /// Bytes of one session's frames that wait to be recorded.
    pub recording_bytes: usize,
    /// Further bytes for notes on these frames that wait to be recorded.
    pub recording_note_bytes: usize,
    /// Largest budget of a recording, in units of 10⁶ bytes.
    pub recording_mb: u64,
    /// Wait for a recording's file to be completed when its end is requested.
    pub recording_end_time: Duration,
    /// Recordings downloaded at a time.
    pub downloads: usize,
    /// Bytes that a download reads at a time.
    pub download_bytes: usize,
    /// Bytes of pushed frames in flight, of all clients; half of it for WebSocket messages being received.
    pub flight_bytes: usize,
    /// Bytes of a request's head, and of buffered output of an answer.
    pub http_bytes: usize,
    /// Read and write buffer of a WebSocket, bytes.
    pub websocket_bytes: usize,
    /// Timeout of a request's head.
    pub header_time: Duration,
    /// Timeout of a request's body.
    pub body_time: Duration,
    /// Bytes of a subscriber's message.
    pub message_bytes: usize,
    /// Timeout of a write without an acknowledged byte. Systems report free buffer space in steps of 64 KiB and more, which
    /// takes a client that reads steadily, say 20 lines a second, some seconds.
    pub send_time: Duration,
    /// Bytes of pictures that all viewers together have not received yet.
    pub picture_bytes: usize,
    /// Time until a viewer that exceeds these bytes is tried again.
    pub picture_time: Duration,
    /// Largest rate of pictures that a viewer may ask for.
    pub picture_rate_hz: f64,
    /// Interval of pings.
    pub ping_time: Duration,
    /// Timeout of a silent subscriber.
    pub silence_time: Duration,
    /// Signals within this time count as one.
    pub signal_time: Duration,
    /// Wait for streams to end when the service stops.
    pub drain_time: Duration,
    /// Largest time that a client may give a frame, s: 300 years.
    pub frame_time_s: f64,
    /// Timeout of a pushed frame's estimate.
    pub push_time: Duration,
    /// Single images fitted at a time.
    pub image_fits: usize,
    /// Single images that are fitted or wait for it.
    pub images: usize,
    /// Items of a page of a list.
    pub page_items: usize,
    /// Wait for a stopped thread to end: a session's last fit, a source's last frame, and all threads when the service stops.
    pub end_time: Duration,
    /// Models whose fits take less time are never too slow to be swapped in.
    pub slow_fit_time: Duration,
    /// Timeout of a camera's driver; its source is then stalled.
    pub driver_time: Duration,
    /// Time after which another thread takes over the camera and the one blocked in its driver is given up; doubles each time.
    pub driver_patience: Duration,
    /// Threads given up by one source.
    pub given_up_each: usize,
    /// Threads given up by all sources, and by other calls to cameras that do not return; then no camera is opened.
    pub given_up_threads: usize,
    /// Timeout to open a camera or to set its controls.
    pub camera_open_time: Duration,
    /// Interval between checks that the owner of all changes answers.
    pub watch_time: Duration,
    /// Timeout of its answer; the service is then not ready.
    pub answer_time: Duration,
    /// Timeout to open a recording.
    pub open_time: Duration,
    /// Recordings opened at a time.
    pub openings: usize,
    /// Range of the pause between two rounds of a looped recording of which nothing can be read.
    pub reread_time: (Duration, Duration),
    /// A start that has lasted this long, or was stopped in order, did not die early.
    pub start_time: Duration,
    /// Consecutive early deaths after which declared sessions stay stopped.
    pub starts_died: u32,
    /// Time for one frame's fits; then the estimate says that it is over budget. The search for a pose of six alike spots is
    /// the longest fit.
    pub frame_time: Duration,
    /// The same for sources whose frames do not wait for fits: the frame interval, but at most this. In CPU time of the fit
    /// thread.
    pub frame_budget: Duration,
    /// Time for a search of such a frame. A search that exceeds it restarts with twice as much, up to `frame_time`.
    pub search_time: Duration,
    /// Time for one fit of a model on trial beside a session; the fit is then cancelled.
    pub trial_time: Duration,
    /// Time for the search before it, if one is needed.
    pub settle_time: Duration,
    /// Wait for the frame that it is tried on.
    pub sample_time: Duration,
    /// Share of the processors that realtime sessions may keep busy.
    pub load_share: f64,
    /// Time for which a session keeps its search turn without asking for it.
    pub search_patience: Duration,
    /// Shadows of all sessions.
    pub shadows: usize,
    /// Pause of a shadow after its session dropped a frame.
    pub shed_time: Duration,
    /// Time for which a swap waits for a running fit; then the fit is cancelled.
    pub swap_time: Duration,
}

/// The limits in force.
pub const LIMITS: ServiceLimits = ServiceLimits {
    document_bytes: 2 * 1024 * 1024,
    parsers: 2,
    frame_bytes: 64 * 1024 * 1024,
    drain_bytes: 16 * 1024 * 1024,
    models: 256,
    model_versions: 32,
    model_bytes: 4 * 1024 * 1024,
    sources: 64,
    sessions: 64,
    subscribers: 32,
    ring_bytes: 16 * 1024 * 1024,
    return_time: Duration::from_secs(60),
    credit: 65_536,
    compile_jobs: 64,
    pushed_frames: 8,
    pushed_window: 4,
    rate_hz: 10_000.0,
    rate_hz_least: 1e-3,
    speed: (0.05, 16.0),
    owner_characters: 64,
    lease_time_s: (0.1, 3600.0),
    exposure: (1.0 / 256.0, 256.0),
    steps: 1_000_000,
    window_pixels: 16 * 1024 * 1024,
    sockets: 1024,
    sockets_told: 64,
    told_time: Duration::from_secs(2),
    sockets_per_address: 64,
    tokens: 1024,
    tenants: 16,
    compiles_a_minute: 30,
    token_file_bytes: 1024 * 1024,
    token_interval: Duration::from_millis(250),
    pem_bytes: 1024 * 1024,
    socket_bytes: 128 * 1024,
    recording_bytes: 64 * 1024 * 1024,
    recording_note_bytes: 16 * 1024 * 1024,
    recording_mb: 1_000_000,
    recording_end_time: Duration::from_secs(10),
    downloads: 8,
    download_bytes: 256 * 1024,
    flight_bytes: 256 * 1024 * 1024,
    http_bytes: 64 * 1024,
    websocket_bytes: 16 * 1024,
    header_time: Duration::from_secs(10),
    body_time: Duration::from_secs(10),
    message_bytes: 4096,
    send_time: Duration::from_secs(15),
    picture_bytes: 256 * 1024 * 1024,
    picture_time: Duration::from_millis(100),
    picture_rate_hz: 60.0,
    ping_time: Duration::from_secs(15),
    silence_time: Duration::from_secs(60),
    signal_time: Duration::from_millis(200),
    drain_time: Duration::from_secs(2),
    frame_time_s: 1e10,
    push_time: Duration::from_secs(20),
    image_fits: 2,
    images: 16,
    page_items: 1000,
    end_time: Duration::from_millis(1000),
    slow_fit_time: Duration::from_millis(100),
    driver_time: Duration::from_secs(3),
    driver_patience: Duration::from_secs(10),
    given_up_each: 4,
    given_up_threads: 16,
    camera_open_time: Duration::from_secs(10),
    watch_time: Duration::from_millis(250),
    answer_time: Duration::from_secs(2),
    open_time: Duration::from_secs(30),
    openings: 4,
    reread_time: (Duration::from_millis(250), Duration::from_secs(5)),
    start_time: Duration::from_secs(30),
    starts_died: 3,
    frame_time: Duration::from_secs(15),
    frame_budget: Duration::from_millis(250),
    search_time: Duration::from_millis(200),
    trial_time: Duration::from_millis(400),
    settle_time: Duration::from_secs(1),
    sample_time: Duration::from_secs(1),
    load_share: 0.8,
    search_patience: Duration::from_secs(1),
    shadows: 16,
    shed_time: Duration::from_secs(2),
    swap_time: Duration::from_millis(100),
};

// SIGTERM: streams and answers, the runtime's threads (half a second), all others; 5 s with a second to spare.
const _: () = assert!(LIMITS.drain_time.as_millis() + 500 + LIMITS.end_time.as_millis() <= 4000);

// A client that pushed a frame learns the outcome of its fit.
const _: () = assert!(LIMITS.frame_time.as_nanos() < LIMITS.push_time.as_nanos());
