//! Syntax trees in, graph nodes out: names, shapes, sums, conditions and the user's functions are worked out here.
//!
//! A value is a matrix of nodes; a scalar is 1×1. A definition that failed poisons its users silently, so that each fault
//! is told once.

use std::collections::BTreeMap;

use crate::diagnostic::{Span, nearest_name, quoted};
use crate::document::Text;
use crate::function::Function1;
use crate::graph::{Graph, NodeId};
use crate::limits::LIMITS;
use crate::parser::{Expr, Fault, Kind, Relation};
use crate::program::Comparison;

/// A matrix of nodes, row-major.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Matrix {
    pub rows: usize,
    pub columns: usize,
    pub entries: Vec<NodeId>,
}

impl Matrix {
    pub fn scalar(node: NodeId) -> Matrix {
        Matrix { rows: 1, columns: 1, entries: vec![node] }
    }
    pub fn shape(&self) -> String {
        match (self.rows, self.columns) {
            (1, 1) => "a scalar".into(),
            (n, 1) => format!("a vector of {n}"),
            (n, m) => format!("a {n}×{m} matrix"),
        }
    }
}

/// What a name stands for.
#[derive(Clone, Debug)]
pub(crate) enum Binding {
    /// A parameter, constant, coordinate, channel or definition already worked out.
    Value(Matrix),
    /// The user's function: names of its arguments, its body, where the body stands.
    Function(Vec<String>, Expr, Text),
    /// A definition that failed or stands in a cycle: its fault is already told.
    Poisoned,
}

/// Names that the language keeps for itself.
pub(crate) const RESERVED: [&str; 24] = [
    "and",
    "or",
    "not",
    "if",
    "piecewise",
    "sum",
    "product",
    "min",
    "max",
    "abs",
    "sqrt",
    "pi",
    "exp",
    "log",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
];

pub(crate) fn is_reserved(name: &str) -> bool {
    RESERVED.contains(&name) || Function1::named(name).is_some()
}

/// The fault of a user of something that already failed; never shown.
pub(crate) const POISONED: &str = "poisoned";

pub(crate) struct Elaborator<'a> {
    pub graph: &'a mut Graph,
    pub names: &'a BTreeMap<String, Binding>,
    /// Where the formula stands, for the spans of nodes.
    pub text: Text,
    pub steps_left: &'a mut usize,
    pub locals: Vec<(String, Matrix)>,
    pub calls: usize,
}

pub(crate) type Worked = Result<Matrix, Fault>;

pub(crate) fn fault(code: &'static str, at: &Expr, message: impl Into<String>) -> Fault {
    Fault::new(code, at.start, at.end, message)
}

