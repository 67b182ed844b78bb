//! Expressions in, a [`Program`] out: operations are chosen (Horner, shared powers, one reciprocal a denominator), placed at
//! the outermost level of the loop nest that knows their operands, and contracted to FMA where the lowering allows.

use rustc_hash::{FxHashMap, FxHashSet};

use crate::derive::domain;
use crate::derive::graph::{Graph, Node, NodeId};
use crate::derive::square::Shift;
use crate::language::diagnostic::Span;
use crate::language::model::Lowering;
use crate::program::steps::Step;
use crate::program::{
    AccumulatorId, Comparison, Cost, Input, InputId, Instruction, Level, Names, Op, PixelSet, Program, Sink, TotalId,
    Value,
};
use crate::proof::draft::Draft;

/// coefficient · Σ_rows (row · Σ_pixels pixel); an absent row factor is 1, an absent pixel value counts pixels.
#[derive(Clone, Debug)]
pub(crate) struct Term {
    /// Known per pass.
    pub coefficient: NodeId,
    pub row: Option<NodeId>,
    pub pixel: Option<NodeId>,
}

/// One number that a pass hands back: a sum of terms.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    pub name: String,
    pub terms: Vec<Term>,
}

#[derive(Clone, Debug)]
pub(crate) struct Sums {
    pub outputs: Vec<Output>,
    /// Totals over one offset of the column are made from those over another, once a row.
    pub shift: Option<Shift>,
}

impl Sums {
    /// The pixel values that are really summed.
    pub fn summed(&self, graph: &mut Graph) -> Vec<NodeId> {
        let Some(shift) = &self.shift else { return self.pixels() };
        let mut seen = FxHashSet::default();
        let parts: Vec<NodeId> = self.pixels().into_iter().flat_map(|p| shift.parts(graph, p)).flatten().collect();
        parts.into_iter().filter(|part| seen.insert(*part)).collect()
    }

    /// The distinct pixel values that are summed, in order of first use.
    pub fn pixels(&self) -> Vec<NodeId> {
        let mut seen = FxHashSet::default();
        self.outputs.iter().flat_map(|o| &o.terms).filter_map(|t| t.pixel).filter(|p| seen.insert(*p)).collect()
    }
}

/// The loop nest for sums over the pixels of `domain`.
pub(crate) fn sums(graph: &mut Graph, sums: &Sums, domain: Option<NodeId>, lowering: Lowering, names: Names) -> Draft {
    let mut builder = Builder::new(graph);
    let pixels = sums.summed(builder.graph);
    builder.wanted.extend(pixels.iter().copied());
    let mut set = PixelSet::default();
    if let Some(domain) = domain {
        let region = domain::region(builder.graph, domain);
        set.bounds = region.bounds.map(|(lo, hi)| (builder.lower(lo), builder.lower(hi)));
        set.mask = region.mask.map(|m| builder.lower(m));
    }
    if lowering.drop_saturated {
        set.saturated = builder.saturated(&pixels);
    }
    let accumulators = builder.pixel_values(&pixels);
    let numbers: FxHashMap<NodeId, AccumulatorId> =
        pixels.iter().enumerate().map(|(i, pixel)| (*pixel, AccumulatorId(i as u32))).collect();
    let accumulator = |node: NodeId| numbers[&node];

    let mut totals: Vec<Value> = Vec::new();
    let mut outputs = Vec::new();
    for output in &sums.outputs {
        let mut sum: Option<Value> = None;
        for term in &output.terms {
            let pass_total = match (term.row, term.pixel) {
                (None, None) => builder.emit(Op::PassCount, Level::PassEnd),
                (row, pixel) => {
                    let row_sum = builder.row_sum(pixel, sums.shift.as_ref(), &accumulator);
                    let total = match row {
                        Some(row) => {
                            let row = builder.lower(row);
                            builder.emit(Op::Mul(row, row_sum), Level::RowEnd)
                        }
                        None => row_sum,
                    };
                    let id = totals.iter().position(|t| *t == total).unwrap_or_else(|| {
                        totals.push(total);
                        totals.len() - 1
                    });
                    builder.emit(Op::PassTotal(TotalId(id as u32)), Level::PassEnd)
                }
            };
            let part = if builder.graph.value_of(term.coefficient) == Some(1.0) {
                pass_total
            } else {
                let coefficient = builder.lower(term.coefficient);
                builder.emit(Op::Mul(coefficient, pass_total), Level::PassEnd)
            };
            sum = Some(match sum {
                None => part,
                Some(so_far) => builder.emit(Op::Add(so_far, part), Level::PassEnd),
            });
        }
        outputs.push(sum.unwrap_or_else(|| builder.emit(Op::Const(0.0), Level::Pass)));
    }
    builder.finish(set, Sink::Sums { accumulators, totals, outputs }, lowering, names)
}

