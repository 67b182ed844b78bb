//! Checks a JPEG's completeness and repairs missing Huffman tables, at the level of segments; decodes no pixel.

use std::ops::Range;

/// Second bytes of markers; the first is 0xff.
const BASELINE: [u8; 2] = [0xc0, 0xc1];
const PROGRESSIVE: u8 = 0xc2;
const HUFFMAN_TABLES: u8 = 0xc4;
const RESTARTS: std::ops::RangeInclusive<u8> = 0xd0..=0xd7;
const START_OF_IMAGE: u8 = 0xd8;
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;

/// APP0 segment of motion JPEG, which makes the decoder use the standard Huffman tables (T.81, K.3.3).
const FILM: [u8; 18] = *b"\xff\xe0\x00\x10AVI1\0\0\0\0\0\0\0\0\0\0";
/// Ones, which begin no Huffman code: a decoder that still expects pixels here reports an error instead of grey.
const BARRIER: [u8; 32] =
    *b"\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0\xff\0";

/// Trailing bytes of pixel data that may be unused, since encoders pad.
const TAIL_BYTES: usize = 8;

/// Headers before the scan.
#[derive(Debug, Default)]
struct Head {
    has_tables: bool,
    is_baseline: bool,
    /// MCUs of the picture; `interval` is the number per restart interval, 0 without restart markers.
    units: usize,
    interval: usize,
    /// Offset of the scan's segment.
    scan: usize,
    /// Segments before it. Webcams leave stray bytes between them.
    segments: Vec<Range<usize>>,
}

/// Adds the standard Huffman tables if there are none, and ends the picture so that missing pixels are an error.
///
/// # Errors
/// The end marker, the scan or a part of the scan is missing.
pub(super) fn prepared(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let is_end = |pair: &[u8]| pair == [0xff, END_OF_IMAGE];
    let end = bytes.windows(2).rposition(is_end).ok_or("it ends before its end marker")?;
    if !bytes.starts_with(&[0xff, START_OF_IMAGE]) {
        return Err("it does not begin with the marker of a JPEG".into());
    }
    let head = head(&bytes[..end]).ok_or("it ends before its first pixel")?;
    if head.interval > 0 && head.is_baseline {
        let is_restart = |pair: &&[u8]| pair[0] == 0xff && RESTARTS.contains(&pair[1]);
        let found = bytes[head.scan..end].windows(2).filter(is_restart).count();
        let expected = head.units.div_ceil(head.interval).saturating_sub(1);
        if found < expected {
            return Err(format!("{} of its {expected} restart markers are missing", expected - found));
        }
    }
    let promise: &[u8] = if head.has_tables { &[] } else { &FILM };
    let barrier: &[u8] = if head.is_baseline { &BARRIER } else { &[] };
    let segments = head.segments.into_iter().map(|segment| &bytes[segment]);
    let parts = [&bytes[..2], promise].into_iter().chain(segments);
    Ok(parts.chain([&bytes[head.scan..end], barrier, &[0xff, END_OF_IMAGE]]).collect::<Vec<_>>().concat())
}

/// Removes padding, a run of equal bytes, from the end of the pixel data; `None` if there is none.
pub(super) fn unpadded(bytes: &[u8]) -> Option<Vec<u8>> {
    let end = end_of_pixels(bytes, &head(bytes)?)?;
    let last = bytes[..end].last()?;
    let kept = bytes[..end].iter().rposition(|byte| byte != last)? + 1;
    (end - kept > TAIL_BYTES).then(|| [&bytes[..kept], &[0xff, END_OF_IMAGE]].concat())
}

/// End of the pixel data if it is contiguous, directly followed by the end of the picture.
fn end_of_pixels(bytes: &[u8], head: &Head) -> Option<usize> {
    let mut pairs = bytes[head.scan + 2..].windows(2);
    let is_marker = |pair: &[u8]| pair[0] == 0xff && ![0, 0xff].contains(&pair[1]) && !RESTARTS.contains(&pair[1]);
    let end = head.scan + 2 + pairs.position(is_marker)?;
    (bytes[end + 1] == END_OF_IMAGE).then_some(end)
}

/// Removes the last bytes of contiguous pixel data: if the result still decodes, the decoder had all blocks before the data
/// ended, so it lost synchronization.
pub(super) fn shortened(bytes: &[u8]) -> Option<Vec<u8>> {
    let head = head(bytes).filter(|head| head.is_baseline)?;
    let end = end_of_pixels(bytes, &head)?;
    // Allows a few bytes of padding; pictures this small are not checked.
    let kept = end.checked_sub(TAIL_BYTES).filter(|kept| *kept > head.scan + 2 * TAIL_BYTES)?;
    Some([&bytes[..kept], &[0xff, END_OF_IMAGE]].concat())
}

/// Parses the segments up to the scan.
fn head(bytes: &[u8]) -> Option<Head> {
    let (mut head, mut at) = (Head::default(), 2);
    loop {
        let [first, marker, high, low] = *bytes.get(at..)?.first_chunk::<4>()?;
        if first != 0xff || [0, 0xff].contains(&marker) {
            at += 1; // cameras pad between segments
            continue;
        }
        if marker == START_OF_IMAGE || RESTARTS.contains(&marker) {
            at += 2; // markers without a length
            continue;
        }
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low])).max(2);
        let body = bytes.get(at + 4..end)?;
        match marker {
            START_OF_SCAN => return Some(Head { scan: at, ..head }),
            HUFFMAN_TABLES => head.has_tables = true,
            RESTART_INTERVAL => head.interval = usize::from(u16::from_be_bytes(*body.first_chunk()?)),
            PROGRESSIVE => head.is_baseline = false,
            _ if BASELINE.contains(&marker) => (head.is_baseline, head.units) = (true, units(body)?),
            _ => {}
        }
        head.segments.push(at..end);
        at = end;
    }
}

/// Number of MCUs, from the frame header's size and sampling.
fn units(body: &[u8]) -> Option<usize> {
    let [_, h0, h1, w0, w1, components] = *body.first_chunk::<6>()?;
    let side = |high, low| usize::from(u16::from_be_bytes([high, low]));
    let sampling = || body[6..].chunks_exact(3).take(usize::from(components)).map(|one| one[1]);
    let most = |shift: u32| sampling().map(|both| usize::from(both >> shift & 15)).max().filter(|most| *most > 0);
    // A single component is not interleaved.
    let [across, down] = if components == 1 { [1, 1] } else { [most(4)?, most(0)?] };
    Some(side(w0, w1).div_ceil(8 * across) * side(h0, h1).div_ceil(8 * down))
}
