//! `POST /v1/models/{name}:fit`: fits one image and keeps nothing.
//!
//! The estimates are those of a session for the first frame of a pushed source, by the same code. A few images are fitted at a
//! time, a few more wait, further ones are refused; their bytes count as those of pushed frames.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use axum::body::Body;
use axum::extract::Query;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use isophote_symbolic::Precision;
use isophote_tracker::Stop;
use isophote_wire::{
    EstimateView, Items, PushedDocument, PushedFormat, SessionDocument, SessionOptions, SourceDocument,
    SourceReference, WindowDocument,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use utoipa::{IntoParams, ToSchema};

use super::parameters::NameParam;
use super::{Answer, App, json};
use crate::http::documents::{parse, read_body};
use crate::http::streams::pushed::{FrameMedia, decode, raw_bytes};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::turns::FairWorkers;
use crate::service::workshop::Lane;
use crate::session::fit_once;
use crate::source;

/// Keys of a session's document as a query; absent ones have the defaults of such a document.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ImageFitQuery {
    /// Width of the image for raw pixels, px.
    width: Option<usize>,
    /// Height of the image for raw pixels, px.
    height: Option<usize>,
    /// Format of raw pixels.
    format: Option<PushedFormat>,
    /// Number of targets to find, each an instance of the model.
    targets: Option<usize>,
    /// Minimum confidence to accept one of several candidates as a target, 0 … 1.
    confidence_min: Option<f64>,
    /// Least signal-to-noise ratio of targets, 3 and above; confidence is then not asked.
    snr_min: Option<f64>,
    /// Least and greatest size of targets, px: `2,8`.
    sizes_px: Option<String>,
    /// Arithmetic of the pixel loops.
    precision: Option<Precision>,
    /// Starting values: `bx=320,by=240` or a JSON object.
    start: Option<String>,
    /// Constants of the model, in the format of `start`.
    constants: Option<String>,
    /// Pixels to fit: `x,y,width,height` or a JSON object; the whole image when absent.
    window: Option<String>,
    /// Properties of the camera: JSON, as in a session's document.
    camera: Option<String>,
    /// Geometry of the target: JSON, as in a session's document.
    target: Option<String>,
}

/// Fits a model to one image and stores nothing.
#[utoipa::path(post, path = "/v1/models/{name}:fit", tag = "models", operation_id = "fit_image",
    params(NameParam, ImageFitQuery),
    request_body(content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "application/octet-stream"))),
    responses((status = 200, description = "One estimate per target.", body = Items<EstimateView>)))]
pub async fn post(app: App, model: &str, uri: &Uri, headers: &HeaderMap, body: Body) -> Answer {
    let entry = app.service.registry.get(model)?;
    let query = Query::<ImageFitQuery>::try_from_uri(uri);
    let Query(query) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    let media = FrameMedia::of(headers)?;
    if media == FrameMedia::Image && query.is_raw() {
        let detail = "width, height and format are those of raw pixels (application/octet-stream); an image says itself what it is";
        return Err(Problem::bad_request(detail));
    }
    let document = query.document(model)?;
    let bytes_max = match (media, &document.source) {
        (FrameMedia::Raw, SourceReference::Own(source)) => raw_bytes_of(source)?,
        _ => LIMITS.frame_bytes,
    };
    let refuse = async |body, problem| {
        drop(read_body(body, 0).await); // discarded, so that the sender can read the answer
        Err(problem)
    };
    let Some(admitted) = app.images.admitted.try_take(1) else {
        return refuse(body, Problem::over_limit("images that are fitted or wait for it", app.images.admitted.most()))
            .await;
    };
    let length = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok());
    let room = match app.frames.room_now(length.unwrap_or(bytes_max).min(bytes_max)) {
        Ok(room) => room,
        Err(problem) => return refuse(body, problem).await,
    };
    let bytes = read_body(body, bytes_max).await?;
    // Derived in turn with other uploads; the fit then finds it done.
    let (deriving, precision) = (entry.clone(), document.options.precision);
    let derive = move |workers: &FairWorkers| deriving.kernels_by(precision, workers).map(drop);
    app.service.workshop.prepare(Lane::Uploads, derive).await?;
    let late = |_| Problem::late("the images before this one were not fitted in time");
    let turn = tokio::time::timeout(LIMITS.push_time, app.images.fitting.clone().take(1)).await;
    let turn = turn.map_err(late)?;
    let wanted = Wanted::default();
    let (service, is_unwanted) = (app.service.clone(), wanted.0.clone());
    let work = move || {
        let _held = (admitted, room, turn);
        let start = Instant::now();
        let watch = || {
            let is_over = is_unwanted.load(Ordering::Relaxed) || service.is_draining();
            let is_late = start.elapsed() > LIMITS.frame_time;
            if is_over { Some(Stop::Cancelled) } else { is_late.then_some(Stop::Budget) }
        };
        let items = fit(&entry, document, media, bytes, &watch)?;
        service.counters.image_fit_s.observe(start.elapsed().as_secs_f64());
        Ok(Items { items, next: None })
    };
    let fitted: Result<_, Problem> =
        tokio::task::spawn_blocking(work).await.map_err(|_| Problem::bug("fitting the image panicked"))?;
    drop(wanted);
    json(StatusCode::OK, &fitted?)
}

