//! Code memory is freed on drop, never writable and executable at once, and shared by threads. Alone in its file: it
//! counts the process' maps.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod common;

use common::soak::executable_maps;
use common::{Random, parameters, programs, shipped};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window};
use isophote_symbolic::{Bindings, Lowering, Precision};

#[test]
fn a_kernel_may_move_between_threads() {
    fn movable<T: Send + Sync + 'static>() {}
    movable::<Kernel>();
}

#[test]
fn code_lives_as_long_as_its_kernel() {
    let model = shipped("thesis-spot");
    let program = programs(&model, Lowering { fma: false, drop_saturated: false }).swap_remove(2).1;
    let options = KernelOptions {
        width: VectorWidth::Bits128,
        precision: Precision::F32,
        formats: vec![PixelFormat::U8],
        packed: true,
    };
    let compile = || Kernel::compile(&program, &options).unwrap();
    drop(compile());
    let (before, _) = executable_maps();

    // Adjacent maps of equal kind are merged, so the count is exact only once all kernels are dropped.
    let kernels: Vec<Kernel> = (0..64).map(|_| compile()).collect();
    let (alive, writable) = executable_maps();
    assert!(alive > before, "code is in maps of its own");
    assert_eq!(writable, 0, "memory that is writable and executable");
    assert!(kernels.iter().all(|k| k.code_bytes() > 100 && k.program() == &program));

    let bytes: Vec<u8> = (0..40 * 30).map(|i| (i * 31 % 251) as u8).collect();
    let view = PlaneView::new(PixelFormat::U8, &bytes, 40, 30, 40, 1).unwrap();
    let values = parameters(&model, [40, 30], &mut Random(8));
    let bindings = Bindings { parameters: &values, entry: &values, ..Bindings::default() };
    let expected = kernels[0].sums(&bindings, &[view], Window::whole(40, 30)).unwrap();
    std::thread::scope(|scope| {
        for kernel in [&kernels[1], &kernels[1], &kernels[2]] {
            scope.spawn(|| {
                for _ in 0..200 {
                    assert_eq!(kernel.sums(&bindings, &[view], Window::whole(40, 30)).unwrap(), expected);
                }
            });
        }
    });

    drop(kernels);
    for _ in 0..500 {
        compile();
    }
    assert_eq!(executable_maps(), (before, 0), "code that outlives its kernel");
}
