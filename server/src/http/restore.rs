//! Restores declared sources and sessions after a start, one after the other on the compile thread. Recordings and cameras are
//! opened before, concurrently, so that a disk or driver that hangs delays only what needs it.

use std::time::Instant;

use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::http::app::App;
use crate::http::openings::opened_ahead;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::service::Service;
use crate::service::compiler::Owner;
use crate::source::Taker;

/// Restores sources, then sessions. Then waits until this start no longer counts as one that died early. The service does not
/// stop before this has ended, so that the next one finds the folder unlocked.
pub async fn restore(app: App, mut stopped: watch::Receiver<bool>) {
    let since = Instant::now();
    tokio::select! {
        () = restore_all(&app) => {}
        _ = stopped.wait_for(|stopped| *stopped) => return,
    }
    tokio::select! {
        () = tokio::time::sleep(LIMITS.start_time.saturating_sub(since.elapsed())) => {}
        _ = stopped.wait_for(|stopped| *stopped) => return,
    }
    // An error means that the service stops, which is in order.
    change(&app, |service, _| service.lived()).await.ok();
}

async fn restore_all(app: &App) {
    let service = &app.service;
    let mut sources = JoinSet::new();
    for (name, (mut document, reader)) in service.awaited_sources() {
        let app = app.clone();
        let taker = Taker::Source(name.clone());
        sources.spawn(async move { (name, opened_ahead(&app, &mut document, &taker, reader).await) });
    }
    while let Some(Ok((name, opened))) = sources.join_next().await {
        let source = name.clone();
        let started = change(app, move |service, owner| service.restore_source(owner, &source, opened)).await;
        // Fails only when the service stops.
        started.unwrap_or_else(|problem| service.source_failed(&name, problem));
    }
    let mut sessions = JoinSet::new();
    for (name, source) in service.awaited_sessions() {
        let app = app.clone();
        let taker = Taker::Session(name.clone());
        sessions.spawn(async move {
            match source {
                Some((mut document, reader)) => (name, opened_ahead(&app, &mut document, &taker, reader).await),
                None => (name, Ok(None)),
            }
        });
    }
    while let Some(Ok((name, opened))) = sessions.join_next().await {
        let session = name.clone();
        let started = change(app, move |service, owner| service.restore_session(owner, &session, opened)).await;
        started.unwrap_or_else(|problem| service.session_failed(&name, problem));
    }
}

/// Runs `work` on the compile thread, in its turn after earlier jobs of clients.
async fn change(app: &App, work: impl FnOnce(&Service, &mut Owner) + Send + 'static) -> Result<(), Problem> {
    let service = app.service.clone();
    let work = move |owner: &mut Owner| {
        work(&service, owner);
        Ok(())
    };
    app.service.compiler.run_in_turn(work).await
}
