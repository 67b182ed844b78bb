#![allow(clippy::unwrap_used)]
use super::*;
use crate::picture::{Falloff, Spot, TestPicture};
use crate::solve::compiled::Compiled;
use crate::solve::workers::InTurn;
use crate::{Tracker, TrackerOptions};

/// `STAGES` is replaced by the stages.
const DOCUMENT: &str = r#"
name = "signed"
coordinates = ["x", "y"]
channels = ["phi"]
STAGES
[parameters]
bx = { start = 20.6 }
by = { start = 19.7 }
a = { start = 0.006, min = 0 }
v0 = { start = 20 }
v1 = { start = 140 }
[definitions]
s = "a * (x - bx)^2 + a * (y - by)^2"
[model]
intensity = "v0 + v1 * if(s <= 1, (1 - s)^2 * (1 + s/2), 0)"
domain = "s <= 2.2"
[roles]
centre = ["bx", "by"]
background = "v0"
brightness = "v1"
"#;

fn model(stages: &str) -> Model {
    let text = DOCUMENT.replace("STAGES", stages);
    Model::from_toml(&text).unwrap_or_else(|faults| panic!("{}", faults[0].render("test")))
}

#[test]
fn jobs_with_equal_sums_share_a_program() {
    let stage =
        |parameters: &str, method: &str| format!("[[stages]]\nparameters = [{parameters}]\nmethod = \"{method}\"\n");
    let (pair, turned) = ("\"bx\", \"by\"", "\"by\", \"bx\"");
    // Number of sums besides F. Where the last stage sums what the covariance needs and frees all parameters of the others,
    // there is the closing sum as well.
    let cases = [
        (vec![stage(pair, "gauss-newton")], 2),
        (vec![stage(pair, "gauss-newton"), stage("\"v0\"", "gauss-newton"), stage(pair, "gauss-newton")], 2),
        (vec![stage(pair, "gauss-newton"), stage(pair, "levenberg-marquardt")], 2),
        (vec![stage(turned, "gauss-newton"), stage(pair, "gauss-newton")], 2),
        (vec![stage(pair, "newton")], 2), // and the covariance
        (vec![stage(pair, "gauss-newton"), stage(pair, "newton")], 2),
    ];
    for (stages, sums) in cases {
        let compiled = Compiled::new(Arc::new(model(&stages.concat())), Precision::F32).unwrap();
        assert_eq!(compiled.derived.parts.len(), sums + 1, "{stages:?}");
        for (index, stage) in compiled.model().stages().iter().enumerate() {
            let mut sets = [compiled.order(index).to_vec(), stage.parameters.clone()];
            sets.iter_mut().for_each(|set| set.sort());
            assert_eq!(sets[0], sets[1], "{stages:?}");
        }
        let last = compiled.model().stages().len() - 1;
        assert_eq!(compiled.order(last), compiled.last_parameters());
    }
}

#[test]
fn the_order_of_parameters_does_not_change_the_fit() {
    let spot = Spot {
        centre: [21.3, 20.4],
        half: [13.0; 2],
        angle: 0.0,
        amplitude: 150.0,
        profile: Falloff::Cubic(-1.5, 0.0),
    };
    let frame = TestPicture { noise: 1.0, ..TestPicture::new(44, 44, vec![spot]) }.frame();
    let ends = ["\"bx\", \"v1\", \"by\", \"v0\"", "\"v0\", \"v1\", \"bx\", \"by\""].map(|first| {
        let stages =
            format!("[[stages]]\nparameters = [{first}]\n[[stages]]\nparameters = [\"bx\", \"by\", \"v0\", \"v1\"]\n");
        let compiled = Compiled::new(Arc::new(model(&stages)), Precision::F64).unwrap();
        let options = TrackerOptions { precision: Precision::F64, ..TrackerOptions::default() };
        Tracker::new(Arc::new(compiled), options).unwrap().track(&frame)
    });
    assert!(ends.iter().all(|end| end.converged && end.iterations.len() == 2), "{ends:?}");
    let apart = ends[0].parameters.iter().zip(&ends[1].parameters).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-6, "{apart}");
    assert_eq!(ends[0].order, ends[1].order);
}

#[test]
fn weights_follow_the_cost_of_a_pixel() {
    let weight = |text: &str| {
        let model = Arc::new(Model::from_toml(text).unwrap());
        let kernels = StageKernels::new(model, Precision::F32, Arc::default(), &InTurn, FitStarts::Anywhere).unwrap();
        assert_eq!(kernels.share().weight(), kernels.weight());
        kernels.weight()
    };
    assert_eq!(weight(include_str!("../../../models/thesis-spot.toml")), 1);
    // Three channels in one loop.
    let raw = weight(include_str!("../../../models/three-spots-pose-raw.toml"));
    assert!((2..8).contains(&raw), "{raw}");
    // Powers at several points of a pixel.
    let moffat = weight(include_str!("../../../models/moffat.toml"));
    assert!(moffat > 2 * raw, "{moffat}");
}
