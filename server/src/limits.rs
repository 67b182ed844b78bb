//! The one table of bounds of the service.

use std::time::Duration;

/// Bounds of the service; those on a document are in [`isophote_symbolic::LIMITS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServiceLimits {
    /// Bytes of a document's body: a model's tables and a camera's map of defects are long.
    pub document_bytes: usize,
    /// Documents that are parsed at a time, of all clients.
    pub parsers: usize,
    /// Bytes of a frame's body.
    pub frame_bytes: usize,
    /// Bytes of a wrong body that are read and thrown away, so that the sender gets to read the answer.
    pub drain_bytes: usize,
    /// Models of the registry.
    pub models: usize,
    /// Versions of one of them that are kept.
    pub model_versions: usize,
    /// Bytes of their texts; the version that has the name is kept however long it is.
    pub model_bytes: u64,
    /// Sources with a name.
    pub sources: usize,
    /// Sessions.
    pub sessions: usize,
    /// Subscribers of one session.
    pub subscribers: usize,
    /// Bytes of the estimates of one session that its subscribers in mode `all` may still get.
    pub ring_bytes: usize,
    /// For a reader of events whose connection broke to come back for what it has missed: until then it is kept.
    pub return_time: Duration,
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
    /// Least and most of what a source may be played at, times its rate.
    pub speed: (f64, f64),
    /// Characters of who controls a source.
    pub owner_characters: usize,
    /// Least and most of a lease on the knobs of a source, s.
    pub lease_time_s: (f64, f64),
    /// Least and most of an exposure, times that of the beginning, where the source does not say.
    pub exposure: (f64, f64),
    /// Frames that a paused source shows at once.
    pub steps: u64,
    /// Pixels of a frame or window.
    pub window_pixels: usize,
    /// Sockets, those of WebSockets among them.
    pub sockets: usize,
    /// Further ones, which are told that there are too many, or that the service lives.
    pub sockets_told: usize,
    /// For one of these.
    pub told_time: Duration,
    /// Sockets of one address, where it is not this machine's; of IPv6, of one network of 64 bits.
    pub sockets_per_address: usize,
    /// Tokens.
    pub tokens: usize,
    /// Those whose tokens they are.
    pub tenants: usize,
    /// Documents that a tenant may have compiled in a minute.
    pub compiles_a_minute: u32,
    /// Bytes of the file of tokens.
    pub token_file_bytes: u64,
    /// Between looks at that file.
    pub token_interval: Duration,
    /// Bytes of a certificate's or key's file.
    pub pem_bytes: u64,
    /// Bytes that are sent and that a client has not taken yet; the system doubles it.
    pub socket_bytes: u32,
    /// Bytes of frames of one session that wait to be recorded, …
    pub recording_bytes: usize,
    /// … and of what is said of them.
    pub recording_note_bytes: usize,
    /// A recording's budget at most, in units of 10⁶ bytes.
    pub recording_mb: u64,
    /// For a recording's file to get its end, when its end is asked for.
    pub recording_end_time: Duration,
    /// Files of recordings that are sent at a time.
    pub downloads: usize,
    /// Bytes of them that are read at a time.
    pub download_bytes: usize,
    /// Bytes of pushed frames on their way, of all clients together; half of it for messages of WebSockets that are half received.
    pub flight_bytes: usize,
    /// Bytes of a request's head, and of an answer that waits to be sent.
    pub http_bytes: usize,
    /// Bytes that a WebSocket reads, and writes, at a time.
    pub websocket_bytes: usize,
    /// Until a request's head is complete.
    pub header_time: Duration,
    /// Until a request's body is complete.
    pub body_time: Duration,
    /// Bytes of a message from a subscriber.
    pub message_bytes: usize,
    /// Without a byte taken of what is to be sent, whatever it is. Systems tell of room in steps of 64 KiB and more, which a client
    /// that reads steadily, 20 lines a second say, takes some seconds for.
    pub send_time: Duration,
    /// Bytes of pictures that viewers have not taken yet, of all of them together, …
    pub picture_bytes: usize,
    /// … and for one who finds no room there until the next try.
    pub picture_time: Duration,
    /// Pictures a second that a viewer may ask for.
    pub picture_rate_hz: f64,
    /// Between pings.
    pub ping_time: Duration,
    /// Without any sign of life from a subscriber.
    pub silence_time: Duration,
    /// Signals that come together count as one.
    pub signal_time: Duration,
    /// For streams to end when the service stops.
    pub drain_time: Duration,
    /// What a client may say of a frame's time, s: 300 years.
    pub frame_time_s: f64,
    /// For a pushed frame's estimate.
    pub push_time: Duration,
    /// Single images that are fitted at a time, …
    pub image_fits: usize,
    /// … and those that are, or wait for it.
    pub images: usize,
    /// Items of a list that is asked for in pieces.
    pub page_items: usize,
    /// For a thread to end when it was told to: a session's last fit, a source's last frame, and all of them when the service
    /// stops.
    pub end_time: Duration,
    /// Models whose fits take less are never too slow to be swapped in.
    pub slow_fit_time: Duration,
    /// For a camera's driver to answer; after that its source is stalled.
    pub driver_time: Duration,
    /// After so long another thread goes on with the camera, and the one that its driver keeps is given up; after twice as long
    /// the next time, and so on.
    pub driver_patience: Duration,
    /// Threads of one source that are given up, …
    pub given_up_each: usize,
    /// … and of all of them, with other calls to cameras that do not return; then no camera is opened.
    pub given_up_threads: usize,
    /// For a camera to be opened, or its controls to be set.
    pub camera_open_time: Duration,
    /// Between questions whether the owner of all changes still answers.
    pub watch_time: Duration,
    /// For its answer; then the service says that it is not ready.
    pub answer_time: Duration,
    /// For a recording to be opened.
    pub open_time: Duration,
    /// Recordings that are opened at a time.
    pub openings: usize,
    /// Least and most of the time between two rounds of a recording that is played again and again and of which nothing can be
    /// read.
    pub reread_time: (Duration, Duration),
    /// A start that has lasted for so long, or was stopped in order, has not died.
    pub start_time: Duration,
    /// Starts that died one after the other; then sessions that were declared stay stopped.
    pub starts_died: u32,
    /// For one frame's fits; then the estimate says that there was too much to do. The search for a pose of six alike spots is
    /// the longest that there is.
    pub frame_time: Duration,
    /// … and of a source whose frames do not wait for fits: its interval, but no more than this. It is counted in the time of
    /// the thread that fits.
    pub frame_budget: Duration,
    /// For a search of such a frame. One that takes longer begins anew with twice as much, up to `frame_time`.
    pub search_time: Duration,
    /// For one fit of a model that is tried beside a session; what takes longer is left.
    pub trial_time: Duration,
    /// For the search before it, where that is needed.
    pub settle_time: Duration,
    /// For the frame that it is tried on to come.
    pub sample_time: Duration,
    /// Share of the processors that realtime sessions may keep busy.
    pub load_share: f64,
    /// A session keeps its turn for a search for so long without asking for it.
    pub search_patience: Duration,
    /// Shadows of all sessions.
    pub shadows: usize,
    /// After a frame that its session has lost a shadow gets none for so long.
    pub shed_time: Duration,
    /// A swap waits for a fit that has begun for so long; then the fit is given up.
    pub swap_time: Duration,
}

/// The bounds in force.
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

// Whoever pushed a frame hears what became of its fit.
const _: () = assert!(LIMITS.frame_time.as_nanos() < LIMITS.push_time.as_nanos());
