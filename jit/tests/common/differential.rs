//! The oracle of random programs: native code and the interpreter on the same pixels and numbers, bit for bit. NaNs are equal
//! whatever their payload (processors and libraries choose it freely); 0 and −0 differ.
#![allow(dead_code, clippy::unwrap_used)]

use super::{Image, Planes, Random, same};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Slices, VectorWidth, Window};
use isophote_symbolic::interpreter::{self, Outcome};
use isophote_symbolic::{
    AccumulatorId, Bindings, Instruction, Lanes, Level, LoopNest, Opcode, PixelSet, Precision, Program, Sink,
    Summation, TotalId, Value,
};

/// Planes for a program, each with its own format and gaps.
pub struct Stage {
    images: Vec<Image>,
    size: [usize; 4],
}

impl Stage {
    /// Random formats and gaps; half of all stages are packed.
    pub fn new(random: &mut Random, program: &Program, lanes: Lanes) -> Stage {
        // Three groups and one pixel, or just too wide for a narrow window; rows of up to three blocks.
        let mut sizes = Random(random.0);
        let mut size = [3 * lanes.count().max(4) + 1, *sizes.pick(&[4, 11, 18]), 1, 1];
        if sizes.below(4) == 0 {
            size[0] = 2 * Summation::NARROW_PX_MAX + 9;
        }
        (2..program.coordinates()).for_each(|axis| size[axis] = 3);
        let is_packed = random.below(2) == 0;
        let image = |random: &mut Random| {
            let gap = if is_packed { 0 } else { random.below(10) };
            let gaps = [gap, random.below(6), random.below(3), random.below(3)];
            let format = *random.pick(&PixelFormat::ALL);
            Image::stack(format, size, 1, gaps, |_, _| 0.0)
        };
        Stage { images: (0..program.channels()).map(|_| image(random)).collect(), size }
    }

    pub fn options(&self, precision: Precision, width: VectorWidth) -> KernelOptions {
        let packed = self.images.iter().all(|image| image.strides[0] == image.format.bytes_per_pixel());
        KernelOptions { width, precision, formats: self.images.iter().map(|image| image.format).collect(), packed }
    }

    /// Draws new pixels; one of `odds` is special, none for 0.
    pub fn draw(&mut self, random: &mut Random, odds: usize) {
        for image in &mut self.images {
            let gaps = std::array::from_fn(|axis| match axis {
                0 => image.strides[0] - image.format.bytes_per_pixel(),
                axis => image.strides[axis] - image.size[axis - 1] * image.strides[axis - 1],
            });
            *image = Image::stack(image.format, self.size, 1, gaps, |_, _| drawn(random, odds));
        }
    }

    pub fn views(&self) -> Vec<PlaneView<'_>> {
        self.images.iter().flat_map(Image::views).collect()
    }
}

fn drawn(random: &mut Random, odds: usize) -> f64 {
    if odds > 0 && random.below(odds) == 0 { random.special() } else { random.ordinary() }
}

/// Bindings and window of a run.
#[derive(Clone, Debug)]
pub struct Case {
    numbers: [Vec<f64>; 5],
    window: Window,
    /// The initial output plane.
    plane: Vec<f32>,
}

impl Case {
    /// A window of up to two groups and one pixel somewhere on the stage.
    pub fn new(random: &mut Random, stage: &Stage, odds: usize) -> Case {
        let mut left = 2 * (stage.size[0] / 3) + 1;
        let sides: Vec<(usize, usize)> = stage
            .size
            .iter()
            .map(|side| {
                let count = 1 + random.below(left.min(*side));
                left /= count;
                (random.below(side - count + 1), count)
            })
            .collect();
        let [(x, width), (y, height), (z, depth), (w, length)] = sides[..] else { unreachable!() };
        let window = Window { x, y, width, height, slices: Slices { first: [z, w], count: [depth, length] } };
        let numbers = std::array::from_fn(|_| (0..6).map(|_| drawn(random, odds)).collect());
        let plane = (0..window.pixels()).map(|_| drawn(random, odds) as f32).collect();
        Case { numbers, window, plane }
    }

