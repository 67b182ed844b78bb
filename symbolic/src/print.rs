//! Text forms: a [`Program`] to read and to keep as an expected file, and what `explain` shows of an [`Objective`].

use std::fmt::Write;

use crate::graph::{Graph, Node, NodeId, operands};
use crate::objective::Objective;
use crate::program::{Comparison, Input, Level, Op, Program, Sink, Value};

/// What to show of an objective.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Show {
    /// Shared values, and the form of F over them.
    Derivative,
    /// Accumulators, and outputs as combinations of them.
    Sums,
}

impl std::fmt::Display for Program {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut level = None;
        for (i, instruction) in self.instructions().iter().enumerate() {
            if level != Some(instruction.level) {
                level = Some(instruction.level);
                let title = match instruction.level {
                    Level::Pass => "pass",
                    Level::Row => "row",
                    Level::Pixel => "pixel",
                    Level::RowEnd => "row end",
                    Level::PassEnd => "pass end",
                };
                writeln!(f, "{title}:")?;
            }
            writeln!(f, "  v{i} = {}", operation(self, instruction.op))?;
        }
        let set = self.pixel_set();
        if let Some((lo, hi)) = set.bounds {
            writeln!(f, "bounds: v{} <= {} <= v{}", lo.0, self.names().coordinates[0], hi.0)?;
        }
        for (name, value) in [("mask", set.mask), ("saturated", set.saturated)] {
            if let Some(value) = value {
                writeln!(f, "{name}: v{}", value.0)?;
            }
        }
        match self.sink() {
            Sink::Plane(value) => writeln!(f, "plane: v{}", value.0),
            Sink::Sums { accumulators, totals, outputs } => {
                writeln!(f, "accumulators: {}", list(accumulators))?;
                writeln!(f, "totals: {}", list(totals))?;
                for (value, name) in outputs.iter().zip(&self.names().outputs) {
                    writeln!(f, "{name} = v{}", value.0)?;
                }
                Ok(())
            }
        }
    }
}

fn list(values: &[Value]) -> String {
    values.iter().map(|v| format!("v{}", v.0)).collect::<Vec<_>>().join(" ")
}

fn sign(comparison: Comparison) -> &'static str {
    match comparison {
        Comparison::Lt => "<",
        Comparison::Le => "<=",
        Comparison::Eq => "==",
        Comparison::Ne => "!=",
    }
}

fn input_name(names: &crate::program::Names, input: Input) -> String {
    match input {
        Input::Parameter(p) => names.parameters[p.index()].clone(),
        Input::Entry(p) => format!("{}@entry", names.parameters[p.index()]),
        Input::Constant(c) => names.constants[c.index()].clone(),
        Input::Saturation(c) => format!("limit({})", names.channels[c.index()]),
        Input::Shift(c) => format!("shift({})", names.coordinates[c.index()]),
    }
}

fn operation(program: &Program, op: Op) -> String {
    let names = program.names();
    match op {
        Op::Const(x) => format!("{x}"),
        Op::Input(i) => input_name(names, program.inputs()[i.index()]),
        Op::Outer(c) => names.coordinates[c.index()].clone(),
        Op::Offset(c) => format!("{} + v{}", names.coordinates[0], c.0),
        Op::Channel(c) => format!("pixel({})", names.channels[c.index()]),
        Op::Neg(a) => format!("-v{}", a.0),
        Op::Abs(a) => format!("abs(v{})", a.0),
        Op::Sqrt(a) => format!("sqrt(v{})", a.0),
        Op::Add(a, b) => format!("v{} + v{}", a.0, b.0),
        Op::Sub(a, b) => format!("v{} - v{}", a.0, b.0),
        Op::Mul(a, b) => format!("v{} * v{}", a.0, b.0),
        Op::Div(a, b) => format!("v{} / v{}", a.0, b.0),
        Op::Fma(a, b, c) => format!("fma(v{}, v{}, v{})", a.0, b.0, c.0),
        Op::Compare(c, a, b) => format!("v{} {} v{}", a.0, sign(c), b.0),
        Op::And(a, b) => format!("v{} and v{}", a.0, b.0),
        Op::Or(a, b) => format!("v{} or v{}", a.0, b.0),
        Op::Not(a) => format!("not v{}", a.0),
        Op::Select(c, a, b) => format!("if(v{}, v{}, v{})", c.0, a.0, b.0),
        Op::Call1(function, a) => format!("{}(v{})", function.name(), a.0),
        Op::Call2(function, a, b) => format!("{}(v{}, v{})", function.name(), a.0, b.0),
        Op::RowTotal(a) => format!("row sum {}", a.0),
        Op::RowCount => "row pixels".into(),
        Op::PassTotal(t) => format!("total {}", t.0),
        Op::PassCount => "pixels".into(),
    }
}

impl Objective {
    /// A part of the derivation, as text.
    pub fn explain(&self, show: Show) -> String {
        let mut printer = Printer::new(self);
        match show {
            Show::Derivative => {
                let forms = self.forms.clone();
                for (name, node) in forms {
                    printer.line(&name, node);
                }
            }
            Show::Sums => {
                let mut shown: Vec<NodeId> = Vec::new();
                for output in &self.sums().outputs {
                    let mut parts = Vec::new();
                    for term in &output.terms {
                        let mut factors = vec![printer.formula(term.coefficient)];
                        let inner = term.pixel.map_or("pixels".to_string(), |p| {
                            let at = shown.iter().position(|s| *s == p).unwrap_or_else(|| {
                                shown.push(p);
                                shown.len() - 1
                            });
                            format!("S{at}")
                        });
                        factors.push(match term.row {
                            Some(row) => format!("Σ_rows {}·{inner}", printer.formula(row)),
                            None => inner,
                        });
                        parts.push(if factors[0] == "1" { factors.remove(1) } else { factors.join("·") });
                    }
                    let sum = if parts.is_empty() { "0".to_string() } else { parts.join(" + ") };
                    printer.lines.push(format!("{} = {sum}", output.name));
                }
                for (i, pixel) in shown.into_iter().enumerate() {
                    let formula = printer.formula(pixel);
                    printer.lines.push(format!("S{i} = Σ_pixels {formula}"));
                }
            }
        }
        printer.finish()
    }
}

