//! The loop bodies that the thesis' Table 6.1 compares: gradient and Hessian each in a loop of its own or jointly in one,
//! as the derivatives were written down ("plain") or optimised.
//!
//! What comes in: a model, a subset of its parameters, and which [`Part`] is to be summed. What goes out: programs, which
//! compute what [`Model::objective`] computes, and the flops that are counted in them.
//!
//! *Plain* is what Maple's `codegen[optimize]` does without `tryhard` (thesis, chapter 5): the derivatives as
//! differentiation gives them; whatever occurs twice in a body is computed once, and xⁿ by shared squares; nothing is
//! factored, multiplied out or taken apart, there is one sum for each entry, and nothing leaves the loop.

use std::collections::BTreeSet;

use rustc_hash::FxHashMap;

use crate::derive::graph::{Bits, Graph, Node, NodeId};
use crate::derive::jet::{jet, pair};
use crate::derive::objective::{Origin, residual, variance};
use crate::language::diagnostic::Diagnostics;
use crate::language::model::{Lowering, Method, Model};
use crate::program::{
    AccumulatorId, ChannelId, Comparison, CoordinateId, Input, InputId, Instruction, Level, Op, ParameterId, PixelSet,
    Program, Sink, TotalId, Value,
};
use crate::proof::draft::Draft;

/// Which derivatives a loop sums.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Part {
    /// The gradient.
    Gradient,
    /// The upper triangle of the Hessian.
    Hessian,
    /// Both, in one loop.
    Both,
}

impl Part {
    /// The gradient is part of it.
    pub fn has_gradient(self) -> bool {
        self != Part::Hessian
    }
    /// The Hessian is part of it.
    pub fn has_hessian(self) -> bool {
        self != Part::Gradient
    }
}

/// Flops per pixel, accumulation included and F left out, in the four columns of the thesis' Table 6.1. Plain counts are
/// those of the whole loop body; optimised counts are those of what is left in it, as everywhere else.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BodyFlops {
    /// A loop for the gradient and one for the Hessian, plain.
    pub separate_plain: u32,
    /// A loop for the gradient and one for the Hessian, each optimised for itself.
    pub separate_optimised: u32,
    /// One loop, plain.
    pub joint_plain: u32,
    /// The same without what is known per pass or row: what a compiler that moves code out of loops would leave in it.
    pub joint_plain_hoisted: u32,
    /// One loop, optimised: what is compiled.
    pub joint_optimised: u32,
}

impl Model {
    /// Flops per pixel in the four columns of the thesis' Table 6.1.
    pub fn body_flops(&self, subset: &[ParameterId], method: Method) -> Result<BodyFlops, Diagnostics> {
        let lowering = Lowering { fma: true, drop_saturated: false };
        let plain = |part| self.plain_program(subset, method, part);
        let optimised = |part| -> Result<u32, Diagnostics> {
            Ok(self.part_objective(subset, method, part)?.cost(lowering)?.flops_per_pixel)
        };
        let joint = plain(Part::Both)?;
        Ok(BodyFlops {
            separate_plain: whole_body(&plain(Part::Gradient)?) + whole_body(&plain(Part::Hessian)?),
            separate_optimised: optimised(Part::Gradient)? + optimised(Part::Hessian)?,
            joint_plain: whole_body(&joint),
            joint_plain_hoisted: joint.cost().flops_per_pixel,
            joint_optimised: self.objective(subset, method)?.cost(lowering)?.flops_per_pixel,
        })
    }

    /// The derivatives as differentiation writes them, F left out, over every pixel of the window: the domain is not
    /// looked at. It is made to be counted and compared with; [`Model::objective`] is what is fast.
    pub fn plain_program(&self, subset: &[ParameterId], method: Method, part: Part) -> Result<Program, Diagnostics> {
        let mut graph = self.formulas.graph.clone();
        let entries = entries(&mut graph, self, subset, method, part);
        let origin = Origin::of(self);
        if graph.overflowed() {
            return Err(origin.growth(subset.len()));
        }
        let names = self.names(entries.iter().map(|(name, _)| name.clone()).collect());
        let mut body = Body::new(&graph);
        let sink = body.sink(&entries);
        let mut program = Program {
            coordinates: names.coordinates.len() as u32,
            channels: names.channels.len() as u32,
            inputs: body.inputs,
            instructions: body.instructions,
            pixel_set: PixelSet::default(),
            sink,
            names,
            fused: false,
        };
        // Orders the instructions by level; without FMA it finds nothing else to do.
        crate::program::peephole::improve(&mut program, false);
        // It is made to be counted and compared with.
        origin.checked(&graph, Draft::new(program)).map(Draft::unproved)
    }
}

