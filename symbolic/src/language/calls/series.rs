//! `sum(e, i, lo, hi)` and `product(e, i, lo, hi)`, elaborated in factored form: parts independent of the index leave
//! the sum before it is expanded: Σ (a + c g(i)) = n a + c Σ g(i), Π c g(i) = cⁿ Π g(i).

use crate::language::elaborate::{Elaborator, Local, Matrix, MatrixShape, Poison, Task, Worked, fault, shape_of};
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::{Expr, ExprKind};
use isophote_syntax::words::is_reserved;

use super::SCALAR;

/// Maximum nesting of sums, including those of called functions.
const SUMS_MAX: usize = 16;

/// Longer sums are not flattened into others.
const LONG: usize = 64;

/// A range and its operation.
struct Series<'e> {
    index: &'e str,
    lo: i64,
    hi: i64,
    is_sum: bool,
    /// The enclosing sums whose index its bounds read.
    levels: u64,
}

impl Series<'_> {
    fn terms(&self) -> i64 {
        self.hi - self.lo + 1
    }
}

impl Elaborator<'_> {
    /// `sum(e, i, lo, hi)`, `product(e, i, lo, hi)`.
    pub(super) fn series(&mut self, name: &str, arguments: &[Expr], at: &Expr) -> Worked {
        let usage = format!("{name}(e, i, lo, hi)");
        let [body, index, lo, hi] = arguments else {
            let message = format!("`{name}` takes 4 arguments, not {}", arguments.len());
            return Err(self.tell(fault("arguments", at, message).help(format!("write `{usage}`"))));
        };
        let outer = self.cache.begin();
        let (lo, hi) = (self.whole(lo, "a bound"), self.whole(hi, "a bound"));
        let levels = self.cache.resume(outer);
        let ExprKind::Name(index) = &index.kind else {
            let message = format!("the second argument of `{name}` is the name of its index");
            return Err(self.tell(fault("syntax", index, message).help(format!("write `{usage}`"))));
        };
        let is_taken = self.names.contains_key(index) || self.locals.iter().any(|l| l.name == *index);
        if is_reserved(index) || is_taken {
            let fault = fault("duplicate", &arguments[1], format!("{} already has a meaning", quoted(index)));
            self.tell(fault.help("choose another name for the index"));
            return Err(self.unexpanded(index, body));
        }
        let (Ok(lo), Ok(hi)) = (lo, hi) else { return Err(self.unexpanded(index, body)) };
        if hi - lo >= LIMITS.terms as i64 {
            let message = format!("`{name}` has at most {} terms, this one {}", LIMITS.terms, hi - lo + 1);
            self.tell(fault("limit", at, message).help("shorten the range"));
            return Err(self.unexpanded(index, body));
        }
        let series = Series { index, lo, hi, is_sum: name == "sum", levels };
        if series.terms() <= 0 {
            let shape = match self.unexpanded(index, body) {
                Poison::Numbers(shape) => shape,
                _ => MatrixShape::SCALAR,
            };
            return self.empty(shape, series.is_sum);
        }
        if self.cache.depth() == SUMS_MAX {
            let message = format!("sums are nested at most {SUMS_MAX} deep");
            return Err(self.tell(fault("limit", at, message).help("give the inner sum a definition of its own")));
        }
        self.total(&series, body)
    }

    /// Checks the body of a sum without a value for its index; returns its shape, if known.
    fn unexpanded(&mut self, index: &str, body: &Expr) -> Poison {
        self.locals.push(Local { name: index.into(), value: Err(SCALAR), levels: 0 });
        let value = self.blindly(|e| e.number_matrix(body));
        self.locals.pop();
        shape_of(&value).map_or(Poison::Unknown, Poison::Numbers)
    }

    /// An empty sum is 0, an empty product the identity, in the shape of the body.
    fn empty(&mut self, MatrixShape(rows, columns): MatrixShape, is_sum: bool) -> Worked {
        let entry = |i: usize| if !is_sum && i / columns == i % columns { 1.0 } else { 0.0 };
        let entries = (0..rows * columns).map(|i| self.graph.number(entry(i))).collect();
        Ok(Matrix { rows, columns, entries })
    }

    /// Σ or Π of `body`, which may be a part of the formula's summand.
    fn total(&mut self, series: &Series<'_>, body: &Expr) -> Worked {
        // The following walks the body to find the parts that depend on the index.
        self.charge(1 + (body.end - body.start) / 32, body)?;
        self.remembered(Task::Total, body, |e| {
            e.cache.reads(series.levels);
            let total = e.total_anew(series, body)?;
            e.finite(total, body)
        })
    }

    fn total_anew(&mut self, series: &Series<'_>, body: &Expr) -> Worked {
        if !mentions(body, series.index) {
            let value = self.number_matrix(body)?;
            return self.repeated(series, value, body);
        }
        match (&body.kind, series.is_sum) {
            (ExprKind::Sum(terms), true) => {
                let parts: Vec<_> =
                    terms.iter().map(|(minus, term)| (*minus, term, self.total(series, term))).collect();
                self.add(parts, body)
            }
            (ExprKind::Negate(inner), true) => {
                let inner = self.total(series, inner)?;
                self.graph.set_span(self.span(body));
                Ok(self.map(inner, |graph, n| graph.scale(-1.0, n)))
            }
            (ExprKind::Product(factors), _) => self.total_of_product(series, factors, body),
            (ExprKind::Call(..), true) => match unfolded(body) {
                Some(Expr { kind: ExprKind::Product(factors), .. }) => self.total_of_product(series, &factors, body),
                _ => self.expanded(series, body, |e| e.number_matrix(body)),
            },
            _ => self.expanded(series, body, |e| e.number_matrix(body)),
        }
    }

    /// Σ or Π of a value independent of the index.
    fn repeated(&mut self, series: &Series<'_>, value: Matrix, body: &Expr) -> Worked {
        let count = series.terms();
        self.graph.set_span(self.span(body));
        match (series.is_sum, value.size()) {
            (true, _) => Ok(self.map(value, |graph, n| graph.scale(count as f64, n))),
            (false, MatrixShape::SCALAR) => Ok(self.map(value, |graph, n| graph.product(1.0, [(n, count as i32)]))),
            (false, _) => self.expanded(series, body, |_| Ok(value.clone())),
        }
    }

    fn total_of_product(&mut self, series: &Series<'_>, factors: &[(bool, Expr)], body: &Expr) -> Worked {
        let depends: Vec<bool> = factors.iter().map(|(_, factor)| mentions(factor, series.index)).collect();
        let count = depends.iter().filter(|d| **d).count();
        let lone = depends.iter().position(|d| *d).filter(|i| count == 1 && !factors[*i].0 && series.is_sum);
        if let Some(lone) = lone {
            // Only one factor depends on the index: all others keep their position, whatever their shape.
            let mut total: Option<Worked> = None;
            for (i, (inverse, factor)) in factors.iter().enumerate() {
                let value = if i == lone { self.total(series, factor) } else { self.number_matrix(factor) };
                total = Some(match total {
                    None => value,
                    Some(total) if *inverse => self.divide(total, value, factor, body),
                    Some(total) => self.multiply(total, value, factor, body),
                });
            }
            return total.unwrap_or(Err(Poison::Unknown));
        }
        // With several dependent factors, scalars may leave.
        let mut free = Vec::new();
        let mut rest = Vec::new();
        for (pair, depends) in factors.iter().zip(depends) {
            let value = if depends { None } else { Some(self.number_matrix(&pair.1)) };
            match value {
                Some(Ok(value)) if value.size() == MatrixShape::SCALAR => free.push((pair, value)),
                _ => rest.push(pair),
            }
        }
        let mut total = self.expanded(series, body, |e| e.product(rest.iter().copied(), body));
        for ((inverse, factor), value) in free {
            let value = if series.is_sum { Ok(value) } else { self.repeated(series, value, factor) };
            total = if *inverse {
                self.divide(total, value, factor, body)
            } else {
                self.multiply(total, value, factor, body)
            };
        }
        total
    }

    /// Expands term by term: evaluates `term` for each value of the index.
    fn expanded(&mut self, series: &Series<'_>, at: &Expr, term: impl Fn(&mut Self) -> Worked) -> Worked {
        let bit = self.cache.enter_sum();
        let mut terms: Vec<Matrix> = Vec::new();
        let mut poison = None;
        for i in series.lo..=series.hi {
            self.cache.step();
            let number = self.graph.number(i as f64);
            let value = Ok(Matrix::scalar(number));
            self.locals.push(Local { name: series.index.into(), value, levels: bit });
            let value = term(self);
            self.locals.pop();
            match value {
                Ok(value) => terms.push(value),
                Err(failed) => poison = Some(failed),
            }
            if poison.is_some() {
                break;
            }
        }
        self.cache.leave_sum(bit);
        if let Some(poison) = poison {
            return Err(poison);
        }
        let shape = terms[0].size();
        if let Some(other) = terms.iter().find(|t| t.size() != shape) {
            let message = format!("one term is {shape}, another {}", other.size());
            return Err(self.tell(fault("shape", at, message).help("all terms have one shape")));
        }
        self.charge(terms.len(), at)?;
        self.graph.set_span(self.span(at));
        if series.is_sum {
            let entry = |k: usize| terms.iter().map(move |t| (t.entries[k], 1.0)).collect::<Vec<_>>();
            let entries: Vec<_> = (0..shape.0 * shape.1).map(|k| self.graph.sum(0.0, entry(k))).collect();
            // A long one stays opaque: else each use would copy its terms.
            entries.iter().filter(|_| terms.len() > LONG).for_each(|n| self.graph.set_opaque(*n));
            return Ok(Matrix { rows: shape.0, columns: shape.1, entries });
        }
        if shape == MatrixShape::SCALAR {
            return Ok(Matrix::scalar(self.graph.product(1.0, terms.iter().map(|t| (t.entries[0], 1)))));
        }
        let mut terms = terms.into_iter().map(Ok);
        let first = terms.next().unwrap_or(Err(Poison::Unknown));
        terms.fold(first, |total, term| self.multiply(total, term, at, at))
    }
}

