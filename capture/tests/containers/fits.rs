//! FITS: number scaling, pages, volumes, and images after other HDUs.

use std::io::Read;

use isophote_capture::{FrameSource, Recording};
use isophote_jit::PixelFormat;

use crate::{frames, mutated, refusal};

/// Cards, END and padding.
fn header(cards: &[&str]) -> Vec<u8> {
    let mut bytes: Vec<u8> = cards.iter().chain(&["END"]).flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes
}

fn filled(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    bytes
}

fn image(bitpix: i64, axes: &[usize], more: &[&str], numbers: Vec<u8>) -> Vec<u8> {
    let mut cards = vec!["SIMPLE  =                    T / conforms".to_string()];
    cards.push(format!("BITPIX  = {bitpix:>20} / bits"));
    cards.push(format!("NAXIS   = {:>20}", axes.len()));
    cards.extend(axes.iter().enumerate().map(|(i, n)| format!("{:<8}= {n:>20}", format!("NAXIS{}", i + 1))));
    cards.push("OBJECT  = 'a / b''s'           / not a number".into());
    cards.push("COMMENT BITPIX  = 99".into());
    cards.extend(more.iter().map(|card| card.to_string()));
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    [header(&cards), filled(numbers)].concat()
}

/// Every number type at both ends of its range; the first row of the file is y = 0.
#[test]
fn header_scaling_is_applied() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.fits");
    let i16s = |values: [i16; 6]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    let i32s = |values: [i32; 6]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    let f32s = |values: [f32; 6]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    let f64s = |values: [f64; 6]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    let unsigned = ["BZERO   =                32768", "BSCALE  =                  1.0"];
    let blank = [unsigned[0], "BLANK   = 0"];
    let nan = f64::NAN;
    type Case<'a> = (i64, &'a [&'a str], Vec<u8>, PixelFormat, [f64; 6]);
    let cases: Vec<Case> = vec![
        (8, &[], vec![0, 1, 2, 3, 254, 255], PixelFormat::U8, [0.0, 1.0, 2.0, 3.0, 254.0, 255.0]),
        (
            8,
            &["BZERO   = -128"],
            vec![0, 127, 128, 129, 1, 255],
            PixelFormat::F32,
            [-128.0, -1.0, 0.0, 1.0, -127.0, 127.0],
        ),
        (
            16,
            &unsigned,
            i16s([-32768, -1, 0, 1, 32767, 5]),
            PixelFormat::U16,
            [0.0, 32767.0, 32768.0, 32769.0, 65535.0, 32773.0],
        ),
        (16, &[], i16s([-32768, -1, 0, 1, 32767, 5]), PixelFormat::F32, [-32768.0, -1.0, 0.0, 1.0, 32767.0, 5.0]),
        (
            16,
            &["BZERO   = 1.0D1 / ten", "BSCALE  = 2.5E-1", "BLANK   = -32768"],
            i16s([-32768, -4, 0, 1, 2, 4]),
            PixelFormat::F32,
            [nan, 9.0, 10.0, 10.25, 10.5, 11.0],
        ),
        // With BLANK, even unsigned numbers may be NaN.
        (16, &blank, i16s([1, 0, 2, 3, 4, 5]), PixelFormat::F32, [32769.0, nan, 32770.0, 32771.0, 32772.0, 32773.0]),
        (
            32,
            &["BLANK   = 7"],
            i32s([-2_000_000, 0, 7, 1 << 24, i32::MIN, 1]),
            PixelFormat::F32,
            [-2e6, 0.0, nan, 16777216.0, -2147483648.0, 1.0],
        ),
        (
            -32,
            &[],
            f32s([1.5, -0.0, f32::NAN, 1e30, -1e-30, 0.1]),
            PixelFormat::F32,
            [1.5, 0.0, nan, f64::from(1e30f32), f64::from(-1e-30f32), f64::from(0.1f32)],
        ),
        (
            -32,
            &["BSCALE  = 2"],
            f32s([1.5, 0.0, 0.0, 0.0, 0.0, 0.25]),
            PixelFormat::F32,
            [3.0, 0.0, 0.0, 0.0, 0.0, 0.5],
        ),
        // Keywords without a value count as absent; floating point has no blank.
        (
            16,
            &["BZERO   = / unknown", "BSCALE  =", "BLANK   =   / none"],
            i16s([-32768, -1, 0, 1, 32767, 5]),
            PixelFormat::F32,
            [-32768.0, -1.0, 0.0, 1.0, 32767.0, 5.0],
        ),
        (
            -32,
            &["BLANK   = 'NaN'"],
            f32s([1.5, 0.0, 0.0, 0.0, 0.0, 0.25]),
            PixelFormat::F32,
            [1.5, 0.0, 0.0, 0.0, 0.0, 0.25],
        ),
        (-64, &[], f64s([0.1, 1e300, -1e-300, nan, 0.0, 1.0]), PixelFormat::F64, [0.1, 1e300, -1e-300, nan, 0.0, 1.0]),
    ];
    for (bitpix, more, stored, format, expected) in cases {
        std::fs::write(&path, image(bitpix, &[3, 2], more, stored)).unwrap();
        let mut recording = Recording::open(&path).unwrap();
        assert_eq!((recording.len(), recording.size()), (1, Some(vec![3, 2])));
        let captured = recording.next().unwrap().unwrap();
        assert_eq!((captured.file.as_deref(), captured.frame.planes()[0].format), (Some("field.fits"), format));
        for (i, value) in expected.iter().enumerate() {
            let found = captured.frame.plane_view(0).pixel(i % 3, i / 3);
            assert!(found == *value || found.is_nan() && value.is_nan(), "{bitpix} {more:?}: {found} for {value}");
        }
    }
}

