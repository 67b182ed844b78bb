//! Frames of known mixing.

use super::*;
use crate::picture::Noise;
use isophote_frame::Plane;
use isophote_jit::PixelFormat;

const WIDTH: usize = 200;
const HEIGHT: usize = 150;
/// Shares of 25 % and 10 %.
const MIXING: [[f64; 3]; 3] = [[1.0, 0.25, 0.10], [0.10, 1.0, 0.25], [0.25, 0.10, 1.0]];
const PLACES: [[f64; 2]; 3] = [[50.3, 48.6], [145.2, 52.1], [98.7, 105.4]];
/// DN per electron, and the noise of a dark pixel in DN.
const GAIN: f64 = 0.051;
const READ_NOISE: f64 = 0.765;

/// A round spot of radius 30 px, 1 in the middle.
fn spot([cx, cy]: [f64; 2], x: usize, y: usize) -> f64 {
    let s = ((x as f64 - cx).powi(2) + (y as f64 - cy).powi(2)) / 900.0;
    if s <= 1.0 { 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s } else { 0.0 }
}

/// Lights by channel and position; `noise`: 0 or 1 times that of the camera.
fn frame(
    mixing: [[f64; 3]; 3],
    light: impl Fn(usize, usize) -> [f64; 3],
    noise: f64,
    random: &mut Noise,
    spoil: impl Fn(usize, usize, usize) -> f64,
) -> Frame {
    let planes = (0..3).map(|channel| {
        let mut bytes = Vec::with_capacity(WIDTH * HEIGHT);
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let light = light(x, y);
            let mean = mixing[channel].iter().zip(light).map(|(m, l)| m * l).sum::<f64>() + [24.0, 16.0, 12.0][channel];
            let sigma = noise * (READ_NOISE.powi(2) + GAIN * mean).sqrt();
            bytes.push((mean + sigma * random.normal() + spoil(channel, x, y)).round().clamp(0.0, 255.0) as u8);
        }
        Plane::owned(PixelFormat::U8, bytes, WIDTH)
    });
    Frame::new(&[WIDTH, HEIGHT], planes.collect()).unwrap()
}

fn clean(_: usize, _: usize, _: usize) -> f64 {
    0.0
}

fn one(light: usize, brightness: f64) -> impl Fn(usize, usize) -> [f64; 3] {
    move |x, y| std::array::from_fn(|i| if i == light { brightness * spot(PLACES[1], x, y) } else { 0.0 })
}

fn three(brightness: [f64; 3], places: [[f64; 2]; 3]) -> impl Fn(usize, usize) -> [f64; 3] {
    move |x, y| std::array::from_fn(|i| brightness[i] * spot(places[i], x, y))
}

fn measured(frames: &[Frame]) -> Result<Mixing, MixingError> {
    let mut measurement = MixingMeasurement::new(3, None);
    frames.iter().try_for_each(|frame| measurement.add(frame))?;
    measurement.finish()
}

/// Lights one at a time or together, clipped or not: the shares agree within five of their errors, which are small and,
/// overall, honest: the mean of (difference / error)² is 1 within five of its own standard errors.
#[test]
fn the_mixing_is_recovered_with_honest_errors() {
    let (mut squares, mut count) = (0.0, 0.0);
    let mut random = Noise(11);
    for seed in 0..12 {
        let brightness = if seed % 2 == 0 { [180.0, 140.0, 90.0] } else { [500.0, 160.0, 800.0] };
        let frames: Vec<Frame> = match seed % 4 {
            0 | 1 => (0..3).map(|i| frame(MIXING, one(i, brightness[i]), 1.0, &mut random, clean)).collect(),
            _ => vec![frame(MIXING, three(brightness, PLACES), 1.0, &mut random, clean)],
        };
        let found = measured(&frames).unwrap();
        for (row, column) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            let (value, error) = (found.matrix[row][column], found.errors[row][column]);
            if row == column {
                assert_eq!((value, error), (1.0, 0.0));
                continue;
            }
            let off = (value - MIXING[row][column]) / error;
            assert!(off.abs() < 5.0 && error < 0.004, "{seed}, {row}{column}: {value} ± {error}");
            (squares, count) = (squares + off * off, count + 1.0);
        }
        assert!(found.pixels.iter().all(|pixels| *pixels > 500), "{:?}", found.pixels);
    }
    let mean = squares / count;
    assert!((mean - 1.0).abs() < 5.0 * f64::sqrt(2.0 / count), "{mean} over {count}");
}

