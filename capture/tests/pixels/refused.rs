//! Invalid pictures are rejected with an error that states the remedy.

use isophote_capture::{Colour, Encoding, LIMITS, PixelsError};

const COLOURS: [Colour; 4] = [Colour::All, Colour::Red, Colour::Green, Colour::Blue];

/// Exactly `bytes_min` bytes suffice, and one less does not.
#[test]
fn short_pictures_report_the_missing_bytes() {
    for encoding in Encoding::all().filter(|encoding| !encoding.is_compressed()) {
        for (size, stride) in [([2, 2], 64), ([5, 3], 31), ([16, 16], 48), ([641, 481], 1923)] {
            let least = encoding.bytes_min(size, stride);
            let bytes = vec![1; least];
            for colour in COLOURS.into_iter().filter(|colour| encoding.has(*colour)) {
                assert!(encoding.frame(&bytes, size, stride, colour).is_ok(), "{encoding:?} {size:?}");
                for got in [least - 1, least / 2, 1, 0] {
                    let error = encoding.frame(&bytes[..got], size, stride, colour).unwrap_err();
                    let said =
                        matches!(error, PixelsError::Short { expected, got: said } if (expected, said) == (least, got));
                    assert!(said, "{error}");
                    assert!(error.to_string().contains(&format!("has {least} bytes; this one has {got}")), "{error}");
                }
            }
        }
    }
}

/// Bytes of complete pictures as kernels allocate them, rows without padding.
#[test]
fn minimum_bytes_match_driver_allocations() {
    let sizes = [("GREY", 640, 307_200), ("Y10 ", 1280, 614_400), ("YUYV", 1280, 614_400), ("NV12", 640, 460_800)];
    let more = [("YU12", 640, 460_800), ("RGB3", 1920, 921_600), ("RGGB", 640, 307_200), ("RG12", 1280, 614_400)];
    for (code, stride, bytes) in sizes.into_iter().chain(more).chain([("MJPG", 0, 0)]) {
        let encoding = Encoding::of(code.as_bytes().try_into().unwrap()).unwrap();
        assert_eq!(encoding.bytes_min([640, 480], stride), bytes, "{code}");
    }
    // Odd sides: 641 · 481 of luma and twice 321 · 241 of chroma.
    for code in [b"NV12", b"YU12"] {
        assert_eq!(Encoding::of(*code).unwrap().bytes_min([641, 481], 641), 641 * 481 + 2 * 321 * 241);
    }
}

#[test]
fn sizes_strides_and_colours_are_checked() {
    let of = |code: &[u8; 4]| Encoding::of(*code).unwrap();
    let bytes = vec![0; 4096];
    let side = LIMITS.side_px as usize;
    for encoding in Encoding::all() {
        for size in [[0, 4], [4, 0], [side + 1, 2], [2, side + 1], [side, side], [usize::MAX, usize::MAX]] {
            let error = encoding.frame(&bytes, size, 4096, Colour::All).unwrap_err();
            assert!(matches!(error, PixelsError::Size { .. }), "{encoding:?} {size:?}: {error}");
        }
        if encoding.is_bayer() {
            assert!(matches!(encoding.frame(&bytes, [1, 4], 64, Colour::Red), Err(PixelsError::Size { .. })));
        }
        if !encoding.is_compressed() {
            for stride in [0, 1, 7] {
                let error = encoding.frame(&bytes, [8, 8], stride, Colour::All).unwrap_err();
                assert!(matches!(error, PixelsError::Stride { given, .. } if given == stride), "{error}");
            }
            let error = encoding.frame(&bytes, [8, 8], usize::MAX, Colour::All).unwrap_err();
            assert!(matches!(error, PixelsError::Short { got: 4096, .. }), "{error}");
        }
    }
    // A side at its limit passes; the bytes are missing.
    assert!(matches!(of(b"GREY").frame(&bytes, [side, 1], side, Colour::All), Err(PixelsError::Short { .. })));
    for code in [b"GREY", b"Y16 ", b"YUYV", b"UYVY", b"NV12", b"YU12"] {
        for colour in [Colour::Red, Colour::Green, Colour::Blue] {
            assert!(!of(code).has(colour));
            assert!(matches!(of(code).frame(&bytes, [8, 8], 64, colour), Err(PixelsError::NoColour { .. })));
        }
    }
}

#[test]
fn colours_serialize_in_lower_case() {
    for (colour, name) in COLOURS.into_iter().zip(["\"all\"", "\"red\"", "\"green\"", "\"blue\""]) {
        assert_eq!(serde_json::to_string(&colour).unwrap(), name);
        assert_eq!(serde_json::from_str::<Colour>(name).unwrap(), colour);
    }
    assert_eq!(Colour::default(), Colour::All);
}
