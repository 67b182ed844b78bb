//! Plain loop bodies, to be compared with the compiled ones, and their flops; the programs compute the same as
//! [`Model::objective`].
//!
//! *Plain* is the output of Maple's `codegen[optimize]` without `tryhard` (thesis, chapter 5): the derivatives as
//! differentiation gives them; common subexpressions of a body are computed once, and xⁿ by shared squares; nothing is
//! factored, expanded or taken apart, there is one sum per entry, and nothing is hoisted out of the loop.

use std::collections::HashMap;

use isophote_symbolic::{
    AccumulatorId, Bits, ChannelId, Comparison, CoordinateId, Expressions, Input, InputId, Instruction, Level,
    LoopNest, Method, Model, Node, NodeId, Op, Opcode, ParameterId, Part, PixelSet, Program, Sink, TotalId, Value,
};

/// The derivatives as differentiation writes them, without F, over every pixel of the window: the domain is ignored.
/// For counting and comparison only; [`Model::objective`] is the fast one. `None` where they exceed a size limit.
pub fn plain_program(model: &Model, subset: &[ParameterId], method: Method, part: Part) -> Option<Program> {
    let derivatives = model.derivatives(subset, method, part).ok()?;
    let names = model.names(derivatives.entries().iter().map(|(name, _)| name.clone()).collect());
    let mut body = Body::new(derivatives.expressions());
    let sink = body.sink(derivatives.entries());
    let nest = LoopNest {
        coordinates: names.coordinates.len() as u32,
        channels: names.channels.len() as u32,
        inputs: body.inputs,
        tables: derivatives.expressions().tables().clone(),
        instructions: body.instructions,
        pixel_set: PixelSet::default(),
        sink,
        names: names.into(),
        fused: false,
    };
    Program::arranged(nest).ok()
}

/// The sums of `program` over the pixel set of another program, for comparison: [`plain_program`] ignores the domain.
/// Inputs of the other program are appended. `None` for programs of different models.
pub fn over_pixels_of(program: &Program, other: &Program) -> Option<Program> {
    let (mut inputs, mut instructions) = (program.inputs().to_vec(), program.instructions().to_vec());
    let first = instructions.len() as u32;
    let moved = |v: Value| Value(v.0 + first);
    for instruction in other.instructions() {
        let op = match instruction.op.code {
            Opcode::Input(input) => {
                let wanted = other.inputs()[input.index()];
                let known = inputs.iter().position(|input| *input == wanted);
                let index = known.unwrap_or_else(|| {
                    inputs.push(wanted);
                    inputs.len() - 1
                });
                Opcode::Input(InputId(index as u32)).of([])
            }
            _ => instruction.op.renamed(moved),
        };
        instructions.push(Instruction { op, ..*instruction });
    }
    let set = other.pixel_set();
    let pixel_set = PixelSet {
        bounds: set.bounds.map(|(lo, hi)| (moved(lo), moved(hi))),
        mask: set.mask.map(moved),
        saturated: set.saturated.map(moved),
    };
    let nest = LoopNest { inputs, instructions, pixel_set, ..LoopNest::clone(program) };
    // Instructions that only the other program's sums read are dropped here.
    Program::arranged(nest).ok()
}

/// The flops of the loop body without hoisting.
pub fn plain_flops(program: &Program) -> u32 {
    let body = program.instructions().iter().filter(|i| i.level <= Level::Pixel);
    body.map(|i| i.op.flops()).sum::<u32>() + program.cost().accumulators
}

/// Emits nodes unchanged: sums and products from left to right.
struct Body<'g> {
    expressions: Expressions<'g>,
    instructions: Vec<Instruction>,
    inputs: Vec<Input>,
    known: HashMap<Op, Value>,
    values: HashMap<NodeId, Value>,
}

