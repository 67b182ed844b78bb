#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use isophote_symbolic::{Diagnostics, Model, Precision, Severity};

use crate::{CheckReport, CompileFailure, Compiled, ExposureGoal};

const SPOT: &str = include_str!("../../../models/spot.toml");
const SHIPPED: [(&str, &str); 20] = [
    ("bead", include_str!("../../../models/bead.toml")),
    ("blob-3d", include_str!("../../../models/blob-3d.toml")),
    ("blob-4d", include_str!("../../../models/blob-4d.toml")),
    ("bright-disc", include_str!("../../../models/bright-disc.toml")),
    ("dark-disc", include_str!("../../../models/dark-disc.toml")),
    ("gaussian", include_str!("../../../models/gaussian.toml")),
    ("gaussian-pixel", include_str!("../../../models/gaussian-pixel.toml")),
    ("laser-beam", include_str!("../../../models/laser-beam.toml")),
    ("moffat", include_str!("../../../models/moffat.toml")),
    ("profile-1d", include_str!("../../../models/profile-1d.toml")),
    ("rational-spot", include_str!("../../../models/rational-spot.toml")),
    ("ring", include_str!("../../../models/ring.toml")),
    ("spot", include_str!("../../../models/spot.toml")),
    ("spot-lobe", include_str!("../../../models/spot-lobe.toml")),
    ("spot-motion", include_str!("../../../models/spot-motion.toml")),
    ("spot-plane", include_str!("../../../models/spot-plane.toml")),
    ("spot-psf", include_str!("../../../models/spot-psf.toml")),
    ("spot-quadratic", include_str!("../../../models/spot-quadratic.toml")),
    ("thesis-spot", include_str!("../../../models/thesis-spot.toml")),
    ("three-spots", include_str!("../../../models/three-spots.toml")),
];
const FREE: &str = "parameters = [\"bx\", \"by\", \"a1\", \"a2\", \"a3\", \"v0\", \"v1\"]";

fn check(document: &str) -> Result<CheckReport, Diagnostics> {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let compiled = Compiled::new(Arc::new(model), Precision::F32).unwrap();
    compiled.report(&|| 0).map_err(|failure| match failure {
        CompileFailure::Model(diagnostics) => diagnostics,
        other => panic!("{other}"),
    })
}

/// The spot with a free profile and these start values.
fn profile(k1: f64, k2: f64) -> String {
    let free = "parameters = [\"bx\", \"by\", \"a1\", \"a2\", \"a3\", \"k1\", \"k2\", \"v0\", \"v1\"]";
    let spot = SPOT.replace(FREE, free).replace("k1 = { start = -0.5 }", &format!("k1 = {{ start = {k1:?} }}"));
    spot.replace("k2 = { start = -0.3 }", &format!("k2 = {{ start = {k2:?} }}"))
}

#[test]
fn profile_without_slope_at_its_rim_is_refused() {
    // f = 1 + k1 s + k2 s² − (1 + k1 + k2) s³ has the slope −3 − 2 k1 − k2 at s = 1.
    for (k1, k2, alike) in [(-1.5, 0.0, "`a1`, `a2`, `a3` and `k1`"), (-1.0, -1.0, "`a1`, `a2`, `a3`, `k1` and `k2`")] {
        let refused = check(&profile(k1, k2)).unwrap_err();
        let [fault] = refused.as_slice() else { panic!("{refused:?}") };
        assert_eq!((fault.severity, fault.code.as_str()), (Severity::Error, "degenerate"));
        assert!(fault.message.starts_with(alike), "{}", fault.message);
        let help = fault.help.as_deref().unwrap();
        assert!(help.contains("hold one of them") && help.contains("start `k1` or `k2` at another number"), "{help}");
        assert_eq!(fault.key, "stages[0].parameters");
        assert!(fault.source.contains("\"k1\""), "{fault:?}");
    }
    let steep = check(&profile(-0.5, -0.3)).unwrap();
    let [clear, saturated] = [steep.stages[0].condition, steep.stages[0].condition_saturated].map(Option::unwrap);
    assert!(clear > saturated && saturated > 1e-6 && clear < 0.1, "{clear} {saturated}");
    assert_eq!(steep.warnings, []);
    let nearly = check(&profile(-1.5, 1e-4)).unwrap();
    assert_eq!(nearly.warnings.iter().map(|w| w.code.as_str()).collect::<Vec<_>>(), ["nearly-degenerate"]);
    assert_eq!(nearly.warnings[0].severity, Severity::Warning);
}

