//! Writes the document's own formulas as MathML, unevaluated and in document order. Each node carries its source bytes
//! in `data-span`, so that formula and text can link to each other.

use isophote_symbolic::{Model, Span};
use isophote_syntax::limits::LIMITS;
use isophote_syntax::parser::{Expr, ExprKind, Junction, Relation, parse};
use isophote_syntax::spelling::Spelling;

use crate::looks::Looks;
use crate::mathml::{MathMl, TIMES, bracketed, call, number};

/// One `math` element per formula and line, in document order; `data-key` is the formula's key.
pub fn written(model: &Model) -> String {
    let formulas: Vec<Written> = model.strings().filter_map(|(key, span)| Written::of(model, key, span)).collect();
    let definitions = formulas.iter().filter_map(|formula| formula.key.strip_prefix("definitions."));
    let defined = definitions.map(|key| key.split('(').next().unwrap_or(key).trim());
    let parameters = model.parameters().iter().map(|parameter| parameter.name.as_str());
    let constants = model.constants().iter().map(|constant| constant.name.as_str());
    let plain = model.coordinates().iter().chain(model.channels()).map(String::as_str);
    let names: Vec<&str> = plain.chain(parameters).chain(constants).chain(defined).collect();
    let looks = Looks::new(model.coordinates(), &names);
    formulas.iter().map(|formula| formula.line(&looks)).collect()
}

/// A formula with its key and source map.
struct Written<'a> {
    key: &'a str,
    value: &'a str,
    spelling: Spelling,
}

impl<'a> Written<'a> {
    fn of(model: &'a Model, key: &'a str, span: Span) -> Option<Written<'a>> {
        let value = match key.strip_prefix("definitions.") {
            Some(name) => model.document().get("definitions")?.get(name)?,
            None => {
                let (name, place) = key.strip_prefix("model.")?.split_once('[').unwrap_or((&key[6..], ""));
                if !["intensity", "observed", "domain", "constraint", "noise"].contains(&name) {
                    return None;
                }
                let value = model.document().get("model")?.get(name)?;
                place.trim_end_matches(']').parse().ok().map_or(Some(value), |place: usize| value.get(place))?
            }
        };
        let value = value.as_str()?;
        Some(Written { key, value, spelling: Spelling::of(value, model.words(span)?, span.start as usize) })
    }

    fn line(&self, looks: &Looks) -> String {
        let tree = |text| parse(text, &mut Some(LIMITS.tokens)).expr;
        let right = Writer { mathml: MathMl { looks }, place: Some((&self.spelling, self.value.len())) };
        let left = match (self.key.strip_prefix("definitions."), self.key.strip_prefix("model.")) {
            (Some(name), _) => Writer { place: None, ..right }.node(&tree(name)) + "<mo>=</mo>",
            (None, Some(word)) if word == "intensity" || word == "noise" => format!("<mi>{word}</mi><mo>=</mo>"),
            (None, word) => {
                let word = word.unwrap_or_default().split('[').next().unwrap_or_default();
                format!("<mtext>{word}:\u{a0}</mtext>")
            }
        };
        let expr = tree(self.value);
        let at = right.at(&expr);
        format!("<math display=\"block\" data-key=\"{}\"{at}>{left}{}</math>\n", escaped(self.key), right.node(&expr))
    }
}

#[derive(Clone, Copy)]
struct Writer<'a> {
    mathml: MathMl<'a>,
    /// The formula's source map and length in bytes; `None` for text without spans.
    place: Option<(&'a Spelling, usize)>,
}

/// Binding strength of a node, loosest first.
#[derive(PartialEq, PartialOrd)]
enum Hold {
    Truth,
    Sum,
    Product,
    Raised,
    Alone,
}

