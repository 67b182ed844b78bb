//! What a pixel costs by the width of the window, and by how it is stored: kernels of the thesis' spot.

use isophote_jit::{Kernel, PixelFormat, PlaneView, Window};
use isophote_symbolic::{Bindings, Model};

use super::against::{SUBSETS, kernel};
use super::frame::{HEIGHT, WIDTH, beside_truth, bytes, picture, truth, values};
use super::race::{Contender, Standing, race};
use crate::text;

/// Windows: width and height, px; all but the square ones have about as many pixels as the first.
pub const SIZES: [[usize; 2]; 11] = [
    [640, 102],
    [8, 8192],
    [16, 4096],
    [24, 24],
    [32, 2048],
    [64, 1024],
    [128, 512],
    [256, 256],
    [512, 128],
    [1024, 64],
    [2048, 32],
];

/// One pass over a whole picture.
fn pass<'a>(kernel: &'a Kernel, bytes: &'a [u8], format: PixelFormat, size: [usize; 2], p: &'a [f64]) -> Contender<'a> {
    let wide = format.bytes_per_pixel();
    let plane = PlaneView::new(format, bytes, size[0], size[1], size[0] * wide, wide).unwrap();
    let turn = move || {
        let bindings = Bindings { parameters: p, entry: p, ..Bindings::default() };
        let sums = kernel.sums(&bindings, &[plane], Window::whole(size[0], size[1])).unwrap();
        (sums.outputs, sums.pixels)
    };
    Contender { name: format!("{} x {}", size[0], size[1]), turn: Box::new(turn), code_bytes: None }
}

/// Which pixels of a window take part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Domain {
    /// All.
    Covering,
    /// Those of the inscribed ellipse.
    Inscribed,
}

/// Over windows of each of [`SIZES`].
pub fn widths(domain: Domain) -> Vec<Standing> {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let kernel = kernel(&model, SUBSETS[0].2, PixelFormat::F32, false);
    let frames: Vec<(Vec<u8>, Vec<f64>)> = SIZES
        .iter()
        .map(|size| {
            let half = size.map(|n| n as f64 / 2.0);
            let reach = match domain {
                Domain::Covering => 2.0,
                Domain::Inscribed => 1.0,
            };
            let parameters = values(&model, |name| match name {
                "bx" => half[0] - 0.5,
                "by" => half[1] - 0.5,
                "a1" => (reach * half[0]).powi(-2),
                "a2" => 0.0,
                "a3" => (reach * half[1]).powi(-2),
                "v0" => 20.0,
                "v1" => 150.0,
                _ => -0.4,
            });
            (bytes(&picture(&model, &parameters, *size)), parameters)
        })
        .collect();
    let contenders: Vec<Contender<'_>> = SIZES
        .iter()
        .zip(&frames)
        .map(|(size, (bytes, parameters))| pass(&kernel, bytes, PixelFormat::F32, *size, parameters))
        .collect();
    race(&contenders)
}

/// For each subset: f32 pixels, then u8 pixels.
pub fn formats() -> Vec<(&'static str, Vec<Standing>)> {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let pixels = picture(&model, &truth(&model), [WIDTH, HEIGHT]);
    let parameters = beside_truth(&model);
    let single = bytes(&pixels);
    let small: Vec<u8> = pixels.iter().map(|p| p.round() as u8).collect();
    let race_of = |(_, title, subset, _): (&'static str, &'static str, &str, f64)| {
        let kernels = [PixelFormat::F32, PixelFormat::U8].map(|format| kernel(&model, subset, format, false));
        let size = [WIDTH, HEIGHT];
        let contenders = [
            pass(&kernels[0], &single, PixelFormat::F32, size, &parameters),
            pass(&kernels[1], &small, PixelFormat::U8, size, &parameters),
        ];
        (title, race(&contenders))
    };
    SUBSETS.map(race_of).into_iter().collect()
}
