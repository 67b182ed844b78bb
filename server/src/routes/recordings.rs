//! `/v1/sessions/{name}/recording` and `/v1/recordings`

use std::io::Read;

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::IntoResponse;
use futures_util::stream;
use isophote_wire::{Items, RecordDocument, RecordedFile, RecordingView};
use tokio::sync::mpsc;

use super::paging::{PageQuery, RawPage, page};
use super::parameters::{FileParam, NameParam};
use super::{Answer, App, RawName, json, raw};
use crate::documents::{place, read_json};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::recording::{FileName, FolderFault};

/// Pieces of a file that are read ahead of the client.
const PIECES: usize = 4;

/// Begins to record a session.
#[utoipa::path(put, path = "/v1/sessions/{name}/recording", tag = "sessions", operation_id = "put_recording", params(NameParam),
    request_body = RecordDocument,
    responses((status = 201, description = "It has begun.", body = RecordingView)))]
pub async fn put(app: App, name: RawName, headers: HeaderMap, body: Body) -> Answer {
    let session = app.service.session(&raw(name)?)?;
    let (document, text) = read_json::<RecordDocument>(&headers, body).await?;
    if app.service.is_draining() {
        return Err(Problem::stopping());
    }
    let folder = app.folder.clone();
    let begun = beside(move || session.record(&folder, document)).await;
    json(StatusCode::CREATED, &begun.map_err(|problem| place(problem, &text))?)
}

/// What the recording of a session does.
#[utoipa::path(get, path = "/v1/sessions/{name}/recording", tag = "sessions", operation_id = "get_recording", params(NameParam),
    responses((status = 200, description = "Its document with its state.", body = RecordingView)))]
pub async fn get(app: App, name: RawName) -> Answer {
    json(StatusCode::OK, &app.service.session(&raw(name)?)?.recording()?)
}

/// Ends the recording of a session; answers when its file has its end.
#[utoipa::path(delete, path = "/v1/sessions/{name}/recording", tag = "sessions", operation_id = "delete_recording", params(NameParam),
    responses((status = 204, description = "It has ended.")))]
pub async fn delete(app: App, name: RawName) -> Answer {
    let recording = app.service.session(&raw(name)?)?.stop_recording()?;
    beside(move || {
        recording.wait(std::time::Instant::now() + LIMITS.recording_end_time);
        match recording.is_running() {
            true => Err(Problem::late("the disk is slow: the file of the recording gets its end later")),
            false => Ok(()),
        }
    })
    .await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Recordings that are finished, by name.
#[utoipa::path(get, path = "/v1/recordings", tag = "sessions", operation_id = "list_recordings", params(PageQuery),
    responses((status = 200, description = "All of them, or a piece.", body = Items<RecordedFile>)))]
pub async fn list(app: App, query: RawPage) -> Answer {
    let folder = app.folder.clone();
    let items = beside(move || match folder.list() {
        Err(FolderFault::None) => Ok(Vec::new()),
        files => files.map_err(FolderFault::problem),
    });
    json(StatusCode::OK, &page(query, items.await?, |recorded| recorded.file.as_str(), Clone::clone)?)
}

/// A finished recording.
#[utoipa::path(get, path = "/v1/recordings/{file}", tag = "sessions", operation_id = "get_recorded_file", params(FileParam),
    responses((status = 200, description = "The file.", body = String, content_type = "application/octet-stream")))]
pub async fn read(app: App, file: RawName) -> Answer {
    let name = file_name(file)?;
    let place = app.downloads.try_take(1);
    let over = || Problem::over_limit("recordings that are sent at a time", app.downloads.most());
    let place = place.ok_or_else(over)?;
    let folder = app.folder.clone();
    let (mut file, bytes) = beside(move || folder.open(&name).map_err(FolderFault::problem)).await?;
    let (pieces, sent) = mpsc::channel::<std::io::Result<Bytes>>(PIECES);
    let held = app.stream.clone();
    let read = move || {
        let _held = (place, held);
        let mut left = bytes;
        while left > 0 {
            let mut piece = vec![0; LIMITS.download_bytes.min(left as usize)];
            let read = file.read_exact(&mut piece).map(|()| piece.into());
            left = if read.is_ok() { left - LIMITS.download_bytes.min(left as usize) as u64 } else { 0 };
            if pieces.blocking_send(read).is_err() {
                return; // the client has gone
            }
        }
    };
    tokio::task::spawn_blocking(read);
    let stream = stream::unfold(sent, async |mut sent| sent.recv().await.map(|piece| (piece, sent)));
    let mut response = Body::from_stream(stream).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    response.headers_mut().insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    Ok(response)
}

/// Deletes a finished recording.
#[utoipa::path(delete, path = "/v1/recordings/{file}", tag = "sessions", operation_id = "delete_recorded_file", params(FileParam),
    responses((status = 204, description = "It is gone.")))]
pub async fn remove(app: App, file: RawName) -> Answer {
    let (name, folder) = (file_name(file)?, app.folder.clone());
    beside(move || folder.remove(&name).map_err(FolderFault::problem)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// The name of a file that should exist: 404 when it cannot.
fn file_name(file: RawName) -> Result<FileName, Problem> {
    let file = raw(file)?;
    FileName::parse(&file).ok_or_else(|| Problem::unknown("recording", &file))
}

/// What waits for a disk.
async fn beside<T: Send + 'static>(work: impl FnOnce() -> Result<T, Problem> + Send + 'static) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work).await.map_err(|_| Problem::bug("work on a recording panicked"))?
}
