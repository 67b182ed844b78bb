//! Checks that every rewrite on the way from formulas to instructions preserves values, in exact arithmetic.
//!
//! The rules: contraction and division (`peephole`), operations chosen for a node (`steps`), factors moved out of sums
//! and into them (`gather`, `absorb`, `absorb_numbers`), polynomials collected and multiplied out, squares completed. A
//! rule must hold for every expression, so the expressions need not resemble models: all small ones where that is
//! feasible, random ones beyond. Values equal modulo 2⁶¹ − 1 at a random point count as equal.

use std::collections::BTreeSet;

use isophote_elementary::{Function1, Modular};

use crate::derive::absorb::{Absorbed, Scaling, absorb, absorb_numbers, gather};
use crate::derive::monomial::{Splitter, whole_output};
use crate::derive::polynomials::collected;
use crate::derive::square::completed;
use crate::graph::hyper::{Order, Values};
use crate::graph::jet::jet;
use crate::graph::random::Random;
use crate::graph::{Graph, Node, NodeId};
use crate::program::peephole::improve;
use crate::program::{
    AccumulatorId, ChannelId, Comparison, ConstantId, CoordinateId, Input, InputId, Instruction, Level, Literal,
    LoopNest, Names, Op, Opcode, ParameterId, PixelSet, Sink, TotalId, Value,
};
use crate::proof::evaluate::{ByLevel, Raster, evaluate_at};
use crate::schedule;
use crate::schedule::Lowering;
use crate::schedule::sums::{FactoredSums, Output, Term};

/// A number for every leaf, the same for graph and program.
fn leaf(input: &Node) -> Modular {
    let place = match input {
        Node::Coordinate(c) => 1 + c.0,
        Node::Channel(c) => 11 + c.0,
        Node::Input(Input::Parameter(p)) => 21 + p.0,
        Node::Input(Input::Constant(c)) => 31 + c.0,
        _ => panic!("{input:?}"),
    };
    Modular::of_bits(Random(u64::from(place)).bits())
}

fn sample(program: &LoopNest) -> Raster<'static, Modular> {
    Raster {
        inputs: program.inputs.iter().map(|input| leaf(&Node::Input(*input))).collect(),
        columns: vec![leaf(&Node::Coordinate(CoordinateId(0)))],
        rows: vec![(1..4).map(|c| leaf(&Node::Coordinate(CoordinateId(c)))).collect()],
        pixel: &|channel, _, _| leaf(&Node::Channel(ChannelId(channel as u32))),
        every_pixel: true,
    }
}

fn outputs(program: &LoopNest) -> Vec<Modular> {
    assert_eq!(program.check(), Ok(()), "{program}");
    evaluate_at(&ByLevel::of(program), &sample(program)).outputs
}

fn values(graph: &Graph, roots: &[NodeId]) -> Vec<Modular> {
    Values::of(graph, roots, &leaf).at(&leaf).into_iter().map(|root| root.value).collect()
}

/// Sums some values over one pixel, with unchanged instructions.
fn summing(mut instructions: Vec<Instruction>, accumulators: Vec<Value>) -> LoopNest {
    let mut push = |op: Op, level: Level| {
        instructions.push(Instruction { op, level, span: None });
        Value(instructions.len() as u32 - 1)
    };
    let count = 0..accumulators.len() as u32;
    let totals = count.clone().map(|i| push(Opcode::RowTotal(AccumulatorId(i)).of([]), Level::RowEnd)).collect();
    let outputs = count.map(|i| push(Opcode::PassTotal(TotalId(i)).of([]), Level::PassEnd)).collect();
    LoopNest {
        coordinates: 2,
        channels: 2,
        inputs: vec![Input::Parameter(ParameterId(0)), Input::Parameter(ParameterId(1))],
        tables: Default::default(),
        instructions,
        pixel_set: PixelSet::default(),
        sink: Sink::Sums { accumulators, totals, outputs },
        names: Default::default(),
        fused: false,
    }
}

/// Asserts that the peephole pass, with and without contraction, preserves the program's outputs.
fn improves_nothing_away(program: &LoopNest) {
    let before = outputs(program);
    for fused in [false, true] {
        let mut improved = LoopNest { fused, ..program.clone() };
        improve(&mut improved);
        assert_eq!(outputs(&improved), before, "contracting {fused}:\n{program:?}\n{improved:?}");
    }
}

