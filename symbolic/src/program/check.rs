//! Is this a program? What comes in: instructions and what is done with them. What goes out: nothing, or what is wrong.
//!
//! Who lowers or runs a program takes for granted what is checked here, so that a bug upstream is an error of
//! [`Program::check`] and never a panic or wrong code.
//! Checked: operands come first and are readable at their reader's level; each operation stands at a level that has it;
//! numbers and truth values are not mixed up; every index (input, channel, accumulator, total, coordinate) exists.

use isophote_elementary::Tables;
use thiserror::Error;

use crate::program::{Input, Instruction, Kind, Level, Names, Op, Opcode, PixelSet, Program, Sink, Value};
use isophote_syntax::limits::LIMITS;

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
    /// What it looks up.
    pub tables: Tables,
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
        let ProgramParts { coordinates, channels, inputs, tables, instructions, pixel_set, sink, fused } = parts;
        let names = Default::default();
        let program = Program { coordinates, channels, inputs, tables, instructions, pixel_set, sink, names, fused };
        program.check().map(|()| program)
    }

    /// A program from parts whose instructions stand in any order of levels, operands first: they are put in order, and what
    /// nothing reads is left out.
    ///
    /// # Panics
    /// When an operand, or what the sink reads, is none of the instructions.
    ///
    /// # Errors
    /// When they are no program.
    pub fn arranged(parts: ProgramParts, names: Names) -> Result<Program, Malformed> {
        let ProgramParts { coordinates, channels, inputs, tables, instructions, pixel_set, sink, fused } = parts;
        let names = names.into();
        let mut program =
            Program { coordinates, channels, inputs, tables, instructions, pixel_set, sink, names, fused: false };
        crate::program::peephole::improve(&mut program);
        program.fused = fused;
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
            Opcode::Gather(lookup) => self.tables.has(lookup),
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
#[path = "check_tests.rs"]
mod tests;
