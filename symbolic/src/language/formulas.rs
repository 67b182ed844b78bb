//! The formulas of a document: definitions in any order, then the formulas of `[model]`, and stand-alone formulas.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use crate::graph::{Graph, Node, NodeId};
use crate::language::document::{Entry, Item, Key, Text, to_json};
use crate::language::elaborate::{Binding, Elaborator, Function, Matrix, Workings, fault};
use crate::language::reader::Faults;
use crate::model::Leaves;
use crate::program::{ConstantId, Input, Level};
use isophote_syntax::diagnostic::{Diagnostics, quoted};
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::{Expr, ExprKind, parse};

/// A line of `[definitions]`; `g(t)` has arguments.
pub(crate) struct Definition {
    pub name: String,
    pub arguments: Vec<String>,
    pub is_function: bool,
    pub key: String,
    pub text: Text,
    /// False when the name or the formula's syntax is invalid.
    pub declared: bool,
}

/// Elaborates formulas over the document's names.
pub(crate) struct FormulaReader<'f, 'd> {
    pub graph: Graph,
    names: BTreeMap<String, Binding>,
    pub faults: &'f mut Faults<'d>,
    tokens_left: Option<usize>,
    workings: Workings,
}

/// A parsed definition, and the names that it uses.
type Read = (Definition, Expr, BTreeSet<String>);

impl<'f, 'd> FormulaReader<'f, 'd> {
    pub fn new(graph: Graph, names: BTreeMap<String, Binding>, faults: &'f mut Faults<'d>) -> FormulaReader<'f, 'd> {
        FormulaReader { graph, names, faults, tokens_left: Some(LIMITS.tokens), workings: Workings::default() }
    }

    /// Some declarations could not be read: undeclared names are not reported any more.
    pub fn lacks_names(&mut self) {
        self.workings.lacks_names = true;
    }

    /// Elaborates all definitions in dependency order; reports a cycle once, at the first of its names.
    pub fn definitions(&mut self, definitions: Vec<Definition>) {
        let mut waiting: Vec<Read> = Vec::new();
        for mut definition in definitions {
            let parsed = parse(&definition.text.value, &mut self.tokens_left);
            definition.declared &= parsed.faults.is_empty();
            self.faults.tell_all(parsed.faults, &definition.key, &definition.text);
            let mut used = BTreeSet::new();
            names_used(&parsed.expr, &mut used);
            used.retain(|name| !definition.arguments.contains(name));
            waiting.push((definition, parsed.expr, used));
        }
        while !waiting.is_empty() {
            let open: BTreeSet<String> = waiting.iter().map(|(d, ..)| d.name.clone()).collect();
            let (mut ready, mut rest): (Vec<_>, Vec<_>) =
                waiting.into_iter().partition(|(_, _, used)| used.is_disjoint(&open));
            if ready.is_empty() {
                (ready, rest) = self.tell_cycle(rest);
            }
            ready.into_iter().for_each(|(definition, expr, _)| self.define(definition, expr));
            waiting = rest;
        }
    }

    /// Reports a cycle among definitions that all wait for one another, found by following the first until a name
    /// repeats. Returns those in the cycle, then the others.
    fn tell_cycle(&mut self, waiting: Vec<Read>) -> (Vec<Read>, Vec<Read>) {
        let next = |i: usize| waiting.iter().position(|(d, ..)| waiting[i].2.contains(&d.name)).unwrap_or(i);
        let mut path = vec![0];
        while !path.contains(&next(path[path.len() - 1])) {
            path.push(next(path[path.len() - 1]));
        }
        let entry = next(path[path.len() - 1]);
        let mut cycle = path[path.iter().position(|i| *i == entry).unwrap_or(0)..].to_vec();
        let first = cycle.iter().enumerate().min_by_key(|(_, i)| **i).map_or(0, |(at, _)| at);
        cycle.rotate_left(first);
        let mut chain: Vec<&str> = cycle.iter().map(|i| waiting[*i].0.name.as_str()).take(8).collect();
        chain.push(if cycle.len() > 8 { "…" } else { chain[0] });
        let (definition, ..) = &waiting[cycle[0]];
        let span = definition.text.span(0, definition.text.value.len());
        let message = format!("{} is defined by itself: {}", quoted(&definition.name), chain.join(" → "));
        self.faults.tell(
            "cycle",
            &definition.key,
            span,
            message,
            "definitions may stand in any order, but not in a circle",
        );
        let (mut inside, mut outside) = (Vec::new(), Vec::new());
        for (i, mut read) in waiting.into_iter().enumerate() {
            if cycle.contains(&i) {
                read.0.declared = false;
                self.names.entry(read.0.name.clone()).or_insert(Binding::Poisoned);
                inside.push(read);
            } else {
                outside.push(read);
            }
        }
        (inside, outside)
    }

