//! The cost of a pixel by window width and by pixel format: kernels of the thesis' spot.

use isophote_jit::{Kernel, PixelFormat, PlaneView, VectorWidth, Window};
use isophote_symbolic::{Bindings, Model};

use super::against::{self, SUBSETS, kernel};
use super::frame::{HEIGHT, WIDTH, beside_truth, bytes, picture, truth, values};
use super::race::{Contender, ContenderTime, race, repeated};
use crate::text;

/// Windows: width and height, px. A turn has as many passes as needed for the pixel count of the first.
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

/// A contender that makes passes over a whole picture.
fn passes<'a>(
    kernel: &'a Kernel,
    bytes: &'a [u8],
    format: PixelFormat,
    size: [usize; 2],
    p: &'a [f64],
) -> Contender<'a> {
    let wide = format.bytes_per_pixel();
    let plane = PlaneView::new(format, bytes, size[0], size[1], size[0] * wide, wide).unwrap();
    let turn = move || {
        let bindings = Bindings { parameters: p, entry: p, ..Bindings::default() };
        repeated((SIZES[0][0] * SIZES[0][1]).div_ceil(size[0] * size[1]), || {
            let sums = kernel.sums(&bindings, &[plane], Window::whole(size[0], size[1])).unwrap();
            (sums.outputs, sums.pixels)
        })
    };
    Contender { name: format!("{} x {}", size[0], size[1]), turn: Box::new(turn), code_bytes: None }
}

/// The pixels of a window inside the domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Domain {
    /// All.
    Covering,
    /// Those of the inscribed ellipse.
    Inscribed,
}

/// A picture of that size, and its parameters.
pub fn small(model: &Model, size: [usize; 2], domain: Domain) -> (Vec<u8>, Vec<f64>) {
    let half = size.map(|n| n as f64 / 2.0);
    let reach = match domain {
        Domain::Covering => 2.0,
        Domain::Inscribed => 1.0,
    };
    let parameters = values(model, |name| match name {
        "bx" => half[0] - 0.5,
        "by" => half[1] - 0.5,
        "a1" => (reach * half[0]).powi(-2),
        "a2" => 0.0,
        "a3" => (reach * half[1]).powi(-2),
        "v0" => 20.0,
        "v1" => 150.0,
        _ => -0.4,
    });
    (bytes(&picture(model, &parameters, size)), parameters)
}

/// Over windows of each of [`SIZES`], for each vector width of this machine.
pub fn widths(domain: Domain) -> Vec<(VectorWidth, Vec<ContenderTime>)> {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let frames: Vec<(Vec<u8>, Vec<f64>)> = SIZES.iter().map(|size| small(&model, *size, domain)).collect();
    let of = |width: VectorWidth| {
        let kernel = kernel(&model, SUBSETS[0].2, PixelFormat::F32, false, width);
        let contenders: Vec<Contender<'_>> = SIZES
            .iter()
            .zip(&frames)
            .map(|(size, (bytes, parameters))| passes(&kernel, bytes, PixelFormat::F32, *size, parameters))
            .collect();
        (width, race(&contenders))
    };
    against::widths().map(of).collect()
}

/// For each subset: f32 pixels, then u8 pixels.
pub fn formats() -> Vec<(&'static str, Vec<ContenderTime>)> {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let pixels = picture(&model, &truth(&model), [WIDTH, HEIGHT]);
    let parameters = beside_truth(&model);
    let single = bytes(&pixels);
    let small: Vec<u8> = pixels.iter().map(|p| p.round() as u8).collect();
    let race_of = |(_, title, subset): (&'static str, &'static str, &str)| {
        let kernels = [PixelFormat::F32, PixelFormat::U8]
            .map(|format| kernel(&model, subset, format, false, VectorWidth::Bits128));
        let size = [WIDTH, HEIGHT];
        let contenders = [
            passes(&kernels[0], &single, PixelFormat::F32, size, &parameters),
            passes(&kernels[1], &small, PixelFormat::U8, size, &parameters),
        ];
        (title, race(&contenders))
    };
    SUBSETS.map(race_of).into_iter().collect()
}
