#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::{Falloff, Spot, TestPicture};
use crate::solve::workers::InTurn;
use isophote_frame::Plane;
use isophote_jit::{PixelFormat, Slices, Window};
use isophote_symbolic::{Model, Precision};

const SPOT: &str = include_str!("../../../tests/documents/plain-spot.toml");
const THESIS: &str = include_str!("../../../models/thesis-spot.toml");
const DISC: &str = include_str!("../../../models/dark-disc.toml");
const GAUSSIAN: &str = include_str!("../../../models/gaussian.toml");

fn compiled(document: &str, precision: Precision) -> Arc<Compiled> {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    Arc::new(Compiled::new(Arc::new(model), precision).unwrap())
}

fn tracker(document: &str, start: &[(&str, f64)]) -> Tracker {
    let start = start.iter().map(|(name, value)| (name.to_string(), *value)).collect();
    Tracker::new(compiled(document, Precision::F32), TrackerOptions { start, ..TrackerOptions::default() }).unwrap()
}

/// The profile that models/spot.toml holds.
fn spot(x: f64, y: f64, half: [f64; 2], angle: f64, amplitude: f64) -> Spot {
    Spot { centre: [x, y], half, angle, amplitude, profile: Falloff::Cubic(-0.5, -0.3) }
}

fn named(tracker: &Tracker, estimate: &Estimate, name: &str) -> f64 {
    estimate.parameters[tracker.compiled().model().parameter(name).unwrap().index()]
}

fn centre_error(tracker: &Tracker, estimate: &Estimate, spot: &Spot) -> f64 {
    (named(tracker, estimate, "bx") - spot.centre[0]).hypot(named(tracker, estimate, "by") - spot.centre[1])
}

/// Amplitude at which a share of the spot's pixels is saturated: f(s) = f(share), since the area goes with s.
fn amplitude_for(share: f64) -> f64 {
    235.0 / (1.0 - 0.5 * share - 0.3 * share.powi(2) - 0.2 * share.powi(3))
}

#[test]
fn from_twenty_pixels_off_with_and_without_saturation() {
    // Share of saturated pixels, allowed error of the centre (issue 2), sub-pixel samples.
    for (share, off) in [(0.0, 0.01), (0.3, 0.02)] {
        for (samples, angle) in [(1, 0.0), (8, 0.6)] {
            let amplitude = if share > 0.0 { amplitude_for(share) } else { 150.0 };
            let truth = spot(322.3, 238.8, [60.0, 42.0], angle, amplitude);
            let frame = TestPicture { samples, ..TestPicture::new(640, 480, vec![truth]) }.frame();
            let mut tracker = tracker(SPOT, &[("bx", 342.3), ("by", 238.8)]);
            let estimate = tracker.track(&frame);
            let case = format!("{share} {samples}: {estimate:?}");
            assert_eq!((estimate.state, estimate.ending), (TrackState::Tracking, Ending::SmallStep), "{case}");
            let error = centre_error(&tracker, &estimate, &truth);
            assert!(error < off, "{error} {case}");
            assert!((named(&tracker, &estimate, "v1") / amplitude - 1.0).abs() < 0.02, "{case}");
            assert!(estimate.converged && estimate.covariance.is_some(), "{case}");
            let saturated = estimate.saturated * 2.2; // of the domain s ≤ 2.2
            assert!((saturated - share).abs() < 0.02, "{saturated} {case}");
        }
    }
}

