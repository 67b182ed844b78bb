//! Is this a program? What comes in: instructions and what is done with them. What goes out: nothing, or what is wrong.
//!
//! Who lowers or runs a program takes for granted what is checked here, so that a bug upstream is an error of
//! [`Program::check`] and never a panic or wrong code.
//! Checked: operands come first and are readable at their reader's level; each operation stands at a level that has it;
//! numbers and truth values are not mixed up; every index (input, channel, accumulator, total, coordinate) exists.

use crate::language::limits::LIMITS;
use crate::program::{Input, Instruction, Level, Names, Op, PixelSet, Program, Sink, Value};

/// A program that was not derived from a document.
#[derive(Clone, PartialEq, Debug)]
pub struct ProgramParts {
    /// Number of coordinates, the inner one included.
    pub coordinates: u32,
    /// Number of raw planes.
    pub channels: u32,
    /// What it reads besides pixels.
    pub inputs: Vec<Input>,
    /// Ordered by level, operands first.
    pub instructions: Vec<Instruction>,
    /// Which pixels take part.
    pub pixel_set: PixelSet,
    /// What becomes of them.
    pub sink: Sink,
    /// See [`Program::is_fused`].
    pub fused: bool,
}

impl Program {
    /// A program from its parts, without names.
    ///
    /// # Errors
    /// A sentence when they are no program.
    pub fn from_parts(parts: ProgramParts) -> Result<Program, String> {
        let ProgramParts { coordinates, channels, inputs, instructions, pixel_set, sink, fused } = parts;
        let names = Names::default();
        let program = Program { coordinates, channels, inputs, instructions, pixel_set, sink, names, fused };
        program.check().map(|()| program)
    }

    /// A program from parts whose instructions stand in any order of levels, operands first: they are put in order, and what
    /// nothing reads is left out.
    ///
    /// # Errors
    /// A sentence when they are no program.
    pub fn arranged(parts: ProgramParts, names: Names) -> Result<Program, String> {
        let ProgramParts { coordinates, channels, inputs, instructions, pixel_set, sink, fused } = parts;
        let mut program = Program { coordinates, channels, inputs, instructions, pixel_set, sink, names, fused };
        crate::program::peephole::improve(&mut program, false);
        program.check().map(|()| program)
    }

    /// Nothing, or what is wrong with the program; only a bug could be.
    ///
    /// # Errors
    /// A sentence.
    pub fn check(&self) -> Result<(), String> {
        Parts {
            instructions: &self.instructions,
            pixel_set: self.pixel_set,
            sink: &self.sink,
            inputs: self.inputs.len(),
            channels: self.channels(),
            coordinates: self.coordinates(),
        }
        .check()
    }
}

/// The parts of a program.
struct Parts<'a> {
    instructions: &'a [Instruction],
    pixel_set: PixelSet,
    sink: &'a Sink,
    inputs: usize,
    channels: usize,
    coordinates: usize,
}

impl Parts<'_> {
    fn check(&self) -> Result<(), String> {
        if self.coordinates > LIMITS.coordinates {
            return Err(format!("{} coordinates are more than {}", self.coordinates, LIMITS.coordinates));
        }
        let mut truths = Vec::with_capacity(self.instructions.len());
        for (at, instruction) in self.instructions.iter().enumerate() {
            let truth = self.instruction(at, instruction, &truths)?;
            truths.push(truth);
        }
        let reads = |v: Value, level: Level, truth: bool, what: &str| {
            let given = truths.get(v.index()).ok_or(format!("{what} {v:?} does not exist"))?;
            let from = self.instructions[v.index()].level;
            match *given == truth && readable(from, level) {
                true => Ok(()),
                false => Err(format!("{what} {v:?} has the wrong kind or level")),
            }
        };
        if let Some((lo, hi)) = self.pixel_set.bounds {
            reads(lo, Level::Row, false, "bound")?;
            reads(hi, Level::Row, false, "bound")?;
        }
        self.pixel_set.mask.map_or(Ok(()), |v| reads(v, Level::Pixel, true, "mask"))?;
        self.pixel_set.saturated.map_or(Ok(()), |v| reads(v, Level::Pixel, true, "saturation"))?;
        match self.sink {
            Sink::Plane(v) => reads(*v, Level::Pixel, false, "plane")?,
            Sink::Sums { accumulators, totals, outputs } => {
                accumulators.iter().try_for_each(|v| reads(*v, Level::Pixel, false, "accumulator"))?;
                totals.iter().try_for_each(|v| reads(*v, Level::RowEnd, false, "total"))?;
                outputs.iter().try_for_each(|v| reads(*v, Level::PassEnd, false, "output"))?;
            }
        }
        Ok(())
    }

    /// Whether the result is a truth value.
    fn instruction(&self, at: usize, instruction: &Instruction, truths: &[bool]) -> Result<bool, String> {
        let Instruction { op, level, .. } = *instruction;
        let wrong = |what: &str| Err(format!("instruction {at}, {op:?} at {level:?}: {what}"));
        let mut kinds = Vec::with_capacity(3);
        for operand in op.operands() {
            let Some(truth) = truths.get(operand.index()) else { return wrong("an operand comes later") };
            let from = self.instructions[operand.index()].level;
            let reader = if matches!(op, Op::Offset(_)) { Level::Row } else { level };
            if !readable(from, reader) {
                return wrong("an operand is not known at this level");
            }
            kinds.push(*truth);
        }
        let (accumulators, totals) = match self.sink {
            Sink::Sums { accumulators, totals, .. } => (accumulators.len(), totals.len()),
            Sink::Plane(_) => (0, 0),
        };
        let placed = match op {
            Op::Input(_) => level == Level::Pass,
            Op::Outer(_) => level == Level::Row,
            Op::Offset(_) | Op::Channel(_) => level == Level::Pixel,
            Op::RowTotal(_) | Op::RowCount => level == Level::RowEnd,
            Op::PassTotal(_) | Op::PassCount => level == Level::PassEnd,
            _ => true,
        };
        let exists = match op {
            Op::Input(input) => input.index() < self.inputs,
            Op::Outer(coordinate) => (1..self.coordinates.max(2)).contains(&coordinate.index()),
            Op::Channel(channel) => channel.index() < self.channels,
            Op::RowTotal(accumulator) => accumulator.index() < accumulators,
            Op::PassTotal(total) => total.index() < totals,
            _ => true,
        };
        let (result, fits) = match op {
            Op::Compare(..) => (true, !kinds.contains(&true)),
            Op::And(..) | Op::Or(..) | Op::Not(_) => (true, !kinds.contains(&false)),
            Op::Select(..) => (kinds[1], kinds[0] && kinds[1] == kinds[2]),
            _ => (false, !kinds.contains(&true)),
        };
        match (placed, exists, fits) {
            (false, ..) => wrong("this level does not have it"),
            (_, false, _) => wrong("the index does not exist"),
            (.., false) => wrong("numbers and truth values are mixed up"),
            _ => Ok(result),
        }
    }
}

