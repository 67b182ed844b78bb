//! `/v1/sessions/{name}/recording` and `/v1/recordings`

use axum::body::Body;
use axum::http::{HeaderMap, Method, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{Items, ProblemDocument, RecordDocument, RecordedFile, RecordingView};

use super::download::{sent, tag_of};
use super::paging::{PageQuery, RawPage, page};
use super::parameters::{FileParam, MatchHeaders, NameParam, RangeHeaders};
use super::{Answer, App, RawName, listed, raw, stateful, tagged};
use crate::http::documents::{place, read_json};
use crate::http::preconditions::Preconditions;
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::recording::{FolderFault, WantedFile};

/// Starts to record a session.
#[utoipa::path(put, path = "/v1/sessions/{name}/recording", tag = "sessions", operation_id = "put_recording", params(NameParam, MatchHeaders),
    request_body = RecordDocument,
    responses((status = 201, description = "The recording has started.", body = RecordingView),
              (status = 200, description = "A recording with this document is already in progress.", body = RecordingView)))]
pub async fn put(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap, body: Body) -> Answer {
    let session = app.service.session(&raw(name)?)?;
    let (document, text) = read_json::<RecordDocument>(&headers, body).await?;
    if app.service.is_draining() {
        return Err(Problem::stopping());
    }
    let folder = app.folder.clone();
    let begun = beside(move || session.record(&folder, document, &preconditions)).await;
    let begun = place(begun, &text).await?;
    let status = if begun.is_new { StatusCode::CREATED } else { StatusCode::OK };
    tagged(status, &begun.view, Some(&begun.tag))
}

/// Returns the recording of a session and its state.
#[utoipa::path(get, path = "/v1/sessions/{name}/recording", tag = "sessions", operation_id = "get_recording", params(NameParam, MatchHeaders),
    responses((status = 200, description = "Document and state of the recording.", body = RecordingView)))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let (tag, view) = app.service.session(&raw(name)?)?.recording()?;
    stateful(&preconditions, "the recording", Some(&tag), &view)
}

/// Ends the recording of a session; answers when its file is complete.
#[utoipa::path(delete, path = "/v1/sessions/{name}/recording", tag = "sessions", operation_id = "delete_recording", params(NameParam, MatchHeaders),
    responses((status = 204, description = "The recording has ended.")))]
pub async fn delete(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let recording = app.service.session(&raw(name)?)?.stop_recording(&preconditions)?;
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

/// Lists finished recordings by name.
#[utoipa::path(get, path = "/v1/recordings", tag = "sessions", operation_id = "list_recordings", params(PageQuery),
    responses((status = 200, description = "All recordings, or one page of them.", body = Items<RecordedFile>)))]
pub async fn list(app: App, query: RawPage, preconditions: Preconditions) -> Answer {
    let folder = app.folder.clone();
    let items = beside(move || match folder.list() {
        Err(FolderFault::None) => Ok(Vec::new()),
        files => files.map_err(FolderFault::problem),
    });
    listed(&preconditions, &page(query, items.await?, |recorded| recorded.file.as_str(), Clone::clone)?)
}

/// Returns a finished recording or the CSV file beside it; `Range` selects a part.
#[utoipa::path(get, path = "/v1/recordings/{file}", tag = "sessions", operation_id = "get_recorded_file",
    params(FileParam, MatchHeaders, RangeHeaders),
    responses((status = 200, description = "The file.", content((String = "application/octet-stream"), (String = "text/csv"))),
              (status = 206, description = "The requested part.", content((String = "application/octet-stream"), (String = "text/csv"))),
              (status = 304, description = "The file is unchanged."),
              (status = 416, description = "The file has no such part.", body = ProblemDocument, content_type = "application/problem+json")))]
pub async fn read(app: App, file: RawName, method: Method, preconditions: Preconditions, headers: HeaderMap) -> Answer {
    let wanted = wanted(file)?;
    let media = match &wanted {
        WantedFile::Recording(_) => "application/octet-stream",
        WantedFile::Table(_) => "text/csv; charset=utf-8",
    };
    let place = app.downloads.try_take(1);
    let over = || Problem::over_limit("recordings that are sent at a time", app.downloads.most());
    let place = place.ok_or_else(over)?;
    let folder = app.folder.clone();
    let opened = beside(move || folder.open(&wanted).map_err(FolderFault::problem)).await?;
    sent(opened, media, (&method, &headers, &preconditions), (place, app.stream.clone()))
}

/// Deletes a finished recording and the CSV file beside it, or the CSV file alone.
#[utoipa::path(delete, path = "/v1/recordings/{file}", tag = "sessions", operation_id = "delete_recorded_file",
    params(FileParam, MatchHeaders), responses((status = 204, description = "The file was deleted.")))]
pub async fn remove(app: App, file: RawName, preconditions: Preconditions) -> Answer {
    let (wanted, folder) = (wanted(file)?, app.folder.clone());
    let remove = move || {
        let about = folder.about(&wanted).map_err(FolderFault::problem)?;
        // A finished file does not change.
        preconditions.check("the file", &[tag_of(&about)])?;
        folder.remove(&wanted).map_err(FolderFault::problem)
    };
    beside(remove).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// The name of an existing file: 404 if it is malformed.
fn wanted(file: RawName) -> Result<WantedFile, Problem> {
    let file = raw(file)?;
    WantedFile::parse(&file).ok_or_else(|| Problem::unknown("recording", &file))
}

/// Runs work that waits for a disk on a blocking thread.
async fn beside<T: Send + 'static>(work: impl FnOnce() -> Result<T, Problem> + Send + 'static) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work).await.map_err(|_| Problem::bug("work on a recording panicked"))?
}