/// What the pixel loop that sums `pixels` costs: levels outside of it, and the domain, are not looked at.
pub(crate) fn pixel_cost(graph: &mut Graph, pixels: &[NodeId], lowering: Lowering) -> Cost {
    let mut builder = Builder::new(graph);
    builder.wanted.extend(pixels.iter().copied());
    let accumulators = builder.pixel_values(pixels);
    let sink = Sink::Sums { accumulators, totals: Vec::new(), outputs: Vec::new() };
    builder.finish(PixelSet::default(), sink, lowering, Names::default()).cost()
}

/// The loop nest that adds `value` to a plane.
pub(crate) fn plane(graph: &mut Graph, value: NodeId, lowering: Lowering, names: Names) -> Draft {
    let mut builder = Builder::new(graph);
    let value = builder.pixel_value(value);
    builder.finish(PixelSet::default(), Sink::Plane(value), lowering, names)
}

pub(crate) fn degree(graph: &Graph, node: NodeId) -> i32 {
    match graph.node(node) {
        Node::Product(factors) => factors.iter().map(|(_, e)| e.abs()).sum(),
        _ => 1,
    }
}

pub(crate) struct Builder<'g> {
    pub graph: &'g mut Graph,
    pub instructions: Vec<Instruction>,
    inputs: Vec<Input>,
    known: FxHashMap<(OpKey, Level), Value>,
    pub values: FxHashMap<NodeId, Value>,
    /// Products that are needed anyway: others are built upon them.
    pub wanted: FxHashSet<NodeId>,
    span: Option<Span>,
}

/// An operation that can be hashed.
type OpKey = (std::mem::Discriminant<Op>, u64, [u32; 3]);

fn key(op: &Op) -> OpKey {
    let mut list = [u32::MAX; 3];
    op.operands().zip(&mut list).for_each(|(v, slot)| *slot = v.0);
    let extra = match *op {
        Op::Const(value) => value.to_bits(),
        Op::Input(i) => u64::from(i.0),
        Op::Outer(c) => u64::from(c.0),
        Op::Channel(c) => u64::from(c.0),
        Op::Compare(c, ..) => c as u64,
        Op::Call1(f, _) => f as u64,
        Op::Call2(f, ..) => f as u64,
        Op::RowTotal(a) => u64::from(a.0),
        Op::PassTotal(t) => u64::from(t.0),
        _ => 0,
    };
    (std::mem::discriminant(op), extra, list)
}

