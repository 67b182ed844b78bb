//! Writes lines as LaTeX: one amsmath `align*`, long sums broken over rows, each line's source span as a comment.

use isophote_symbolic::Comparison;

use crate::looks::{Looks, Stem};
use crate::text;
use crate::tree::{Addend, Equation, Expression, Tree, fraction, needs_power_of_ten, scientific};

/// An `align*` environment; needs amsmath.
pub(crate) fn lines(lines: &[Equation], looks: &Looks) -> String {
    let latex = Latex { looks };
    let mut rows = Vec::new();
    for line in lines {
        let right = match line.right.rows() {
            Some(rows) => {
                let first = rows.first().map(|row| latex.terms(row, true)).unwrap_or_default();
                let more = rows.iter().skip(1).map(|row| latex.terms(row, false));
                std::iter::once(first).chain(more).collect()
            }
            None => vec![latex.tree(&line.right)],
        };
        let place = line.right.span.map_or(String::new(), |span| format!(" % {}-{}", span.start, span.end));
        for (i, row) in right.into_iter().enumerate() {
            match i {
                0 => rows.push((format!("  {} &= {row}", latex.tree(&line.left)), place.clone())),
                _ => rows.push((format!("  &\\quad {row}"), String::new())),
            }
        }
    }
    let last = rows.len().saturating_sub(1);
    let ended = rows.into_iter().enumerate().map(|(i, (row, place))| match i == last {
        true => format!("{row}{place}\n"),
        false => format!("{row} \\\\{place}\n"),
    });
    format!("\\begin{{align*}}\n{}\\end{{align*}}\n", ended.collect::<String>())
}

struct Latex<'a> {
    looks: &'a Looks,
}

