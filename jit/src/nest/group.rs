//! The pixel level: one group of lanes.

use isophote_symbolic::{Level, Opcode, PixelSet, Program, Sink, Value};
use smallvec::SmallVec;

use super::functions::Evaluation;
use super::narrow::NarrowPlaces;
use super::order;
use super::pixels::begin;
use super::places::{Homes, element};
use crate::options::{KernelOptions, VectorWidth};
use crate::vector::{
    Act, Block, Condition, Element, Id, Integer, Label, MemoryPlace, Operation, Resident, VectorCode, comparison,
};

/// State shared by all groups of a kernel.
pub(super) struct PixelLoop<'p> {
    pub program: &'p Program,
    pub options: &'p KernelOptions,
    /// The live pixel instructions, those of the pixel set first.
    pub order: Vec<Value>,
    pub evaluation: Evaluation,
    /// For each accumulator: the factors of a fused multiply-add.
    pub contractions: Vec<Option<(Value, Value)>>,
    /// Whether a value is such a product, which is not computed separately; by value.
    pub is_contracted: Vec<bool>,
}

/// The meaning of lanes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum LaneUse {
    /// Consecutive pixels of a row.
    Along,
    /// Rows of a narrow window, each with a pixel, or at 512 bits with two.
    Across,
}

/// Which lanes of a group take part.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Fullness {
    /// All; if the pixel set excludes one, the code at `otherwise` takes over.
    Full { otherwise: Label },
    /// Those of the row that the pixel set does not exclude.
    Partial,
}

impl<'p> PixelLoop<'p> {
    pub fn new(program: &'p Program, options: &'p KernelOptions) -> PixelLoop<'p> {
        let order = order::order(program);
        let evaluation = Evaluation::new(program, &order, options.precision);
        let contractions = program.contractions();
        let mut is_contracted = vec![false; program.instructions().len()];
        if let Sink::Sums { accumulators, .. } = program.sink() {
            let products = accumulators.iter().zip(&contractions).filter(|(_, factors)| factors.is_some());
            products.for_each(|(v, _)| is_contracted[v.index()] = true);
        }
        PixelLoop { program, options, order, evaluation, contractions, is_contracted }
    }

    pub fn lanes(&self) -> usize {
        self.options.lanes().count()
    }

    /// Whether full groups have code of their own. At 512 bits it costs nothing to mask lanes of a sum, and with a mask per pixel
    /// every group that turns out partial would evaluate it twice.
    pub fn has_full_groups(&self) -> bool {
        self.options.width != VectorWidth::Bits512 || self.program.pixel_set().mask.is_none()
    }

    /// The number of leading values that the pixel set depends on.
    pub fn set_values(&self) -> usize {
        let PixelSet { mask, saturated, .. } = *self.program.pixel_set();
        let place = |root: Value| self.order.iter().position(|value| *value == root);
        mask.into_iter().chain(saturated).filter_map(place).max().map_or(0, |last| last + 1)
    }

    /// Writes a group, and the step to the next.
    pub fn write(&self, form: LaneUse, group: Fullness, places: &Homes, code: &mut VectorCode) {
        let after = code.new_label();
        let block = Block::new(&mut code.constants, self.options.width);
        let narrow = places.narrow.as_ref().filter(|_| form == LaneUse::Across);
        let none = vec![None; self.program.instructions().len()];
        let mut writer = GroupWriter {
            pixels: self,
            places,
            narrow,
            block,
            element: element(self.options.precision),
            group,
            live: None,
            surplus: None,
            known: none.clone(),
            masked: [none.clone(), none],
            after,
        };
        writer.run();
        let parts = writer.block.into_parts();
        code.append(parts, places.reserved);
        if group == Fullness::Partial && self.set_values() > 0 {
            code.write(|i| i.label(after));
        }
        // A partial group is the row's last, unless only the pixel set made it partial. Columns advance together.
        if form == LaneUse::Along && (group != Fullness::Partial || order::is_masked(self.program)) {
            let running: Vec<_> = places.columns.iter().map(|column| (Some(column.value), column.running)).collect();
            self.advance(&running, self.lanes(), places, code);
        }
    }

    /// Advances the variables that run along rows by `pixels`.
    pub fn advance(&self, running: &[(Option<Value>, Resident)], pixels: usize, places: &Homes, code: &mut VectorCode) {
        let mut block = Block::new(&mut code.constants, self.options.width);
        let element = element(self.options.precision);
        let step = block.number(element, pixels as f64);
        for (value, running) in running {
            block.set_source(*value);
            let variable = block.variable(*running);
            block.sum(variable, element, SmallVec::from_slice(&[step]), None);
        }
        let parts = block.into_parts();
        code.append(parts, places.reserved);
    }
}

