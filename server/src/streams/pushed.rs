//! Frames that clients send: bytes in, the estimate of this very frame out.

use std::sync::Arc;

use isophote_capture::Captured;
use isophote_tracker::{Frame, Plane};
use tokio::sync::oneshot;
use tokio::time::Instant;

use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::session::Session;
use crate::session::inbox::{Inbox, Reply};
use crate::source::{Source, pixel_format};
use crate::wire::{Estimate, PushedDocument, SourceDocument};

/// What a PNG file begins with.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// What a JPEG file begins with.
const JPEG: &[u8] = b"\xff\xd8\xff";

/// What the bytes of a frame are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Media {
    /// Pixels in the source's format, rows without padding.
    Raw,
    /// A file that says what it is.
    Image,
}

/// Where the frames of a session with a pushed source go.
pub struct Pushed {
    document: PushedDocument,
    source: Arc<Source>,
    inbox: Arc<Inbox>,
}

/// A frame that waits for its fit.
pub struct Waiting {
    answer: oneshot::Receiver<Arc<Estimate>>,
    deadline: Instant,
}

impl Pushed {
    /// 409 when the session's source takes no frames.
    pub fn of(session: &Session) -> Result<Pushed, Problem> {
        let source = session.source().source.clone();
        let SourceDocument::Pushed(document) = source.document().clone() else {
            let kind = source.document().kind();
            let message =
                format!("the session's frames come from a source of kind {kind}; only kind pushed takes frames");
            return Err(Problem::conflict("not-applicable", message));
        };
        Ok(Pushed { document, source, inbox: session.inbox().clone() })
    }

    /// What bytes are that come without a type.
    pub fn media(&self, bytes: &[u8]) -> Media {
        media(&self.document, bytes)
    }

    /// Decodes on a thread where it may take its time.
    pub async fn decode(&self, media: Media, bytes: Vec<u8>) -> Result<Frame, Problem> {
        let document = self.document.clone();
        let decoding = tokio::task::spawn_blocking(move || decode(&document, media, bytes));
        decoding.await.map_err(|_| Problem::bug("decoding panicked"))?
    }

    /// Hands a frame to the source; frames are fitted in the order of these calls.
    pub fn push(&self, frame: Frame) -> Result<Waiting, Problem> {
        let (sender, answer) = oneshot::channel();
        let reply = Reply { session: self.inbox.clone(), sender };
        self.source.push(Captured { frame, file: None, truth: None }, reply)?;
        Ok(Waiting { answer, deadline: Instant::now() + LIMITS.push_time })
    }
}

impl Waiting {
    /// The estimate, when it is there. Nothing is lost when the future is dropped.
    pub async fn estimate(&mut self) -> Result<Arc<Estimate>, Problem> {
        let late = |_| Problem::conflict("not-applicable", "the frame was not fitted in time");
        tokio::time::timeout_at(self.deadline, &mut self.answer).await.map_err(late)?.map_err(|_| gone())
    }

    /// The estimate if it is there by now, for a session that has ended.
    pub fn last(mut self) -> Result<Arc<Estimate>, Problem> {
        self.answer.try_recv().map_err(|_| gone())
    }
}

/// What is said of a frame that will not be fitted any more.
pub fn gone() -> Problem {
    Problem::conflict("not-applicable", "the session ended before the frame was fitted")
}

/// Pixels that begin like a JPEG are possible; the eight bytes of a PNG are not.
fn media(document: &PushedDocument, bytes: &[u8]) -> Media {
    let is_image = bytes.starts_with(PNG) || (bytes.starts_with(JPEG) && bytes.len() != raw_bytes(document));
    if is_image { Media::Image } else { Media::Raw }
}

fn raw_bytes(document: &PushedDocument) -> usize {
    document.width * document.height * pixel_format(document.format).bytes_per_pixel()
}

fn decode(document: &PushedDocument, media: Media, bytes: Vec<u8>) -> Result<Frame, Problem> {
    let size = [document.width, document.height];
    let wrong = |message: String| Problem::wrong_key("wrong-frame", "", message);
    if media == Media::Image {
        let frame = isophote_capture::decode(&bytes).map_err(|error| wrong(error.to_string()))?;
        if frame.size() != size {
            return Err(wrong(format!("the frame has {:?} px, the source {size:?}", frame.size())));
        }
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
    use super::*;
    use crate::wire::PushedFormat;

    /// A frame of 4 × 3 pixels has 24 bytes.
    #[test]
    fn images_are_known_by_how_they_begin() {
        let document = PushedDocument { width: 4, height: 3, format: PushedFormat::U16le };
        let cases: [(&[u8], Media); 6] = [
            (b"\x89PNG\r\n\x1a\n and so on", Media::Image),
            (b"\x89PNG\r\n\x1a\n of 24 bytes....", Media::Image),
            (b"\x89PNG\n is not how it begins", Media::Raw),
            (b"\xff\xd8\xff\xe0 and so on", Media::Image),
            (b"\xff\xd8\xff\xe0 of pixels 24 bytes.", Media::Raw),
            (b"", Media::Raw),
        ];
        assert_eq!((cases[1].0.len(), cases[4].0.len()), (24, 24));
        for (bytes, expected) in cases {
            assert_eq!(media(&document, bytes), expected, "{bytes:?}");
        }
    }
}
