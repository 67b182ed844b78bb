//! The levels outside the pixel loop: vectors of f64, with one value in all lanes for a pass and a row per lane for rows.

use std::mem::offset_of;

use isophote_symbolic::{Level, Opcode, Precision, Program, Sink, Value};
use smallvec::SmallVec;

use super::functions::Evaluation;
use super::order;
use super::places::{Homes, element, parts};
use super::sums::of_vector;
use crate::abi::Args;
use crate::options::{KernelOptions, VectorWidth};
use crate::vector::{
    Act, Anchor, Block, Element, Id, Integer, Integers, MemoryPlace, Operation, Portion, VectorCode, arg, comparison,
};

const DOUBLE: Element = Element::Double;

/// Writes every instruction of a level other than the pixel's, and its end.
pub(super) fn write(level: Level, program: &Program, options: &KernelOptions, places: &Homes, code: &mut VectorCode) {
    let parts = parts_of(level, options);
    let mut writer = Writer::new(level, (program, options, places), code);
    let acts: Vec<_> = (0..parts).map(|part| writer.part(level, part)).collect();
    let (_, givens) = writer.block.into_parts();
    let acts = match level {
        // Operations of one part depend on each other, and no part reads what another writes.
        Level::Row => side_by_side(acts),
        _ => acts.into_iter().flatten().collect(),
    };
    code.append((acts, givens), 0);
}

/// Writes the group bounds for rows of a wide window, where [`Level::Row`] wrote those of a narrow one.
pub(super) fn write_groups(program: &Program, options: &KernelOptions, places: &Homes, code: &mut VectorCode) {
    let mut writer = Writer::new(Level::Row, (program, options, places), code);
    for part in 0..parts(options.width) {
        writer.part = part;
        writer.groups_of_rows();
    }
    let parts = writer.block.into_parts();
    code.append(parts, 0);
}

/// Interleaves lists of equal length.
fn side_by_side<T>(lists: Vec<Vec<T>>) -> Vec<T> {
    let mut lists: Vec<_> = lists.into_iter().map(Vec::into_iter).collect();
    let mut all = Vec::new();
    while lists.iter().any(|list| list.len() > 0) {
        all.extend(lists.iter_mut().filter_map(Iterator::next));
    }
    all
}

/// Vectors of f64 per value of a level.
fn parts_of(level: Level, options: &KernelOptions) -> usize {
    if matches!(level, Level::Row | Level::RowEnd) { parts(options.width) } else { 1 }
}

struct Writer<'w, 'a> {
    program: &'w Program,
    options: &'w KernelOptions,
    places: &'w Homes,
    evaluation: Evaluation,
    block: Block<'a>,
    /// Index of the current vector of the rows.
    part: usize,
    /// The rows' numbers, once computed.
    number: Option<Id>,
    known: Vec<Option<Id>>,
}