/// Whether a value of level `from` is known where `at` runs.
fn readable(from: Level, at: Level) -> bool {
    match from {
        Level::Pass => true,
        Level::Row => at != Level::Pass && at != Level::PassEnd,
        Level::Pixel | Level::RowEnd | Level::PassEnd => from == at,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::program::{AccumulatorId, ChannelId, Comparison, CoordinateId, InputId, TotalId};

    fn verdict(ops: &[(Level, Op)], sink: Sink, pixel_set: PixelSet) -> Result<(), String> {
        let instructions: Vec<Instruction> =
            ops.iter().map(|(level, op)| Instruction { op: *op, level: *level, span: None }).collect();
        Parts { instructions: &instructions, pixel_set, sink: &sink, inputs: 1, channels: 1, coordinates: 2 }.check()
    }

    fn good() -> (Vec<(Level, Op)>, Sink) {
        let ops = vec![
            (Level::Pass, Op::Input(InputId(0))),
            (Level::Row, Op::Outer(CoordinateId(1))),
            (Level::Pixel, Op::Channel(ChannelId(0))),
            (Level::Pixel, Op::Offset(Value(1))),
            (Level::Pixel, Op::Compare(Comparison::Lt, Value(2), Value(3))),
            (Level::Pixel, Op::Select(Value(4), Value(2), Value(0))),
            (Level::RowEnd, Op::RowTotal(AccumulatorId(0))),
            (Level::PassEnd, Op::PassTotal(TotalId(0))),
        ];
        (ops, Sink::Sums { accumulators: vec![Value(5)], totals: vec![Value(6)], outputs: vec![Value(7)] })
    }

    #[test]
    fn a_sound_program_passes() {
        let (ops, sink) = good();
        assert_eq!(verdict(&ops, sink, PixelSet { mask: Some(Value(4)), ..PixelSet::default() }), Ok(()));
    }

    #[test]
    fn planted_faults_are_caught() {
        let faults: [(usize, (Level, Op), &str); 8] = [
            (0, (Level::Pass, Op::Input(InputId(1))), "does not exist"),
            (0, (Level::Row, Op::Input(InputId(0))), "does not have it"),
            (1, (Level::Row, Op::Outer(CoordinateId(2))), "does not exist"),
            (2, (Level::Pixel, Op::Channel(ChannelId(1))), "does not exist"),
            (3, (Level::Pixel, Op::Offset(Value(2))), "not known at this level"),
            (4, (Level::Pixel, Op::Compare(Comparison::Lt, Value(2), Value(4))), "comes later"),
            (5, (Level::Pixel, Op::Select(Value(2), Value(2), Value(0))), "mixed up"),
            (6, (Level::RowEnd, Op::Neg(Value(5))), "not known at this level"),
        ];
        for (at, planted, message) in faults {
            let (mut ops, sink) = good();
            ops[at] = planted;
            let error = verdict(&ops, sink, PixelSet::default()).unwrap_err();
            assert!(error.contains(message), "{error} instead of {message}");
        }
        let (ops, sink) = good();
        let instructions: Vec<Instruction> =
            ops.iter().map(|(level, op)| Instruction { op: *op, level: *level, span: None }).collect();
        let five = Parts {
            instructions: &instructions,
            pixel_set: PixelSet::default(),
            sink: &sink,
            inputs: 1,
            channels: 1,
            coordinates: 5,
        };
        assert!(five.check().unwrap_err().contains("5 coordinates"));
        let (ops, _) = good();
        let sink = Sink::Sums { accumulators: vec![Value(4)], totals: vec![], outputs: vec![] };
        assert!(verdict(&ops[..6], sink, PixelSet::default()).unwrap_err().contains("wrong kind"));
    }
}
