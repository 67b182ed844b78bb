//! Elaborates syntax trees to graph nodes: names, shapes, sums, conditions and user functions.
//!
//! A value is a matrix of nodes; a scalar is 1×1. All operands are elaborated before any is checked, so that all faults
//! of a formula are reported; a failure leaves a silent [`Poison`], so that each fault is reported once.

mod cache;
mod conditions;
mod matrices;
pub mod unknown;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::rc::Rc;

use rustc_hash::{FxHashMap, FxHashSet};

use crate::graph::{Graph, NodeId};
use crate::language::document::Text;
use cache::Cache;
pub(crate) use cache::Task;
use isophote_syntax::diagnostic::{Span, Spellings, quoted};
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::{Expr, ExprKind, Fault};
use isophote_syntax::words::is_reserved;

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
    pub fn size(&self) -> MatrixShape {
        MatrixShape(self.rows, self.columns)
    }
}

/// Rows and columns.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct MatrixShape(pub usize, pub usize);

impl MatrixShape {
    pub const SCALAR: MatrixShape = MatrixShape(1, 1);
}

impl std::fmt::Display for MatrixShape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            MatrixShape(1, 1) => f.write_str("a scalar"),
            MatrixShape(n, 1) => write!(f, "a vector of {n}"),
            MatrixShape(n, m) => write!(f, "a {n}×{m} matrix"),
        }
    }
}

/// Placeholder of a failed part, whose fault is already reported, or of one that is not known yet.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Poison {
    Unknown,
    /// Numbers of this shape.
    Numbers(MatrixShape),
    /// A condition.
    Truth,
}

/// A value or its placeholder.
pub(crate) type Worked = Result<Matrix, Poison>;

/// The shape of numbers, if known.
pub(crate) fn shape_of(worked: &Worked) -> Option<MatrixShape> {
    match worked {
        Ok(matrix) => Some(matrix.size()),
        Err(Poison::Numbers(shape)) => Some(*shape),
        Err(_) => None,
    }
}

fn poisoned(shape: Option<MatrixShape>) -> Poison {
    shape.map_or(Poison::Unknown, Poison::Numbers)
}

/// A user function: argument names, body, and the body's source.
#[derive(Debug)]
pub(crate) struct Function {
    pub arguments: Vec<String>,
    pub body: Expr,
    pub text: Text,
}

/// Meaning of a name.
#[derive(Clone, Debug)]
pub(crate) enum Binding {
    /// A parameter, constant, coordinate, channel or elaborated definition.
    Value(Matrix),
    Function(Rc<Function>),
    /// One of the graph's tables, bound to its name in quotes, which no other name has.
    Table(u16),
    /// A definition that failed or is in a cycle, its fault already reported.
    Poisoned,
}

/// Units of work to visit a part of a formula.
const STEP: usize = 3;

/// Maximum number of entries of cached user calls, arguments and values together.
pub(crate) const REMEMBERED: usize = 1 << 18;

/// State shared by all formulas of a document.
#[derive(Default)]
pub(crate) struct Workings {
    /// A limit is reported: elaboration stops.
    exhausted: bool,
    /// Cached values of user functions.
    pub results: HashMap<(String, Vec<Matrix>), Matrix>,
    /// Entries in `results`.
    pub remembered: usize,
    /// Nodes that conditions read, each with its flattened form; and those of them in which flattening cancels
    /// something.
    apart: FxHashMap<NodeId, NodeId>,
    lessened: FxHashSet<NodeId>,
    /// Spelling suggestions.
    spellings: Spellings,
    /// Some names could not be read: undeclared names are not reported.
    pub lacks_names: bool,
}

/// A local name: an argument, or the index of a sum.
pub(crate) struct Local {
    pub name: String,
    pub value: Worked,
    /// The sums whose index it depends on, one bit each.
    pub levels: u64,
}