/// Rewrites Σ c g(j) as c Σ g(j) if one factor alone depends on j, so that the enclosing sum can factor out c.
fn unfolded(sum: &Expr) -> Option<Expr> {
    let ExprKind::Call(name, arguments) = &sum.kind else { return None };
    let ("sum", [body, index, lo, hi]) = (name.as_str(), &arguments[..]) else { return None };
    let ExprKind::Name(name) = &index.kind else { return None };
    let body = unfolded(body).unwrap_or_else(|| body.clone());
    let ExprKind::Product(mut factors) = body.kind else { return None };
    let mut dependent = (0..factors.len()).filter(|i| mentions(&factors[*i].1, name));
    let (Some(lone), None) = (dependent.next(), dependent.next()) else { return None };
    let (inverse, factor) = factors[lone].clone();
    if inverse {
        return None;
    }
    // Unique bytes, by which the cache distinguishes parts of a formula.
    let (start, end) = (sum.start, factor.end);
    let arguments = vec![factor, index.clone(), lo.clone(), hi.clone()];
    factors[lone].1 = Expr { kind: ExprKind::Call("sum".into(), arguments), start, end };
    Some(Expr { kind: ExprKind::Product(factors), start: sum.start, end: sum.end })
}

/// True when the expression reads the name.
fn mentions(expr: &Expr, name: &str) -> bool {
    let any = |list: &[Expr]| list.iter().any(|e| mentions(e, name));
    match &expr.kind {
        ExprKind::Number(_) | ExprKind::Text(_) => false,
        ExprKind::Name(own) => own == name,
        ExprKind::List(list) | ExprKind::Joined(_, list) | ExprKind::Broken(list) | ExprKind::Call(_, list) => {
            any(list)
        }
        ExprKind::Sum(parts) | ExprKind::Product(parts) => parts.iter().any(|(_, e)| mentions(e, name)),
        ExprKind::Negate(a) | ExprKind::Transpose(a) | ExprKind::Not(a) => mentions(a, name),
        ExprKind::Power(a, b) | ExprKind::Compare(_, a, b) => mentions(a, name) || mentions(b, name),
        ExprKind::Index(a, list) => mentions(a, name) || any(list),
    }
}

#[cfg(test)]
#[path = "series_tests.rs"]
mod tests;
