//! Session data as Foxglove messages: pictures, lens, outlines, poses. Lengths are in metres, times since 1970.

use isophote_frame::Frame;
use isophote_jit::PixelFormat;

use super::protobuf::ProtobufMessage;

/// Time and reference frame of a message.
#[derive(Clone, Copy, Debug)]
pub struct Stamped<'a> {
    /// ns since 1970.
    pub unix_ns: u64,
    /// The frame of reference.
    pub frame_id: &'a str,
}

/// A polyline over a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnLine {
    /// px; pixel centres are at integers.
    pub points: Vec<[f64; 2]>,
    /// Whether the last point joins the first.
    pub is_closed: bool,
    /// Red, green, blue, 0 … 1.
    pub colour: [f64; 3],
}

/// Pose of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyPose<'a> {
    /// Name of the body.
    pub body: &'a str,
    /// mm
    pub position_mm: [f64; 3],
    /// A unit quaternion.
    pub orientation_xyzw: [f64; 4],
    /// 6 × 6, row by row: position, then a small rotation; mm², mm rad, rad².
    pub covariance: Option<&'a [f64]>,
}

/// Why a frame cannot be recorded as a picture.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "frames of {0} cannot be recorded as pictures: they need two dimensions, and one plane of 8 or 16 bits or 32-bit fractions, \
     or three of 8 or 16 bits; record them with \"frames\": \"none\""
)]
pub struct NoPicture(String);

fn stamp(unix_ns: u64) -> ProtobufMessage {
    ProtobufMessage::default().number(1, unix_ns / 1_000_000_000).number(2, unix_ns % 1_000_000_000)
}

/// Foxglove's name of a frame's pixel format.
fn encoding(frame: &Frame) -> Result<&'static str, NoPicture> {
    let format = frame.planes()[0].format;
    let is_even = frame.planes().iter().all(|plane| plane.format == format);
    let known = match (format, frame.planes().len()) {
        (PixelFormat::U8, 1) => Some("mono8"),
        (PixelFormat::U16, 1) => Some("mono16"),
        (PixelFormat::F32, 1) => Some("32FC1"),
        (PixelFormat::U8, 3) => Some("rgb8"),
        (PixelFormat::U16, 3) => Some("rgb16"),
        _ => None,
    };
    known.filter(|_| is_even && frame.size().len() == 2 && frame.names().is_none()).ok_or_else(|| {
        let size: Vec<String> = frame.size().iter().map(usize::to_string).collect();
        NoPicture(format!("{} px in {} planes of {format:?}", size.join("×"), frame.planes().len()))
    })
}

/// `foxglove.RawImage` with unchanged pixels.
///
/// # Errors
/// The frame is not a picture of one plane or three.
pub fn raw_image(at: Stamped, frame: &Frame) -> Result<Vec<u8>, NoPicture> {
    let encoding = encoding(frame)?;
    let (width, height, planes) = (frame.width(), frame.rows(), frame.planes());
    let pixel = planes[0].format.bytes_per_pixel();
    let step = width * pixel * planes.len();
    let message =
        ProtobufMessage::with_capacity(step * height + 128).message(1, stamp(at.unix_ns)).text(7, at.frame_id);
    let message = message.fixed32(2, width as u32).fixed32(3, height as u32).text(4, encoding).fixed32(5, step as u32);
    Ok(message.counted(6, step * height, |bytes| append_pixels(bytes, frame)).finish())
}