    fn define(&mut self, definition: Definition, expr: Expr) {
        let Definition { name, arguments, is_function, key, text, declared } = definition;
        let binding = if is_function {
            let whole = self.work_out(&expr, &text, &key, |e, expr| {
                e.trial(&arguments, expr);
                Some(())
            });
            match whole {
                Some(()) if declared => Binding::Function(Rc::new(Function { arguments, body: expr, text })),
                _ => Binding::Poisoned,
            }
        } else {
            match self.work_out(&expr, &text, &key, |e, expr| e.expr(expr).ok()) {
                Some(value) if declared => {
                    value.entries.iter().for_each(|n| self.graph.set_opaque(*n));
                    Binding::Value(value)
                }
                _ => Binding::Poisoned,
            }
        };
        self.names.entry(name).or_insert(binding);
    }

    /// Applies `f` to a formula; on faults reports them all and returns `None`.
    fn work_out<T>(
        &mut self,
        expr: &Expr,
        text: &Text,
        key: &str,
        f: impl FnOnce(&mut Elaborator<'_>, &Expr) -> Option<T>,
    ) -> Option<T> {
        let mut elaborator = Elaborator::new(&mut self.graph, &self.names, text.clone(), &mut self.workings);
        let mut result = f(&mut elaborator, expr);
        if elaborator.charge(0, expr).is_err() {
            result = None;
        }
        let faults = std::mem::take(&mut elaborator.faults);
        result = result.filter(|_| faults.is_empty());
        self.faults.tell_all(faults, key, text);
        result
    }

    /// A formula of `[model]`.
    fn formula<T>(&mut self, key: &str, entry: &Entry, f: fn(&mut Elaborator<'_>, &Expr) -> Option<T>) -> Option<T> {
        if let Item::Integer(_) | Item::Float(_) = entry.item {
            let value = to_json(entry).to_string();
            self.faults.tell("wrong-type", key, entry.span, "formulas are strings", format!("write `\"{value}\"`"));
            return None;
        }
        let text = self.faults.text(key, entry)?;
        let parsed = parse(&text.value, &mut self.tokens_left);
        let is_readable = parsed.faults.is_empty();
        self.faults.tell_all(parsed.faults, key, text);
        self.work_out(&parsed.expr, text, key, f).filter(|_| is_readable)
    }

    /// A formula over `intensity`, bound to that number unless the document declares the name.
    pub fn number_of_intensity(&mut self, key: &str, entry: &Entry, intensity: Option<NodeId>) -> Option<NodeId> {
        let own = self.names.get("intensity").cloned();
        if own.is_none() {
            let binding = intensity.map_or(Binding::Poisoned, |node| Binding::Value(Matrix::scalar(node)));
            self.names.insert("intensity".into(), binding);
        }
        let value = self.number(key, entry);
        if own.is_none() {
            self.names.remove("intensity");
        }
        value
    }

    /// A formula whose value is a number or a column of numbers.
    pub fn column(&mut self, key: &str, entry: &Entry) -> Option<Vec<NodeId>> {
        self.formula(key, entry, |e, expr| {
            let value = e.number_matrix(expr).ok()?;
            if value.columns != 1 {
                let message = format!("this is {} where a scalar or a column is needed", value.size());
                e.faults
                    .push(fault("shape", expr, message).help("one entry for each value that is fitted: `[r, g, b]`"));
                return None;
            }
            Some(value.entries)
        })
    }

    /// A formula whose value is a number.
    pub fn number(&mut self, key: &str, entry: &Entry) -> Option<NodeId> {
        self.formula(key, entry, |e, expr| e.scalar(expr).ok())
    }
    /// A formula whose value is a condition.
    pub fn truth(&mut self, key: &str, entry: &Entry) -> Option<NodeId> {
        self.formula(key, entry, |e, expr| e.truth(expr).ok())
    }

    /// Checks that `observed` reads no parameters, `domain` no channels, a constraint neither coordinates nor channels,
    /// and `intensity` some parameter.
    pub fn check_levels(
        &mut self,
        model: &[(Key, Entry)],
        intensity: &[NodeId],
        observed: &[NodeId],
        domain: Option<NodeId>,
        constraints: &[Option<NodeId>],
    ) {
        let tell = |reader: &mut Self, key: &str, message: &str, help: &str| {
            let name = key.trim_start_matches("model.");
            let at = model.iter().find(|(k, _)| k.name == name).map_or_else(Default::default, |(_, e)| e.span);
            reader.faults.tell("bad-formula", key, at, message, help);
        };
        let reads = |reader: &Self, roots: &[NodeId], wanted: fn(&Node) -> bool| {
            reader.graph.reachable(roots).iter().any(|n| wanted(reader.graph.node(*n)))
        };
        let is_parameter = |n: &Node| matches!(n, Node::Input(Input::Parameter(_)));
        if reads(self, observed, is_parameter) {
            tell(
                self,
                "model.observed",
                "`observed` depends on a parameter",
                "it is a formula over channels and constants",
            );
        }
        if let Some(node) = domain
            && reads(self, &[node], |n| matches!(n, Node::Channel(_)))
        {
            tell(
                self,
                "model.domain",
                "`domain` depends on a channel",
                "it is a condition on coordinates and parameters",
            );
        }
        if !intensity.is_empty() && !self.workings.lacks_names && !reads(self, intensity, is_parameter) {
            tell(self, "model.intensity", "`intensity` depends on no parameter", "there is nothing to fit");
        }
        if constraints.iter().flatten().any(|c| self.graph.level(*c) > Level::Pass) {
            tell(
                self,
                "model.constraint",
                "a constraint depends on a coordinate or channel",
                "it is a condition on parameters and constants",
            );
        }
    }
}

/// Every name that an expression mentions, functions included.
fn names_used(expr: &Expr, names: &mut BTreeSet<String>) {
    let mut visit = |list: &[Expr]| list.iter().for_each(|e| names_used(e, names));
    match &expr.kind {
        ExprKind::Number(_) | ExprKind::Text(_) => {}
        ExprKind::Name(name) => {
            names.insert(name.clone());
        }
        ExprKind::List(list) | ExprKind::Joined(_, list) | ExprKind::Broken(list) => visit(list),
        ExprKind::Sum(parts) | ExprKind::Product(parts) => parts.iter().for_each(|(_, e)| names_used(e, names)),
        ExprKind::Negate(a) | ExprKind::Transpose(a) | ExprKind::Not(a) => names_used(a, names),
        ExprKind::Power(a, b) | ExprKind::Compare(_, a, b) => {
            names_used(a, names);
            names_used(b, names);
        }
        ExprKind::Index(a, list) => {
            visit(list);
            names_used(a, names);
        }
        ExprKind::Call(name, list) => {
            visit(list);
            names.insert(name.clone());
        }
    }
}

/// A stand-alone formula over given names, in f64: motion scripts, session constants.
#[derive(Clone, Debug)]
pub struct Formula {
    graph: Graph,
    node: NodeId,
    variables: usize,
}

impl Formula {
    /// Parses a formula over `variables`; spans of faults are relative to the formula.
    pub fn parse(text: &str, variables: &[&str]) -> Result<Formula, Diagnostics> {
        let mut faults = Faults::of(text);
        let mut graph = Graph::default();
        let mut names = BTreeMap::new();
        for (i, name) in variables.iter().enumerate() {
            let node = graph.input(Input::Constant(ConstantId(i as u32)));
            names.insert(name.to_string(), Binding::Value(Matrix::scalar(node)));
        }
        let mut reader = FormulaReader::new(graph, names, &mut faults);
        let text = Text::alone(text);
        let parsed = parse(&text.value, &mut reader.tokens_left);
        let is_readable = parsed.faults.is_empty();
        reader.faults.tell_all(parsed.faults, "", &text);
        let node = reader.work_out(&parsed.expr, &text, "", |e, x| e.scalar(x).ok());
        match node.filter(|_| is_readable) {
            Some(node) => Ok(Formula { graph: reader.graph, node, variables: variables.len() }),
            None => Err(faults.finish()),
        }
    }

    /// The value; `values` are those of the variables, in order. A missing one is NaN.
    pub fn evaluate(&self, values: &[f64]) -> f64 {
        debug_assert_eq!(values.len(), self.variables);
        let leaves = Leaves { constants: values, ..Leaves::default() };
        self.graph.evaluate(self.node, &|node| leaves.value(node))
    }
}
