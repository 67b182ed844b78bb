//! Validates programs. Lowering and execution rely on it, so that a bug upstream is an error of [`LoopNest::check`] and
//! never a panic or wrong code.
//!
//! Checked: operands precede their readers and are readable at the reader's level; each operation is at a level that
//! has it; numbers and truth values are not mixed; every index (input, channel, table, accumulator, total, coordinate)
//! exists.

use thiserror::Error;

use crate::program::{Instruction, Kind, Level, LoopNest, Op, Opcode, PixelSet, Sink, Value};
use isophote_syntax::limits::LIMITS;

/// A broken rule and its location.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum Malformed {
    /// Too many coordinates.
    #[error("{0} coordinates are more than {max}", max = LIMITS.coordinates)]
    Coordinates(usize),
    /// An instruction breaks a rule.
    #[error("v{}, {op:?} at {level:?}: {broken}", value.0)]
    Instruction {
        /// Its value.
        value: Value,
        /// Its operation.
        op: Op,
        /// Its level.
        level: Level,
        /// The rule that it breaks.
        broken: Rule,
    },
    /// The pixel set or the sink breaks a rule.
    #[error("{reader:?} reads v{}: {broken}", value.0)]
    Reader {
        /// The reader.
        reader: Reader,
        /// The value read.
        value: Value,
        /// The rule that it breaks.
        broken: Rule,
    },
}

/// A rule of programs; displays as its violation.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum Rule {
    /// Operands precede their readers.
    #[error("it does not exist, or comes later")]
    Order,
    /// A value is available at its reader's level.
    #[error("it is not known at this level")]
    Known,
    /// An operation is at a level that has it.
    #[error("this level does not have it")]
    Place,
    /// An input, a channel, an accumulator, a total, a coordinate exists.
    #[error("the index does not exist")]
    Index,
    /// Operands have the right kind: number or truth value.
    #[error("numbers and truth values are mixed up")]
    Kind,
}

/// A reader of values other than an instruction; sums by position.
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

impl LoopNest {
    /// Validates the program; a derived one fails only by a bug.
    ///
    /// # Errors
    /// The first broken rule and its location.
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

    /// The kind of a value read at `level`.
    fn read(&self, value: Value, level: Level, kinds: &[Kind]) -> Result<Kind, Rule> {
        let kind = kinds.get(value.index()).ok_or(Rule::Order)?;
        let is_known = readable(self.instructions[value.index()].level, level);
        if is_known { Ok(*kind) } else { Err(Rule::Known) }
    }

    /// The kind of an operation's result; `kinds` are those of the values before it.
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

    /// Whether the opcode's index exists.
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

/// Whether a value of level `from` is available at level `at`.
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