pub(crate) struct Elaborator<'a> {
    pub graph: &'a mut Graph,
    pub names: &'a BTreeMap<String, Binding>,
    /// The formula's source, for the spans of nodes.
    pub text: Text,
    pub workings: &'a mut Workings,
    pub locals: Vec<Local>,
    pub faults: Vec<Fault>,
    /// Span and code of the faults reported.
    pub told: HashSet<(usize, usize, &'static str)>,
    pub calls: usize,
    depth: usize,
    /// Locals have no values: only parts independent of them are checked.
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
            told: HashSet::new(),
            calls: 0,
            depth: 0,
            blind: false,
            cache: Cache::default(),
        }
    }

    pub fn span(&self, at: &Expr) -> Option<Span> {
        Some(self.text.span(at.start, at.end))
    }

    /// Reports a fault once per span and code.
    pub fn tell(&mut self, fault: Fault) -> Poison {
        if self.told.insert((fault.start, fault.end, fault.code)) {
            self.faults.push(fault);
        }
        Poison::Unknown
    }

    /// Charges `steps` to the document's budget.
    pub fn charge(&mut self, steps: usize, at: &Expr) -> Result<(), Poison> {
        if self.workings.exhausted {
            return Err(Poison::Unknown);
        }
        self.graph.charge(STEP * steps);
        let message = if self.graph.budget().is_spent() {
            format!("working the formulas out takes more than {} units of work", LIMITS.work)
        } else if self.graph.overflowed() {
            format!("the model's formulas grow past {} distinct operations", LIMITS.nodes)
        } else {
            return Ok(());
        };
        self.workings.exhausted = true;
        let fault = fault("limit", at, message).help("shorten the sums, or give repeated parts a definition");
        Err(self.tell(fault))
    }

    /// Charges for copying or comparing a matrix.
    pub fn charge_copy(&mut self, value: &Worked, at: &Expr) -> Result<(), Poison> {
        self.charge(value.as_ref().map_or(0, |matrix| matrix.entries.len() / 16), at)
    }

    pub fn expr(&mut self, at: &Expr) -> Worked {
        self.charge(1, at)?;
        match &at.kind {
            ExprKind::Number(value) => Ok(Matrix::scalar(self.graph.number(*value))),
            ExprKind::Name(name) => self.name(name, at),
            _ => self.remembered(Task::Value, at, |e| e.deeper(at)),
        }
    }

    /// Caches parts inside a sum that do not depend on its index.
    pub fn remembered(&mut self, task: Task, at: &Expr, f: impl FnOnce(&mut Self) -> Worked) -> Worked {
        if !self.blind
            && let Some(known) = self.cache.get(task, at)
        {
            self.charge_copy(&known, at)?;
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
        // Long sums are charged by length, wherever they end up.
        if !matches!(at.kind, ExprKind::Index(..) | ExprKind::Transpose(_) | ExprKind::List(_)) {
            let terms = value.entries.iter().map(|n| self.graph.operand_count(*n)).sum();
            self.charge(terms, at)?;
            let exponent = value.entries.iter().map(|n| self.graph.exponent_max(*n)).max().unwrap_or(0);
            if exponent as usize > LIMITS.terms {
                let message = format!("the exponents grow to {exponent}, past {}", LIMITS.terms);
                return Err(
                    self.tell(fault("limit", at, message).help("use exp(n*log(x)) where that is what you mean"))
                );
            }
        }
        self.finite(value, at)
    }

    /// Reports constants that are NaN or infinite.
    pub fn finite(&mut self, value: Matrix, at: &Expr) -> Worked {
        if value.entries.iter().all(|n| self.graph.has_finite_numbers(*n)) {
            return Ok(value);
        }
        let fault = fault("bad-number", at, "the value of this is not a finite number");
        Err(self.tell(fault.help("no division by zero, no logarithm or root of what is negative")))
    }

    fn compound(&mut self, at: &Expr) -> Worked {
        match &at.kind {
            ExprKind::Number(_) | ExprKind::Name(_) => self.expr(at),
            ExprKind::List(list) => self.list(list, at),
            ExprKind::Text(_) => {
                let fault = fault("syntax", at, "a text is no number");
                Err(self.tell(fault.help("only a table has a name in quotes: `table(\"psf\", s)`")))
            }
            ExprKind::Sum(terms) => self.sum(terms, at),
            ExprKind::Product(factors) => self.product(factors.iter(), at),
            ExprKind::Negate(inner) => {
                let inner = self.number_matrix(inner)?;
                self.graph.set_span(self.span(at));
                Ok(self.map(inner, |graph, n| graph.scale(-1.0, n)))
            }
            ExprKind::Power(base, exponent) => self.power(base, exponent, at),
            ExprKind::Transpose(inner) => self.transpose(inner),
            ExprKind::Index(inner, indices) => self.index(inner, indices, at),
            ExprKind::Call(name, arguments) => self.call(name, arguments, at),
            ExprKind::Compare(relation, left, right) => self.compare(*relation, left, right, at),
            ExprKind::Joined(junction, parts) => self.joined(*junction, parts, at),
            ExprKind::Not(inner) => self.not(inner, at),
            ExprKind::Broken(parts) => {
                for part in parts {
                    let is_called = matches!(&part.kind, ExprKind::Name(name)
                        if is_reserved(name) || matches!(self.names.get(name), Some(Binding::Function(_))));
                    if !is_called {
                        let _told = self.expr(part);
                    }
                }
                Err(Poison::Unknown)
            }
        }
    }

    /// Checks a function's body without values for its arguments.
    pub fn trial(&mut self, arguments: &[String], body: &Expr) {
        let local = |name: &String| Local { name: name.clone(), value: Err(Poison::Unknown), levels: 0 };
        self.locals = arguments.iter().map(local).collect();
        self.blindly(|e| e.expr(body).is_ok());
        self.locals.clear();
    }

    /// Runs `f` with locals that have no values.
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
            (Some(MatrixShape::SCALAR) | None, Ok(value)) => Ok(value.entries[0]),
            (Some(MatrixShape::SCALAR) | None, Err(poison)) => Err(poison),
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

    /// A whole number known at reading time.
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
            let value = if self.blind { Err(poisoned(shape_of(&local.value))) } else { local.value.clone() };
            self.charge_copy(&value, at)?;
            return value;
        }
        let fault = match self.names.get(name) {
            Some(Binding::Value(value)) => {
                let value = Ok(value.clone());
                self.charge_copy(&value, at)?;
                return value;
            }
            Some(Binding::Poisoned | Binding::Table(_)) => return Err(Poison::Unknown),
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
}