impl<'g> Builder<'g> {
    fn new(graph: &'g mut Graph) -> Builder<'g> {
        Builder {
            graph,
            instructions: Vec::new(),
            inputs: Vec::new(),
            known: FxHashMap::default(),
            values: FxHashMap::default(),
            wanted: FxHashSet::default(),
            span: None,
        }
    }

    fn emit(&mut self, op: Op, level: Level) -> Value {
        let key = (key(&op), level);
        if let Some(value) = self.known.get(&key) {
            return *value;
        }
        let value = Value(self.instructions.len() as u32);
        self.instructions.push(Instruction { op, level, span: self.span });
        self.known.insert(key, value);
        value
    }

    /// At the level that its operands know.
    fn emit_at_operands(&mut self, op: Op) -> Value {
        let level = op.operands().map(|v| self.instructions[v.index()].level).max().unwrap_or(Level::Pass);
        self.emit(op, level)
    }

    pub fn input(&mut self, input: Input) -> Value {
        let at = self.inputs.iter().position(|i| *i == input).unwrap_or_else(|| {
            self.inputs.push(input);
            self.inputs.len() - 1
        });
        self.emit(Op::Input(InputId(at as u32)), Level::Pass)
    }

    /// The row's total of a pixel value: of what is summed, or made from such totals by the shift.
    fn row_sum(
        &mut self,
        pixel: Option<NodeId>,
        shift: Option<&Shift>,
        accumulator: &dyn Fn(NodeId) -> AccumulatorId,
    ) -> Value {
        let total = |builder: &mut Self, part: Option<NodeId>| match part {
            Some(part) => builder.emit(Op::RowTotal(accumulator(part)), Level::RowEnd),
            None => builder.emit(Op::RowCount, Level::RowEnd),
        };
        let (Some(pixel), Some(shift)) = (pixel, shift) else { return total(self, pixel) };
        // Σ_j C(k, j) e^(k−j) U_j by Horner's rule.
        let parts = shift.parts(self.graph, pixel);
        let power = parts.len() - 1;
        let (mut sum, mut binomial) = (total(self, parts[0]), 1.0);
        for (j, part) in parts.into_iter().enumerate().skip(1) {
            let distance = self.lower(shift.distance);
            binomial *= (power + 1 - j) as f64 / j as f64;
            let mut value = total(self, part);
            if binomial != 1.0 {
                let number = self.emit(Op::Const(binomial), Level::Pass);
                value = self.emit(Op::Mul(number, value), Level::RowEnd);
            }
            let lower = self.emit(Op::Mul(distance, sum), Level::RowEnd);
            sum = self.emit(Op::Add(lower, value), Level::RowEnd);
        }
        sum
    }

    /// The node as a pixel value: one known earlier is chosen by a condition that always holds, so that a sink may read it.
    fn pixel_value(&mut self, node: NodeId) -> Value {
        let value = self.lower(node);
        if self.instructions[value.index()].level == Level::Pixel {
            return value;
        }
        let zero = self.emit(Op::Const(0.0), Level::Pass);
        let x = self.emit(Op::Offset(zero), Level::Pixel);
        let always = self.emit(Op::Compare(Comparison::Eq, x, x), Level::Pixel);
        self.emit(Op::Select(always, value, value), Level::Pixel)
    }

    /// The pixel values of the accumulators: small monomials first, so that larger ones find them.
    fn pixel_values(&mut self, pixels: &[NodeId]) -> Vec<Value> {
        let mut order: Vec<usize> = (0..pixels.len()).collect();
        order.sort_by_key(|i| degree(self.graph, pixels[*i]));
        let mut accumulators = vec![Value(0); pixels.len()];
        for i in order {
            accumulators[i] = self.pixel_value(pixels[i]);
        }
        accumulators
    }

    /// Where any channel that the pixel values read is at or above its limit.
    fn saturated(&mut self, pixels: &[NodeId]) -> Option<Value> {
        let mut found: Option<Value> = None;
        for id in self.graph.reachable(pixels) {
            let Node::Channel(channel) = *self.graph.node(id) else { continue };
            let limit = self.input(Input::Saturation(channel));
            let pixel = self.emit(Op::Channel(channel), Level::Pixel);
            let at_limit = self.emit(Op::Compare(Comparison::Le, limit, pixel), Level::Pixel);
            found = Some(match found {
                None => at_limit,
                Some(before) => self.emit(Op::Or(before, at_limit), Level::Pixel),
            });
        }
        found
    }

    /// The value of a node; operands are visited by worklist, operands first.
    fn lower(&mut self, root: NodeId) -> Value {
        let mut stack: Vec<(NodeId, Option<Step>)> = vec![(root, None)];
        while let Some((node, step)) = stack.pop() {
            if self.values.contains_key(&node) {
                continue;
            }
            match step {
                None => {
                    let step = self.step(node);
                    let operands = step.operands();
                    stack.push((node, Some(step)));
                    stack.extend(operands.into_iter().rev().map(|n| (n, None)));
                }
                Some(step) => {
                    self.span = self.graph.span(node);
                    let value = self.emit_step(&step);
                    self.values.insert(node, value);
                }
            }
        }
        self.values[&root]
    }

    fn emit_step(&mut self, step: &Step) -> Value {
        let at = |n: &NodeId| self.values[n];
        let op = match step {
            Step::Leaf(op) => *op,
            Step::Offset(a) => {
                let op = Op::Offset(at(a));
                return self.emit(op, Level::Pixel);
            }
            Step::Unary(make, a) => make(at(a)),
            Step::Binary(make, a, b) => make(at(a), at(b)),
            Step::MulAdd(a, b, c) => {
                let (product, c) = (Op::Mul(at(a), at(b)), at(c));
                let product = self.emit_at_operands(product);
                Op::Add(product, c)
            }
            Step::Call1(f, a) => Op::Call1(*f, at(a)),
            Step::Call2(f, a, b) => Op::Call2(*f, at(a), at(b)),
            Step::Compare(c, a, b) => Op::Compare(*c, at(a), at(b)),
            Step::Select(c, a, b) => Op::Select(at(c), at(a), at(b)),
        };
        match op {
            Op::Outer(_) => self.emit(op, Level::Row),
            Op::Channel(_) => self.emit(op, Level::Pixel),
            _ => self.emit_at_operands(op),
        }
    }

    fn finish(self, set: PixelSet, sink: Sink, lowering: Lowering, names: Names) -> Draft {
        let mut program = Program {
            coordinates: names.coordinates.len() as u32,
            channels: names.channels.len() as u32,
            inputs: self.inputs,
            instructions: self.instructions,
            pixel_set: set,
            sink,
            names,
            fused: lowering.fma,
        };
        crate::program::peephole::improve(&mut program, lowering.fma);
        Draft::new(program)
    }
}
