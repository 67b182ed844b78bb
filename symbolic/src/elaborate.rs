//! Syntax trees in, graph nodes out: names, shapes, sums, conditions and the user's functions are worked out here.
//!
//! A value is a matrix of nodes; a scalar is 1×1. Every operand is worked out before any is judged, so that all faults of a
//! formula are told; what failed leaves a [`Poison`] behind, which is silent: each fault is told once.

mod cache;
mod unknown;

use std::collections::{BTreeMap, HashMap};
use std::rc::Rc;

use crate::diagnostic::{Span, quoted};
use crate::document::Text;
use crate::function::Function1;
use crate::graph::{Graph, Node, NodeId};
use crate::limits::LIMITS;
use crate::parser::{Expr, Fault, Kind, Relation};
use crate::program::Comparison;
use cache::Cache;
pub(crate) use cache::Task;

/// A matrix of nodes, row-major.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub(crate) struct Matrix {
    pub rows: usize,
    pub columns: usize,
    pub entries: Vec<NodeId>,
}

impl Matrix {
    pub fn scalar(node: NodeId) -> Matrix {
        Matrix { rows: 1, columns: 1, entries: vec![node] }
    }
    pub fn size(&self) -> Shape {
        Shape(self.rows, self.columns)
    }
}

/// Rows and columns.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Shape(pub usize, pub usize);

impl Shape {
    pub const SCALAR: Shape = Shape(1, 1);
}

impl std::fmt::Display for Shape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Shape(1, 1) => f.write_str("a scalar"),
            Shape(n, 1) => write!(f, "a vector of {n}"),
            Shape(n, m) => write!(f, "a {n}×{m} matrix"),
        }
    }
}

/// What is left of a part that failed, or of one that is not known yet. Its fault is told already.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Poison {
    Unknown,
    /// Numbers of that shape.
    Numbers(Shape),
    /// A condition.
    Truth,
}

/// A value, or what is left of it.
pub(crate) type Worked = Result<Matrix, Poison>;

/// The shape of numbers, as far as it is known.
pub(crate) fn shape_of(worked: &Worked) -> Option<Shape> {
    match worked {
        Ok(matrix) => Some(matrix.size()),
        Err(Poison::Numbers(shape)) => Some(*shape),
        Err(_) => None,
    }
}

fn poisoned(shape: Option<Shape>) -> Poison {
    shape.map_or(Poison::Unknown, Poison::Numbers)
}

/// The user's function: the names of its arguments, its body, where the body stands.
#[derive(Debug)]
pub(crate) struct Function {
    pub arguments: Vec<String>,
    pub body: Expr,
    pub text: Text,
}

/// What a name stands for.
#[derive(Clone, Debug)]
pub(crate) enum Binding {
    /// A parameter, constant, coordinate, channel or definition already worked out.
    Value(Matrix),
    Function(Rc<Function>),
    /// A definition that failed or stands in a cycle: its fault is already told.
    Poisoned,
}

/// Names that the language keeps for itself, besides the functions of one argument.
pub(crate) const RESERVED: [&str; 13] =
    ["and", "or", "not", "if", "piecewise", "sum", "product", "min", "max", "abs", "sqrt", "pi", "atan2"];

pub(crate) fn is_reserved(name: &str) -> bool {
    RESERVED.contains(&name) || Function1::named(name).is_some()
}

/// True of the language's own functions.
pub(crate) fn is_function(name: &str) -> bool {
    is_reserved(name) && !matches!(name, "and" | "or" | "not" | "pi")
}

/// What all formulas of a document share.
pub(crate) struct Workings {
    steps_left: usize,
    /// A limit is met and told: nothing more is worked out.
    exhausted: bool,
    /// Values of the user's functions.
    pub results: HashMap<(String, Vec<Matrix>), Matrix>,
    /// Spellings still to be compared: only what is shown needs help.
    near_misses_left: usize,
    /// Some names could not be read: one that nothing declares is silent.
    pub lacks_names: bool,
}

