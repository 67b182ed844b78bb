//! Pushed frames: decodes the bytes of a client's frame and returns the estimate of that frame.

use std::sync::Arc;

use axum::http::{HeaderMap, StatusCode};
use isophote_capture::Captured;
use isophote_capture::decode::{is_jpeg, is_png};
use isophote_tracker::{Frame, Plane};
use isophote_wire::{EstimateView, PushedDocument, SourceDocument};
use tokio::sync::oneshot;
use tokio::time::Instant;

use crate::http::documents::media_type;
use crate::limits::LIMITS;
use crate::net::gate::MessageGate;
use crate::net::quota::{QuotaPermit, SharedQuota};
use crate::problem::Problem;
use crate::session::Session;
use crate::session::inbox::{Inbox, Reply};
use crate::source::{Source, pixel_format};

/// Encoding of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameMedia {
    /// Pixels in the source's format, rows without padding.
    Raw,
    /// A PNG or JPEG file.
    Image,
}

impl FrameMedia {
    /// The encoding of a body, from `Content-Type`.
    ///
    /// # Errors
    /// 415 for other types.
    pub fn of(headers: &HeaderMap) -> Result<FrameMedia, Problem> {
        match media_type(headers).as_str() {
            "application/octet-stream" => Ok(FrameMedia::Raw),
            "image/png" | "image/jpeg" => Ok(FrameMedia::Image),
            _ => Err(Problem::wrong_type("image/png, image/jpeg or application/octet-stream")),
        }
    }
}

/// The pushed source of a session.
pub struct Pushed {
    document: PushedDocument,
    source: Arc<Source>,
    inbox: Arc<Inbox>,
    quota: Arc<FrameRoom>,
}

/// Quotas of the bytes of frames in flight, of all clients; a permit is 1 KiB.
pub struct FrameRoom {
    /// Frames that are read, decoded, or wait for their fits.
    frames: SharedQuota,
    /// WebSocket messages being received.
    sockets: SharedQuota,
}

impl Default for FrameRoom {
    fn default() -> FrameRoom {
        let half = || SharedQuota::new(permits(LIMITS.flight_bytes / 2) as usize);
        FrameRoom { frames: half(), sockets: half() }
    }
}

impl FrameRoom {
    /// Permits for a frame of so many bytes, or 503.
    pub fn room_now(&self, bytes: usize) -> Result<QuotaPermit, Problem> {
        self.frames.try_take(permits(bytes)).ok_or_else(full)
    }

    /// Bytes in use.
    pub fn bytes_taken(&self) -> usize {
        (self.frames.taken() + self.sockets.taken()) * 1024
    }

    /// The part of another tenant.
    pub fn part(&self) -> FrameRoom {
        FrameRoom { frames: self.frames.part(), sockets: self.sockets.part() }
    }
}

fn permits(bytes: usize) -> u32 {
    bytes.div_ceil(1024) as u32
}

/// A decoded frame, with the permits that it holds until it is answered.
pub struct DecodedFrame {
    frame: Frame,
    quota: QuotaPermit,
}

/// A frame that waits for its fit.
pub struct WaitingFrame {
    answer: oneshot::Receiver<Arc<EstimateView>>,
    /// Set once it is the next to be answered: until then it waits for earlier frames.
    deadline: Option<Instant>,
    _room: QuotaPermit,
}

impl Pushed {
    /// 409 when the session's source takes no frames.
    pub fn of(session: &Session, quota: Arc<FrameRoom>) -> Result<Pushed, Problem> {
        let source = session.source().source.clone();
        let SourceDocument::Pushed(document) = source.document().clone() else {
            let kind = source.document().kind();
            let message =
                format!("the session's frames come from a source of kind {kind}; only kind pushed takes frames");
            return Err(Problem::conflict("not-applicable", message));
        };
        Ok(Pushed { document, source, inbox: session.inbox().clone(), quota })
    }

    /// Largest encoded frame of the source, bytes: the raw pixels, or an image of four channels of 16 bits that compression has
    /// not made smaller, plus a quarter and 64 KiB for the rest of the file.
    pub fn frame_bytes(&self) -> usize {
        frame_bytes(&self.document)
    }

    /// The same of one encoding.
    pub fn bytes_of(&self, media: FrameMedia) -> usize {
        if media == FrameMedia::Raw { raw_bytes(&self.document) } else { self.frame_bytes() }
    }