#[test]
fn every_size_from_a_cold_start() {
    for (half, amplitude, noise, size) in [
        ([5.0, 3.5], 150.0, 1.0, [128, 96]),
        ([20.0, 14.0], 30.0, 1.0, [128, 96]),
        ([20.0, 14.0], amplitude_for(0.3), 1.0, [128, 96]),
        ([20.0, 14.0], amplitude_for(0.6), 1.0, [128, 96]),
        ([60.0, 42.0], 100.0, 4.0, [320, 240]),
        ([150.0, 100.0], 150.0, 2.0, [320, 240]),
    ] {
        for seed in 0..3 {
            let centre = [0.5 * size[0] as f64 + 7.3, 0.5 * size[1] as f64 - 5.8];
            let truth = spot(centre[0], centre[1], half, 0.4, amplitude);
            let picture = TestPicture { noise, seed, ..TestPicture::new(size[0], size[1], vec![truth]) };
            let mut tracker = tracker(SPOT, &[]);
            let estimate = tracker.track(&picture.frame());
            let case = format!("{half:?} {amplitude} seed {seed}: {estimate:?}");
            assert_eq!(estimate.state, TrackState::Tracking, "{case}");
            let bx = tracker.compiled().model().parameter("bx").unwrap();
            let sigma = estimate.deviation(bx).unwrap();
            let error = centre_error(&tracker, &estimate, &truth);
            assert!(error < 6.0 * sigma && sigma < 0.1, "{error} {sigma} {case}");
        }
    }
}

/// Mean of dᵀC⁻¹d over (bx, by): 2 when the covariance is honest.
#[test]
fn covariance_is_honest() {
    let noisy = SPOT
        .replace("saturated  = \"dropped\"", "saturated  = \"dropped\"\nnoise = \"sigma^2\"\n[constants]\nsigma = 3.0");
    for document in [SPOT, noisy.as_str()] {
        let mut sum = 0.0;
        let compiled = compiled(document, Precision::F32);
        let frames = 60;
        for seed in 0..frames {
            let truth = spot(40.2 + 0.37 * (seed % 7) as f64, 38.9, [14.0, 10.0], 0.3, 120.0);
            let picture = TestPicture { noise: 3.0, seed, ..TestPicture::new(80, 80, vec![truth]) };
            let mut tracker = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
            let estimate = tracker.track(&picture.frame());
            assert!(estimate.converged, "{estimate:?}");
            let c = estimate.covariance.clone().unwrap();
            let (dx, dy) = (
                named(&tracker, &estimate, "bx") - truth.centre[0],
                named(&tracker, &estimate, "by") - truth.centre[1],
            );
            let determinant = c[0][0] * c[1][1] - c[0][1] * c[1][0];
            sum += (c[1][1] * dx * dx - 2.0 * c[0][1] * dx * dy + c[0][0] * dy * dy) / determinant;
            let reduced = estimate.reduced_chi_square.unwrap();
            let expected = if compiled.model().has_noise() { 1.0 } else { 9.0 };
            assert!((reduced / expected - 1.0).abs() < 0.15, "{reduced}");
        }
        let mean = sum / frames as f64;
        assert!((1.2..2.9).contains(&mean), "{mean}"); // 2 ± 2/√60·…: four standard deviations
    }
}

#[test]
fn a_dark_disc() {
    let disc = Spot { profile: Falloff::Disc, ..spot(150.4, 119.7, [30.0, 22.0], 0.5, -130.0) };
    let picture = TestPicture { ground: 200.0, noise: 2.0, samples: 8, ..TestPicture::new(320, 240, vec![disc]) };
    let mut tracker = tracker(DISC, &[]);
    let estimate = tracker.track(&picture.frame());
    assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
    assert!(centre_error(&tracker, &estimate, &disc) < 0.03, "{estimate:?}");
    let v1 = named(&tracker, &estimate, "v1");
    assert!((v1 + 130.0).abs() < 4.0, "{v1}");
    assert!(estimate.stages.len() == 2 && estimate.iterations.iter().all(|&n| n > 0));
    // A bright one is refused by the bound.
    let bright = Spot { amplitude: 50.0, ..disc };
    let lost = tracker.track(&TestPicture { ground: 100.0, ..TestPicture::new(320, 240, vec![bright]) }.frame());
    assert_eq!(lost.state, TrackState::Lost, "{lost:?}");
}

#[test]
fn the_thesis_spot_staged_from_moments() {
    // A domain that moves with the parameters: each pass has its own pixel set, and the fit holds still on it.
    let truth = spot(160.7, 119.2, [60.0, 42.0], 0.0, 150.0);
    let mut tracker = tracker(THESIS, &[]);
    let estimate = tracker.track(&TestPicture::new(320, 240, vec![truth]).frame());
    assert_eq!(estimate.state, TrackState::Tracking, "{estimate:?}");
    assert!(centre_error(&tracker, &estimate, &truth) < 0.1, "{estimate:?}");
}

