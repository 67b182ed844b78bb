#![allow(clippy::unwrap_used, clippy::print_stdout)]
use super::*;
use crate::picture::Noise;

const GAUSSIAN: &str = include_str!("../../../../models/gaussian.toml");

fn model(text: &str) -> Model {
    Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("test")))
}

/// A star of σ px and SNR 8 on an even noisy background, if `has_star`, and its position.
fn star(side: usize, sigma: f64, seed: u64, has_star: bool) -> (Grey, [f64; 2]) {
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15 ^ (seed + 1).wrapping_mul(0xD134_2543_DE82_EF95));
    let variance = 400.0;
    let area = 4.0 * std::f64::consts::PI * sigma * sigma;
    let flux = 32.0 + (1024.0 + 64.0 * area * variance).sqrt();
    let place = [0, 1].map(|_| side as f64 * (0.1 + 0.8 * noise.uniform()));
    let value = |i: usize| {
        let (x, y) = ((i % side) as f64 - place[0], (i / side) as f64 - place[1]);
        let light = flux / (0.5 * area) * (-0.5 * (x * x + y * y) / (sigma * sigma)).exp();
        let light = if has_star { light } else { 0.0 };
        (300.0 + light + (variance + light).sqrt() * noise.normal()).round()
    };
    let values = (0..side * side).map(value).collect();
    (Grey { values, size: [side, side, 1, 1], saturation: 65535.0, step: 1.0 }, place)
}

fn detect(bank: &Bank, model: &Model, grey: &Grey, options: &DetectOptions) -> Detections {
    bank.detect(model, &[], grey, options, &|_| Ok(())).unwrap()
}

fn options() -> DetectOptions<'static> {
    let threshold = DetectionThreshold::FalseAlarms(0.01);
    DetectOptions { sign: Some(Sign::Bright), sizes_px: [0.0, f64::INFINITY], masks: &[], count_max: 12, threshold }
}

#[test]
fn faint_stars_are_detected_and_noise_is_not() {
    let model = model(GAUSSIAN);
    let bank = Bank::of(&model).unwrap();
    let (side, seeds) = (512, 20);
    for sigma in [1.1, 2.5] {
        let found = |seed: u64| {
            let (grey, place) = star(side, sigma, seed, true);
            let found = detect(&bank, &model, &grey, &options());
            found.all.first().is_some_and(|s| (s.centre[0] - place[0]).hypot(s.centre[1] - place[1]) < 2.0 * sigma)
        };
        let count = (0..seeds).filter(|&seed| found(seed)).count();
        assert!(count + 1 >= seeds as usize, "σ {sigma}: {count} of {seeds}");
    }
    let false_alarms: Vec<Strength> = (100..100 + seeds)
        .filter_map(|seed| {
            let (grey, _) = star(side, 1.0, seed, false);
            let found = detect(&bank, &model, &grey, &options());
            assert!(found.strongest.unwrap().score > 3.0, "something is always the strongest");
            (!found.all.is_empty()).then_some(found.strongest.unwrap())
        })
        .collect();
    assert!(false_alarms.len() <= 1, "{false_alarms:?}");
}

#[test]
fn maps_equal_direct_correlation_with_zeros_beyond_the_border() {
    let model = model(GAUSSIAN);
    let bank = Bank::of(&model).unwrap();
    let (width, height) = (331, 75); // several tiles across, an odd one down
    let mut noise = Noise(7);
    let values = (0..width * height).map(|_| 50.0 + noise.normal()).collect();
    let grey = Grey { values, size: [width, height, 1, 1], saturation: 1e9, step: 0.0 };
    let level = Octave::of(Mended::of(&grey, &[]), 0);
    let templates: Vec<&Template> =
        bank.templates(&model, &[], [0.0, 3.0], height).into_iter().filter(|template| template.level == 0).collect();
    assert_eq!(templates.len(), 2);
    let mut filter = Filter::default();
    let maps = filter.maps(&level, &templates);
    let half = template::HALF_PX as isize;
    for (template, map) in templates.iter().zip(maps) {
        for (x, y) in [(0, 0), (330, 74), (1, 40), (175, 37), (176, 37), (200, 3), (216, 70), (331 / 2, 0)] {
            let mut sum = 0.0;
            for (row, line) in template.kernel.chunks_exact(2 * half as usize + 1).enumerate() {
                for (column, factor) in line.iter().enumerate() {
                    let (u, v) = (x as isize + column as isize - half, y as isize + row as isize - half);
                    if (0..width as isize).contains(&u) && (0..height as isize).contains(&v) {
                        sum += factor * level.values[v as usize * width + u as usize];
                    }
                }
            }
            let is = map[y * width + x];
            assert!((is - sum).abs() < 1e-4, "{x}, {y}: {is} {sum}");
        }
    }
}

#[test]
fn bad_pixels_and_slopes_are_not_detected() {
    let model = model(GAUSSIAN);
    let bank = Bank::of(&model).unwrap();
    let (mut grey, _) = star(256, 1.0, 3, false);
    let mut random = Noise(11);
    for _ in 0..60 {
        let at = (random.uniform() * grey.values.len() as f64) as usize;
        grey.values[at] = 4095.0;
    }
    for (i, value) in grey.values.iter_mut().enumerate() {
        let (x, y) = ((i % 256) as f64, (i / 256) as f64);
        *value += 0.8 * x - 0.5 * y + 0.002 * (x - 128.0) * (y - 100.0);
    }
    let found = detect(&bank, &model, &grey, &options());
    assert!(found.all.is_empty(), "{:?}", found.strongest);
}