impl<'g> Body<'g> {
    fn new(expressions: Expressions<'g>) -> Body<'g> {
        let (known, values) = (HashMap::new(), HashMap::new());
        Body { expressions, instructions: Vec::new(), inputs: Vec::new(), known, values }
    }

    /// One sum for each entry that is not zero everywhere.
    fn sink(&mut self, entries: &[(String, NodeId)]) -> Sink {
        let roots: Vec<NodeId> = entries.iter().map(|(_, node)| *node).collect();
        for id in self.expressions.reachable(&roots) {
            let value = self.node(id);
            self.values.insert(id, value);
        }
        let (mut accumulators, mut totals, mut outputs) = (Vec::new(), Vec::new(), Vec::new());
        for (_, node) in entries {
            if matches!(self.expressions.node(*node), Node::Number(number) if number.get() == 0.0) {
                outputs.push(self.number(0.0));
                continue;
            }
            let id = accumulators.len() as u32;
            let value = self.values[node];
            accumulators.push(self.as_pixel(value));
            totals.push(self.emit(Opcode::RowTotal(AccumulatorId(id)).of([])));
            outputs.push(self.emit(Opcode::PassTotal(TotalId(id)).of([])));
        }
        Sink::Sums { accumulators, totals, outputs }
    }

    /// Wraps a loop-invariant value in a pixel-level select, so that a sum may read it.
    fn as_pixel(&mut self, value: Value) -> Value {
        if self.instructions[value.index()].level == Level::Pixel {
            return value;
        }
        let pixel = self.emit(Opcode::Channel(ChannelId(0)).of([]));
        let either = self.emit(Opcode::Compare(Comparison::Eq).of([pixel, pixel]));
        self.emit(Opcode::Select.of([either, value, value]))
    }

    fn emit(&mut self, op: Op) -> Value {
        let next = Value(self.instructions.len() as u32);
        let value = *self.known.entry(op).or_insert(next);
        if value == next {
            let level = op.level(|v| self.instructions[v.index()].level);
            self.instructions.push(Instruction { op, level, span: None });
        }
        value
    }

    fn number(&mut self, value: f64) -> Value {
        self.emit(Opcode::number(value).of([]))
    }

    fn node(&mut self, id: NodeId) -> Value {
        let expressions = self.expressions;
        let at = |n: &NodeId| self.values[n];
        let op = match expressions.node(id) {
            Node::Number(bits) => return self.number(bits.get()),
            Node::Input(input) => {
                let index = self.inputs.iter().position(|i| i == input).unwrap_or_else(|| {
                    self.inputs.push(*input);
                    self.inputs.len() - 1
                });
                return self.emit(Opcode::Input(InputId(index as u32)).of([]));
            }
            Node::Coordinate(CoordinateId(0)) => {
                let zero = self.number(0.0);
                return self.emit(Opcode::Offset.of([zero]));
            }
            Node::Coordinate(c) => return self.emit(Opcode::Outer(*c).of([])),
            Node::Channel(c) => return self.emit(Opcode::Channel(*c).of([])),
            Node::Sum(constant, terms) => return self.sum(constant.get(), terms),
            Node::Product(factors) => return self.product(factors),
            Node::Sqrt(a) => Opcode::Sqrt.of([at(a)]),
            Node::Abs(a) => Opcode::Abs.of([at(a)]),
            Node::Call1(f, a) => Opcode::Call1(*f).of([at(a)]),
            Node::Call2(f, a, b) => Opcode::Call2(*f).of([at(a), at(b)]),
            Node::Gather(lookup, a, b) => Opcode::Gather(*lookup).of([at(a), at(b)]),
            Node::Compare(c, a, b) => Opcode::Compare(*c).of([at(a), at(b)]),
            Node::And(a, b) => Opcode::And.of([at(a), at(b)]),
            Node::Or(a, b) => Opcode::Or.of([at(a), at(b)]),
            Node::Not(a) => Opcode::Not.of([at(a)]),
            Node::Select(c, a, b) => Opcode::Select.of([at(c), at(a), at(b)]),
        };
        self.emit(op)
    }

    /// Coefficients of ±1 are free; x plus a loop-invariant value is one operation, as in every program.
    fn sum(&mut self, constant: f64, terms: &[(NodeId, Bits)]) -> Value {
        let inner = |n: NodeId| matches!(self.expressions.node(n), Node::Coordinate(CoordinateId(0)));
        if let Some(x) = terms.iter().position(|(n, c)| inner(*n) && c.get() == 1.0) {
            let (early, late): (Vec<_>, Vec<_>) = terms
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != x)
                .map(|(_, term)| *term)
                .partition(|(n, _)| self.expressions.level(*n) < Level::Pixel);
            let early = self.terms(constant, &early, None);
            let offset = self.emit(Opcode::Offset.of([early]));
            return self.terms(0.0, &late, Some(offset));
        }
        self.terms(constant, terms, None)
    }

    fn terms(&mut self, constant: f64, terms: &[(NodeId, Bits)], start: Option<Value>) -> Value {
        let mut total = match constant {
            0.0 => start,
            _ => Some(self.number(constant)),
        };
        for (node, coefficient) in terms {
            let mut term = self.values[node];
            let coefficient = coefficient.get();
            if coefficient.abs() != 1.0 {
                let number = self.number(coefficient.abs());
                term = self.emit(Opcode::Mul.of([number, term]));
            }
            total = Some(match (total, coefficient < 0.0) {
                (None, false) => term,
                (None, true) => self.emit(Opcode::Neg.of([term])),
                (Some(sum), false) => self.emit(Opcode::Add.of([sum, term])),
                (Some(sum), true) => self.emit(Opcode::Sub.of([sum, term])),
            });
        }
        total.unwrap_or_else(|| self.number(0.0))
    }

    fn product(&mut self, factors: &[(NodeId, i32)]) -> Value {
        let (mut over, mut under) = (None, None);
        for (node, exponent) in factors {
            let power = self.power(self.values[node], exponent.unsigned_abs());
            let side = if *exponent > 0 { &mut over } else { &mut under };
            let before: Option<Value> = *side;
            *side = Some(before.map_or(power, |product| self.emit(Opcode::Mul.of([product, power]))));
        }
        let over = over.unwrap_or_else(|| self.number(1.0));
        under.map_or(over, |under| self.emit(Opcode::Div.of([over, under])))
    }

    /// By squaring; squares are shared with other powers of the same base.
    fn power(&mut self, base: Value, exponent: u32) -> Value {
        let (mut result, mut square) = (None, base);
        let mut rest = exponent;
        while rest > 0 {
            if rest & 1 == 1 {
                result = Some(result.map_or(square, |product| self.emit(Opcode::Mul.of([product, square]))));
            }
            rest >>= 1;
            if rest > 0 {
                square = self.emit(Opcode::Mul.of([square, square]));
            }
        }
        result.unwrap_or(base)
    }
}