    fn bindings(&self) -> Bindings<'_> {
        let [parameters, entry, constants, saturation, shift] = &self.numbers;
        Bindings { parameters, entry, constants, saturation, shift }
    }

    /// Bindings, window, initial output plane.
    pub fn parts(&self) -> (Bindings<'_>, Window, &[f32]) {
        (self.bindings(), self.window, &self.plane)
    }

    pub fn native(&self, kernel: &Kernel, stage: &Stage) -> (Outcome, Vec<f32>) {
        let mut plane = self.plane.clone();
        if let Sink::Plane(_) = kernel.program().sink() {
            kernel.render(&self.bindings(), self.window, &mut plane).unwrap();
            return (Outcome::default(), plane);
        }
        let sums = kernel.sums(&self.bindings(), &stage.views(), self.window).unwrap();
        (Outcome { outputs: sums.outputs, pixels: sums.pixels, saturated: sums.saturated }, plane)
    }

    pub fn interpreted(&self, program: &Program, options: &KernelOptions, stage: &Stage) -> (Outcome, Vec<f32>) {
        let mut plane = self.plane.clone();
        let (bindings, planes) = (self.bindings(), Planes(stage.views()));
        let outcome = interpreter::run(
            program,
            options.precision,
            options.summation(),
            &bindings,
            &planes,
            self.window,
            Some(&mut plane),
        );
        match program.sink() {
            Sink::Plane(_) => (Outcome::default(), plane),
            Sink::Sums { .. } => (outcome, plane),
        }
    }
}

/// Whether two runs agree.
pub fn agree(a: &(Outcome, Vec<f32>), b: &(Outcome, Vec<f32>)) -> bool {
    let numbers = |(outcome, plane): &(Outcome, Vec<f32>)| -> Vec<f64> {
        outcome.outputs.iter().copied().chain(plane.iter().map(|x| f64::from(*x))).collect()
    };
    let (x, y) = (numbers(a), numbers(b));
    let counts = (a.0.pixels, a.0.saturated) == (b.0.pixels, b.0.saturated);
    counts && x.len() == y.len() && x.iter().zip(&y).all(|(x, y)| same(*x, *y))
}

/// The first pixel value in which native code and the interpreter differ, for a message.
pub fn first_difference(program: &Program, options: &KernelOptions, stage: &Stage, case: &Case) -> String {
    let pixel = |i: &usize| program.instructions()[*i].level == Level::Pixel && !program.is_truth(Value(*i as u32));
    for i in (0..program.instructions().len()).filter(pixel) {
        let mut instructions = program.instructions()[..=i].to_vec();
        let (value, next) = (Value(i as u32), i as u32 + 1);
        let at = |level, op| Instruction { op, level, span: None };
        instructions.push(at(Level::RowEnd, Opcode::RowTotal(AccumulatorId(0)).of([])));
        instructions.push(at(Level::PassEnd, Opcode::PassTotal(TotalId(0)).of([])));
        let one = Program::of(LoopNest {
            coordinates: program.coordinates() as u32,
            channels: program.channels() as u32,
            inputs: program.inputs().to_vec(),
            tables: program.tables().clone(),
            instructions,
            pixel_set: PixelSet::default(),
            sink: Sink::Sums { accumulators: vec![value], totals: vec![Value(next)], outputs: vec![Value(next + 1)] },
            names: Default::default(),
            fused: program.is_fused(),
        });
        let Ok(one) = one else { continue };
        let Ok(kernel) = Kernel::compile(&one, options) else { continue };
        let (native, expected) = (case.native(&kernel, stage).0, case.interpreted(&one, options, stage).0);
        if !same(native.outputs[0], expected.outputs[0]) {
            let text = program.operation_text(value);
            return format!("v{i} = {text} is the first: {:?}, not {:?}", native.outputs[0], expected.outputs[0]);
        }
    }
    "no pixel value differs: look at the rows, the pixel set or the sums".into()
}