    /// Permits for a frame of that encoding, or 503.
    pub fn room_now(&self, media: FrameMedia) -> Result<QuotaPermit, Problem> {
        self.quota.room_now(self.bytes_of(media))
    }

    /// The same, but waits for the permits; later frames wait in the client's socket.
    pub async fn room_for(&self, media: FrameMedia) -> QuotaPermit {
        self.quota.frames.clone().take(permits(self.bytes_of(media))).await
    }

    /// Makes each further message of a connection hold permits while it is received.
    pub fn close(&self, gate: &MessageGate) {
        gate.close(self.quota.sockets.clone(), permits(self.frame_bytes()));
    }

    /// The encoding of a WebSocket message, from its first bytes.
    pub fn media(&self, bytes: &[u8]) -> FrameMedia {
        media(&self.document, bytes)
    }

    /// Decodes on a blocking thread. `time_s` is the client's; refused if it is not finite or too large.
    pub async fn decode(
        &self,
        media: FrameMedia,
        bytes: Vec<u8>,
        time_s: Option<f64>,
        quota: QuotaPermit,
    ) -> Result<DecodedFrame, Problem> {
        let most = LIMITS.frame_time_s;
        if time_s.is_some_and(|time_s| !(-most..=most).contains(&time_s)) {
            return Err(Problem::bad_request(format!(
                "time_s is not a finite number of seconds from {} to {most}",
                -most
            )));
        }
        let document = self.document.clone();
        let decoding = tokio::task::spawn_blocking(move || decode(&document, media, bytes));
        let frame = decoding.await.map_err(|_| Problem::bug("decoding panicked"))??;
        Ok(DecodedFrame { frame: frame.with_time_s(time_s), quota })
    }

    /// Hands a frame to the source; frames are fitted in this order.
    pub fn push(&self, decoded: DecodedFrame) -> Result<WaitingFrame, Problem> {
        let DecodedFrame { frame, quota } = decoded;
        let (sender, answer) = oneshot::channel();
        let reply = Reply { session: self.inbox.clone(), sender };
        self.source.push(Captured { frame, file: None, truth: None }, reply)?;
        Ok(WaitingFrame { answer, deadline: None, _room: quota })
    }
}

impl WaitingFrame {
    /// Waits for the estimate; the timeout starts with the first call. Cancel-safe.
    pub async fn estimate(&mut self) -> Result<Arc<EstimateView>, Problem> {
        let late = |_| Problem::late("the frame was not fitted in time");
        let deadline = *self.deadline.get_or_insert_with(|| Instant::now() + LIMITS.push_time);
        tokio::time::timeout_at(deadline, &mut self.answer).await.map_err(late)?.map_err(|_| Problem::session_ended())
    }

    /// The estimate if there is one, for a session that has ended.
    pub fn last(mut self) -> Result<Arc<EstimateView>, Problem> {
        self.answer.try_recv().map_err(|_| Problem::session_ended())
    }
}

fn full() -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, "full", "too many bytes of frames are on their way; try again")
}

/// Raw pixels may begin like a JPEG, but hardly with the eight bytes of a PNG.
fn media(document: &PushedDocument, bytes: &[u8]) -> FrameMedia {
    let is_image = is_png(bytes) || (is_jpeg(bytes) && bytes.len() != raw_bytes(document));
    if is_image { FrameMedia::Image } else { FrameMedia::Raw }
}

/// Bytes of a raw frame.
pub fn raw_bytes(document: &PushedDocument) -> usize {
    document.width * document.height * pixel_format(document.format).bytes_per_pixel()
}

fn frame_bytes(document: &PushedDocument) -> usize {
    let image = document.width.saturating_mul(document.height).saturating_mul(10).saturating_add(64 * 1024);
    image.max(raw_bytes(document)).min(LIMITS.frame_bytes)
}