/// Writes one group.
struct GroupWriter<'w, 'p, 'a> {
    pixels: &'w PixelLoop<'p>,
    places: &'w Homes,
    /// Set if lanes stand for rows.
    narrow: Option<&'w NarrowPlaces>,
    block: Block<'a>,
    element: Element,
    group: Fullness,
    /// Partial groups: truth values of the lanes that belong to it.
    live: Option<Id>,
    /// Partial groups along a row: the pixels by which it starts left of its first live one.
    surplus: Option<Id>,
    /// The values that pixel instructions have read or computed.
    known: Vec<Option<Id>>,
    /// The values with 0, and with −0, in the lanes that take no part.
    masked: [Vec<Option<Id>>; 2],
    /// The end of the group.
    after: Label,
}

impl GroupWriter<'_, '_, '_> {
    /// Writes the pixel set, then every value, summed as soon as it is computed.
    fn run(&mut self) {
        match (self.group, self.narrow) {
            (Fullness::Partial, None) => self.open(),
            (Fullness::Partial, Some(narrow)) => self.live = Some(narrow.live(&mut self.block)),
            (Fullness::Full { .. }, _) => {}
        }
        let first = self.pixels.set_values();
        self.set(first);
        let used = self.decide();
        if let Some(used) = used.filter(|_| first > 0) {
            self.skip_unless(used);
        }
        self.rest(first, used);
        self.block.set_source(None);
    }

    /// Writes the first `count` values, which decide on the pixel set.
    fn set(&mut self, count: usize) {
        let pixels = self.pixels;
        for value in &pixels.order[..count] {
            self.make(*value);
        }
    }

    fn make(&mut self, value: Value) {
        self.block.set_source(Some(value));
        let result = self.value(value);
        self.known[value.index()] = Some(result);
    }

    /// Skips the rest of the group if no lane takes part.
    fn skip_unless(&mut self, used: Id) {
        self.block.act(Act::Truths { operand: used, element: self.element });
        let after = self.after;
        self.block.integers(|i| {
            i.jump_if(Integer::A, Condition::Equal, 0, after);
        });
    }

    /// Writes the values after the pixel set, and all sums.
    fn rest(&mut self, set: usize, used: Option<Id>) {
        let pixels = self.pixels;
        self.sink(None, used);
        for (at, value) in pixels.order.iter().enumerate() {
            // A value that only its sum reads is not computed separately.
            if at >= set && !pixels.is_contracted[value.index()] {
                self.make(*value);
            }
            self.sink(Some(*value), used);
        }
    }

    /// Computes which lanes belong to a partial group, which starts far enough left to end inside the window.
    fn open(&mut self) {
        use Integer::A;
        let Homes { counters, ends, .. } = *self.places;
        let element = self.element;
        self.block.integers(begin);
        let [before, until] = if order::is_masked(self.pixels.program) {
            self.block.integers(|i| {
                i.mov(A, Integer::Pixel);
                i.minus(A, Integer::Begin);
                i.store_low(counters.before, A);
                i.mov(A, ends.indexed(Integer::Row, 8));
                i.minus(A, Integer::Begin);
                i.plus(A, 1);
                i.store_low(counters.until, A);
            });
            [counters.before, counters.until].map(|place| {
                let integer = self.block.fleeting(place.spread());
                self.block.compute(Operation::FromIntegers, element, [integer])
            })
        } else {
            let lanes = [self.places.before, self.places.until];
            lanes.map(|array| self.block.kept(array.indexed(Integer::Row, element.bytes() as u32).spread()))
        };
        let steps = self.block.constant_lanes(element, |lane| lane as f64);
        let early = self.block.compute(Operation::Compare(comparison::LESS), element, [steps, before]);
        let reached = self.block.compute(Operation::Compare(comparison::LESS), element, [steps, until]);
        self.live = Some(self.block.compute(Operation::AndNot, element, [early, reached]));
        self.surplus = Some(before);
    }

    /// The register with the start of the group.
    fn begins_at(&self) -> Integer {
        match self.group {
            Fullness::Full { .. } => Integer::Pixel,
            Fullness::Partial => Integer::Begin,
        }
    }

    /// An operand of a pixel instruction.
    fn operand(&mut self, value: Value) -> Id {
        if let Some(known) = self.known[value.index()] {
            return known;
        }
        let constant = self.pixels.program.instruction(value).op.constant();
        let shown = match self.narrow {
            Some(narrow) => narrow.shown[value.index()],
            None => self.places.shown[value.index()].map(|shown| shown.held),
        };
        let id = match (constant, shown) {
            (Some(number), _) => self.block.number(self.element, number),
            (None, Some(held)) => self.block.held(held),
            (None, None) => unreachable!("the check refuses instructions before their operands"),
        };
        self.known[value.index()] = Some(id);
        id
    }

    fn operands(&mut self, values: &[Value]) -> SmallVec<[Id; 2]> {
        values.iter().map(|value| self.operand(*value)).collect()
    }

    fn value(&mut self, value: Value) -> Id {
        let (pixels, element) = (self.pixels, self.element);
        let op = pixels.program.instruction(value).op;
        match op.code {
            Opcode::Channel(channel) => {
                if let Some(narrow) = self.narrow {
                    return narrow.pixels(&mut self.block, channel.index());
                }
                let begin = self.begins_at();
                return self.block.channel(channel.index(), self.places, pixels.options, begin);
            }
            Opcode::Offset => return self.offset(value),
            _ => {}
        }
        let operands: SmallVec<[Id; 3]> = op.operands().map(|v| self.operand(v)).collect();
        let result = self.block.arithmetic(element, op, &operands, pixels.program.tables());
        match result.or_else(|| self.block.function(pixels.evaluation, op.code, &operands)) {
            Some(result) => result,
            None => unreachable!("the check refuses scalar instructions at the pixel level"),
        }
    }

    fn offset(&mut self, value: Value) -> Id {
        let Some(column) = self.places.columns.iter().find(|column| column.value == value) else {
            unreachable!("every offset has a place")
        };
        if let Some(narrow) = self.narrow {
            return narrow.offset(&mut self.block, column);
        }
        let mut here = self.block.variable(column.running);
        if let Some(surplus) = self.surplus {
            here = self.block.compute(Operation::Sub, self.element, [here, surplus]);
        }
        let fraction = self.block.held(column.fraction.held);
        self.block.compute(Operation::Add, self.element, [here, fraction])
    }

    /// The lanes that take part; `None`: all.
    fn decide(&mut self) -> Option<Id> {
        let PixelSet { mask, saturated, .. } = *self.pixels.program.pixel_set();
        self.block.set_source(mask.or(saturated));
        let mask = mask.map(|mask| self.operand(mask));
        let over = saturated.map(|saturated| self.operand(saturated));
        let element = self.element;
        let (Some(live), Fullness::Partial) = (self.live, self.group) else {
            self.leave(mask, over);
            self.block.set_source(None);
            return None;
        };
        let in_set = mask.map_or(live, |mask| self.block.compute(Operation::And, element, [live, mask]));
        let used = over.map_or(in_set, |over| self.block.compute(Operation::AndNot, element, [over, in_set]));
        let counters = self.places.counters;
        if mask.is_some() || over.is_some() {
            let unused = self.block.compute(Operation::AndNot, element, [used, live]);
            match self.narrow {
                Some(narrow) => narrow.leave_out(&mut self.block, unused),
                None => self.count(unused, counters.unused),
            }
        }
        if let Some(over) = over {
            let dropped = self.block.compute(Operation::And, element, [in_set, over]);
            self.count(dropped, counters.saturated);
        }
        self.block.set_source(None);
        Some(used)
    }

    /// Adds the number of true lanes to a counter.
    fn count(&mut self, truth: Id, counter: MemoryPlace) {
        self.block.act(Act::Truths { operand: truth, element: self.element });
        self.block.integers(|i| {
            i.count_ones(Integer::A);
            i.plus_at(counter, Integer::A);
        });
    }

    /// Continues only if every lane is in the set and none is saturated.
    fn leave(&mut self, mask: Option<Id>, over: Option<Id>) {
        let Fullness::Full { otherwise } = self.group else { return };
        let all = (1 << self.pixels.lanes()) - 1;
        let (truth, expected) = match (mask, over) {
            (Some(mask), Some(over)) => (self.block.compute(Operation::AndNot, self.element, [over, mask]), all),
            (Some(mask), None) => (mask, all),
            (None, Some(over)) => (over, 0),
            (None, None) => return,
        };
        self.block.act(Act::Truths { operand: truth, element: self.element });
        self.block.integers(|i| {
            i.jump_if(Integer::A, Condition::Different, expected, otherwise);
        });
    }

    /// Adds `value` to its sums or writes it to the plane; `None` stands for every pass or row value.
    fn sink(&mut self, value: Option<Value>, used: Option<Id>) {
        let program = self.pixels.program;
        let meant = |v: &Value| match value {
            Some(value) => *v == value,
            None => program.instruction(*v).level != Level::Pixel,
        };
        match program.sink() {
            Sink::Sums { accumulators, .. } => {
                for (i, v) in accumulators.iter().enumerate().filter(|(_, v)| meant(v)) {
                    self.block.set_source(Some(*v));
                    let terms: SmallVec<[Value; 2]> = match self.pixels.contractions[i] {
                        Some((a, b)) => SmallVec::from_slice(&[a, b]),
                        None => SmallVec::from_slice(&[*v]),
                    };
                    let (terms, used) = match used {
                        Some(used) if self.block.width == VectorWidth::Bits256 => (self.masked(&terms, used), None),
                        used => (self.operands(&terms), used),
                    };
                    let accumulator = match self.narrow {
                        Some(narrow) => narrow.accumulator(self.places, i),
                        None => self.places.accumulators[i],
                    };
                    let variable = self.block.variable(accumulator);
                    self.block.sum(variable, self.element, terms, used);
                }
            }
            Sink::Plane(v) if meant(v) => {
                self.block.set_source(Some(*v));
                let value = self.operand(*v);
                let begin = self.begins_at();
                self.block.write(value, used, self.places, self.element, begin);
            }
            Sink::Plane(_) => {}
        }
    }

    /// A term with 0 in the lanes that take no part. Of a product, one factor has 0 there and the other −0, so that −0 is added,
    /// which changes no number, not even −0; a sum of terms starts with 0 and is never −0.
    fn masked(&mut self, terms: &[Value], used: Id) -> SmallVec<[Id; 2]> {
        let has = |sign: usize, value: Value| self.masked[sign][value.index()].is_some();
        let signed = match *terms {
            [a, b] if has(0, b) || has(1, a) => SmallVec::from_slice(&[(b, 0), (a, 1)]),
            _ => terms.iter().copied().zip(0..).collect::<SmallVec<[(Value, usize); 2]>>(),
        };
        signed.into_iter().map(|(value, sign)| self.masked_value(value, sign, used)).collect()
    }

    fn masked_value(&mut self, value: Value, sign: usize, used: Id) -> Id {
        if let Some(known) = self.masked[sign][value.index()] {
            return known;
        }
        let operand = self.operand(value);
        let id = match sign {
            0 => self.block.compute(Operation::And, self.element, [used, operand]),
            _ => {
                let zero = self.block.sign(self.element);
                self.block.compute(Operation::Select, self.element, [used, operand, zero])
            }
        };
        *self.masked[sign][value.index()].insert(id)
    }
}
