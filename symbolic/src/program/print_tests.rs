//! Text form of programs.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::program::{AccumulatorId, ChannelId, CoordinateId, InputId, Instruction, ParameterId, PixelSet, TotalId};

#[test]
fn unnamed_program_prints_positions() {
    let at = |level, op| Instruction { op, level, span: None };
    let instructions = vec![
        at(Level::Pass, Opcode::Input(InputId(0)).of([])),
        at(Level::Pass, Opcode::Input(InputId(1)).of([])),
        at(Level::Row, Opcode::Outer(CoordinateId(1)).of([])),
        at(Level::Pixel, Opcode::Channel(ChannelId(0)).of([])),
        at(Level::Pixel, Opcode::Offset.of([Value(2)])),
        at(Level::Pixel, Opcode::Fma.of([Value(0), Value(3), Value(4)])),
        at(Level::RowEnd, Opcode::RowTotal(AccumulatorId(0)).of([])),
        at(Level::PassEnd, Opcode::PassTotal(TotalId(0)).of([])),
    ];
    let program = LoopNest {
        coordinates: 2,
        channels: 1,
        inputs: vec![Input::Parameter(ParameterId(3)), Input::Saturation(ChannelId(0))],
        tables: Default::default(),
        instructions,
        pixel_set: PixelSet { bounds: Some((Value(2), Value(2))), ..PixelSet::default() },
        sink: Sink::Sums { accumulators: vec![Value(5)], totals: vec![Value(6)], outputs: vec![Value(7)] },
        names: Default::default(),
        fused: true,
    };
    program.check().unwrap();
    let expected = "pass:\n  v0 = p3\n  v1 = limit(i0)\nrow:\n  v2 = x1\npixel:\n  v3 = pixel(i0)\n  v4 = x0 + v2\n  \
        v5 = fma(v0, v3, v4)\nrow end:\n  v6 = row sum 0\npass end:\n  v7 = total 0\nbounds: v2 <= x0 <= v2\n\
        accumulators: v5\ntotals: v6\no0 = v7\n";
    assert_eq!(program.to_string(), expected);
}
