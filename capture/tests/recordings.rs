//! Recordings from folders and files: order, formats, truth, and errors for damaged ones.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};
use isophote_capture::{FrameSource, Recording, SourceError, encode_png};
use isophote_jit::PixelFormat;

fn gray(path: &Path, value: u8) {
    std::fs::write(path, encode_png(3, 2, PixelFormat::U8, &[value; 6]).unwrap()).unwrap();
}

fn names(recording: &mut Recording) -> Vec<String> {
    std::iter::from_fn(|| recording.next().unwrap()).map(|captured| captured.file.unwrap()).collect()
}

#[test]
fn folders_yield_only_images_in_natural_order() {
    let folder = tempfile::tempdir().unwrap();
    for (i, name) in ["f10.png", "f2.png", "f1.png", "F3.PNG"].iter().enumerate() {
        gray(&folder.path().join(name), i as u8);
    }
    for other in ["LICENSE.txt", "notes.md", "table.csv", "f0.bmp"] {
        std::fs::write(folder.path().join(other), "x\n1\n").unwrap();
    }
    std::fs::create_dir(folder.path().join("more.png")).unwrap();
    let mut recording = Recording::open(folder.path()).unwrap();
    assert_eq!(recording.len(), 4);
    assert_eq!(recording.size(), Some(vec![3, 2]));
    assert_eq!(names(&mut recording), ["F3.PNG", "f1.png", "f2.png", "f10.png"]);
    recording.rewind();
    let again = recording.next().unwrap().unwrap();
    assert_eq!((again.frame.sequence, again.frame.plane_view(0).pixel(2, 1)), (4, 3.0));
}

/// Recordings of other formats are ignored next to pictures; without pictures they are the frames.
#[test]
fn other_recordings_are_ignored_next_to_pictures() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.mcap", "b.y4m", "c.fits.fz"] {
        std::fs::write(folder.path().join(name), "not even one").unwrap();
    }
    assert!(Recording::open(folder.path()).unwrap_err().to_string().contains("a.mcap"));
    assert!(Recording::of_dimensions(folder.path(), 3).unwrap_err().to_string().contains("a.mcap"));
    gray(&folder.path().join("1.png"), 1);
    gray(&folder.path().join("2.png"), 2);
    assert_eq!(names(&mut Recording::open(folder.path()).unwrap()), ["1.png", "2.png"]);
    assert_eq!(Recording::of_dimensions(folder.path(), 3).unwrap().size(), Some(vec![3, 2, 2]));
}

/// Every pixel of every kind of PNG reads back as written.
#[test]
fn pixels_round_trip_at_8_and_16_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (width, height) = (7, 5);
    let sample = |i: usize| (i * 7919 % 65_536) as u16;
    for channels in 1..=4usize {
        for bits in [8, 16] {
            let values: Vec<u16> = (0..width * height * channels).map(|i| sample(i) >> (16 - bits)).collect();
            let bytes: Vec<u8> = values.iter().map(|v| *v as u8).collect();
            let image = match (channels, bits) {
                (1, 8) => DynamicImage::ImageLuma8(image::ImageBuffer::from_raw(7, 5, bytes).unwrap()),
                (2, 8) => DynamicImage::ImageLumaA8(image::ImageBuffer::from_raw(7, 5, bytes).unwrap()),
                (3, 8) => DynamicImage::ImageRgb8(image::ImageBuffer::from_raw(7, 5, bytes).unwrap()),
                (4, 8) => DynamicImage::ImageRgba8(image::ImageBuffer::from_raw(7, 5, bytes).unwrap()),
                (1, _) => DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(7, 5, values.clone()).unwrap()),
                (2, _) => DynamicImage::ImageLumaA16(image::ImageBuffer::from_raw(7, 5, values.clone()).unwrap()),
                (3, _) => DynamicImage::ImageRgb16(image::ImageBuffer::from_raw(7, 5, values.clone()).unwrap()),
                _ => DynamicImage::ImageRgba16(image::ImageBuffer::from_raw(7, 5, values.clone()).unwrap()),
            };
            let path = folder.path().join("frame.png");
            image.save_with_format(&path, ImageFormat::Png).unwrap();
            let frame = Recording::open(&path).unwrap().next().unwrap().unwrap().frame;
            let planes = if channels < 3 { 1 } else { 3 };
            assert_eq!((frame.size(), frame.planes().len()), (&[width, height][..], planes));
            for (i, value) in values.iter().enumerate() {
                let (pixel, channel) = (i / channels, i % channels);
                if channel < planes {
                    let found = frame.plane_view(channel).pixel(pixel % width, pixel / width);
                    assert_eq!(found, f64::from(*value), "{channels} channels, {bits} bit, sample {i}");
                }
            }
        }
    }
}

