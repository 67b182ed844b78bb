//! Is this a program? What comes in: instructions and what is done with them. What goes out: nothing, or what is wrong.
//!
//! Who lowers or runs a program takes for granted what is checked here, so that a bug upstream is an error of
//! [`Program::check`] and never a panic or wrong code.
//! Checked: operands come first and are readable at their reader's level; each operation stands at a level that has it;
//! numbers and truth values are not mixed up; every index (input, channel, accumulator, total, coordinate) exists.

use thiserror::Error;

use crate::language::limits::LIMITS;
use crate::program::{Input, Instruction, Kind, Level, Names, Op, Opcode, PixelSet, Program, Sink, Value};

/// What is wrong with a program, and where.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum Malformed {
    /// More than a program can have.
    #[error("{0} coordinates are more than {max}", max = LIMITS.coordinates)]
    Coordinates(usize),
    /// An instruction.
    #[error("v{}, {op:?} at {level:?}: {broken}", value.0)]
    Instruction {
        /// Its value.
        value: Value,
        /// What it does.
        op: Op,
        /// Where it stands.
        level: Level,
        /// The rule that it breaks.
        broken: Rule,
    },
    /// What is done with a value.
    #[error("{reader:?} reads v{}: {broken}", value.0)]
    Reader {
        /// Who reads it.
        reader: Reader,
        /// Which.
        value: Value,
        /// The rule that it breaks.
        broken: Rule,
    },
}

/// A rule of programs, as it sounds when it is broken.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum Rule {
    /// Operands come first.
    #[error("it does not exist, or comes later")]
    Order,
    /// A value is read where it is known.
    #[error("it is not known at this level")]
    Known,
    /// An operation stands where the table has it.
    #[error("this level does not have it")]
    Place,
    /// An input, a channel, an accumulator, a total, a coordinate exists.
    #[error("the index does not exist")]
    Index,
    /// Numbers are numbers, and truth values are truth values.
    #[error("numbers and truth values are mixed up")]
    Kind,
}