#[test]
fn a_third_axis_gives_pages() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.FIT");
    std::fs::write(&path, image(8, &[3, 2, 4], &[], (0..24).collect())).unwrap();
    let mut pages = Recording::open(&path).unwrap();
    assert_eq!((pages.len(), pages.size()), (4, Some(vec![3, 2])));
    let found = frames(&mut pages);
    assert_eq!(found[3], ("cube.FIT#3".into(), vec![3, 2], (18..24).map(f64::from).collect()));
    let mut stack = Recording::of_dimensions(&path, 3).unwrap();
    assert_eq!(stack.size(), Some(vec![3, 2, 4]));
    assert_eq!(stack.next().unwrap().unwrap().frame.plane_view(0).pixel_at([2, 1, 3, 0]), 23.0);
    let error = Recording::of_dimensions(&path, 4).unwrap_err().to_string();
    assert!(error.contains("a FITS file of 4 pages, but the document has 4 coordinates"), "{error}");
    // Trailing axes of length one are ignored.
    std::fs::write(&path, image(8, &[3, 2, 1, 1], &[], (0..6).collect())).unwrap();
    assert_eq!(Recording::open(&path).unwrap().len(), 1);
}

#[test]
fn a_fourth_axis_gives_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("series.fits");
    std::fs::write(&path, image(8, &[3, 2, 4, 5], &[], (0..120).collect())).unwrap();
    let mut pages = Recording::open(&path).unwrap();
    assert_eq!((pages.len(), pages.size()), (20, Some(vec![3, 2])));
    assert_eq!(frames(&mut pages)[19], ("series.fits#19".into(), vec![3, 2], (114..120).map(f64::from).collect()));
    let mut volumes = Recording::of_dimensions(&path, 3).unwrap();
    assert_eq!((volumes.len(), volumes.size()), (5, Some(vec![3, 2, 4])));
    assert_eq!(volumes.next().unwrap().unwrap().file.as_deref(), Some("series.fits#0"));
    let second = volumes.next().unwrap().unwrap();
    assert_eq!(second.file.as_deref(), Some("series.fits#1"));
    assert_eq!(second.frame.plane_view(0).pixel_at([2, 1, 3, 0]), 47.0);
    let mut series = Recording::of_dimensions(&path, 4).unwrap();
    assert_eq!((series.len(), series.size()), (1, Some(vec![3, 2, 4, 5])));
    let whole = series.next().unwrap().unwrap();
    assert_eq!((whole.file.as_deref(), whole.frame.plane_view(0).pixel_at([1, 0, 2, 4])), (Some("series.fits"), 109.0));
    let error = Recording::of_dimensions(&path, 5).unwrap_err().to_string();
    assert!(error.contains("a FITS file of 5 volumes of 4 pages, but the document has 5 coordinates"), "{error}");
    // Volumes of a single slice are pages.
    std::fs::write(&path, image(8, &[3, 2, 1, 5], &[], (0..30).collect())).unwrap();
    assert_eq!(Recording::of_dimensions(&path, 3).unwrap().size(), Some(vec![3, 2, 5]));
}

/// The image may follow an empty primary array, a table and an empty image.
#[test]
fn the_first_image_with_pixels_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("late.fts");
    let empty = image(8, &[], &["EXTEND  =                    T"], Vec::new());
    let table = [
        "XTENSION= 'BINTABLE'           / a table",
        "BITPIX  = 8",
        "NAXIS   = 2",
        "NAXIS1  = 10",
        "NAXIS2  = 300",
        "PCOUNT  = 100",
        "GCOUNT  = 1",
    ];
    // The scaling keywords of a table may hold anything.
    let table = [&table[..], &["BZERO   = 'none'", "BLANK   = 'n/a'"]].concat();
    let extension = ["XTENSION= 'IMAGE   '", "BITPIX  = 8", "NAXIS   = 2"];
    let none = header(&[&extension[..], &["NAXIS1  = 0", "NAXIS2  = 5"]].concat());
    let some = header(&[&extension[..], &["NAXIS1  = 2", "NAXIS2  = 1", "PCOUNT  = 0", "GCOUNT  = 1"]].concat());
    let plane = [some, filled(vec![41, 42])].concat();
    let file = [empty.clone(), header(&table), filled(vec![0; 3100]), none.clone(), plane.clone()].concat();
    std::fs::write(&path, &file).unwrap();
    assert_eq!(frames(&mut Recording::open(&path).unwrap())[0].2, [41.0, 42.0]);

    let tiles = header(&[&table[..], &["ZIMAGE  =                    T"]].concat());
    let [no_image, funpack] = ["there is no image in it", "compressed in tiles; unpack it first: funpack"];
    for (bytes, words) in [
        ([empty.clone(), tiles.clone(), filled(vec![0; 3100])].concat(), funpack),
        // The first image with pixels is the tile-compressed one.
        ([empty.clone(), tiles, filled(vec![0; 3100]), plane].concat(), funpack),
        ([empty.clone(), header(&table), filled(vec![0; 3100])].concat(), no_image),
        ([empty.clone(), none].concat(), no_image),
        ([empty, b"something else".to_vec()].concat(), no_image),
        (b"SIMPLY".to_vec(), "but does not begin like one"),
    ] {
        std::fs::write(&path, &bytes).unwrap();
        let message = refusal(&path);
        assert!(message.contains("late.fts") && message.contains(words), "{message}");
        let packed = folder.path().join("late.fits.fz");
        std::fs::write(&packed, &bytes).unwrap();
        assert!(refusal(&packed).contains(words));
    }
}

