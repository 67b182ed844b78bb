//! Writes lines as MathML Core: one `<math display="block">` each, long sums broken over table rows. An operation's
//! element carries its source bytes in `data-span`, unless its parent has the same.

use isophote_symbolic::{Comparison, Span};

use crate::looks::{Looks, Stem};
use crate::text;
use crate::tree::{Addend, Equation, Expression, Tree, fraction, needs_power_of_ten, scientific};

pub(crate) const TIMES: &str = "<mo lspace=\"0\" rspace=\"0.17em\">\u{2062}</mo>";
const APPLY: &str = "<mo>\u{2061}</mo>";

/// A page fragment: one `math` element per line.
pub(crate) fn lines(lines: &[Equation], looks: &Looks) -> String {
    let mathml = MathMl { looks };
    lines.iter().map(|line| mathml.line(line)).collect()
}

/// Writes elements with typeset names.
#[derive(Clone, Copy)]
pub(crate) struct MathMl<'a> {
    pub looks: &'a Looks,
}

impl MathMl<'_> {
    fn line(&self, line: &Equation) -> String {
        let left = format!("{}<mo>=</mo>", self.tree(&line.left, None));
        let span = line.right.span;
        let inside = match line.right.rows() {
            None => left + &self.tree(&line.right, span),
            Some(rows) => {
                let row = |(i, terms): (usize, &&[Addend])| {
                    let name = if i == 0 { left.as_str() } else { "" };
                    let terms = self.terms(terms, i == 0, span);
                    format!(
                        "<mtr><mtd style=\"text-align:right\">{name}</mtd><mtd style=\"text-align:left\">{terms}</mtd></mtr>"
                    )
                };
                format!(
                    "<mtable displaystyle=\"true\">{}</mtable>",
                    rows.iter().enumerate().map(row).collect::<String>()
                )
            }
        };
        format!("<math display=\"block\"{}>{inside}</math>\n", place(span))
    }

    pub fn name(&self, name: &str) -> String {
        let look = self.looks.of(name);
        let stem = match look.stem {
            Stem::Letter(letter) | Stem::Greek(letter, _) => format!("<mi>{letter}</mi>"),
            Stem::Word(word) if word.chars().count() == 1 => format!("<mi mathvariant=\"normal\">{word}</mi>"),
            Stem::Word(word) => format!("<mi>{word}</mi>"),
        };
        match look.index {
            None => stem,
            Some(index) if index.starts_with(|c: char| c.is_ascii_digit()) => {
                format!("<msub>{stem}<mn>{index}</mn></msub>")
            }
            Some(index) => format!("<msub>{stem}<mi>{index}</mi></msub>"),
        }
    }

    /// One element. `around` is the enclosing element's span.
    fn tree(&self, t: &Tree, around: Option<Span>) -> String {
        let here = t.span.or(around);
        let at = |a: &Tree| self.tree(a, here);
        let (tag, inside) = match &t.kind {
            Expression::Number(value) => return number(*value),
            Expression::Name(name) => return self.name(name),
            Expression::Entry(name) => {
                return format!("<msup>{}<mtext>(entry)</mtext></msup>", self.name(name));
            }
            Expression::Saturation(name) => return call("limit", &self.name(name)),
            Expression::Shift(name) => return call("shift", &self.name(name)),
            Expression::Sum(list) => ("mrow", self.terms(list, true, here)),
            Expression::Product(factors) => ("mrow", self.product(1.0, factors, here)),
            Expression::Sqrt(a) => ("msqrt", at(a)),
            Expression::Abs(a) => ("mrow", format!("<mo form=\"prefix\">|</mo>{}<mo form=\"postfix\">|</mo>", at(a))),
            Expression::Call(name, arguments) => {
                let arguments: Vec<String> = arguments.iter().map(at).collect();
                ("mrow", call(name, &arguments.join("<mo>,</mo>")))
            }
            Expression::Power(a, b) => ("msup", self.base(a, here) + &at(b)),
            Expression::Compare(c, a, b) => {
                ("mrow", format!("{}<mo>{}</mo>{}", self.inline(a, here), sign(*c), self.inline(b, here)))
            }
            Expression::And(a, b) => ("mrow", format!("{}<mo>∧</mo>{}", self.factor(a, here), self.factor(b, here))),
            Expression::Or(a, b) => ("mrow", format!("{}<mo>∨</mo>{}", self.factor(a, here), self.factor(b, here))),
            Expression::Not(a) => ("mrow", format!("<mo>¬</mo>{}", self.factor(a, here))),
            Expression::Select(..) => {
                let row = |value: &str, condition: &str| {
                    let cell = |inside: &str| format!("<mtd style=\"text-align:left\">{inside}</mtd>");
                    format!("<mtr>{}{}</mtr>", cell(value), cell(condition))
                };
                let (cases, otherwise) = t.cases();
                let mut rows: String = cases
                    .iter()
                    .map(|(value, condition)| row(&at(value), &format!("<mtext>if\u{a0}</mtext>{}", at(condition))))
                    .collect();
                rows += &row(&at(otherwise), "<mtext>otherwise</mtext>");
                ("mrow", format!("<mo form=\"prefix\">{{</mo><mtable>{rows}</mtable>"))
            }
            Expression::Total(over, a) => (
                "mrow",
                format!(
                    "<munder><mo movablelimits=\"false\">∑</mo><mtext>{over}</mtext></munder>{}",
                    self.factor(a, here)
                ),
            ),
            Expression::Derivative(function, parameters) => {
                let function = self.name(function);
                let d = |name: &String| format!("<mi>∂</mi>{}", self.name(name));
                let (above, below) = match &parameters[..] {
                    [u, v] => {
                        let below = match u == v {
                            true => format!("<mi>∂</mi><msup>{}<mn>2</mn></msup>", grouped_row(&self.name(u))),
                            false => d(u) + TIMES + &d(v),
                        };
                        (format!("<msup><mi>∂</mi><mn>2</mn></msup>{function}"), below)
                    }
                    all => (format!("<mi>∂</mi>{function}"), all.iter().map(d).collect()),
                };
                ("mfrac", grouped_row(&above) + &grouped_row(&below))
            }
        };
        format!("<{tag}{}>{inside}</{tag}>", place(t.span.filter(|own| Some(*own) != around)))
    }

    fn terms(&self, list: &[Addend], first: bool, around: Option<Span>) -> String {
        let mut text = String::new();
        for (i, term) in list.iter().enumerate() {
            text += match (first && i == 0, term.coefficient < 0.0) {
                (true, true) => "<mo form=\"prefix\">−</mo>",
                (true, false) => "",
                (false, true) => "<mo form=\"infix\">−</mo>",
                (false, false) => "<mo form=\"infix\">+</mo>",
            };
            let c = term.coefficient.abs();
            text += &match &term.body {
                None => number(c),
                Some(Tree { kind: Expression::Product(factors), span }) => {
                    let own = span.filter(|own| Some(*own) != around);
                    format!("<mrow{}>{}</mrow>", place(own), self.product(c, factors, span.or(around)))
                }
                Some(body) => self.juxtaposed(c, &[(body, 1)], false, around),
            };
        }
        text
    }

    fn product(&self, coefficient: f64, factors: &[(Tree, i32)], around: Option<Span>) -> String {
        let [above, below] = fraction(factors);
        if below.is_empty() {
            return self.juxtaposed(coefficient, &above, false, around);
        }
        let above = self.juxtaposed(coefficient, &above, true, around);
        let below = self.juxtaposed(1.0, &below, true, around);
        format!("<mfrac>{}{}</mfrac>", grouped_row(&above), grouped_row(&below))
    }

    /// `enclosed`: nothing stands next to it.
    fn juxtaposed(&self, coefficient: f64, factors: &[(&Tree, u32)], enclosed: bool, around: Option<Span>) -> String {
        let mut text = String::new();
        if coefficient != 1.0 || factors.is_empty() {
            text = number(coefficient);
        }
        let alone = enclosed && text.is_empty() && factors.len() == 1;
        for (tree, exponent) in factors {
            if !text.is_empty() {
                text += if tree.starts_with_digit() { "<mo>⋅</mo>" } else { TIMES };
            }
            text += &match exponent {
                1 if alone => self.tree(tree, around),
                1 => self.factor(tree, around),
                e => format!("<msup>{}<mn>{e}</mn></msup>", self.base(tree, around)),
            };
        }
        text
    }

    fn factor(&self, t: &Tree, around: Option<Span>) -> String {
        if t.is_loose() { bracketed(&self.tree(t, around)) } else { self.tree(t, around) }
    }

    fn inline(&self, t: &Tree, around: Option<Span>) -> String {
        if matches!(t.kind, Expression::Sum(_)) { self.tree(t, around) } else { self.factor(t, around) }
    }

    fn base(&self, t: &Tree, around: Option<Span>) -> String {
        if t.is_closed() { self.tree(t, around) } else { bracketed(&self.tree(t, around)) }
    }
}