#[test]
fn palettes_become_colours() {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 4, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Two);
    encoder.set_palette(vec![0, 0, 0, 10, 20, 30, 40, 50, 60, 200, 200, 200]);
    encoder.write_header().unwrap().write_image_data(&[0b00_01_10_11]).unwrap();
    let frame = isophote_capture::decode(&bytes).unwrap();
    assert_eq!(frame.planes().len(), 3);
    let found: Vec<f64> = (0..4).map(|x| frame.plane_view(2).pixel(x, 0)).collect();
    assert_eq!(found, [0.0, 30.0, 60.0, 200.0]);
    assert_eq!(frame.luma().plane_view(0).pixel(3, 0), 200.0);
}

#[test]
fn animated_pngs_are_rejected_with_their_frame_count() {
    let image = |frames: Option<u32>| {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(png::ColorType::Grayscale);
        frames.into_iter().for_each(|frames| encoder.set_animated(frames, 0).unwrap());
        let mut writer = encoder.write_header().unwrap();
        (0..frames.unwrap_or(1)).for_each(|frame| writer.write_image_data(&[frame as u8, 9]).unwrap());
        writer.finish().unwrap();
        bytes
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("moving.png");
    std::fs::write(&path, image(Some(4))).unwrap();
    let message = Recording::open(&path).unwrap().next().unwrap_err().to_string();
    assert!(message.contains("moving.png: it is an animated PNG of 4 frames; convert it to Y4M"), "{message}");
    assert!(isophote_capture::decode(&image(Some(2))).unwrap_err().to_string().contains("of 2 frames"));
    for one in [image(None), image(Some(1))] {
        assert_eq!(isophote_capture::decode(&one).unwrap().plane_view(0).pixel(1, 0), 9.0);
    }
}

#[test]
fn encoded_16_bit_png_round_trips() {
    let values: Vec<u16> = (0..640 * 48).map(|i| (i * 40_503 % 65_536) as u16).collect();
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let frame = isophote_capture::decode(&encode_png(640, 48, PixelFormat::U16, &bytes).unwrap()).unwrap();
    assert_eq!(frame.planes()[0].buffer.bytes(), bytes);
    assert!(encode_png(640, 48, PixelFormat::F32, &bytes).is_err());
    assert!(encode_png(640, 47, PixelFormat::U16, &bytes).is_err());
}

#[test]
fn colour_maps_to_luma_for_one_channel_and_rgb_for_three() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("colour.png");
    RgbImage::from_fn(4, 3, |x, _| image::Rgb([200, 100, x as u8 * 10])).save(&path).unwrap();
    let one = Recording::open(&path).unwrap().for_channels(&["phi".into()]).next().unwrap().unwrap().frame;
    assert_eq!(one.planes().len(), 1);
    // Not rounded: 59.8 + 58.7 + 3.42.
    assert_eq!(one.plane_view(0).pixel(3, 2), f64::from(121.92f32));
    let names = ["r".to_string(), "g".into(), "b".into()];
    let three = Recording::open(&path).unwrap().for_channels(&names).next().unwrap().unwrap().frame;
    assert_eq!(three.plane_view(2).pixel(3, 2), 30.0);
    let two = Recording::open(&path).unwrap().for_channels(&names[..2]).next().unwrap_err();
    assert!(
        two.to_string().ends_with("a colour image has three channels (r, g, b), but the model reads 2: r, g"),
        "{two}"
    );
    gray(&path, 1);
    let gray = Recording::open(&path).unwrap().for_channels(&names).next().unwrap_err();
    assert!(gray.to_string().ends_with("a gray image has one channel, but the model reads 3: r, g, b"), "{gray}");
}

#[test]
fn jpeg_is_read_in_gray_and_colour() {
    let folder = tempfile::tempdir().unwrap();
    let (g, c) = (folder.path().join("g.jpg"), folder.path().join("h.jpeg"));
    GrayImage::from_pixel(16, 8, image::Luma([90])).save(&g).unwrap();
    RgbImage::from_pixel(16, 8, image::Rgb([90, 91, 92])).save(&c).unwrap();
    let mut recording = Recording::open(folder.path()).unwrap();
    let first = recording.next().unwrap().unwrap().frame;
    let second = recording.next().unwrap().unwrap().frame;
    assert_eq!((first.planes().len(), second.planes().len()), (1, 3));
    assert!((first.plane_view(0).pixel(8, 4) - 90.0).abs() <= 2.0);
}