impl Program {
    /// The same sums over the pixels of another program's set, to compare the two: [`Model::plain_program`] looks at no
    /// domain. Inputs of the other program come after those of this one.
    pub fn over_pixels_of(&self, other: &Program) -> Program {
        let mut program = self.clone();
        let moved = |v: Value| Value(v.0 + self.instructions.len() as u32);
        for instruction in &other.instructions {
            let op = match crate::program::peephole::renamed(instruction.op, &moved) {
                Op::Input(input) => {
                    let wanted = other.inputs[input.index()];
                    let known = program.inputs.iter().position(|input| *input == wanted);
                    let index = known.unwrap_or_else(|| {
                        program.inputs.push(wanted);
                        program.inputs.len() - 1
                    });
                    Op::Input(InputId(index as u32))
                }
                op => op,
            };
            program.instructions.push(Instruction { op, ..*instruction });
        }
        let set = other.pixel_set;
        program.pixel_set = PixelSet {
            bounds: set.bounds.map(|(lo, hi)| (moved(lo), moved(hi))),
            mask: set.mask.map(moved),
            saturated: set.saturated.map(moved),
        };
        // What only the other program's sums read is dropped here.
        crate::program::peephole::improve(&mut program, false);
        program
    }
}

/// The flops of the loop body when nothing leaves it.
fn whole_body(program: &Program) -> u32 {
    let body = program.instructions.iter().filter(|i| i.level <= Level::Pixel);
    body.map(|i| i.op.flops()).sum::<u32>() + program.cost().accumulators
}

/// The derivatives of F, named, as differentiation writes them.
fn entries(
    graph: &mut Graph,
    model: &Model,
    subset: &[ParameterId],
    method: Method,
    part: Part,
) -> Vec<(String, NodeId)> {
    let newton = method == Method::Newton;
    let residual = residual(graph, model);
    let variance = variance(graph, model, !newton);
    let parameters: Vec<NodeId> = subset.iter().map(|p| graph.input(Input::Parameter(*p))).collect();
    let variables: BTreeSet<NodeId> = parameters.iter().copied().collect();
    let name = |i: usize| &model.parameters[subset[i].index()].name;
    let zero = graph.number(0.0);
    // Newton: F itself; else L r_u and Q r_u r_v.
    let (total, own) = model.formulas.shape().jet(graph, newton, &[residual], variance);
    let entry = |node: Option<&NodeId>| node.copied().unwrap_or(zero);
    let (l, q) = (entry(own.first.get(&residual)), entry(own.second.get(&(residual, residual))));
    let root = if newton { total } else { residual };
    let jet = jet(graph, root, &variables, newton && part.has_hessian());
    let first: Vec<NodeId> = parameters.iter().map(|u| jet.first.get(u).copied().unwrap_or(zero)).collect();
    let mut list = Vec::new();
    for i in (0..parameters.len()).filter(|_| part.has_gradient()) {
        let node = match newton {
            true => first[i],
            false => graph.product(1.0, [(l, 1), (first[i], 1)]),
        };
        list.push((format!("dF/d{}", name(i)), node));
    }
    for i in (0..parameters.len()).filter(|_| part.has_hessian()) {
        for j in i..parameters.len() {
            let node = match newton {
                true => jet.second.get(&pair(parameters[i], parameters[j])).copied().unwrap_or(zero),
                false => graph.product(1.0, [(q, 1), (first[i], 1), (first[j], 1)]),
            };
            list.push((format!("d2F/d{}d{}", name(i), name(j)), node));
        }
    }
    list
}

/// Writes nodes as they stand: sums and products from left to right.
struct Body<'g> {
    graph: &'g Graph,
    instructions: Vec<Instruction>,
    inputs: Vec<Input>,
    /// By the operation as text, which has what a hash needs.
    known: FxHashMap<String, Value>,
    values: FxHashMap<NodeId, Value>,
}

