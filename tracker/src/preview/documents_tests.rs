//! Residuals, sections and contours of every shipped document against the interpreter's values of its formulas.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::sync::Arc;

use isophote_frame::{Frame, Plane};
use isophote_jit::{PixelFormat, Window};
use isophote_symbolic::{Bindings, Lanes, Lowering, Model, Precision, Prediction, Summand, interpreter};

use super::picture::{PreviewDepth, PreviewPart};
use super::viewer::FrameScene;
use crate::estimate::{Ending, Estimate, TrackState};
use crate::options::TrackerOptions;
use crate::report::points::{ModelPoint, Numbers, sizes};
use crate::solve::compiled::Compiled;
use crate::track::tracker::Tracker;
use crate::track::window::Reach;

/// χ²/ν of the synthetic estimates: σ is 2 where none is stated.
const REDUCED: f64 = 4.0;
/// Image size of poses, px: the lens is centred there.
const POSED_PX: [usize; 2] = [640, 480];

/// A document with a frame and an estimate.
struct Case {
    model: Arc<Model>,
    parameters: Vec<f64>,
    constants: Vec<f64>,
    frame: Frame,
    estimate: Estimate,
}

fn estimate(parameters: &[f64], state: TrackState) -> Estimate {
    Estimate {
        target: "0".into(),
        sequence: 7,
        capture_ns: None,
        state,
        parameters: parameters.to_vec(),
        order: Vec::new(),
        covariance: None,
        objective: None,
        reduced_chi_square: Some(REDUCED),
        noise_ratio: None,
        photometry: None,
        log_likelihood: None,
        confidence: None,
        exposure_advice: None,
        ahead: Vec::new(),
        pixels: 0,
        left_out: None,
        saturated: 0.0,
        iterations: Vec::new(),
        converged: true,
        ending: Ending::SmallStep,
        rejection: None,
        quality: Vec::new(),
        candidate: None,
        stages: Vec::new(),
        substitute: None,
        sampled: None,
        strongest: None,
        pose: None,
    }
}

fn case(path: &Path) -> Case {
    let model = Model::from_toml(&std::fs::read_to_string(path).unwrap());
    let model = Arc::new(model.unwrap_or_else(|faults| panic!("{}", faults[0].render("a shipped document"))));
    let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
    let reach = Reach::of(&model, &constants);
    let size = sizes(&model)[0];
    let point = ModelPoint::made_up(&model, &constants, &reach, size, Numbers::AsStarted).unwrap();
    let is_pose = model.roles().iter().any(|roles| !roles.position.is_empty());
    let sides: Vec<usize> = match is_pose {
        true => POSED_PX.to_vec(),
        // Slightly larger than the target.
        false => (0..model.coordinates().len())
            .map(|axis| point.window.first()[axis] + point.window.size()[axis] + 3)
            .collect(),
    };
    let parameters = point.parameters;
    let summands = model.summands().into_iter().filter(|summand| !summand.is_clipped());
    let own: Vec<Summand> = summands.collect();
    let own = if own.len() == model.channels().len() { own } else { Vec::new() };
    let plane = |channel: usize| {
        // The prediction plus noise; only noise where the observed value mixes several channels.
        let value = |i: usize| {
            let noise = ((7 * i + 13 * (i / sides[0]) + 5 * channel) % 31) as f64 / 4.0 - 4.0;
            let place = sides.iter().scan(i, |rest, side| Some((std::mem::replace(rest, *rest / side) % side) as f64));
            let place: Vec<f64> = place.collect();
            let own = own.get(channel).filter(|own| own.model().domain_holds(&place, &parameters, &constants));
            noise + own.map_or(60.0, |own| own.predicted(&place, &parameters, &constants))
        };
        let bytes: Vec<u8> = (0..sides.iter().product()).flat_map(|i| (value(i) as f32).to_le_bytes()).collect();
        Plane::owned(PixelFormat::F32, bytes, sides[0])
    };
    let frame = Frame::new(&sides, (0..model.channels().len()).map(plane).collect()).unwrap().with_sequence(7);
    let estimate = estimate(&parameters, TrackState::Tracking);
    Case { model, parameters, constants, frame, estimate }
}

