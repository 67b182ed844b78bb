//! Cold starts of shipped models on frames rendered from them recover the rendered parameters.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::sync::Arc;

use isophote_capture::{Captured, FrameSource, Synthetic, SyntheticSpec};
use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Buffer, Compiled, Ending, Estimate, Frame, Plane, TrackState, Tracker, TrackerOptions};

fn model(name: &str) -> Arc<Model> {
    let path = format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Arc::new(Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap())
}

fn numbers(set: &[(&str, f64)]) -> BTreeMap<String, f64> {
    set.iter().map(|(name, value)| (name.to_string(), *value)).collect()
}

fn rendered(spec: SyntheticSpec) -> Captured {
    Synthetic::new(spec).unwrap().next().unwrap().unwrap()
}

/// A cold start from the document alone.
fn fitted(model: &Arc<Model>, frame: &Frame) -> Estimate {
    let compiled = Compiled::new(model.clone(), Precision::F32).unwrap();
    let estimate = Tracker::new(Arc::new(compiled), TrackerOptions::default()).unwrap().track(frame);
    let case = format!("{}: {estimate:?}", model.name());
    assert_eq!((estimate.state, estimate.ending), (TrackState::Tracking, Ending::SmallStep), "{case}");
    estimate
}

fn value(model: &Model, estimate: &Estimate, name: &str) -> f64 {
    estimate.parameters[model.parameter(name).unwrap().index()]
}

/// Rendering settings, and tolerances of the parameters without noise.
struct Case {
    model: &'static str,
    size: [usize; 4],
    samples: u32,
    set: &'static [(&'static str, f64)],
    close: &'static [(&'static str, f64)],
}

const CASES: [Case; 11] = [
    Case {
        model: "spot",
        size: [320, 240, 1, 1],
        samples: 8,
        set: &[("bx", 141.3), ("by", 120.6), ("a1", 9e-4), ("a2", 2e-4), ("a3", 12e-4), ("v1", 170.0)],
        close: &[("bx", 0.01), ("by", 0.01), ("v1", 1.0)],
    },
    Case {
        model: "rational-spot",
        size: [320, 240, 1, 1],
        samples: 8,
        set: &[("bx", 141.3), ("by", 120.6), ("a1", 2e-3), ("a3", 3e-3)],
        close: &[("bx", 0.02), ("by", 0.02), ("v1", 1.0)],
    },
    Case {
        model: "moffat",
        size: [160, 120, 1, 1],
        samples: 8,
        set: &[("bx", 71.3), ("by", 60.6), ("a1", 0.02), ("a2", 0.004), ("a3", 0.015), ("b", 3.2), ("v1", 180.0)],
        close: &[("bx", 0.02), ("by", 0.02), ("b", 0.2)],
    },
    Case {
        model: "moffat",
        size: [640, 480, 1, 1],
        samples: 8,
        set: &[("bx", 300.2), ("by", 260.9)],
        close: &[("bx", 0.02), ("by", 0.02), ("b", 0.2)],
    },
    Case {
        model: "ring",
        size: [200, 160, 1, 1],
        samples: 8,
        set: &[("bx", 98.3), ("by", 71.4), ("a1", 7e-4), ("a2", 1e-4), ("a3", 1e-3), ("e", 0.15)],
        close: &[("bx", 0.01), ("by", 0.01), ("e", 0.01), ("a1", 1e-5)],
    },
    Case {
        model: "ring",
        size: [200, 160, 1, 1],
        samples: 8,
        set: &[("bx", 98.3), ("by", 71.4), ("a1", 1.7e-3), ("a3", 2e-3), ("e", 0.9)],
        close: &[("bx", 0.01), ("by", 0.01), ("e", 0.01), ("a1", 1e-5)],
    },
    // One sample: the model itself integrates over the pixel.
    Case {
        model: "gaussian-pixel",
        size: [40, 32, 1, 1],
        samples: 1,
        set: &[("bx", 18.3), ("by", 14.4), ("wx", 1.3), ("wy", 2.1), ("v1", 200.0)],
        close: &[("bx", 0.01), ("by", 0.01), ("wx", 0.02), ("wy", 0.02), ("v1", 2.0)],
    },
    Case {
        model: "gaussian-pixel",
        size: [320, 240, 1, 1],
        samples: 1,
        set: &[("bx", 120.7), ("by", 131.2), ("wx", 20.0), ("wy", 35.0)],
        close: &[("bx", 0.01), ("by", 0.01), ("wx", 0.1), ("wy", 0.1), ("v1", 1.0)],
    },
    Case {
        model: "blob-3d",
        size: [48, 40, 24, 1],
        samples: 1,
        set: &[
            ("bx", 21.3),
            ("by", 22.8),
            ("bz", 10.4),
            ("axx", 0.02),
            ("axy", 0.004),
            ("axz", -0.005),
            ("ayy", 0.015),
        ],
        close: &[("bx", 0.01), ("by", 0.01), ("bz", 0.01), ("axz", 1e-4), ("v1", 1.0)],
    },
    Case {
        model: "blob-3d",
        size: [64, 64, 8, 1], // the blob reaches through the whole stack
        samples: 8,
        set: &[("bx", 31.3), ("by", 28.8), ("bz", 3.1), ("axx", 0.01), ("ayy", 0.012), ("azz", 0.04)],
        close: &[("bx", 0.01), ("by", 0.01), ("bz", 0.01)],
    },
    Case {
        model: "blob-4d",
        size: [32, 32, 16, 8],
        samples: 8,
        set: &[("bx", 12.3), ("by", 17.7), ("bz", 6.2), ("ux", 0.9), ("uy", -0.5), ("uz", 0.4)],
        close: &[("bx", 0.01), ("by", 0.01), ("bz", 0.01), ("ux", 0.003), ("uy", 0.003), ("uz", 0.003)],
    },
];