#[test]
fn constant_frames_have_no_detections() {
    let model = model(GAUSSIAN);
    let bank = Bank::of(&model).unwrap();
    for step in [0.0, 1.0] {
        for size in [[64, 48, 1, 1], [7, 5, 1, 1], [1, 1, 1, 1]] {
            let grey = Grey { values: vec![17.0; size[0] * size[1]], size, saturation: 255.0, step };
            assert!(detect(&bank, &model, &grey, &options()).all.is_empty());
        }
    }
}

#[test]
fn templates_follow_the_document() {
    // A ring is empty in its middle; a dark disc is dark; a document may state its target's size.
    let ring = model(include_str!("../../../../models/ring.toml"));
    let bank = Bank::of(&ring).unwrap();
    let small = bank.templates(&ring, &[], [15.5, 17.0], 480)[0];
    let at = |template: &Template, x: i32| {
        let side = 2 * template::HALF_PX + 1;
        template.kernel[(template::HALF_PX * side + template::HALF_PX + x) as usize]
    };
    assert_eq!((small.level, small.size_px.round()), (3, 16.0));
    assert!(at(small, 2) > 0.0 && at(small, 0) < 0.5 * at(small, 2), "{} {}", at(small, 0), at(small, 2));
    let dark = model(include_str!("../../../../models/dark-disc.toml"));
    assert!(Bank::of(&dark).unwrap().templates(&dark, &[], [0.0, 5.0], 480).iter().all(|dark| dark.height < 0.0));
    let text =
        GAUSSIAN.replace("\"extent.xx\"", "0.04").replace("\"extent.xy\"", "0.0").replace("\"extent.yy\"", "0.04");
    let fixed = model(&text);
    let templates = Bank::of(&fixed).unwrap();
    let templates = templates.templates(&fixed, &[], [0.0, f64::INFINITY], 480);
    assert_eq!((templates.len(), templates[0].level), (1, 0));
    let bounded = model(&GAUSSIAN.replace("\"extent.xx\", min = 0.0", "\"extent.xx\", min = 0.01, max = 0.1"));
    let sizes: Vec<f64> = Bank::of(&bounded)
        .unwrap()
        .templates(&bounded, &[], [0.0, f64::INFINITY], 480)
        .iter()
        .map(|t| t.size_px)
        .collect();
    assert!(sizes.iter().all(|size| (3.16..10.0).contains(size)) && sizes.len() == 3, "{sizes:?}");
    let poses = model(include_str!("../../../../models/spot-pose.toml"));
    assert!(Bank::of(&poses).is_none(), "several spots or a pose are no single thing");
}

/// The noise estimate from a few dozen pixels is itself random.
#[test]
fn noise_is_not_detected_at_large_sizes() {
    let model = model(GAUSSIAN);
    let bank = Bank::of(&model).unwrap();
    let (width, height) = (320, 240);
    let false_alarms = (0..60).filter(|seed| {
        let mut noise = Noise(0xA076_1D64_78BD_642F ^ (seed + 1_u64).wrapping_mul(0xE703_7ED1_A0B4_28DB));
        let values = (0..width * height).map(|_| (20.0 + 1.3 * noise.normal()).round()).collect();
        let grey = Grey { values, size: [width, height, 1, 1], saturation: 255.0, step: 1.0 };
        let options = DetectOptions { threshold: DetectionThreshold::FalseAlarms(0.5), ..options() };
        detect(&bank, &model, &grey, &options).all.iter().any(|detection| detection.size[0] > 12.0)
    });
    let count = false_alarms.count();
    assert!(count <= 3, "{count}");
}

/// On a background of bumps one always exceeds noise of that scatter.
#[test]
fn thresholds_rise_on_uneven_ground() {
    let model = model(GAUSSIAN);
    let bank = Bank::of(&model).unwrap();
    let (side, step) = (512_usize, 6_usize);
    let mut noise = Noise(11);
    let nodes: Vec<f64> = (0..(side / step + 2).pow(2)).map(|_| noise.normal()).collect();
    let ground = |i: usize| {
        let (x, y) = (i % side, i / side);
        let (u, v) = ((x % step) as f64 / step as f64, (y % step) as f64 / step as f64);
        let node = |dx: usize, dy: usize| nodes[(y / step + dy) * (side / step + 2) + x / step + dx];
        let row = |dy: usize| node(0, dy) * (1.0 - u) + node(1, dy) * u;
        row(0) * (1.0 - v) + row(1) * v
    };
    let detect = |bumps: f64, deviation: f64, noise: &mut Noise| {
        let value = |i: usize| (300.0 + bumps * ground(i) + deviation * noise.normal()).round();
        let values = (0..side * side).map(value).collect();
        let grey = Grey { values, size: [side, side, 1, 1], saturation: 65535.0, step: 1.0 };
        detect(&bank, &model, &grey, &options())
    };
    let (even, uneven) = (detect(0.0, 20.0, &mut noise), detect(30.0, 20.0, &mut noise));
    assert!(even.bumps < 0.05 && uneven.bumps > 0.4, "{} {}", even.bumps, uneven.bumps);
    assert!(uneven.all.is_empty() && even.all.is_empty(), "{uneven:?}");
    let [high, low] = [&uneven, &even].map(|found| found.strongest.unwrap().threshold);
    assert!(high > 1.1 * low, "{high} {low}");
    // Noise of whole pixel values is no bumps, however few values there are.
    for deviation in [0.3, 0.4, 0.5, 0.6, 0.7, 1.0, 1.5, 2.0, 2.5, 3.7, 5.2] {
        let bumps = detect(0.0, deviation, &mut noise).bumps;
        assert!(bumps < 0.12, "{deviation} DN: {bumps}");
    }
}
