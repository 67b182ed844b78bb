//! The driver's control requests: standard ones, format negotiation, and camera controls.

use super::controls::{AUTOMATIC, Controls, EXPOSURE, GAIN, MANUAL};
use super::descriptors::{INTERVALS, KINDS, PAYLOAD, PROCESSING, SENSOR, SIZES, descriptor};
use super::state::State;

/// Requests of the video class.
const SET: u8 = 0x01;
const GET: u8 = 0x81;
const MINIMUM: u8 = 0x82;
const MAXIMUM: u8 = 0x83;
const STEP: u8 = 0x84;
const LENGTH: u8 = 0x85;
const ABILITIES: u8 = 0x86;
const DEFAULT: u8 = 0x87;
/// Size of a format negotiation (probe and commit), bytes.
const AGREEMENT: usize = 26;

/// A control: bytes of its value, current value, minimum, maximum, step, default.
struct Control {
    bytes: usize,
    values: [i64; 5],
}

fn control(controls: &Controls, part: u8, selector: u8) -> Option<Control> {
    let Controls { mode, exposure, gain, brightness } = *controls;
    let (bytes, values) = match (part, selector) {
        // The step of a bitmask of modes is the mask of supported ones.
        (SENSOR, 2) => (1, [i64::from(mode), 0, 0, i64::from(MANUAL | AUTOMATIC), i64::from(AUTOMATIC)]),
        (SENSOR, 4) => (4, [i64::from(exposure), 1, 5000, 1, i64::from(EXPOSURE)]),
        (PROCESSING, 2) => (2, [i64::from(brightness), -64, 64, 1, 0]),
        (PROCESSING, 4) => (2, [i64::from(gain), 0, 255, 1, i64::from(GAIN)]),
        _ => return None,
    };
    Some(Control { bytes, values })
}

/// Answers a setup packet of eight bytes with the data sent; `None` stalls.
pub(super) fn answer(state: &mut State, setup: [u8; 8], sent: &[u8], serial: &str) -> Option<Vec<u8>> {
    let [kind, request, value, value_high, interface, part, ..] = setup;
    match (kind, request) {
        (0x80, 6) => descriptor(value_high, value, serial),
        (0x80..=0x82, 0) => Some(vec![0, 0]),           // status
        (0x00, 5 | 9) | (0x01, 11) => Some(Vec::new()), // address, configuration, interface
        (0x02, 1) => {
            state.stops += 1; // the driver clears the endpoint when it stops
            Some(Vec::new())
        }
        (0x21 | 0xa1, _) if interface == 1 => agreement(state, request, value_high, sent),
        (0x21 | 0xa1, _) => class(&mut state.controls, request, part, value_high, sent),
        _ => None,
    }
}

/// Format negotiation: probe (selector 1) and commit (2), both handled alike.
fn agreement(state: &mut State, request: u8, selector: u8, sent: &[u8]) -> Option<Vec<u8>> {
    match (selector, request) {
        (1 | 2, LENGTH) => Some((AGREEMENT as u16).to_le_bytes().to_vec()),
        (1 | 2, ABILITIES) => Some(vec![3]),
        (1 | 2, SET) => {
            let chosen = |number: u8, last: usize| usize::from(number).clamp(1, last) - 1;
            let [_, _, kind, size, a, b, c, d] = *sent.first_chunk::<8>()?;
            (state.kind, state.size) = (KINDS[chosen(kind, KINDS.len())], SIZES[chosen(size, SIZES.len())]);
            state.interval = u32::from_le_bytes([a, b, c, d]).clamp(INTERVALS[0], INTERVALS[INTERVALS.len() - 1]);
            Some(Vec::new())
        }
        (1 | 2, _) => {
            let number = |place: Option<usize>| place.map_or(1, |place| place as u8 + 1);
            let kind = number(KINDS.iter().position(|kind| *kind == state.kind));
            let size = number(SIZES.iter().position(|size| *size == state.size));
            let bytes = (state.size[0] * state.size[1] * state.kind.bytes_per_pixel()) as u32;
            let numbers = [bytes, PAYLOAD as u32].map(u32::to_le_bytes);
            Some([&[1, 0, kind, size][..], &state.interval.to_le_bytes(), &[0; 10], numbers.as_flattened()].concat())
        }
        _ => None,
    }
}

fn class(controls: &mut Controls, request: u8, part: u8, selector: u8, sent: &[u8]) -> Option<Vec<u8>> {
    if (part, selector) == (0, 2) {
        return Some(vec![0]); // no error in the last request
    }
    let Control { bytes, values } = control(controls, part, selector)?;
    let place = match request {
        SET => {
            set(controls, part, selector, sent.get(..bytes)?);
            return Some(Vec::new());
        }
        LENGTH => return Some(vec![bytes as u8, 0]),
        ABILITIES => return Some(vec![3]), // supports GET and SET
        GET => 0,
        MINIMUM => 1,
        MAXIMUM => 2,
        STEP => 3,
        DEFAULT => 4,
        _ => return None,
    };
    Some(values[place].to_le_bytes()[..bytes].to_vec())
}

/// `sent` has the length of the control's value.
fn set(controls: &mut Controls, part: u8, selector: u8, sent: &[u8]) {
    let mut wide = [0; 4];
    wide[..sent.len()].copy_from_slice(sent);
    let value = u32::from_le_bytes(wide);
    match (part, selector) {
        (SENSOR, 2) => controls.mode = value as u8,
        (SENSOR, _) => controls.exposure = value,
        (_, 2) => controls.brightness = value as u16 as i16,
        _ => controls.gain = value as u16,
    }
}