impl<'a> Elaborator<'a> {
    pub fn new(
        graph: &'a mut Graph,
        names: &'a BTreeMap<String, Binding>,
        text: Text,
        steps_left: &'a mut usize,
    ) -> Elaborator<'a> {
        Elaborator { graph, names, text, steps_left, locals: Vec::new(), calls: 0 }
    }

    pub fn span(&self, at: &Expr) -> Option<Span> {
        Some(self.text.span(at.start, at.end))
    }

    pub fn expr(&mut self, at: &Expr) -> Worked {
        if *self.steps_left == 0 || self.graph.overflowed() {
            let message = if self.graph.overflowed() {
                format!("the model's formulas grow past {} distinct operations", LIMITS.nodes)
            } else {
                format!("working the formulas out takes more than {} steps", LIMITS.steps)
            };
            return Err(fault("limit", at, message).help("shorten the sums, or give repeated parts a definition"));
        }
        *self.steps_left -= 1;
        let value = match &at.kind {
            Kind::Number(value) => Matrix::scalar(self.graph.number(*value)),
            Kind::Name(name) => self.name(name, at)?,
            Kind::List(list) => self.list(list, at)?,
            Kind::Sum(terms) => self.sum(terms, at)?,
            Kind::Product(factors) => self.product(factors, at)?,
            Kind::Negate(inner) => {
                let inner = self.number_matrix(inner)?;
                self.graph.set_span(self.span(at));
                self.map(inner, |graph, n| graph.scale(-1.0, n))
            }
            Kind::Power(base, exponent) => self.power(base, exponent, at)?,
            Kind::Transpose(inner) => {
                let inner = self.expr(inner)?;
                let entry = |i: usize| inner.entries[(i % inner.rows) * inner.columns + i / inner.rows];
                let entries = (0..inner.entries.len()).map(entry).collect();
                Matrix { rows: inner.columns, columns: inner.rows, entries }
            }
            Kind::Index(inner, indices) => self.index(inner, indices, at)?,
            Kind::Call(name, arguments) => self.call(name, arguments, at)?,
            Kind::Compare(relation, left, right) => self.compare(*relation, left, right, at)?,
            Kind::And(parts) => self.logic(parts, at, Graph::and)?,
            Kind::Or(parts) => self.logic(parts, at, Graph::or)?,
            Kind::Not(inner) => {
                let inner = self.truth(inner)?;
                self.graph.set_span(self.span(at));
                Matrix::scalar(self.graph.not(inner))
            }
        };
        Ok(value)
    }

    /// Works a function's body out with numbers for its arguments.
    pub fn trial(&mut self, arguments: &[String], body: &Expr) -> Worked {
        let number = Matrix::scalar(self.graph.number(1.5));
        self.locals = arguments.iter().map(|a| (a.clone(), number.clone())).collect();
        let result = self.expr(body);
        self.locals.clear();
        result
    }

    fn map(&mut self, mut matrix: Matrix, f: impl Fn(&mut Graph, NodeId) -> NodeId) -> Matrix {
        matrix.entries.iter_mut().for_each(|n| *n = f(self.graph, *n));
        matrix
    }

    /// A number: 1×1 and not a truth value.
    pub fn scalar(&mut self, at: &Expr) -> Result<NodeId, Fault> {
        let value = self.number_matrix(at)?;
        match value.entries[..] {
            [node] => Ok(node),
            _ => Err(fault("shape", at, format!("this is {} where a scalar is needed", value.shape()))
                .help("index it: `v[0]`")),
        }
    }

    /// A truth value.
    pub fn truth(&mut self, at: &Expr) -> Result<NodeId, Fault> {
        let value = self.expr(at)?;
        match value.entries[..] {
            [node] if self.graph.is_truth(node) => Ok(node),
            _ => Err(fault("truth-value", at, "a condition is needed here, not a number")
                .help("compare it with something: `s <= 1`")),
        }
    }

    pub fn number_matrix(&mut self, at: &Expr) -> Worked {
        let value = self.expr(at)?;
        if value.entries.iter().any(|n| self.graph.is_truth(*n)) {
            let fault = fault("truth-value", at, "this is a condition where a number is needed");
            return Err(fault.help("choose numbers by it: `if(condition, 1, 0)`"));
        }
        Ok(value)
    }

    /// A whole number known now.
    pub fn whole(&mut self, at: &Expr, what: &str) -> Result<i64, Fault> {
        let node = self.scalar(at)?;
        match self.graph.value_of(node) {
            Some(value) if value.fract() == 0.0 && value.abs() < 1e9 => Ok(value as i64),
            Some(value) if value.fract() == 0.0 => {
                Err(fault("bad-range", at, format!("{what} is at most 1e9, not {value}")))
            }
            Some(value) => Err(fault("bad-range", at, format!("{what} is a whole number, not {value}"))),
            None => Err(fault("bad-range", at, format!("{what} must be known when the model is read"))
                .help("use whole numbers and the index of an enclosing `sum` or `product` only")),
        }
    }

    fn name(&mut self, name: &str, at: &Expr) -> Worked {
        if let Some((_, value)) = self.locals.iter().rev().find(|(n, _)| n == name) {
            return Ok(value.clone());
        }
        match self.names.get(name) {
            Some(Binding::Value(value)) => Ok(value.clone()),
            Some(Binding::Poisoned) => Err(fault(POISONED, at, "")),
            Some(Binding::Function(arguments, ..)) => {
                let fault =
                    fault("syntax", at, format!("{} is a function of {} arguments", quoted(name), arguments.len()));
                Err(fault.help(format!("call it: `{name}({})`", arguments.join(", "))))
            }
            None if name == "pi" => Ok(Matrix::scalar(self.graph.number(std::f64::consts::PI))),
            None if is_reserved(name) => Err(fault("syntax", at, format!("`{name}` needs arguments in parentheses"))),
            None => Err(self.unknown(name, at, "is not defined")),
        }
    }

    pub fn unknown(&self, name: &str, at: &Expr, what: &str) -> Fault {
        let locals = self.locals.iter().map(|(n, _)| n.as_str());
        let candidates = self.names.keys().map(String::as_str).chain(locals).chain(RESERVED);
        let fault = fault("unknown-name", at, format!("{} {what}", quoted(name)));
        match nearest_name(name, candidates) {
            Some(near) => fault.help(format!("did you mean `{near}`?")),
            None => fault.help("declare it under [parameters], [constants] or [definitions]"),
        }
    }

    fn list(&mut self, list: &[Expr], at: &Expr) -> Worked {
        if list.is_empty() {
            return Err(fault("shape", at, "a vector has at least one entry"));
        }
        let mut rows = Vec::new();
        for item in list {
            let row = self.number_matrix(item)?;
            if row.columns != 1 {
                return Err(fault("shape", item, format!("{} cannot be a row of a matrix", row.shape())));
            }
            rows.push(row.entries);
        }
        let columns = rows[0].len();
        if let Some(i) = rows.iter().position(|r| r.len() != columns) {
            let message = format!("this row has {} entries, the first has {columns}", rows[i].len());
            return Err(fault("shape", &list[i], message));
        }
        if rows.len() * columns > LIMITS.entries {
            return Err(fault("limit", at, format!("a matrix has at most {} entries", LIMITS.entries)));
        }
        Ok(Matrix { rows: rows.len(), columns, entries: rows.concat() })
    }

    fn sum(&mut self, terms: &[(bool, Expr)], at: &Expr) -> Worked {
        let mut parts: Vec<(f64, Matrix)> = Vec::new();
        for (negative, term) in terms {
            let value = self.number_matrix(term)?;
            if let Some((_, first)) = parts.first()
                && (first.rows, first.columns) != (value.rows, value.columns)
            {
                let message = format!("{} cannot be added to {}", value.shape(), first.shape());
                return Err(
                    fault("shape", term, message).help("shapes must be equal; nothing is done elementwise by accident")
                );
            }
            parts.push((if *negative { -1.0 } else { 1.0 }, value));
        }
        self.graph.set_span(self.span(at));
        let (rows, columns) = (parts[0].1.rows, parts[0].1.columns);
        let entry = |i: usize| parts.iter().map(move |(sign, m)| (m.entries[i], *sign)).collect::<Vec<_>>();
        let entries = (0..rows * columns).map(|i| self.graph.sum(0.0, entry(i))).collect();
        Ok(Matrix { rows, columns, entries })
    }

    fn product(&mut self, factors: &[(bool, Expr)], at: &Expr) -> Worked {
        let mut total = self.number_matrix(&factors[0].1)?;
        for (inverse, factor) in &factors[1..] {
            let value = self.number_matrix(factor)?;
            self.graph.set_span(self.span(at));
            total = if *inverse {
                let [divisor] = value.entries[..] else {
                    return Err(fault("shape", factor, format!("nothing can be divided by {}", value.shape())));
                };
                self.map(total, |graph, n| graph.div(n, divisor))
            } else {
                self.multiply(total, value, factor)?
            };
        }
        Ok(total)
    }

    pub fn multiply(&mut self, a: Matrix, b: Matrix, at: &Expr) -> Worked {
        if let [scale] = b.entries[..] {
            return Ok(self.map(a, |graph, n| graph.mul(n, scale)));
        }
        if let [scale] = a.entries[..] {
            return Ok(self.map(b, |graph, n| graph.mul(scale, n)));
        }
        if a.columns != b.rows {
            let fault = fault("shape", at, format!("{} cannot be multiplied by {}", a.shape(), b.shape()));
            return Err(fault.help("the columns of the left must be the rows of the right; a dot product is `u' * v`"));
        }
        if a.rows * b.columns > LIMITS.entries {
            return Err(fault("limit", at, format!("a matrix has at most {} entries", LIMITS.entries)));
        }
        let mut entries = Vec::with_capacity(a.rows * b.columns);
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
        let base = self.scalar(base)?;
        let power = self.scalar(exponent)?;
        if let Some(value) = self.graph.value_of(power)
            && value.abs() > LIMITS.exponent as f64
        {
            let message = format!("the exponent {value} is larger than {}", LIMITS.exponent);
            return Err(fault("limit", exponent, message).help("use exp(n*log(x)) where that is what you mean"));
        }
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(self.graph.power(base, power)))
    }

    fn index(&mut self, inner: &Expr, indices: &[Expr], at: &Expr) -> Worked {
        let value = self.expr(inner)?;
        let numbers = indices.iter().map(|i| self.whole(i, "an index")).collect::<Result<Vec<_>, _>>()?;
        let inside = |i: i64, size: usize, at: &Expr| {
            let message = format!("index {i} is outside {}, whose indices run from 0 to {}", value.shape(), size - 1);
            usize::try_from(i).ok().filter(|i| *i < size).ok_or_else(|| fault("bad-range", at, message))
        };
        let is_vector = value.rows == 1 || value.columns == 1;
        match (numbers[..].len(), is_vector) {
            (1, true) => Ok(Matrix::scalar(value.entries[inside(numbers[0], value.entries.len(), &indices[0])?])),
            (1, false) => {
                let row = inside(numbers[0], value.rows, &indices[0])?;
                let entries = value.entries[row * value.columns..(row + 1) * value.columns].to_vec();
                Ok(Matrix { rows: value.columns, columns: 1, entries })
            }
            (2, _) => {
                let row = inside(numbers[0], value.rows, &indices[0])?;
                let column = inside(numbers[1], value.columns, &indices[1])?;
                Ok(Matrix::scalar(value.entries[row * value.columns + column]))
            }
            _ => Err(fault("shape", at, "an index is `[i]` or `[i, j]`")),
        }
    }

    fn compare(&mut self, relation: Relation, left: &Expr, right: &Expr, at: &Expr) -> Worked {
        let (a, b) = (self.scalar(left)?, self.scalar(right)?);
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(match relation {
            Relation::Lt => self.graph.compare(Comparison::Lt, a, b),
            Relation::Le => self.graph.compare(Comparison::Le, a, b),
            Relation::Gt => self.graph.compare(Comparison::Lt, b, a),
            Relation::Ge => self.graph.compare(Comparison::Le, b, a),
            Relation::Eq => self.graph.compare(Comparison::Eq, a, b),
            Relation::Ne => self.graph.compare(Comparison::Ne, a, b),
        }))
    }

    fn logic(&mut self, parts: &[Expr], at: &Expr, join: fn(&mut Graph, NodeId, NodeId) -> NodeId) -> Worked {
        let mut total = self.truth(&parts[0])?;
        for part in &parts[1..] {
            let next = self.truth(part)?;
            self.graph.set_span(self.span(at));
            total = join(self.graph, total, next);
        }
        Ok(Matrix::scalar(total))
    }
}
