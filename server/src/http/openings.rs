//! Opens recordings and cameras off the compile thread.

use std::sync::Arc;

use isophote_symbolic::Model;
use isophote_wire::{CameraDocument, RecordingDocument, SourceDocument};

use crate::http::app::App;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::source::{self, Opened, Taker};

/// Opens a recording or a camera on a blocking thread, so that a slow disk or driver delays nobody else; sets a recording's
/// path to the address by which it is found again. Other sources open quickly, when they are put.
pub async fn opened_ahead(
    app: &App,
    document: &mut SourceDocument,
    taker: &Taker,
    reader: Option<Arc<Model>>,
) -> Result<Option<Opened>, Problem> {
    match document {
        SourceDocument::Recording(recording) => opened_recording(app, recording, taker, reader).await.map(Some),
        SourceDocument::Camera(camera) => opened_camera(app, camera, taker).await.map(Some),
        SourceDocument::Synthetic(_) | SourceDocument::Pushed(_) => Ok(None),
    }
}

async fn opened_recording(
    app: &App,
    recording: &mut RecordingDocument,
    taker: &Taker,
    reader: Option<Arc<Model>>,
) -> Result<Opened, Problem> {
    let prefix = taker.prefix();
    let (sent, openings) = (recording.clone(), app.openings.clone());
    let (recordings, folder) = (app.recordings.clone(), app.folder.clone());
    let seconds = LIMITS.open_time.as_secs();
    let busy = |_| Problem::late(format!("the recordings before this one were not opened within {seconds} s"));
    let place = tokio::time::timeout(LIMITS.open_time, openings.take(1)).await.map_err(busy)?;
    let open = move || {
        let _place = place;
        // The tenant's own recording by its listed name, else a path within reach.
        let reach = folder.reach(&sent.path).map_or_else(|| recordings.reach(prefix), Ok)?;
        source::open_recording(&sent, prefix, reader.as_deref(), &reach)
    };
    let late = |_| Problem::late(format!("the recording was not opened within {seconds} s"));
    let opening = tokio::time::timeout(LIMITS.open_time, tokio::task::spawn_blocking(open));
    let opened = opening.await.map_err(late)?.map_err(|_| Problem::bug("opening the recording panicked"))?;
    let (address, opened) = opened?;
    recording.path = address;
    Ok(opened)
}

/// A camera has one reader: the source to be replaced releases it first, and gets it back if opening fails.
async fn opened_camera(app: &App, camera: &CameraDocument, taker: &Taker) -> Result<Opened, Problem> {
    let (service, camera, taker) = (app.service.clone(), camera.clone(), taker.clone());
    let open = move || {
        let held = service.let_go(&taker)?;
        let opened = source::open_camera(&camera, taker.prefix(), &service.machine.drivers)?;
        Ok(Opened { held, ..opened })
    };
    tokio::task::spawn_blocking(open).await.map_err(|_| Problem::bug("opening the camera panicked"))?
}