#[test]
fn product_of_two_heights_is_refused() {
    let two = SPOT.replace("v0 + v1 * f", "v0 + v1 * k1 * f").replace("k = \"[1, k1,", "k = \"[1, -0.5,");
    let two = two.replace("-(1 + k1 + k2)", "-(0.5 + k2)").replace(FREE, &FREE.replace("\"v1\"", "\"k1\", \"v1\""));
    let refused = check(&two).unwrap_err();
    assert!(refused[0].message.starts_with("`k1` and `v1` cannot be told apart:"), "{}", refused[0].message);
}

#[test]
fn parameters_without_effect_give_warnings() {
    let unread = check(&SPOT.replace("v1 = {", "z9 = { start = 1.0 }\nv1 = {")).unwrap();
    assert_eq!(
        unread.warnings.iter().map(|w| (w.code.as_str(), w.key.as_str())).collect::<Vec<_>>(),
        [("unused", "parameters.z9")]
    );
    let constant = check(&SPOT.replace("[constants]\n", "[constants]\nc9 = 2.0\n")).unwrap();
    let [unread] = &constant.warnings[..] else { panic!("{:?}", constant.warnings) };
    assert_eq!(
        (unread.code.as_str(), unread.key.as_str(), unread.severity),
        ("unused", "constants.c9", Severity::Warning)
    );
    assert!(unread.source.starts_with("c9"), "{unread:?}");
    // A tilt that starts at 0 and is squared.
    let squared = SPOT.replace("v1 = {", "g = { start = 0.0 }\nv1 = {").replace("v0 + v1 * f", "v0 + g^2 * x + v1 * f");
    let squared = check(&squared.replace(FREE, &FREE.replace("\"v1\"", "\"g\", \"v1\""))).unwrap();
    assert_eq!(squared.warnings[0].code, "no-effect");
    assert!(squared.warnings[0].message.contains("where it starts"), "{:?}", squared.warnings);
    assert_eq!((squared.bound, squared.stages[0].condition), (None, Some(0.0)));
    // Two components that start alike part at the first step.
    let twins = "name = \"twins\"\ncoordinates = [\"x\"]\nchannels = [\"phi\"]\n[parameters]\nu = { start = 50.0 }\n\
                 v = { start = 50.0 }\np = { start = 8.0 }\nq = { start = 8.0 }\n[model]\n\
                 intensity = \"u * exp(-x / p) + v * exp(-x / q)\"\n[[stages]]\nparameters = [\"u\", \"v\", \"p\", \"q\"]\n";
    assert_eq!(check(twins).unwrap().warnings[0].code, "degenerate");
}

#[test]
fn bound_follows_the_number_of_pixels() {
    // An even picture of 128 × 96 pixels: the mean has the deviation 1/√n.
    let even = "name = \"even\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nv0 = { start = 9.0 }\n\
                [model]\nintensity = \"v0\"\n[[stages]]\nparameters = [\"v0\"]\n";
    let bound = check(even).unwrap().bound.unwrap();
    let n = bound.deviation["v0"].powi(-2);
    assert!((n - n.round()).abs() < 1e-6 * n && n >= 128.0 * 96.0, "{n}");
    assert_eq!((bound.noise, bound.saturated, bound.parameters["v0"]), (Some(1.0), 0.0, 9.0));
    let noisy = even.replace("intensity = \"v0\"", "intensity = \"v0\"\nnoise = \"4\"");
    let twice = check(&noisy).unwrap().bound.unwrap();
    assert_eq!(twice.noise, None);
    assert!((twice.deviation["v0"] / bound.deviation["v0"] - 2.0).abs() < 1e-9);
}

#[test]
fn every_shipped_model_passes() {
    for (name, document) in SHIPPED {
        let report = check(document).unwrap_or_else(|d| panic!("{name}: {}", d[0].render("model")));
        assert_eq!(report.warnings, [], "{name}");
        let last = report.stages.last().unwrap();
        assert!(report.bound.is_some() && last.condition > Some(1e-5), "{name}: {report:?}");
        assert!(last.condition_saturated > Some(1e-6), "{name}: {report:?}");
    }
    let spot = check(SPOT).unwrap();
    let (clear, saturated) = (spot.stages[0].condition.unwrap(), spot.stages[0].condition_saturated.unwrap());
    assert!(clear > 1e-2 && saturated > 1e-3, "{clear} {saturated}");
    assert_eq!(
        spot.exposure.iter().map(|e| e.goal).collect::<Vec<_>>(),
        [ExposureGoal::Centre, ExposureGoal::Brightness]
    );
    assert!(spot.exposure[0].factor > spot.exposure[1].factor, "{:?}", spot.exposure);
    let deviation = &spot.bound.unwrap().deviation;
    assert_eq!(deviation.len(), 7);
    assert!(deviation["bx"] > 1e-3 && deviation["bx"] < 2e-2, "{deviation:?}");
}
