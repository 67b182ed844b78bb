//! Expression trees before a notation is chosen, shared by `text`, `latex` and `mathml`.
//!
//! `explain` builds them from graph nodes as lines `name = tree`. A tree is never deeper than [`WIDTH`], because
//! anything wider gets its own name; so recursion is safe.

use isophote_symbolic::{Comparison, Span};

/// Longest expression in plain text without a line and name of its own, characters.
pub(crate) const WIDTH: usize = 120;
/// Longest row of a broken sum in plain text, characters.
const ROW: usize = 72;

/// `left = right`.
pub(crate) struct Equation {
    pub left: Tree,
    pub right: Tree,
}

/// An expression and its source span.
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

/// Kinds of expressions.
#[derive(Clone)]
pub(crate) enum Expression {
    Number(f64),
    /// A name of the document or of `explain`.
    Name(String),
    /// A parameter's value at the start of the pass.
    Entry(String),
    /// A channel's saturation limit.
    Saturation(String),
    /// A coordinate's shift.
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

    /// Needs brackets next to a factor or under an exponent.
    pub fn is_loose(&self) -> bool {
        use Expression::*;
        matches!(self.kind, Sum(_) | Compare(..) | And(..) | Or(..) | Not(_) | Select(..))
    }

    /// A plain number, a name, or a form with its own delimiters: takes an exponent without brackets.
    pub fn is_closed(&self) -> bool {
        match &self.kind {
            Expression::Number(value) => *value >= 0.0 && !needs_power_of_ten(*value),
            kind => matches!(kind, Expression::Name(_) | Expression::Sqrt(_) | Expression::Abs(_)),
        }
    }

    /// Starts with a digit: a coefficient before it needs a dot.
    pub fn starts_with_digit(&self) -> bool {
        match &self.kind {
            Expression::Number(_) => true,
            Expression::Power(base, _) => base.starts_with_digit(),
            _ => false,
        }
    }

    /// Flattens nested `if`s: values with their conditions, and the final alternative.
    pub fn cases(&self) -> (Vec<(&Tree, &Tree)>, &Tree) {
        let (mut cases, mut rest) = (Vec::new(), self);
        while let Expression::Select(condition, value, otherwise) = &rest.kind {
            cases.push((value.as_ref(), condition.as_ref()));
            rest = otherwise;
        }
        (cases, rest)
    }

    /// A sum's terms, broken into rows; `None` if one row suffices.
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

/// Too large or small to print without an exponent.
pub(crate) fn needs_power_of_ten(value: f64) -> bool {
    value.is_finite() && value != 0.0 && !(1e-5..1e15).contains(&value.abs())
}

/// Mantissa and decimal exponent, shortest that round-trips.
pub(crate) fn scientific(value: f64) -> (String, String) {
    let text = format!("{value:e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    (mantissa.to_string(), exponent.to_string())
}
