use std::sync::Arc;

use isophote_symbolic::{Method, Model, ParameterId, Precision};

use super::starts::start;
use super::{Bench, Grid, Offset, figures, newton_of_each, schedules, subsets};
use crate::options::TrackerOptions;
use crate::picture::{Falloff, Spot, TestPicture};
use crate::solve::compiled::Compiled;

const SPOT: &str = include_str!("../../../models/spot.toml");
const PROFILE: &str = include_str!("../../../models/profile-1d.toml");
/// In the parameters' order: bx, by, a1, a2, a3, k1, k2, v0, v1.
const BRIGHTNESS: usize = 8;

fn model(text: &str) -> Arc<Model> {
    Arc::new(Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("test"))))
}

fn bench(text: &str) -> Bench {
    let compiled = Compiled::new(model(text), Precision::F64).unwrap();
    let options = TrackerOptions { precision: Precision::F64, ..TrackerOptions::default() };
    Bench::new(Arc::new(compiled), options).unwrap()
}

/// SPOT with one Newton stage for each of these lists.
fn with_stages(lists: &[&str]) -> String {
    let head = SPOT.split("[[stages]]").next().unwrap();
    let stages = lists.iter().map(|list| format!("[[stages]]\nparameters = [{list}]\nmethod = \"newton\"\n"));
    head.to_string() + &stages.collect::<String>()
}

fn picture() -> (TestPicture, Vec<f64>) {
    let truth = Spot {
        centre: [80.3, 59.6],
        half: [30.0, 21.0],
        angle: 0.4,
        amplitude: 150.0,
        profile: Falloff::Cubic(-0.5, -0.3),
    };
    let [a1, a2, a3] = truth.extent();
    let picture = TestPicture { samples: 4, ..TestPicture::new(160, 120, vec![truth]) };
    (picture, vec![80.3, 59.6, a1, a2, a3, -0.5, -0.3, 20.0, 150.0])
}

fn names(model: &Model, parameters: &[ParameterId]) -> Vec<String> {
    parameters.iter().map(|p| model.parameters()[p.index()].name.clone()).collect()
}

#[test]
fn quantiles_and_second_differences_are_those_of_the_definition() {
    assert_eq!(figures::median(&[3.0, 1.0, 2.0]), Some(2.0));
    assert_eq!(figures::quantile(&[0.0, 10.0], 0.95), Some(9.5));
    assert_eq!((figures::median(&[]), figures::rms(&[])), (None, None));
    assert_eq!(figures::rms(&[3.0, 4.0]), Some(12.5f64.sqrt()));
    let place = |n: f64| Some(vec![2.0 * n, -n]);
    let uniform = [place(0.0), place(1.0), place(2.0), None, place(4.0), place(5.0), Some(vec![15.0, -10.0])];
    let differences = figures::second_differences(&uniform);
    assert_eq!(differences, [0.0, 5.0], "three in a row twice, the last one (3, −4) off");
}

#[test]
fn schedules_include_the_documents_own_and_unions_of_roles() {
    let spot = model(SPOT);
    let parts: Vec<_> = subsets(&spot).into_iter().map(|s| (s.name, names(&spot, &s.parameters).join(" "))).collect();
    let expected =
        [("centre", "bx by"), ("shape", "a1 a2 a3"), ("illumination", "v0 v1"), ("all", "bx by a1 a2 a3 v0 v1")];
    assert_eq!(parts, expected.map(|(name, parameters)| (name.to_string(), parameters.to_string())), "k1, k2 are held");
    let tried = schedules(&spot);
    assert_eq!((tried[0].name.as_str(), &tried[0].stages[..]), ("document", spot.stages()));
    let all = |method| tried.iter().filter(|s| s.stages.len() == 1 && s.stages[0].method == method).count();
    assert_eq!([Method::Newton, Method::GaussNewton, Method::LevenbergMarquardt].map(all), [1, 1, 1]);
    let thesis = tried.iter().find(|s| s.name == "centre, shape, all by newton, levenberg-marquardt").unwrap();
    let freed: Vec<String> = thesis.stages.iter().map(|stage| names(&spot, &stage.parameters).join(" ")).collect();
    assert_eq!(freed, ["bx by", "a1 a2 a3", "bx by a1 a2 a3 v0 v1"]);
    for (i, one) in tried.iter().enumerate() {
        assert!(tried[..i].iter().all(|other| other.stages != one.stages && other.name != one.name), "{}", one.name);
        assert!(one.stages.len() <= isophote_symbolic::LIMITS.stages, "{}", one.name);
        let last = one.stages.last().unwrap();
        assert!(one.stages.iter().all(|s| s.parameters.iter().all(|p| last.parameters.contains(p))), "{}", one.name);
    }
    let line = model(PROFILE);
    let parts: Vec<String> = subsets(&line).into_iter().map(|subset| subset.name).collect();
    assert_eq!(parts, ["centre", "illumination", "all"], "it names no shape");
    assert!(schedules(&line).iter().all(|schedule| !schedule.name.contains("shape")));
}

