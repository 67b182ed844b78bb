//! Multi-channel documents: rendering by the synthetic camera, and finding each target by its colour from a cold start.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_capture::{Captured, FrameSource, Synthetic, SyntheticSpec, decode, encode_png_planes};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Frame, Plane, TrackState, Tracker, TrackerOptions};

fn shipped(name: &str) -> Arc<Model> {
    let path = format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Arc::new(Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap())
}

fn two_channels(observed: &str, intensity: &str) -> Arc<Model> {
    let text = format!(
        "name = \"two\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"p\", \"q\"]\n[parameters]\nv = {{ start = 3.0 }}\n\
         [constants]\nc = 2.0\n[model]\nobserved = \"{observed}\"\nintensity = \"{intensity}\"\n"
    );
    Arc::new(Model::from_toml(&text).unwrap())
}

fn rendered(spec: SyntheticSpec) -> Captured {
    Synthetic::new(spec).unwrap().next().unwrap().unwrap()
}

fn plane(frame: &Frame, number: usize) -> Vec<f64> {
    let view = frame.plane_view(number);
    let [width, height, ..] = frame.sides();
    (0..width * height).map(|i| view.pixel(i % width, i / width)).collect()
}

/// Each plane follows its own channel's formula, in any order of `observed`.
#[test]
fn every_channel_reads_its_own_prediction() {
    for (observed, intensity) in
        [("[p, q]", "[v + x + 2*y, c * (v + x) + 40]"), ("[q, p]", "[c * (v + x) + 40, v + x + 2*y]")]
    {
        let spec = SyntheticSpec { width: 40, height: 12, ..SyntheticSpec::new(two_channels(observed, intensity)) };
        let captured = rendered(SyntheticSpec { set: BTreeMap::from([("c".to_string(), 3.0)]), ..spec });
        assert_eq!(captured.frame.planes().len(), 2);
        let of = |f: &dyn Fn(f64, f64) -> f64| (0..480).map(|i| f((i % 40) as f64, (i / 40) as f64)).collect();
        let [p, q]: [Vec<f64>; 2] = [of(&|x, y| 3.0 + x + 2.0 * y), of(&|x, _| 3.0 * (3.0 + x) + 40.0)];
        assert_eq!((plane(&captured.frame, 0), plane(&captured.frame, 1)), (p, q), "{observed}");
        assert_eq!(captured.truth.unwrap(), BTreeMap::from([("v".to_string(), 3.0)]));
    }
}

/// Three planes of 8 or 16 bit encode as a colour picture; two are rejected.
#[test]
fn colour_pictures_round_trip_plane_by_plane() {
    for (format, bytes) in [(PixelFormat::U8, 6), (PixelFormat::U16, 12)] {
        let planes: [Vec<u8>; 3] = std::array::from_fn(|plane| (0..bytes).map(|i| 40 * plane as u8 + i).collect());
        let png = encode_png_planes(3, 2, format, &planes.each_ref().map(Vec::as_slice)).unwrap();
        let frame = decode(&png).unwrap();
        for (number, bytes) in planes.into_iter().enumerate() {
            let alone = Frame::new(&[3, 2], vec![Plane::owned(format, bytes, 3)]).unwrap();
            assert_eq!(plane(&frame, number), plane(&alone, 0), "{format:?}, plane {number}");
        }
    }
    let two = encode_png_planes(3, 2, PixelFormat::U8, &[&[0; 6], &[0; 6]]).unwrap_err();
    assert_eq!(two.to_string(), "pictures have 1 channel or 3 (r, g, b), not 2");
}

/// Both channels have equal noise, uncorrelated: r < 4 standard errors.
#[test]
fn channels_have_independent_noise() {
    let model = two_channels("[p, q]", "[97 + v, 97 + v]");
    let spec = SyntheticSpec { full_well_e: 5000.0, read_noise_e: 15.0, ..SyntheticSpec::new(model) };
    let frame = rendered(spec).frame;
    let (p, q) = (plane(&frame, 0), plane(&frame, 1));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - 100.0) * (b - 100.0)).sum::<f64>();
    let n = p.len() as f64;
    assert!((product(&p, &p) / product(&q, &q) - 1.0).abs() < 4.0 * 2.0 / n.sqrt());
    let correlation = product(&p, &q) / (product(&p, &p) * product(&q, &q)).sqrt();
    assert!(correlation.abs() < 4.0 / n.sqrt(), "{correlation}");
}

