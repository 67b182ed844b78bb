//! The order of the pixel instructions, and what they read.

use isophote_symbolic::{Level, Opcode, PixelSet, Program, Sink, Value};

/// Peak register pressure of an elementary function, vectors.
pub(super) const FUNCTION_REGISTERS: usize = 7;

/// Whether the program tests each pixel.
pub(super) fn is_masked(program: &Program) -> bool {
    let PixelSet { mask, saturated, .. } = program.pixel_set();
    mask.is_some() || saturated.is_some()
}

/// The roots of the pixel level, including those of the pixel set.
pub(super) fn sinks(program: &Program) -> impl Iterator<Item = Value> {
    let PixelSet { mask, saturated, .. } = *program.pixel_set();
    let summed = match program.sink() {
        Sink::Sums { accumulators, .. } => accumulators.as_slice(),
        Sink::Plane(value) => std::slice::from_ref(value),
    };
    mask.into_iter().chain(saturated).chain(summed.iter().copied())
}

/// The live pixel instructions; those of the pixel set come first, so that a value can be summed as soon as it is
/// computed.
pub(super) fn order(program: &Program) -> Vec<Value> {
    let PixelSet { mask, saturated, .. } = *program.pixel_set();
    let first = program.made_of(mask.into_iter().chain(saturated));
    let all = program.made_of(sinks(program));
    let pixel = |i: &usize| program.instructions()[*i].level == Level::Pixel;
    let (set, rest): (Vec<usize>, Vec<usize>) =
        (0..all.len()).filter(|i| all[*i]).filter(pixel).partition(|i| first[*i]);
    set.into_iter().chain(rest).map(|i| Value(i as u32)).collect()
}

/// Reads of pass and row values as f64: (level of the reader, value).
pub(super) fn scalar_reads(program: &Program) -> Vec<(Level, Value)> {
    let mut reads = Vec::new();
    for instruction in program.instructions() {
        let level = match (instruction.level, instruction.op.code) {
            (Level::Pixel, Opcode::Offset) => Level::Row,
            (Level::Pixel, _) => continue,
            (level, _) => level,
        };
        reads.extend(instruction.op.operands().map(|v| (level, v)));
    }
    if let Some((lo, hi)) = program.pixel_set().bounds {
        reads.extend([(Level::Row, lo), (Level::Row, hi)]);
    }
    if let Sink::Sums { totals, outputs, .. } = program.sink() {
        reads.extend(totals.iter().map(|v| (Level::RowEnd, *v)));
        reads.extend(outputs.iter().map(|v| (Level::PassEnd, *v)));
    }
    reads
}

/// Peak register pressure of a group, vectors: live values, the pixel set's roots, the running offsets, and one memory
/// operand.
pub(super) fn busy_registers(program: &Program, pixels: &[Value]) -> usize {
    let mut last_read = vec![0_usize; program.instructions().len()];
    for (at, value) in pixels.iter().enumerate() {
        program.instruction(*value).op.operands().for_each(|v| last_read[v.index()] = at);
    }
    let PixelSet { mask, saturated, .. } = *program.pixel_set();
    mask.into_iter().chain(saturated).for_each(|v| last_read[v.index()] = pixels.len());
    let (mut live, mut most) = (0_usize, 0);
    for (at, value) in pixels.iter().enumerate() {
        live += 1;
        most = most.max(live);
        let mut ended: Vec<Value> = program.instruction(*value).op.operands().collect();
        ended.push(*value);
        ended.sort();
        ended.dedup();
        let pixel = |v: &Value| program.instruction(*v).level == Level::Pixel;
        live -= ended.iter().filter(|v| pixel(v) && last_read[v.index()] <= at).count();
    }
    let offsets = pixels.iter().filter(|v| program.instruction(**v).op.code == Opcode::Offset).count();
    most + offsets + 1
}