impl<'g> Body<'g> {
    fn new(graph: &'g Graph) -> Body<'g> {
        let (known, values) = (FxHashMap::default(), FxHashMap::default());
        Body { graph, instructions: Vec::new(), inputs: Vec::new(), known, values }
    }

    /// One sum for each entry that is not zero everywhere.
    fn sink(&mut self, entries: &[(String, NodeId)]) -> Sink {
        let roots: Vec<NodeId> = entries.iter().map(|(_, node)| *node).collect();
        for id in self.graph.reachable(&roots) {
            let value = self.node(id);
            self.values.insert(id, value);
        }
        let (mut accumulators, mut totals, mut outputs) = (Vec::new(), Vec::new(), Vec::new());
        for (_, node) in entries {
            if self.graph.value_of(*node) == Some(0.0) {
                outputs.push(self.number(0.0));
                continue;
            }
            let id = accumulators.len() as u32;
            let value = self.values[node];
            accumulators.push(self.as_pixel(value));
            totals.push(self.emit(Op::RowTotal(AccumulatorId(id)), Level::RowEnd));
            outputs.push(self.emit(Op::PassTotal(TotalId(id)), Level::PassEnd));
        }
        Sink::Sums { accumulators, totals, outputs }
    }

    /// A value known earlier is chosen by a condition, so that a sum may read it.
    fn as_pixel(&mut self, value: Value) -> Value {
        if self.instructions[value.index()].level == Level::Pixel {
            return value;
        }
        let pixel = self.emit(Op::Channel(ChannelId(0)), Level::Pixel);
        let either = self.at_operands(Op::Compare(Comparison::Eq, pixel, pixel));
        self.at_operands(Op::Select(either, value, value))
    }

    fn emit(&mut self, op: Op, level: Level) -> Value {
        let next = Value(self.instructions.len() as u32);
        let value = *self.known.entry(format!("{op:?}")).or_insert(next);
        if value == next {
            self.instructions.push(Instruction { op, level, span: None });
        }
        value
    }

    fn at_operands(&mut self, op: Op) -> Value {
        let level = op.operands().map(|v| self.instructions[v.index()].level).max().unwrap_or(Level::Pass);
        self.emit(op, level)
    }

    fn number(&mut self, value: f64) -> Value {
        self.emit(Op::Const(value), Level::Pass)
    }

    fn node(&mut self, id: NodeId) -> Value {
        let graph = self.graph;
        let at = |n: &NodeId| self.values[n];
        let op = match graph.node(id) {
            Node::Number(bits) => return self.number(bits.get()),
            Node::Input(input) => {
                let index = self.inputs.iter().position(|i| i == input).unwrap_or_else(|| {
                    self.inputs.push(*input);
                    self.inputs.len() - 1
                });
                return self.emit(Op::Input(InputId(index as u32)), Level::Pass);
            }
            Node::Coordinate(CoordinateId(0)) => {
                let zero = self.number(0.0);
                return self.emit(Op::Offset(zero), Level::Pixel);
            }
            Node::Coordinate(c) => return self.emit(Op::Outer(*c), Level::Row),
            Node::Channel(c) => return self.emit(Op::Channel(*c), Level::Pixel),
            Node::Sum(constant, terms) => return self.sum(constant.get(), terms),
            Node::Product(factors) => return self.product(factors),
            Node::Sqrt(a) => Op::Sqrt(at(a)),
            Node::Abs(a) => Op::Abs(at(a)),
            Node::Call1(f, a) => Op::Call1(*f, at(a)),
            Node::Call2(f, a, b) => Op::Call2(*f, at(a), at(b)),
            Node::Compare(c, a, b) => Op::Compare(*c, at(a), at(b)),
            Node::And(a, b) => Op::And(at(a), at(b)),
            Node::Or(a, b) => Op::Or(at(a), at(b)),
            Node::Not(a) => Op::Not(at(a)),
            Node::Select(c, a, b) => Op::Select(at(c), at(a), at(b)),
        };
        self.at_operands(op)
    }

    /// Coefficients of ±1 cost nothing; x plus what is known earlier is one operation, as it is in every program.
    fn sum(&mut self, constant: f64, terms: &[(NodeId, Bits)]) -> Value {
        let inner = |n: NodeId| matches!(self.graph.node(n), Node::Coordinate(CoordinateId(0)));
        if let Some(x) = terms.iter().position(|(n, c)| inner(*n) && c.get() == 1.0) {
            let (early, late): (Vec<_>, Vec<_>) = terms
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != x)
                .map(|(_, term)| *term)
                .partition(|(n, _)| self.graph.level(*n) < Level::Pixel);
            let early = self.terms(constant, &early, None);
            let offset = self.emit(Op::Offset(early), Level::Pixel);
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
                term = self.at_operands(Op::Mul(number, term));
            }
            total = Some(match (total, coefficient < 0.0) {
                (None, false) => term,
                (None, true) => self.at_operands(Op::Neg(term)),
                (Some(sum), false) => self.at_operands(Op::Add(sum, term)),
                (Some(sum), true) => self.at_operands(Op::Sub(sum, term)),
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
            *side = Some(before.map_or(power, |product| self.at_operands(Op::Mul(product, power))));
        }
        let over = over.unwrap_or_else(|| self.number(1.0));
        under.map_or(over, |under| self.at_operands(Op::Div(over, under)))
    }

    /// By squares, which other powers of the same base share.
    fn power(&mut self, base: Value, exponent: u32) -> Value {
        let (mut result, mut square) = (None, base);
        let mut rest = exponent;
        while rest > 0 {
            if rest & 1 == 1 {
                result = Some(result.map_or(square, |product| self.at_operands(Op::Mul(product, square))));
            }
            rest >>= 1;
            if rest > 0 {
                square = self.at_operands(Op::Mul(square, square));
            }
        }
        result.unwrap_or(base)
    }
}