#[test]
fn a_shrinking_domain_is_reported() {
    // The thesis' domain on a frame without a spot at the given start: the ellipse closes in.
    let picture = TestPicture { noise: 3.0, ..TestPicture::new(160, 120, vec![]) };
    let start = [("bx", 80.0), ("by", 60.0), ("a1", 1e-3), ("a2", 0.0), ("a3", 1e-3), ("v0", 20.0), ("v1", 100.0)];
    let mut tracker = tracker(THESIS, &start);
    let estimate = tracker.track(&picture.frame());
    assert_eq!(estimate.state, TrackState::Searching, "{estimate:?}");
    assert!(estimate.domain_shrank() && estimate.indefinite_steps() > 0, "{estimate:?}");
    assert!(estimate.parameters.is_empty() && estimate.covariance.is_none() && estimate.rejection.is_some());
}

#[test]
fn a_line_in_one_dimension() {
    let line = |x: f64| 30.0 + 0.05 * x + 90.0 * (-2.0 * ((x - 170.4) / 25.0).powi(2)).exp();
    let bytes = (0..400).map(|x| line(f64::from(x)).round() as u8).collect();
    let frame = Frame::new(&[400], vec![Plane::owned(PixelFormat::U8, bytes, 400)]).unwrap();
    let mut tracker = tracker(include_str!("../../../models/profile-1d.toml"), &[]);
    let estimate = tracker.track(&frame);
    assert!(estimate.converged, "{estimate:?}");
    for (name, value, off) in [("b", 170.4, 0.02), ("w", 25.0, 0.05), ("g0", 0.05, 1e-3), ("v1", 90.0, 0.2)] {
        assert!((named(&tracker, &estimate, name) - value).abs() < off, "{name} {estimate:?}");
    }
}

#[test]
fn the_report_of_every_shipped_model() {
    let shipped = [
        SPOT,
        THESIS,
        DISC,
        GAUSSIAN,
        MISRA1A,
        include_str!("../../../models/profile-1d.toml"),
        include_str!("../../../models/rational-spot.toml"),
        include_str!("../../../models/bright-disc.toml"),
        include_str!("../../../models/bead.toml"),
        include_str!("../../../models/moffat.toml"),
        include_str!("../../../models/ring.toml"),
        include_str!("../../../models/gaussian-pixel.toml"),
        include_str!("../../../models/three-spots.toml"),
        include_str!("../../../models/blob-3d.toml"),
        include_str!("../../../models/blob-4d.toml"),
    ];
    for document in shipped {
        let compiled = compiled(document, Precision::F32);
        let clock = std::cell::Cell::new(0);
        let report = compiled.report(&|| clock.replace(clock.get() + 2_000_000)).unwrap();
        assert_eq!(report.stages.len(), compiled.model().stages().len());
        assert!(report.stages.iter().all(|stage| stage.compile_ms == 2.0 && stage.flops_per_pixel > 0));
        assert!(report.self_check_error.unwrap() < 1e-12, "{report:?}");
    }
}

