//! Light defects: each effect against an independent formula, on uniform scenes.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use isophote_capture::light::{Blind, Glare, Occluder};
use isophote_capture::{FrameSource, Light, Moving, Synthetic, SyntheticSpec, decode, encode_png};
use isophote_symbolic::Model;

const WIDTH: usize = 48;
const HEIGHT: usize = 32;

fn model(intensity: &str) -> Arc<Model> {
    let document = format!(
        "name = \"test\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nv = {{ start = 1.0 }}\nbx = {{ start = 16.2 }}\n\
         [model]\nintensity = \"{intensity}\"\n[roles]\nbackground = \"v\"\n"
    );
    Arc::new(Model::from_toml(&document).unwrap())
}

/// 16 bits, so that rounding hides nothing.
fn spec(intensity: &str, light: Light) -> SyntheticSpec {
    SyntheticSpec {
        width: WIDTH,
        height: HEIGHT,
        bits: 16,
        saturation: 65_535.0,
        light,
        ..SyntheticSpec::new(model(intensity))
    }
}

fn even(light: Light) -> SyntheticSpec {
    spec("5000*v + 0*bx", light)
}

fn number(number: f64) -> Option<Moving> {
    Some(Moving::Number(number))
}

fn occluder(x: f64, width: f64, value: f64) -> Occluder {
    Occluder {
        x: number(x),
        y: None,
        width: number(width),
        height: None,
        value: value.into(),
        from_s: None,
        to_s: None,
    }
}

fn blind(x: f64, y: f64, width: f64, height: f64) -> Blind {
    let [x, y, width, height] = [x, y, width, height].map(number);
    Blind { x, y, width, height, soft_px: None, from_s: None, to_s: None }
}

fn pixels(camera: &mut Synthetic) -> Vec<f64> {
    let frame = camera.next().unwrap().unwrap().frame;
    let plane = frame.plane_view(0);
    (0..frame.rows()).flat_map(|y| (0..frame.width()).map(move |x| (x, y))).map(|(x, y)| plane.pixel(x, y)).collect()
}

fn first(spec: SyntheticSpec) -> Vec<f64> {
    pixels(&mut Synthetic::new(spec).unwrap())
}

/// Every pixel matches `expected` within rounding and one millionth.
fn compare(found: &[f64], expected: impl Fn(f64, f64) -> f64) {
    for (i, found) in found.iter().enumerate() {
        let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let expected = expected(x, y);
        assert!((found - expected).abs() <= 0.51 + 1e-6 * expected, "({x}, {y}): {found}, not {expected}");
    }
}

/// Mean over a pixel from 20 × 20 samples.
fn mean(x: f64, y: f64, f: impl Fn(f64, f64) -> f64) -> f64 {
    let at = |i: usize| (i as f64 + 0.5) / 20.0 - 0.5;
    (0..400).map(|i| f(x + at(i % 20), y + at(i / 20))).sum::<f64>() / 400.0
}

#[test]
fn glare_adds_lobes_streaks_and_slopes() {
    let lobe = Glare {
        x: number(30.3),
        y: number(12.0),
        sigma_px: 9.0.into(),
        height: 140.0.into(),
        from_s: None,
        to_s: None,
    };
    let small = Glare { sigma_px: 0.6.into(), height: 9000.0.into(), x: number(7.4), ..lobe.clone() };
    let streak = Glare { y: None, ..small.clone() };
    let gaussian = |d2: f64, sigma: f64| (-d2 / (2.0 * sigma * sigma)).exp();
    let found = first(even(Light { glare: vec![lobe.clone(), small], ..Light::default() }));
    compare(&found, |x, y| {
        let large = mean(x, y, |x, y| 140.0 * gaussian((x - 30.3).powi(2) + (y - 12.0).powi(2), 9.0));
        // A lobe smaller than a pixel needs more samples; they separate in x and y.
        let side = |at: f64, middle: f64| {
            (0..400).map(|i| gaussian((at + (f64::from(i) + 0.5) / 400.0 - 0.5 - middle).powi(2), 0.6)).sum::<f64>()
                / 400.0
        };
        5000.0 + large + 9000.0 * side(x, 7.4) * side(y, 12.0)
    });
    let found = first(even(Light { glare: vec![streak], ..Light::default() }));
    assert!((0..HEIGHT).all(|y| found[y * WIDTH + 7] == found[7] && found[7] > 10_000.0));
    let wide = Glare { sigma_px: 1e7.into(), ..lobe };
    compare(&first(even(Light { glare: vec![wide], ..Light::default() })), |_, _| 5140.0);
    let sloping = Light { slope: Some([300.0.into(), 20.0.into()]), ..Light::default() };
    compare(&first(even(sloping)), |x, y| (5000.0 + 300.0 * (x - 23.5) + 20.0 * (y - 15.5)).max(0.0));
}