const MAKES: [Opcode; 4] = [Opcode::Add, Opcode::Sub, Opcode::Mul, Opcode::Div];

/// `start`, and one instruction for each choice of an operation and two operands.
fn built(start: &[(Op, Level)], choices: &[(Opcode, usize, usize)]) -> Vec<Instruction> {
    let mut all: Vec<Instruction> =
        start.iter().map(|(op, level)| Instruction { op: *op, level: *level, span: None }).collect();
    for (make, a, b) in choices {
        let level = all[*a].level.max(all[*b].level);
        all.push(Instruction { op: make.of([Value(*a as u32), Value(*b as u32)]), level, span: None });
    }
    all
}

/// All programs of three operations over a pixel and a number of the pass, and of two over more; each value but the
/// last is summed or not.
#[test]
fn peephole_preserves_every_small_program() {
    let (pixel, pass) = (Level::Pixel, Level::Pass);
    let leaves = [
        (Opcode::Channel(ChannelId(0)).of([]), pixel),
        (Opcode::Input(InputId(0)).of([]), pass),
        (Opcode::Channel(ChannelId(1)).of([]), pixel),
        (Opcode::Const(Literal::new(1.0)).of([]), pass),
        (Opcode::Input(InputId(1)).of([]), pass),
    ];
    let mut count = 0;
    for (start, depth, makes) in
        [(&leaves[..2], 3, &MAKES[..3]), (&leaves[..4], 2, &MAKES[..]), (&leaves[..], 2, &MAKES[..3])]
    {
        let ways = |step: usize| makes.len() * (start.len() + step) * (start.len() + step);
        let total: usize = (0..depth).map(ways).product();
        for mut code in 0..total {
            let choices: Vec<(Opcode, usize, usize)> = (0..depth)
                .map(|step| {
                    let width = start.len() + step;
                    let choice = code % ways(step);
                    code /= ways(step);
                    (makes[choice % makes.len()], choice / makes.len() % width, choice / makes.len() / width)
                })
                .collect();
            let instructions = built(start, &choices);
            let last = instructions.len() - 1;
            if instructions[last].level != pixel {
                continue;
            }
            for also in start.len()..=last {
                let also = (also < last && instructions[also].level == pixel).then_some(Value(also as u32));
                let accumulators = [Value(last as u32)].into_iter().chain(also).collect();
                improves_nothing_away(&summing(instructions.clone(), accumulators));
                count += 1;
            }
        }
    }
    assert!(count > 40_000, "{count}");
}

/// Longer random programs, with shared products and reciprocals, and with dead code.
#[test]
fn peephole_preserves_random_programs() {
    for seed in 0..20_000 {
        let mut random = Random(seed);
        let leaves = [
            (Opcode::Channel(ChannelId(0)).of([]), Level::Pixel),
            (Opcode::Channel(ChannelId(1)).of([]), Level::Pixel),
            (Opcode::Input(InputId(0)).of([]), Level::Pass),
            (Opcode::Const(Literal::new(1.0)).of([]), Level::Pass),
            (Opcode::Outer(CoordinateId(1)).of([]), Level::Row),
        ];
        let depth = 4 + random.below(6);
        let choices: Vec<(Opcode, usize, usize)> = (0..depth)
            .map(|step| {
                let width = leaves.len() + step;
                let recent = |random: &mut Random| width - 1 - random.below(width).min(random.below(width));
                (random.pick(&MAKES), recent(&mut random), recent(&mut random))
            })
            .collect();
        let instructions = built(&leaves, &choices);
        let is_pixel = |i: &usize| instructions[*i].level == Level::Pixel;
        let pixels: Vec<usize> = (leaves.len()..instructions.len()).filter(is_pixel).collect();
        if pixels.is_empty() {
            continue;
        }
        let accumulators = (0..1 + random.below(2)).map(|_| Value(random.pick(&pixels) as u32)).collect();
        improves_nothing_away(&summing(instructions, accumulators));
    }
}

