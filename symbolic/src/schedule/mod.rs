//! Lowers expressions to a [`LoopNest`]: chooses operations (Horner, shared powers, one reciprocal a denominator),
//! places them at the outermost level of the loop nest where their operands are known, and contracts to FMA where the
//! lowering allows.

pub(crate) mod domain;
pub(crate) mod steps;
pub(crate) mod sums;

use std::sync::Arc;

use rustc_hash::{FxHashMap, FxHashSet};

use crate::graph::{Graph, Node, NodeId};
use crate::program::{
    AccumulatorId, Comparison, Input, InputId, Instruction, Level, LoopNest, Names, Op, Opcode, PixelSet, Sink,
    TotalId, Value, Weight,
};
use crate::schedule::steps::Step;
use crate::schedule::sums::{FactoredSums, Shift};
use isophote_syntax::diagnostic::Span;

/// Units of work to emit and place an instruction.
const EMISSION: usize = 3;
/// Units of work to count an instruction's cost, mainly spills.
const COST: usize = 2;
/// Initial instruction capacity.
const ROOM: usize = 224;

/// Options of lowering.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Lowering {
    /// Contract a · b + c (the processor has fused multiply-add).
    pub fma: bool,
    /// Leave out and count pixels at or above their channel's limit.
    pub drop_saturated: bool,
}

/// The loop nest for sums over the pixels of `domain`.
pub(crate) fn sums(
    graph: &mut Graph,
    sums: &FactoredSums,
    domain: Option<NodeId>,
    lowering: Lowering,
    names: Arc<Names>,
) -> LoopNest {
    let mut builder = Builder::new(graph);
    let pixels = sums.summed(builder.graph);
    builder.wanted.extend(pixels.iter().copied());
    let mut set = PixelSet::default();
    if let Some(domain) = domain {
        let region = domain::region(builder.graph, domain);
        set.bounds = region.bounds.map(|(lo, hi)| (builder.lower(lo), builder.lower(hi)));
        set.mask = region.mask.map(|m| builder.lower(m));
    }
    let mut accumulators = vec![Value(0); pixels.len()];
    by_degree(builder.graph, &pixels).into_iter().for_each(|i| accumulators[i] = builder.pixel_value(pixels[i]));
    let numbers: FxHashMap<NodeId, AccumulatorId> =
        pixels.iter().enumerate().map(|(i, pixel)| (*pixel, AccumulatorId(i as u32))).collect();
    let accumulator = |node: NodeId| numbers[&node];

    let mut totals: Vec<Value> = Vec::new();
    let mut total_ids: FxHashMap<Value, usize> = FxHashMap::default();
    let mut outputs = Vec::new();
    for output in &sums.outputs {
        let mut sum: Option<Value> = None;
        for term in &output.terms {
            let pass_total = match (term.row, term.pixel) {
                (None, None) => builder.emit(Opcode::PassCount.of([])),
                (row, pixel) => {
                    let row_sum = builder.row_sum(pixel, sums.shift.as_ref(), &accumulator);
                    let total = match row {
                        Some(row) => {
                            let row = builder.lower(row);
                            builder.emit(Opcode::Mul.of([row, row_sum]))
                        }
                        None => row_sum,
                    };
                    let id = *total_ids.entry(total).or_insert_with(|| {
                        totals.push(total);
                        totals.len() - 1
                    });
                    builder.emit(Opcode::PassTotal(TotalId(id as u32)).of([]))
                }
            };
            let part = if builder.graph.value_of(term.coefficient) == Some(1.0) {
                pass_total
            } else {
                let coefficient = builder.lower(term.coefficient);
                builder.emit(Opcode::Mul.of([coefficient, pass_total]))
            };
            sum = Some(match sum {
                None => part,
                Some(so_far) => builder.emit(Opcode::Add.of([so_far, part])),
            });
        }
        outputs.push(sum.unwrap_or_else(|| builder.emit(Opcode::number(0.0).of([]))));
    }
    let saturable = if lowering.drop_saturated { builder.graph.channels(&pixels) } else { Vec::new() };
    let program = builder.finish(set, Sink::Sums { accumulators, totals, outputs }, lowering, names);
    if saturable.is_empty() { program } else { program.without_saturated(&saturable) }
}

/// The weight of the pixel loop that sums `pixels`, if it is below `below`; ignores the outer levels and the domain.
pub(crate) fn pixel_weight(graph: &mut Graph, pixels: &[NodeId], lowering: Lowering, below: Weight) -> Option<Weight> {
    // Each value takes an addition, and each product a multiplication.
    let products = pixels.iter().filter(|n| matches!(graph.node(**n), Node::Product(_))).count();
    let most = below.flops as usize;
    if pixels.len() + products > most {
        return None;
    }
    let mut builder = Builder::new(graph);
    builder.wanted.extend(pixels.iter().copied());
    let mut accumulators = vec![Value(0); pixels.len()];
    for i in by_degree(builder.graph, pixels) {
        accumulators[i] = builder.pixel_value(pixels[i]);
        let flops = builder.flops_min as usize + pixels.len();
        let is_ahead =
            |n: &&NodeId| matches!(builder.graph.node(**n), Node::Product(_)) && !builder.values.contains_key(*n);
        if flops + products > most && flops + pixels.iter().filter(is_ahead).count() > most {
            return None;
        }
    }
    let sink = Sink::Sums { accumulators, totals: Vec::new(), outputs: Vec::new() };
    builder.graph.charge(COST * builder.instructions.len());
    builder.finish(PixelSet::default(), sink, lowering, Default::default()).weight(below)
}