impl Writer<'_> {
    fn at(&self, expr: &Expr) -> String {
        let span = self.place.map(|(spelling, length)| spelling.span(expr.start, expr.end, length));
        span.map_or(String::new(), |span| format!(" data-span=\"{}-{}\"", span.start, span.end))
    }

    /// One element.
    fn node(&self, expr: &Expr) -> String {
        let list =
            |parts: &[Expr], between: &str| parts.iter().map(|part| self.node(part)).collect::<Vec<_>>().join(between);
        let (tag, inside) = match &expr.kind {
            ExprKind::Number(value) => ("mrow", number(*value)),
            ExprKind::Name(name) => ("mrow", self.mathml.name(name)),
            ExprKind::Text(text) => ("mtext", escaped(text)),
            ExprKind::List(rows) => ("mrow", self.matrix(rows)),
            ExprKind::Sum(terms) => ("mrow", self.sum(terms)),
            ExprKind::Product(factors) => ("mrow", self.product(factors)),
            ExprKind::Negate(of) => ("mrow", format!("<mo form=\"prefix\">−</mo>{}", self.held(of, Hold::Product))),
            ExprKind::Power(base, exponent) => ("msup", self.held(base, Hold::Alone) + &self.node(exponent)),
            ExprKind::Transpose(of) => ("msup", self.held(of, Hold::Alone) + "<mo>⊤</mo>"),
            ExprKind::Index(of, places) => {
                let is_number = places.iter().any(|place| matches!(place.kind, ExprKind::Number(_)));
                let inside = list(places, "<mo>,</mo>"); // digits in brackets: k₁ is another name, not k[1]
                let inside = if is_number { format!("<mo>[</mo>{inside}<mo>]</mo>") } else { inside };
                ("msub", format!("{}<mrow>{inside}</mrow>", self.held(of, Hold::Alone)))
            }
            ExprKind::Call(name, arguments) => self.call(name, arguments),
            ExprKind::Compare(relation, a, b) => {
                let sign = match relation {
                    Relation::Lt => "&lt;",
                    Relation::Le => "≤",
                    Relation::Gt => "&gt;",
                    Relation::Ge => "≥",
                    Relation::Eq => "=",
                    Relation::Ne => "≠",
                };
                ("mrow", format!("{}<mo>{sign}</mo>{}", self.held(a, Hold::Sum), self.held(b, Hold::Sum)))
            }
            ExprKind::Joined(junction, parts) => {
                let sign = if *junction == Junction::And { "<mo>∧</mo>" } else { "<mo>∨</mo>" };
                let parts: Vec<String> = parts.iter().map(|part| self.truth(part)).collect();
                ("mrow", parts.join(sign))
            }
            ExprKind::Not(of) => ("mrow", format!("<mo>¬</mo>{}", self.truth(of))),
            ExprKind::Broken(parts) => ("mrow", list(parts, "<mo>?</mo>")),
        };
        format!("<{tag}{}>{inside}</{tag}>", self.at(expr))
    }

    /// A node, in brackets if it binds looser than `least`.
    fn held(&self, expr: &Expr, least: Hold) -> String {
        if hold(expr) < least { bracketed(&self.node(expr)) } else { self.node(expr) }
    }

    fn truth(&self, expr: &Expr) -> String {
        let is_joined = matches!(expr.kind, ExprKind::Joined(..));
        if is_joined { bracketed(&self.node(expr)) } else { self.node(expr) }
    }

    fn sum(&self, terms: &[(bool, Expr)]) -> String {
        let mut text = String::new();
        for (i, (is_subtracted, term)) in terms.iter().enumerate() {
            let sign = if *is_subtracted { "−" } else { "+" };
            if i > 0 {
                text += &format!("<mo form=\"infix\">{sign}</mo>");
            }
            text += &self.behind(i, term);
        }
        text
    }

    /// A term or factor; a leading sign of the first needs no brackets.
    fn behind(&self, place: usize, part: &Expr) -> String {
        if place == 0 && is_signed(part) { self.node(part) } else { self.held(part, Hold::Product) }
    }

    fn product(&self, factors: &[(bool, Expr)]) -> String {
        let side = |is_below: bool| -> Vec<&Expr> {
            factors.iter().filter(|(below, _)| *below == is_below).map(|(_, factor)| factor).collect()
        };
        let (above, below) = (side(false), side(true));
        if below.is_empty() {
            return self.juxtaposed(&above);
        }
        format!("<mfrac><mrow>{}</mrow><mrow>{}</mrow></mfrac>", self.juxtaposed(&above), self.juxtaposed(&below))
    }

    fn juxtaposed(&self, factors: &[&Expr]) -> String {
        if let [alone] = factors {
            return self.node(alone);
        }
        let mut text = String::new();
        for (i, factor) in factors.iter().enumerate() {
            if !text.is_empty() {
                text += if starts_with_digit(factor) { "<mo>⋅</mo>" } else { TIMES };
            }
            text += &self.behind(i, factor);
        }
        text
    }

    fn matrix(&self, rows: &[Expr]) -> String {
        let cell = |entry: &Expr| format!("<mtd>{}</mtd>", self.node(entry));
        let row = |entry: &Expr| match &entry.kind {
            ExprKind::List(entries) => entries.iter().map(cell).collect::<String>(),
            _ => cell(entry),
        };
        let rows: String = rows.iter().map(|entry| format!("<mtr>{}</mtr>", row(entry))).collect();
        format!("<mo form=\"prefix\">(</mo><mtable>{rows}</mtable><mo form=\"postfix\">)</mo>")
    }

    fn call(&self, name: &str, arguments: &[Expr]) -> (&'static str, String) {
        match (name, arguments) {
            ("sqrt", [of]) => ("msqrt", self.node(of)),
            ("abs", [of]) => {
                ("mrow", format!("<mo form=\"prefix\">|</mo>{}<mo form=\"postfix\">|</mo>", self.node(of)))
            }
            ("if", [_, _, _]) => ("mrow", self.cases(arguments)),
            ("sum" | "product", [body, index, first, last]) => {
                let sign = if name == "sum" { "∑" } else { "∏" };
                let below = format!("<mrow>{}<mo>=</mo>{}</mrow>", self.node(index), self.node(first));
                let sign = format!("<munderover><mo>{sign}</mo>{below}{}</munderover>", self.node(last));
                ("mrow", sign + &self.held(body, Hold::Product))
            }
            _ => {
                let arguments: Vec<String> = arguments.iter().map(|argument| self.node(argument)).collect();
                let arguments = arguments.join("<mo>,</mo>");
                let own = self.mathml.name(name);
                ("mrow", if name.len() == 1 { own + &bracketed(&arguments) } else { call(&escaped(name), &arguments) })
            }
        }
    }

    /// Nested `if`s as one list.
    fn cases(&self, arguments: &[Expr]) -> String {
        let row = |value: &str, condition: &str| format!("<mtr><mtd>{value}</mtd><mtd>{condition}</mtd></mtr>");
        let (mut rows, mut rest) = (String::new(), arguments);
        while let [condition, value, otherwise] = rest {
            rows += &row(&self.node(value), &format!("<mtext>if\u{a0}</mtext>{}", self.node(condition)));
            rest = match &otherwise.kind {
                ExprKind::Call(name, inner) if name == "if" && inner.len() == 3 => inner,
                _ => {
                    rows += &row(&self.node(otherwise), "<mtext>otherwise</mtext>");
                    break;
                }
            };
        }
        format!("<mo form=\"prefix\">{{</mo><mtable>{rows}</mtable>")
    }
}