/// Cancels the fit when the request is dropped.
#[derive(Default)]
struct Wanted(Arc<AtomicBool>);

impl Drop for Wanted {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn fit(
    entry: &ModelEntry,
    mut document: SessionDocument,
    media: FrameMedia,
    bytes: Vec<u8>,
    watch: &dyn isophote_tracker::Watch,
) -> Result<Vec<EstimateView>, Problem> {
    let mut pushed = pushed(&document)?;
    if media == FrameMedia::Image {
        // The size of an image is read before it is decoded.
        let size = isophote_capture::decode::size(&bytes);
        let [width, height] = size.map_err(|error| Problem::wrong_key("wrong-frame", "", error.to_string()))?;
        pushed = PushedDocument { width, height, ..pushed };
    }
    let source = SourceDocument::Pushed(pushed.clone());
    source::open(&source, "", |model| Err(Problem::unknown("model", model)))?; // checks its size
    let frame = decode(&pushed, media, bytes)?;
    document.source = SourceReference::Own(Box::new(source));
    fit_once(entry, &document, &frame, watch)
}

fn pushed(document: &SessionDocument) -> Result<PushedDocument, Problem> {
    match &document.source {
        SourceReference::Own(source) => match &**source {
            SourceDocument::Pushed(pushed) => Ok(pushed.clone()),
            _ => Err(Problem::bug("an image comes from a pushed source")),
        },
        SourceReference::Named(_) => Err(Problem::bug("an image has a source of its own")),
    }
}

fn raw_bytes_of(source: &SourceDocument) -> Result<usize, Problem> {
    match source {
        SourceDocument::Pushed(pushed) if pushed.width > 0 && pushed.height > 0 => {
            source::open(source, "", |model| Err(Problem::unknown("model", model)))?;
            Ok(raw_bytes(pushed))
        }
        _ => Err(Problem::bad_request("raw pixels need width and height in the query, at least 1 each")),
    }
}

impl ImageFitQuery {
    /// Whether it describes raw pixels.
    fn is_raw(&self) -> bool {
        self.width.is_some() || self.height.is_some() || self.format.is_some()
    }

