//! Pixel formats as a driver of the kernel packs them: its colour bars, read in each, are the same bars.

use std::path::Path;

use isophote_capture::{Colour, Encoding};
use isophote_tests::rig::{Rig, WEBCAM, in_rig};
use isophote_tracker::Frame;
use v4l::buffer::Type;
use v4l::io::mmap::Stream;
use v4l::io::traits::CaptureStream;
use v4l::video::Capture;
use v4l::{Device, Format, FourCC};

use crate::ctl;

const SIZE: [usize; 2] = [640, 360];
/// White, yellow, cyan, green, magenta, red, blue, black: which of red, green and blue each bar has.
const BARS: [[bool; 3]; 8] = [
    [true, true, true],
    [true, true, false],
    [false, true, true],
    [false, true, false],
    [true, false, true],
    [true, false, false],
    [false, false, true],
    [false, false, false],
];
/// What a colour reads where it is there: 75 % of 255, rounded.
const LIT: f64 = 191.0;

/// A bar's middle in a plane, in 255ths of the full scale: 10 bits are cut to 8.
fn bars(frame: &Frame, plane: usize, saturation: f64) -> [f64; 8] {
    let (view, width) = (frame.plane_view(plane), frame.width());
    let shift = (saturation + 1.0) / 256.0;
    std::array::from_fn(|bar| (view.pixel((2 * bar + 1) * width / 16, frame.rows() / 2) / shift).floor())
}

/// One picture in a format, as the driver gives it, and as it is read.
fn picture(device: &Device, encoding: Encoding, colour: Colour) -> Frame {
    let wanted = Format::new(SIZE[0] as u32, SIZE[1] as u32, FourCC::new(&encoding.fourcc()));
    let format = device.set_format(&wanted).unwrap();
    assert_eq!((format.fourcc, format.width, format.height), (wanted.fourcc, wanted.width, wanted.height));
    let mut stream = Stream::with_buffers(device, Type::VideoCapture, 2).unwrap();
    let (bytes, about) = stream.next().unwrap();
    let bytes = &bytes[..about.bytesused as usize];
    assert_eq!(bytes.len(), encoding.bytes_min(SIZE, format.stride as usize), "{}", encoding.name());
    encoding.frame(bytes, SIZE, format.stride as usize, colour).unwrap()
}

#[test]
fn colour_bars_are_the_same_in_every_format() {
    in_rig(Rig { vivid: Some(WEBCAM), ..Rig::default() }, || {
        let path = Path::new("/dev/video0");
        assert_eq!(ctl(path, &["--set-ctrl=test_pattern=0,osd_text_mode=2"]).status, Some(0));
        let device = Device::with_path(path).unwrap();
        let grey = [190.0, 176.0, 149.0, 136.0, 54.0, 40.0, 13.0, 0.0];
        // Luma of limited range: 16 is black.
        let luma = [179.0, 160.0, 130.0, 111.0, 83.0, 64.0, 34.0, 16.0];
        for encoding in Encoding::all().filter(|encoding| !encoding.is_compressed()) {
            let (name, saturation) = (encoding.name(), encoding.saturation());
            let frame = picture(&device, encoding, Colour::All);
            if frame.planes().len() == 1 {
                let expected = if name.starts_with(['G', 'Y']) && !name.starts_with("YU") { grey } else { luma };
                assert_eq!(bars(&frame, 0, saturation), expected, "{name}");
                continue;
            }
            for channel in 0..3 {
                let expected = BARS.map(|bar| if bar[channel] { LIT } else { 0.0 });
                assert_eq!(bars(&frame, channel, saturation), expected, "{name} channel {channel}");
            }
            let green = picture(&device, encoding, Colour::Green);
            assert_eq!(green.size(), encoding.size(SIZE, Colour::Green), "{name}");
            assert_eq!(bars(&green, 0, saturation), BARS.map(|bar| if bar[1] { LIT } else { 0.0 }), "{name}");
        }
    });
}
