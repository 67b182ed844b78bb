//! Every operation of the table, on edge-case numbers: machine code equals the interpreter.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, Planes, Random, same, tables, widths};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, Window, has_fma};
use isophote_symbolic::interpreter;
use isophote_symbolic::{
    AccumulatorId, Bindings, Comparison, Input, InputId, Instruction, Kind, Level, LoopNest, Opcode, ParameterId,
    PixelSet, Precision, Program, Sink, TotalId, Value,
};

/// The numbers that a truth value selects from: the operands of a comparison in either order (their minimum or maximum), or
/// one of them and 0 or −0.
const CHOICES: [[usize; 2]; 6] = [[0, 1], [1, 0], [0, 3], [3, 0], [0, 4], [4, 0]];

/// Three numbers, two truth values about them, and the operation at a level; its result is an output, so that a single NaN
/// or sign of a zero shows, or selects a number.
fn program(code: Opcode, level: Level, truths: bool, choice: [usize; 2]) -> Program {
    let mut instructions: Vec<Instruction> = Vec::new();
    let mut push = |level, op| {
        instructions.push(Instruction { op, level, span: None });
        Value(instructions.len() as u32 - 1)
    };
    let parameters: Vec<Value> = (0..4).map(|i| push(Level::Pass, Opcode::Input(InputId(i)).of([]))).collect();
    // The operands are of the same level if it can have its own; row ends and pass ends read the pass'.
    let mut numbers: Vec<Value> = parameters[..3].iter().map(|v| push(level, Opcode::Neg.of([*v]))).collect();
    numbers.extend([0.0, -0.0].map(|zero| push(level, Opcode::number(zero).of([]))));
    let conditions = [[0, 1], [1, 2], [2, 0]]
        .map(|[a, b]| push(level, Opcode::Compare(Comparison::Lt).of([numbers[a], numbers[b]])));
    let (mut number, mut condition) = (numbers.iter(), conditions.iter());
    let mut operand = |kind: &Kind| match kind {
        Kind::Number => *number.next().unwrap(),
        Kind::OfRow => parameters[0],
        Kind::Either if !truths => *number.next().unwrap(),
        Kind::Truth | Kind::Either => *condition.next().unwrap(),
    };
    let op = match code.row().operands {
        [] => code.of([]),
        [a] => code.of([operand(a)]),
        [a, b] => code.of([operand(a), operand(b)]),
        [a, b, c] => code.of([operand(a), operand(b), operand(c)]),
        _ => unreachable!("no operation has more than three operands"),
    };
    let mut result = push(level, op);
    if is_truth(code, truths) {
        result = push(level, Opcode::Select.of([result, numbers[choice[0]], numbers[choice[1]]]));
    }
    // A condition selects a pixel value that is known earlier.
    let pixel = if level == Level::Pixel { result } else { push(Level::Pixel, Opcode::Neg.of([parameters[3]])) };
    let row = push(Level::RowEnd, Opcode::RowTotal(AccumulatorId(0)).of([]));
    let total = if matches!(level, Level::Row | Level::RowEnd) { result } else { row };
    let pass = push(Level::PassEnd, Opcode::PassTotal(TotalId(0)).of([]));
    let output = if matches!(level, Level::Pass | Level::PassEnd) { result } else { pass };
    // By level.
    let mut order: Vec<usize> = (0..instructions.len()).collect();
    order.sort_by_key(|i| instructions[*i].level);
    let at = |v: Value| Value(order.iter().position(|i| *i == v.index()).unwrap() as u32);
    let moved = |i: &usize| Instruction { op: instructions[*i].op.renamed(at), ..instructions[*i] };
    let nest = LoopNest {
        coordinates: 2,
        channels: 1,
        inputs: (0..4).map(|i| Input::Parameter(ParameterId(i))).collect(),
        tables: tables(),
        instructions: order.iter().map(moved).collect(),
        pixel_set: PixelSet::default(),
        sink: Sink::Sums { accumulators: vec![at(pixel)], totals: vec![at(total)], outputs: vec![at(output)] },
        names: Default::default(),
        fused: false,
    };
    Program::of(nest).unwrap_or_else(|wrong| panic!("{code:?} at {level:?}: {wrong}"))
}

fn is_truth(code: Opcode, truths: bool) -> bool {
    code.row().result == Kind::Truth || (code.row().result == Kind::Either && truths)
}

#[test]
fn every_operation_equals_the_interpreter() {
    const LEVELS: [Level; 5] = [Level::Pass, Level::Row, Level::Pixel, Level::RowEnd, Level::PassEnd];
    let seed = 5;
    let mut random = Random(seed);
    let image = Image::new(PixelFormat::F32, [1, 1], 1, [0, 0], |_, _, _| -0.75);
    let window = Window::whole(1, 1);
    let mut met = 0;
    for code in Opcode::every().into_iter().filter(|code| *code != Opcode::Fma || has_fma()) {
        let at = LEVELS.into_iter().filter(|level| code.row().level.is_none_or(|only| only == *level));
        let truths: &[bool] = if code.row().result == Kind::Either { &[false, true] } else { &[false] };
        let ways = at.flat_map(|level| truths.iter().map(move |truths| (level, *truths)));
        let choices = |truths: bool| if is_truth(code, truths) { &CHOICES[..] } else { &CHOICES[..1] };
        for (level, truths, choice) in ways.flat_map(|(l, t)| choices(t).iter().map(move |choice| (l, t, *choice))) {
            let program = program(code, level, truths, choice);
            for (precision, width) in
                [Precision::F32, Precision::F64].into_iter().flat_map(|p| widths().into_iter().map(move |w| (p, w)))
            {
                let options = KernelOptions { width, precision, formats: vec![PixelFormat::F32], packed: true };
                let kernel = Kernel::compile(&program, &options).unwrap();
                for case in 0..60 {
                    let numbers: [f64; 4] = std::array::from_fn(|_| match case % 3 {
                        0 => random.special(),
                        1 => random.ordinary(),
                        _ if random.below(2) == 0 => random.special(),
                        _ => random.ordinary(),
                    });
                    let bindings = Bindings { parameters: &numbers, ..Bindings::default() };
                    let native = kernel.sums(&bindings, &image.views(), window).unwrap().outputs;
                    let planes = Planes(image.views());
                    let expected =
                        interpreter::run(&program, precision, options.summation(), &bindings, &planes, window, None)
                            .outputs;
                    assert!(
                        same(native[0], expected[0]),
                        "{code:?} at {level:?}, {options:?}, of {numbers:?}: {native:?}, not {expected:?}; seed {seed}"
                    );
                    met += 1;
                }
            }
        }
    }
    assert!(met > 60 * 2 * 5 * 25, "{met}");
}
