//! The frames of the speed figures: a spot whose domain s ≤ 1 covers half of 640 × 480 px.

use isophote_jit::{Kernel, KernelOptions, PixelFormat, VectorWidth, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Model, Precision};

/// px
pub const WIDTH: usize = 640;
/// px
pub const HEIGHT: usize = 480;

/// Parameters of the rendered frame.
pub fn truth(model: &Model) -> Vec<f64> {
    values(model, |name| match name {
        "bx" => 320.3,
        "by" => 240.7,
        "a1" => 1.0 / (250.0 * 250.0),
        "a2" => 1e-6,
        "a3" => 1.0 / (196.0 * 196.0),
        "v0" => 20.0,
        "v1" => 150.0,
        "k1" => -0.5,
        _ => -0.3,
    })
}

/// Parameters off the minimum, where the gradient would be a small difference of large sums.
pub fn beside_truth(model: &Model) -> Vec<f64> {
    let shifted = |(name, value): (&str, f64)| match name {
        "bx" => value + 3.0,
        "by" => value - 2.0,
        "a3" => value * 1.05,
        "a2" => value * 0.95,
        "v1" => value * 1.1,
        _ => value,
    };
    let names = model.parameters().iter().map(|p| p.name.as_str());
    names.zip(truth(model)).map(shifted).collect()
}

/// Parameter values by name.
pub fn values(model: &Model, value: impl Fn(&str) -> f64) -> Vec<f64> {
    model.parameters().iter().map(|p| value(&p.name)).collect()
}

/// The model's picture with a fixed pattern added.
pub fn picture(model: &Model, parameters: &[f64], [width, height]: [usize; 2]) -> Vec<f32> {
    let program = model.rendering(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
    let options = KernelOptions {
        width: VectorWidth::Bits128,
        precision: Precision::F32,
        formats: vec![PixelFormat::F32],
        packed: true,
    };
    let mut plane = vec![0.0; width * height];
    let bindings = Bindings { parameters, entry: parameters, ..Bindings::default() };
    Kernel::compile(&program, &options).unwrap().render(&bindings, Window::whole(width, height), &mut plane).unwrap();
    plane.iter_mut().enumerate().for_each(|(i, p)| *p = (*p + ((i * 7919) % 11) as f32 - 5.0).clamp(0.0, 254.0));
    plane
}

/// The pixels as bytes in native order.
pub fn bytes(pixels: &[f32]) -> Vec<u8> {
    pixels.iter().flat_map(|p| p.to_ne_bytes()).collect()
}