/// Damage in the middle, or a half with an end marker, is an error, where most decoders fill with grey.
#[test]
fn damaged_jpegs_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let shade = |x: u32, y: u32| ((x * 37 + y * 91) % 251) as u8;
    let grey = DynamicImage::from(GrayImage::from_fn(96, 64, |x, y| image::Luma([shade(x, y)])));
    let colour = DynamicImage::from(RgbImage::from_fn(96, 64, |x, y| image::Rgb([shade(x, y), shade(y, x), 90])));
    for (name, image) in [("grey.jpg", grey), ("colour.jpg", colour)] {
        let path = folder.path().join(name);
        image.save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        assert!(isophote_capture::decode(&whole).is_ok());
        let middle = whole.len() / 2;
        let mut zeroed = whole.clone();
        zeroed[middle..middle + 200].fill(0);
        // Trailing bytes of other programs are ignored.
        assert!(isophote_capture::decode(&[&whole[..], &whole[..], &[0; 9]].concat()).is_ok());
        let half = [&whole[..middle], &[0xff, 0xd9]].concat();
        for damaged in [zeroed, half, whole[..middle].to_vec()] {
            std::fs::write(&path, damaged).unwrap();
            let message = Recording::open(&path).unwrap().next().unwrap_err().to_string();
            assert!(message.contains(name) && message.contains("damaged: the JPEG cannot be decoded"), "{message}");
        }
    }
}

/// Each error names the file and a remedy; the frame after a damaged one can still be read.
#[test]
fn damaged_files_are_reported_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let noisy = GrayImage::from_fn(64, 64, |x, y| image::Luma([(x * 37 + y * 91) as u8]));
    noisy.save(path("1.png")).unwrap();
    noisy.save(path("2.jpg")).unwrap();
    for name in ["1.png", "2.jpg"] {
        let whole = std::fs::read(path(name)).unwrap();
        std::fs::write(path(name), &whole[..whole.len() / 2]).unwrap();
    }
    std::fs::write(path("3.png"), b"GIF89a").unwrap();
    std::fs::write(path("4.png"), b"").unwrap();
    gray(&path("5.png"), 9);
    let mut recording = Recording::open(folder.path()).unwrap();
    for (name, word) in [("1.png", "damaged"), ("2.jpg", "damaged"), ("3.png", "not a PNG"), ("4.png", "not a PNG")] {
        let message = recording.next().unwrap_err().to_string();
        assert!(message.contains(name) && message.contains(word), "{message}");
    }
    assert_eq!(recording.next().unwrap().unwrap().frame.sequence, 4);
    assert!(recording.next().unwrap().is_none());
}

#[test]
fn unsupported_paths_are_rejected_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let message = |path: &Path| Recording::open(path).unwrap_err().to_string();
    assert!(message(&folder.path().join("none")).ends_with("none: no such file or folder"));
    assert!(
        message(folder.path()).contains("holds no frames; a recording is a folder of PNG, JPEG, TIFF or FITS files")
    );
    let bitmap = folder.path().join("a.bmp");
    std::fs::write(&bitmap, b"BM").unwrap();
    assert!(message(&bitmap).contains("convert it to PNG"));
    for (name, remedy) in [
        ("run.bag", "convert it to MCAP"),
        ("run.DB3", "convert it to MCAP"),
        ("star.fits.Z", "gunzip FILE"),
        ("curve.csv.gz", "gunzip FILE"),
        ("run.mcap.zst", "unzstd FILE"),
        ("run.avi", "ffmpeg -i FILE OUT.y4m"),
        ("moving.gif", "ffmpeg -i FILE OUT.y4m"),
        ("photo.heic", "convert it to JPEG"),
        ("photo.dng", "TIFF of 16 bits"),
        ("cube.npy", "TIFF (16 bit, or 32-bit float) or FITS"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, b"not read").unwrap();
        assert!(message(&path).contains(remedy), "{}", message(&path));
    }
    let png = folder.path().join("really.tif");
    gray(&png, 1);
    assert!(
        message(&png).contains("named .tif but does not begin like one; it begins like a PNG file"),
        "{}",
        message(&png)
    );
    let tiff = folder.path().join("really.png");
    stack(&tiff, 1);
    let refused = Recording::open(&tiff).unwrap().next().unwrap_err().to_string();
    assert!(refused.contains("its bytes are those of a TIFF file"), "{refused}");
    // A PNG whose header claims 30,000 × 30,000 pixels allocates no memory.
    let mut bomb = encode_png(1, 1, PixelFormat::U8, &[0]).unwrap();
    for i in [16, 20] {
        bomb[i..i + 4].copy_from_slice(&30_000u32.to_be_bytes());
    }
    let crc = crc32(&bomb[12..29]);
    bomb[29..33].copy_from_slice(&crc.to_be_bytes());
    let path = folder.path().join("bomb.png");
    std::fs::write(&path, bomb).unwrap();
    let error = Recording::open(&path).unwrap().next().unwrap_err();
    assert!(matches!(error, SourceError::TooLarge { .. }), "{error}");
}