#[test]
fn occluders_hide_the_covered_share() {
    let moving =
        Occluder { x: Some(Moving::Formula("10.25 + 60*t".into())), y: number(4.0), ..occluder(0.0, 6.5, 800.0) };
    let light = Light { occluders: vec![Occluder { height: number(3.5), ..moving }], ..Light::default() };
    let mut camera = Synthetic::new(even(light)).unwrap();
    for frame in 0..3 {
        // One pixel further each frame. A pixel's share is the product of the interval overlaps along both axes.
        let overlap = |at: f64, first: f64, count: f64| {
            ((first - 0.5 + count).min(at + 0.5) - (first - 0.5).max(at - 0.5)).clamp(0.0, 1.0)
        };
        compare(&pixels(&mut camera), |x, y| {
            let share = overlap(x, 10.25 + f64::from(frame), 6.5) * overlap(y, 4.0, 3.5);
            5000.0 * (1.0 - share) + 800.0 * share
        });
    }
    // The later occluder covers the earlier one, and hides glare too.
    let glare = Glare { x: None, y: None, sigma_px: 1.0.into(), height: 9.0.into(), from_s: None, to_s: None };
    let light = Light {
        occluders: vec![occluder(10.0, 20.0, 100.0), occluder(20.0, 5.0, 200.0)],
        glare: vec![glare],
        ..Light::default()
    };
    compare(&first(even(light)), |x, _| match x as usize {
        20..25 => 200.0,
        10..30 => 100.0,
        _ => 5009.0,
    });
}

#[test]
fn blind_pixels_saturate_with_a_veil_around_them() {
    let light = Light { blind: vec![blind(9.6, 3.0, 4.0, 5.0)], ..Light::default() };
    let noisy = SyntheticSpec { full_well_e: 5000.0, read_noise_e: 15.0, bits: 12, saturation: 4000.0, ..even(light) };
    let noisy = SyntheticSpec { set: [("v".to_string(), 0.1)].into(), ..noisy };
    let found = first(noisy);
    for (i, pixel) in found.iter().enumerate() {
        let is_blind = (10..14).contains(&(i % WIDTH)) && (3..8).contains(&(i / WIDTH));
        assert_eq!(*pixel == 4000.0, is_blind, "pixel {i} is {pixel}");
    }
    // Along y the veil is unbounded, so it is one edge along x.
    let soft = Blind { soft_px: number(4.0), y: None, height: None, ..blind(30.0, 0.0, 100.0, 0.0) };
    let found = first(even(Light { blind: vec![soft], ..Light::default() }));
    compare(&found, |x, _| {
        let veil = 65_535.0 * libm::erfc(-(x - 29.5) / (4.0 * std::f64::consts::SQRT_2));
        if x >= 30.0 { 65_535.0 } else { (5000.0 + veil).min(65_535.0) }
    });
}

/// A blackout and a white-out of the whole frame, with times but without positions.
#[test]
fn timed_items_start_and_end() {
    let black = Occluder { x: None, width: None, from_s: Some(0.1), to_s: Some(0.3), ..occluder(0.0, 0.0, 20.0) };
    let white = Blind { x: None, y: None, width: None, height: None, soft_px: None, from_s: Some(0.5), to_s: None };
    let light = Light { occluders: vec![black], blind: vec![white], ..Light::default() };
    let mut camera = Synthetic::new(SyntheticSpec { rate_hz: 10.0, ..even(light) }).unwrap();
    let levels: Vec<f64> = (0..7)
        .map(|_| {
            let found = pixels(&mut camera);
            assert!(found.iter().all(|pixel| *pixel == found[0]));
            found[0]
        })
        .collect();
    assert_eq!(levels, [5000.0, 20.0, 20.0, 5000.0, 5000.0, 65_535.0, 65_535.0]);
}

