//! Memory safety: windows and planes that do not fit are refused; guard pages on both sides of the pixels prove that
//! nothing outside is read.
#![allow(clippy::unwrap_used)]
#![allow(unsafe_code)] // guard pages: a slice over memory that this test has mapped

mod common;

use common::{Random, lowerings, parameters, programs, shipped, widths};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneError, PlaneView, RunError, Slices, VectorWidth, Window};
use isophote_symbolic::{Bindings, Lowering, Precision, Program};

fn program() -> Program {
    programs(&shipped("spot"), Lowering { fma: false, drop_saturated: false }).swap_remove(0).1
}

fn kernel(format: PixelFormat, packed: bool) -> Kernel {
    Kernel::compile(
        &program(),
        &KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, formats: vec![format], packed },
    )
    .unwrap()
}

#[test]
fn planes_that_do_not_fit_their_bytes_are_refused() {
    let bytes = [0_u8; 100];
    let plane = |w, h, row, pixel| PlaneView::new(PixelFormat::U16, &bytes, w, h, row, pixel);
    assert!(plane(5, 10, 10, 2).is_ok());
    assert_eq!(plane(5, 10, 11, 2).unwrap_err(), PlaneError::TooShort { width: 5, height: 10, given: 100 });
    assert!(plane(5, 10, 10, 3).is_err(), "the last pixel of the last row sticks out");
    assert!(plane(6, 8, 12, 2).is_ok() && plane(6, 9, 12, 2).is_err());
    assert_eq!(plane(0, 10, 10, 2).unwrap_err(), PlaneError::Empty { width: 0, height: 10 });
    assert!(plane(1, 1, usize::MAX, usize::MAX).is_ok(), "strides that are never used");
    assert!(plane(2, 1, 1, usize::MAX).is_err() && plane(1, 2, usize::MAX, 1).is_err());
    assert!(plane(3, 3, usize::MAX / 2, usize::MAX / 2).is_err());
    assert!(matches!(plane(1 << 40, 1, 0, 0), Err(PlaneError::TooLarge { .. })));
}

#[test]
fn windows_outside_the_plane_are_refused() {
    let bytes = [0_u8; 20 * 10];
    let view = PlaneView::new(PixelFormat::U8, &bytes, 20, 10, 20, 1).unwrap();
    let kernel = kernel(PixelFormat::U8, true);
    let values = [1.0; 9];
    let bindings = Bindings { parameters: &values, entry: &values, ..Bindings::default() };
    let run =
        |x, y, width, height| kernel.sums(&bindings, &[view], Window { x, y, width, height, slices: Slices::ONE });
    assert!(run(0, 0, 20, 10).is_ok() && run(19, 9, 1, 1).is_ok() && run(3, 4, 17, 6).is_ok());
    let outside = [
        (0, 0, 21, 10),
        (0, 0, 20, 11),
        (1, 0, 20, 10),
        (0, 1, 20, 10),
        (20, 0, 1, 1),
        (0, 10, 1, 1),
        (0, 0, 0, 10),
        (0, 0, 20, 0),
        (usize::MAX, 0, 2, 1),
        (0, usize::MAX, 1, 2),
        (1, 1, usize::MAX, 1),
    ];
    for (x, y, width, height) in outside {
        let refused = run(x, y, width, height);
        assert!(matches!(refused, Err(RunError::Window { .. })), "{x} {y} {width} {height}: {refused:?}");
    }
    assert_eq!(
        Window { x: 15, y: 8, width: 10, height: 10, slices: Slices::ONE }.clipped(20, 10),
        Some(Window { x: 15, y: 8, width: 5, height: 2, slices: Slices::ONE })
    );
    assert_eq!(Window { x: 20, y: 0, width: 10, height: 10, slices: Slices::ONE }.clipped(20, 10), None);
}

