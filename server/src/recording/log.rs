//! `SessionLog`: one file of a recording; writes frames, fits, swaps, snapshots and camera settings to its channels.

use std::fs::File;
use std::io::Error;
use std::sync::Arc;

use isophote_capture::record::{
    BodyPose, DrawnLine, LogChannel, LogSchema, LogWriter, Stamped, camera_calibration, compressed_image,
    image_annotations, jpeg, odometry, raw_image,
};
use isophote_symbolic::Model;
use isophote_tracker::{Frame, Snapshot, TrackState, contours};
use isophote_wire::{CameraStatus, EstimateView, LoggedFit, LoggedSession, LoggedSnapshot, LoggedSwap, RecordedFrames};
use serde::Serialize;

/// Number of points on an outline.
const OUTLINE_POINTS: usize = 48;
/// Half the length of a centre's cross, px.
const ARM_PX: f64 = 4.0;
const OUTLINE: [f64; 3] = [1.0, 0.6, 0.0];
const CENTRE: [f64; 3] = [0.0, 0.85, 1.0];

/// Why a recording cannot go on.
#[derive(Debug)]
pub enum LogFault {
    /// The disk failed.
    Disk(Error),
    /// Frames cannot be recorded in the requested format.
    Frames(String),
}

impl From<Error> for LogFault {
    fn from(error: Error) -> LogFault {
        LogFault::Disk(error)
    }
}

/// An open file.
pub struct SessionLog {
    writer: LogWriter,
    session: LoggedSession,
    channels: Channels,
    /// Frame size in pixels, which the lens does not include.
    size: Option<[usize; 2]>,
}

struct Channels {
    image: Option<LogChannel>,
    calibration: LogChannel,
    annotations: LogChannel,
    odometry: LogChannel,
    session: LogChannel,
    swap: LogChannel,
    snapshot: LogChannel,
    fit: LogChannel,
    estimate: LogChannel,
    camera: LogChannel,
}

impl SessionLog {
    /// Begins an empty file with the session message.
    pub fn begin(file: File, session: &LoggedSession, unix_ns: u64) -> Result<SessionLog, Error> {
        let mut writer = LogWriter::begin(file, concat!("isophote ", env!("CARGO_PKG_VERSION")))?;
        let name = session.session.clone();
        let image = match session.frames {
            RecordedFrames::Raw => Some("foxglove.RawImage"),
            RecordedFrames::Jpeg => Some("foxglove.CompressedImage"),
            RecordedFrames::None => None,
        };
        let mut channel = |topic: &str, schema| writer.channel(&format!("/{name}/{topic}"), schema);
        let channels = Channels {
            image: image.map(|schema| channel("image", LogSchema::Foxglove(schema))).transpose()?,
            calibration: channel("calibration", LogSchema::Foxglove("foxglove.CameraCalibration"))?,
            annotations: channel("annotations", LogSchema::Foxglove("foxglove.ImageAnnotations"))?,
            odometry: channel("odometry", LogSchema::Foxglove("foxglove.Odometry"))?,
            session: channel("session", LogSchema::Json("isophote.Session"))?,
            swap: channel("swap", LogSchema::Json("isophote.Swap"))?,
            snapshot: channel("snapshot", LogSchema::Json("isophote.Snapshot"))?,
            fit: channel("fit", LogSchema::Json("isophote.Fit"))?,
            estimate: channel("estimate", LogSchema::Json("isophote.Estimate"))?,
            camera: channel("camera", LogSchema::Json("isophote.Camera"))?,
        };
        let mut log = SessionLog { writer, session: session.clone(), channels, size: None };
        log.json(log.channels.session, unix_ns, session)?;
        Ok(log)
    }

    fn json(&mut self, channel: LogChannel, unix_ns: u64, value: &impl Serialize) -> Result<(), Error> {
        let text = serde_json::to_vec(value)?;
        self.writer.write(channel, unix_ns, &text)
    }

    /// Writes a frame's pixels.
    pub fn frame(&mut self, unix_ns: u64, frame: &Frame) -> Result<(), LogFault> {
        let Some(channel) = self.channels.image else { return Ok(()) };
        let name = self.session.session.clone();
        let at = Stamped { unix_ns, frame_id: &name };
        let refused = |reason: &dyn std::fmt::Display| LogFault::Frames(reason.to_string());
        let payload = match self.session.frames {
            RecordedFrames::Jpeg => compressed_image(at, "jpeg", &jpeg(frame).map_err(|reason| refused(&reason))?),
            _ => raw_image(at, frame).map_err(|reason| refused(&reason))?,
        };
        if self.size.is_none() {
            self.size = Some([frame.width(), frame.rows()]);
            self.calibration(unix_ns)?;
        }
        Ok(self.writer.write(channel, unix_ns, &payload)?)
    }

