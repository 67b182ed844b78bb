//! The unit of cost: one pass of the {a, b, v} kernel of `thesis-spot` over the pixels of an ellipse.

use std::time::Instant;

use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Method, Model, Precision};
use isophote_tracker::Frame;

use crate::accuracy::light::PROFILE;
use crate::text;

/// The pixels of an ellipse: centre, px, and A, px⁻².
#[derive(Clone, Copy, Debug)]
pub struct CoveredArea {
    /// px
    pub centre: [f64; 2],
    /// xx, xy, yy
    pub shape: [f64; 3],
}

/// The kernel.
pub struct Pass(Kernel);

impl Pass {
    /// For 8-bit pixels.
    pub fn new(width: VectorWidth) -> Pass {
        let model = Model::from_toml(&text("thesis-spot")).unwrap();
        let names = ["bx", "by", "a1", "a2", "a3", "v0", "v1"];
        let subset: Vec<_> = names.iter().map(|name| model.parameter(name).unwrap()).collect();
        let program = model.objective(&subset, Method::Newton).unwrap();
        let program = program.program(Lowering { fma: has_fma(), drop_saturated: false }).unwrap();
        let formats = vec![PixelFormat::U8];
        let options = KernelOptions { precision: Precision::F32, width, formats, packed: true };
        Pass(Kernel::compile(&program, &options).unwrap())
    }

    /// Microseconds and pixels.
    pub fn run(&self, covered: CoveredArea, image: &Frame) -> (f64, u64) {
        let ([bx, by], [a1, a2, a3]) = (covered.centre, covered.shape);
        let parameters = [bx, by, a1, a2, a3, PROFILE[0], PROFILE[1], 20.0, 180.0];
        let determinant = a1 * a3 - a2 * a2;
        let [wide, high] = [a3, a1].map(|entry| (entry / determinant).sqrt());
        let (columns, rows) = (image.width(), image.rows());
        let first = |at: f64, half: f64| (at - half).floor().max(0.0) as usize;
        let end = |at: f64, half: f64, side: usize| ((at + half).ceil() as usize + 1).min(side);
        let (x, y) = (first(bx, wide), first(by, high));
        let (width, height) = (end(bx, wide, columns) - x, end(by, high, rows) - y);
        let window = Window { x, y, width, height, ..Window::whole(1, 1) };
        let bytes = image.planes()[0].buffer.bytes();
        let plane = PlaneView::new(PixelFormat::U8, bytes, columns, rows, columns, 1).unwrap();
        let bindings = Bindings { parameters: &parameters, entry: &parameters, ..Bindings::default() };
        let begin = Instant::now();
        let sums = self.0.sums(&bindings, &[plane], window).unwrap();
        (begin.elapsed().as_secs_f64() * 1e6, sums.pixels)
    }
}
