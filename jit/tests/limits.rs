//! The limits of a kernel: programs beyond them are refused, those within run on a thread with the default stack.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, agree_with};
use isophote_jit::{CompileError, Kernel, KernelOptions, LIMITS, PixelFormat, RunError, Slices, VectorWidth, Window};
use isophote_symbolic::{
    AccumulatorId, Bindings, CoordinateId, Instruction, Level, LoopNest, Opcode, PixelSet, Precision, Program, Sink,
    TotalId, Value,
};

/// Sums `rows` different row values over the pixels; each has a slot on the stack.
fn wide(rows: usize, channels: u32) -> Program {
    let mut instructions = Vec::new();
    let mut push = |level, op| {
        instructions.push(Instruction { op, level, span: None });
        Value(instructions.len() as u32 - 1)
    };
    let y = push(Level::Row, Opcode::Outer(CoordinateId(1)).of([]));
    let mut values = vec![y];
    for _ in 1..rows {
        values.push(push(Level::Row, Opcode::Add.of([*values.last().unwrap(), y])));
    }
    let mut sum = push(Level::Pixel, Opcode::number(0.0).of([]));
    for value in values {
        sum = push(Level::Pixel, Opcode::Add.of([sum, value]));
    }
    let row = push(Level::RowEnd, Opcode::RowTotal(AccumulatorId(0)).of([]));
    let total = push(Level::PassEnd, Opcode::PassTotal(TotalId(0)).of([]));
    let sink = Sink::Sums { accumulators: vec![sum], totals: vec![row], outputs: vec![total] };
    let (inputs, pixel_set) = (Vec::new(), PixelSet { bounds: None, mask: None, saturated: None });
    let nest = LoopNest {
        coordinates: 2,
        channels,
        inputs,
        tables: Default::default(),
        instructions,
        pixel_set,
        sink,
        names: Default::default(),
        fused: false,
    };
    Program::of(nest).unwrap()
}

fn compiled(program: &Program) -> Result<Kernel, CompileError> {
    let formats = vec![PixelFormat::U8; program.channels()];
    Kernel::compile(
        program,
        &KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, formats, packed: true },
    )
}

#[test]
fn frames_within_the_limit_run_on_a_default_stack_and_larger_ones_are_refused() {
    // The frame has 48 bytes for a row value that pixels read: eight rows at a time, and a vector of the current one.
    let most = LIMITS.frame_bytes / 48;
    let kernel = compiled(&wide(most * 15 / 16, 1)).unwrap();
    assert!((LIMITS.frame_bytes * 7 / 8..=LIMITS.frame_bytes).contains(&kernel.frame_bytes()));
    let run = move || {
        let image = Image::new(PixelFormat::U8, [9, 5], 1, [0, 0], |_, _, _| 0.0);
        agree_with(&kernel, &Bindings::default(), &image, Window::whole(9, 5), "a large frame")
    };
    // The default stack size of threads; RUST_MIN_STACK does not apply here.
    let thread = std::thread::Builder::new().stack_size(2 << 20).spawn(run).unwrap();
    assert_eq!(thread.join().unwrap().pixels, 45);
    match compiled(&wide(most, 1)) {
        Err(error @ CompileError::FrameTooLarge { bytes }) => {
            assert!(bytes > LIMITS.frame_bytes && error.to_string().contains("bytes of stack"));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn windows_are_checked_without_planes() {
    let kernel = compiled(&wide(2, 0)).unwrap();
    let slices = Slices::ONE;
    let run = |window| kernel.sums(&Bindings::default(), &[], window);
    assert_eq!(run(Window { x: 3, y: 1, width: 4, height: 2, slices }).unwrap().outputs, [4.0 * (3.0 + 6.0)]);
    for (x, y, width, height) in
        [(0, 0, 0, 1), (0, 0, 1, 0), (0, 0, usize::MAX, 1), (0, 0, 1, usize::MAX), (usize::MAX, 0, 1, 1)]
    {
        let refused = run(Window { x, y, width, height, slices });
        assert!(matches!(refused, Err(RunError::Window { .. })), "{x} {y} {width} {height}: {refused:?}");
    }
}