/// Evaluates a formula with the interpreter, in f64.
fn interpreted(case: &Case, summand: &Summand, what: Prediction, window: Window) -> Vec<f64> {
    struct NoPixels;
    impl interpreter::Pixels for NoPixels {
        fn at(&self, _: usize, _: usize, _: usize) -> f64 {
            f64::NAN
        }
    }
    let program = summand.prediction(what, Lowering::default()).unwrap().unwrap();
    let (parameters, constants) = (&case.parameters[..], &case.constants[..]);
    let bindings = Bindings { parameters, entry: parameters, constants, ..Bindings::default() };
    let mut plane = vec![0.0f32; window.pixels()];
    let lanes = Lanes::Two;
    interpreter::run(&program, Precision::F64, lanes, &bindings, &NoPixels, window, Some(&mut plane));
    plane.into_iter().map(f64::from).collect()
}

/// For each observed value, the observation, the prediction and σ of the pixels of a window.
fn expected(case: &Case, window: Window) -> Vec<[Vec<f64>; 3]> {
    let views: Vec<_> = (0..case.frame.planes().len()).map(|channel| case.frame.plane_view(channel)).collect();
    let places: Vec<[usize; 4]> = (0..window.pixels())
        .map(|i| {
            let [x, y, z, w] = window.first();
            [x + i % window.width, y + i / window.width, z, w]
        })
        .collect();
    let of = |summand: &Summand| {
        let observed = places.iter().map(|place| {
            let channels: Vec<f64> = views.iter().map(|view| view.pixel_at(*place)).collect();
            summand.observed(&channels, &case.constants)
        });
        let sigma = match summand.model().has_noise() {
            true => interpreted(case, summand, Prediction::Variance, window).into_iter().map(f64::sqrt).collect(),
            false => vec![REDUCED.sqrt(); window.pixels()],
        };
        [observed.collect(), interpreted(case, summand, Prediction::Intensity, window), sigma]
    };
    let summands = case.model.summands();
    summands.iter().filter(|summand| !summand.is_clipped()).map(of).collect()
}

/// Whether a pixel is so close to the domain's edge that f32 and f64 may disagree.
fn is_at_rim(case: &Case, place: [f64; 4]) -> bool {
    let coordinates = case.model.coordinates().len();
    let holds = |off: f64| {
        let moved = place.map(|at| at + off);
        case.model.domain_holds(&moved[..coordinates], &case.parameters, &case.constants)
    };
    holds(1e-3) != holds(-1e-3)
}

fn check_residuals(case: &Case, scene: &FrameScene<'_>, name: &str) {
    let picture = scene.picture(PreviewPart::Residual, 1, PreviewDepth::Sixteen);
    let window = scene.window.unwrap();
    assert_eq!([picture.width, picture.height], [window.width, window.height], "{name}");
    assert_eq!(picture.origin, [window.x as f64, window.y as f64], "{name}");
    let expected = expected(case, window);
    let mut compared = 0;
    for (i, sent) in picture.bytes.chunks_exact(2).enumerate() {
        let sent = f64::from(u16::from_le_bytes([sent[0], sent[1]])) / 65535.0 * 10.0 - 5.0;
        let residuals = expected.iter().map(|[observed, predicted, sigma]| (observed[i] - predicted[i]) / sigma[i]);
        let residual = residuals.filter(|r| !r.is_nan()).max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let wanted = residual.map_or(0.0, |r| r.clamp(-5.0, 5.0));
        let [x, y, z, w] = window.first();
        let place = [x + i % window.width, y + i / window.width, z, w].map(|at| at as f64);
        assert!((sent - wanted).abs() < 2e-3 || is_at_rim(case, place), "{name} at {place:?}: {sent}, {wanted}");
        compared += usize::from(residual.is_some_and(|r| r.abs() < 5.0));
    }
    assert!(compared > 20, "{name}: {compared} residuals within the scale");
}

