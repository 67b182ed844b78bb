//! Excludes saturated pixels from sums: counts and skips pixels at the limit of given channels, in the same loop nest;
//! and compares programs up to that.

use rustc_hash::FxHashMap;

use crate::program::peephole::{arrange, roots};
use crate::program::{
    ChannelId, Comparison, Input, InputId, Instruction, Level, LoopNest, Op, Opcode, PixelSet, Value,
};

impl LoopNest {
    /// The same program without pixels at or above their limit in one of these channels.
    pub(crate) fn without_saturated(&self, channels: &[ChannelId]) -> LoopNest {
        let mut program = self.clone();
        let mut limits: Vec<Instruction> = Vec::new();
        let mut emit = |op: Op, level: Level| {
            let span = self.instructions.iter().find(|i| i.op == op).and_then(|i| i.span);
            limits.push(Instruction { op, level, span });
            Value(limits.len() as u32 - 1)
        };
        for channel in channels {
            let limit = Input::Saturation(*channel);
            let at = program.inputs.iter().position(|input| *input == limit).unwrap_or(program.inputs.len());
            program.inputs.extend((at == program.inputs.len()).then_some(limit));
            let limit = emit(Opcode::Input(InputId(at as u32)).of([]), Level::Pass);
            let pixel = emit(Opcode::Channel(*channel).of([]), Level::Pixel);
            let at_limit = emit(Opcode::Compare(Comparison::Le).of([limit, pixel]), Level::Pixel);
            let found = program.pixel_set.saturated.map(|before| emit(Opcode::Or.of([before, at_limit]), Level::Pixel));
            program.pixel_set.saturated = found.or(Some(at_limit));
        }
        // An input or a channel is read once.
        let there = |v: Value| {
            let op = self.instructions[v.index()].op;
            limits.iter().position(|i| i.op == op && op.operands().next().is_none())
        };
        let saturated = program.pixel_set.saturated.take();
        program.rename(|v| Value(there(v).unwrap_or(limits.len() + v.index()) as u32));
        program.pixel_set.saturated = saturated;
        program.instructions.splice(0..0, limits);
        arrange(&mut program);
        program
    }

    /// True when the programs are equal up to saturated pixels: each value read for anything else results from the same
    /// operations in the same loop. Equal values that are computed differently compare unequal.
    pub(crate) fn is_alike(&self, other: &LoopNest) -> bool {
        let mut known = FxHashMap::default();
        let mut read = |program: &LoopNest| {
            let mut numbers: Vec<Value> = Vec::with_capacity(program.instructions.len());
            for Instruction { op, level, .. } in &program.instructions {
                let (op, input) = match op.code {
                    Opcode::Input(i) => (Opcode::Input(InputId(0)).of([]), Some(program.inputs[i.index()])),
                    _ => (op.renamed(|v| numbers[v.index()]), None),
                };
                let next = Value(known.len() as u32);
                numbers.push(*known.entry((op, *level, input)).or_insert(next));
            }
            let set = PixelSet { saturated: None, ..program.pixel_set };
            let read: Vec<Value> = roots(&set, &program.sink).into_iter().map(|v| numbers[v.index()]).collect();
            let contracted: Vec<bool> = program.contractions().iter().map(Option::is_some).collect();
            (read, set.bounds.is_some(), set.mask.is_some(), program.fused, contracted)
        };
        read(self) == read(other)
    }
}
