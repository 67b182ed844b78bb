//! The synthetic camera: truth, determinism, sub-pixel samples, motion, noise, errors.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_capture::{FrameSource, Light, Moving, SceneSpec, Synthetic, SyntheticSpec};
use isophote_jit::PixelFormat;
use isophote_symbolic::Model;

fn shipped(name: &str) -> Arc<Model> {
    let path = format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Arc::new(Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap())
}

fn model(intensity: &str) -> Arc<Model> {
    let document = format!(
        "name = \"test\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nbx = {{ start = 16.2 }}\nby = {{ start = 11.7 }}\n\
         [constants]\nheight = 100.0\n[model]\nintensity = \"{intensity}\"\n"
    );
    Arc::new(Model::from_toml(&document).unwrap())
}

fn set(pairs: &[(&str, f64)]) -> BTreeMap<String, f64> {
    pairs.iter().map(|(name, value)| (name.to_string(), *value)).collect()
}

fn pixels(camera: &mut Synthetic) -> Vec<f64> {
    let frame = camera.next().unwrap().unwrap().frame;
    let plane = frame.plane_view(0);
    (0..frame.rows()).flat_map(|y| (0..frame.width()).map(move |x| (x, y))).map(|(x, y)| plane.pixel(x, y)).collect()
}

fn small(model: Arc<Model>) -> SyntheticSpec {
    SyntheticSpec { width: 33, height: 21, ..SyntheticSpec::new(model) }
}