/// The loop nest that adds `value` to a plane.
pub(crate) fn plane(graph: &mut Graph, value: NodeId, lowering: Lowering, names: Arc<Names>) -> LoopNest {
    let mut builder = Builder::new(graph);
    let value = builder.pixel_value(value);
    builder.finish(PixelSet::default(), Sink::Plane(value), lowering, names)
}

/// Indices of pixel values by degree, so that larger monomials reuse smaller ones.
fn by_degree(graph: &Graph, pixels: &[NodeId]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..pixels.len()).collect();
    order.sort_by_key(|i| degree(graph, pixels[*i]));
    order
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
    known: FxHashMap<Op, Value>,
    pub values: FxHashMap<NodeId, Value>,
    /// Products needed in any case: others are built from them.
    pub wanted: FxHashSet<NodeId>,
    /// Sums whose terms share no factors.
    pub apart: FxHashSet<NodeId>,
    span: Option<Span>,
    /// Weighted flops of the pixel loop so far: a lower bound of those that remain after the peephole pass.
    flops_min: u32,
}

impl<'g> Builder<'g> {
    fn new(graph: &'g mut Graph) -> Builder<'g> {
        Builder {
            graph,
            instructions: Vec::with_capacity(ROOM),
            inputs: Vec::new(),
            known: FxHashMap::with_capacity_and_hasher(ROOM, Default::default()),
            values: FxHashMap::with_capacity_and_hasher(ROOM, Default::default()),
            wanted: FxHashSet::default(),
            apart: FxHashSet::default(),
            span: None,
            flops_min: 0,
        }
    }

    /// The value of an operation, new or known, at the level of its operands or of its own.
    fn emit(&mut self, op: Op) -> Value {
        if let Some(value) = self.known.get(&op) {
            return *value;
        }
        let level = op.level(|v| self.instructions[v.index()].level);
        self.graph.charge(EMISSION);
        if level == Level::Pixel {
            // The peephole pass may merge a reciprocal with a product.
            self.flops_min += op.weight() - u32::from(op.code == Opcode::Div);
        }
        let value = Value(self.instructions.len() as u32);
        self.instructions.push(Instruction { op, level, span: self.span });
        self.known.insert(op, value);
        value
    }

    pub fn input(&mut self, input: Input) -> Value {
        let at = self.inputs.iter().position(|i| *i == input).unwrap_or_else(|| {
            self.inputs.push(input);
            self.inputs.len() - 1
        });
        self.emit(Opcode::Input(InputId(at as u32)).of([]))
    }

    /// The row total of a pixel value, summed directly or made from other totals by the shift.
    fn row_sum(
        &mut self,
        pixel: Option<NodeId>,
        shift: Option<&Shift>,
        accumulator: &dyn Fn(NodeId) -> AccumulatorId,
    ) -> Value {
        let total = |builder: &mut Self, part: Option<NodeId>| match part {
            Some(part) => builder.emit(Opcode::RowTotal(accumulator(part)).of([])),
            None => builder.emit(Opcode::RowCount.of([])),
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
                let number = self.emit(Opcode::number(binomial).of([]));
                value = self.emit(Opcode::Mul.of([number, value]));
            }
            let lower = self.emit(Opcode::Mul.of([distance, sum]));
            sum = self.emit(Opcode::Add.of([lower, value]));
        }
        sum
    }

    /// The node as a pixel value: an earlier one goes through a select that always holds, so that a sink may read it.
    fn pixel_value(&mut self, node: NodeId) -> Value {
        let value = self.lower(node);
        if self.instructions[value.index()].level == Level::Pixel {
            return value;
        }
        let zero = self.emit(Opcode::number(0.0).of([]));
        let x = self.emit(Opcode::Offset.of([zero]));
        let always = self.emit(Opcode::Compare(Comparison::Eq).of([x, x]));
        self.emit(Opcode::Select.of([always, value, value]))
    }

    /// The value of a node; a worklist visits operands first.
    fn lower(&mut self, root: NodeId) -> Value {
        let mut stack: Vec<(NodeId, Option<Step>)> = vec![(root, None)];
        while let Some((node, step)) = stack.pop() {
            if self.values.contains_key(&node) {
                continue;
            }
            match step {
                None => {
                    // A full graph's program is not used; the search for its missing nodes would not end.
                    let step = match self.graph.overflowed() {
                        true => Step::Leaf(Opcode::number(0.0).of([])),
                        false => self.step(node),
                    };
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
            Step::Of(code, operands) => match operands[..] {
                [a] => code.of([at(&a)]),
                [a, b] => code.of([at(&a), at(&b)]),
                _ => code.of([at(&operands[0]), at(&operands[1]), at(&operands[2])]),
            },
            Step::MulAdd(a, b, c) => {
                let (product, c) = (Opcode::Mul.of([at(a), at(b)]), at(c));
                Opcode::Add.of([self.emit(product), c])
            }
        };
        self.emit(op)
    }

    fn finish(self, set: PixelSet, sink: Sink, lowering: Lowering, names: Arc<Names>) -> LoopNest {
        let mut program = LoopNest {
            coordinates: names.coordinates.len() as u32,
            channels: names.channels.len() as u32,
            inputs: self.inputs,
            tables: self.graph.tables.clone(),
            instructions: self.instructions,
            pixel_set: set,
            sink,
            names,
            fused: lowering.fma,
        };
        crate::program::peephole::improve(&mut program);
        program
    }
}
