//! Error recovery: reports each mistake once, at its position, and suppresses the faults that follow from it.

use super::{Expr, ExprKind, Fault, Parser, enclose, is_word};
use crate::diagnostic::{quoted, visible};
use crate::lexer::{Lexeme, Token};
use crate::words::is_function;

/// Prefix of the message for a character outside the language.
pub const STRAY_CHARACTER: &str = "no formula holds the character";

/// Spellings of other languages and of typesetters, with a hint.
const FOREIGN: [(&str, &str); 19] = [
    ("**", "powers are written `^`"),
    ("&&", "write `and`"),
    ("||", "write `or`"),
    ("!", "write `not`"),
    ("=", "comparisons are written `==`, `<=`, `>=`"),
    ("|", "the absolute value is `abs(x)`"),
    ("{", "brackets are ( ) and [ ]"),
    (";", "the rows of a matrix are lists: `[[a, b], [c, d]]`"),
    (":", "a range is written `sum(e, i, lo, hi)`"),
    ("≤", "write `<=`"),
    ("≥", "write `>=`"),
    ("≠", "write `!=`"),
    ("−", "write `-`"),
    ("–", "write `-`"),
    ("×", "write `*`"),
    ("·", "write `*`"),
    ("÷", "write `/`"),
    ("√", "write `sqrt(x)`"),
    ("’", "a transposition is written `'`"),
];

fn remedy(spelling: &str) -> Option<&'static str> {
    FOREIGN.iter().find(|(foreign, _)| *foreign == spelling).map(|(_, help)| *help)
}

impl Parser {
    pub(super) fn tell(&mut self, fault: Fault) {
        if !self.ended {
            self.faults.push(fault);
        }
    }

    /// Reports a limit and skips the rest of the formula.
    pub(super) fn give_up(&mut self, message: String, help: &str) -> Expr {
        let Lexeme { start, end, .. } = self.lexemes[self.at];
        self.tell(Fault::new("limit", start, end, message).help(help));
        self.ended = true;
        self.at = self.lexemes.len() - 1;
        Expr { kind: ExprKind::Broken(Vec::new()), start, end }
    }

    /// Parses an expression up to `,` or a closing bracket if one is open, else up to the formula's end. Reports and
    /// skips tokens that belong to no expression.
    pub(super) fn item(&mut self, wanted: &str) -> Expr {
        let first = self.expression();
        if self.is_at_stop() {
            return first;
        }
        let mut parts = vec![first];
        let mut told = false;
        while !self.is_at_stop() {
            if !told || matches!(self.peek(), Token::Unknown(_)) {
                let fault = self.unexpected(wanted);
                self.tell(fault);
            }
            told |= !matches!(self.peek(), Token::Unknown(_));
            self.at += 1;
            // An operator after it is not a second fault.
            let infix = ["+", "-", "*", "/", "^", "<", "<=", ">", ">=", "==", "!="];
            self.at += usize::from(matches!(self.peek(), Token::Symbol(s) if infix.contains(s)));
            if self.starts_operand() || self.is_at("-") {
                parts.push(self.expression());
            }
        }
        enclose(ExprKind::Broken, parts)
    }

    fn is_at_stop(&self) -> bool {
        match self.peek() {
            Token::End => true,
            Token::Symbol(s) => matches!(*s, "," | ")" | "]") && !self.open.is_empty(),
            _ => false,
        }
    }

    /// True when the next token starts an operand.
    pub(super) fn starts_operand(&self) -> bool {
        match self.peek() {
            Token::Number(_) | Token::BadNumber(_) | Token::Text(_) => true,
            Token::Name(name) => !is_word(name),
            Token::Symbol(s) => matches!(*s, "(" | "["),
            _ => false,
        }
    }

    /// Consumes the closing bracket of the one at `open`; if it is missing, reports that and returns false.
    pub(super) fn close(&mut self, symbol: &'static str, open: usize) -> bool {
        let fault = self.unexpected(&format!("`{symbol}`"));
        self.open.pop();
        if self.eat(symbol) {
            return true;
        }
        let closes_outer = self.open.iter().any(|s| self.is_at(s));
        if matches!(self.peek(), Token::End) || closes_outer {
            let fault = Fault::new("syntax", open, open + 1, "this bracket is never closed");
            self.tell(fault.help(format!("add `{symbol}`")));
            self.ended |= !closes_outer;
            return false;
        }
        self.tell(fault);
        self.at += 1;
        false
    }

    /// Reports the next token if it is a foreign spelling of an operator.
    pub(super) fn tell_foreign(&mut self) -> bool {
        let Token::Symbol(symbol) = *self.peek() else { return false };
        let Some(help) = remedy(symbol) else { return false };
        let Lexeme { start, end, .. } = self.lexemes[self.at];
        self.tell(Fault::new("syntax", start, end, format!("`{symbol}` is not an operator")).help(help));
        true
    }

    /// Reports `%`, which parses like `*`.
    pub(super) fn tell_modulo(&mut self) -> bool {
        if !self.is_at("%") {
            return false;
        }
        let at = self.here();
        let fault = Fault::new("syntax", at, at + 1, "`%` is not an operator");
        self.tell(fault.help("there is no remainder; a percentage is `0.01 * x`"));
        self.at += 1;
        true
    }