/// A graph of random formulas; parameter 0 is positive. The last nodes are the largest.
fn formulas(random: &mut Random, size: usize) -> (Graph, Vec<NodeId>) {
    let mut graph = Graph::default();
    graph.declare_positive(ParameterId(0));
    let mut nodes: Vec<NodeId> = (0..2).map(|c| graph.coordinate(CoordinateId(c))).collect();
    nodes.extend((0..2).map(|c| graph.channel(ChannelId(c))));
    nodes.extend((0..3).map(|p| graph.input(Input::Parameter(ParameterId(p)))));
    nodes.push(graph.input(Input::Constant(ConstantId(0))));
    let leaves = nodes.len();
    while nodes.len() < leaves + size {
        let count = nodes.len();
        let one = |random: &mut Random| nodes[count - 1 - random.below(count).min(random.below(count))];
        let node = match random.below(12) {
            0..=4 => {
                let numbers = [1.0, 1.0, 1.0, -1.0, -1.0, 2.0, -3.0, 0.5];
                let terms: Vec<_> = (0..2 + random.below(3)).map(|_| (one(random), random.pick(&numbers))).collect();
                graph.sum(random.pick(&[0.0, 0.0, 1.0, -2.0]), terms)
            }
            5..=8 => {
                let powers = [1, 1, 1, 2, 3, -1, -2];
                let factors: Vec<_> = (0..2 + random.below(2)).map(|_| (one(random), random.pick(&powers))).collect();
                graph.product(random.pick(&[1.0, 1.0, -1.0, 2.0, -0.5]), factors)
            }
            9 => {
                let a = one(random);
                graph.call1(random.pick(&[Function1::Exp, Function1::Tanh]), a)
            }
            10 => {
                let a = one(random);
                graph.sqrt(a)
            }
            _ => {
                let (a, b, c, d) = (one(random), one(random), one(random), one(random));
                let condition = graph.compare(random.pick(&[Comparison::Lt, Comparison::Le]), a, b);
                graph.select(condition, c, d)
            }
        };
        // Folded numbers may be 0 and then divide.
        if graph.value_of(node).is_some() {
            continue;
        }
        if random.one_in(4) && matches!(graph.node(node), Node::Sum(..) | Node::Product(_)) {
            graph.set_opaque(node);
        }
        nodes.push(node);
    }
    (graph, nodes.split_off(leaves))
}

/// Asserts that a rule preserves the values of some roots; 1 when it changed anything.
fn keeps(
    seed: u64,
    rule: &str,
    graph: &mut Graph,
    roots: &[NodeId],
    make: impl FnOnce(&mut Graph) -> Vec<NodeId>,
) -> usize {
    let before = values(graph, roots);
    let new = make(graph);
    assert_eq!(values(graph, &new), before, "{rule}, seed {seed}");
    usize::from(new != roots)
}

#[test]
fn rewrites_preserve_values() {
    let mut changed = [0; 5];
    for seed in 0..4_000 {
        let mut random = Random(seed);
        let (graph, nodes) = formulas(&mut random, 14);
        let roots: Vec<NodeId> = nodes.iter().rev().take(3).copied().collect();
        let mut trial = graph.clone();
        changed[0] +=
            keeps(seed, "gather", &mut trial, &roots, |graph| roots.iter().map(|root| gather(graph, *root)).collect());
        let mut trial = graph.clone();
        changed[1] += keeps(seed, "absorb_numbers", &mut trial, &roots, |graph| {
            let mut roots = roots.clone();
            absorb_numbers(graph, &mut roots);
            roots
        });
        for scaling in [Scaling::AsWritten, Scaling::Unified] {
            let mut trial = graph.clone();
            let variables = BTreeSet::from([trial.input(Input::Parameter(ParameterId(0))), nodes[2]]);
            let own = jet(&mut trial, roots[0], &variables, Order::Second);
            let mut all = vec![roots[0], roots[1]];
            all.extend(own.first.values().chain(own.second.values()));
            changed[2] += keeps(seed, "absorb", &mut trial, &all, |graph| {
                let Absorbed { tops, jets, others, .. } = absorb(graph, &roots[..1], &[own], &roots[1..2], scaling);
                let jets = jets[0].first.values().chain(jets[0].second.values()).copied();
                tops.into_iter().chain(others).chain(jets).collect()
            });
        }
        let mut trial = graph.clone();
        let variable = match random.one_in(2) {
            true => trial.coordinate(CoordinateId(0)),
            false => nodes[random.below(3)],
        };
        changed[3] += keeps(seed, "collected", &mut trial, &roots, |graph| {
            roots.iter().map(|root| collected(graph, *root, variable)).collect()
        });
        let mut trial = graph.clone();
        let atoms = BTreeSet::from([variable]);
        changed[4] += keeps(seed, "expand", &mut trial, &roots, |graph| {
            let mut expanded = |root: &NodeId| {
                let terms = Splitter::new(&atoms).expand(graph, *root).into_terms(graph);
                let one = graph.number(1.0);
                let part = |graph: &mut Graph, t: Term| {
                    graph.product(1.0, [t.coefficient, t.row.unwrap_or(one), t.pixel.unwrap_or(one)].map(|n| (n, 1)))
                };
                let parts: Vec<_> = terms.into_iter().map(|t| (part(graph, t), 1.0)).collect();
                graph.sum(0.0, parts)
            };
            roots.iter().map(&mut expanded).collect()
        });
    }
    assert!(changed.iter().all(|count| *count > 10), "{changed:?}");
}

