//! Sends an open file, or the part of it that a client asks for (RFC 9110, section 14).

use std::fs::{File, Metadata};
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::os::unix::fs::MetadataExt;

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::IntoResponse;
use futures_util::stream;
use tokio::sync::mpsc;

use super::Answer;
use super::representation;
use crate::http::preconditions::{EntityTag, Preconditions, Reading};
use crate::limits::LIMITS;
use crate::problem::Problem;

/// Pieces of a file that are read ahead of the client.
const PIECES: usize = 4;

/// The part of a file to send.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Portion {
    /// 200.
    Whole,
    /// 206.
    Part(Range<u64>),
    /// 416.
    Outside,
}

impl Portion {
    /// The range that `Range` asks for, of `length` bytes. Several ranges and other units than bytes yield the whole.
    fn of(headers: &HeaderMap, tag: &EntityTag, length: u64) -> Portion {
        let mut lines = headers.get_all(header::RANGE).iter().map(HeaderValue::as_bytes);
        let (Some(range), None) = (lines.next(), lines.next()) else { return Portion::Whole };
        // A date, a weak tag or another tag means that the client has a part of another file.
        let is_same = |sent: &HeaderValue| tag.header().is_ok_and(|tag| tag == *sent);
        if !headers.get_all(header::IF_RANGE).iter().all(is_same) {
            return Portion::Whole;
        }
        let Some((unit, ranges)) = std::str::from_utf8(range).ok().and_then(|range| range.split_once('=')) else {
            return Portion::Outside;
        };
        if !unit.trim().eq_ignore_ascii_case("bytes") || ranges.contains(',') {
            return Portion::Whole;
        }
        let part = ranges.trim().split_once('-').and_then(|(first, last)| part(first, last, length));
        part.map_or(Portion::Outside, Portion::Part)
    }
}

/// From the first to the last byte, or the last so many; `None` if that is no part of `length` bytes.
fn part(first: &str, last: &str, length: u64) -> Option<Range<u64>> {
    // Numbers that overflow are beyond every file.
    let number = |digits: &str| {
        let is_number = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
        is_number.then(|| digits.parse().unwrap_or(u64::MAX))
    };
    let part = match (first.is_empty(), last.is_empty()) {
        (true, _) => length.saturating_sub(number(last)?)..length,
        (false, true) => number(first)?..length,
        (false, false) => {
            let (first, last) = (number(first)?, number(last)?);
            if last < first {
                return None;
            }
            first..last.saturating_add(1).min(length)
        }
    };
    (part.start < part.end).then_some(part)
}

/// The tag of a finished file: another file of that name has another inode or time.
pub fn tag_of(about: &Metadata) -> EntityTag {
    let (seconds, nanoseconds) = (about.mtime(), about.mtime_nsec());
    EntityTag::new(format!("{:x}-{:x}-{seconds:x}.{nanoseconds:x}", about.ino(), about.len()))
}

/// Sends an open file, or a part of it. `held` is kept until it has been read.
pub fn sent(
    (file, about): (File, Metadata),
    media: &'static str,
    (method, headers, preconditions): (&Method, &HeaderMap, &Preconditions),
    held: impl Send + 'static,
) -> Answer {
    let (tag, length) = (tag_of(&about), about.len());
    let is_wanted = preconditions.read("the file", &tag)? == Reading::Whole;
    // HEAD ignores ranges.
    let portion = if *method == Method::GET && is_wanted { Portion::of(headers, &tag, length) } else { Portion::Whole };
    let (status, range) = match portion {
        Portion::Whole => (StatusCode::OK, 0..length),
        Portion::Part(range) => (StatusCode::PARTIAL_CONTENT, range),
        Portion::Outside => {
            let detail =
                format!("the file has {length} bytes, 0 to {}, and Range names none of them", length.saturating_sub(1));
            let problem = Problem::new(StatusCode::RANGE_NOT_SATISFIABLE, "no-such-range", detail);
            return Ok(([(header::CONTENT_RANGE, format!("bytes */{length}"))], problem).into_response());
        }
    };
    let bytes = range.end - range.start;
    let body = match *method == Method::GET && is_wanted {
        true => streamed(file, range.clone(), held),
        false => Body::empty(),
    };
    let mut response = (status, body).into_response();
    let answered = response.headers_mut();
    answered.insert(header::CONTENT_TYPE, HeaderValue::from_static(media));
    answered.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    if status == StatusCode::PARTIAL_CONTENT {
        let said = format!("bytes {}-{}/{length}", range.start, range.end - 1);
        answered.insert(
            header::CONTENT_RANGE,
            HeaderValue::from_str(&said).map_err(|error| Problem::bug(error.to_string()))?,
        );
    }
    let mut response = representation(preconditions, "the file", &tag, response)?;
    response.headers_mut().insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    Ok(response)
}

