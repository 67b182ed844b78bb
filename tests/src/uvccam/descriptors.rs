//! The camera's USB descriptors: USB 2.0 and USB Video Class 1.0, as bytes on the wire.

/// Picture sizes; the first is the default.
pub(super) const SIZES: [[usize; 2]; 2] = [[640, 480], [320, 240]];
/// Formats by number, from 1.
pub(super) const KINDS: [Kind; 2] = [Kind::Yuyv, Kind::Grey];
/// Frame intervals, 100 ns: 60, 30, 25, 15, 10 and 5 per second.
pub(super) const INTERVALS: [u32; 6] = [166_666, 333_333, 400_000, 666_666, 1_000_000, 2_000_000];
/// The default interval.
pub(super) const INTERVAL: u32 = INTERVALS[1];
/// Maximum payload of one transfer, with its header.
pub(super) const PAYLOAD: usize = 16_384;
/// Numbers of the units with controls.
pub(super) const SENSOR: u8 = 1;
pub(super) const PROCESSING: u8 = 2;

/// Descriptor types.
const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const TEXT: u8 = 3;
const INTERFACE: u8 = 4;
const ENDPOINT: u8 = 5;
const ASSOCIATION: u8 = 0x0b;
/// A class-specific interface descriptor of the video class.
const CLASS: u8 = 0x24;
const VIDEO: u8 = 0x0e;
/// Unit number of the USB output terminal.
const OUTPUT: u8 = 3;

/// A pixel format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Luma and chroma, two bytes a pixel.
    Yuyv,
    /// One byte a pixel.
    Grey,
}

impl Kind {
    pub(super) fn bytes_per_pixel(self) -> usize {
        match self {
            Kind::Yuyv => 2,
            Kind::Grey => 1,
        }
    }

    /// First four bytes of the format's GUID.
    fn code(self) -> &'static [u8; 4] {
        match self {
            Kind::Yuyv => b"YUY2",
            Kind::Grey => b"Y800",
        }
    }
}

/// Answers a standard descriptor request; `None` if there is none.
pub(super) fn descriptor(kind: u8, index: u8, serial: &str) -> Option<Vec<u8>> {
    match (kind, index) {
        // USB 2.0, interface association, vendor 0x1209 product 1, strings 1 to 3, one configuration.
        (DEVICE, _) => Some(sized(&[DEVICE, 0, 2, 0xef, 2, 1, 64, 0x09, 0x12, 1, 0, 0, 1, 1, 2, 3, 1])),
        (CONFIGURATION, _) => Some(configuration()),
        (TEXT, 0) => Some(sized(&[TEXT, 9, 4])), // the language is English
        (TEXT, index) => Some(text(["Isophote", "Test camera", serial].get(usize::from(index.checked_sub(1)?))?)),
        _ => None,
    }
}

/// Prepends the length.
fn sized(body: &[u8]) -> Vec<u8> {
    [&[body.len() as u8 + 1], body].concat()
}

fn text(text: &str) -> Vec<u8> {
    let letters: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    sized(&[&[TEXT][..], &letters].concat())
}

/// Concatenates parts and stores the total length in bytes at `at` of the first.
fn totalled(mut head: Vec<u8>, at: usize, rest: &[u8]) -> Vec<u8> {
    let total = (head.len() + rest.len()) as u16;
    head[at..at + 2].copy_from_slice(&total.to_le_bytes());
    [&head, rest].concat()
}

fn configuration() -> Vec<u8> {
    let parts = [
        sized(&[ASSOCIATION, 0, 2, VIDEO, 3, 0, 0]),
        sized(&[INTERFACE, 0, 0, 0, VIDEO, 1, 0, 0]),
        controlled(),
        sized(&[INTERFACE, 1, 0, 1, VIDEO, 2, 0, 0]),
        streamed(),
        sized(&[ENDPOINT, 0x81, 2, 0, 2, 0]), // in, bulk, 512 bytes
    ];
    totalled(sized(&[CONFIGURATION, 0, 0, 2, 1, 0, 0x80, 250]), 2, &parts.concat())
}

/// Sensor, processing unit and output terminal, with their controls.
fn controlled() -> Vec<u8> {
    let parts = [
        // Exposure mode (bit 1) and exposure time (bit 3).
        sized(&[CLASS, 2, SENSOR, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0a, 0, 0]),
        // Brightness (bit 0) and gain (bit 9).
        sized(&[CLASS, 5, PROCESSING, SENSOR, 0, 0, 2, 0x01, 0x02, 0]),
        sized(&[CLASS, 3, OUTPUT, 0x01, 0x01, 0, PROCESSING, 0]),
    ];
    let clock_hz = 48_000_000u32.to_le_bytes();
    totalled(sized(&[&[CLASS, 1, 0, 1, 0, 0][..], &clock_hz, &[1, 1]].concat()), 5, &parts.concat())
}

/// Formats with their sizes and rates.
fn streamed() -> Vec<u8> {
    let formats: Vec<u8> = KINDS.iter().zip(1..).flat_map(|(kind, number)| format(*kind, number)).collect();
    totalled(sized(&[CLASS, 1, KINDS.len() as u8, 0, 0, 0x81, 0, OUTPUT, 0, 0, 0, 1, 0, 0]), 4, &formats)
}

fn format(kind: Kind, number: u8) -> Vec<u8> {
    let guid = [kind.code().as_slice(), &[0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71]].concat();
    let bits = 8 * kind.bytes_per_pixel() as u8;
    let head = sized(&[&[CLASS, 4, number, SIZES.len() as u8][..], &guid, &[bits, 1, 0, 0, 0, 0]].concat());
    let sizes = SIZES.iter().zip(1..).flat_map(|(size, number)| picture(kind, *size, number));
    [head, sizes.collect(), sized(&[CLASS, 0x0d, 1, 1, 4])].concat()
}

fn picture(kind: Kind, [width, height]: [usize; 2], number: u8) -> Vec<u8> {
    let bytes = (width * height * kind.bytes_per_pixel()) as u32;
    let bits_s = bytes * 8 * 30;
    let mut body = vec![CLASS, 5, number, 0];
    body.extend([width as u16, height as u16].map(u16::to_le_bytes).as_flattened());
    body.extend([bits_s, bits_s, bytes, INTERVAL].map(u32::to_le_bytes).as_flattened());
    body.push(INTERVALS.len() as u8);
    body.extend(INTERVALS.map(u32::to_le_bytes).as_flattened());
    sized(&body)
}
