//! Frames of known truth through a loopback device are read back byte for byte.

use std::path::Path;
use std::sync::Arc;

use isophote_capture::{Colour, Encoding, SyntheticSpec};
use isophote_symbolic::Model;
use isophote_tests::loopback::{Film, Writer, number, number_of};
use isophote_tests::repository;
use isophote_tests::rig::{LOOPBACK, Rig, in_rig};

use crate::stream;

const SIZE: [usize; 2] = [160, 120];
const PICTURES: usize = 8;

/// A spot on a known path.
fn moving() -> SyntheticSpec {
    let text = std::fs::read_to_string(repository().join("models/spot.toml")).unwrap();
    let mut spec = SyntheticSpec::new(Arc::new(Model::from_toml(&text).unwrap()));
    [spec.width, spec.height] = SIZE;
    (spec.samples, spec.rate_hz) = (2, 20.0);
    spec.motion.insert("bx".into(), "50 + 60*t".into());
    spec.motion.insert("by".into(), "60 - 20*t".into());
    spec
}

#[test]
#[ignore = "long proof"]
fn loopback_frames_are_read_back_unchanged() {
    in_rig(Rig { loopback: Some(LOOPBACK), ..Rig::default() }, || {
        let device = Path::new("/dev/video0");
        for (fourcc, bytes_per_pixel) in [(*b"GREY", 1), (*b"YUYV", 2)] {
            let film = Film::render(moving(), PICTURES, fourcc).unwrap();
            let playing = film.play(device, 20.0).unwrap();
            let name = String::from_utf8(fourcc.to_vec()).unwrap();
            let bytes = stream(device, &name, SIZE, 6);
            let shown = playing.stop().unwrap();
            let pictures = bytes.chunks_exact(SIZE[0] * SIZE[1] * bytes_per_pixel);
            assert_eq!(pictures.len(), 6, "{name}");
            for picture in pictures {
                let stride = SIZE[0] * bytes_per_pixel;
                let frame = Encoding::of(fourcc).unwrap().frame(picture, SIZE, stride, Colour::All).unwrap();
                let n = number_of(&frame);
                assert!(n < shown, "{name}: picture {n} of {shown}");
                let mut written = film.pictures[n as usize % PICTURES].clone();
                number(&mut written, fourcc, n);
                assert!(picture == written, "{name}: picture {n} is not as it was written");
                // Truth is indexed by the sequence number: the pixel there is bright.
                let truth = film.truth(n);
                assert_eq!(truth["bx"], 50.0 + 3.0 * f64::from(n % PICTURES as u32));
                let [x, y] = ["bx", "by"].map(|name| truth[name].round() as usize);
                assert!(frame.plane_view(0).pixel(x, y) > frame.plane_view(0).pixel(5, 5) + 50.0);
            }
        }
        // RGB from a writer without a film; a picture of wrong length is rejected.
        let mut writer = Writer::open(device, *b"RGB3", SIZE).unwrap();
        assert!(writer.write(&[0; 100]).is_err());
        writer.write(&vec![7; 3 * SIZE[0] * SIZE[1]]).unwrap();
    });
}
