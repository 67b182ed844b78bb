//! Calls in formulas: elementary functions, conditions, user functions; [`series`] has `sum` and `product`.

mod series;
mod table;

use std::rc::Rc;

use isophote_elementary::{Function1, Function2};

use crate::graph::{Node, NodeId};
use crate::language::elaborate::unknown::NO_FUNCTION;
use crate::language::elaborate::{
    Binding, Elaborator, Function, Local, Matrix, MatrixShape, Poison, REMEMBERED, Worked, fault, shape_of,
};
use crate::program::Comparison;
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::Expr;

/// Maximum nesting of user function calls.
const CALLS_MAX: usize = LIMITS.depth / 4;

/// Overhead of a cached call, in entries.
const CALL: usize = 32;

/// A number of unknown value.
const SCALAR: Poison = Poison::Numbers(MatrixShape::SCALAR);

impl Elaborator<'_> {
    /// Reports a wrong number of arguments; they are checked all the same.
    fn count(&mut self, name: &str, arguments: &[Expr], wanted: usize, usage: &str, at: &Expr) -> Result<(), Poison> {
        if arguments.len() == wanted {
            return Ok(());
        }
        let plural = if wanted == 1 { "" } else { "s" };
        let message = format!("{} takes {wanted} argument{plural}, not {}", quoted(name), arguments.len());
        self.tell(fault("arguments", at, message).help(format!("write `{usage}`")));
        self.check(arguments);
        Err(Poison::Unknown)
    }

    /// Elaborates parts for their faults only.
    fn check(&mut self, parts: &[Expr]) {
        for part in parts {
            let _told = self.expr(part);
        }
    }

    pub fn call(&mut self, name: &str, arguments: &[Expr], at: &Expr) -> Worked {
        match self.names.get(name) {
            Some(Binding::Function(function)) => {
                let function = function.clone();
                let usage = format!("{name}({})", function.arguments.join(", "));
                self.count(name, arguments, function.arguments.len(), &usage, at)?;
                return self.call_own(name, &function, arguments, at);
            }
            Some(Binding::Poisoned) => {
                self.check(arguments);
                return Err(Poison::Unknown);
            }
            _ => {}
        }
        if let Some(function) = Function1::named(name) {
            return self.call_elementary(name, arguments, at, |e, x| e.graph.call1(function, x));
        }
        match name {
            "sqrt" => self.call_elementary(name, arguments, at, |e, x| e.graph.sqrt(x)),
            "abs" => self.call_elementary(name, arguments, at, |e, x| e.graph.abs(x)),
            "atan2" => {
                self.count(name, arguments, 2, "atan2(y, x)", at)?;
                let (y, x) = (self.scalar(&arguments[0]), self.scalar(&arguments[1]));
                let (Ok(y), Ok(x)) = (y, x) else { return Err(SCALAR) };
                self.graph.set_span(self.span(at));
                Ok(Matrix::scalar(self.graph.call2(Function2::Atan2, y, x)))
            }
            "min" | "max" => self.extreme(name, arguments, at),
            "if" => {
                self.count(name, arguments, 3, "if(condition, a, b)", at)?;
                self.choose(arguments, at)
            }
            "piecewise" => {
                if arguments.len() >= 3 && !arguments.len().is_multiple_of(2) {
                    return self.choose(arguments, at);
                }
                let message = "`piecewise` takes pairs of condition and value, then what holds otherwise";
                self.tell(fault("arguments", at, message).help("write `piecewise(c1, e1, c2, e2, otherwise)`"));
                self.check(arguments);
                Err(Poison::Unknown)
            }
            "sum" | "product" => self.series(name, arguments, at),
            "table" => self.table(arguments, at),
            _ => {
                let is_declared = self.names.contains_key(name) || self.locals.iter().any(|l| l.name == name);
                if is_declared || name == "pi" {
                    let fault = fault("syntax", at, format!("{} is not a function", quoted(name)));
                    self.tell(fault.help("there is no implicit multiplication: write `*`"));
                } else {
                    self.unknown(name, at, NO_FUNCTION);
                }
                self.check(arguments);
                Err(Poison::Unknown)
            }
        }
    }

    fn call_elementary(
        &mut self,
        name: &str,
        arguments: &[Expr],
        at: &Expr,
        make: impl Fn(&mut Self, NodeId) -> NodeId,
    ) -> Worked {
        self.count(name, arguments, 1, &format!("{name}(x)"), at)?;
        let argument = self.scalar(&arguments[0]).map_err(|_| SCALAR)?;
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(make(self, argument)))
    }

    fn extreme(&mut self, name: &str, arguments: &[Expr], at: &Expr) -> Worked {
        if arguments.len() < 2 {
            self.count(name, arguments, 2, &format!("{name}(a, b)"), at)?;
        }
        let values: Vec<_> = arguments.iter().map(|a| self.scalar(a)).collect();
        let values = values.into_iter().collect::<Result<Vec<_>, _>>().map_err(|_| SCALAR)?;
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(values[1..].iter().fold(values[0], |best, next| self.extreme_of_two(name, best, *next))))
    }

    /// The minimum or maximum; if one of them is NaN, the other. With NaN the comparison fails and selects `b`: the one
    /// that cannot be NaN, or else one with a NaN test.
    fn extreme_of_two(&mut self, name: &str, first: NodeId, second: NodeId) -> NodeId {
        let is_last = self.graph.may_lack_value(first) || !self.graph.may_lack_value(second);
        let (a, b) = if is_last { (first, second) } else { (second, first) };
        let is_a = match name {
            "min" => self.comparison(Comparison::Lt, a, b),
            _ => self.comparison(Comparison::Lt, b, a),
        };
        if let Some(is_a) = self.known_truth(is_a) {
            return if is_a { a } else { b };
        }
        let is_a = match self.graph.may_lack_value(b) {
            true => {
                let is_missing = self.comparison(Comparison::Ne, b, b);
                self.graph.or(is_a, is_missing)
            }
            false => is_a,
        };
        self.graph.select(is_a, a, b)
    }

    /// `piecewise(c1, e1, …, otherwise)`; `if` is the shortest. A branch that is known not to be taken may be invalid:
    /// it is checked without the indices and arguments that exclude it.
    fn choose(&mut self, arguments: &[Expr], at: &Expr) -> Worked {
        let conditions: Vec<_> = arguments.chunks_exact(2).map(|pair| self.truth(&pair[0])).collect();
        let known: Vec<_> = conditions.iter().map(|c| c.ok().and_then(|c| self.known_truth(c))).collect();
        let taken = known.iter().position(|k| *k == Some(true)).unwrap_or(known.len());
        let mut first: Option<MatrixShape> = None;
        let mut branches = Vec::new();
        for i in 0..=conditions.len() {
            let part = arguments.get(2 * i + 1).unwrap_or(&arguments[arguments.len() - 1]);
            let is_possible = i <= taken && known.get(i) != Some(&Some(false));
            if !is_possible {
                self.blindly(|e| e.number_matrix(part).is_ok());
                continue;
            }
            let value = self.number_matrix(part);
            if let (Some(shape), Some(first)) = (shape_of(&value), first)
                && shape != first
            {
                let fault = fault("shape", part, format!("one branch is {first}, this one {shape}"));
                return Err(self.tell(fault.help("all branches of a condition have one shape")));
            }
            first = first.or(shape_of(&value));
            branches.push((i, value));
        }
        let poison = first.map_or(Poison::Unknown, Poison::Numbers);
        self.graph.set_span(self.span(at));
        let mut result: Worked = Err(poison);
        let last = branches.len() - 1;
        let mut whole = true;
        for (k, (i, value)) in branches.into_iter().enumerate().rev() {
            let Ok(value) = value else {
                whole = false;
                continue;
            };
            result = match (conditions.get(i), result) {
                _ if k == last => Ok(value),
                (Some(Ok(condition)), Ok(result)) => {
                    let pairs = value.entries.iter().zip(&result.entries);
                    let entries = pairs.map(|(a, b)| self.graph.select(*condition, *a, *b)).collect();
                    Ok(Matrix { entries, ..value })
                }
                _ => Err(poison),
            };
        }
        if whole && conditions.iter().all(Result::is_ok) { result } else { Err(poison) }
    }

    fn call_own(&mut self, name: &str, function: &Rc<Function>, arguments: &[Expr], at: &Expr) -> Worked {
        let mut locals = Vec::with_capacity(arguments.len());
        for (argument, name) in arguments.iter().zip(&function.arguments) {
            let outer = self.cache.begin();
            let value = self.number_matrix(argument);
            // Keeps a power of a product: 1 + k·t² is computed from t.
            let whole = |n: &&NodeId| matches!(self.graph.node(**n), Node::Product(_));
            let products: Vec<NodeId> = value.iter().flat_map(|v| v.entries.iter().filter(whole).copied()).collect();
            products.into_iter().for_each(|n| self.graph.set_opaque(n));
            locals.push(Local { name: name.clone(), value, levels: self.cache.resume(outer) });
        }
        // The body is checked at its definition.
        let values =
            locals.iter().map(|l| l.value.clone()).collect::<Result<Vec<_>, _>>().map_err(|_| Poison::Unknown)?;
        let entries = values.iter().map(|value| value.entries.len()).sum::<usize>();
        self.charge(4 + entries / 4, at)?;
        let key = (name.to_string(), values);
        if let Some(known) = self.workings.results.get(&key) {
            return Ok(known.clone());
        }
        if self.calls == CALLS_MAX {
            let message = format!("calls are nested more than {CALLS_MAX} deep at {}", quoted(name));
            return Err(self.tell(fault("limit", at, message).help("give inner results a definition of their own")));
        }
        let outer_locals = std::mem::replace(&mut self.locals, locals);
        let outer_text = std::mem::replace(&mut self.text, function.text.clone());
        let outer_faults = (std::mem::take(&mut self.faults), std::mem::take(&mut self.told));
        let context = self.cache.enter_call(at);
        self.calls += 1;
        let result = self.expr(&function.body);
        self.calls -= 1;
        self.cache.leave_call(context);
        self.locals = outer_locals;
        self.text = outer_text;
        let inner = std::mem::take(&mut self.faults);
        (self.faults, self.told) = outer_faults;
        // The caller gets the first fault: its arguments cause it.
        if let Some(mut first) = inner.into_iter().next() {
            if first.code != "limit" {
                first.message = format!("in {}: {}", quoted(name), first.message);
            }
            return Err(self.tell(isophote_syntax::parser::Fault { start: at.start, end: at.end, ..first }));
        }
        if let Ok(value) = &result {
            let entries = entries + value.entries.len() + CALL;
            if self.workings.remembered + entries <= REMEMBERED {
                self.workings.remembered += entries;
                self.workings.results.insert(key, value.clone());
            }
        }
        result
    }
}
