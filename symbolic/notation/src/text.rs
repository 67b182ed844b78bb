//! Writes trees and lines in the formula language's syntax, where it has one.

use crate::tree::{Addend, Equation, Expression, Tree, needs_power_of_ten};

/// One line each.
pub(crate) fn lines(lines: &[Equation]) -> String {
    lines.iter().map(|line| format!("{} = {}\n", tree(&line.left), tree(&line.right))).collect()
}

/// A tree.
pub(crate) fn tree(t: &Tree) -> String {
    match &t.kind {
        Expression::Number(value) => number(*value),
        Expression::Name(name) => name.clone(),
        Expression::Entry(name) => format!("{name}@entry"),
        Expression::Saturation(name) => format!("limit({name})"),
        Expression::Shift(name) => format!("shift({name})"),
        Expression::Sum(list) => terms(list),
        Expression::Product(factors) => {
            let power = |(base, e): &(Tree, i32)| match e {
                1 => grouped(base),
                _ if matches!(base.kind, Expression::Product(_)) => format!("({})^{e}", tree(base)),
                _ => format!("{}^{e}", grouped(base)),
            };
            factors.iter().map(power).collect::<Vec<_>>().join("*")
        }
        Expression::Sqrt(a) => format!("sqrt({})", tree(a)),
        Expression::Abs(a) => format!("abs({})", tree(a)),
        Expression::Call(name, arguments) => {
            format!("{name}({})", arguments.iter().map(tree).collect::<Vec<_>>().join(", "))
        }
        Expression::Power(a, b) => format!("pow({}, {})", tree(a), tree(b)),
        Expression::Compare(c, a, b) => format!("{} {} {}", tree(a), c.sign(), tree(b)),
        Expression::And(a, b) => format!("({} and {})", tree(a), tree(b)),
        Expression::Or(a, b) => format!("({} or {})", tree(a), tree(b)),
        Expression::Not(a) => format!("not ({})", tree(a)),
        Expression::Select(c, a, b) => format!("if({}, {}, {})", tree(c), tree(a), tree(b)),
        Expression::Total(over, a) => format!("Σ_{over} {}", grouped(a)),
        Expression::Derivative(function, parameters) => {
            let order = if parameters.len() > 1 { parameters.len().to_string() } else { String::new() };
            let below: String = parameters.iter().map(|name| format!("d{name}")).collect();
            format!("d{order}{function}/{below}")
        }
    }
}

/// A sum's terms; a leading + is omitted.
pub(crate) fn terms(list: &[Addend]) -> String {
    let mut text = String::new();
    for term in list {
        let c = term.coefficient;
        text += match (text.is_empty(), c < 0.0) {
            (true, true) => "-",
            (true, false) => "",
            (false, true) => " - ",
            (false, false) => " + ",
        };
        text += &match &term.body {
            None => number(c.abs()),
            Some(body) if c.abs() == 1.0 => grouped(body),
            Some(body) => format!("{}*{}", number(c.abs()), grouped(body)),
        };
    }
    text
}

pub(crate) fn number(value: f64) -> String {
    if needs_power_of_ten(value) { format!("{value:e}") } else { format!("{value}") }
}

fn grouped(t: &Tree) -> String {
    if matches!(t.kind, Expression::Sum(_)) { format!("({})", tree(t)) } else { tree(t) }
}
