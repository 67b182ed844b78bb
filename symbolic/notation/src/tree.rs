//! An expression as it is written down, before a notation is chosen: what `text`, `latex` and `mathml` have in common.
//!
//! What comes in: nodes of the graph, from `explain`. What goes out: lines `name = tree`. A tree never knows how it will look;
//! it is never deeper than [`WIDTH`], because what is wider than that gets a name of its own, so it may be walked recursively.

use isophote_symbolic::{Comparison, Span};

/// Characters of plain text beyond which an expression gets a line and a name of its own.
pub(crate) const WIDTH: usize = 120;
/// Characters of plain text on one row of a sum that is broken over rows.
const ROW: usize = 72;

/// `left = right`.
pub(crate) struct Equation {
    pub left: Tree,
    pub right: Tree,
}

/// An expression, and where in the document the operation came from.
#[derive(Clone)]
pub(crate) struct Tree {
    pub kind: Expression,
    pub span: Option<Span>,
}

/// Coefficient times body; without a body, a number.
#[derive(Clone)]
pub(crate) struct Addend {
    pub coefficient: f64,
    pub body: Option<Tree>,
}

/// The expressions there are.
#[derive(Clone)]
pub(crate) enum Expression {
    Number(f64),
    /// A name of the document, or one that `explain` gave.
    Name(String),
    /// A parameter's value at the pass' entry.
    Entry(String),
    /// A channel's saturation limit.
    Saturation(String),
    /// How far a coordinate is shifted.
    Shift(String),
    Sum(Vec<Addend>),
    Product(Vec<(Tree, i32)>),
    Sqrt(Box<Tree>),
    Abs(Box<Tree>),
    Call(&'static str, Vec<Tree>),
    Power(Box<Tree>, Box<Tree>),
    Compare(Comparison, Box<Tree>, Box<Tree>),
    And(Box<Tree>, Box<Tree>),
    Or(Box<Tree>, Box<Tree>),
    Not(Box<Tree>),
    /// Condition, value, otherwise.
    Select(Box<Tree>, Box<Tree>, Box<Tree>),
    /// A sum over `rows` or `pixels`.
    Total(&'static str, Box<Tree>),
    /// The function's derivative by the parameters.
    Derivative(String, Vec<String>),
}

impl Tree {
    pub fn name(name: impl Into<String>) -> Tree {
        Tree { kind: Expression::Name(name.into()), span: None }
    }

    /// Stands beside a factor, or under an exponent, only in brackets.
    pub fn is_loose(&self) -> bool {
        use Expression::*;
        matches!(self.kind, Sum(_) | Compare(..) | And(..) | Or(..) | Not(_) | Select(..))
    }

    /// One sign or one name with its index, or something with brackets of its own: takes an exponent as it is.
    pub fn is_closed(&self) -> bool {
        match &self.kind {
            Expression::Number(value) => *value >= 0.0 && !needs_power_of_ten(*value),
            kind => matches!(kind, Expression::Name(_) | Expression::Sqrt(_) | Expression::Abs(_)),
        }
    }

    /// Its first sign is a digit: a coefficient before it needs a dot between.
    pub fn starts_with_digit(&self) -> bool {
        match &self.kind {
            Expression::Number(_) => true,
            Expression::Power(base, _) => base.starts_with_digit(),
            _ => false,
        }
    }

    /// The value chosen first, then the others with their conditions, then what is left: nested `if`s as one list.
    pub fn cases(&self) -> (Vec<(&Tree, &Tree)>, &Tree) {
        let (mut cases, mut rest) = (Vec::new(), self);
        while let Expression::Select(condition, value, otherwise) = &rest.kind {
            cases.push((value.as_ref(), condition.as_ref()));
            rest = otherwise;
        }
        (cases, rest)
    }

    /// A sum's terms, broken into rows; `None` if one row holds it.
    pub fn rows(&self) -> Option<Vec<&[Addend]>> {
        let Expression::Sum(terms) = &self.kind else { return None };
        let (mut rows, mut start, mut width) = (Vec::new(), 0, 0);
        for (i, term) in terms.iter().enumerate() {
            let own = crate::text::terms(std::slice::from_ref(term)).chars().count() + 3;
            if i > start && width + own > ROW {
                rows.push(&terms[start..i]);
                (start, width) = (i, 0);
            }
            width += own;
        }
        rows.push(&terms[start..]);
        (rows.len() > 1).then_some(rows)
    }
}

/// A product's factors above and below the fraction bar, exponents positive.
pub(crate) fn fraction(factors: &[(Tree, i32)]) -> [Vec<(&Tree, u32)>; 2] {
    let side = |above: bool| {
        let factors = factors.iter().filter(|(_, e)| (*e > 0) == above);
        factors.map(|(tree, e)| (tree, e.unsigned_abs())).collect()
    };
    [side(true), side(false)]
}

/// So large or small that its digits alone would be mostly zeros.
pub(crate) fn needs_power_of_ten(value: f64) -> bool {
    value.is_finite() && value != 0.0 && !(1e-5..1e15).contains(&value.abs())
}

/// Mantissa and exponent of ten, shortest that reads back as the same number.
pub(crate) fn scientific(value: f64) -> (String, String) {
    let text = format!("{value:e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    (mantissa.to_string(), exponent.to_string())
}