/// Prints nodes; what is used more than once gets a line `t… = …` of its own.
struct Printer<'a> {
    graph: &'a Graph,
    names: &'a crate::program::Names,
    counts: Vec<u32>,
    shared: std::collections::BTreeMap<NodeId, String>,
    definitions: Vec<String>,
    lines: Vec<String>,
}

impl<'a> Printer<'a> {
    fn new(objective: &'a Objective) -> Printer<'a> {
        let terms = objective.sums().outputs.iter().flat_map(|o| &o.terms);
        let mut roots: Vec<NodeId> = terms.flat_map(|t| [Some(t.coefficient), t.row, t.pixel]).flatten().collect();
        roots.extend(objective.forms.iter().map(|(_, n)| *n));
        let graph = objective.graph();
        let counts = graph.use_counts(&roots);
        Printer {
            graph,
            names: objective.names(),
            counts,
            shared: Default::default(),
            definitions: Vec::new(),
            lines: Vec::new(),
        }
    }

    fn line(&mut self, name: &str, node: NodeId) {
        let formula = self.formula(node);
        self.lines.push(format!("{name} = {formula}"));
    }

    /// The formula of a node; shared ones below it are defined first, operands before users.
    fn formula(&mut self, root: NodeId) -> String {
        let mut texts: std::collections::BTreeMap<NodeId, String> = Default::default();
        for id in self.graph.reachable(&[root]) {
            if let Some(name) = self.shared.get(&id) {
                texts.insert(id, name.clone());
                continue;
            }
            let text = self.text(id, &texts);
            let leaf = operands(self.graph.node(id)).next().is_none();
            if !leaf && (self.counts[id.index()] > 1 || text.len() > 120) {
                let name = format!("t{}", self.shared.len());
                self.definitions.push(format!("{name} = {text}"));
                self.shared.insert(id, name.clone());
                texts.insert(id, name);
            } else {
                texts.insert(id, text);
            }
        }
        texts.remove(&root).unwrap_or_default()
    }

    fn text(&self, id: NodeId, texts: &std::collections::BTreeMap<NodeId, String>) -> String {
        let at = |n: &NodeId| texts.get(n).cloned().unwrap_or_default();
        let grouped = |n: &NodeId| {
            let inner = at(n);
            let loose = matches!(self.graph.node(*n), Node::Sum(..)) && !self.shared.contains_key(n);
            if loose { format!("({inner})") } else { inner }
        };
        match self.graph.node(id) {
            Node::Number(bits) => format!("{}", bits.get()),
            Node::Input(input) => input_name(self.names, *input),
            Node::Coordinate(c) => self.names.coordinates[c.index()].clone(),
            Node::Channel(c) => self.names.channels[c.index()].clone(),
            Node::Sum(constant, terms) => {
                let mut text = String::new();
                for (n, c) in terms.iter() {
                    let c = c.get();
                    text += match (text.is_empty(), c < 0.0) {
                        (true, true) => "-",
                        (true, false) => "",
                        (false, true) => " - ",
                        (false, false) => " + ",
                    };
                    if c.abs() != 1.0 {
                        let _ = write!(text, "{}*", c.abs());
                    }
                    text += &grouped(n);
                }
                if constant.get() != 0.0 {
                    let _ = write!(text, " {} {}", if constant.get() < 0.0 { "-" } else { "+" }, constant.get().abs());
                }
                text
            }
            Node::Product(factors) => {
                let base = |n: &NodeId| {
                    let compound = matches!(self.graph.node(*n), Node::Product(..)) && !self.shared.contains_key(n);
                    if compound { format!("({})", at(n)) } else { grouped(n) }
                };
                let power = |n: &NodeId, e: i32| if e == 1 { grouped(n) } else { format!("{}^{e}", base(n)) };
                factors.iter().map(|(n, e)| power(n, *e)).collect::<Vec<_>>().join("*")
            }
            Node::Sqrt(a) => format!("sqrt({})", at(a)),
            Node::Abs(a) => format!("abs({})", at(a)),
            Node::Call1(f, a) => format!("{}({})", f.name(), at(a)),
            Node::Call2(f, a, b) => format!("{}({}, {})", f.name(), at(a), at(b)),
            Node::Compare(c, a, b) => format!("{} {} {}", at(a), sign(*c), at(b)),
            Node::And(a, b) => format!("({} and {})", at(a), at(b)),
            Node::Or(a, b) => format!("({} or {})", at(a), at(b)),
            Node::Not(a) => format!("not ({})", at(a)),
            Node::Select(c, a, b) => format!("if({}, {}, {})", at(c), at(a), at(b)),
        }
    }

    fn finish(self) -> String {
        let mut text = self.definitions.join("\n");
        if !text.is_empty() {
            text.push('\n');
        }
        text + &self.lines.join("\n") + "\n"
    }
}
