//! Y4M: luma as stored, frame by frame.

use isophote_capture::{FrameSource, Recording};
use isophote_jit::PixelFormat;

use crate::{frames, mutated, refusal};

/// Frames of `samples` bytes each; luma byte i of frame n is 10 n + i, chroma is 200.
fn video(header: &str, lines: &[&str], luma: usize, samples: usize) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 {header}\n").into_bytes();
    for (n, line) in lines.iter().enumerate() {
        bytes.extend_from_slice(format!("{line}\n").as_bytes());
        bytes.extend((0..samples).map(|i| if i < luma { (10 * n + i) as u8 } else { 200 }));
    }
    bytes
}

#[test]
fn luma_is_read_as_stored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.y4m");
    // 5 × 3 pixels of 8 bit with odd chroma sides, and a frame header with parameters.
    let lines = ["FRAME", "FRAME Ip XSHUTTER=3", "FRAME"];
    for (space, samples) in [(" C420jpeg", 27), (" C422", 33), (" C444", 45), (" Cmono", 15), ("", 27)] {
        let header = format!("W5 H3 F30000:1001 Ip A1:1{space} XYSCSS=420JPEG");
        std::fs::write(&path, video(&header, &lines, 15, samples)).unwrap();
        let mut recording = Recording::open(&path).unwrap();
        assert_eq!((recording.len(), recording.size()), (3, Some(vec![5, 3])), "{space}");
        let found = frames(&mut recording);
        for (n, frame) in found.iter().enumerate() {
            let pixels: Vec<f64> = (0..15).map(|i| (10 * n + i) as f64).collect();
            assert_eq!(*frame, (format!("run.y4m#{n}"), vec![5, 3], pixels), "{space}");
        }
        recording.rewind();
        assert_eq!(frames(&mut recording), found);
    }
}

#[test]
fn deep_pixels_are_little_endian() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.y4m");
    for (space, chroma) in [("C420p10", 4), ("Cmono16", 0), ("C422p12", 8)] {
        let mut bytes = format!("YUV4MPEG2 W4 H2 {space}\nFRAME\n").into_bytes();
        bytes.extend((0..8u16).flat_map(|i| (257 * i + 3).to_le_bytes()));
        bytes.extend(vec![9; 2 * chroma]);
        std::fs::write(&path, &bytes).unwrap();
        let captured = Recording::open(&path).unwrap().next().unwrap().unwrap();
        // A single frame has the file's name.
        assert_eq!(captured.file.as_deref(), Some("deep.y4m"));
        assert_eq!(captured.frame.planes()[0].format, PixelFormat::U16);
        assert_eq!(captured.frame.plane_view(0).pixel(3, 1), 257.0 * 7.0 + 3.0, "{space}");
    }
}

/// For three coordinates a video is a stack, like the pages of a TIFF; in a folder its frames follow those of the file
/// before.
#[test]
fn videos_are_stacks_and_count_in_folders() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = video("W4 H2 Cmono", &["FRAME"; 3], 8, 8);
    for name in ["a.y4m", "b.Y4M"] {
        std::fs::write(folder.path().join(name), &bytes).unwrap();
    }
    let mut stack = Recording::of_dimensions(folder.path().join("a.y4m"), 3).unwrap();
    assert_eq!((stack.len(), stack.size()), (1, Some(vec![4, 2, 3])));
    assert_eq!(stack.next().unwrap().unwrap().frame.plane_view(0).pixel_at([1, 1, 2, 0]), 25.0);
    let names: Vec<String> =
        frames(&mut Recording::open(folder.path()).unwrap()).into_iter().map(|frame| frame.0).collect();
    assert_eq!(names, ["a.y4m#0", "a.y4m#1", "a.y4m#2", "b.Y4M#0", "b.Y4M#1", "b.Y4M#2"]);
}

#[test]
fn errors_name_file_and_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.y4m");
    let whole = video("W4 H2 Cmono", &["FRAME"; 3], 8, 8);
    let two = whole.len() - 8;
    for (bytes, words) in [
        (&whole[..two + 5], "bad.y4m: damaged: frame 2 is cut off: 5 of its 8 bytes are there"),
        (&whole[..two], "frame 2 is cut off: 0 of its 8 bytes"),
        (&whole[..two - 3], "frame 2 does not begin with the line FRAME"),
        (&whole[..10], "its first line does not end"),
        (&whole[..22], "there is no picture in it"),
        (b"RIFF", "it is named .y4m but does not begin like one"),
        (b"YUV4MPEG2 W30000 H30000 Cmono\nFRAME\n", "is more than the 67108864 px"),
        (b"YUV4MPEG2 W8000 H8000 C444p16\nFRAME\n", "frame 0 is cut off: 0 of its 384000000 bytes"),
        (b"YUV4MPEG2 W4 H2 C410\nFRAME\n", "its colour space is C410"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = refusal(&path);
        assert!(message.contains("bad.y4m") && message.contains(words), "{message}");
    }
    // The frames before the cut are read.
    std::fs::write(&path, &whole[..two + 5]).unwrap();
    let mut recording = Recording::open(&path).unwrap();
    assert_eq!(recording.len(), 3);
    assert_eq!(recording.next().unwrap().unwrap().file.as_deref(), Some("bad.y4m#0"));
    assert_eq!(recording.next().unwrap().unwrap().frame.plane_view(0).pixel(0, 0), 10.0);
    assert!(recording.next().is_err());
    assert!(recording.next().unwrap().is_none());
}

#[test]
fn hostile_videos_are_refused_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let whole = video("W4 H2 F25:1 C420p10", &["FRAME", "FRAME Ip", "FRAME"], 16, 24);
    let [read, refused] = mutated(&folder.path().join("hostile.y4m"), &whole, 1500);
    assert!(read > 150 && refused > 150, "{read} {refused}");
}