#[test]
fn instructions_have_the_values_of_the_formulas() {
    for seed in 0..4_000 {
        let mut random = Random(seed);
        let (mut graph, nodes) = formulas(&mut random, 4 + (seed % 13) as usize);
        let roots: Vec<NodeId> = nodes.iter().rev().take(3).copied().collect();
        let expected = values(&graph, &roots);
        let outputs_of = |graph: &mut Graph| -> Vec<Output> {
            roots.iter().map(|root| whole_output(graph, "value", *root)).collect()
        };
        let sums = FactoredSums { outputs: outputs_of(&mut graph), shift: None };
        for fma in [false, true] {
            let mut graph = graph.clone();
            let names =
                Names { coordinates: vec![String::new(); 2], channels: vec![String::new(); 2], ..Names::default() };
            let program =
                schedule::sums(&mut graph, &sums, None, Lowering { fma, drop_saturated: false }, names.into());
            assert_eq!(outputs(&program), expected, "seed {seed}, contracting {fma}\n{program:?}");
        }
    }
}

/// s = a d² + 2 b d e + c e², and sums of dᵏ · n(s).
#[test]
fn completed_squares_have_the_same_sums() {
    let mut squared = 0;
    for seed in 0..2_000 {
        let mut random = Random(seed);
        let mut graph = Graph::default();
        graph.declare_positive(ParameterId(0));
        let [a, b, c] = [0, 1, 2].map(|p| graph.input(Input::Parameter(ParameterId(p))));
        let [x, y] = [0, 1].map(|c| graph.coordinate(CoordinateId(c)));
        let phi = graph.channel(ChannelId(0));
        let shift = graph.input(Input::Constant(ConstantId(0)));
        let d = graph.sum(random.pick(&[0.0, 1.5]), [(x, 1.0), (shift, -1.0)]);
        graph.set_opaque(d);
        let e = graph.sum(0.0, [(y, 1.0), (shift, -1.0)]);
        let [aa, bb, cc] = [[(a, 1), (d, 2)], [(b, 1), (d, 1)], [(c, 1), (e, 2)]];
        let squares =
            [graph.product(1.0, aa), graph.product(1.0, bb.into_iter().chain([(e, 1)])), graph.product(1.0, cc)];
        let s = graph.sum(random.pick(&[0.0, -1.0]), squares.into_iter().zip([1.0, random.pick(&[2.0, -1.0]), 1.0]));
        graph.set_opaque(s);
        let mut all = Vec::new();
        for k in 0..3 {
            let form = match random.below(4) {
                0 => graph.call1(Function1::Exp, s),
                1 => graph.product(1.0, [(s, 2), (phi, 1)]),
                2 => graph.product(2.0, [(s, -1)]),
                _ => graph.sum(1.0, [(s, 1.0), (phi, -1.0)]),
            };
            let power = if random.one_in(4) { 2 } else { k };
            let node = graph.product(random.pick(&[1.0, -2.0]), [(form, 1), (d, power), (e, random.below(2) as i32)]);
            all.push(whole_output(&mut graph, "value", node));
        }
        let before = FactoredSums { outputs: all, shift: None };
        let Some(after) = completed(&mut graph, &before) else { continue };
        squared += 1;
        let outputs_of = |sums: &FactoredSums, fma: bool| {
            let mut graph = graph.clone();
            let names =
                Names { coordinates: vec![String::new(); 2], channels: vec![String::new(); 2], ..Names::default() };
            let program = schedule::sums(&mut graph, sums, None, Lowering { fma, drop_saturated: false }, names.into());
            outputs(&program)
        };
        let expected = outputs_of(&before, false);
        assert!([false, true].iter().all(|fma| outputs_of(&after, *fma) == expected), "seed {seed}");
    }
    assert!(squared > 500, "{squared}");
}
