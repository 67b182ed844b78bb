//! `GET /metrics`: counters for Prometheus. Only two labels carry users' names: `session`, of present sessions only (at most
//! [`LIMITS::sessions`](crate::limits::LIMITS)), and `tenant`, for operators.

use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use isophote_wire::SessionState;

use super::App;
use crate::access::Visitor;
use crate::counters::{Histogram, STATES, SessionCounters, Tally};
use crate::http::exposition::{Exposition, MEDIA};
use crate::http::tenants::Tenants;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::preview::Preview;
use crate::service::Service;
use crate::service::machine::Member;
use crate::session::Session;

type Sessions = [(Name, Arc<Session>)];

/// Name, help, and the counter.
type Row<T> = (&'static str, &'static str, fn(&SessionCounters) -> &T);

/// States of sessions, with their names.
const SESSION_STATES: [(SessionState, &str); 6] = [
    (SessionState::Starting, "starting"),
    (SessionState::Running, "running"),
    (SessionState::Stalled, "stalled"),
    (SessionState::LostSource, "lost_source"),
    (SessionState::Stopped, "stopped"),
    (SessionState::Failed, "failed"),
];

/// Returns counters, gauges and histograms for Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "operation", operation_id = "metrics",
    responses((status = 200, description = "Prometheus text format 0.0.4.", body = String, content_type = "text/plain")))]
pub async fn get(tenants: State<Arc<Tenants>>, visitor: Extension<Visitor>, app: App) -> Response {
    let sessions = app.service.sessions();
    let mut all = Exposition::default();
    of_service(&mut all, &app);
    if visitor.is_operator() {
        of_tenants(&mut all, &tenants.all());
    }
    of_kernels(&mut all, &app.service);
    of_sessions(&mut all, &sessions);
    of_fits(&mut all, &sessions);
    of_subscribers(&mut all, &sessions);
    of_previews(&mut all, &sessions);
    ([(header::CONTENT_TYPE, MEDIA), (header::CACHE_CONTROL, "no-store")], all.text()).into_response()
}

fn of_service(all: &mut Exposition, app: &App) {
    let service = &app.service;
    let one = |all: &mut Exposition, name, help: &str, value: usize| all.gauge(name, help).sample(&[], value as f64);
    all.gauge("isophote_build_info", "Always 1; the version is a label.")
        .sample(&[("version", env!("CARGO_PKG_VERSION"))], 1.0);
    let is_ready = service.readiness().is_ok();
    one(all, "isophote_ready", "1 when changes are taken, of this tenant.", usize::from(is_ready));
    let answer_s = service.watch.answer_time().as_secs_f64();
    all.gauge("isophote_owner_answer_seconds", "Latest response time of the thread that applies all changes.")
        .sample(&[], answer_s);
    let taken = LIMITS.sockets - app.sockets.available_permits();
    one(all, "isophote_sockets", "Open connections, including WebSockets.", taken);
    let bytes = app.frames.bytes_taken();
    one(all, "isophote_frame_bytes_in_flight", "Memory of frames in requests, until they are answered.", bytes);
    let given_up = service.machine.drivers.given_up();
    one(all, "isophote_camera_threads_given_up", "Camera threads blocked in driver calls and abandoned.", given_up);
    one(all, "isophote_models", "Models in the registry.", service.registry.list().len());
    one(all, "isophote_sources", "Named sources.", service.sources().len());
    one(all, "isophote_recording_bytes", "Size of the recordings' files.", app.folder.bytes() as usize);
}

/// Metrics of each tenant, for operators.
fn of_tenants(all: &mut Exposition, tenants: &[(Name, App)]) {
    type Gauge = (&'static str, &'static str, fn(&App) -> f64);
    let gauges: [Gauge; 8] = [
        ("isophote_tenant_models", "Models in a tenant's registry.", |app| app.service.registry.list().len() as f64),
        ("isophote_tenant_sources", "Named sources.", |app| app.service.holding().sources as f64),
        ("isophote_tenant_sessions", "Sessions, including stopped ones.", |app| app.service.holding().sessions as f64),
        ("isophote_tenant_load", "Processors used by realtime sessions.", |app| app.service.holding().load),
        ("isophote_tenant_ready", "1 when changes are taken.", |app| {
            f64::from(u8::from(app.service.readiness().is_ok()))
        }),
        ("isophote_tenant_kernels", "Cached compiled kernels.", |app| {
            app.service.registry.cache().counts().kernels as f64
        }),
        ("isophote_tenant_kernel_bytes", "Estimated memory of the cached kernels.", |app| {
            app.service.registry.cache().counts().bytes as f64
        }),
        ("isophote_tenant_recording_bytes", "Size of the recordings' files.", |app| app.folder.bytes() as f64),
    ];
    for (name, help, value) in gauges {
        let mut family = all.gauge(name, help);
        tenants.iter().for_each(|(tenant, app)| family.sample(&[("tenant", tenant.as_str())], value(app)));
    }
}

