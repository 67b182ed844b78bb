#![allow(clippy::unwrap_used)]

use isophote_jit::PixelFormat;

use super::*;
use crate::picture::{Falloff, Spot, TestPicture};
use isophote_frame::Plane;

const SIZE: [usize; 2] = [96, 80];

/// Frames of a sensor with defects.
struct Sensor {
    scene: fn(u64) -> Vec<Spot>,
    noise: f64,
    defects: Vec<([usize; 2], f64)>,
    columns: Vec<(usize, f64)>,
    seed: u64,
}

impl Sensor {
    fn dark(seed: u64) -> Sensor {
        Sensor { scene: |_| Vec::new(), noise: 2.0, defects: Vec::new(), columns: Vec::new(), seed }
    }

    fn frame(&self, number: u64) -> Frame {
        let seed = 1_000 * self.seed + number;
        let spots = (self.scene)(number);
        let picture = TestPicture { noise: self.noise, seed, samples: 2, ..TestPicture::new(SIZE[0], SIZE[1], spots) };
        let mut values = picture.pixels();
        self.defects.iter().for_each(|([x, y], offset)| values[y * SIZE[0] + x] += offset);
        for (x, offset) in &self.columns {
            (0..SIZE[1]).for_each(|y| values[y * SIZE[0] + x] += offset);
        }
        let bytes = values.iter().map(|value| value.round().clamp(0.0, 255.0) as u8).collect();
        Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, SIZE[0])]).unwrap()
    }

    fn measured(&self, frames: u64, scene: DefectScene) -> FoundDefects {
        let options = DefectOptions { scene, kinds: PixelKinds::One, false_alarms: 0.01 };
        let mut measurement = DefectMeasurement::new(options);
        (0..frames).for_each(|number| measurement.add(&self.frame(number)).unwrap());
        measurement.finish().unwrap()
    }
}

/// 38 positions (0.5 %), none adjacent, with their offsets.
fn hot(least: f64, step: f64) -> Vec<([usize; 2], f64)> {
    let place = |i: usize| [(5 + 37 * i) % SIZE[0], (3 + 11 * i) % SIZE[1]];
    (0..38).map(|i| (place(i), least + step * i as f64)).collect()
}

fn sorted(places: impl Iterator<Item = [usize; 2]>) -> Vec<[u32; 2]> {
    let mut places: Vec<[u32; 2]> = places.map(|[x, y]| [x as u32, y as u32]).collect();
    places.sort_unstable_by_key(|[x, y]| [*y, *x]);
    places
}

#[test]
fn false_alarms_are_rare() {
    let mut taken = 0;
    for seed in 0..30 {
        let frames = if seed % 3 == 0 { 3 } else { 16 };
        let found = Sensor::dark(seed).measured(frames, DefectScene::Dark);
        taken += found.map.pixels.len() + found.map.columns.len() + found.map.rows.len();
    }
    // 0.3 are expected.
    assert!(taken <= 3, "{taken}");
}

#[test]
fn dark_frames_reveal_hot_and_dead_pixels_and_columns() {
    let mut sensor = Sensor { defects: hot(12.0, 4.0), columns: vec![(50, 6.0)], ..Sensor::dark(1) };
    sensor.defects.iter_mut().step_by(4).for_each(|(_, offset)| *offset = -15.0);
    let found = sensor.measured(16, DefectScene::Dark);
    let should = sensor.defects.iter().map(|(place, _)| *place).filter(|[x, _]| *x != 50);
    assert_eq!(found.map.pixels, sorted(should.clone()));
    assert_eq!((found.map.columns.as_slice(), found.map.rows.len(), found.noisy), (&[50][..], 0, 0));
    assert_eq!(found.hot + found.dead, should.count());
    assert!(found.dead >= 8 && found.frames == 16 && found.tells_noisy, "{found:?}");
}

/// With a moving target, and one that is static and as sharp as a lens allows.
#[test]
fn running_scenes_reveal_defects_but_no_targets() {
    fn scene(number: u64) -> Vec<Spot> {
        let spot = |centre, half: [f64; 2], amplitude| Spot {
            centre,
            half,
            angle: 0.3,
            amplitude,
            profile: Falloff::Cubic(-0.5, -0.3),
        };
        let moving = [20.0 + 1.7 * number as f64, 40.0 + 10.0 * (0.3 * number as f64).sin()];
        vec![spot(moving, [14.0, 10.0], 150.0), spot([70.4, 20.3], [3.5, 3.0], 170.0)]
    }
    for seed in 0..3 {
        let clean = Sensor { scene, ..Sensor::dark(seed) };
        let found = clean.measured(32, DefectScene::Running);
        assert_eq!(found.map.pixels, Vec::<[u32; 2]>::new());
        assert_eq!((found.map.columns.len(), found.map.rows.len()), (0, 0));
        let sensor = Sensor { defects: hot(30.0, 4.0), ..clean };
        let found = sensor.measured(32, DefectScene::Running);
        let near = |[x, y]: &[u32; 2]| (i64::from(*x) - 70).abs() <= 5 && (i64::from(*y) - 20).abs() <= 5;
        let should = sorted(sensor.defects.iter().map(|(place, _)| *place));
        let missed = should.iter().filter(|place| !near(place) && !found.map.pixels.contains(place)).count();
        assert!(missed <= 1, "{missed} of {}", should.len());
        assert!(found.map.pixels.iter().all(|place| should.contains(place)), "{:?}", found.map.pixels);
    }
}

