//! `table("psf", s)` and `table("psf", u, v)`: the spline through a table's samples, as the polynomial of a cell.

use isophote_elementary::{Function1, Lookup};

use super::SCALAR;
use crate::language::elaborate::{Binding, Elaborator, Matrix, Poison, Worked, fault};
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::parser::{Expr, ExprKind};

impl Elaborator<'_> {
    pub(super) fn table(&mut self, arguments: &[Expr], at: &Expr) -> Worked {
        let Some((Expr { kind: ExprKind::Text(name) | ExprKind::Name(name), .. }, places)) = arguments.split_first()
        else {
            let fault = fault("arguments", at, "`table` takes the name of a table, and where to read it");
            return Err(self.tell(fault.help("write `table(\"psf\", s)`, or `table(\"psf\", u, v)`")));
        };
        let worked: Vec<_> = places.iter().map(|place| self.scalar(place)).collect();
        let number = match self.names.get(&format!("\"{name}\"")) {
            Some(Binding::Table(number)) => *number,
            Some(_) => return Err(SCALAR),
            None => {
                let fault = fault("unknown-name", at, format!("the document has no table {}", quoted(name)));
                let help = "declare it under `[tables]` with `first`, `step` and `values`; or name a file beside the document, from which `isophote` takes them";
                return Err(self.tell(fault.help(help)));
            }
        };
        let axes = self.graph.tables.all()[usize::from(number)].axes().to_vec();
        if worked.len() != axes.len() {
            let usage = ["table(\"psf\", s)", "table(\"psf\", u, v)"][axes.len() - 1];
            let message = format!("{} has {} axes, not {}", quoted(name), axes.len(), worked.len());
            return Err(self.tell(fault("arguments", at, message).help(format!("write `{usage}`"))));
        }
        let worked = worked.into_iter().collect::<Result<Vec<_>, Poison>>().map_err(|_| SCALAR)?;
        self.graph.set_span(self.span(at));
        let step = |(s, axis): (_, &isophote_elementary::Axis)| {
            self.graph.sum(-axis.first / axis.step, [(s, 1.0 / axis.step)])
        };
        let t: Vec<_> = worked.into_iter().zip(&axes).map(step).collect();
        if !t.iter().all(|t| self.graph.has_finite_numbers(*t)) {
            let message = format!("places divided by the step of {} are too large for a number", quoted(name));
            let help = "make the table's `step` larger, or the numbers in the formula smaller";
            return Err(self.tell(fault("bad-number", at, message).help(help)));
        }
        let f: Vec<_> = t.iter().map(|t| self.graph.call1(Function1::Fraction, *t)).collect();
        let mut terms = Vec::new();
        for coefficient in 0..self.graph.tables.all()[usize::from(number)].coefficients() as u8 {
            let lookup = Lookup { table: number, coefficient };
            let value = self.graph.gather(lookup, t[0], t[t.len() - 1]);
            let powers = f.iter().zip([coefficient % 4, coefficient / 4]).map(|(f, power)| (*f, power.into()));
            let term = self.graph.product(1.0, powers.chain([(value, 1)]).collect::<Vec<_>>());
            terms.push((term, 1.0));
        }
        Ok(Matrix::scalar(self.graph.sum(0.0, terms)))
    }
}