#[test]
fn a_csv_file_is_one_frame_whose_header_names_the_channels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("curve.csv");
    std::fs::write(&path, "x,y\n0.5,1e3\n1.5,2e3\n2.5,3e3\n").unwrap();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.csv_channels().unwrap(), Some(vec!["x".into(), "y".into()]));
    let mut recording = recording.for_channels(&["y".into()]);
    let captured = recording.next().unwrap().unwrap();
    assert_eq!((captured.frame.size(), captured.frame.planes()[0].format), (&[3][..], PixelFormat::F64));
    assert_eq!(captured.frame.plane_view(0).pixel(2, 0), 3000.0);
    assert!(recording.next().unwrap().is_none());
}

#[test]
fn truth_is_read_from_the_frames_folder() {
    let folder = tempfile::tempdir().unwrap();
    gray(&folder.path().join("000000.png"), 1);
    gray(&folder.path().join("000001.png"), 1);
    let truth = folder.path().join("truth.jsonl");
    std::fs::write(&truth, "{\"frame\":1,\"file\":\"000001.png\",\"parameters\":{\"bx\":3.25}}\n").unwrap();
    let mut recording = Recording::open(folder.path()).unwrap();
    assert_eq!(recording.next().unwrap().unwrap().truth, None);
    assert_eq!(recording.next().unwrap().unwrap().truth.unwrap()["bx"], 3.25);
    std::fs::write(&truth, "{\"frame\":1}\n").unwrap();
    assert!(Recording::open(folder.path()).unwrap_err().to_string().contains("truth.jsonl:1: not a line of truth"));
}

/// CRC-32 of PNG chunks.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 1 { 0xedb8_8320 ^ (crc >> 1) } else { crc >> 1 };
    !bytes.iter().fold(!0u32, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), step))
}

/// Slices of 4 × 3 pixels: pixel (x, y) of slice n is 10 n + 4 y + x.
fn slices(count: usize) -> Vec<u8> {
    (0..12 * count).map(|i| (10 * (i / 12) + i % 12) as u8).collect()
}

fn stack(path: &Path, count: usize) {
    std::fs::write(path, isophote_capture::encode_tiff(4, 3, PixelFormat::U8, &slices(count)).unwrap()).unwrap();
}

fn picture(path: &Path, number: usize) {
    std::fs::write(path, encode_png(4, 3, PixelFormat::U8, &slices(number + 1)[12 * number..]).unwrap()).unwrap();
}