fn of_kernels(all: &mut Exposition, service: &Service) {
    let counts = service.registry.cache().counts();
    all.gauge("isophote_kernels", "Cached compiled kernels.").sample(&[], counts.kernels as f64);
    all.gauge("isophote_kernel_bytes", "Estimated memory of the cached kernels.").sample(&[], counts.bytes as f64);
    let mut requests = all.counter("isophote_kernel_requests_total", "Kernel cache lookups, by result.");
    requests.sample(&[("result", "hit")], counts.hits as f64);
    requests.sample(&[("result", "miss")], counts.misses as f64);
    all.counter("isophote_kernel_evictions_total", "Kernels evicted from the cache.")
        .sample(&[], counts.evictions as f64);
    let counters = &service.counters;
    all.histogram("isophote_compile_seconds", "Compile time of documents, for models, sessions and swaps.")
        .distribution(&[], &counters.compile_s);
    all.histogram("isophote_image_fit_seconds", "Time of fits of single images.")
        .distribution(&[], &counters.image_fit_s);
}

fn of_sessions(all: &mut Exposition, sessions: &Sessions) {
    let states: Vec<SessionState> = sessions.iter().map(|(_, session)| session.state().0).collect();
    let mut family = all.gauge("isophote_sessions", "Sessions, by state.");
    for (state, name) in SESSION_STATES {
        let count = states.iter().filter(|one| **one == state).count();
        family.sample(&[("state", name)], count as f64);
    }
    let counted: [Row<Tally>; 4] = [
        ("isophote_frames_total", "Frames that were fitted.", |of| &of.frames),
        ("isophote_frames_dropped_total", "Frames of the source that were not fitted.", |of| &of.dropped),
        ("isophote_fits_unfinished_total", "Fits stopped by a limit of work or time.", |of| &of.unfinished),
        ("isophote_swaps_total", "Model swaps.", |of| &of.swaps),
    ];
    for (name, help, counter) in counted {
        let mut family = all.counter(name, help);
        for (session, one) in sessions {
            family.sample(&[("session", session.as_str())], counter(one.counters()).count() as f64);
        }
    }
    let mut family = all.counter("isophote_estimates_total", "Estimates, by the state of their target.");
    for (session, one) in sessions {
        for ((_, state), counter) in STATES.iter().zip(&one.counters().estimates) {
            family.sample(&[("session", session.as_str()), ("state", state)], counter.count() as f64);
        }
    }
}

fn of_fits(all: &mut Exposition, sessions: &Sessions) {
    let observed: [Row<Histogram>; 6] = [
        ("isophote_fit_seconds", "Time of a frame's fits.", |of| &of.fit_s),
        ("isophote_search_seconds", "Time of a frame's fits, in frames with a search.", |of| &of.search_s),
        ("isophote_frame_age_seconds", "Time from a frame's capture to its estimates.", |of| &of.age_s),
        ("isophote_fit_iterations", "Iterations of a tracked target's fit, all stages.", |of| &of.iterations),
        ("isophote_reduced_chi_square", "Reduced chi-square of tracked targets; 1 for noise alone.", |of| {
            &of.chi_square
        }),
        ("isophote_saturated_ratio", "Share of a tracked target's pixels that are saturated.", |of| &of.saturated),
    ];
    for (name, help, histogram) in observed {
        let mut family = all.histogram(name, help);
        for (session, one) in sessions {
            family.distribution(&[("session", session.as_str())], histogram(one.counters()));
        }
    }
}

/// Frames drawn for viewers.
fn of_previews(all: &mut Exposition, sessions: &Sessions) {
    let mut family = all.gauge("isophote_preview_viewers", "Viewers of a session's preview.");
    for (session, one) in sessions {
        family.sample(&[("session", session.as_str())], one.preview().viewers() as f64);
    }
    type Counted = (&'static str, &'static str, fn(&Preview) -> &Tally);
    let counted: [Counted; 2] = [
        ("isophote_preview_frames_total", "Preview frames rendered.", |of| &of.frames),
        ("isophote_preview_messages_total", "Preview messages encoded, each for any number of viewers.", |of| {
            &of.messages
        }),
    ];
    for (name, help, counter) in counted {
        let mut family = all.counter(name, help);
        for (session, one) in sessions {
            family.sample(&[("session", session.as_str())], counter(one.preview()).count() as f64);
        }
    }
}

fn of_subscribers(all: &mut Exposition, sessions: &Sessions) {
    let loads: Vec<_> = sessions.iter().map(|(name, session)| (name, session.hub().load())).collect();
    let mut family = all.gauge("isophote_subscribers", "Subscribers of estimates.");
    loads.iter().for_each(|(name, load)| family.sample(&[("session", name.as_str())], load.subscribers as f64));
    let mut family = all.gauge("isophote_ring_bytes", "Size of the estimates kept for subscribers in mode all.");
    loads.iter().for_each(|(name, load)| family.sample(&[("session", name.as_str())], load.ring_bytes as f64));
    let mut family = all.counter("isophote_subscriber_dropped_total", "Frames that subscribers missed.");
    loads.iter().for_each(|(name, load)| family.sample(&[("session", name.as_str())], load.dropped as f64));
}