/// An edge becomes an error function, computed here in f64, even if its other side is outside the frame.
#[test]
fn defocus_blurs_the_scene_with_its_surroundings() {
    for (edge, sigma) in [(16.2, 2.0), (-1.5, 2.0), (46.9, 5.0)] {
        let light = Light { defocus_px: number(sigma), ..Light::default() };
        let mut spec = SyntheticSpec { samples: 16, ..spec("if(x <= bx, 1000*v, 50000*v)", light) };
        spec.set = [("bx".to_string(), edge)].into();
        let found = first(spec);
        // 16 samples place the edge within 1/32 px, and the pixel's width widens it: within 1 % of its height.
        let sigma = (sigma * sigma + 1.0 / 12.0f64).sqrt();
        for (i, found) in found.iter().enumerate() {
            let x = (i % WIDTH) as f64;
            let expected = 1000.0 + 49_000.0 * 0.5 * libm::erfc(-(x - edge) / (sigma * std::f64::consts::SQRT_2));
            assert!((found - expected).abs() < 490.0, "σ {sigma}, edge {edge}, x {x}: {found} for {expected}");
        }
    }
    // Uniform light stays uniform up to the frame's edge, and 0 px is no blur.
    let found = first(even(Light { defocus_px: number(6.0), ..Light::default() }));
    compare(&found, |_, _| 5000.0);
    let edge = |light| first(spec("if(x <= bx, 1000*v, 50000*v)", light));
    assert_eq!(edge(Light { defocus_px: number(0.0), ..Light::default() }), edge(Light::default()));
}

/// A line has no y, and every slice of a stack has the same light.
#[test]
fn light_defects_apply_to_lines_and_stacks() {
    let even = |coordinates: &str| {
        let document = format!(
            "name = \"test\"\ncoordinates = [{coordinates}]\nchannels = [\"phi\"]\n[parameters]\nv = {{ start = 5000.0 }}\n[model]\nintensity = \"v\"\n"
        );
        SyntheticSpec { model: Arc::new(Model::from_toml(&document).unwrap()), ..even(Light::default()) }
    };
    let light = || Light {
        defocus_px: number(2.0),
        slope: Some([10.0.into(), 0.0.into()]),
        occluders: vec![occluder(10.0, 3.5, 800.0)],
        blind: vec![Blind { y: None, height: None, ..blind(30.0, 0.0, 2.0, 0.0) }],
        ..Light::default()
    };
    let expected = |x: usize| match x {
        10..=12 => 800.0,
        13 => 400.0 + (5000.0 + 10.0 * (13.0 - 23.5)) / 2.0,
        30 | 31 => 65_535.0,
        _ => 5000.0 + 10.0 * (x as f64 - 23.5),
    };
    let frame = |spec| Synthetic::new(spec).unwrap().next().unwrap().unwrap().frame;
    let line = frame(SyntheticSpec { light: light(), height: 1, ..even("\"x\"") });
    assert!((0..WIDTH).all(|x| (line.plane_view(0).pixel(x, 0) - expected(x)).abs() <= 0.51));
    let stack = frame(SyntheticSpec { light: light(), depth: 3, ..even("\"x\", \"y\", \"z\"") });
    let pixels: Vec<u16> = stack.planes()[0]
        .buffer
        .bytes()
        .chunks_exact(2)
        .map(|pixel| u16::from_le_bytes([pixel[0], pixel[1]]))
        .collect();
    assert_eq!(pixels.len(), WIDTH * HEIGHT * 3);
    assert!(pixels.iter().enumerate().all(|(i, pixel)| (f64::from(*pixel) - expected(i % WIDTH)).abs() <= 0.51));
}

/// Mean g·m and variance g²·(m/e + (r/e)²) + 1/12 for m DN of light, e electrons per DN, r electrons of read noise and gain
/// g; five standard errors. One intensity is uniform and one is not, to cover both ways of counting.
#[test]
fn gain_amplifies_light_and_noise_but_not_rounding() {
    for gain in [0.5, 1.0, 2.0, 3.7] {
        for intensity in ["60*v + 0*bx", "60*v + 0*bx + 0.00001*x"] {
            let mut spec = spec(intensity, Light::default());
            (spec.bits, spec.saturation, spec.full_well_e, spec.read_noise_e) = (8, 255.0, 5000.0, 15.0);
            (spec.width, spec.height, spec.gain) = (400, 300, gain.into());
            let mut camera = Synthetic::new(spec).unwrap();
            let captured = camera.next().unwrap().unwrap();
            assert_eq!(captured.truth.unwrap()["v"], gain, "what is told is what is seen");
            let found = pixels(&mut camera);
            let n = found.len() as f64;
            let e = 5000.0 / 255.0;
            let expected = gain * gain * (60.0 / e + (15.0f64 / e).powi(2)) + 1.0 / 12.0;
            let mean = found.iter().sum::<f64>() / n;
            let variance = found.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / n;
            assert!((mean - 60.0 * gain).abs() < 5.0 * (expected / n).sqrt(), "gain {gain}: mean {mean}");
            let tolerance = 5.0 * expected * (2.0 / n).sqrt();
            assert!((variance - expected).abs() < tolerance, "gain {gain}: variance {variance} for {expected}");
        }
    }
}