    /// Writes the lens, if the session's document has one.
    fn calibration(&mut self, unix_ns: u64) -> Result<(), Error> {
        let (Some(lens), Some(size)) = (self.session.document.camera.intrinsics.as_ref(), self.size) else {
            return Ok(());
        };
        let model = match serde_json::to_value(lens.model)?.as_str() {
            Some("rational") => "rational_polynomial",
            Some("fisheye") => "kannala_brandt",
            _ => "plumb_bob",
        };
        let at = Stamped { unix_ns, frame_id: &self.session.session };
        let matrix = [lens.fx, lens.fy, lens.cx, lens.cy];
        let message = camera_calibration(at, size, (model, &lens.coefficients), matrix);
        self.writer.write(self.channels.calibration, unix_ns, &message)
    }

    /// Writes a swap; attaches the model's document as a file.
    pub fn swap(&mut self, unix_ns: u64, swap: &LoggedSwap) -> Result<(), Error> {
        let extension = if swap.media == "application/toml" { "toml" } else { "json" };
        self.writer.attach(&format!("{}.{extension}", swap.name), &swap.media, unix_ns, swap.text.as_bytes())?;
        self.json(self.channels.swap, unix_ns, swap)
    }

    /// Writes the tracker's snapshot before the next frame.
    pub fn snapshot(&mut self, unix_ns: u64, fits: u64, snapshot: &Snapshot) -> Result<(), Error> {
        let snapshot = serde_json::to_value(snapshot)?;
        self.calibration(unix_ns)?;
        self.json(self.channels.snapshot, unix_ns, &LoggedSnapshot { fits, snapshot })
    }

    /// Writes the camera's settings.
    pub fn camera(&mut self, unix_ns: u64, camera: &CameraStatus) -> Result<(), Error> {
        self.json(self.channels.camera, unix_ns, camera)
    }

    /// Writes a fitted frame with its estimates.
    pub fn fit(
        &mut self,
        unix_ns: u64,
        fit: &LoggedFit,
        estimates: &[Arc<EstimateView>],
        model: &Model,
    ) -> Result<(), Error> {
        self.json(self.channels.fit, unix_ns, fit)?;
        let mut lines = Vec::new();
        for estimate in estimates {
            self.json(self.channels.estimate, unix_ns, &**estimate)?;
            lines.extend(drawn(model, estimate));
            if let Some(pose) = &estimate.pose {
                let body = format!("{}/{}", self.session.session, estimate.target);
                let at = Stamped { unix_ns, frame_id: &self.session.session };
                let pose = BodyPose {
                    body: &body,
                    position_mm: pose.position_mm,
                    orientation_xyzw: pose.orientation_xyzw,
                    covariance: pose.covariance.as_deref(),
                };
                self.writer.write(self.channels.odometry, unix_ns, &odometry(at, &pose))?;
            }
        }
        // Written even without lines, to clear those of the previous frame.
        self.writer.write(self.channels.annotations, unix_ns, &image_annotations(unix_ns, &lines))
    }

    /// Bytes buffered in the current chunk.
    pub fn waiting_bytes(&self) -> u64 {
        self.writer.waiting_bytes()
    }

    /// Upper bound of the bytes written at the file's end.
    pub fn end_bytes(&self) -> u64 {
        self.writer.end_bytes()
    }

    /// Ends the chunk; returns the file's bytes.
    pub fn flush(&mut self) -> Result<u64, Error> {
        self.writer.flush()
    }

    /// Waits for the disk.
    pub fn sync(&self) -> Result<(), Error> {
        self.writer.sync()
    }

    /// Ends the file; returns its bytes.
    pub fn finish(self) -> Result<u64, Error> {
        self.writer.finish()
    }
}

/// Outlines and centres of tracked targets.
fn drawn(model: &Model, estimate: &EstimateView) -> Vec<DrawnLine> {
    if !matches!(estimate.state, TrackState::Tracking | TrackState::Coasting) {
        return Vec::new();
    }
    let value = |name: &str| estimate.parameters.get(name).unwrap_or(f64::NAN);
    let parameters: Vec<f64> = model.parameters().iter().map(|parameter| value(&parameter.name)).collect();
    let lines = contours(model, &parameters).into_iter().flat_map(|contour| {
        let [x, y] = contour.centre;
        let line = |points: Vec<[f64; 2]>| DrawnLine { points, is_closed: false, colour: CENTRE };
        let outline = DrawnLine { points: contour.outline(OUTLINE_POINTS), is_closed: true, colour: OUTLINE };
        [outline, line(vec![[x - ARM_PX, y], [x + ARM_PX, y]]), line(vec![[x, y - ARM_PX], [x, y + ARM_PX]])]
    });
    let is_finite = |line: &DrawnLine| !line.points.is_empty() && line.points.iter().flatten().all(|at| at.is_finite());
    lines.filter(is_finite).collect()
}