#[test]
fn pages_are_frames_of_two_dimensions_or_slices_of_three() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stack.tif");
    stack(&path, 5);
    let mut pages = Recording::open(&path).unwrap();
    assert_eq!((pages.len(), pages.size()), (5, Some(vec![4, 3])));
    for page in 0..5 {
        let captured = pages.next().unwrap().unwrap();
        assert_eq!(captured.file, Some(format!("stack.tif#{page}")));
        assert_eq!(captured.frame.plane_view(0).pixel(3, 2), (10 * page + 11) as f64);
    }
    assert!(pages.next().unwrap().is_none());
    pages.rewind();
    assert_eq!(pages.next().unwrap().unwrap().frame.plane_view(0).pixel(0, 0), 0.0);

    let mut volume = Recording::of_dimensions(&path, 3).unwrap();
    assert_eq!((volume.len(), volume.size()), (1, Some(vec![4, 3, 5])));
    let frame = volume.next().unwrap().unwrap();
    assert_eq!((frame.frame.size(), frame.file.as_deref()), (&[4, 3, 5][..], Some("stack.tif")));
    assert_eq!(frame.frame.plane_view(0).pixel_at([1, 2, 4, 0]), 49.0);

    // A folder of single pictures, one of them a single-page TIFF, gives the same volume.
    let pictures = folder.path().join("pictures");
    std::fs::create_dir(&pictures).unwrap();
    (0..4).for_each(|n| picture(&pictures.join(format!("p{n}.png")), n));
    let tiff = isophote_capture::encode_tiff(4, 3, PixelFormat::U8, &slices(5)[48..]).unwrap();
    std::fs::write(pictures.join("p4.tiff"), tiff).unwrap();
    let same = Recording::of_dimensions(&pictures, 3).unwrap().next().unwrap().unwrap();
    assert_eq!(same.file.as_deref(), Some("pictures"));
    assert_eq!(same.frame.planes()[0].buffer.bytes(), frame.frame.planes()[0].buffer.bytes());

    // Two folders of pictures, or two stacks, form a time series for four coordinates, and two frames for three.
    let series = folder.path().join("series");
    for volume in ["t0", "t1"] {
        std::fs::create_dir_all(series.join(volume)).unwrap();
        (0..3).for_each(|n| picture(&series.join(volume).join(format!("p{n}.png")), n));
    }
    let stacks = folder.path().join("stacks");
    std::fs::create_dir(&stacks).unwrap();
    ["t0.tiff", "t1.tiff"].iter().for_each(|name| stack(&stacks.join(name), 3));
    for path in [&series, &stacks] {
        let mut four = Recording::of_dimensions(path, 4).unwrap();
        assert_eq!((four.len(), four.size()), (1, Some(vec![4, 3, 3, 2])));
        assert_eq!(four.next().unwrap().unwrap().frame.plane_view(0).pixel_at([0, 1, 2, 1]), 24.0);
        let three = Recording::of_dimensions(path, 3).unwrap();
        assert_eq!((three.len(), three.size()), (2, Some(vec![4, 3, 3])));
    }
}

/// 16 bit, float, colour and LZW, as other programs write them.
#[test]
fn common_tiff_kinds_are_read() {
    use tiff::encoder::{Compression, TiffEncoder, colortype};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.tiff");
    let save = |write: &dyn Fn(std::fs::File)| {
        write(std::fs::File::create(&path).unwrap());
        Recording::open(&path).unwrap().next().map(|captured| captured.unwrap().frame)
    };
    let deep: Vec<u16> = (0..12).map(|i| 5000 * i).collect();
    let frame = save(&|file| {
        let mut encoder = TiffEncoder::new(file).unwrap().with_compression(Compression::Lzw);
        encoder.write_image::<colortype::Gray16>(4, 3, &deep).unwrap();
    });
    assert_eq!(frame.unwrap().plane_view(0).pixel(3, 2), 55_000.0);
    let floats: Vec<f32> = (0..12).map(|i| i as f32 - 0.25).collect();
    let frame =
        save(&|file| TiffEncoder::new(file).unwrap().write_image::<colortype::Gray32Float>(4, 3, &floats).unwrap());
    assert_eq!(frame.unwrap().plane_view(0).pixel(0, 1), 3.75);
    let colour: Vec<u8> = (0..36).collect();
    let frame = save(&|file| TiffEncoder::new(file).unwrap().write_image::<colortype::RGB8>(4, 3, &colour).unwrap());
    let frame = frame.unwrap();
    assert_eq!((frame.planes().len(), frame.plane_view(2).pixel(1, 0)), (3, 5.0));
    let wide: Vec<u32> = (0..12).collect();
    let frame = save(&|file| TiffEncoder::new(file).unwrap().write_image::<colortype::Gray32>(4, 3, &wide).unwrap());
    assert_eq!(frame.unwrap().plane_view(0).pixel(3, 2), 11.0);
}