/// The camera's exposure and the controlled one multiply; both scale light and truth, but not the read noise.
#[test]
fn scene_and_controlled_exposures_multiply() {
    let exposure = "if(t < 1, 2, 3)".parse().unwrap();
    let spec = SyntheticSpec { exposure, rate_hz: 1.0, exposure_latency: 1, ..even(Light::default()) };
    let mut camera = Synthetic::new(spec).unwrap();
    camera.exposure().unwrap().set(0.5);
    for expected in [2.0, 1.5, 1.5] {
        let captured = camera.next().unwrap().unwrap();
        assert_eq!(captured.frame.plane_view(0).pixel(3, 2), 5000.0 * expected);
        assert_eq!(captured.truth.unwrap()["v"], expected);
    }
    let wrong = SyntheticSpec { exposure: 0.0.into(), ..even(Light::default()) };
    assert_eq!(Synthetic::new(wrong).err().unwrap().to_string(), "`exposure` is 0; it must be positive");
}

/// Blind pixels are full wells: below unit gain they read the full well times the gain.
#[test]
fn blind_pixels_read_the_full_well() {
    let light = Light { blind: vec![blind(0.0, 0.0, 4.0, 4.0)], ..Light::default() };
    for (gain, end) in [(0.5, 32_767.0), (2.0, 65_535.0)] {
        let frame = Synthetic::new(SyntheticSpec { gain: gain.into(), ..even(light.clone()) }).unwrap().next();
        assert_eq!(frame.unwrap().unwrap().frame.plane_view(0).pixel(1, 1), end);
    }
}

/// A frame does not depend on earlier ones, even when the gain changes.
#[test]
fn frames_do_not_depend_on_earlier_gains() {
    let noisy = |gain: &str| {
        let gain = gain.parse().unwrap();
        SyntheticSpec { full_well_e: 9000.0, read_noise_e: 3.0, gain, rate_hz: 1.0, ..even(Light::default()) }
    };
    let mut moving = Synthetic::new(noisy("1 + t")).unwrap();
    let mut still = Synthetic::new(noisy("2")).unwrap();
    let frames: Vec<_> = (0..2).map(|_| (pixels(&mut moving), pixels(&mut still))).collect();
    assert_ne!(frames[0].0, frames[0].1);
    assert_eq!(frames[1].0, frames[1].1);
}

/// 10 and 12 bits: saturation is the limit of the bits, and a PNG keeps it.
#[test]
fn deep_pixels_saturate_at_their_limit_and_round_trip() {
    for (bits, limit) in [(10, 1023.0), (12, 4095.0)] {
        let glare = Glare {
            x: number(20.0),
            y: number(16.0),
            sigma_px: 5.0.into(),
            height: 5000.0.into(),
            from_s: None,
            to_s: None,
        };
        let light = Light { glare: vec![glare], ..Light::default() };
        let mut spec =
            SyntheticSpec { bits, saturation: limit, full_well_e: 20_000.0, read_noise_e: 5.0, ..even(light) };
        spec.set = [("v".to_string(), 0.02)].into();
        let frame = Synthetic::new(spec).unwrap().next().unwrap().unwrap().frame;
        let plane = &frame.planes()[0];
        let read = decode(&encode_png(WIDTH, HEIGHT, plane.format, plane.buffer.bytes()).unwrap()).unwrap();
        let (found, read) = (frame.plane_view(0), read.plane_view(0));
        let all: Vec<f64> = (0..WIDTH * HEIGHT).map(|i| found.pixel(i % WIDTH, i / WIDTH)).collect();
        assert!(all.iter().enumerate().all(|(i, pixel)| *pixel == read.pixel(i % WIDTH, i / WIDTH)));
        assert_eq!((all.iter().copied().fold(0.0, f64::max), found.pixel(20, 16)), (limit, limit));
        assert!(all.iter().filter(|pixel| **pixel == limit).count() < 400);
    }
}

