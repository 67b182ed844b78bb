#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use nalgebra::{DMatrix, DVector};

use super::*;
use crate::sight::view::PlaneLayout;
use crate::solve::stage_kernels::{FitStarts, Job, PixelHandling, StageKernels};
use crate::solve::workers::InTurn;

const DOCUMENT: &str = r#"
name = "slope"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
v0 = { start = 20 }
v1 = { start = 2 }
v2 = { start = 1 }
[model]
intensity = "v0 + v1 * x + v2 * x * y"
noise = "0.5 + 0.05 * intensity"
[[stages]]
parameters = ["v2", "v0"]
[[stages]]
parameters = ["v0", "v1", "v2"]
"#;
const WIDTH: usize = 9;
const HEIGHT: usize = 6;
/// Variance of a row's offset.
const VARIANCE: f64 = 7.0;
const AT: [f64; 3] = [21.0, 1.5, 1.1];

fn rectangle(x: usize, y: usize, width: usize, height: usize) -> Window {
    Window { x, y, width, height, ..Window::whole(1, 1) }
}

/// F, gradient and Gauss–Newton Hessian with the dense covariance of all pixels, and its ln det.
fn dense(pixels: &[u8], used: &[usize], free: &[usize]) -> (Vec<f64>, f64) {
    let intensity = |i: usize| AT[0] + AT[1] * (i % WIDTH) as f64 + AT[2] * (i % WIDTH * (i / WIDTH)) as f64;
    let slope = |i: usize, parameter: usize| match parameter {
        0 => 1.0,
        1 => (i % WIDTH) as f64,
        _ => (i % WIDTH * (i / WIDTH)) as f64,
    };
    let n = used.len();
    let residual = DVector::from_fn(n, |k, _| f64::from(pixels[used[k]]) - intensity(used[k]));
    let slopes = DMatrix::from_fn(n, free.len(), |k, u| -slope(used[k], free[u]));
    let covariance = DMatrix::from_fn(n, n, |k, l| {
        let own = if k == l { 0.5 + 0.05 * intensity(used[k]) } else { 0.0 };
        own + if used[k] / WIDTH == used[l] / WIDTH { VARIANCE } else { 0.0 }
    });
    let factor = covariance.cholesky().unwrap();
    let solved = factor.solve(&residual);
    let mut outputs = vec![residual.dot(&solved)];
    outputs.extend((2.0 * slopes.tr_mul(&solved)).iter());
    let hessian = 2.0 * slopes.tr_mul(&factor.solve(&slopes));
    outputs.extend((0..free.len()).flat_map(|i| (i..free.len()).map(move |j| (i, j))).map(|at| hessian[at]));
    (outputs, 2.0 * factor.l().diagonal().map(f64::ln).sum())
}

/// Over windows that share rows, and with gaps.
#[test]
fn sums_equal_those_with_the_dense_covariance() {
    let pixels: Vec<u8> =
        (0..WIDTH * HEIGHT).map(|i| 20 + (i * i * 7 % 23) as u8 + 9 * (i / WIDTH % 2) as u8).collect();
    let plane = PlaneView::new(PixelFormat::U8, &pixels, WIDTH, HEIGHT, WIDTH, 1).unwrap();
    let (windows, gaps) =
        ([rectangle(0, 0, 4, 6), rectangle(5, 1, 4, 4)], [rectangle(1, 2, 2, 1), rectangle(6, 2, 1, 2)]);
    let is_in = |i: usize, window: &Window| overlap(*window, rectangle(i % WIDTH, i / WIDTH, 1, 1)).is_some();
    let is_used = |i: &usize| windows.iter().any(|w| is_in(*i, w)) && !gaps.iter().any(|gap| is_in(*i, gap));
    let used: Vec<usize> = (0..pixels.len()).filter(is_used).collect();

    let model = Arc::new(Model::from_toml(DOCUMENT).unwrap());
    let kernels = StageKernels::new(model, Precision::F64, Arc::default(), &InTurn, FitStarts::Anywhere).unwrap();
    let layout = PlaneLayout { has_rows: true, ..PlaneLayout::of_format(PixelFormat::U8, 1) };
    let bindings = Bindings { parameters: &AT, entry: &AT, saturation: &[255.0], ..Bindings::default() };
    let mut totals = Totals::default();
    let cases = [
        (Job::Stage(0), kernels.order(0)),
        (Job::Stage(1), kernels.order(1)),
        (Job::Covariance, kernels.order(1)),
        (Job::Value, &[]),
        (Job::Report, &[]),
    ];
    for (job, order) in cases {
        let free: Vec<usize> = order.iter().map(|id| id.index()).collect();
        let (mut expected, determinant) = dense(&pixels, &used, &free);
        if job == Job::Report {
            expected.insert(0, expected[0] + determinant);
        }
        for handling in [PixelHandling::All, PixelHandling::SkipSaturated] {
            let loops = kernels.loops(job, handling, &layout).unwrap();
            loops.sums(&bindings, &[plane], &windows, &gaps, &[VARIANCE], &mut totals).unwrap();
            assert_eq!((totals.pixels as usize, totals.left_out), (used.len(), 4), "{job:?}");
            assert_eq!(totals.outputs.len(), expected.len(), "{job:?}");
            for (found, expected) in totals.outputs.iter().zip(&expected) {
                assert!((found - expected).abs() <= 1e-6 * expected.abs(), "{job:?}: {found} for {expected}");
            }
        }
    }
}