/// Interpolates a frame from a mosaic with a red pixel at 0, 0 and a blue one at 1, 1: each pixel has of each colour the
/// mean of the nearest sensor pixels of that colour.
fn interpolated(frame: &Frame) -> Frame {
    let planes = (0..3).map(|channel| {
        let has = |x: usize, y: usize| match channel {
            0 => x.is_multiple_of(2) && y.is_multiple_of(2),
            1 => x % 2 != y % 2,
            _ => x % 2 == 1 && y % 2 == 1,
        };
        let view = frame.plane_view(channel);
        let mirrored = |at: usize, by: isize, side: usize| {
            let at = (at as isize + by).unsigned_abs();
            if at < side { at } else { 2 * side - 2 - at }
        };
        let value = |x: usize, y: usize| {
            let mean = |steps: &[[isize; 2]]| {
                let places = steps.iter().map(|[dx, dy]| [mirrored(x, *dx, WIDTH), mirrored(y, *dy, HEIGHT)]);
                let values: Vec<f64> = places.filter(|[x, y]| has(*x, *y)).map(|[x, y]| view.pixel(x, y)).collect();
                (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
            };
            let beside = || mean(&[[1, 0], [-1, 0], [0, 1], [0, -1]]);
            mean(&[[0, 0]]).or_else(beside).or_else(|| mean(&[[1, 1], [1, -1], [-1, 1], [-1, -1]])).unwrap()
        };
        let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
        Plane::owned(PixelFormat::U8, pixels.map(|(x, y)| value(x, y).round() as u8).collect(), WIDTH)
    });
    Frame::new(&[WIDTH, HEIGHT], planes.collect()).unwrap()
}

/// Neighbours in an interpolated mosaic share their noise: errors that assume independent pixels are too small by a factor
/// of three.
#[test]
#[ignore = "long proof"]
fn mixing_of_an_interpolated_mosaic_has_honest_errors() {
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..40 {
        let mut random = Noise(1000 + seed);
        let lights = three([180.0, 140.0, 90.0], PLACES);
        let found = measured(&[interpolated(&frame(MIXING, lights, 1.0, &mut random, clean))]).unwrap();
        for (row, column) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).filter(|(row, column)| row != column) {
            let (value, error) = (found.matrix[row][column], found.errors[row][column]);
            assert!(error < 0.01, "{seed}, {row}{column}: {value} ± {error}");
            squares += ((value - MIXING[row][column]) / error).powi(2);
            count += 1.0;
        }
    }
    // Within five standard errors of a mean of squares of normal numbers.
    let mean = squares / count;
    assert!((mean - 1.0).abs() < 5.0 * f64::sqrt(2.0 / count), "{mean} over {count}");
}

#[test]
fn noiseless_frames_are_exact_to_their_rounding() {
    let found = measured(&[frame(MIXING, three([180.0; 3], PLACES), 0.0, &mut Noise(1), clean)]).unwrap();
    for (row, column) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        assert!((found.matrix[row][column] - MIXING[row][column]).abs() < 1e-3, "{:?}", found.matrix);
    }
}

/// Every fiftieth pixel of one channel is hot.
#[test]
fn hot_pixels_are_ignored() {
    let hot = |channel, x, y| if channel == 1 && (7 * x + 13 * y) % 50 == 0 { 90.0 } else { 0.0 };
    let frames: Vec<Frame> = (0..3).map(|i| frame(MIXING, one(i, 150.0), 1.0, &mut Noise(5), hot)).collect();
    let found = measured(&frames).unwrap();
    for light in [0, 2] {
        assert!((found.matrix[1][light] - MIXING[1][light]).abs() < 0.01, "{:?}", found.matrix);
    }
}

#[test]
fn unsuitable_lights_are_refused() {
    let mut random = Noise(3);
    let mut shown = |mixing, lights: &[usize]| -> Vec<Frame> {
        lights.iter().map(|light| frame(mixing, one(*light, 150.0), 1.0, &mut random, clean)).collect()
    };
    assert_eq!(measured(&shown(MIXING, &[0, 2])), Err(MixingError::NoLight { channel: 1, seen: vec![1, 0, 1] }));
    let twice = Err(MixingError::NoLight { channel: 1, seen: vec![2, 0, 1] });
    assert_eq!(measured(&shown(MIXING, &[0, 0, 2])), twice);
    // Red and green nearly alike.
    let alike = [[1.0, 0.93, 0.1], [0.93, 1.0, 0.2], [0.2, 0.2, 1.0]];
    assert_eq!(measured(&shown(alike, &[0, 1, 2])), Err(MixingError::SameColour(0, 1)));
    // Another lamp of a different red.
    let mut frames = shown(MIXING, &[0, 1, 2]);
    frames.extend(shown([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.25, 0.0, 1.0]], &[0]));
    assert_eq!(measured(&frames), Err(MixingError::TwoLights(0)));
    // A disc with a sharp edge, ten times over the limit in its own channel.
    let disc = |x: usize, y: usize| {
        let inside = (x as f64 - 100.0).hypot(y as f64 - 70.0) < 30.0;
        [0.0, if inside { 2550.0 } else { 0.0 }, 0.0]
    };
    let mut frames = shown(MIXING, &[0, 2]);
    frames.push(frame([[1.0, 0.1, 0.1], [0.1, 1.0, 0.1], [0.1, 0.05, 1.0]], disc, 1.0, &mut Noise(9), clean));
    assert_eq!(measured(&frames), Err(MixingError::Clipped(1)));
    // Red and green overlap.
    let close = [[90.0, 70.0], [118.0, 70.0], [30.0, 30.0]];
    let overlap = frame(MIXING, three([150.0, 150.0, 0.0], close), 1.0, &mut Noise(2), clean);
    assert!(matches!(measured(&[overlap]), Err(MixingError::Mixed(_))));
    let grey = Frame::new(&[4, 4], vec![Plane::owned(PixelFormat::U8, vec![0; 16], 4)]).unwrap();
    assert_eq!(measured(&[grey]), Err(MixingError::Planes { found: 1, wanted: 3 }));
}