#[test]
fn light_errors_name_their_key() {
    let fault = |text: &str| {
        let light: Light = serde_json::from_str(text).map_err(|error| error.to_string())?;
        Synthetic::new(even(light)).map(|_| ()).map_err(|error| error.to_string())
    };
    let lobe = "\"x\": 3, \"sigma_px\": 2, \"height\": 5";
    let cases = [
        (
            format!("{{\"glare\": [{{{lobe}}}, {{\"x\": 3, \"sigma_px\": -2, \"height\": 5}}]}}"),
            "`light.glare[1].sigma_px` is -2; it must be positive",
        ),
        (
            "{\"glare\": [{\"sigma_px\": 2, \"height\": 5, \"y\": \"u\"}]}".into(),
            "`light.glare[0].y` is no formula of t: `u` is not defined (only t is known, the seconds since the first frame",
        ),
        (
            "{\"glare\": [{\"sigma_px\": 1e200, \"height\": 5, \"y\": 3}]}".into(),
            "`light.glare[0].sigma_px` is 1e200; it must be positive, and 1000000000 at most",
        ),
        ("{\"glare\": [{\"sigma_px\": 2}]}".into(), "missing field `height`"),
        (format!("{{\"glare\": [{{{lobe}, \"width\": 3}}]}}"), "unknown field `width`"),
        (
            format!("{{\"glare\": [{}]}}", vec![format!("{{{lobe}}}"); 65].join(",")),
            "`light.glare` has 65 entries; 64 at most",
        ),
        (
            "{\"occluders\": [{\"value\": 2, \"width\": -1}]}".into(),
            "`light.occluders[0].width` is -1; it must be 0 or positive",
        ),
        (
            "{\"occluders\": [{\"value\": 2, \"from_s\": 3, \"to_s\": 3}]}".into(),
            "`light.occluders` has a time that ends before it begins",
        ),
        (
            "{\"occluders\": [{\"value\": 2e6}]}".into(),
            "`light.occluders[0].value` is 2000000; it must be 0 to 1000000",
        ),
        ("{\"blind\": [{\"soft_px\": -0.5}]}".into(), "`light.blind[0].soft_px` is -0.5; it must be 0 to 1000000000"),
        ("{\"slope\": [1]}".into(), "invalid length 1"),
        ("{\"slope\": [1, true]}".into(), "invalid type: boolean `true`, expected a number or a formula of t"),
        ("{\"defocus_px\": 64.1}".into(), "`light.defocus_px` is 64.1; it must be 0 to 64"),
        ("{\"fog\": 1}".into(), "unknown field `fog`"),
    ];
    for (text, expected) in cases {
        let message = fault(&text).unwrap_err();
        assert!(message.starts_with(expected), "{text}: {message}");
    }
    assert_eq!(fault(&format!("{{\"glare\": [{}]}}", vec![format!("{{{lobe}}}"); 64].join(","))), Ok(()));
    for gain in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let message =
            Synthetic::new(SyntheticSpec { gain: gain.into(), ..even(Light::default()) }).err().unwrap().to_string();
        assert_eq!(message, format!("`gain` is {gain}; it must be positive"));
    }
    let light = Light { defocus_px: number(f64::NAN), ..Light::default() };
    assert!(Synthetic::new(even(light)).err().unwrap().to_string().starts_with("`light.defocus_px` is NaN"));
    // A formula that leaves its range later fails only the frames at that time.
    let light = Light { defocus_px: Some("1 - 2*t + 4*t^2*t".parse().unwrap()), ..Light::default() };
    let mut camera =
        Synthetic::new(SyntheticSpec { rate_hz: 1.0, gain: "1/(2 - t)^2".parse().unwrap(), ..even(light) }).unwrap();
    assert!(camera.next().is_ok() && camera.next().is_ok());
    assert_eq!(camera.next().unwrap_err().to_string(), "frame 2: `gain` is inf at t = 2 s; it must be positive");
    assert!(
        camera
            .next()
            .unwrap_err()
            .to_string()
            .starts_with("frame 3: `light.defocus_px` is 103 at t = 3 s; it must be 0 to 64")
    );
}