impl<'w, 'a> Writer<'w, 'a> {
    fn new(
        level: Level,
        (program, options, places): (&'w Program, &'w KernelOptions, &'w Homes),
        code: &'a mut VectorCode,
    ) -> Writer<'w, 'a> {
        let block = Block::new(&mut code.constants, options.width);
        let known = vec![None; program.instructions().len()];
        let evaluation = Evaluation::outer(program, level, parts_of(level, options), options.width);
        Writer { program, options, places, evaluation, block, part: 0, number: None, known }
    }

    /// The acts of a level; for rows, those of one vector of them.
    fn part(&mut self, level: Level, part: usize) -> Vec<(Act, Option<Value>)> {
        let program = self.program;
        (self.part, self.number) = (part, None);
        // Parts are interleaved: neither may read values of the other.
        self.block.cells.clear();
        let of_rows = |value: usize| program.instructions()[value].level != Level::Pass;
        self.known.iter_mut().enumerate().filter(|(value, _)| of_rows(*value)).for_each(|(_, known)| *known = None);
        if level == Level::Pass {
            self.window();
        }
        for (i, instruction) in program.instructions().iter().enumerate().filter(|(_, x)| x.level == level) {
            self.block.set_source(Some(Value(i as u32)));
            self.instruction(Value(i as u32), instruction.op.code);
        }
        self.block.set_source(None);
        match level {
            Level::Row => {
                let first = self.range();
                self.columns(first);
            }
            Level::RowEnd => self.totals(),
            Level::PassEnd => self.outputs(),
            Level::Pass | Level::Pixel => {}
        }
        std::mem::take(&mut self.block.acts)
    }

    fn operand(&mut self, value: Value) -> Id {
        if let Some(known) = self.known[value.index()] {
            return known;
        }
        let id = match (self.program.instruction(value).op.constant(), self.places.doubles[value.index()]) {
            (Some(number), _) => self.block.number(DOUBLE, number),
            (None, Some(memory)) => {
                let memory = self.of_value(value, memory);
                self.block.kept(memory)
            }
            (None, None) => unreachable!("every value that crosses levels has a place"),
        };
        self.known[value.index()] = Some(id);
        id
    }

    fn lanes(&self) -> usize {
        self.options.width.bytes() / DOUBLE.bytes()
    }

    /// The current vector of the prepared rows, in an array with `bytes` bytes per row.
    fn of_rows(&self, array: MemoryPlace, bytes: usize) -> MemoryPlace {
        let array = self.of_all(array, bytes);
        if self.places.blocks == 1 { array } else { array.indexed(Integer::Block, bytes as u32) }
    }

    /// Like [`Writer::of_rows`], in an array that all blocks share.
    fn of_all(&self, array: MemoryPlace, bytes: usize) -> MemoryPlace {
        array.plus(self.part * self.lanes() * bytes)
    }

    /// Like [`Writer::of_rows`], in an f64 vector; only row values have more than one.
    fn of_value(&self, value: Value, memory: MemoryPlace) -> MemoryPlace {
        match self.program.instruction(value).level {
            Level::Row => self.of_rows(memory, DOUBLE.bytes()),
            _ => memory,
        }
    }

    /// 32-bit integers in memory, one per lane or one for all.
    fn integers(&mut self, memory: MemoryPlace) -> Id {
        let integers = self.block.fleeting(memory);
        self.block.compute(Operation::FromIntegers, DOUBLE, [integers])
    }

    fn instruction(&mut self, value: Value, code: Opcode) {
        let op = self.program.instruction(value).op;
        let result = match code {
            Opcode::Input(input) => {
                self.block.integers(|i| i.mov(Integer::D, arg(offset_of!(Args, inputs))));
                let number = MemoryPlace::new(Anchor::At(Integer::D), (size_of::<f64>() * input.index()) as i32);
                let number = self.block.fleeting(number.spread());
                self.block.compute(Operation::Spread, DOUBLE, [number])
            }
            Opcode::Outer(_) if self.program.coordinates() <= 2 => {
                let y = self.block.kept(self.places.window.y);
                let number = self.number();
                self.block.compute(Operation::Add, DOUBLE, [y, number])
            }
            Opcode::Outer(coordinate) => {
                let coordinates = self.places.coordinates[coordinate.index() - 1];
                self.integers(self.of_rows(coordinates, size_of::<i32>()))
            }
            Opcode::RowTotal(accumulator) => {
                let sums = self.of_rows(self.places.row_sums[accumulator.index()], DOUBLE.bytes());
                self.block.kept(sums)
            }
            Opcode::RowCount => self.counts(),
            Opcode::PassTotal(total) if self.options.width == VectorWidth::Bits128 => {
                let rows = self.block.kept(self.places.totals[total.index()]);
                of_vector(&mut self.block, Precision::F64, rows)
            }
            Opcode::PassTotal(total) => self.block.kept(self.places.pass_totals[total.index()].spread()),
            Opcode::PassCount => {
                let pixels = self.block.kept(self.places.counters.pixels.spread());
                self.as_double(pixels)
            }
            _ => {
                let operands: SmallVec<[Id; 3]> = op.operands().map(|v| self.operand(v)).collect();
                let result = self.block.arithmetic(DOUBLE, op, &operands, self.program.tables());
                match result.or_else(|| self.block.function(self.evaluation, code, &operands)) {
                    Some(result) => result,
                    None => unreachable!("the check refuses pixel instructions at this level"),
                }
            }
        };
        self.known[value.index()] = Some(result);
        if let Some(memory) = self.places.doubles[value.index()] {
            let memory = self.of_value(value, memory);
            self.block.store(DOUBLE, Portion::Whole, result, memory);
        }
        self.show(value, result);
    }

    /// Stores a value as the pixel loop reads it: rounded to the lane type, once.
    fn show(&mut self, value: Value, result: Id) {
        let Some(shown) = self.places.shown[value.index()] else { return };
        let is_truth = self.program.is_truth(value);
        match shown.array {
            Some((array, _)) if is_truth => {
                let array = self.of_rows(array, DOUBLE.bytes());
                self.block.store(DOUBLE, Portion::Whole, result, array);
            }
            Some((array, _)) => self.rounded(result, array),
            None => self.spread(result, is_truth, shown.held.memory),
        }
    }

    /// Stores the lanes in an array of the pixel loop's elements; twice if a vector of columns has two of each row.
    fn rounded(&mut self, lanes: Id, array: MemoryPlace) {
        let element = element(self.options.precision);
        let mut array = self.of_rows(array, element.bytes());
        if let Some((_, pitch)) = array.index.as_mut().filter(|_| self.options.width == VectorWidth::Bits512) {
            *pitch = 2 * element.bytes() as u32;
        }
        match self.options.precision {
            Precision::F32 => {
                let rounded = self.block.compute(Operation::Narrow, DOUBLE, [lanes]);
                self.block.store(Element::Single, Portion::Half, rounded, array);
                if self.places.narrow.is_some() && self.options.width == VectorWidth::Bits512 {
                    self.block.store(
                        Element::Single,
                        Portion::Half,
                        rounded,
                        array.plus(self.options.width.bytes() / 2),
                    );
                }
            }
            Precision::F64 => self.block.store(DOUBLE, Portion::Whole, lanes, array),
        }
    }

    /// Stores the first lane for all lanes of the pixel loop.
    fn spread(&mut self, lanes: Id, is_truth: bool, memory: MemoryPlace) {
        let element = element(self.options.precision);
        let rounds = element == Element::Single && !is_truth;
        let rounded = if rounds { self.block.compute(Operation::Narrow, DOUBLE, [lanes]) } else { lanes };
        if self.options.width == VectorWidth::Bits512 {
            let memory = MemoryPlace { is_spread: false, ..memory };
            return self.block.store(element, Portion::Least, rounded, memory);
        }
        let all = if rounds { self.block.compute(Operation::SpreadFirst, element, [rounded]) } else { rounded };
        self.block.store(element, Portion::Whole, all, memory);
    }

    /// Stores the values of the window that rows need.
    fn window(&mut self) {
        let field = |offset: usize| move |i: &mut Integers| i.mov(Integer::A, arg(offset));
        let window = self.places.window;
        self.spread_integer(field(offset_of!(Args, x)), window.first);
        let last = |i: &mut Integers| {
            i.mov(Integer::A, arg(offset_of!(Args, x)));
            i.plus(Integer::A, arg(offset_of!(Args, width)));
            i.minus(Integer::A, 1);
        };
        self.spread_integer(last, window.last);
        let rows = self.places.counters.rows;
        self.spread_integer(|i| i.mov(Integer::A, rows), window.rows);
        if self.program.coordinates() <= 2 {
            self.spread_integer(field(offset_of!(Args, y)), window.y);
        }
        if !order::is_masked(self.program) {
            self.spread_integer(|i| i.mov(Integer::A, Integer::Furthest), window.furthest);
        }
    }

    /// Broadcasts the number that `make` leaves in rax, and stores it.
    fn spread_integer(&mut self, make: impl FnOnce(&mut Integers), memory: MemoryPlace) {
        let place = self.places.counters.before;
        self.block.integers(|i| {
            make(i);
            i.store_low(place, Integer::A);
        });
        let number = self.integers(place.spread());
        self.block.store(DOUBLE, Portion::Whole, number, memory);
    }

    /// The rows' numbers in the window.
    fn number(&mut self) -> Id {
        if let Some(number) = self.number {
            return number;
        }
        let before = self.integers(self.places.counters.at.spread());
        let first = self.part * self.lanes();
        let lanes = self.block.constant_lanes(DOUBLE, |lane| (first + lane) as f64);
        let number = self.block.compute(Operation::Add, DOUBLE, [before, lanes]);
        *self.number.insert(number)
    }

    /// Converts an integer below 2⁵¹ to f64.
    fn as_double(&mut self, integer: Id) -> Id {
        let magic = self.block.number(DOUBLE, isophote_elementary::MAGIC);
        let shifted = self.block.compute(Operation::AddBits, DOUBLE, [integer, magic]);
        self.block.compute(Operation::Sub, DOUBLE, [shifted, magic])
    }

    /// Stores the first and the last pixel of each row in the frame (last before first if there is none) and returns the first
    /// as f64. Comparisons follow the interpreter's order, so that NaN and infinities give the same result.
    fn range(&mut self) -> Id {
        use Operation::{Add, AddBits, And, Compare, Or, Select, Sub, SubBits};
        let [first, last, rows] =
            [self.places.window.first, self.places.window.last, self.places.window.rows].map(|x| self.block.kept(x));
        let number = self.number();
        let bounds = self.program.pixel_set().bounds.map(|(lo, hi)| [lo, hi].map(|value| self.operand(value)));
        let b = &mut self.block;
        let at_most = Compare(comparison::AT_MOST);
        let less = Compare(comparison::LESS);
        let exists = b.compute(less, DOUBLE, [number, rows]);
        let (start, first_pixel, end, any) = match bounds {
            None => {
                let (zero, width) = (b.pattern(0), b.compute(Sub, DOUBLE, [last, first]));
                let [_, end] = b.nearest(width);
                (zero, zero, end, exists)
            }
            Some([lo, hi]) => {
                let ordered = b.compute(at_most, DOUBLE, [lo, hi]);
                let inside = b.compute(less, DOUBLE, [first, lo]);
                let lo = b.compute(Select, DOUBLE, [inside, lo, first]);
                let inside = b.compute(less, DOUBLE, [hi, last]);
                let hi = b.compute(Select, DOUBLE, [inside, hi, last]);
                let still = b.compute(at_most, DOUBLE, [lo, hi]);
                let any = b.compute(And, DOUBLE, [ordered, still]);
                let any = b.compute(And, DOUBLE, [any, exists]);

                // Where there are pixels, both are inside the window: distances below 2³¹. As an integer, true is −1.
                let distance = b.compute(Sub, DOUBLE, [lo, first]);
                let [near, integer] = b.nearest(distance);
                let short = b.compute(less, DOUBLE, [near, distance]);
                let start = b.compute(SubBits, DOUBLE, [integer, short]);
                let start = b.compute(And, DOUBLE, [start, any]);
                let one = b.number(DOUBLE, 1.0);
                let step = b.compute(And, DOUBLE, [short, one]);
                let first_pixel = b.compute(Add, DOUBLE, [near, step]);
                let first_pixel = b.compute(And, DOUBLE, [first_pixel, any]);

                let distance = b.compute(Sub, DOUBLE, [hi, first]);
                let [near, integer] = b.nearest(distance);
                let over = b.compute(less, DOUBLE, [distance, near]);
                let end = b.compute(AddBits, DOUBLE, [integer, over]);
                (start, first_pixel, end, any)
            }
        };
        let none = b.not(DOUBLE, any);
        let end = b.compute(Or, DOUBLE, [end, none]);
        let all = b.pattern(u64::MAX);
        let count = b.compute(SubBits, DOUBLE, [end, start]);
        let count = b.compute(SubBits, DOUBLE, [count, all]);
        let Homes { starts, ends, counts, taken, .. } = *self.places;
        for (numbers, place) in [(start, starts), (end, ends)] {
            let place = self.of_rows(place, DOUBLE.bytes());
            self.block.store(DOUBLE, Portion::Whole, numbers, place);
        }
        let length = self.as_double(count);
        if !order::is_masked(self.program) {
            let taken = self.of_all(taken, DOUBLE.bytes());
            let so_far = self.block.fleeting(taken);
            let so_far = self.block.compute(AddBits, DOUBLE, [count, so_far]);
            self.block.store(DOUBLE, Portion::Whole, so_far, taken);
            let place = self.of_rows(counts, DOUBLE.bytes());
            self.block.store(DOUBLE, Portion::Whole, length, place);
        }
        match &self.places.narrow {
            Some(narrow) => {
                let [starts, lengths] = [narrow.starts, narrow.lengths];
                self.rounded(first_pixel, starts);
                self.rounded(length, lengths);
            }
            None => self.groups(start, count, [first_pixel, length]),
        }
        first_pixel
    }

    /// Computes the group bounds that [`Writer::range`] omits if there is a loop across rows as well.
    fn groups_of_rows(&mut self) {
        let Homes { starts, ends, .. } = *self.places;
        let [start, end] = [starts, ends].map(|place| {
            let place = self.of_rows(place, DOUBLE.bytes());
            self.block.kept(place)
        });
        let all = self.block.pattern(u64::MAX);
        let count = self.block.compute(Operation::SubBits, DOUBLE, [end, start]);
        let count = self.block.compute(Operation::SubBits, DOUBLE, [count, all]);
        let both = [start, count].map(|integer| self.as_double(integer));
        self.groups(start, count, both);
    }

    /// Stores the first pixel beyond the full groups, and which lanes of the last group take part.
    fn groups(&mut self, start: Id, count: Id, [first_pixel, length]: [Id; 2]) {
        use Operation::{Add, AddBits, And, Compare, Select, Sub};
        let groups = self.block.pattern(!(self.options.lanes().count() as u64 - 1));
        let full = self.block.compute(And, DOUBLE, [count, groups]);
        let rest = self.block.compute(AddBits, DOUBLE, [start, full]);
        let Homes { rests, before, until, window, .. } = *self.places;
        let place = self.of_rows(rests, DOUBLE.bytes());
        self.block.store(DOUBLE, Portion::Whole, rest, place);
        if order::is_masked(self.program) {
            return;
        }
        let end = self.block.compute(Add, DOUBLE, [first_pixel, length]);
        let rest = self.as_double(rest);
        let furthest = self.block.kept(window.furthest);
        let is_early = self.block.compute(Compare(comparison::LESS), DOUBLE, [furthest, rest]);
        let begin = self.block.compute(Select, DOUBLE, [is_early, furthest, rest]);
        for (from, place) in [(rest, before), (end, until)] {
            let distance = self.block.compute(Sub, DOUBLE, [from, begin]);
            self.rounded(distance, place);
        }
    }

    /// Stores where the offsets of the rows start; `first` is their first pixel, from the window's first column.
    fn columns(&mut self, first: Id) {
        use Operation::{Add, Sub};
        let edge = self.block.kept(self.places.window.first);
        let x = self.block.compute(Add, DOUBLE, [first, edge]);
        for column in &self.places.columns {
            self.block.set_source(Some(column.value));
            let c = self.operand(column.term);
            let magic = self.block.number(DOUBLE, isophote_elementary::MAGIC);
            let n = self.block.compute(Sub, DOUBLE, [magic, c]);
            let n = self.block.compute(Sub, DOUBLE, [n, magic]);
            let distance = self.block.compute(Sub, DOUBLE, [x, n]);
            self.rounded(distance, column.first);
            let fraction = self.block.compute(Add, DOUBLE, [c, n]);
            if let Some((array, _)) = column.fraction.array {
                self.rounded(fraction, array);
            }
        }
    }

    /// The number of used pixels of each row, as f64.
    fn counts(&mut self) -> Id {
        let counts = self.places.counts;
        match order::is_masked(self.program) {
            true => self.integers(self.of_rows(counts, size_of::<i32>())),
            false => {
                let counts = self.of_rows(counts, DOUBLE.bytes());
                self.block.kept(counts)
            }
        }
    }

    /// Adds rows to the totals of their position in a block. A row without pixels adds 0, even if its values are NaN.
    fn totals(&mut self) {
        let Sink::Sums { totals, .. } = self.program.sink() else { return };
        let counts = self.counts();
        let zero = self.block.number(DOUBLE, 0.0);
        let used = self.block.compute(Operation::Compare(comparison::DIFFERENT), DOUBLE, [counts, zero]);
        for (value, place) in totals.iter().zip(&self.places.totals) {
            self.block.set_source(Some(*value));
            let place = self.of_all(*place, DOUBLE.bytes());
            let rows = self.operand(*value);
            let added = self.block.compute(Operation::And, DOUBLE, [used, rows]);
            let total = self.block.fleeting(place);
            let total = self.block.compute(Operation::Add, DOUBLE, [added, total]);
            self.block.store(DOUBLE, Portion::Whole, total, place);
        }
    }

    fn outputs(&mut self) {
        let Sink::Sums { outputs, .. } = self.program.sink() else { return };
        for (i, value) in outputs.iter().enumerate() {
            self.block.set_source(Some(*value));
            let output = self.operand(*value);
            self.block.integers(|i| i.mov(Integer::D, arg(offset_of!(Args, outputs))));
            let memory = MemoryPlace::new(Anchor::At(Integer::D), (size_of::<f64>() * i) as i32);
            self.block.store(DOUBLE, Portion::Least, output, memory);
        }
    }
}