#[test]
fn kernels_are_shared_between_threads() {
    let compiled = compiled(SPOT, Precision::F32);
    compiled.warm(PixelFormat::U8, &InTurn).unwrap();
    let truth = spot(70.0, 60.0, [20.0, 14.0], 0.2, 150.0);
    let frame = TestPicture { noise: 1.0, ..TestPicture::new(160, 120, vec![truth]) }.frame();
    let estimates: Vec<Estimate> = std::thread::scope(|scope| {
        let run = || Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap().track(&frame);
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(run)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(estimates.iter().all(|estimate| *estimate == estimates[0] && estimate.converged));
}

#[test]
fn a_warm_start_takes_few_steps() {
    let mut tracker = tracker(SPOT, &[]);
    for sequence in 0..8 {
        let truth = spot(70.0 + 1.5 * sequence as f64, 60.0, [20.0, 14.0], 0.2, 150.0);
        let estimate = tracker
            .track(&TestPicture { noise: 1.0, seed: sequence, ..TestPicture::new(160, 120, vec![truth]) }.frame());
        assert!(estimate.converged && estimate.iterations[0] <= 20, "{sequence}: {estimate:?}");
    }
}

#[test]
fn a_swap_carries_shared_parameters() {
    let mut tracker = tracker(SPOT, &[]);
    let truth = spot(70.0, 60.0, [20.0, 14.0], 0.2, 150.0);
    let frame = TestPicture { noise: 1.0, ..TestPicture::new(160, 120, vec![truth]) }.frame();
    assert_eq!(tracker.track(&frame).state, TrackState::Tracking);
    let carried = tracker.swap(compiled(GAUSSIAN, Precision::F32), TrackerOptions::default());
    assert_eq!(carried.carried, ["bx", "by", "a1", "a2", "a3", "v0", "v1"]);
    assert!(carried.reset.is_empty());
    let estimate = tracker.track(&frame);
    assert_eq!(estimate.state, TrackState::Tracking);
    assert!(centre_error(&tracker, &estimate, &truth) < 0.1);
    let carried = tracker.swap(compiled(SPOT, Precision::F32), TrackerOptions::default());
    assert_eq!(carried.reset, ["k1", "k2"]);
    let estimate = tracker.track(&frame);
    assert_eq!(estimate.state, TrackState::Tracking);
    assert!(centre_error(&tracker, &estimate, &truth) < 0.1 && named(&tracker, &estimate, "k1") == -0.5);
    // A dark disc replaces the bright spot: its bound refuses the brightness, the rest is carried.
    let carried = tracker.swap(compiled(DISC, Precision::F32), TrackerOptions::default());
    assert_eq!(carried.reset, ["e", "v1"]);
    assert_eq!(tracker.track(&frame).state, TrackState::Coasting);
}

#[test]
fn a_window_keeps_the_neighbours_out() {
    let (left, right) = (spot(40.0, 60.0, [14.0, 14.0], 0.0, 100.0), spot(120.0, 60.0, [25.0, 25.0], 0.0, 150.0));
    let frame = TestPicture { noise: 1.0, ..TestPicture::new(160, 120, vec![left, right]) }.frame();
    let options = |window| TrackerOptions { window, ..TrackerOptions::default() };
    let compiled = compiled(SPOT, Precision::F32);
    let both = Tracker::new(compiled.clone(), options(None)).unwrap().sightings(&frame);
    let confidences: Vec<f64> = both.iter().filter_map(|one| one.confidence).collect();
    assert!(confidences.len() == 2 && confidences.iter().sum::<f64>() <= 1.0, "either is the target: {both:?}");
    for (x, truth) in [(10, left), (90, right)] {
        let window = Window { x, y: 30, width: 60, height: 900, slices: Slices::ONE };
        let mut tracker = Tracker::new(compiled.clone(), options(Some(window))).unwrap();
        let estimate = tracker.track(&frame);
        assert!(centre_error(&tracker, &estimate, &truth) < 0.1, "{window:?} {estimate:?}");
    }
    let mut tracker =
        Tracker::new(compiled, options(Some(Window { x: 160, y: 0, width: 9, height: 9, slices: Slices::ONE })))
            .unwrap();
    assert_eq!(tracker.track(&frame).ending, Ending::WrongFrame);
}

#[test]
fn formats_strides_and_precisions_agree() {
    let truth = spot(70.3, 60.2, [20.0, 14.0], 0.2, 150.0);
    let pixels: Vec<f64> = TestPicture { noise: 1.0, ..TestPicture::new(160, 120, vec![truth]) }
        .pixels()
        .iter()
        .map(|v| v.round())
        .collect();
    let bytes = |format: PixelFormat, gap: usize| -> Vec<u8> {
        let one = |v: &f64| match format {
            PixelFormat::U8 => vec![*v as u8],
            PixelFormat::U16 => (*v as u16).to_le_bytes().to_vec(),
            PixelFormat::F32 => (*v as f32).to_le_bytes().to_vec(),
            PixelFormat::F64 => v.to_le_bytes().to_vec(),
        };
        pixels.iter().flat_map(|v| [one(v), vec![0xFF; gap]].concat()).collect()
    };
    let mut centres = Vec::new();
    for precision in [Precision::F32, Precision::F64] {
        let compiled = compiled(SPOT, precision);
        for format in PixelFormat::ALL {
            for gap in [0, 3] {
                let pixel_stride = format.bytes_per_pixel() + gap;
                let plane = Plane {
                    pixel_stride,
                    row_stride: 160 * pixel_stride,
                    ..Plane::owned(format, bytes(format, gap), 160)
                };
                let frame = Frame::new(&[160, 120], vec![plane]).unwrap();
                let options = TrackerOptions { precision, ..TrackerOptions::default() };
                let mut tracker = Tracker::new(compiled.clone(), options).unwrap();
                let estimate = tracker.track(&frame);
                assert!(estimate.converged, "{format:?} {precision:?}: {estimate:?}");
                centres.push(named(&tracker, &estimate, "bx"));
            }
        }
    }
    assert!(centres.iter().all(|x| (x - centres[0]).abs() < 1e-4), "{centres:?}");
}

#[test]
fn pixels_without_any_rounding_end_by_a_small_step() {
    let truth = spot(70.3, 60.2, [20.0, 14.0], 0.2, 150.0);
    let pixels = TestPicture::new(160, 120, vec![truth]).pixels();
    for precision in [Precision::F32, Precision::F64] {
        let bytes = pixels.iter().flat_map(|v| v.to_le_bytes()).collect();
        let frame = Frame::new(&[160, 120], vec![Plane::owned(PixelFormat::F64, bytes, 160)]).unwrap();
        let options = TrackerOptions { precision, ..TrackerOptions::default() };
        let mut tracker = Tracker::new(compiled(SPOT, precision), options).unwrap();
        for _ in 0..3 {
            let estimate = tracker.track(&frame);
            let error = centre_error(&tracker, &estimate, &truth);
            assert_eq!(estimate.ending, Ending::SmallStep, "{estimate:?}");
            assert!(error < if precision == Precision::F32 { 1e-5 } else { 1e-10 });
        }
    }
}

#[test]
fn wrong_frames_and_names_are_reported() {
    let compiled = compiled(SPOT, Precision::F32);
    let options = |start: &str, constant: &str, value: f64| TrackerOptions {
        start: (!start.is_empty()).then(|| (start.to_string(), value)).into_iter().collect(),
        constants: (!constant.is_empty()).then(|| (constant.to_string(), value)).into_iter().collect(),
        ..TrackerOptions::default()
    };
    for (options, text) in [
        (options("bz", "", 1.0), "the model has no parameter `bz`; did you mean `bx`?"),
        (options("", "gain", 1.0), "the model has no constant `gain`"),
        (options("v1", "", 0.0), "start of `v1` = 0 is not between 0 and 1e30, its bounds (exclusive)"),
        (options("bx", "", f64::NAN), "start of `bx` = NaN is not between -1e30 and 1e30, its bounds (exclusive)"),
        (
            TrackerOptions { precision: Precision::F64, ..TrackerOptions::default() },
            "the options say F64, the kernels are for F32",
        ),
    ] {
        let error = Tracker::new(compiled.clone(), options).err().unwrap();
        assert!(error.to_string().starts_with(text), "{error}");
    }
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    let one = Frame::new(&[9], vec![Plane::owned(PixelFormat::U8, vec![0; 9], 9)]).unwrap();
    let estimate = tracker.track(&one);
    assert_eq!((estimate.ending, estimate.state), (Ending::WrongFrame, TrackState::Searching));
    let two = Frame::new(&[3, 3], vec![Plane::owned(PixelFormat::U8, vec![0; 9], 3); 2]).unwrap();
    assert_eq!(tracker.track(&two).ending, Ending::WrongFrame);
    let nothing = Frame::new(&[3, 3], vec![Plane::owned(PixelFormat::U8, vec![0; 9], 3); 3]).unwrap(); // colour: luma
    assert_eq!(tracker.track(&nothing).ending, Ending::NoTarget);
}

#[test]
fn constants_come_from_the_session_then_the_camera_then_the_model() {
    let model = Model::from_toml(&SPOT.replace(
        "saturated  = \"dropped\"",
        "noise = \"read_noise^2 + gain * max(intensity, 0)\"\n[constants]\nread_noise = 0.75\ngain = 0.05",
    ));
    let model = model.unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let camera = crate::Camera { electrons_per_dn: Some(20.0), read_noise_e: Some(10.0), ..Default::default() };
    let mut options = TrackerOptions::default();
    assert_eq!(options.constants_of(&model), [0.75, 0.05]);
    options.camera = camera;
    assert_eq!(options.constants_of(&model), [0.5, 0.05]);
    options.constants.insert("gain".into(), 0.1);
    assert_eq!(options.constants_of(&model), [0.5, 0.1]);
    let censored = Model::from_toml(include_str!("../../../models/spot.toml")).unwrap();
    assert_eq!(options.constants_of(&censored), [0.1, 0.5, 0.0, 1e-3]);
    options.camera.defects = Some(0.01);
    assert_eq!(options.constants_of(&censored), [0.1, 0.5, 0.0, 0.01]);
    options.camera.defects = Some(1.0);
    assert!(matches!(options.check(&model), Err(TrackError::Range { name: "camera.defects", .. })));
    options.camera.black = 16.0;
    assert_eq!(options.camera.constant("black"), Some(16.0));
    assert_eq!(crate::Camera::default().constant("black"), None, "the document's own stays");
}

const MISRA1A: &str = r#"
name = "misra1a"
coordinates = ["i"]
channels = ["y", "x"]
[parameters]
b1 = { start = 500 }
b2 = { start = 0.0001 }
[model]
observed = "y"
intensity = "b1*(1-exp(-b2*x))"
[[stages]]
parameters = ["b1", "b2"]
method = "levenberg-marquardt"
iterations = 200
tolerance = 1e-6
"#;

#[test]
fn a_curve_fit_through_columns() {
    let x = [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0];
    let y = [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78];
    let column =
        |values: &[f64]| Plane::owned(PixelFormat::F64, values.iter().flat_map(|v| v.to_le_bytes()).collect(), 14);
    let frame = Frame::new(&[14], vec![column(&y), column(&x)]).unwrap();
    for start in [[500.0, 0.0001], [250.0, 0.0005]] {
        let options = TrackerOptions {
            precision: Precision::F64,
            start: [("b1".to_string(), start[0]), ("b2".to_string(), start[1])].into(),
            ..TrackerOptions::default()
        };
        let mut tracker = Tracker::new(compiled(MISRA1A, Precision::F64), options).unwrap();
        let estimate = tracker.track(&frame);
        assert_eq!((estimate.state, estimate.ending), (TrackState::Tracking, Ending::SmallStep), "{estimate:?}");
        assert!((named(&tracker, &estimate, "b1") / 2.389_421_291_8e2 - 1.0).abs() < 1e-8, "{estimate:?}");
        assert!((named(&tracker, &estimate, "b2") / 5.501_564_318_1e-4 - 1.0).abs() < 1e-8, "{estimate:?}");
        assert!((estimate.objective.unwrap() / 1.245_513_889_4e-1 - 1.0).abs() < 1e-8);
        let deviation = estimate.covariance.unwrap()[0][0].sqrt();
        assert!((deviation / 2.707_007_521_5 - 1.0).abs() < 1e-6, "{deviation}");
    }
}

/// With ln σ² below zero, F per pixel is negative; a step that lowers it must not be taken for one that strayed.
#[test]
fn newton_with_a_small_variance_converges() {
    let document = SPOT
        .replace("[model]", "[model]\nnoise = \"0.1 + 1e-4*max(intensity, 0)\"")
        .replace("method     = \"levenberg-marquardt\"", "method     = \"newton\"");
    assert!(document.contains("newton") && document.contains("noise"));
    let truth = spot(70.3, 60.2, [20.0, 14.0], 0.2, 150.0);
    let frame = TestPicture { noise: 0.1, ..TestPicture::new(160, 120, vec![truth]) }.frame();
    let estimate = tracker(&document, &[("bx", 76.0), ("by", 55.0)]).track(&frame);
    assert_eq!((estimate.state, estimate.ending), (TrackState::Tracking, Ending::SmallStep), "{estimate:?}");
    assert!(estimate.objective.unwrap() < 0.0, "{estimate:?}");
    assert!((estimate.parameters[0] - 70.3).abs() < 0.02 && (estimate.parameters[1] - 60.2).abs() < 0.02);
}

/// A blob in a stack: found, followed with a window of slices, and rejected where the window leaves it out.
#[test]
fn a_blob_in_a_stack() {
    let size = [32, 28, 20];
    let frame = |bz: f64, sequence: u64| {
        let value = |i: usize| {
            let (x, y, z) = ((i % 32) as f64, (i / 32 % 28) as f64, (i / 32 / 28) as f64);
            let s = ((x - 15.3) / 7.0).powi(2) + ((y - 12.8) / 6.0).powi(2) + ((z - bz) / 4.0).powi(2);
            (20.0 + 180.0 * (-2.0 * s).exp()).round() as u8
        };
        let plane = Plane::owned(PixelFormat::U8, (0..32 * 28 * 20).map(value).collect(), 32);
        Frame::new(&size, vec![plane]).unwrap().with_sequence(sequence)
    };
    let compiled = compiled(include_str!("../../../models/blob-3d.toml"), Precision::F32);
    let window = |first: usize, count: usize| {
        let slices = Slices { first: [first, 0], count: [count, usize::MAX] };
        TrackerOptions { window: Some(Window { slices, ..Window::whole(32, 28) }), ..TrackerOptions::default() }
    };
    let mut whole = Tracker::new(compiled.clone(), TrackerOptions::default()).unwrap();
    let mut part = Tracker::new(compiled.clone(), window(3, 16)).unwrap();
    for sequence in 0..4 {
        let bz = 9.4 + 0.8 * sequence as f64;
        for tracker in [&mut whole, &mut part] {
            let estimate = tracker.track(&frame(bz, sequence));
            assert!(estimate.converged, "{estimate:?}");
            for (name, value) in [("bx", 15.3), ("by", 12.8), ("bz", bz)] {
                assert!((named(tracker, &estimate, name) - value).abs() < 0.01, "{name} {estimate:?}");
            }
        }
    }
    let mut elsewhere = Tracker::new(compiled.clone(), window(0, 3)).unwrap();
    assert_eq!(elsewhere.track(&frame(14.0, 0)).state, TrackState::Searching);
    let mut beyond = Tracker::new(compiled, window(20, 3)).unwrap();
    assert_eq!(beyond.track(&frame(9.4, 0)).ending, Ending::WrongFrame);
    let picture = Frame::new(&[32, 28], vec![Plane::owned(PixelFormat::U8, vec![20; 32 * 28], 32)]).unwrap();
    assert_eq!(whole.track(&picture).ending, Ending::WrongFrame);
}

/// Floating-point files have unknown pixels (BLANK of FITS): they are left out, wherever they lie.
#[test]
fn nan_pixels_are_left_out() {
    let truth = spot(81.3, 58.7, [18.0, 13.0], 0.5, 150.0);
    let picture = TestPicture { samples: 4, ..TestPicture::new(160, 120, vec![truth]) };
    let is_unknown = |x: usize, y: usize| x < 9 || (88..93).contains(&x) && (50..70).contains(&y) || y == 61;
    let pixels = picture.pixels().into_iter().enumerate();
    let bytes: Vec<u8> = pixels
        .flat_map(|(i, value)| if is_unknown(i % 160, i / 160) { f32::NAN } else { value as f32 }.to_le_bytes())
        .collect();
    let frame = Frame::new(&[160, 120], vec![Plane::owned(PixelFormat::F32, bytes, 160)]).unwrap();
    let whole = tracker(SPOT, &[]).track(&picture.frame());
    let mut tracker = tracker(SPOT, &[]);
    for number in 0..3 {
        let estimate = tracker.track(&frame.clone().with_sequence(number));
        assert_eq!((estimate.state, estimate.ending), (TrackState::Tracking, Ending::SmallStep), "{estimate:?}");
        let error = centre_error(&tracker, &estimate, &truth);
        assert!(error < 0.01, "{error} {estimate:?}");
        assert!(estimate.pixels < whole.pixels, "{} {}", estimate.pixels, whole.pixels);
    }
}