fn place(span: Option<Span>) -> String {
    span.map_or(String::new(), |span| format!(" data-span=\"{}-{}\"", span.start, span.end))
}

fn grouped_row(inside: &str) -> String {
    format!("<mrow>{inside}</mrow>")
}

pub(crate) fn bracketed(inside: &str) -> String {
    format!("<mrow><mo>(</mo>{inside}<mo>)</mo></mrow>")
}

pub(crate) fn call(name: &str, arguments: &str) -> String {
    format!("<mi>{name}</mi>{APPLY}{}", bracketed(arguments))
}

/// One element.
pub(crate) fn number(value: f64) -> String {
    let minus = if value < 0.0 { "<mo form=\"prefix\">−</mo>" } else { "" };
    let digits = match value.abs() {
        size if needs_power_of_ten(size) => {
            let (mantissa, exponent) = scientific(size);
            let exponent = match exponent.strip_prefix('-') {
                Some(digits) => format!("<mrow><mo form=\"prefix\">−</mo><mn>{digits}</mn></mrow>"),
                None => format!("<mn>{exponent}</mn>"),
            };
            let mantissa = if mantissa == "1" { String::new() } else { format!("<mn>{mantissa}</mn><mo>⋅</mo>") };
            format!("{mantissa}<msup><mn>10</mn>{exponent}</msup>")
        }
        size if size.is_infinite() => "<mn>∞</mn>".into(),
        size if minus.is_empty() => return format!("<mn>{}</mn>", text::number(size)),
        size => format!("<mn>{}</mn>", text::number(size)),
    };
    format!("<mrow>{minus}{digits}</mrow>")
}

fn sign(comparison: Comparison) -> &'static str {
    match comparison {
        Comparison::Lt => "&lt;",
        Comparison::Le => "≤",
        Comparison::Eq => "=",
        Comparison::Ne => "≠",
    }
}