    /// Reports an operand directly after another.
    pub(super) fn tell_implicit(&mut self, parts: &mut Vec<(bool, Expr)>) {
        let last = &parts[parts.len() - 1].1;
        if matches!(last.kind, ExprKind::Broken(_)) {
            return;
        }
        if matches!(self.peek(), Token::BadNumber(_)) {
            return;
        }
        if let ExprKind::Name(name) = &last.kind
            && is_function(name)
        {
            let message = format!("`{name}` needs its arguments in parentheses");
            let fault = Fault::new("syntax", last.start, last.end, message).help(format!("write `{name}(…)`"));
            self.tell(fault);
            // Its bare name would be reported again.
            parts.pop();
            return;
        }
        let fault = self.unexpected("an operator");
        self.tell(fault.help("there is no implicit multiplication: write `*`"));
    }

    /// Reports a missing operand and recovers.
    pub(super) fn no_operand(&mut self) -> Expr {
        let start = self.here();
        let wanted = "a number, a name or a bracket";
        let fault = self.unexpected(wanted);
        let mut parts = Vec::new();
        match self.peek().clone() {
            Token::BadNumber(_) => {
                self.tell(fault);
                self.at += 1;
            }
            Token::Unknown(_) => {
                while matches!(self.peek(), Token::Unknown(_)) {
                    let fault = self.unexpected(wanted);
                    self.tell(fault);
                    self.at += 1;
                }
                if self.starts_operand() {
                    parts.push(self.nested(Parser::unary));
                }
            }
            Token::Symbol(open @ ("!" | "{" | "|")) => {
                self.tell(fault);
                self.at += 1;
                if self.starts_operand() || self.is_at("-") {
                    parts.push(if open == "!" { self.nested(Parser::unary) } else { self.expression() });
                }
                let close = if open == "{" { "}" } else { open };
                if open != "!" {
                    self.eat(close);
                }
            }
            Token::Name(word) if word == "not" => {
                self.tell(fault.help("put parentheses around `not …`"));
                self.at += 1;
                parts.push(self.nested(Parser::negation));
            }
            Token::End => {
                self.tell(fault);
                self.ended = true;
            }
            // An operator or a closing bracket, which the callers handle.
            Token::Symbol(s) if s != "{" => {
                self.tell(fault);
                if self.open.is_empty() && matches!(s, ")" | "]" | "}" | ",") {
                    self.at += 1;
                    if self.starts_operand() {
                        parts.push(self.nested(Parser::unary));
                    }
                }
            }
            _ => self.tell(fault),
        }
        let end = self.behind().max(start);
        Expr { kind: ExprKind::Broken(parts), start, end }
    }

    /// The fault of the next token where `wanted` is expected.
    fn unexpected(&self, wanted: &str) -> Fault {
        let Lexeme { token, start, end } = &self.lexemes[self.at];
        let fault = |message: String| Fault::new("syntax", *start, (*end).max(start + 1), message);
        let implicit = "there is no implicit multiplication: write `*`";
        match token {
            Token::End => fault(format!("the formula ends where {wanted} is expected")),
            Token::BadNumber(text) => {
                Fault::new("bad-number", *start, *end, format!("{} is not a number", quoted(text)))
                    .help(remedy_of_number(text))
            }
            Token::Unknown(c) => {
                let help = remedy(c.encode_utf8(&mut [0; 4]));
                let shown = if visible(*c) == *c { format!("`{c}`") } else { format!("U+{:04X}", u32::from(*c)) };
                fault(format!("{STRAY_CHARACTER} {shown}")).help(
                    help.unwrap_or("formulas are made of numbers, names and + - * / ^ ' ( ) [ ] , < <= > >= == !="),
                )
            }
            Token::Symbol(s) if self.open.is_empty() && matches!(*s, ")" | "]") => {
                fault(format!("`{s}` closes no bracket")).help("remove it, or open the bracket")
            }
            Token::Symbol(",") if self.open.is_empty() => fault(format!("`,` stands where {wanted} is expected"))
                .help("a formula is one expression; a vector is `[a, b]`"),
            Token::Symbol(s) => {
                let fault = fault(format!("`{s}` stands where {wanted} is expected"));
                match remedy(s) {
                    Some(help) => fault.help(help),
                    None => fault,
                }
            }
            Token::Name(word) if is_word(word) => fault(format!("`{word}` stands where {wanted} is expected")),
            Token::Name(name) => fault(format!("{} stands where {wanted} is expected", quoted(name))).help(implicit),
            Token::Text(_) => fault(format!("a text stands where {wanted} is expected"))
                .help("only a table has a name in quotes: `table(\"psf\", s)`"),
            Token::Number(_) => fault(format!("a number stands where {wanted} is expected")).help(implicit),
        }
    }
}

/// `2x` means `2*x`; anything else is malformed.
fn remedy_of_number(text: &str) -> String {
    let digits = text.find(|c: char| c.is_alphabetic() || c == '_').unwrap_or(text.len());
    let (number, name) = text.split_at(digits);
    let exponent = name.strip_prefix(['e', 'E']).is_some_and(|rest| rest.chars().all(|c| c.is_ascii_digit()));
    if name.is_empty() || exponent || number.parse::<f64>().is_err() || name.contains('.') {
        return "write a finite number such as `0.5` or `1e-3`".into();
    }
    let name: String = name.chars().take(40).collect();
    format!("write the multiplication: `{number}*{name}`, not `{number}{name}`")
}
