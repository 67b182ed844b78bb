//! Validation of programs.

use super::*;
use crate::program::{AccumulatorId, ChannelId, Comparison, CoordinateId, Input, InputId, ParameterId, TotalId};

fn verdict(ops: &[(Level, Op)], sink: Sink, pixel_set: PixelSet, coordinates: u32) -> Result<(), Malformed> {
    let instructions = ops.iter().map(|(level, op)| Instruction { op: *op, level: *level, span: None }).collect();
    let inputs = vec![Input::Parameter(ParameterId(0))];
    let nest = LoopNest {
        coordinates,
        channels: 1,
        inputs,
        tables: Default::default(),
        instructions,
        pixel_set,
        sink,
        names: Default::default(),
        fused: false,
    };
    nest.check()
}

const LESS: Opcode = Opcode::Compare(Comparison::Lt);

fn good() -> (Vec<(Level, Op)>, Sink) {
    let ops = vec![
        (Level::Pass, Opcode::Input(InputId(0)).of([])),
        (Level::Row, Opcode::Outer(CoordinateId(1)).of([])),
        (Level::Pixel, Opcode::Channel(ChannelId(0)).of([])),
        (Level::Pixel, Opcode::Offset.of([Value(1)])),
        (Level::Pixel, LESS.of([Value(2), Value(3)])),
        (Level::Pixel, Opcode::Select.of([Value(4), Value(2), Value(0)])),
        (Level::RowEnd, Opcode::RowTotal(AccumulatorId(0)).of([])),
        (Level::PassEnd, Opcode::PassTotal(TotalId(0)).of([])),
    ];
    (ops, Sink::Sums { accumulators: vec![Value(5)], totals: vec![Value(6)], outputs: vec![Value(7)] })
}

#[test]
fn valid_program_passes() {
    let (ops, sink) = good();
    assert_eq!(verdict(&ops, sink, PixelSet { mask: Some(Value(4)), ..PixelSet::default() }, 2), Ok(()));
}

#[test]
fn planted_faults_are_caught() {
    let faults: [(usize, (Level, Op), Rule); 10] = [
        (0, (Level::Pass, Opcode::Input(InputId(1)).of([])), Rule::Index),
        (0, (Level::Row, Opcode::Input(InputId(0)).of([])), Rule::Place),
        (1, (Level::Row, Opcode::Outer(CoordinateId(2)).of([])), Rule::Index),
        (2, (Level::Pixel, Opcode::Channel(ChannelId(1)).of([])), Rule::Index),
        (3, (Level::Pixel, Opcode::Offset.of([Value(2)])), Rule::Known),
        (4, (Level::Pixel, LESS.of([Value(2), Value(4)])), Rule::Order),
        (4, (Level::Pixel, LESS.of([Value(2)])), Rule::Order),
        (5, (Level::Pixel, Opcode::Select.of([Value(2), Value(2), Value(0)])), Rule::Kind),
        (5, (Level::Pixel, Opcode::Select.of([Value(4), Value(2), Value(4)])), Rule::Kind),
        (6, (Level::RowEnd, Opcode::Neg.of([Value(5)])), Rule::Known),
    ];
    for (at, (level, op), broken) in faults {
        let (mut ops, sink) = good();
        ops[at] = (level, op);
        let wrong = Malformed::Instruction { value: Value(at as u32), op, level, broken };
        assert_eq!(verdict(&ops, sink, PixelSet::default(), 2), Err(wrong));
    }
}

#[test]
fn invalid_readers_are_rejected() {
    let (ops, sink) = good();
    let set = |mask| PixelSet { mask: Some(mask), ..PixelSet::default() };
    let wrong = |reader, value, broken| Err(Malformed::Reader { reader, value, broken });
    assert_eq!(verdict(&ops, sink.clone(), PixelSet::default(), 5), Err(Malformed::Coordinates(5)));
    assert_eq!(verdict(&ops, sink.clone(), set(Value(2)), 2), wrong(Reader::Mask, Value(2), Rule::Kind));
    assert_eq!(verdict(&ops, sink.clone(), set(Value(9)), 2), wrong(Reader::Mask, Value(9), Rule::Order));
    assert_eq!(verdict(&ops, sink, set(Value(6)), 2), wrong(Reader::Mask, Value(6), Rule::Known));
    let sink = Sink::Sums { accumulators: vec![Value(5), Value(4)], totals: vec![], outputs: vec![] };
    assert_eq!(verdict(&ops[..6], sink, PixelSet::default(), 2), wrong(Reader::Accumulator(1), Value(4), Rule::Kind));
}