/// Decodes a frame, which must have the size of the document.
pub fn decode(document: &PushedDocument, media: FrameMedia, bytes: Vec<u8>) -> Result<Frame, Problem> {
    let size = [document.width, document.height];
    let wrong = |message: String| Problem::wrong_key("wrong-frame", "", message);
    if media == FrameMedia::Image {
        // Checked before decoding: a small file may hold an image of any size.
        let got = isophote_capture::decode::size(&bytes).map_err(|error| wrong(error.to_string()))?;
        if got != size {
            return Err(wrong(format!("the frame has {got:?} px, the source {size:?}")));
        }
        let frame = isophote_capture::decode(&bytes).map_err(|error| wrong(error.to_string()))?;
        return Ok(frame);
    }
    let expected = raw_bytes(document);
    if bytes.len() != expected {
        return Err(wrong(format!("the frame has {} bytes, {expected} are expected", bytes.len())));
    }
    let plane = Plane::owned(pixel_format(document.format), bytes, document.width);
    Frame::new(&size, vec![plane]).map_err(|error| wrong(error.to_string()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use isophote_wire::PushedFormat;

    /// A frame of 4 × 3 pixels has 24 bytes.
    #[test]
    fn images_are_detected_by_their_first_bytes() {
        let document = PushedDocument { width: 4, height: 3, format: PushedFormat::U16le };
        let cases: [(&[u8], FrameMedia); 6] = [
            (b"\x89PNG\r\n\x1a\n and so on", FrameMedia::Image),
            (b"\x89PNG\r\n\x1a\n of 24 bytes....", FrameMedia::Image),
            (b"\x89PNG\n is not how it begins", FrameMedia::Raw),
            (b"\xff\xd8\xff\xe0 and so on", FrameMedia::Image),
            (b"\xff\xd8\xff\xe0 of pixels 24 bytes.", FrameMedia::Raw),
            (b"", FrameMedia::Raw),
        ];
        assert_eq!((cases[1].0.len(), cases[4].0.len()), (24, 24));
        for (bytes, expected) in cases {
            assert_eq!(media(&document, bytes), expected, "{bytes:?}");
        }
    }

    /// The header of a PNG of 8192 × 8192 px without pixels, which are never decoded.
    #[test]
    fn an_image_of_another_size_is_refused_before_it_is_decoded() {
        let document = PushedDocument { width: 4, height: 3, format: PushedFormat::U8 };
        let mut png = isophote_capture::encode_png(4, 3, isophote_jit::PixelFormat::U8, &[7; 12]).unwrap();
        assert_eq!(decode(&document, FrameMedia::Image, png.clone()).unwrap().size(), [4, 3]);
        png[16..24].copy_from_slice(&[0, 0, 32, 0, 0, 0, 32, 0]);
        let (mut crc, head) = (u32::MAX, 12..29);
        for byte in &png[head] {
            crc ^= u32::from(*byte);
            (0..8).for_each(|_| crc = crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 });
        }
        png[29..33].copy_from_slice(&(!crc).to_be_bytes());
        let problem = decode(&document, FrameMedia::Image, png).unwrap_err();
        assert_eq!(problem.detail, "the frame has [8192, 8192] px, the source [4, 3]");
    }

    #[test]
    fn the_message_limit_fits_any_encoded_frame() {
        let of = |width, height| frame_bytes(&PushedDocument { width, height, format: PushedFormat::U16le });
        // An image with noise in every bit.
        let noise: Vec<u8> = (0..64 * 48 * 2u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        let image = isophote_capture::encode_png(64, 48, isophote_jit::PixelFormat::U16, &noise).unwrap();
        assert!(image.len() < of(64, 48) && of(64, 48) < 100_000);
        assert_eq!(of(32_768, 32_768), LIMITS.frame_bytes);
    }

    /// The timeout of a queued frame starts when it is the first.
    #[tokio::test]
    async fn the_timeout_starts_when_a_frame_is_next() {
        let (sender, answer) = oneshot::channel();
        let quota = SharedQuota::new(1).take(1).await;
        let mut waiting = WaitingFrame { answer, deadline: None, _room: quota };
        let (begun, long) = (Instant::now(), LIMITS.push_time);
        assert!(tokio::time::timeout(std::time::Duration::from_millis(1), waiting.estimate()).await.is_err());
        let deadline = waiting.deadline.unwrap();
        assert!(deadline >= begun + long && deadline <= Instant::now() + long);
        // A dropped future does not restart the timeout.
        assert!(tokio::time::timeout(std::time::Duration::from_millis(1), waiting.estimate()).await.is_err());
        assert_eq!(waiting.deadline, Some(deadline));
        waiting.deadline = Some(begun);
        let problem = waiting.estimate().await.unwrap_err();
        assert_eq!((problem.status.as_u16(), problem.code), (503, "late"));
        drop(sender);
    }
}
