//! Measures the fastest vector width of this machine, since some processors slow down for wide vectors.
//!
//! A width counts only if the processor has it and its kernel of a typical document sums the same as the interpreter.

use isophote_symbolic::interpreter::{self, Pixels};
use isophote_symbolic::{Bindings, Lowering, Method, Model, ParameterId, Precision, Program};

use crate::host::{Processor, has_fma};
use crate::kernel::Kernel;
use crate::options::{KernelOptions, VectorWidth};
use crate::plane::{PixelFormat, PlaneView, Window};

/// Size of the image, px: as wide as a spot's window, and too wide for the loops across rows.
const SIDES: [usize; 2] = [160, 24];
/// Passes per timing, and timings per width.
const PASSES: usize = 6;
const TURNS: usize = 9;
/// Rows compared with the interpreter, which is slower than the measurement: one block.
const CHECKED_ROWS: usize = 8;
/// Minimum speed-up for a wider vector.
const GAIN_MIN: f64 = 1.05;
/// A division, a per-pixel domain, u8 and f32 pixels.
const DOCUMENT: &str = r#"
name = "typical"
coordinates = ["x", "y"]
channels = ["bytes", "floats"]
[parameters]
bx = { start = 0.0 }
by = { start = 0.0 }
v0 = { start = 0.0 }
v1 = { start = 0.0 }
[definitions]
s = "(x - bx)^2 / 6400 + (y - by)^2 / 144"
[model]
observed = "0.5 * (bytes + floats)"
intensity = "v0 + v1 / (1 + s)"
domain = "s * s <= 1"
"#;
const FORMATS: [PixelFormat; 2] = [PixelFormat::U8, PixelFormat::F32];
/// Values of the document's parameters.
const VALUES: &[f64] = &[79.3, 11.6, 20.0, 150.0];
const BINDINGS: Bindings<'static> =
    Bindings { parameters: VALUES, entry: VALUES, constants: &[], saturation: &[], shift: &[] };

/// The fastest width for a typical loop; a wider one must be at least 5 % faster.
pub fn fastest_width(clock_ns: &dyn Fn() -> u64) -> VectorWidth {
    let bytes: Vec<u8> = (0..SIDES[0] * SIDES[1]).map(|i| (i * 7919 % 251) as u8).collect();
    let floats: Vec<u8> = bytes.iter().flat_map(|byte| f32::from(*byte).to_ne_bytes()).collect();
    let (Some(program), Some(planes)) = (typical(), planes([&bytes, &floats])) else { return VectorWidth::default() };
    let mut kernels: Vec<(Kernel, u64)> = VectorWidth::ALL
        .into_iter()
        .filter(|width| Processor::Host.has(*width))
        .filter_map(|width| right(&program, width, &planes))
        .map(|kernel| (kernel, u64::MAX))
        .collect();
    for _ in 0..TURNS {
        for (kernel, least_ns) in &mut kernels {
            let start_ns = clock_ns();
            for _ in 0..PASSES {
                let _sums = kernel.sums(&BINDINGS, &planes, Window::whole(SIDES[0], SIDES[1]));
            }
            *least_ns = (*least_ns).min(clock_ns().saturating_sub(start_ns));
        }
    }
    let mut best = None;
    for (kernel, least_ns) in &kernels {
        if best.is_none_or(|(_, ns)| *least_ns as f64 * GAIN_MIN < ns) {
            best = Some((kernel.options().width, *least_ns as f64));
        }
    }
    best.map_or_else(VectorWidth::default, |(width, _)| width)
}

/// Packed planes of both formats.
fn planes(pixels: [&[u8]; 2]) -> Option<Vec<PlaneView<'_>>> {
    let plane = |(format, pixels): (PixelFormat, _)| {
        let stride = format.bytes_per_pixel();
        PlaneView::new(format, pixels, SIDES[0], SIDES[1], SIDES[0] * stride, stride).ok()
    };
    FORMATS.into_iter().zip(pixels).map(plane).collect()
}

/// The kernel of that width, if it agrees with the interpreter.
fn right(program: &Program, width: VectorWidth, planes: &[PlaneView<'_>]) -> Option<Kernel> {
    let options = KernelOptions { precision: Precision::F32, width, formats: FORMATS.to_vec(), packed: true };
    let kernel = Kernel::compile(program, &options).ok()?;
    let window = Window::whole(SIDES[0], CHECKED_ROWS);
    let sums = kernel.sums(&BINDINGS, planes, window).ok()?;
    let (order, pictures) = (options.summation(), Pictures(planes));
    let expected = interpreter::run(program, options.precision, order, &BINDINGS, &pictures, window, None);
    (sums.outputs == expected.outputs && sums.pixels == expected.pixels).then_some(kernel)
}

struct Pictures<'a>(&'a [PlaneView<'a>]);

impl Pixels for Pictures<'_> {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        self.0[channel].pixel(x, y)
    }
}

/// The Gauss–Newton program of all parameters.
fn typical() -> Option<Program> {
    let model = Model::from_toml(DOCUMENT).ok()?;
    let all: Vec<ParameterId> = (0..VALUES.len() as u32).map(ParameterId).collect();
    let lowering = Lowering { fma: has_fma(), drop_saturated: false };
    model.objective(&all, Method::GaussNewton).ok()?.program(lowering).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::cell::Cell;

    #[test]
    fn every_host_width_agrees_with_the_interpreter() {
        let program = typical().unwrap();
        let text = program.to_string();
        assert!(text.contains(" / ") && text.contains("mask"), "{text}");
        let pixels = vec![7; 4 * SIDES[0] * SIDES[1]];
        let planes = planes([&pixels, &pixels]).unwrap();
        for width in VectorWidth::ALL.into_iter().filter(|width| Processor::Host.has(*width)) {
            assert!(right(&program, width, &planes).is_some(), "{width:?}");
        }
    }

    #[test]
    fn faster_width_wins_and_narrowest_wins_a_tie() {
        assert_eq!(fastest_width(&|| 5), VectorWidth::Bits128);
        // Each clock interval is longer than the one before: the first timing of a turn is the fastest.
        let looks = Cell::new(0_u64);
        let slowing = || {
            looks.set(looks.get() + 1);
            looks.get() * looks.get() * 1000
        };
        assert_eq!(fastest_width(&slowing), VectorWidth::Bits128);
        // Each interval is shorter than the one before.
        let speeding = || {
            looks.set(looks.get() + 1);
            u64::MAX / 2 - 1_000_000_000_000 / looks.get()
        };
        looks.set(10);
        let widest = VectorWidth::ALL.into_iter().rfind(|width| Processor::Host.has(*width)).unwrap();
        assert_eq!(fastest_width(&speeding), widest);
    }
}