#[test]
fn starts_are_at_the_requested_distance() {
    let spot = model(SPOT);
    let (_, truth) = picture();
    let all = subsets(&spot);
    for number in 0..200 {
        let offset = Offset { centre_px: 7.0, share: 0.3 };
        let moved = start(&spot, &[], &truth, &all[3].parameters, offset, number);
        assert_eq!(moved, start(&spot, &[], &truth, &all[3].parameters, offset, number));
        assert!(spot.constraints_hold(&moved, &[]), "{moved:?}");
        assert!(((moved[0] - truth[0]).hypot(moved[1] - truth[1]) - 7.0).abs() < 1e-9);
        assert_eq!(moved[5..7], truth[5..7], "held");
        let light = start(&spot, &[], &truth, &all[2].parameters, offset, number);
        assert_eq!(light[..BRIGHTNESS - 1], truth[..BRIGHTNESS - 1]);
        let brightness = (light[BRIGHTNESS] / truth[BRIGHTNESS]).ln() / 0.3;
        let ground = (light[7] - truth[7]) / (0.5 * 0.3 * truth[BRIGHTNESS]);
        assert!((brightness.abs().max(ground.abs()) - 1.0).abs() < 1e-9, "one of them by all of it");
    }
    // Shares that would make a hyperbola.
    let wild = Offset { centre_px: 0.0, share: 5.0 };
    assert!((0..50).all(|n| spot.constraints_hold(&start(&spot, &[], &truth, &all[3].parameters, wild, n), &[])));
}

#[test]
fn goal_is_reached_from_near_starts_only() {
    let (picture, truth) = picture();
    let frame = TestPicture { noise: 2.0, ..picture }.frame();
    let bench = bench(SPOT);
    let goal = bench.goal(&frame, &truth).unwrap().unwrap();
    assert!((goal.parameters[0] - truth[0]).abs() < 0.1 && (goal.parameters[BRIGHTNESS] - 150.0).abs() < 3.0);
    let offset = Offset { centre_px: 3.0, share: 0.1 };
    for number in 0..10 {
        let run = bench.run(&frame, &goal, &bench.start(&goal, offset, number), offset).unwrap();
        assert!(run.reached && run.passes > 1 && run.iterations > 0, "{number}: {run:?}");
    }
    let mut beside = goal.parameters.clone();
    assert!(goal.is_near(&beside));
    beside[0] += 0.09;
    assert!(goal.is_near(&beside), "a tenth of a pixel");
    beside[0] += 1.0;
    assert!(!goal.is_near(&beside));
    // A start without the spot in view fails.
    let lost = [&[500.0, 500.0], &goal.parameters[2..]].concat();
    assert!(!bench.run(&frame, &goal, &lost, offset).unwrap().reached);
    let blank = TestPicture::new(160, 120, Vec::new()).frame();
    assert!(bench.goal(&blank, &truth).unwrap().is_none(), "there is no answer in an empty frame");
}

/// F is quadratic in linear parameters: convex everywhere. In centre and shape together it is not (Table 4.1).
#[test]
fn light_is_convex_everywhere_and_all_together_is_not() {
    let (picture, truth) = picture();
    let frame = picture.frame();
    let goal = bench(SPOT).goal(&frame, &truth).unwrap().unwrap();
    let lists = [
        "\"bx\", \"by\"",
        "\"a1\", \"a2\", \"a3\"",
        "\"v0\", \"v1\"",
        "\"bx\", \"by\", \"a1\", \"a2\", \"a3\", \"v0\", \"v1\"",
    ];
    // One document each: together they exceed the cost limit of a document.
    let newton = lists.map(|list| bench(&with_stages(&[list])));
    assert_eq!(newton_of_each(&model(SPOT)).len(), lists.len());
    let level = |centre_px: f64| Offset { centre_px, share: 0.05 * centre_px };
    let grid = Grid { offsets: [1.0, 5.0, 15.0].map(level).to_vec(), directions: 12, seed: 7 };
    let found = newton.map(|bench| bench.convexity(&frame, &goal, 0, &grid).unwrap().unwrap());
    let [centre, shape, light, all] = &found;
    assert!(found.iter().all(|c| c.starts == 37 && c.radius.is_some()), "convex at a minimum: {found:?}");
    assert_eq!((light.convex, light.radius, light.negative_max), (37, Some(level(15.0)), 0));
    assert!(all.convex < 37 && all.negative_max > 0, "{all:?}");
    assert!(all.convex < centre.convex.max(shape.convex), "{found:?}");
    let [least, largest] = all.eigenvalues.unwrap();
    assert!(0.0 < least && least < 1e-3 * largest, "px and px⁻² differ in magnitude: {all:?}");
    let both = light.and(all);
    assert_eq!((both.starts, both.radius, both.negative_max), (74, all.radius, all.negative_max));
}
