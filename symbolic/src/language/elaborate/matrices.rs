//! Vectors and matrices: all operands are elaborated before shapes are checked.

use super::{Elaborator, Matrix, MatrixShape, Poison, Worked, fault, poisoned, shape_of};
use crate::graph::NodeId;
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::Expr;

impl Elaborator<'_> {
    pub(super) fn list(&mut self, list: &[Expr], at: &Expr) -> Worked {
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
        let shape = columns.filter(|_| rows.iter().all(|r| shape_of(r).is_some())).map(|c| MatrixShape(list.len(), c));
        let rows = rows.into_iter().collect::<Result<Vec<_>, _>>().map_err(|_| poisoned(shape))?;
        let entries: Vec<NodeId> = rows.into_iter().flat_map(|r| r.entries).collect();
        Ok(Matrix { rows: list.len(), columns: entries.len() / list.len(), entries })
    }

    pub(super) fn sum(&mut self, terms: &[(bool, Expr)], at: &Expr) -> Worked {
        let parts: Vec<_> = terms.iter().map(|(minus, term)| (*minus, term, self.number_matrix(term))).collect();
        self.add(parts, at)
    }

    /// Adds elaborated parts; true means subtracted.
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
        let MatrixShape(rows, columns) = first.unwrap_or(MatrixShape::SCALAR);
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
            && shape != MatrixShape::SCALAR
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
        let shape = if right == MatrixShape::SCALAR {
            left
        } else if left == MatrixShape::SCALAR {
            right
        } else if left.1 == right.0 {
            MatrixShape(left.0, right.1)
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
            let message =
                format!("a matrix has at most {} entries, this product {}", LIMITS.entries, shape.0 * shape.1);
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

    pub(super) fn power(&mut self, base: &Expr, exponent: &Expr, at: &Expr) -> Worked {
        let base_at = base;
        let (base, power) = (self.scalar(base), self.scalar(exponent));
        let value = power.ok().and_then(|p| self.graph.value_of(p));
        if let Some(value) = value
            && value.abs() > LIMITS.exponent as f64
        {
            let shown = if value.abs() < 1e6 { value.to_string() } else { format!("{value:e}") };
            let message = format!("the exponent {shown} is larger than {}", LIMITS.exponent);
            let fault = fault("limit", exponent, message).help("use exp(n*log(x)) where that is what you mean");
            self.tell(fault);
            return Err(Poison::Numbers(MatrixShape::SCALAR));
        }
        let (Ok(base), Ok(power)) = (base, power) else { return Err(Poison::Numbers(MatrixShape::SCALAR)) };
        if let (None, Some(number)) = (value, self.graph.value_of(base))
            && number <= 0.0
        {
            let message =
                format!("the base of a power is positive where its exponent is no number, and this is {number}");
            let help = "write the sign outside, or choose the value by `if(condition, a, b)`";
            self.tell(fault("bad-number", base_at, message).help(help));
            return Err(Poison::Numbers(MatrixShape::SCALAR));
        }
        self.graph.set_span(self.span(at));
        Ok(Matrix::scalar(self.graph.power(base, power)))
    }

    pub(super) fn transpose(&mut self, inner: &Expr) -> Worked {
        let inner = self.number_matrix(inner).map_err(|poison| match poison {
            Poison::Numbers(MatrixShape(rows, columns)) => Poison::Numbers(MatrixShape(columns, rows)),
            _ => Poison::Unknown,
        })?;
        let entry = |i: usize| inner.entries[(i % inner.rows) * inner.columns + i / inner.rows];
        let entries = (0..inner.entries.len()).map(entry).collect();
        Ok(Matrix { rows: inner.columns, columns: inner.rows, entries })
    }

    pub(super) fn index(&mut self, inner: &Expr, indices: &[Expr], at: &Expr) -> Worked {
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
        let result = if row_is_result { MatrixShape(shape.1, 1) } else { MatrixShape::SCALAR };
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
}