/// Appends tightly packed rows of interleaved pixels.
pub(super) fn append_pixels(bytes: &mut Vec<u8>, frame: &Frame) {
    let (width, planes) = (frame.width(), frame.planes());
    let pixel = planes[0].format.bytes_per_pixel();
    for y in 0..frame.rows() {
        let [first, ..] = planes else { return };
        let row = first.offset + y * first.row_stride;
        // Planes that are already interleaved in one buffer are copied row by row.
        let is_together = planes.iter().enumerate().all(|(number, plane)| {
            plane.offset == first.offset + number * pixel
                && plane.row_stride == first.row_stride
                && plane.pixel_stride == planes.len() * pixel
                && plane.buffer.bytes().as_ptr() == first.buffer.bytes().as_ptr()
        });
        if is_together {
            bytes.extend_from_slice(&first.buffer.bytes()[row..][..width * pixel * planes.len()]);
            continue;
        }
        for (x, plane) in (0..width).flat_map(|x| planes.iter().map(move |plane| (x, plane))) {
            let at = plane.offset + y * plane.row_stride + x * plane.pixel_stride;
            bytes.extend_from_slice(&plane.buffer.bytes()[at..][..pixel]);
        }
    }
}

/// `foxglove.CompressedImage`
pub fn compressed_image(at: Stamped, format: &str, bytes: &[u8]) -> Vec<u8> {
    let message = ProtobufMessage::with_capacity(bytes.len() + 64).message(1, stamp(at.unix_ns)).text(4, at.frame_id);
    message.bytes(2, bytes).text(3, format).finish()
}

/// `foxglove.CameraCalibration` with ROS conventions. `matrix`: fx, fy, cx, cy.
pub fn camera_calibration(
    at: Stamped,
    size: [usize; 2],
    (model, coefficients): (&str, &[f64]),
    matrix: [f64; 4],
) -> Vec<u8> {
    let [fx, fy, cx, cy] = matrix;
    let message = ProtobufMessage::default().message(1, stamp(at.unix_ns)).text(9, at.frame_id);
    let message = message.fixed32(2, size[0] as u32).fixed32(3, size[1] as u32);
    let message = message.text(4, model).doubles(5, coefficients);
    let message = message.doubles(6, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    let message = message.doubles(7, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    message.doubles(8, &[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]).finish()
}

/// `foxglove.ImageAnnotations`
pub fn image_annotations(unix_ns: u64, lines: &[DrawnLine]) -> Vec<u8> {
    let line = |line: &DrawnLine| {
        let message =
            ProtobufMessage::default().message(1, stamp(unix_ns)).number(2, if line.is_closed { 2 } else { 3 });
        let message = line.points.iter().fold(message, |message, [x, y]| {
            message.message(3, ProtobufMessage::default().double(1, *x).double(2, *y))
        });
        let [r, g, b] = line.colour;
        let colour = ProtobufMessage::default().double(1, r).double(2, g).double(3, b).double(4, 1.0);
        message.message(4, colour).double(7, 1.5)
    };
    lines.iter().fold(ProtobufMessage::default(), |all, one| all.message(2, line(one))).finish()
}

/// `foxglove.Odometry`: position in metres, covariance in ROS order (x, y, z, rotations about x, y, z) in m², m rad, rad²;
/// an unknown covariance is zero.
pub fn odometry(at: Stamped, pose: &BodyPose) -> Vec<u8> {
    let [x, y, z] = pose.position_mm.map(|mm| mm * 1e-3);
    let position = ProtobufMessage::default().double(1, x).double(2, y).double(3, z);
    let [x, y, z, w] = pose.orientation_xyzw;
    let orientation = ProtobufMessage::default().double(1, x).double(2, y).double(3, z).double(4, w);
    let unit = |axis: usize| if axis < 3 { 1e-3 } else { 1.0 };
    let known = pose.covariance.filter(|covariance| covariance.len() == 36);
    let covariance: [f64; 36] =
        std::array::from_fn(|i| known.map_or(0.0, |covariance| covariance[i] * unit(i / 6) * unit(i % 6)));
    let message = ProtobufMessage::default().message(1, stamp(at.unix_ns)).text(2, at.frame_id).text(3, pose.body);
    let pose = ProtobufMessage::default().message(1, position).message(2, orientation);
    message.message(4, pose).doubles(7, &covariance).finish()
}