/// What reads a value besides instructions; sums by their position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[allow(missing_docs)]
pub enum Reader {
    Bound,
    Mask,
    Saturation,
    Plane,
    Accumulator(usize),
    Total(usize),
    Output(usize),
}

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
    /// When they are no program.
    pub fn from_parts(parts: ProgramParts) -> Result<Program, Malformed> {
        let ProgramParts { coordinates, channels, inputs, instructions, pixel_set, sink, fused } = parts;
        let names = Names::default();
        let program = Program { coordinates, channels, inputs, instructions, pixel_set, sink, names, fused };
        program.check().map(|()| program)
    }

    /// A program from parts whose instructions stand in any order of levels, operands first: they are put in order, and what
    /// nothing reads is left out.
    ///
    /// # Errors
    /// When they are no program.
    pub fn arranged(parts: ProgramParts, names: Names) -> Result<Program, Malformed> {
        let ProgramParts { coordinates, channels, inputs, instructions, pixel_set, sink, fused } = parts;
        let mut program = Program { coordinates, channels, inputs, instructions, pixel_set, sink, names, fused };
        crate::program::peephole::improve(&mut program, false);
        program.check().map(|()| program)
    }

    /// Nothing, or what is wrong with the program; only a bug could be.
    ///
    /// # Errors
    /// The first rule that is broken, and by what.
    pub fn check(&self) -> Result<(), Malformed> {
        if self.coordinates() > LIMITS.coordinates {
            return Err(Malformed::Coordinates(self.coordinates()));
        }
        let mut kinds = Vec::with_capacity(self.instructions.len());
        for (at, Instruction { op, level, .. }) in self.instructions.iter().enumerate() {
            let wrong = |broken| Malformed::Instruction { value: Value(at as u32), op: *op, level: *level, broken };
            kinds.push(self.kind(*op, *level, &kinds).map_err(wrong)?);
        }
        let reads = |reader: Reader, value: Value, level: Level, kind: Kind| {
            let found = self.read(value, level, &kinds);
            let broken = match found {
                Ok(found) if found == kind => return Ok(()),
                Ok(_) => Rule::Kind,
                Err(broken) => broken,
            };
            Err(Malformed::Reader { reader, value, broken })
        };
        let PixelSet { bounds, mask, saturated } = self.pixel_set;
        for bound in bounds.into_iter().flat_map(|(lo, hi)| [lo, hi]) {
            reads(Reader::Bound, bound, Level::Row, Kind::Number)?;
        }
        mask.map_or(Ok(()), |v| reads(Reader::Mask, v, Level::Pixel, Kind::Truth))?;
        saturated.map_or(Ok(()), |v| reads(Reader::Saturation, v, Level::Pixel, Kind::Truth))?;
        match &self.sink {
            Sink::Plane(v) => reads(Reader::Plane, *v, Level::Pixel, Kind::Number),
            Sink::Sums { accumulators, totals, outputs } => {
                let all = |list: &[Value], reader: fn(usize) -> Reader, level| {
                    list.iter().enumerate().try_for_each(|(i, v)| reads(reader(i), *v, level, Kind::Number))
                };
                all(accumulators, Reader::Accumulator, Level::Pixel)?;
                all(totals, Reader::Total, Level::RowEnd)?;
                all(outputs, Reader::Output, Level::PassEnd)
            }
        }
    }

    /// What a value is, for a reader at `level`.
    fn read(&self, value: Value, level: Level, kinds: &[Kind]) -> Result<Kind, Rule> {
        let kind = kinds.get(value.index()).ok_or(Rule::Order)?;
        let is_known = readable(self.instructions[value.index()].level, level);
        if is_known { Ok(*kind) } else { Err(Rule::Known) }
    }

    /// What an operation gives, number or truth value; `kinds` are those of the values before it.
    fn kind(&self, op: Op, level: Level, kinds: &[Kind]) -> Result<Kind, Rule> {
        let row = op.code.row();
        let mut either = None;
        for (operand, wanted) in op.operands().zip(row.operands) {
            let reader = if *wanted == Kind::OfRow { Level::Row } else { level };
            let given = self.read(operand, reader, kinds)?;
            let wanted = match wanted {
                Kind::OfRow => Kind::Number,
                Kind::Either => *either.get_or_insert(given),
                wanted => *wanted,
            };
            if given != wanted {
                return Err(Rule::Kind);
            }
        }
        if row.level.is_some_and(|only| only != level) {
            return Err(Rule::Place);
        }
        if !self.has(op.code) {
            return Err(Rule::Index);
        }
        Ok(either.filter(|_| row.result == Kind::Either).unwrap_or(row.result))
    }

    /// Whether what the opcode names exists.
    fn has(&self, code: Opcode) -> bool {
        let (accumulators, totals) = match &self.sink {
            Sink::Sums { accumulators, totals, .. } => (accumulators.len(), totals.len()),
            Sink::Plane(_) => (0, 0),
        };
        match code {
            Opcode::Input(input) => input.index() < self.inputs.len(),
            Opcode::Outer(coordinate) => (1..self.coordinates().max(2)).contains(&coordinate.index()),
            Opcode::Channel(channel) => channel.index() < self.channels(),
            Opcode::RowTotal(accumulator) => accumulator.index() < accumulators,
            Opcode::PassTotal(total) => total.index() < totals,
            _ => true,
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
    use super::*;
    use crate::program::{AccumulatorId, ChannelId, Comparison, CoordinateId, InputId, ParameterId, TotalId};

    fn verdict(ops: &[(Level, Op)], sink: Sink, pixel_set: PixelSet, coordinates: u32) -> Result<(), Malformed> {
        let instructions = ops.iter().map(|(level, op)| Instruction { op: *op, level: *level, span: None }).collect();
        let inputs = vec![Input::Parameter(ParameterId(0))];
        let parts = ProgramParts { coordinates, channels: 1, inputs, instructions, pixel_set, sink, fused: false };
        Program::from_parts(parts).map(|_| ())
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
    fn a_sound_program_passes() {
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
    fn wrong_readers_are_caught() {
        let (ops, sink) = good();
        let set = |mask| PixelSet { mask: Some(mask), ..PixelSet::default() };
        let wrong = |reader, value, broken| Err(Malformed::Reader { reader, value, broken });
        assert_eq!(verdict(&ops, sink.clone(), PixelSet::default(), 5), Err(Malformed::Coordinates(5)));
        assert_eq!(verdict(&ops, sink.clone(), set(Value(2)), 2), wrong(Reader::Mask, Value(2), Rule::Kind));
        assert_eq!(verdict(&ops, sink.clone(), set(Value(9)), 2), wrong(Reader::Mask, Value(9), Rule::Order));
        assert_eq!(verdict(&ops, sink, set(Value(6)), 2), wrong(Reader::Mask, Value(6), Rule::Known));
        let sink = Sink::Sums { accumulators: vec![Value(5), Value(4)], totals: vec![], outputs: vec![] };
        assert_eq!(
            verdict(&ops[..6], sink, PixelSet::default(), 2),
            wrong(Reader::Accumulator(1), Value(4), Rule::Kind)
        );
    }
}