#[test]
fn cold_starts_recover_the_rendered_parameters() {
    for case in CASES {
        let model = model(case.model);
        let [width, height, depth, length] = case.size;
        let (set, samples) = (numbers(case.set), case.samples);
        let spec = SyntheticSpec { set, width, height, depth, length, samples, ..SyntheticSpec::new(model.clone()) };
        let exact = rendered(spec.clone());
        let truth = exact.truth.unwrap();
        let estimate = fitted(&model, &exact.frame);
        for (name, off) in case.close {
            let error = value(&model, &estimate, name) - truth[*name];
            assert!(error.abs() < *off, "{} {name} is {error} off: {estimate:?}", case.model);
        }
        // With 5000 electrons full well and 15 of read noise: within five standard deviations plus the sampling bias.
        let noisy = rendered(SyntheticSpec { full_well_e: 5000.0, read_noise_e: 15.0, ..spec });
        let estimate = fitted(&model, &noisy.frame);
        for (name, off) in case.close {
            let error = value(&model, &estimate, name) - truth[*name];
            let sigma = estimate.deviation(model.parameter(name).unwrap()).unwrap();
            assert!(error.abs() < *off + 5.0 * sigma, "{} {name} is {error} off, σ {sigma}", case.model);
        }
    }
}

/// The three lights are rendered separately and mixed as a camera's channels would.
#[test]
fn three_coloured_spots_are_found_by_colour() {
    let (width, height) = (320, 240);
    let places = [("r", [80.3, 60.7]), ("g", [220.6, 90.2]), ("b", [150.4, 180.9])];
    let light = |[x, y]: [f64; 2]| {
        let set =
            numbers(&[("bx", x), ("by", y), ("a1", 1.0 / 900.0), ("a3", 1.0 / 625.0), ("v0", 0.0), ("v1", 150.0)]);
        let frame = rendered(SyntheticSpec { set, width, height, ..SyntheticSpec::new(model("spot")) }).frame;
        frame.planes()[0].buffer.bytes().to_vec()
    };
    let lights = places.map(|(_, place)| light(place));
    let mixing = [[1.0, 0.12, 0.03], [0.10, 1.0, 0.12], [0.02, 0.08, 1.0]];
    let pixel = |i: usize| {
        mixing.map(|row| row.iter().zip(&lights).map(|(m, light)| m * f64::from(light[i])).sum::<f64>() + 20.0)
    };
    let bytes: Vec<u8> = (0..width * height).flat_map(pixel).map(|v| v.round() as u8).collect();
    let buffer = Buffer::Owned(bytes.into());
    let planes = (0..3).map(|channel| Plane::interleaved(PixelFormat::U8, &buffer, width, 3, channel)).collect();
    let frame = Frame::new(&[width, height], planes).unwrap();
    let model = model("three-spots");
    let estimate = fitted(&model, &frame);
    for ((colour, [x, y]), share) in places.into_iter().zip([1.0, 0.6, 0.36]) {
        let error = (value(&model, &estimate, &format!("x{colour}")) - x)
            .hypot(value(&model, &estimate, &format!("y{colour}")) - y);
        assert!(error < 0.02, "{colour} is {error} px off: {estimate:?}");
        let brightness = value(&model, &estimate, &format!("v{colour}"));
        assert!((brightness / (150.0 * share) - 1.0).abs() < 0.03, "{colour}: {brightness}");
    }
}