/// Every pixel against the mean over its samples, computed here in f64. 16 bits, so that rounding hides nothing: f32 sums of
/// 25 samples of at most 60,000 are accurate to 0.05.
#[test]
fn a_pixel_is_the_mean_of_its_samples() {
    let disc = "if((x-bx)^2/100 + (y-by)^2/36 <= 1, 500*height, 20*height)";
    let plane = "height*(100 + 3*x - 2*y + 0.3*x*y) + bx + by - 27.9";
    let edge = "if(x + 0.3731*y <= bx, 0, 600*height + 0.001*by)";
    let value: [fn(f64, f64) -> f64; 3] = [
        |x, y| if (x - 16.2).powi(2) / 100.0 + (y - 11.7).powi(2) / 36.0 <= 1.0 { 50_000.0 } else { 2000.0 },
        |x, y| 100.0 * (100.0 + 3.0 * x - 2.0 * y + 0.3 * x * y),
        |x, y| if x + 0.3731 * y <= 16.2 { 0.0 } else { 60_000.011_7 },
    ];
    for (formula, value) in [disc, plane, edge].into_iter().zip(value) {
        for samples in [1, 2, 5] {
            let spec = SyntheticSpec { bits: 16, saturation: 65_535.0, samples, ..small(model(formula)) };
            let found = pixels(&mut Synthetic::new(spec).unwrap());
            let n = f64::from(samples);
            let at = |i: u32| (f64::from(i) + 0.5) / n - 0.5;
            for (i, found) in found.iter().enumerate() {
                let (x, y) = ((i % 33) as f64, (i / 33) as f64);
                let sum: f64 = (0..samples)
                    .flat_map(|j| (0..samples).map(move |i| (i, j)))
                    .map(|(i, j)| value(x + at(i), y + at(j)))
                    .sum();
                let expected = sum / (n * n);
                assert!(
                    (found - expected).abs() <= 0.55,
                    "{formula}, {samples} samples, ({x}, {y}): {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn frames_depend_only_on_seed_and_number() {
    let spec = |seed| SyntheticSpec { seed, full_well_e: 5000.0, read_noise_e: 15.0, ..small(shipped("spot")) };
    let (mut first, mut second, mut other) =
        (Synthetic::new(spec(1)).unwrap(), Synthetic::new(spec(1)).unwrap(), Synthetic::new(spec(2)).unwrap());
    let frames: Vec<_> = (0..3).map(|_| pixels(&mut first)).collect();
    assert_eq!(frames[0], pixels(&mut second));
    assert_eq!(frames[1], pixels(&mut second));
    assert_ne!(frames[0], frames[1]);
    assert_ne!(frames[0], pixels(&mut other));
}

/// Exactly these bytes on every machine: rendering uses no fused operations, and noise no platform library.
#[test]
fn a_seed_gives_the_same_bytes_on_every_machine() {
    let spec = SyntheticSpec { full_well_e: 5000.0, read_noise_e: 15.0, seed: 7, ..small(shipped("spot")) };
    let found = pixels(&mut Synthetic::new(spec).unwrap());
    let digest = found.iter().fold(0u64, |digest, pixel| digest.wrapping_mul(0x100_0000_01b3) ^ (*pixel as u64));
    let expected =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/seed-7.txt")).unwrap_or_default();
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/seed-7.txt"), format!("{digest:016x}\n")).unwrap();
    } else {
        assert_eq!(format!("{digest:016x}"), expected.trim());
    }
}

#[test]
fn truth_follows_set_and_motion() {
    let mut spec = small(shipped("spot"));
    spec.set = set(&[("by", 9.5), ("k1", -0.75)]);
    spec.motion = BTreeMap::from([("bx".to_string(), "16 + 4*sin(2*pi*0.5*t)".to_string())]);
    spec.rate_hz = 4.0;
    let mut camera = Synthetic::new(spec).unwrap();
    let mut centres = Vec::new();
    for frame in 0..8u64 {
        let captured = camera.next().unwrap().unwrap();
        assert_eq!(captured.frame.sequence, frame);
        let truth = captured.truth.unwrap();
        let t = frame as f64 / 4.0;
        let expected = 16.0 + 4.0 * (2.0 * std::f64::consts::PI * 0.5 * t).sin();
        assert!((truth["bx"] - expected).abs() < 1e-12);
        assert_eq!((truth["by"], truth["k1"], truth["k2"]), (9.5, -0.75, -0.3));
        // The image follows the truth: centroid above background.
        let plane = captured.frame.plane_view(0);
        let (mut mass, mut moment) = (0.0, 0.0);
        for (x, y) in (0..21).flat_map(|y| (0..33).map(move |x| (x, y))) {
            let light = plane.pixel(x, y) - 20.0;
            (mass, moment) = (mass + light, moment + light * x as f64);
        }
        assert!((moment / mass - expected).abs() < 0.05, "frame {frame}: {} for {expected}", moment / mass);
        centres.push(truth["bx"]);
    }
    assert!(centres.iter().any(|c| (c - 20.0).abs() < 1e-9));
}

#[test]
fn unset_parameters_have_typical_values() {
    let truth = |name: &str| Synthetic::new(SyntheticSpec::new(shipped(name))).unwrap().truth(0).unwrap();
    let spot = truth("spot");
    assert_eq!((spot["bx"], spot["by"]), (319.5, 239.5));
    assert!(
        (spot["a1"] - 1.0 / 3600.0).abs() < 1e-18 && spot["a2"] == 0.0 && (spot["a3"] - 1.0 / 1764.0).abs() < 1e-18
    );
    assert_eq!((spot["k1"], spot["v0"], spot["v1"]), (-0.5, 20.0, 150.0));
    let dark = truth("dark-disc");
    assert_eq!((dark["v0"], dark["v1"]), (200.0, -150.0));
    let line = Synthetic::new(SyntheticSpec::new(shipped("profile-1d"))).unwrap();
    assert_eq!((line.size(), line.truth(0).unwrap()["w"]), (Some(vec![640]), 40.0));
}

/// Pixels clip at the limit, and only those expected there.
#[test]
fn pixels_clip_at_the_saturation_limit() {
    let spec = SyntheticSpec { set: set(&[("v1", 400.0)]), saturation: 253.0, ..SyntheticSpec::new(shipped("spot")) };
    let found = pixels(&mut Synthetic::new(spec).unwrap());
    assert_eq!(found.iter().copied().fold(0.0, f64::max), 253.0);
    let clipped = found.iter().filter(|p| **p == 253.0).count();
    assert!((1500..6000).contains(&clipped), "{clipped}");
}

/// Mean and variance of a uniform field through the whole camera; σ² = m/g + (r/g)² + 1/12, five standard errors.
#[test]
fn noise_matches_the_camera_model() {
    let even = small(model("height + bx + by - 27.9"));
    let spec = SyntheticSpec { width: 640, height: 480, full_well_e: 5000.0, read_noise_e: 15.0, ..even };
    let found = pixels(&mut Synthetic::new(spec).unwrap());
    let n = found.len() as f64;
    let gain = 5000.0 / 255.0;
    let expected = 100.0 / gain + (15.0f64 / gain).powi(2) + 1.0 / 12.0;
    let mean = found.iter().sum::<f64>() / n;
    let variance = found.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / n;
    assert!((mean - 100.0).abs() < 5.0 * (expected / n).sqrt(), "{mean}");
    assert!((variance - expected).abs() < 5.0 * expected * (2.0 / n).sqrt(), "{variance} for {expected}");
}

#[test]
fn more_than_8_bits_give_u16() {
    let spec = SyntheticSpec { bits: 12, saturation: 4095.0, ..small(shipped("spot")) };
    let frame = Synthetic::new(spec).unwrap().next().unwrap().unwrap().frame;
    assert_eq!(frame.planes()[0].format, PixelFormat::U16);
    let background = frame.plane_view(0).pixel(0, 0);
    assert_eq!(background, (20.0 * 4095.0 / 255.0f64).round());
}

#[test]
fn errors_state_the_allowed_values() {
    type Change = fn(&mut SyntheticSpec);
    let fault = |change: Change| {
        let mut spec = SyntheticSpec::new(shipped("spot"));
        change(&mut spec);
        Synthetic::new(spec).err().unwrap().to_string()
    };
    let cases: [(Change, &str); 11] = [
        (|s| s.set = set(&[("bz", 1.0)]), "the model `spot` has no parameter or constant named `bz`; is `bx` meant?"),
        (|s| s.set = set(&[("bx", f64::NAN)]), "a value of `set` is NaN; it must be a finite number"),
        (
            |s| s.motion = BTreeMap::from([("qqq".into(), "t".into())]),
            "the model `spot` has no parameter named `qqq`; its parameters are bx, by, a1",
        ),
        (|s| s.motion = BTreeMap::from([("bx".into(), "320 + u".into())]), "the motion of `bx` is no formula of t: "),
        (|s| s.width = 0, "width is 0; it must be 1 to 32768"),
        (|s| (s.width, s.height) = (32_768, 32_768), "width × height is 1073741824; it must be 1 to 67108864"),
        (|s| s.samples = 33, "samples is 33; it must be 1 to 32"),
        (|s| s.bits = 17, "bits is 17; it must be 1 to 16"),
        (|s| s.saturation = 300.0, "saturation is 300; it must be at least 1 and at most 255, the largest of 8 bits"),
        (|s| s.rate_hz = 0.0, "rate_hz is 0; it must be positive"),
        (|s| s.full_well_e = -1.0, "full_well_e is -1; it must be 0 (no noise) or positive"),
    ];
    for (change, expected) in cases {
        let message = fault(change);
        assert!(message.starts_with(expected), "{message}");
    }
    let mut spec = SyntheticSpec::new(shipped("spot"));
    spec.motion = BTreeMap::from([("bx".into(), "320 + 1/(t - 1/60)".into())]);
    let mut camera = Synthetic::new(spec).unwrap();
    assert!(camera.next().is_ok());
    let message = camera.next().unwrap_err().to_string();
    assert!(message.starts_with("frame 1: the motion of `bx` is inf at t = 0.01666"), "{message}");
    assert!(camera.next().is_ok(), "the frame after is fine again");
}

/// An exposure takes effect `exposure_latency` frames after it is set, on the light and on the truth.
#[test]
fn an_exposure_takes_effect_after_the_latency() {
    let model = shipped("spot");
    for latency in [0, 2, 5] {
        let spec = SyntheticSpec {
            width: 64,
            height: 48,
            set: [("v0".to_string(), 10.0), ("v1".to_string(), 60.0)].into(),
            exposure_latency: latency,
            ..SyntheticSpec::new(model.clone())
        };
        let mut source = Synthetic::new(spec).unwrap();
        let exposure = source.exposure().unwrap();
        let told: Vec<[f64; 3]> = (0..12)
            .map(|number| {
                if number == 3 {
                    exposure.set(2.0);
                    exposure.set(f64::NAN); // ignored
                }
                let captured = source.next().unwrap().unwrap();
                let truth = captured.truth.unwrap();
                [truth["v0"], truth["v1"], captured.frame.plane_view(0).pixel(0, 0)]
            })
            .collect();
        for (number, told) in told.iter().enumerate() {
            let factor = if number >= 3 + latency as usize { 2.0 } else { 1.0 };
            assert_eq!(*told, [10.0 * factor, 60.0 * factor, 10.0 * factor], "latency {latency}, frame {number}");
        }
    }
    let spec = SyntheticSpec { exposure_latency: 65, ..SyntheticSpec::new(model) };
    assert!(Synthetic::new(spec).err().unwrap().to_string().contains("exposure_latency is 65"));
}

/// From the frame at which it takes effect, a changed scene renders like a camera created with it.
#[test]
fn a_scene_changes_between_two_frames() {
    let spec = |height: f64, full_well_e: f64| SyntheticSpec {
        set: set(&[("height", height)]),
        motion: BTreeMap::from([("bx".into(), "16 + 30*t".into())]),
        full_well_e,
        ..small(model("height*exp(-((x-bx)^2 + (y-by)^2)/40)"))
    };
    let scene = |spec: &SyntheticSpec| SceneSpec {
        set: spec.set.clone(),
        motion: spec.motion.clone(),
        exposure: Moving::Number(1.0),
        gain: Moving::Number(1.0),
        full_well_e: spec.full_well_e,
        read_noise_e: 0.0,
        row_noise_e: 0.0,
        light: Light::default(),
    };
    let (before, after) = (spec(100.0, 0.0), spec(200.0, 9000.0));
    let frames = |spec: &SyntheticSpec| -> Vec<Vec<f64>> {
        let mut camera = Synthetic::new(spec.clone()).unwrap();
        (0..6).map(|_| pixels(&mut camera)).collect()
    };
    let (old, new) = (frames(&before), frames(&after));
    let mut camera = Synthetic::new(before.clone()).unwrap();
    let knob = camera.scene().unwrap();
    assert_eq!((pixels(&mut camera), pixels(&mut camera)), (old[0].clone(), old[1].clone()));
    let wrong = SceneSpec { full_well_e: -1.0, ..scene(&after) };
    knob.set(wrong).unwrap_err();
    assert_eq!(pixels(&mut camera), old[2]);
    assert_eq!(knob.set(scene(&before)).unwrap(), 3);
    assert_eq!(knob.set(scene(&after)).unwrap(), 3);
    assert_eq!(pixels(&mut camera), new[3], "the newest wins");
    assert_eq!(pixels(&mut camera), new[4]);
    // A frame that is taken back is rendered again, with the scene at that time.
    assert!(camera.take_back());
    assert_eq!(knob.set(scene(&before)).unwrap(), 4);
    assert_eq!(pixels(&mut camera), old[4]);
}