#[test]
fn slices_that_do_not_fit_are_refused() {
    let bytes = [0_u8; 200];
    let stack = |size, strides| PlaneView::stack(PixelFormat::U8, &bytes, size, strides);
    assert!(stack([5, 4, 5, 2], [1, 5, 20, 100]).is_ok());
    assert!(matches!(
        stack([5, 4, 5, 2], [1, 5, 20, 101]),
        Err(PlaneError::TooShort { width: 5, height: 40, given: 200 })
    ));
    assert!(matches!(stack([5, 4, 0, 2], [1, 5, 20, 100]), Err(PlaneError::Empty { .. })));
    assert!(matches!(stack([1, 1 << 20, 1 << 20, 1], [0; 4]), Err(PlaneError::TooLarge { .. })));
    assert!(stack([5, 4, 1, 1], [1, 5, usize::MAX, usize::MAX]).is_ok(), "strides that are never used");

    let view = stack([5, 4, 5, 2], [1, 5, 20, 100]).unwrap();
    let window = |first, count| Window { slices: Slices { first, count }, ..Window::whole(5, 4) };
    let flat = kernel(PixelFormat::U8, true);
    let values = [1.0; 9];
    let bindings = Bindings { parameters: &values, entry: &values, ..Bindings::default() };
    assert!(flat.sums(&bindings, &[view], window([4, 1], [1, 1])).is_ok(), "one slice is a picture");
    let refused = flat.sums(&bindings, &[view], window([0, 0], [2, 1]));
    assert!(matches!(refused, Err(RunError::Slices { coordinates: 2, .. })), "{refused:?}");
    let options = KernelOptions {
        width: VectorWidth::Bits128,
        precision: Precision::F32,
        formats: vec![PixelFormat::U8],
        packed: true,
    };
    let deep = Kernel::compile(&stacked(), &options).unwrap();
    assert!(deep.sums(&bindings, &[view], window([0, 0], [5, 2])).is_ok());
    for (first, count) in [
        ([0, 0], [6, 2]),
        ([0, 0], [5, 3]),
        ([1, 0], [5, 1]),
        ([0, 0], [0, 1]),
        ([5, 0], [1, 1]),
        ([0, 1], [usize::MAX, 1]),
    ] {
        let refused = deep.sums(&bindings, &[view], window(first, count));
        assert!(matches!(refused, Err(RunError::Window { .. })), "{first:?} {count:?}: {refused:?}");
    }
    assert_eq!(window([1, 0], [9, 9]).clipped_to([5, 4, 5, 2]), Some(window([1, 0], [4, 2])));
    assert_eq!(Window { slices: Slices::ALL, ..Window::whole(9, 9) }.clipped(5, 4), Some(Window::whole(5, 4)));
}

/// A program of four coordinates that tests each pixel.
fn stacked() -> Program {
    let text = r#"
    name = "all"
    coordinates = ["x", "y", "z", "t"]
    channels = ["phi"]
    [parameters]
    v = { start = 1.0 }
    [model]
    intensity = "v * (x + y + z + t)"
    "#;
    programs(&common::document(text), Lowering { fma: false, drop_saturated: false }).swap_remove(2).1
}

#[test]
fn nothing_outside_a_stack_is_read() {
    let seed = 12;
    let mut random = Random(seed);
    for precision in [Precision::F32, Precision::F64] {
        for format in PixelFormat::ALL {
            for packed in [true, false] {
                let size = format.bytes_per_pixel();
                let pixel = if packed { size } else { size + 1 };
                for (vectors, columns) in columns() {
                    let options = KernelOptions { width: vectors, precision, formats: vec![format], packed };
                    let kernel = Kernel::compile(&stacked(), &options).unwrap();
                    let sides = [columns, 1 + random.below(4), 1 + random.below(4), 1 + random.below(3)];
                    let row = columns * pixel + random.below(4);
                    let slice = sides[1] * row + random.below(9);
                    let strides = [pixel, row, slice, sides[2] * slice + random.below(9)];
                    let last: usize = sides.iter().zip(strides).map(|(n, stride)| (n - 1) * stride).sum();
                    let bytes = last + size;
                    let guarded = Guarded::new(bytes);
                    for at_end in [false, true] {
                        let view = PlaneView::stack(format, guarded.slice(bytes, at_end), sides, strides).unwrap();
                        let bindings = Bindings { parameters: &[1.0], entry: &[1.0], ..Bindings::default() };
                        let sums = kernel.sums(&bindings, &[view], Window::of_size(sides)).unwrap();
                        assert_eq!(sums.pixels as usize, sides.iter().product::<usize>(), "seed {seed}");
                    }
                }
            }
        }
    }
}

#[test]
fn planes_of_another_kind_are_refused() {
    let bytes = [0_u8; 800];
    let window = Window::whole(5, 5);
    let bindings = Bindings::default();
    let view = |format, pixel| PlaneView::new(format, &bytes, 5, 5, 100, pixel).unwrap();
    let kernel = kernel(PixelFormat::U8, true);
    assert!(matches!(kernel.sums(&bindings, &[], window), Err(RunError::Planes { channels: 1, planes: 0 })));
    let given = kernel.sums(&bindings, &[view(PixelFormat::F32, 4)], window);
    assert!(matches!(given, Err(RunError::Format { channel: 0, .. })));
    let given = kernel.sums(&bindings, &[view(PixelFormat::U8, 3)], window);
    assert!(matches!(given, Err(RunError::Packing { channel: 0, stride: 3 })));
    assert!(kernel.render(&bindings, window, &mut [0.0; 25]).is_err(), "it sums");
}