#[test]
fn unrenderable_models_are_rejected_with_a_reason() {
    let fault = |model: Arc<Model>| Synthetic::new(SyntheticSpec::new(model)).err().unwrap().to_string();
    let mixed = fault(shipped("three-spots"));
    assert!(mixed.contains("`observed` mixes the channels r, g, b, so that nothing says"), "{mixed}");
    assert!(mixed.contains("observed = \"[r, g, b]\""), "{mixed}");
    let missing = fault(two_channels("p", "v"));
    assert!(missing.contains("nothing says what the channel q reads"), "{missing}");
}

/// Positions of the three spots, px.
const PLACES: [(&str, [f64; 2]); 3] = [("r", [60.3, 50.7]), ("g", [170.6, 62.2]), ("b", [110.4, 130.9])];

/// 25 % crosstalk into the next channel, 10 % into the one after.
fn crosstalk() -> BTreeMap<String, f64> {
    let names = ["r", "g", "b"];
    let share = |row: usize, column: usize| [1.0, 0.25, 0.10][(row + 3 - column) % 3];
    let all = (0..9).map(|i| (i / 3, i % 3));
    all.map(|(row, column)| (format!("m_{}{}", names[row], names[column]), share(row, column))).collect()
}

fn coloured_frame(model: &Arc<Model>, brightness: [f64; 3]) -> Frame {
    let mut set = crosstalk();
    for ((name, [x, y]), v) in PLACES.into_iter().zip(brightness) {
        let own = [("x", x), ("y", y), ("v", v)].map(|(key, value)| (format!("{key}{name}"), value));
        let shape = [("1", 1.0 / 900.0), ("2", 1e-4), ("3", 1.0 / 625.0)].map(|(key, a)| (format!("{name}{key}"), a));
        set.extend(own.into_iter().chain(shape));
    }
    set.extend([("v0r", 24.0), ("v0g", 18.0), ("v0b", 12.0)].map(|(name, v)| (name.to_string(), v)));
    let spec = SyntheticSpec { set, width: 240, height: 180, samples: 8, ..SyntheticSpec::new(model.clone()) };
    rendered(SyntheticSpec { full_well_e: 5000.0, read_noise_e: 15.0, seed: 5, ..spec }).frame
}

/// All orders of brightness, also with the brightest far above saturation.
#[test]
fn each_spot_is_found_by_its_colour_whichever_is_brighter() {
    let model = shipped("three-spots-raw");
    let compiled = Arc::new(Compiled::new(model.clone(), Precision::F32).unwrap());
    let levels = [180.0, 100.0, 45.0];
    for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        for brightest in [180.0, 700.0] {
            let brightness = order.map(|level: usize| if level == 0 { brightest } else { levels[level] });
            let frame = coloured_frame(&model, brightness);
            let options = TrackerOptions { constants: crosstalk(), ..TrackerOptions::default() };
            let estimate = Tracker::new(compiled.clone(), options).unwrap().track(&frame);
            assert_eq!(estimate.state, TrackState::Tracking, "{brightness:?}: {estimate:?}");
            for ((name, [x, y]), v) in PLACES.into_iter().zip(brightness) {
                for (key, truth) in [(format!("x{name}"), x), (format!("y{name}"), y), (format!("v{name}"), v)] {
                    let id = model.parameter(&key).unwrap();
                    let (found, sigma) = (estimate.parameters[id.index()], estimate.deviation(id).unwrap());
                    let bound = 5.0 * sigma + 2e-3 * v.max(1.0) * f64::from(u8::from(key.starts_with('v')));
                    assert!((found - truth).abs() < bound, "{brightness:?}, {key}: {found} for {truth}, σ {sigma}");
                }
            }
        }
    }
}
