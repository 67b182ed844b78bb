//! Recordings are opened beside everything else.

use std::sync::Arc;

use isophote_symbolic::Model;
use isophote_wire::SourceDocument;

use crate::app::App;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::source::{self, Opened};

/// Opens a recording where its disk may take its time, and nobody else waits for it; its document then has the path by which it
/// is found again. Other sources open at once, by whoever puts them.
pub async fn opened_ahead(
    app: &App,
    document: &mut SourceDocument,
    prefix: &'static str,
    reader: Option<Arc<Model>>,
) -> Result<Option<Opened>, Problem> {
    let SourceDocument::Recording(recording) = document else { return Ok(None) };
    let reach = app.recordings.reach(prefix)?;
    let (sent, openings) = (recording.clone(), app.openings.clone());
    let seconds = LIMITS.open_time.as_secs();
    let busy = |_| Problem::late(format!("the recordings before this one were not opened within {seconds} s"));
    let place = tokio::time::timeout(LIMITS.open_time, openings.take(1)).await.map_err(busy)?;
    let open = move || {
        let _place = place;
        source::open_recording(&sent, prefix, reader.as_deref(), &reach)
    };
    let late = |_| Problem::late(format!("the recording was not opened within {seconds} s"));
    let opening = tokio::time::timeout(LIMITS.open_time, tokio::task::spawn_blocking(open));
    let opened = opening.await.map_err(late)?.map_err(|_| Problem::bug("opening the recording panicked"))?;
    let (address, opened) = opened?;
    recording.path = address;
    Ok(Some(opened))
}
