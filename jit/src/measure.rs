//! Which vectors are fastest here: measured, since some processors slow down for wide ones.
//!
//! What comes in: a clock. What goes out: a width that this processor has, whose kernel of a typical loop says what the
//! interpreter says. It must never know: what the clock is.

use isophote_symbolic::interpreter::{self, Pixels};
use isophote_symbolic::{
    AccumulatorId, Bindings, ChannelId, Input, Instruction, Level, Opcode, ParameterId, PixelSet, Precision, Program,
    ProgramParts, Sink, TotalId, Value,
};

use crate::host::{Processor, has_fma};
use crate::kernel::Kernel;
use crate::options::{KernelOptions, VectorWidth};
use crate::plane::{PixelFormat, PlaneView, Window};

/// Of the picture, px.
const SIDES: [usize; 2] = [128, 32];
/// Passes between two looks at the clock, and how often each width has its turn.
const PASSES: usize = 40;
const TURNS: usize = 9;
/// By how much the next width must be faster to be worth it.
const GAIN_MIN: f64 = 1.05;
/// Sums, and steps of the polynomials that are summed.
const SUMS: usize = 8;

/// The width that runs a typical loop fastest; the narrower of two that are as good as equal.
pub fn fastest_width(clock_ns: &dyn Fn() -> u64) -> VectorWidth {
    let Some(program) = typical() else { return VectorWidth::default() };
    let pixels: Vec<u8> = (0..SIDES[0] * SIDES[1]).map(|i| (i * 7919 % 251) as u8).collect();
    let Ok(plane) = PlaneView::new(PixelFormat::U8, &pixels, SIDES[0], SIDES[1], SIDES[0], 1) else {
        return VectorWidth::default();
    };
    let mut kernels: Vec<(Kernel, u64)> = VectorWidth::ALL
        .into_iter()
        .filter(|width| Processor::Host.has(*width))
        .filter_map(|width| right(&program, width, plane))
        .map(|kernel| (kernel, u64::MAX))
        .collect();
    for _ in 0..TURNS {
        for (kernel, least_ns) in &mut kernels {
            let start_ns = clock_ns();
            for _ in 0..PASSES {
                let _sums = kernel.sums(&BINDINGS, &[plane], Window::whole(SIDES[0], SIDES[1]));
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

const BINDINGS: Bindings<'static> =
    Bindings { parameters: &[-61.3], entry: &[], constants: &[], saturation: &[], shift: &[] };

/// The kernel of that width, if it says what the interpreter says.
fn right(program: &Program, width: VectorWidth, plane: PlaneView<'_>) -> Option<Kernel> {
    let options = KernelOptions { precision: Precision::F32, width, formats: vec![plane.format()], packed: true };
    let kernel = Kernel::compile(program, &options).ok()?;
    let window = Window::whole(SIDES[0], SIDES[1]);
    let sums = kernel.sums(&BINDINGS, &[plane], window).ok()?;
    let (order, picture) = (options.summation(), Picture(plane));
    let expected = interpreter::run(program, options.precision, order, &BINDINGS, &picture, window, None);
    (sums.outputs == expected.outputs && sums.pixels == expected.pixels).then_some(kernel)
}

struct Picture<'a>(PlaneView<'a>);

impl Pixels for Picture<'_> {
    fn at(&self, _: usize, x: usize, y: usize) -> f64 {
        self.0.pixel(x, y)
    }
}

/// Polynomials of a column's distance times the pixel, summed.
fn typical() -> Option<Program> {
    let mut instructions = Vec::new();
    let mut push = |level, op| {
        instructions.push(Instruction { op, level, span: None });
        Value(instructions.len() as u32 - 1)
    };
    let shift = push(Level::Pass, Opcode::Input(isophote_symbolic::InputId(0)).of([]));
    let scale = push(Level::Pass, Opcode::number(1.0 / 64.0).of([]));
    let x = push(Level::Pixel, Opcode::Offset.of([shift]));
    let x = push(Level::Pixel, Opcode::Mul.of([x, scale]));
    let pixel = push(Level::Pixel, Opcode::Channel(ChannelId(0)).of([]));
    let mut value = pixel;
    let mut accumulators = Vec::new();
    for _ in 0..SUMS {
        value = if has_fma() {
            push(Level::Pixel, Opcode::Fma.of([value, x, pixel]))
        } else {
            let product = push(Level::Pixel, Opcode::Mul.of([value, x]));
            push(Level::Pixel, Opcode::Add.of([product, pixel]))
        };
        accumulators.push(push(Level::Pixel, Opcode::Mul.of([value, pixel])));
    }
    let rows = (0..SUMS as u32).map(|i| push(Level::RowEnd, Opcode::RowTotal(AccumulatorId(i)).of([])));
    let totals: Vec<Value> = rows.collect();
    let ends = (0..SUMS as u32).map(|i| push(Level::PassEnd, Opcode::PassTotal(TotalId(i)).of([])));
    let outputs: Vec<Value> = ends.collect();
    let parts = ProgramParts {
        coordinates: 2,
        channels: 1,
        inputs: vec![Input::Parameter(ParameterId(0))],
        tables: Default::default(),
        instructions,
        pixel_set: PixelSet::default(),
        sink: Sink::Sums { accumulators, totals, outputs },
        fused: has_fma(),
    };
    Program::from_parts(parts).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::cell::Cell;

    #[test]
    fn every_width_of_this_machine_is_right() {
        let program = typical().unwrap();
        let pixels = vec![7; SIDES[0] * SIDES[1]];
        let plane = PlaneView::new(PixelFormat::U8, &pixels, SIDES[0], SIDES[1], SIDES[0], 1).unwrap();
        for width in VectorWidth::ALL.into_iter().filter(|width| Processor::Host.has(*width)) {
            assert!(right(&program, width, plane).is_some(), "{width:?}");
        }
    }

    #[test]
    fn the_clock_decides_and_the_narrowest_wins_a_tie() {
        assert_eq!(fastest_width(&|| 5), VectorWidth::Bits128);
        // Each look at the clock takes longer than the one before: the first of a turn is the fastest.
        let looks = Cell::new(0_u64);
        let slowing = || {
            looks.set(looks.get() + 1);
            looks.get() * looks.get() * 1000
        };
        assert_eq!(fastest_width(&slowing), VectorWidth::Bits128);
        // Each is sooner than the one before.
        let speeding = || {
            looks.set(looks.get() + 1);
            u64::MAX / 2 - 1_000_000_000_000 / looks.get()
        };
        looks.set(10);
        let widest = VectorWidth::ALL.into_iter().rfind(|width| Processor::Host.has(*width)).unwrap();
        assert_eq!(fastest_width(&speeding), widest);
    }
}