#[test]
fn fluctuating_pixels_are_noisy() {
    let blinking = [[30, 30], [61, 9]];
    let options = DefectOptions { scene: DefectScene::Dark, kinds: PixelKinds::One, false_alarms: 0.01 };
    let mut measurement = DefectMeasurement::new(options);
    for number in 0..40 {
        let offset = if number % 9 == 0 { 40.0 } else { 0.0 };
        let sensor = Sensor { defects: blinking.map(|place| (place, offset)).to_vec(), ..Sensor::dark(4) };
        measurement.add(&sensor.frame(number)).unwrap();
    }
    let found = measurement.finish().unwrap();
    assert_eq!((found.map.pixels, found.noisy), (sorted(blinking.into_iter()), 2));
}

/// A raw mosaic: three quarters of the pixels read half of what the others do.
#[test]
fn mosaics_are_compared_by_colour() {
    let frame = |number: u64| {
        let sensor = Sensor { defects: hot(30.0, 4.0), ..Sensor::dark(7) };
        let frame = sensor.frame(number);
        let view = frame.plane_view(0);
        let light =
            |i: usize| if [i % SIZE[0], i / SIZE[0]].iter().all(|at| at.is_multiple_of(2)) { 60.0 } else { 0.0 };
        let value = |i: usize| (view.pixel(i % SIZE[0], i / SIZE[0]) + light(i)).min(255.0) as u8;
        let bytes = (0..SIZE[0] * SIZE[1]).map(value).collect();
        Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, bytes, SIZE[0])]).unwrap()
    };
    let options = DefectOptions { scene: DefectScene::Dark, kinds: PixelKinds::Mosaic, false_alarms: 0.01 };
    let mut measurement = DefectMeasurement::new(options);
    (0..16).for_each(|number| measurement.add(&frame(number)).unwrap());
    let found = measurement.finish().unwrap();
    assert_eq!(found.map.pixels, sorted(hot(30.0, 4.0).into_iter().map(|(place, _)| place)));
}

#[test]
fn many_frames_are_thinned_evenly() {
    let sensor = Sensor::dark(2);
    let frame = sensor.frame(0);
    let options = DefectOptions { scene: DefectScene::Dark, kinds: PixelKinds::One, false_alarms: 0.01 };
    let mut measurement = DefectMeasurement::new(options);
    for number in 0..300 {
        measurement.add(&frame.clone().with_sequence(number)).unwrap();
    }
    let kept: Vec<u64> = measurement.kept.iter().map(|frame| frame.sequence).collect();
    assert_eq!(kept, (0..300).step_by(8).collect::<Vec<u64>>());
    let other = Frame::new(&[80, 96], vec![Plane::owned(PixelFormat::U8, vec![0; 80 * 96], 80)]).unwrap();
    assert!(matches!(measurement.add(&other), Err(DefectFault::Unlike(..))));
    assert_eq!(DefectMeasurement::new(options).finish(), Err(DefectFault::NoFrame));
}

/// Floating-point frames.
fn fractions(value: impl Fn(usize, f64) -> f64) -> Result<FoundDefects, DefectFault> {
    let options = DefectOptions { scene: DefectScene::Dark, kinds: PixelKinds::One, false_alarms: 0.01 };
    let mut measurement = DefectMeasurement::new(options);
    for seed in 0..16 {
        let picture = TestPicture { noise: 2.0, seed, samples: 2, ..TestPicture::new(SIZE[0], SIZE[1], Vec::new()) };
        let values = picture.pixels().into_iter().enumerate();
        let bytes = values.flat_map(|(pixel, dark)| (value(pixel, dark) as f32).to_le_bytes()).collect();
        measurement.add(&Frame::new(&SIZE, vec![Plane::owned(PixelFormat::F32, bytes, SIZE[0])]).unwrap()).unwrap();
    }
    measurement.finish()
}

#[test]
fn non_finite_pixels_are_dead() {
    // A single pixel, a block of 6 × 6 and a column; their neighbours are sound except for a hot pixel.
    let is_absent = |pixel: usize| {
        let [x, y] = [pixel % SIZE[0], pixel / SIZE[0]];
        [x, y] == [40, 9] || ((10..16).contains(&x) && (20..26).contains(&y)) || x == 70
    };
    let hot = 22 * SIZE[0] + 16;
    let found = fractions(|pixel, dark| match pixel {
        pixel if is_absent(pixel) => f64::NAN,
        pixel if pixel == hot => dark + 30.0,
        _ => dark,
    });
    let found = found.unwrap();
    let all = (0..SIZE[0] * SIZE[1]).filter(|pixel| is_absent(*pixel) || *pixel == hot);
    let should = sorted(all.map(|pixel| [pixel % SIZE[0], pixel / SIZE[0]]).filter(|[x, _]| *x != 70));
    assert_eq!((found.map.pixels, found.map.columns, found.map.rows), (should, vec![70], vec![]));
    assert_eq!((found.hot, found.dead, found.noisy), (1, 37, 0));
}

#[test]
fn frames_without_noise_are_refused() {
    // Clipped at zero except for some pixels.
    let clipped = |pixel: usize, dark: f64| if pixel.is_multiple_of(97) { 1e-3 * dark.abs() } else { 0.0 };
    assert_eq!(fractions(clipped), Err(DefectFault::Silent));
    assert_eq!(fractions(|_, _| f64::NAN), Err(DefectFault::Silent));
    // Whole numbers differ by their steps, in any format.
    let found = fractions(|pixel, _| if pixel == 4_000 { 30.0 } else { 0.0 }).unwrap();
    assert_eq!((found.map.pixels, found.hot), (sorted([[4_000 % SIZE[0], 4_000 / SIZE[0]]].into_iter()), 1));
}