#[test]
fn mismatched_pictures_and_dimensions_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("odd")).unwrap();
    (0..3).for_each(|n| picture(&path("odd").join(format!("p{n}.png")), n));
    std::fs::write(path("odd/p3.png"), encode_png(4, 4, PixelFormat::U8, &[0; 16]).unwrap()).unwrap();
    let error = Recording::of_dimensions(path("odd"), 3).unwrap().next().unwrap_err().to_string();
    assert!(error.contains("p3.png has 4×4 px of 8-bit gray where p0.png has 4×3 px"), "{error}");
    let mut file = std::fs::File::create(path("odd.tiff")).unwrap();
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
    encoder.write_image::<tiff::encoder::colortype::Gray8>(2, 2, &[0; 4]).unwrap();
    encoder.write_image::<tiff::encoder::colortype::Gray16>(2, 2, &[0; 4]).unwrap();
    let error = Recording::of_dimensions(path("odd.tiff"), 3).unwrap().next().unwrap_err().to_string();
    assert!(error.contains("odd.tiff#1 has 2×2 px of 16-bit gray where odd.tiff#0 has 2×2 px of 8-bit"), "{error}");

    std::fs::create_dir(path("deep")).unwrap();
    stack(&path("deep/t0.tiff"), 3);
    stack(&path("deep/t1.tiff"), 4);
    let error = Recording::of_dimensions(path("deep"), 4).unwrap().next().unwrap_err().to_string();
    assert!(error.contains("t1.tiff: it has 4 slices where t0.tiff has 3"), "{error}");
    picture(&path("deep/t2.png"), 0);
    let error = Recording::of_dimensions(path("deep"), 4).unwrap_err().to_string();
    assert!(error.contains("t2.png: one picture where t0.tiff is a TIFF of 3 pages"), "{error}");

    picture(&path("one.png"), 0);
    std::fs::create_dir(path("single")).unwrap();
    picture(&path("single/p0.png"), 0);
    for (name, dimensions, words) in [
        ("one.png", 3, "one picture, but the document has 3 coordinates"),
        ("single", 3, "a folder of one picture, but the document has 3"),
        ("odd.tiff", 4, "a TIFF of 2 pages, but the document has 4"),
        ("odd", 4, "a folder of 4 pictures, but the document has 4 coordinates and is fitted to a folder of TIFFs"),
    ] {
        let error = Recording::of_dimensions(path(name), dimensions).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    std::fs::write(path("broken.tiff"), b"II*\0\x08\0\0\0").unwrap();
    std::fs::write(path("text.tiff"), b"not a picture").unwrap();
    let whole = std::fs::read(path("deep/t0.tiff")).unwrap();
    std::fs::write(path("cut.tiff"), &whole[..whole.len() - 9]).unwrap();
    for (name, words) in
        [("broken.tiff", "damaged"), ("cut.tiff", "damaged"), ("text.tiff", "named .tiff but does not begin")]
    {
        for dimensions in [2, 3] {
            let error = Recording::of_dimensions(path(name), dimensions).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(words), "{error}");
        }
    }
}

/// Any TIFF is read or rejected.
#[test]
fn hostile_tiffs_are_refused_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hostile.tiff");
    let whole = isophote_capture::encode_tiff(4, 3, PixelFormat::U16, &[7; 24 * 3]).unwrap();
    let mut state: u64 = 5;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let (mut read, mut refused) = (0, 0);
    for _ in 0..1500 {
        let mut bytes = whole.clone();
        for _ in 0..1 + random(3) {
            let at = random(bytes.len());
            bytes[at] = [0, 1, 2, 3, 255, 128, random(256) as u8][random(7)];
        }
        bytes.truncate(bytes.len() - if random(4) == 0 { random(bytes.len()) } else { 0 });
        std::fs::write(&path, &bytes).unwrap();
        for dimensions in [2, 3] {
            let outcome = Recording::of_dimensions(&path, dimensions).and_then(|mut recording| {
                for _ in 0..recording.len().min(5) {
                    recording.next()?;
                }
                Ok(())
            });
            *if outcome.is_ok() { &mut read } else { &mut refused } += 1;
        }
    }
    assert!(read > 100 && refused > 500, "{read} {refused}");
}

/// A volume that is too large is rejected by its first picture, before memory is allocated.
#[test]
fn volumes_beyond_the_limit_are_rejected_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let side = 4096;
    let bytes = encode_png(side, side, PixelFormat::U8, &vec![0; side * side]).unwrap();
    (0..5).for_each(|n| std::fs::write(folder.path().join(format!("p{n}.png")), &bytes).unwrap());
    let error = Recording::of_dimensions(folder.path(), 3).unwrap().next().unwrap_err().to_string();
    assert!(error.contains("4096×4096×5 px are more than the 67108864") && error.contains("crop or bin"), "{error}");
}
