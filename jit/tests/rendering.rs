//! The synthetic camera's kernel adds to planes, equal to the interpreter bit for bit.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Random, document, lowerings, parameters, shipped, widths};
use isophote_jit::{Kernel, KernelOptions, RunError, Slices, VectorWidth, Window};
use isophote_symbolic::{Bindings, Precision, Program, interpreter};

struct NoPixels;
impl interpreter::Pixels for NoPixels {
    fn at(&self, _: usize, _: usize, _: usize) -> f64 {
        f64::NAN
    }
}

/// Checks that a kernel adds the same as the interpreter, bit for bit.
fn agrees(
    (program, kernel, options): (&Program, &Kernel, &KernelOptions),
    bindings: &Bindings<'_>,
    window: Window,
    (random, seed): (&mut Random, u64),
) {
    // The planes are not zero before: rendering adds to them, sub-pixel by sub-pixel.
    let mut native: Vec<f32> = (0..window.pixels()).map(|_| random.between(-1.0, 1.0) as f32).collect();
    let mut expected = native.clone();
    kernel.render(bindings, window, &mut native).unwrap();
    let (precision, order) = (options.precision, options.summation());
    interpreter::run(program, precision, order, bindings, &NoPixels, window, Some(&mut expected));
    let same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
    assert!(
        native.iter().zip(&expected).all(same),
        "{options:?} {window:?} seed {seed}\n{program}\n{native:?}\n{expected:?}"
    );
}

const STEPS: &str = r#"
name = "steps"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = 10.0 }
v1 = { start = 10.0 }
[model]
intensity = "if(x + y < bx, v1, exp(-x) / (y - 3))"
"#;

#[test]
fn planes_agree() {
    let seed = 1;
    let mut random = Random(seed);
    for model in [shipped("thesis-spot"), shipped("spot"), shipped("gaussian"), shipped("profile-1d"), document(STEPS)]
    {
        let tall = if model.coordinates().len() == 1 { 1 } else { 9 };
        for lowering in lowerings() {
            let program = model.rendering(lowering).unwrap();
            for (precision, width) in
                [Precision::F32, Precision::F64].into_iter().flat_map(|p| widths().into_iter().map(move |w| (p, w)))
            {
                let options = KernelOptions { width, precision, formats: vec![], packed: true };
                let kernel = Kernel::compile(&program, &options).unwrap();
                for columns in 1..=37 {
                    let window = Window {
                        x: random.below(40),
                        y: random.below(tall),
                        width: columns,
                        height: tall,
                        slices: Slices::ONE,
                    };
                    let values = parameters(&model, [40, 9], &mut random);
                    let shift = [random.between(-0.5, 0.5), random.between(-0.5, 0.5)];
                    let bindings =
                        Bindings { parameters: &values, entry: &values, shift: &shift, ..Bindings::default() };
                    agrees((&program, &kernel, &options), &bindings, window, (&mut random, seed));
                }
            }
        }
    }
}

const STACK: &str = r#"
name = "stack"
coordinates = ["x", "y", "z", "t"]
channels = ["phi"]
[parameters]
bx = { start = 10.0 }
v1 = { start = 10.0 }
[model]
intensity = "if(x + y < bx + z, v1, exp(-x * t) / (y - 3 + z))"
"#;

#[test]
fn volumes_agree() {
    let seed = 2;
    let mut random = Random(seed);
    let program = document(STACK).rendering(lowerings()[0]).unwrap();
    for (precision, width) in
        [Precision::F32, Precision::F64].into_iter().flat_map(|p| widths().into_iter().map(move |w| (p, w)))
    {
        let options = KernelOptions { width, precision, formats: vec![], packed: true };
        let kernel = Kernel::compile(&program, &options).unwrap();
        for columns in 1..=19 {
            let slices = Slices { first: [random.below(5), random.below(5)], count: [3, 2] };
            let window = Window { x: random.below(9), y: random.below(9), width: columns, height: 4, slices };
            let shift: [f64; 4] = std::array::from_fn(|_| random.between(-0.5, 0.5));
            let values = [random.between(5.0, 15.0), random.between(1.0, 9.0)];
            let bindings = Bindings { parameters: &values, entry: &values, shift: &shift, ..Bindings::default() };
            agrees((&program, &kernel, &options), &bindings, window, (&mut random, seed));
        }
    }
}

#[test]
fn a_plane_of_another_size_is_refused() {
    let model = shipped("spot");
    let program = model.rendering(lowerings()[0]).unwrap();
    let options =
        KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, formats: vec![], packed: true };
    let kernel = Kernel::compile(&program, &options).unwrap();
    let bindings = Bindings::default();
    let window = Window::whole(4, 3);
    assert_eq!(kernel.render(&bindings, window, &mut [0.0; 11]), Err(RunError::Target { expected: 12, given: 11 }));
    let empty = Window::whole(4, 0);
    assert!(matches!(kernel.render(&bindings, empty, &mut []), Err(RunError::Window { .. })));
    assert!(matches!(kernel.sums(&bindings, &[], window), Err(RunError::Sink { renders: true })));
}