fn check_section(case: &Case, scene: &FrameScene<'_>, name: &str) {
    let section = scene.overlay().section.unwrap_or_else(|| panic!("{name} has no section"));
    if let Some(y) = case.model.roles()[0].centre.get(1) {
        assert_eq!(section.y, case.parameters[y.index()].round() as usize, "{name}");
    }
    let window = scene.window.unwrap();
    let row = Window { x: section.x, y: section.y, width: section.observed.len(), height: 1, ..window };
    let [observed, predicted, sigma] = &expected(case, row)[0];
    let mut inside = 0;
    for i in 0..row.width {
        let place = [row.x + i, row.y, row.slices.first[0], row.slices.first[1]].map(|at| at as f64);
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-4 * (1.0 + b.abs());
        assert!(near(section.observed[i], observed[i]), "{name} {i}: {} {}", section.observed[i], observed[i]);
        if is_at_rim(case, place) {
            continue;
        }
        let (model, own) = (f64::from(section.model[i]), f64::from(section.sigma[i]));
        assert_eq!(model.is_nan(), predicted[i].is_nan(), "{name} {place:?}");
        if !model.is_nan() {
            inside += 1;
            assert!(near(model, predicted[i]) && near(own, sigma[i]), "{name} {place:?}: {model} {own}");
        }
    }
    assert!(inside > 3, "{name}: {inside} pixels of the section are in the domain");
}

/// True when the edge crosses the lattice at a point, along x or y, whichever connects two pixels.
fn is_edge(case: &Case, scene: &FrameScene<'_>, [x, y]: [f64; 2]) -> bool {
    const NEAR_PX: f64 = 0.04;
    let coordinates = case.model.coordinates().len();
    let [z, w] = scene.slice.map(|at| at as f64);
    let has_domain = case.model.document().pointer("/model/domain").is_some();
    let intensity = (!has_domain).then(|| expected(case, scene.window.unwrap()).swap_remove(0)[1].clone());
    let inside = |x: f64, y: f64| match &intensity {
        None => case.model.domain_holds(&[x, y, z, w][..coordinates], &case.parameters, &case.constants),
        Some(plane) => {
            let ground = case.parameters[case.model.roles()[0].background.unwrap().index()];
            let peak = plane.iter().copied().max_by(|a, b| (a - ground).abs().total_cmp(&(b - ground).abs())).unwrap();
            let value = case.model.predicted(&[x, y, z, w][..coordinates], &case.parameters, &case.constants);
            (value - ground) / (peak - ground) >= 0.5
        }
    };
    // Linear interpolation between two pixels is straighter than the formula.
    let near = if has_domain { NEAR_PX } else { 5.0 * NEAR_PX };
    let crosses = |dx: f64, dy: f64| inside(x - dx, y - dy) != inside(x + dx, y + dy);
    crosses(near, 0.0) || crosses(0.0, near)
}

#[test]
#[ignore = "long proof"]
fn previews_of_every_shipped_document_match_its_formulas() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    assert!(paths.len() >= 25);
    for path in paths {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let case = case(&path);
        let compiled = Arc::new(Compiled::new(case.model.clone(), Precision::F32).unwrap());
        let viewer = Tracker::new(compiled, TrackerOptions::default()).unwrap().viewer();
        let estimates = [case.estimate.clone()];
        let scene = viewer.scene(&case.frame, &estimates);
        check_residuals(&case, &scene, &name);
        check_section(&case, &scene, &name);
        let overlay = scene.overlay();
        assert_eq!(overlay.contours.is_empty(), case.model.coordinates().len() == 1, "{name}");
        for point in overlay.contours.concat() {
            assert!(is_edge(&case, &scene, point), "{name}: {point:?} is not on the edge");
        }
        // Touching domains share one edge; every target is inside some contour.
        for roles in case.model.roles().iter().filter(|roles| roles.centre.len() > 1) {
            for (axis, id) in roles.centre.iter().take(2).enumerate() {
                let along: Vec<f64> = overlay.contours.concat().iter().map(|point| point[axis]).collect();
                let ends = along.iter().fold([f64::MAX, f64::MIN], |[low, high], at| [at.min(low), at.max(high)]);
                assert!((ends[0]..ends[1]).contains(&case.parameters[id.index()]), "{name}: {ends:?}");
            }
        }
    }
}