    /// The document of a session that would fit the image; the size of an image file is filled in later.
    fn document(&self, model: &str) -> Result<SessionDocument, Problem> {
        let usual = SessionOptions::default();
        let options = SessionOptions {
            precision: self.precision.unwrap_or(usual.precision),
            targets: self.targets.unwrap_or(usual.targets),
            confidence_min: self.confidence_min.unwrap_or(usual.confidence_min),
            snr_min: self.snr_min,
            sizes_px: self.sizes_px.as_deref().map(sizes).transpose()?,
            ..usual
        };
        let source = SourceDocument::Pushed(PushedDocument {
            width: self.width.unwrap_or(0),
            height: self.height.unwrap_or(0),
            format: self.format.unwrap_or_default(),
        });
        Ok(SessionDocument {
            source: SourceReference::Own(Box::new(source)),
            model: model.to_string(),
            constants: numbers("constants", self.constants.as_deref())?,
            start: numbers("start", self.start.as_deref())?,
            window: self.window.as_deref().map(window).transpose()?,
            camera: self.camera.as_deref().map(|text| within("camera", text)).transpose()?.unwrap_or_default(),
            target: self.target.as_deref().map(|text| within("target", text)).transpose()?,
            options,
        })
    }
}

/// Parses the JSON of a part of a document.
fn within<T: DeserializeOwned + ToSchema>(part: &str, text: &str) -> Result<T, Problem> {
    parse(text).map_err(|mut problem| {
        for diagnostic in &mut problem.diagnostics {
            diagnostic.key = format!("{part}.{}", diagnostic.key).trim_end_matches('.').to_string();
        }
        problem
    })
}

fn numbers(part: &str, text: Option<&str>) -> Result<BTreeMap<String, f64>, Problem> {
    let text = text.unwrap_or_default().trim();
    if text.starts_with('{') {
        return within(part, text);
    }
    let wrong = |pair: &str| Problem::wrong_key("wrong-value", part, format!("`{pair}` is not name=number"));
    let pair = |pair: &str| -> Result<(String, f64), Problem> {
        let (name, value) = pair.split_once('=').ok_or_else(|| wrong(pair))?;
        let number: f64 = value.trim().parse().map_err(|_| wrong(pair))?;
        Ok((name.trim().to_string(), number))
    };
    let mut numbers = BTreeMap::new();
    for (name, number) in
        text.split(',').filter(|pair| !pair.trim().is_empty()).map(pair).collect::<Result<Vec<_>, _>>()?
    {
        if numbers.insert(name.clone(), number).is_some() {
            return Err(Problem::wrong_key("wrong-value", part, format!("`{name}` is given twice")));
        }
    }
    Ok(numbers)
}

fn sizes(text: &str) -> Result<[f64; 2], Problem> {
    let both =
        text.split_once(',').and_then(|(least, most)| Some([least.trim().parse().ok()?, most.trim().parse().ok()?]));
    both.ok_or_else(|| Problem::wrong_key("wrong-value", "options.sizes_px", "two numbers: least,greatest"))
}

fn window(text: &str) -> Result<WindowDocument, Problem> {
    if text.trim().starts_with('{') {
        return within("window", text);
    }
    let wrong = || Problem::wrong_key("wrong-value", "window", "a window is x,y,width,height, whole numbers of pixels");
    let sides: Vec<usize> =
        text.split(',').map(|side| side.trim().parse()).collect::<Result<_, _>>().map_err(|_| wrong())?;
    let [x, y, width, height] = sides[..] else { return Err(wrong()) };
    Ok(WindowDocument { x, y, width, height, z: None, depth: None, w: None, length: None })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn query(text: &str) -> Result<SessionDocument, Problem> {
        let uri: Uri = format!("/v1/models/spot:fit?{text}").parse().unwrap();
        let query = Query::<ImageFitQuery>::try_from_uri(&uri);
        query.map_err(|error| Problem::bad_request(error.body_text()))?.0.document("spot")
    }

    #[test]
    fn a_query_is_a_sessions_document() {
        let short = query("start=bx=320,by=240.5&window=1,2,30,40&targets=3&precision=f64").unwrap();
        let long = query(
            "start=%7B%22bx%22:320,%22by%22:240.5%7D&window=%7B%22x%22:1,%22y%22:2,%22width%22:30,%22height%22:40%7D\
                          &targets=3&precision=f64",
        );
        assert_eq!(short, long.unwrap());
        assert_eq!((short.start["by"], short.options.targets), (240.5, 3));
        let camera = query("camera=%7B%22saturation%22:253%7D").unwrap().camera;
        assert_eq!(camera.saturation, Some(253.0));
    }

    #[test]
    fn faults_name_their_part() {
        let key = |text: &str| query(text).unwrap_err().diagnostics[0].key.clone();
        assert_eq!(key("start=bx"), "start");
        assert_eq!(key("start=bx=1,bx=2"), "start");
        assert_eq!(key("constants=gain=one"), "constants");
        assert_eq!(key("window=1,2,3"), "window");
        assert_eq!(key("camera=%7B%22saturatoin%22:253%7D"), "camera.saturatoin");
        assert_eq!(query("colour=red").unwrap_err().code, "bad-request");
        assert_eq!(query("format=rgb").unwrap_err().code, "bad-request");
    }
}
