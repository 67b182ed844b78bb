//! Calls in formulas: elementary functions, conditions, `sum` and `product`, the user's own functions.

use crate::diagnostic::quoted;
use crate::document::Text;
use crate::elaborate::{Binding, Elaborator, Matrix, POISONED, Worked, fault, is_reserved};
use crate::function::{Function1, Function2};
use crate::limits::LIMITS;
use crate::parser::{Expr, Fault, Kind};
use crate::program::Comparison;

impl Elaborator<'_> {
    fn count(&self, name: &str, arguments: &[Expr], wanted: usize, usage: &str, at: &Expr) -> Result<(), Fault> {
        if arguments.len() == wanted {
            return Ok(());
        }
        let message = format!(
            "{} takes {wanted} argument{}, not {}",
            quoted(name),
            if wanted == 1 { "" } else { "s" },
            arguments.len()
        );
        Err(fault("arguments", at, message).help(format!("write `{usage}`")))
    }

    pub fn call(&mut self, name: &str, arguments: &[Expr], at: &Expr) -> Worked {
        if let Some(Binding::Function(names, body, text)) = self.names.get(name) {
            let (names, body, text) = (names.clone(), body.clone(), text.clone());
            self.count(name, arguments, names.len(), &format!("{name}({})", names.join(", ")), at)?;
            return self.call_own(name, (names, body, text), arguments, at);
        }
        if let Some(function) = Function1::named(name) {
            self.count(name, arguments, 1, &format!("{name}(x)"), at)?;
            let argument = self.scalar(&arguments[0])?;
            self.graph.set_span(self.span(at));
            return Ok(Matrix::scalar(self.graph.call1(function, argument)));
        }
        let scalar = match name {
            "sqrt" | "abs" => {
                self.count(name, arguments, 1, &format!("{name}(x)"), at)?;
                let argument = self.scalar(&arguments[0])?;
                self.graph.set_span(self.span(at));
                if name == "sqrt" { self.graph.sqrt(argument) } else { self.graph.abs(argument) }
            }
            "atan2" => {
                self.count(name, arguments, 2, "atan2(y, x)", at)?;
                let (y, x) = (self.scalar(&arguments[0])?, self.scalar(&arguments[1])?);
                self.graph.set_span(self.span(at));
                self.graph.call2(Function2::Atan2, y, x)
            }
            "min" | "max" => {
                if arguments.len() < 2 {
                    self.count(name, arguments, 2, &format!("{name}(a, b)"), at)?;
                }
                let mut best = self.scalar(&arguments[0])?;
                for argument in &arguments[1..] {
                    let next = self.scalar(argument)?;
                    self.graph.set_span(self.span(at));
                    let (a, b) = if name == "min" { (best, next) } else { (next, best) };
                    let keep = self.graph.compare(Comparison::Lt, a, b);
                    best = self.graph.select(keep, best, next);
                }
                best
            }
            "if" => {
                self.count(name, arguments, 3, "if(condition, a, b)", at)?;
                return self.choose(arguments, at);
            }
            "piecewise" => {
                if arguments.len() < 3 || arguments.len().is_multiple_of(2) {
                    let fault = fault(
                        "arguments",
                        at,
                        "`piecewise` takes pairs of condition and value, then what holds otherwise",
                    );
                    return Err(fault.help("write `piecewise(c1, e1, c2, e2, otherwise)`"));
                }
                return self.choose(arguments, at);
            }
            "sum" | "product" => return self.series(name, arguments, at),
            _ => {
                if matches!(self.names.get(name), Some(Binding::Poisoned)) {
                    return Err(fault(POISONED, at, ""));
                }
                if self.names.contains_key(name) || self.locals.iter().any(|(n, _)| n == name) {
                    let fault = fault("syntax", at, format!("{} is not a function", quoted(name)));
                    return Err(fault.help("there is no implicit multiplication: write `*`"));
                }
                return Err(self.unknown(name, at, "is not a function"));
            }
        };
        Ok(Matrix::scalar(scalar))
    }

    /// `piecewise(c1, e1, …, otherwise)`; `if` is the shortest.
    fn choose(&mut self, arguments: &[Expr], at: &Expr) -> Worked {
        let mut result = self.number_matrix(&arguments[arguments.len() - 1])?;
        for pair in arguments[..arguments.len() - 1].chunks(2).rev() {
            let condition = self.truth(&pair[0])?;
            let value = self.number_matrix(&pair[1])?;
            if (value.rows, value.columns) != (result.rows, result.columns) {
                let message = format!("one branch is {}, the other {}", value.shape(), result.shape());
                return Err(fault("shape", &pair[1], message));
            }
            self.graph.set_span(self.span(at));
            let pairs = value.entries.iter().zip(&result.entries);
            let entries = pairs.map(|(a, b)| self.graph.select(condition, *a, *b)).collect();
            result = Matrix { entries, ..value };
        }
        Ok(result)
    }

    /// `sum(e, i, lo, hi)`, `product(e, i, lo, hi)`.
    fn series(&mut self, name: &str, arguments: &[Expr], at: &Expr) -> Worked {
        self.count(name, arguments, 4, &format!("{name}(e, i, lo, hi)"), at)?;
        let Kind::Name(index) = &arguments[1].kind else {
            let fault =
                fault("syntax", &arguments[1], format!("the second argument of `{name}` is the name of its index"));
            return Err(fault.help(format!("write `{name}(e, i, lo, hi)`")));
        };
        if is_reserved(index) || self.names.contains_key(index) {
            let fault = fault("duplicate", &arguments[1], format!("{} already has a meaning", quoted(index)));
            return Err(fault.help("choose another name for the index"));
        }
        let (lo, hi) = (self.whole(&arguments[2], "a bound")?, self.whole(&arguments[3], "a bound")?);
        if hi - lo >= LIMITS.terms as i64 {
            return Err(fault("limit", at, format!("`{name}` has at most {} terms", LIMITS.terms)));
        }
        let mut total: Option<Matrix> = None;
        for i in lo..=hi {
            let number = self.graph.number(i as f64);
            self.locals.push((index.clone(), Matrix::scalar(number)));
            let term = self.number_matrix(&arguments[0]);
            self.locals.pop();
            let term = term?;
            self.graph.set_span(self.span(at));
            total = Some(match total {
                None => term,
                Some(so_far) if name == "product" => self.multiply(so_far, term, at)?,
                Some(mut so_far) => {
                    for (a, b) in so_far.entries.iter_mut().zip(&term.entries) {
                        *a = self.graph.add2(*a, *b);
                    }
                    so_far
                }
            });
        }
        let empty = if name == "sum" { 0.0 } else { 1.0 };
        Ok(total.unwrap_or_else(|| Matrix::scalar(self.graph.number(empty))))
    }

    fn call_own(
        &mut self,
        name: &str,
        (names, body, text): (Vec<String>, Expr, Text),
        arguments: &[Expr],
        at: &Expr,
    ) -> Worked {
        if self.calls >= LIMITS.depth / 4 {
            let message =
                format!("calls are nested more than {} deep: does {} call itself?", LIMITS.depth / 4, quoted(name));
            return Err(fault("limit", at, message));
        }
        let values = arguments.iter().map(|a| self.number_matrix(a)).collect::<Result<Vec<_>, _>>()?;
        let outer_locals = std::mem::replace(&mut self.locals, names.into_iter().zip(values).collect());
        let outer_text = std::mem::replace(&mut self.text, text);
        self.calls += 1;
        let result = self.expr(&body);
        self.calls -= 1;
        self.text = outer_text;
        self.locals = outer_locals;
        result.map_err(|inner| Fault {
            message: format!("in `{name}`: {}", inner.message),
            start: at.start,
            end: at.end,
            ..inner
        })
    }
}
