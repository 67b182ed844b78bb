//! Trees and lines in the spelling of the formula language, as far as it goes.

use crate::tree::{Kind, Line, Term, Tree, needs_power_of_ten};

/// One line each.
pub(crate) fn lines(lines: &[Line]) -> String {
    lines.iter().map(|line| format!("{} = {}\n", tree(&line.left), tree(&line.right))).collect()
}

/// A tree.
pub(crate) fn tree(t: &Tree) -> String {
    match &t.kind {
        Kind::Number(value) => number(*value),
        Kind::Name(name) => name.clone(),
        Kind::Entry(name) => format!("{name}@entry"),
        Kind::Saturation(name) => format!("limit({name})"),
        Kind::Shift(name) => format!("shift({name})"),
        Kind::Sum(list) => terms(list),
        Kind::Product(factors) => {
            let power = |(base, e): &(Tree, i32)| match e {
                1 => grouped(base),
                _ if matches!(base.kind, Kind::Product(_)) => format!("({})^{e}", tree(base)),
                _ => format!("{}^{e}", grouped(base)),
            };
            factors.iter().map(power).collect::<Vec<_>>().join("*")
        }
        Kind::Sqrt(a) => format!("sqrt({})", tree(a)),
        Kind::Abs(a) => format!("abs({})", tree(a)),
        Kind::Call(name, arguments) => {
            format!("{name}({})", arguments.iter().map(tree).collect::<Vec<_>>().join(", "))
        }
        Kind::Power(a, b) => format!("pow({}, {})", tree(a), tree(b)),
        Kind::Compare(c, a, b) => format!("{} {} {}", tree(a), c.sign(), tree(b)),
        Kind::And(a, b) => format!("({} and {})", tree(a), tree(b)),
        Kind::Or(a, b) => format!("({} or {})", tree(a), tree(b)),
        Kind::Not(a) => format!("not ({})", tree(a)),
        Kind::Select(c, a, b) => format!("if({}, {}, {})", tree(c), tree(a), tree(b)),
        Kind::Total(over, a) => format!("Σ_{over} {}", grouped(a)),
        Kind::Derivative(function, parameters) => {
            let order = if parameters.len() > 1 { parameters.len().to_string() } else { String::new() };
            let below: String = parameters.iter().map(|name| format!("d{name}")).collect();
            format!("d{order}{function}/{below}")
        }
    }
}

/// The terms of a sum; the first one's sign only if it is −.
pub(crate) fn terms(list: &[Term]) -> String {
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
    if matches!(t.kind, Kind::Sum(_)) { format!("({})", tree(t)) } else { tree(t) }
}