impl Default for Workings {
    fn default() -> Workings {
        Workings {
            steps_left: LIMITS.steps,
            exhausted: false,
            results: HashMap::new(),
            near_misses_left: 2 * LIMITS.diagnostics,
            lacks_names: false,
        }
    }
}

/// A name that is known in one place only: an argument, or the index of a sum.
pub(crate) struct Local {
    pub name: String,
    pub value: Worked,
    /// The sums whose index it depends on, one bit each.
    pub levels: u64,
}

pub(crate) struct Elaborator<'a> {
    pub graph: &'a mut Graph,
    pub names: &'a BTreeMap<String, Binding>,
    /// Where the formula stands, for the spans of nodes.
    pub text: Text,
    pub workings: &'a mut Workings,
    pub locals: Vec<Local>,
    pub faults: Vec<Fault>,
    pub calls: usize,
    depth: usize,
    /// Locals have no values now: only what does not depend on them is judged.
    blind: bool,
    pub cache: Cache,
}

pub(crate) fn fault(code: &'static str, at: &Expr, message: impl Into<String>) -> Fault {
    Fault::new(code, at.start, at.end, message)
}

impl<'a> Elaborator<'a> {
    pub fn new(
        graph: &'a mut Graph,
        names: &'a BTreeMap<String, Binding>,
        text: Text,
        workings: &'a mut Workings,
    ) -> Elaborator<'a> {
        let (locals, faults) = (Vec::new(), Vec::new());
        Elaborator {
            graph,
            names,
            text,
            workings,
            locals,
            faults,
            calls: 0,
            depth: 0,
            blind: false,
            cache: Cache::default(),
        }
    }

    pub fn span(&self, at: &Expr) -> Option<Span> {
        Some(self.text.span(at.start, at.end))
    }

    /// Tells a fault, once a place.
    pub fn tell(&mut self, fault: Fault) -> Poison {
        let told = |f: &Fault| (f.start, f.end, f.code) == (fault.start, fault.end, fault.code);
        if !self.faults.iter().any(told) {
            self.faults.push(fault);
        }
        Poison::Unknown
    }

    /// Takes `steps` from the document's budget.
    pub fn charge(&mut self, steps: usize, at: &Expr) -> Result<(), Poison> {
        if self.workings.exhausted {
            return Err(Poison::Unknown);
        }
        let message = if self.graph.overflowed() {
            format!("the model's formulas grow past {} distinct operations", LIMITS.nodes)
        } else if self.workings.steps_left < steps {
            format!("working the formulas out takes more than {} steps", LIMITS.steps)
        } else {
            self.workings.steps_left -= steps;
            return Ok(());
        };
        self.workings.exhausted = true;
        let fault = fault("limit", at, message).help("shorten the sums, or give repeated parts a definition");
        Err(self.tell(fault))
    }

    pub fn expr(&mut self, at: &Expr) -> Worked {
        self.charge(1, at)?;
        match &at.kind {
            Kind::Number(value) => Ok(Matrix::scalar(self.graph.number(*value))),
            Kind::Name(name) => self.name(name, at),
            _ => self.remembered(Task::Value, at, |e| e.deeper(at)),
        }
    }

    /// What is worked out inside a sum and does not depend on its index is worked out once.
    pub fn remembered(&mut self, task: Task, at: &Expr, f: impl FnOnce(&mut Self) -> Worked) -> Worked {
        if !self.blind
            && let Some(known) = self.cache.get(task, at)
        {
            return known;
        }
        let outer = self.cache.begin();
        let value = f(self);
        self.cache.end(outer, task, at, (!self.blind).then_some(&value));
        value
    }

    fn deeper(&mut self, at: &Expr) -> Worked {
        if self.depth == 4 * LIMITS.depth {
            let message = format!("formulas and the functions that they call are nested at most {} deep", self.depth);
            return Err(self.tell(fault("limit", at, message).help("give the inner part a definition of its own")));
        }
        self.depth += 1;
        let value = self.compound(at);
        self.depth -= 1;
        let value = value?;
        // Long sums cost by their length, wherever they end up.
        if !matches!(at.kind, Kind::Index(..) | Kind::Transpose(_) | Kind::List(_)) {
            let terms = value.entries.iter().map(|n| self.graph.operand_count(*n)).sum();
            self.charge(terms, at)?;
        }
        match value.entries[..] {
            [node] if self.graph.value_of(node).is_some_and(|v| !v.is_finite()) => {
                let fault = fault("bad-number", at, "the value of this is not a finite number");
                Err(self.tell(fault.help("no division by zero, no logarithm or root of what is negative")))
            }
            _ => Ok(value),
        }
    }

    fn compound(&mut self, at: &Expr) -> Worked {
        match &at.kind {
            Kind::Number(_) | Kind::Name(_) => self.expr(at),
            Kind::List(list) => self.list(list, at),
            Kind::Sum(terms) => self.sum(terms, at),
            Kind::Product(factors) => self.product(factors.iter(), at),
            Kind::Negate(inner) => {
                let inner = self.number_matrix(inner)?;
                self.graph.set_span(self.span(at));
                Ok(self.map(inner, |graph, n| graph.scale(-1.0, n)))
            }
            Kind::Power(base, exponent) => self.power(base, exponent, at),
            Kind::Transpose(inner) => self.transpose(inner),
            Kind::Index(inner, indices) => self.index(inner, indices, at),
            Kind::Call(name, arguments) => self.call(name, arguments, at),
            Kind::Compare(relation, left, right) => self.compare(*relation, left, right, at),
            Kind::And(parts) => self.logic(parts, at, Graph::and, true),
            Kind::Or(parts) => self.logic(parts, at, Graph::or, false),
            Kind::Not(inner) => self.not(inner, at),
            Kind::Broken(parts) => {
                for part in parts {
                    let is_called = matches!(&part.kind, Kind::Name(name)
                        if is_reserved(name) || matches!(self.names.get(name), Some(Binding::Function(_))));
                    if !is_called {
                        let _told = self.expr(part);
                    }
                }
                Err(Poison::Unknown)
            }
        }
    }

    /// Checks a function's body as far as that goes without its arguments.
    pub fn trial(&mut self, arguments: &[String], body: &Expr) {
        let local = |name: &String| Local { name: name.clone(), value: Err(Poison::Unknown), levels: 0 };
        self.locals = arguments.iter().map(local).collect();
        self.blindly(|e| e.expr(body).is_ok());
        self.locals.clear();
    }

    /// With locals that have no values.
    pub fn blindly<T>(&mut self, f: impl FnOnce(&mut Self) -> T) -> T {
        let outer = std::mem::replace(&mut self.blind, true);
        let result = f(self);
        self.blind = outer;
        result
    }

    pub fn map(&mut self, mut matrix: Matrix, f: impl Fn(&mut Graph, NodeId) -> NodeId) -> Matrix {
        matrix.entries.iter_mut().for_each(|n| *n = f(self.graph, *n));
        matrix
    }

    /// A number: 1×1 and not a truth value.
    pub fn scalar(&mut self, at: &Expr) -> Result<NodeId, Poison> {
        let value = self.number_matrix(at);
        match (shape_of(&value), value) {
            (Some(Shape::SCALAR) | None, Ok(value)) => Ok(value.entries[0]),
            (Some(Shape::SCALAR) | None, Err(poison)) => Err(poison),
            (Some(shape), _) => {
                let fault = fault("shape", at, format!("this is {shape} where a scalar is needed"));
                let remedy =
                    if shape.1 == 1 { "index it: `v[0]`; a dot product is `u' * v`" } else { "index it: `A[0, 0]`" };
                Err(self.tell(fault.help(remedy)))
            }
        }
    }

    /// A truth value.
    pub fn truth(&mut self, at: &Expr) -> Result<NodeId, Poison> {
        let value = self.expr(at);
        match &value {
            Ok(Matrix { entries, .. }) if entries.len() == 1 && self.graph.is_truth(entries[0]) => Ok(entries[0]),
            Err(Poison::Unknown | Poison::Truth) => Err(Poison::Unknown),
            _ => Err(self.tell(
                fault("truth-value", at, "a condition is needed here, not a number")
                    .help("compare it with something: `s <= 1`"),
            )),
        }
    }

    /// Numbers, not a truth value.
    pub fn number_matrix(&mut self, at: &Expr) -> Worked {
        let value = self.expr(at);
        let is_truth = match &value {
            Ok(matrix) => matrix.entries.iter().any(|n| self.graph.is_truth(*n)),
            Err(poison) => *poison == Poison::Truth,
        };
        if is_truth {
            let fault = fault("truth-value", at, "this is a condition where a number is needed");
            return Err(self.tell(fault.help("choose numbers by it: `if(condition, 1, 0)`")));
        }
        value
    }

    /// A whole number known now.
    pub fn whole(&mut self, at: &Expr, what: &str) -> Result<i64, Poison> {
        let node = self.scalar(at)?;
        let fault = match self.graph.value_of(node) {
            Some(value) if value.fract() == 0.0 && value.abs() < 1e9 => return Ok(value as i64),
            Some(value) if value.fract() == 0.0 => {
                fault("bad-range", at, format!("{what} is at most 1e9, not {value:e}")).help("count from 0")
            }
            Some(value) => fault("bad-range", at, format!("{what} is a whole number, not {value}"))
                .help("the entries of a vector are counted from 0; `if` chooses between formulas"),
            None => fault("bad-range", at, format!("{what} must be known when the model is read"))
                .help("use whole numbers and the index of an enclosing `sum` or `product` only"),
        };
        Err(self.tell(fault))
    }

    fn name(&mut self, name: &str, at: &Expr) -> Worked {
        if let Some(local) = self.locals.iter().rev().find(|l| l.name == name) {
            self.cache.reads(local.levels);
            return if self.blind { Err(poisoned(shape_of(&local.value))) } else { local.value.clone() };
        }
        let fault = match self.names.get(name) {
            Some(Binding::Value(value)) => {
                let value = value.clone();
                self.charge(value.entries.len() / 16, at)?;
                return Ok(value);
            }
            Some(Binding::Poisoned) => return Err(Poison::Unknown),
            Some(Binding::Function(function)) => {
                let count = function.arguments.len();
                let plural = if count == 1 { "" } else { "s" };
                fault("syntax", at, format!("{} is a function of {count} argument{plural}", quoted(name)))
                    .help(format!("call it: `{name}({})`", function.arguments.join(", ")))
            }
            None if name == "pi" => return Ok(Matrix::scalar(self.graph.number(std::f64::consts::PI))),
            None if is_reserved(name) => fault("syntax", at, format!("`{name}` needs its arguments in parentheses"))
                .help(format!("write `{name}(…)`")),
            None => return Err(self.unknown(name, at, "is not defined")),
        };
        Err(self.tell(fault))
    }

    fn list(&mut self, list: &[Expr], at: &Expr) -> Worked {
        if list.is_empty() {
            let fault = fault("shape", at, "a vector has at least one entry");
            return Err(self.tell(fault.help("write `[a, b]`")));
        }
        let rows: Vec<Worked> = list.iter().map(|item| self.number_matrix(item)).collect();
        let mut columns = None;
        for (item, row) in list.iter().zip(&rows) {
            let Some(shape) = shape_of(row) else { continue };
            let first = *columns.get_or_insert(shape.0);
            let message = if shape.1 != 1 {
                format!("{shape} cannot be a row of a matrix")
            } else if shape.0 != first {
                format!("this row has {} entries, the first has {first}", shape.0)
            } else {
                continue;
            };
            let fault = fault("shape", item, message);
            return Err(self.tell(fault.help("the rows of a matrix are vectors of one length: `[[a, b], [c, d]]`")));
        }
        let count = list.len() * columns.unwrap_or(1);
        if count > LIMITS.entries {
            let message = format!("a matrix has at most {} entries, this one {count}", LIMITS.entries);
            return Err(self.tell(fault("limit", at, message)));
        }
        let shape = columns.filter(|_| rows.iter().all(|r| shape_of(r).is_some())).map(|c| Shape(list.len(), c));
        let rows = rows.into_iter().collect::<Result<Vec<_>, _>>().map_err(|_| poisoned(shape))?;
        let entries: Vec<NodeId> = rows.into_iter().flat_map(|r| r.entries).collect();
        Ok(Matrix { rows: list.len(), columns: entries.len() / list.len(), entries })
    }

    fn sum(&mut self, terms: &[(bool, Expr)], at: &Expr) -> Worked {
        let parts: Vec<_> = terms.iter().map(|(minus, term)| (*minus, term, self.number_matrix(term))).collect();
        self.add(parts, at)
    }

    /// Adds what is worked out; true means subtracted.
    pub fn add(&mut self, parts: Vec<(bool, &Expr, Worked)>, at: &Expr) -> Worked {
        let first = parts.iter().find_map(|(_, _, value)| shape_of(value));
        let mut whole = true;
        for (_, term, value) in &parts {
            if let (Some(first), Some(shape)) = (first, shape_of(value))
                && first != shape
            {
                whole = false;
                let fault = fault("shape", term, format!("{shape} cannot be added to {first}"));
                self.tell(fault.help("shapes must be equal; nothing is done elementwise by accident"));
            }
        }
        if !whole {
            return Err(Poison::Unknown);
        }
        if parts.iter().any(|(_, _, value)| value.is_err()) {
            return Err(poisoned(first));
        }
        let Shape(rows, columns) = first.unwrap_or(Shape::SCALAR);
        let parts: Vec<(f64, Matrix)> =
            parts.into_iter().filter_map(|(minus, _, v)| Some((if minus { -1.0 } else { 1.0 }, v.ok()?))).collect();
        self.graph.set_span(self.span(at));
        let entry = |i: usize| parts.iter().map(move |(sign, m)| (m.entries[i], *sign)).collect::<Vec<_>>();
        let entries = (0..rows * columns).map(|i| self.graph.sum(0.0, entry(i))).collect();
        Ok(Matrix { rows, columns, entries })
    }

    /// Multiplies factors from the left; true means divided by.
    pub fn product<'e>(&mut self, factors: impl Iterator<Item = &'e (bool, Expr)>, at: &Expr) -> Worked {
        let mut total: Option<Worked> = None;
        for (inverse, factor) in factors {
            let value = self.number_matrix(factor);
            total = Some(match (total, *inverse) {
                (None, false) => value,
                (Some(total), false) => self.multiply(total, value, factor, at),
                (total, true) => {
                    let one = Ok(Matrix::scalar(self.graph.number(1.0)));
                    self.divide(total.unwrap_or(one), value, factor, at)
                }
            });
        }
        total.unwrap_or(Err(Poison::Unknown))
    }

    pub fn divide(&mut self, total: Worked, value: Worked, factor: &Expr, at: &Expr) -> Worked {
        if let Some(shape) = shape_of(&value)
            && shape != Shape::SCALAR
        {
            let fault = fault("shape", factor, format!("nothing can be divided by {shape}"));
            return Err(self.tell(fault.help("divide by a number: an entry `v[0]`, or a length `sqrt(v' * v)`")));
        }
        let shape = poisoned(shape_of(&total));
        let (total, value) = (total?, value.map_err(|_| shape)?);
        self.graph.set_span(self.span(at));
        Ok(self.map(total, |graph, n| graph.div(n, value.entries[0])))
    }

    pub fn multiply(&mut self, a: Worked, b: Worked, factor: &Expr, at: &Expr) -> Worked {
        let (Some(left), Some(right)) = (shape_of(&a), shape_of(&b)) else { return Err(Poison::Unknown) };
        let shape = if right == Shape::SCALAR {
            left
        } else if left == Shape::SCALAR {
            right
        } else if left.1 == right.0 {
            Shape(left.0, right.1)
        } else {
            let fault = fault("shape", factor, format!("{left} cannot be multiplied by {right}"));
            let help = if left == right {
                "a dot product is `u' * v`"
            } else {
                "the columns of the left must be the rows of the right; a dot product is `u' * v`"
            };
            return Err(self.tell(fault.help(help)));
        };
        if shape.0 * shape.1 > LIMITS.entries {
            let message = format!("a matrix has at most {} entries, this product {}", LIMITS.entries, shape.0 * shape.1);
            return Err(self.tell(fault("limit", at, message)));
        }
        let (Ok(a), Ok(b)) = (a, b) else { return Err(Poison::Numbers(shape)) };
        self.graph.set_span(self.span(at));
        if let [scale] = b.entries[..] {
            return Ok(self.map(a, |graph, n| graph.mul(n, scale)));
        }
        if let [scale] = a.entries[..] {
            return Ok(self.map(b, |graph, n| graph.mul(scale, n)));
        }
        self.charge(shape.0 * shape.1 * a.columns, at)?;
        let mut entries = Vec::with_capacity(shape.0 * shape.1);
        for i in 0..a.rows {
            for j in 0..b.columns {
                let terms: Vec<_> = (0..a.columns)
                    .map(|k| (self.graph.mul(a.entries[i * a.columns + k], b.entries[k * b.columns + j]), 1.0))
                    .collect();
                entries.push(self.graph.sum(0.0, terms));
            }
        }
        Ok(Matrix { rows: a.rows, columns: b.columns, entries })
    }

    fn power(&mut self, base: &Expr, exponent: &Expr, at: &Expr) -> Worked {
        let (base, power) = (self.scalar(base), self.scalar(exponent));
        let value = power.ok().and_then(|p| self.graph.value_of(p));
        if let Some(value) = value
            && value.abs() > LIMITS.exponent as f64
        {
            let message = format!("the exponent {value} is larger than {}", LIMITS.exponent);
            let fault = fault("limit", exponent, message).help("use exp(n*log(x)) where that is what you mean");
            self.tell(fault);
            return Err(Poison::Numbers(Shape::SCALAR));
        }
        let (Ok(base), Ok(power)) = (base, power) else { return Err(Poison::Numbers(Shape::SCALAR)) };
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(self.graph.power(base, power)))
    }

    fn transpose(&mut self, inner: &Expr) -> Worked {
        let inner = self.number_matrix(inner).map_err(|poison| match poison {
            Poison::Numbers(Shape(rows, columns)) => Poison::Numbers(Shape(columns, rows)),
            _ => Poison::Unknown,
        })?;
        let entry = |i: usize| inner.entries[(i % inner.rows) * inner.columns + i / inner.rows];
        let entries = (0..inner.entries.len()).map(entry).collect();
        Ok(Matrix { rows: inner.columns, columns: inner.rows, entries })
    }

    fn index(&mut self, inner: &Expr, indices: &[Expr], at: &Expr) -> Worked {
        let value = self.number_matrix(inner);
        let numbers: Vec<Option<i64>> = indices.iter().map(|i| self.whole(i, "an index").ok()).collect();
        let Some(shape) = shape_of(&value) else { return Err(Poison::Unknown) };
        let is_vector = shape.0 == 1 || shape.1 == 1;
        let sizes: &[usize] = match (indices.len(), is_vector) {
            (1, true) => &[shape.0 * shape.1],
            (1, false) => &[shape.0],
            (2, _) => &[shape.0, shape.1],
            _ => {
                let fault = fault("shape", at, "an index is `[i]` or `[i, j]`");
                return Err(self.tell(fault.help("indices count from 0; there are no ranges")));
            }
        };
        let mut inside = Vec::new();
        for ((number, size), at) in numbers.iter().zip(sizes).zip(indices) {
            match number {
                Some(i) if (0..*size as i64).contains(i) => inside.push(*i as usize),
                Some(i) => {
                    let message =
                        format!("index {i} is outside {shape}, whose indices run from 0 to {}", size.saturating_sub(1));
                    self.tell(fault("bad-range", at, message).help("indices count from 0"));
                }
                None => {}
            }
        }
        let row_is_result = indices.len() == 1 && !is_vector;
        let result = if row_is_result { Shape(shape.1, 1) } else { Shape::SCALAR };
        let (Ok(value), true) = (value, inside.len() == indices.len()) else { return Err(Poison::Numbers(result)) };
        Ok(match inside[..] {
            [row] if row_is_result => {
                let entries = value.entries[row * value.columns..(row + 1) * value.columns].to_vec();
                Matrix { rows: value.columns, columns: 1, entries }
            }
            [i] => Matrix::scalar(value.entries[i]),
            _ => Matrix::scalar(value.entries[inside[0] * value.columns + inside[1]]),
        })
    }

    fn compare(&mut self, relation: Relation, left: &Expr, right: &Expr, at: &Expr) -> Worked {
        let (a, b) = (self.scalar(left), self.scalar(right));
        let (Ok(a), Ok(b)) = (a, b) else { return Err(Poison::Truth) };
        self.graph.set_span(self.span(at));
        let (comparison, a, b) = match relation {
            Relation::Lt => (Comparison::Lt, a, b),
            Relation::Le => (Comparison::Le, a, b),
            Relation::Gt => (Comparison::Lt, b, a),
            Relation::Ge => (Comparison::Le, b, a),
            Relation::Eq => (Comparison::Eq, a, b),
            Relation::Ne => (Comparison::Ne, a, b),
        };
        Ok(Matrix::scalar(self.graph.compare(comparison, a, b)))
    }

    /// `and` where `neutral` is true, else `or`; what is known now is left out.
    fn logic(
        &mut self,
        parts: &[Expr],
        at: &Expr,
        join: fn(&mut Graph, NodeId, NodeId) -> NodeId,
        neutral: bool,
    ) -> Worked {
        let parts: Vec<_> = parts.iter().map(|part| self.truth(part)).collect();
        let parts = parts.into_iter().collect::<Result<Vec<_>, _>>().map_err(|_| Poison::Truth)?;
        self.graph.set_span(self.span(at));
        let mut total = parts[0];
        for next in &parts[1..] {
            total = match (self.known_truth(total), self.known_truth(*next)) {
                (Some(known), _) => if known == neutral { *next } else { total },
                (None, Some(known)) => if known == neutral { total } else { *next },
                (None, None) => join(self.graph, total, *next),
            };
        }
        Ok(Matrix::scalar(total))
    }

    fn not(&mut self, inner: &Expr, at: &Expr) -> Worked {
        let inner = self.truth(inner).map_err(|_| Poison::Truth)?;
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(match self.known_truth(inner) {
            Some(known) => {
                let zero = self.graph.number(0.0);
                self.graph.compare(if known { Comparison::Lt } else { Comparison::Le }, zero, zero)
            }
            None => self.graph.not(inner),
        }))
    }

    /// The value of a comparison between numbers.
    pub fn known_truth(&self, node: NodeId) -> Option<bool> {
        let Node::Compare(comparison, a, b) = self.graph.node(node) else { return None };
        let (a, b) = (self.graph.value_of(*a)?, self.graph.value_of(*b)?);
        Some(match comparison {
            Comparison::Lt => a < b,
            Comparison::Le => a <= b,
            Comparison::Eq => a == b,
            Comparison::Ne => a != b,
        })
    }
}