/// Vector widths, with rows of up to one pixel more than two groups of bytes.
fn columns() -> Vec<(VectorWidth, usize)> {
    let of = |width: VectorWidth| (1..=1 + width.bytes() / 2).map(move |columns| (width, columns));
    widths().into_iter().flat_map(of).collect()
}

/// Bytes with an unreadable page before the first and after the last.
struct Guarded {
    pages: region::Allocation,
    inner: usize,
}

impl Guarded {
    fn new(bytes: usize) -> Guarded {
        let page = region::page::size();
        let inner = region::page::ceil(bytes as *const u8) as usize;
        let pages = region::alloc(inner + 2 * page, region::Protection::READ_WRITE).unwrap();
        let start = pages.as_ptr::<u8>();
        for guard in [start, start.wrapping_add(page + inner)] {
            // SAFETY: both pages belong to `pages`.
            unsafe { region::protect(guard, page, region::Protection::NONE).unwrap() };
        }
        Guarded { pages, inner }
    }

    /// `bytes` bytes that start right after the first guard page, or end right before the second.
    fn slice(&self, bytes: usize, at_end: bool) -> &[u8] {
        let first = if at_end { self.inner - bytes } else { 0 };
        // SAFETY: `first + bytes <= inner`, and the inner pages are readable for as long as `self` lives.
        unsafe { std::slice::from_raw_parts(self.pages.as_ptr::<u8>().add(region::page::size() + first), bytes) }
    }
}

#[test]
fn no_byte_beyond_the_plane_is_touched() {
    let mut random = Random(7);
    let model = shipped("spot");
    for precision in [Precision::F32, Precision::F64] {
        for format in PixelFormat::ALL {
            for packed in [true, false] {
                let size = format.bytes_per_pixel();
                let pixel = if packed { size } else { size + 1 + random.below(3) };
                for lowering in lowerings().into_iter().take(2) {
                    for (_, program) in programs(&model, lowering).into_iter().take(3) {
                        for (vectors, width) in columns() {
                            let options = KernelOptions { width: vectors, precision, formats: vec![format], packed };
                            let kernel = Kernel::compile(&program, &options).unwrap();
                            let height = *random.pick(&[1, 2, 5, 9, 17]);
                            let row = width * pixel + random.below(4);
                            let bytes = (height - 1) * row + (width - 1) * pixel + size;
                            let guarded = Guarded::new(bytes);
                            for at_end in [false, true] {
                                let slice = guarded.slice(bytes, at_end);
                                let view = PlaneView::new(format, slice, width, height, row, pixel).unwrap();
                                let values = parameters(&model, [width, height], &mut random);
                                let bindings = Bindings {
                                    parameters: &values,
                                    entry: &values,
                                    saturation: &[9.0],
                                    ..Bindings::default()
                                };
                                kernel.sums(&bindings, &[view], Window::whole(width, height)).unwrap();
                            }
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn windows_of_placed_planes_use_image_coordinates() {
    let lowering = Lowering { fma: false, drop_saturated: false };
    let program = programs(&shipped("thesis-spot"), lowering).swap_remove(0).1;
    let options = KernelOptions {
        width: VectorWidth::Bits128,
        precision: Precision::F32,
        formats: vec![PixelFormat::U8],
        packed: true,
    };
    let kernel = Kernel::compile(&program, &options).unwrap();
    let pixels: Vec<u8> = (0..60 * 40).map(|i| (i * 7919 % 251) as u8).collect();
    let whole = PlaneView::new(PixelFormat::U8, &pixels, 60, 40, 60, 1).unwrap();
    let part = PlaneView::new(PixelFormat::U8, &pixels[8 * 60 + 5..], 40, 20, 60, 1).unwrap().placed([5, 8, 0, 0]);
    let parameters = [25.0, 17.0, 0.01, 0.0, 0.01, -0.5, -0.3, 20.0, 150.0];
    let bindings = Bindings { parameters: &parameters, entry: &parameters, ..Bindings::default() };
    let window = Window { x: 9, y: 8, width: 30, height: 18, slices: Slices::ONE };
    let sums = kernel.sums(&bindings, &[part], window).unwrap();
    assert!(sums.pixels > 0 && sums == kernel.sums(&bindings, &[whole], window).unwrap());
    for (x, y, width, height) in [(4, 8, 10, 10), (9, 7, 10, 10), (9, 9, 37, 10), (9, 9, 10, 20)] {
        let window = Window { x, y, width, height, ..window };
        assert!(kernel.sums(&bindings, &[whole], window).is_ok());
        assert!(matches!(kernel.sums(&bindings, &[part], window), Err(RunError::Window { .. })));
    }
}