fn hold(expr: &Expr) -> Hold {
    match &expr.kind {
        _ if is_signed(expr) => Hold::Sum,
        ExprKind::Number(_) | ExprKind::Name(_) | ExprKind::Text(_) | ExprKind::List(_) | ExprKind::Broken(_) => {
            Hold::Alone
        }
        ExprKind::Call(name, _) => match name.as_str() {
            "sum" | "product" | "if" => Hold::Sum,
            "sqrt" | "abs" => Hold::Alone,
            _ => Hold::Raised,
        },
        ExprKind::Power(..) | ExprKind::Transpose(_) | ExprKind::Index(..) => Hold::Raised,
        ExprKind::Product(_) => Hold::Product,
        ExprKind::Sum(_) | ExprKind::Negate(_) => Hold::Sum,
        ExprKind::Compare(..) | ExprKind::Joined(..) | ExprKind::Not(_) => Hold::Truth,
    }
}

/// Begins with a minus.
fn is_signed(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Negate(_) => true,
        ExprKind::Product(factors) => factors.first().is_some_and(|(is_below, first)| !is_below && is_signed(first)),
        _ => false,
    }
}

fn starts_with_digit(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Number(_) => true,
        ExprKind::Power(base, _) => starts_with_digit(base),
        ExprKind::Product(factors) => factors.first().is_some_and(|(_, first)| starts_with_digit(first)),
        _ => false,
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
