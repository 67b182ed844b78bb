//! Draws one frame for all viewers that asked for it.

use std::collections::BTreeMap;

use isophote_capture::encode_jpeg;
use isophote_tracker::{FrameScene, PreviewDepth};
use isophote_wire::{PreviewDrawing, PreviewFormat, PreviewHeader, PreviewLevels, PreviewPixels};

use super::{Ask, FittedScene, PreviewForm, ShownFrame};
use crate::counters::Tally;

/// A message as it is sent; clones share it.
pub type PreviewMessage = axum::body::Bytes;

/// Draws each requested form once; returns the requests whose message exceeds the quota.
pub(super) fn answer(scene: FittedScene, asks: Vec<Ask>, messages: &Tally) -> Vec<Ask> {
    let mut wanted: BTreeMap<PreviewForm, Vec<Ask>> = BTreeMap::new();
    for ask in asks {
        wanted.entry(ask.form).or_default().push(ask);
    }
    let mut left = Vec::new();
    let FittedScene { frame, estimates, views, viewer, session, epoch } = scene;
    let frame = { frame }.owned(); // returns a loaned buffer before drawing
    let seen = viewer.scene(&frame, &estimates);
    let [width, height, ..] = frame.sides();
    let mut drawing = PreviewDrawing::new(&session, epoch, frame.sequence, [width, height], seen.overlay());
    drawing.estimate = views.first().map(|view| (**view).clone());
    if views.len() > 1 {
        drawing.estimates = views.iter().map(|view| (**view).clone()).collect();
    }
    let drawing = match serde_json::to_string(&drawing) {
        Ok(text) => text,
        Err(error) => {
            tracing::error!(session, %error, "bug: a preview is no JSON");
            return left;
        }
    };
    for (form, asks) in wanted {
        // The sides of a JPEG are limited.
        let least = width.max(height).div_ceil(JPEG_SIDE_MAX);
        let step = if form.format == PreviewFormat::Jpeg { form.step.max(least) } else { form.step };
        let message = match message(&seen, PreviewForm { step, ..form }, &drawing) {
            Ok(message) => PreviewMessage::from(message),
            Err(error) => {
                tracing::error!(session, %error, "a preview cannot be encoded");
                continue;
            }
        };
        messages.add(1);
        // Each viewer's socket holds a copy.
        let bytes = u32::try_from(message.len()).unwrap_or(u32::MAX);
        for ask in asks {
            match ask.quota.try_take(bytes) {
                Some(quota) => {
                    let shown = ShownFrame { number: frame.sequence, message: message.clone(), quota };
                    ask.reply.send(shown).ok(); // the viewer may have gone
                }
                None => left.push(ask),
            }
        }
    }
    left
}

/// Pixels along x or y that a JPEG can have.
const JPEG_SIDE_MAX: usize = 65_535;

fn message(seen: &FrameScene<'_>, form: PreviewForm, drawing: &str) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let depth = match form.format {
        PreviewFormat::Raw8 => PreviewDepth::Eight,
        PreviewFormat::Raw16 => PreviewDepth::Sixteen,
        PreviewFormat::Jpeg => PreviewDepth::Colour,
    };
    let picture = seen.picture(form.part, form.step, depth);
    let [low, high] = picture.levels;
    let pixels = PreviewPixels {
        part: form.part,
        format: form.format,
        width: picture.width,
        height: picture.height,
        origin: picture.origin,
        step: picture.step,
        levels: PreviewLevels { low, high },
    };
    let bytes = match form.format {
        PreviewFormat::Jpeg => {
            encode_jpeg(picture.width, picture.height, picture.channels, &picture.bytes, form.quality)?
        }
        PreviewFormat::Raw8 | PreviewFormat::Raw16 => picture.bytes,
    };
    Ok(PreviewHeader::message(&pixels, drawing, &bytes))
}