#[test]
fn untracked_targets_have_no_outline() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/spot.toml");
    let case = case(&path);
    let compiled = Arc::new(Compiled::new(case.model.clone(), Precision::F32).unwrap());
    let viewer = Tracker::new(compiled, TrackerOptions::default()).unwrap().viewer();
    for (state, is_seen) in [
        (TrackState::Tracking, true),
        (TrackState::Coasting, true),
        (TrackState::Lost, false),
        (TrackState::Searching, false),
    ] {
        let overlay = viewer.scene(&case.frame, &[estimate(&case.parameters, state)]).overlay();
        let seen = [!overlay.contours.is_empty(), overlay.section.is_some(), overlay.window.is_some()];
        assert_eq!(seen, [is_seen; 3], "{state:?}");
    }
    // A target that was never found has no parameters; and a frame of another kind.
    let nothing = viewer.scene(&case.frame, &[estimate(&[], TrackState::Searching)]);
    assert!(nothing.overlay().contours.is_empty());
    let line = Frame::new(&[5], vec![Plane::owned(PixelFormat::U8, vec![1, 2, 3, 4, 5], 5)]).unwrap();
    let scene = viewer.scene(&line, &[case.estimate]);
    assert!(scene.overlay().section.is_none());
    assert_eq!(scene.picture(PreviewPart::Residual, 1, PreviewDepth::Eight).bytes, [128; 5]);
    assert_eq!(scene.picture(PreviewPart::Frame, 1, PreviewDepth::Eight).bytes, [1, 2, 3, 4, 5]);
}

/// Pixels are means of blocks in every format; incomplete blocks at the sides are dropped.
#[test]
fn pictures_of_all_kinds() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/spot.toml");
    let model = Arc::new(Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap());
    let compiled = Arc::new(Compiled::new(model, Precision::F32).unwrap());
    let viewer = Tracker::new(compiled, TrackerOptions::default()).unwrap().viewer();
    let values: [u16; 15] = [10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 150];
    let frame = |format, bytes: Vec<u8>| Frame::new(&[5, 3], vec![Plane::owned(format, bytes, 5)]).unwrap();
    let eight = frame(PixelFormat::U8, values.iter().map(|v| *v as u8).collect());
    let wide = frame(PixelFormat::U16, values.iter().flat_map(|v| v.to_le_bytes()).collect());
    let real = frame(PixelFormat::F32, values.iter().flat_map(|v| f32::from(*v).to_le_bytes()).collect());
    let shown = |frame: &Frame, step, depth| viewer.scene(frame, &[]).picture(PreviewPart::Frame, step, depth);
    let small = shown(&eight, 2, PreviewDepth::Eight);
    assert_eq!((small.width, small.height, small.origin, small.step), (2, 1, [0.5, 0.5], 2));
    assert_eq!(small.bytes, [40, 60]); // (10 + 20 + 60 + 70)/4, (30 + 40 + 80 + 90)/4
    assert_eq!(shown(&eight, 1, PreviewDepth::Sixteen).bytes[..2], (10 * 257u16).to_le_bytes());
    let plain = shown(&wide, 1, PreviewDepth::Sixteen);
    assert_eq!((&plain.bytes[2..4], plain.levels), (&20u16.to_le_bytes()[..], [0.0, 65535.0]));
    let stretched = shown(&wide, 1, PreviewDepth::Eight);
    assert_eq!((stretched.levels, stretched.bytes[14]), ([0.0, 150.0], 255));
    let known = wide.clone().with_largest(300.0);
    assert_eq!(shown(&known, 1, PreviewDepth::Eight).bytes[14], 128);
    let fractions = shown(&real, 1, PreviewDepth::Eight);
    assert_eq!((fractions.levels, fractions.bytes[0], fractions.bytes[14]), ([10.0, 150.0], 0, 255));
    let whole = shown(&eight, 1000, PreviewDepth::Eight);
    assert_eq!((whole.width, whole.height, whole.bytes), (1, 1, vec![80]));
    let buffer =
        isophote_frame::Buffer::Owned((0..45).map(|i| if i % 3 == 0 { 200 } else { 0 }).collect::<Vec<u8>>().into());
    let planes = (0..3).map(|channel| Plane::interleaved(PixelFormat::U8, &buffer, 5, 3, channel)).collect();
    let colours = Frame::new(&[5, 3], planes).unwrap();
    let coloured = shown(&colours, 1, PreviewDepth::Colour);
    assert_eq!((coloured.channels, &coloured.bytes[..3]), (3, &[200, 0, 0][..]));
    let grey = shown(&colours, 1, PreviewDepth::Eight);
    assert_eq!((grey.channels, grey.bytes[0]), (1, 60)); // 0.299 · 200
}