/// Streams the file as fast as the client reads. A truncated file aborts the response.
fn streamed(mut file: File, range: Range<u64>, held: impl Send + 'static) -> Body {
    let (pieces, sent) = mpsc::channel::<std::io::Result<Bytes>>(PIECES);
    let read = move || {
        let _held = held;
        let mut left = range.end - range.start;
        let mut sought = file.seek(SeekFrom::Start(range.start)).map(drop);
        while left > 0 {
            let mut piece = vec![0; LIMITS.download_bytes.min(left as usize)];
            let read = std::mem::replace(&mut sought, Ok(())).and_then(|()| file.read_exact(&mut piece));
            left = if read.is_ok() { left - piece.len() as u64 } else { 0 };
            if pieces.blocking_send(read.map(|()| piece.into())).is_err() {
                return; // the client has gone
            }
        }
    };
    tokio::task::spawn_blocking(read);
    Body::from_stream(stream::unfold(sent, async |mut sent| sent.recv().await.map(|piece| (piece, sent))))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn ranges_are_read_as_rfc_9110_says() {
        let tag = EntityTag::new("a");
        let portion = |range: &str, length| {
            let headers = HeaderMap::from_iter([(header::RANGE, HeaderValue::from_str(range).unwrap())]);
            Portion::of(&headers, &tag, length)
        };
        let cases = [
            ("bytes=0-0", Portion::Part(0..1)),
            ("bytes=0-9", Portion::Part(0..10)),
            ("Bytes=3-4", Portion::Part(3..5)),
            ("bytes=3-", Portion::Part(3..10)),
            ("bytes=9-99", Portion::Part(9..10)),
            ("bytes=8-18446744073709551615", Portion::Part(8..10)),
            ("bytes=8-99999999999999999999999", Portion::Part(8..10)),
            ("bytes=-3", Portion::Part(7..10)),
            ("bytes=-11", Portion::Part(0..10)),
            ("bytes=007-008", Portion::Part(7..9)),
            ("bytes=10-", Portion::Outside),
            ("bytes=10-12", Portion::Outside),
            ("bytes=99999999999999999999999-", Portion::Outside),
            ("bytes=-0", Portion::Outside),
            ("bytes=4-3", Portion::Outside),
            ("bytes=-", Portion::Outside),
            ("bytes=", Portion::Outside),
            ("bytes=a-b", Portion::Outside),
            ("bytes=+1-2", Portion::Outside),
            ("bytes=--1", Portion::Outside),
            ("bytes", Portion::Outside),
            ("bytes=0-1,3-4", Portion::Whole),
            ("lines=0-1", Portion::Whole),
        ];
        for (range, expected) in cases {
            assert_eq!(portion(range, 10), expected, "{range}");
        }
        assert_eq!(portion("bytes=0-", 0), Portion::Outside);
        assert_eq!(portion("bytes=-1", 0), Portion::Outside);
    }

    #[test]
    fn a_part_of_another_file_is_not_continued() {
        let tag = EntityTag::new("a");
        for (if_range, expected) in [
            ("\"a\"", Portion::Part(2..10)),
            ("\"b\"", Portion::Whole),
            ("W/\"a\"", Portion::Whole),
            ("Sat, 29 Oct 1994 19:43:31 GMT", Portion::Whole),
        ] {
            let headers = [(header::RANGE, "bytes=2-"), (header::IF_RANGE, if_range)];
            let headers = headers.map(|(name, value)| (name, HeaderValue::from_static(value)));
            assert_eq!(Portion::of(&HeaderMap::from_iter(headers), &tag, 10), expected, "{if_range}");
        }
    }
}
