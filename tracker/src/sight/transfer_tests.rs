#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::Noise;
use isophote_frame::Plane;

const ELECTRONS: f64 = 19.6;
const READ_E: f64 = 15.0;

/// A ramp of light under a flickering lamp, with something that moves across a corner.
fn frames(count: usize, brightest: f64, seed: u64) -> Vec<Frame> {
    let mut random = Noise(seed);
    let frame = |number: usize| {
        let lamp = 1.0 + 0.02 * (number % 3) as f64;
        let mut pixel = |at: usize| {
            let (x, y) = (at % 128, at / 128);
            let is_passed = y < 6 && x / 8 == number % 16;
            let light = if is_passed { 240.0 } else { 12.0 + brightest * x as f64 / 128.0 };
            let electrons = light * lamp * ELECTRONS;
            let scatter_e = (electrons + READ_E * READ_E).sqrt(); // nearly normal for this many electrons
            ((electrons + scatter_e * random.normal()) / ELECTRONS).round().clamp(0.0, 255.0) as u8
        };
        frame_of((0..128 * 96).map(&mut pixel).collect(), [128, 96])
    };
    (0..count).map(frame).collect()
}

fn frame_of(bytes: Vec<u8>, size: [usize; 2]) -> Frame {
    Frame::new(&size, vec![Plane::owned(PixelFormat::U8, bytes, size[0])]).unwrap()
}

fn measured(frames: &[Frame]) -> Result<MeasuredNoise, NoiseFault> {
    let mut measurement = NoiseMeasurement::new(NoiseOptions { black: 0.0, saturation: None, rounding_gain: 0.0 });
    frames.iter().try_for_each(|frame| measurement.add(frame))?;
    measurement.finish()
}

#[test]
fn gain_and_read_noise_agree_with_their_errors() {
    for seed in 1..=5 {
        let found = measured(&frames(20, 180.0, seed)).unwrap();
        let [electrons, sigma] = found.electrons_per_dn;
        assert!((electrons - ELECTRONS).abs() < 4.0 * sigma && sigma < 0.02 * ELECTRONS, "{found:?}");
        let [read_e, sigma] = found.read_noise_e.unwrap();
        assert!((read_e - READ_E).abs() < 4.0 * sigma && sigma < 0.1 * READ_E, "{found:?}");
        assert!(found.reduced_chi_square < 2.0 && (0.001..0.02).contains(&found.left_out), "{found:?}");
    }
}

/// Row offsets of 2 DN are separated from the noise of the pixels.
#[test]
fn row_offsets_are_separated_from_pixel_noise() {
    for seed in 1..=5 {
        let mut random = Noise(seed + 70);
        let row_of = |row: &[u8], offset: f64| {
            row.iter().map(|value| (f64::from(*value) + offset).round().clamp(0.0, 255.0) as u8).collect::<Vec<u8>>()
        };
        let off = |frame: &Frame| {
            let view = frame.plane_view(0);
            let rows = (0..96).map(|y| (0..128).map(|x| view.pixel(x, y) as u8).collect::<Vec<u8>>());
            frame_of(rows.flat_map(|row| row_of(&row, 2.0 * random.normal())).collect(), [128, 96])
        };
        let clean = frames(20, 180.0, seed);
        let even = measured(&clean).unwrap();
        assert_eq!(even.row_noise_e, None, "{even:?}");
        let found = measured(&clean.iter().map(off).collect::<Vec<Frame>>()).unwrap();
        let [rows_e, sigma] = found.row_noise_e.unwrap();
        assert!((rows_e - 2.0 * ELECTRONS).abs() < 4.0 * sigma && sigma < 0.1 * rows_e, "{found:?}");
        let [electrons, sigma] = found.electrons_per_dn;
        assert!((electrons - ELECTRONS).abs() < 4.0 * sigma && sigma < 0.02 * ELECTRONS, "{found:?}");
        // Offsets are rounded again with their pixels: 1/12 DN².
        let [read_e, sigma] = found.read_noise_e.unwrap();
        let expected_e = (READ_E * READ_E + ELECTRONS * ELECTRONS / 12.0).sqrt();
        assert!((read_e - expected_e).abs() < 4.0 * sigma && sigma < 0.1 * READ_E, "{found:?}");
    }
}

/// From a 12-bit sensor that clips at 4,095, in 16-bit words.
#[test]
fn clipped_pixels_are_excluded() {
    let mut random = Noise(3);
    let mut frame = |_| {
        let mut pixel = |at: usize| {
            let light = 40.0 + 36.0 * (at % 128) as f64;
            let value = light + (light / 4.0 + 9.0).sqrt() * random.normal();
            (value.round().clamp(0.0, 4095.0) as u16).to_ne_bytes()
        };
        let bytes = (0..128 * 96).flat_map(&mut pixel).collect();
        Frame::new(&[128, 96], vec![Plane::owned(PixelFormat::U16, bytes, 128)]).unwrap()
    };
    let frames: Vec<Frame> = (0..16).map(&mut frame).collect();
    let found = measured(&frames).unwrap();
    let ([electrons, sigma], [read_e, read_sigma]) = (found.electrons_per_dn, found.read_noise_e.unwrap());
    assert!((electrons - 4.0).abs() < 4.0 * sigma && (read_e - 12.0).abs() < 4.0 * read_sigma, "{found:?}");
    assert!(found.range[1] < 4000.0, "{found:?}");
}

#[test]
fn unsuitable_frames_are_refused() {
    assert_eq!(measured(&frames(1, 180.0, 1)), Err(NoiseFault::FewFrames(1)));
    let alike = frames(2, 180.0, 1);
    assert_eq!(measured(&[alike[0].clone(), alike[0].clone()]), Err(NoiseFault::Silent));
    // A smooth spot with a camera that shakes by `step` px.
    let scene = |amplitude: f64, step: f64| -> Vec<Frame> {
        let mut random = Noise(5);
        let mut frame = |number: usize| {
            let mut pixel = |at: usize| {
                let shift = if number.is_multiple_of(2) { step } else { 0.0 };
                let (x, y) = ((at % 128) as f64 - 64.0 - shift, (at / 128) as f64 - 48.0 - shift);
                let light = 20.0 + amplitude * (-(x * x + y * y) / 800.0).exp();
                (light + (light / ELECTRONS + 0.6).sqrt() * random.normal()).round().clamp(0.0, 255.0) as u8
            };
            frame_of((0..128 * 96).map(&mut pixel).collect(), [128, 96])
        };
        (0..12).map(&mut frame).collect()
    };
    assert!(measured(&scene(160.0, 0.0)).is_ok());
    assert!(matches!(measured(&scene(0.0, 0.0)), Err(NoiseFault::Narrow(..))));
    for step in [0.3, 1.0] {
        let found = measured(&scene(160.0, step));
        assert!(matches!(found, Err(NoiseFault::Moving(_))), "{step} px: {found:?}");
    }
    let mut moving = frames(4, 180.0, 1);
    for (number, frame) in moving.iter_mut().enumerate() {
        let pixel = |at: usize| if (at / 4 + at / 512 + number).is_multiple_of(5) { 200 } else { 40 + (at % 3) as u8 };
        *frame = frame_of((0..128 * 96).map(pixel).collect(), [128, 96]);
    }
    assert!(
        matches!(measured(&moving), Err(NoiseFault::Moving(_) | NoiseFault::Narrow(..))),
        "{:?}",
        measured(&moving)
    );
    let other = frame_of(vec![0; 64], [8, 8]);
    assert!(matches!(measured(&[alike[0].clone(), other]), Err(NoiseFault::Unlike(..))));
}