impl Latex<'_> {
    fn name(&self, name: &str) -> String {
        let look = self.looks.of(name);
        let stem = match look.stem {
            Stem::Letter(letter) => letter.to_string(),
            Stem::Greek(_, command) => format!("\\{command}"),
            Stem::Word(word) if word.is_ascii() => format!("\\mathrm{{{}}}", word.replace('_', "\\_")),
            Stem::Word(word) => format!("\\text{{{}}}", word.replace('_', "\\_")),
        };
        look.index.map_or(stem.clone(), |index| format!("{stem}_{{{index}}}"))
    }

    fn tree(&self, t: &Tree) -> String {
        match &t.kind {
            Expression::Number(value) => number(*value),
            Expression::Name(name) => self.name(name),
            Expression::Entry(name) => format!("{}^{{(\\mathrm{{entry}})}}", self.name(name)),
            Expression::Saturation(name) => format!("\\operatorname{{limit}}({})", self.name(name)),
            Expression::Shift(name) => format!("\\operatorname{{shift}}({})", self.name(name)),
            Expression::Sum(list) => self.terms(list, true),
            Expression::Product(factors) => self.product(1.0, factors),
            Expression::Sqrt(a) => format!("\\sqrt{{{}}}", self.tree(a)),
            Expression::Abs(a) => format!("\\left|{}\\right|", self.tree(a)),
            Expression::Call(name, arguments) => {
                let arguments: Vec<String> = arguments.iter().map(|a| self.tree(a)).collect();
                format!("\\operatorname{{{name}}}\\left({}\\right)", arguments.join(", "))
            }
            Expression::Power(a, b) => format!("{}^{{{}}}", self.base(a), self.tree(b)),
            Expression::Compare(c, a, b) => format!("{} {} {}", self.inline(a), sign(*c), self.inline(b)),
            Expression::And(a, b) => format!("{} \\land {}", self.factor(a), self.factor(b)),
            Expression::Or(a, b) => format!("{} \\lor {}", self.factor(a), self.factor(b)),
            Expression::Not(a) => format!("\\lnot {}", self.factor(a)),
            Expression::Select(..) => {
                let (cases, otherwise) = t.cases();
                let mut rows: Vec<String> = cases
                    .iter()
                    .map(|(value, condition)| format!("{} & \\text{{if }} {}", self.tree(value), self.tree(condition)))
                    .collect();
                rows.push(format!("{} & \\text{{otherwise}}", self.tree(otherwise)));
                format!("\\begin{{cases}} {} \\end{{cases}}", rows.join(" \\\\ "))
            }
            Expression::Total(over, a) => format!("\\sum_{{\\mathrm{{{over}}}}} {}", self.factor(a)),
            Expression::Derivative(function, parameters) => {
                let function = self.name(function);
                let d = |name: &String| format!("\\partial {}", self.name(name));
                match &parameters[..] {
                    [u, v] if u == v => format!("\\frac{{\\partial^2 {function}}}{{{}^2}}", d(u)),
                    [u, v] => format!("\\frac{{\\partial^2 {function}}}{{{}\\,{}}}", d(u), d(v)),
                    all => {
                        format!("\\frac{{\\partial {function}}}{{{}}}", all.iter().map(d).collect::<String>())
                    }
                }
            }
        }
    }

    /// `first`: at the start of the sum, where a leading + is omitted.
    fn terms(&self, list: &[Addend], first: bool) -> String {
        let mut text = String::new();
        for (i, term) in list.iter().enumerate() {
            text += match (first && i == 0, i == 0, term.coefficient < 0.0) {
                (true, _, true) => "-",
                (true, _, false) => "",
                (_, true, true) => "- ",
                (_, true, false) => "+ ",
                (_, _, true) => " - ",
                (_, _, false) => " + ",
            };
            let c = term.coefficient.abs();
            text += &match &term.body {
                None => number(c),
                Some(Tree { kind: Expression::Product(factors), .. }) => self.product(c, factors),
                Some(body) => self.juxtaposed(c, &[(body, 1)], false),
            };
        }
        text
    }

    fn product(&self, coefficient: f64, factors: &[(Tree, i32)]) -> String {
        let [above, below] = fraction(factors);
        if below.is_empty() {
            return self.juxtaposed(coefficient, &above, false);
        }
        format!("\\frac{{{}}}{{{}}}", self.juxtaposed(coefficient, &above, true), self.juxtaposed(1.0, &below, true))
    }

    /// `enclosed`: nothing stands next to it.
    fn juxtaposed(&self, coefficient: f64, factors: &[(&Tree, u32)], enclosed: bool) -> String {
        let mut text = String::new();
        if coefficient != 1.0 || factors.is_empty() {
            text = number(coefficient);
        }
        let alone = enclosed && text.is_empty() && factors.len() == 1;
        for (tree, exponent) in factors {
            if !text.is_empty() {
                text += if tree.starts_with_digit() { " \\cdot " } else { "\\," };
            }
            text += &match exponent {
                1 if alone => self.tree(tree),
                1 => self.factor(tree),
                e => format!("{}^{{{e}}}", self.base(tree)),
            };
        }
        text
    }

    fn factor(&self, t: &Tree) -> String {
        if t.is_loose() { format!("\\left({}\\right)", self.tree(t)) } else { self.tree(t) }
    }

    fn inline(&self, t: &Tree) -> String {
        if matches!(t.kind, Expression::Sum(_)) { self.tree(t) } else { self.factor(t) }
    }

    fn base(&self, t: &Tree) -> String {
        if t.is_closed() { self.tree(t) } else { format!("\\left({}\\right)", self.tree(t)) }
    }
}

fn number(value: f64) -> String {
    if needs_power_of_ten(value) {
        let (mantissa, exponent) = scientific(value);
        return match mantissa.as_str() {
            "1" => format!("10^{{{exponent}}}"),
            "-1" => format!("-10^{{{exponent}}}"),
            _ => format!("{mantissa} \\cdot 10^{{{exponent}}}"),
        };
    }
    if value.is_infinite() { if value < 0.0 { "-\\infty" } else { "\\infty" }.into() } else { text::number(value) }
}

fn sign(comparison: Comparison) -> &'static str {
    match comparison {
        Comparison::Lt => "<",
        Comparison::Le => "\\le",
        Comparison::Eq => "=",
        Comparison::Ne => "\\ne",
    }
}
