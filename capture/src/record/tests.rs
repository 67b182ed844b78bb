//! Written files read back, complete and truncated anywhere.

#![allow(clippy::unwrap_used)]

use std::fs::File;
use std::path::Path;

use isophote_frame::{Frame, Plane};
use isophote_jit::PixelFormat;

use super::*;
use crate::{FrameSource, LogReader, Recording};

const BEGIN_NS: u64 = 1_700_000_000_000_000_000;

fn frame(number: u64) -> Frame {
    let pixels = (0..12).map(|pixel| (pixel * 7 + number * 31) as u8).collect();
    Frame::new(&[4, 3], vec![Plane::owned(PixelFormat::U8, pixels, 4)]).unwrap()
}

/// Writes three chunks of two frames and two notes each; returns the ends of the chunks and of the file.
fn written(path: &Path) -> Vec<u64> {
    let mut writer = LogWriter::begin(File::create_new(path).unwrap(), "test").unwrap();
    writer.attach("model.toml", "application/toml", BEGIN_NS, b"name = 1").unwrap();
    let images = writer.channel("/one/image", LogSchema::Foxglove("foxglove.RawImage")).unwrap();
    let notes = writer.channel("/one/note", LogSchema::Json("isophote.Note")).unwrap();
    let chunk = |chunk: u64| {
        for number in 2 * chunk..2 * chunk + 2 {
            let at = Stamped { unix_ns: BEGIN_NS + 10_000_000 * number, frame_id: "one" };
            writer.write(images, at.unix_ns, &raw_image(at, &frame(number)).unwrap()).unwrap();
            writer.write(notes, at.unix_ns, format!("{{\"number\":{number}}}").as_bytes()).unwrap();
        }
        writer.flush().unwrap()
    };
    let mut ends: Vec<u64> = (0..3).map(chunk).collect();
    ends.push(writer.finish().unwrap());
    ends
}

/// Numbers of the notes; checks the pictures as well.
fn notes(path: &Path) -> Vec<u64> {
    let mut reader = LogReader::open(path).unwrap();
    let (mut notes, mut pictures) = (Vec::new(), Vec::new());
    while let Some(message) = reader.next_message().unwrap() {
        match message.frame() {
            Some(frame) => pictures.push(frame.unwrap().plane_view(0).pixel(2, 1)),
            None => {
                let note: serde_json::Value = serde_json::from_slice(&message.payload).unwrap();
                notes.push(note["number"].as_u64().unwrap());
            }
        }
    }
    let expected = |number: &u64| frame(*number).plane_view(0).pixel(2, 1);
    assert_eq!(pictures, notes.iter().map(expected).collect::<Vec<_>>());
    notes
}

#[test]
fn frames_round_trip_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    written(&path);
    assert_eq!(notes(&path), [0, 1, 2, 3, 4, 5]);
    let mut recording = Recording::open(&path).unwrap();
    for number in 0..6u64 {
        let captured = recording.next().unwrap().unwrap();
        assert_eq!(captured.frame.time_s.map(|s| (s * 1e3).round()), Some(10.0 * number as f64));
        let pixels: Vec<f64> = (0..12).map(|i| captured.frame.plane_view(0).pixel(i % 4, i / 4)).collect();
        let expected = frame(number);
        assert_eq!(pixels, (0..12).map(|i| expected.plane_view(0).pixel(i % 4, i / 4)).collect::<Vec<_>>());
    }
    assert!(recording.next().unwrap().is_none());
    assert_eq!(mend(&path).unwrap(), MendedFile::Whole);
}

/// Wherever a file is truncated, complete chunks are kept and the mended file equals a finished one in structure.
#[test]
fn truncated_files_are_completed() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.mcap");
    let ends = written(&whole);
    let bytes = std::fs::read(&whole).unwrap();
    let cut = folder.path().join("cut.mcap");
    let near = |length: &usize| ends.iter().any(|end| end.abs_diff(*length as u64) < 2) || length.is_multiple_of(37);
    for length in (8..bytes.len()).rev().filter(near) {
        std::fs::write(&cut, &bytes[..length]).unwrap();
        let flushed = 2 * ends[..3].iter().filter(|end| **end <= length as u64).count() as u64;
        let mended = mend(&cut).unwrap();
        let MendedFile::Mended { messages, .. } = mended else {
            assert_eq!((mended, flushed), (MendedFile::Empty, 0), "{length}");
            continue;
        };
        // A chunk's message indexes are not needed to keep it.
        assert!(messages == 2 * flushed || messages == 2 * flushed + 4, "{length}: {messages}");
        assert_eq!(notes(&cut), (0..messages / 2).collect::<Vec<_>>(), "{length}");
        let after = std::fs::read(&cut).unwrap();
        let summary = mcap::Summary::read(&after).unwrap().unwrap();
        assert_eq!(summary.stats.as_ref().unwrap().message_count, messages, "{length}");
        assert_eq!(
            (summary.chunk_indexes.len() as u64, summary.attachment_indexes.len()),
            (messages / 4, 1),
            "{length}"
        );
        for chunk in &summary.chunk_indexes {
            let indexes = summary.read_message_indexes(&after, chunk).unwrap();
            assert_eq!(indexes.values().map(Vec::len).sum::<usize>(), 4, "{length}");
        }
        let read = mcap::MessageStream::new(&after).unwrap().map(Result::unwrap).count();
        assert_eq!(read as u64, messages, "{length}");
        assert_eq!(mend(&cut).unwrap(), MendedFile::Whole, "{length}");
    }
}

#[test]
fn frames_that_are_not_pictures_are_rejected() {
    let at = Stamped { unix_ns: BEGIN_NS, frame_id: "one" };
    let planes = |format: PixelFormat, count: usize| vec![Plane::owned(format, vec![0; 96], 4); count];
    for (size, planes) in [
        (&[4, 3][..], planes(PixelFormat::F64, 1)),
        (&[4, 3], planes(PixelFormat::U8, 2)),
        (&[4], planes(PixelFormat::U8, 1)),
        (&[4, 3, 2], planes(PixelFormat::U8, 1)),
    ] {
        let error = raw_image(at, &Frame::new(size, planes).unwrap()).unwrap_err().to_string();
        assert!(error.contains("cannot be recorded as pictures"), "{error}");
    }
}

/// Separate planes are interleaved; interleaved planes are copied.
#[test]
fn planes_are_interleaved() {
    let apart = (1..4u8).map(|n| Plane::owned(PixelFormat::U8, vec![n, 10 + n], 2)).collect();
    let mut bytes = Vec::new();
    foxglove::append_pixels(&mut bytes, &Frame::new(&[2, 1], apart).unwrap());
    assert_eq!(bytes, [1, 2, 3, 11, 12, 13]);
    let buffer = isophote_frame::Buffer::Owned(vec![1, 2, 3, 11, 12, 13].into());
    let together = (0..3).map(|channel| Plane::interleaved(PixelFormat::U8, &buffer, 2, 3, channel)).collect();
    let mut copied = Vec::new();
    foxglove::append_pixels(&mut copied, &Frame::new(&[2, 1], together).unwrap());
    assert_eq!(copied, bytes);
}