#[test]
fn gzip_compressed_files_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let pack = |bytes: &[u8]| {
        let mut packed = Vec::new();
        flate2::read::GzEncoder::new(bytes, flate2::Compression::fast()).read_to_end(&mut packed).unwrap();
        packed
    };
    let whole = image(16, &[2, 1, 3], &["BZERO   = 32768"], vec![128, 1, 128, 2, 128, 3, 128, 4, 128, 5, 128, 6]);
    let packed = pack(&whole);
    for name in ["run.fits.gz", "run.FIT.gz", "run.fts"] {
        let path = folder.path().join(name);
        std::fs::write(&path, &packed).unwrap();
        let found = frames(&mut Recording::open(&path).unwrap());
        let pixels: Vec<f64> = found.into_iter().flat_map(|(.., pixels)| pixels).collect();
        assert_eq!(pixels, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "{name}");
    }
    let path = folder.path().join("bad.fits.gz");
    for (bytes, words) in [
        (packed[..packed.len() - 9].to_vec(), "bad.fits.gz: damaged: gzip cannot unpack it"),
        (pack(b"SIMPLY"), "but does not begin like one"),
        (b"SIMPLY".to_vec(), "but does not begin like one"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        assert!(refusal(&path).contains(words), "{}", refusal(&path));
    }
}

#[test]
fn errors_name_the_file_and_the_fault() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.fits");
    let cut = image(16, &[30, 20, 4], &[], vec![1; 4800]);
    for (bytes, words) in [
        (cut[..cut.len() - 2880].to_vec(), "bad.fits: damaged: page 2 is cut off: 480 of its 1200 bytes are there"),
        (cut[..400].to_vec(), "header 0 has no END"),
        (image(8, &[6], &[], vec![0; 6]), "its image has 1 axes (6); FITS is read with two (a picture), three (pages)"),
        (image(8, &[2, 2, 2, 3, 2], &[], vec![0; 48]), "its image has 5 axes (2×2×2×3×2)"),
        (image(64, &[2, 2], &[], vec![0; 32]), "BITPIX is 64; FITS is read with 8, 16, 32, −32 or −64"),
        (image(8, &[2, 2], &["BSCALE  = 0.0"], vec![0; 4]), "BSCALE = 0"),
        (image(8, &[2, 2], &["BZERO   = many / of them"], vec![0; 4]), "its header says BZERO = many"),
        (image(16, &[2, 2], &["BLANK   = 'none'"], vec![0; 8]), "its header says BLANK = 'none'"),
        (image(8, &[40_000, 2], &[], vec![0; 4]), "40000×2 px; a side may have 32768 px"),
        (image(8, &[30_000, 30_000], &[], vec![0; 4]), "is more than the 67108864 px"),
        (image(-64, &[8000, 8000], &[], vec![0; 4]), "page 0 is cut off: 2880 of its 512000000 bytes"),
        (image(8, &[1, 1, 1 << 40], &[], vec![0; 4]), "more than 1000000 pictures"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = refusal(&path);
        assert!(message.contains("bad.fits") && message.contains(words), "{message}");
    }
}

#[test]
fn hostile_files_are_refused_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let whole = image(16, &[4, 3, 2], &["BZERO   = 32768", "BLANK   = 9"], vec![3; 48]);
    // The header's numbers, and the first pixels.
    let head: Vec<u8> = whole[..10 * 80].to_vec();
    let path = folder.path().join("hostile.fits");
    let [read, refused] = mutated(&path, &whole, 800);
    assert!(read > 100 && refused > 50, "{read} {refused}");
    let short = [head, b"END".to_vec(), vec![b' '; 77], whole[2880..].to_vec()].concat();
    let [read, refused] = mutated(&path, &short, 800);
    assert!(read > 50 && refused > 200, "{read} {refused}");
}
