//! The kernel driver's colour bars read the same in every pixel format.

use std::path::Path;
use std::time::Duration;

use isophote_capture::camera::FormatWanted;
use isophote_capture::{CameraSpec, Colour, Encoding, LiveCamera};
use isophote_tests::rig::{Rig, WEBCAM, in_rig, until};
use isophote_tracker::Frame;

use crate::ctl;

const DEVICE: &str = "/dev/video0";
const SIZE: [usize; 2] = [640, 360];
/// White, yellow, cyan, green, magenta, red, blue, black: red, green and blue of each bar.
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
/// Value of a lit colour: 75 % of 255, rounded.
const LIT: f64 = 191.0;

/// The middle of each bar in a plane, in 255ths of full scale: 10 bits are truncated to 8.
fn bars(frame: &Frame, plane: usize, saturation: f64) -> [f64; 8] {
    let (view, width) = (frame.plane_view(plane), frame.width());
    let shift = (saturation + 1.0) / 256.0;
    std::array::from_fn(|bar| (view.pixel((2 * bar + 1) * width / 16, frame.rows() / 2) / shift).floor())
}

fn camera(format: String, colour: Colour, size: [u32; 2], rate_hz: Option<f64>) -> LiveCamera {
    let format = FormatWanted { format: Some(format), size: Some(size), rate_hz };
    LiveCamera::open(CameraSpec { device: DEVICE.into(), format, colour, ..CameraSpec::default() }).unwrap()
}

fn next(camera: &mut LiveCamera) -> Frame {
    let frame = until("frame", Duration::from_secs(10), || camera.next(Duration::from_millis(200)));
    frame.unwrap_or_else(|error| panic!("{error}: {:?}", camera.state())).frame
}

/// One picture in a format, as a session would get it.
fn picture(encoding: Encoding, colour: Colour) -> Frame {
    let mut camera = camera(encoding.name(), colour, SIZE.map(|side| side as u32), None);
    assert_eq!(camera.size(), encoding.size(SIZE, colour));
    next(&mut camera)
}

/// 25 pictures per second: gaps in their numbers are exactly the lost frames.
#[test]
#[ignore = "long proof"]
fn sequence_gaps_equal_lost_frames() {
    in_rig(Rig { vivid: Some(WEBCAM), ..Rig::default() }, || {
        let path = Path::new(DEVICE);
        let run = |frames: u64, what: &str| {
            let mut camera = camera("GREY".into(), Colour::All, [640, 480], Some(25.0));
            let first = next(&mut camera).sequence;
            let before = camera.status().clone(); // a slow machine overtakes frames before the first one taken
            let last = (1..frames).map(|_| next(&mut camera).sequence).last().unwrap();
            let status = camera.status().clone();
            assert_eq!(status.rate_hz, Some(25.0));
            assert_eq!((status.damaged, status.reconnects), (0, 0), "{what}");
            let [gaps, overtaken] = [status.gaps - before.gaps, status.overtaken - before.overtaken];
            assert_eq!(last - first, frames - 1 + gaps + overtaken, "{what}: {before:?}, {status:?}");
            eprintln!("{what}: {frames} frames, {gaps} left out by the driver, {overtaken} overtaken");
            gaps
        };
        // A slow machine may lose a few; 30 % are more.
        let lost = run(100, "25 Hz");
        assert!(lost < 10, "{lost}");
        assert_eq!(ctl(path, &["--set-ctrl=percentage_of_dropped_buffers=30"]).status, Some(0));
        let dropped = run(100, "30 % dropped");
        assert!((20..80).contains(&dropped), "{dropped}");
        assert_eq!(ctl(path, &["--set-ctrl=percentage_of_dropped_buffers=0,wrap_sequence_number=1"]).status, Some(0));
        let wrapped = run(150, "wrapping numbers");
        assert!(wrapped < 15, "{wrapped}");
    });
}

#[test]
#[ignore = "long proof"]
fn colour_bars_are_the_same_in_every_format() {
    in_rig(Rig { vivid: Some(WEBCAM), ..Rig::default() }, || {
        let path = Path::new(DEVICE);
        assert_eq!(ctl(path, &["--set-ctrl=test_pattern=0,osd_text_mode=2"]).status, Some(0));
        let grey = [190.0, 176.0, 149.0, 136.0, 54.0, 40.0, 13.0, 0.0];
        // Limited-range luma: 16 is black.
        let luma = [179.0, 160.0, 130.0, 111.0, 83.0, 64.0, 34.0, 16.0];
        for encoding in Encoding::all().filter(|encoding| !encoding.is_compressed()) {
            let (name, saturation) = (encoding.name(), encoding.saturation());
            let frame = picture(encoding, Colour::All);
            if frame.planes().len() == 1 {
                let expected = if name.starts_with(['G', 'Y']) && !name.starts_with("YU") { grey } else { luma };
                assert_eq!(bars(&frame, 0, saturation), expected, "{name}");
                continue;
            }
            for channel in 0..3 {
                let expected = BARS.map(|bar| if bar[channel] { LIT } else { 0.0 });
                assert_eq!(bars(&frame, channel, saturation), expected, "{name} channel {channel}");
            }
            let green = picture(encoding, Colour::Green);
            assert_eq!(green.size(), encoding.size(SIZE, Colour::Green), "{name}");
            assert_eq!(bars(&green, 0, saturation), BARS.map(|bar| if bar[1] { LIT } else { 0.0 }), "{name}");
        }
    });
}
