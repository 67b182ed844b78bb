//! Parses tokens to a syntax tree, whatever the text: unreadable input becomes a fault and an [`ExprKind::Broken`]
//! node, and parsing continues after it. Precedence, loosest first: `or`, `and`, `not`, comparisons, `+ -`, `* /`,
//! unary minus, `^` (right-associative), `'` and indexing. Long chains are lists, so that the tree is no deeper than
//! its brackets.

mod recovery;

pub use recovery::STRAY_CHARACTER;

use crate::lexer::{Lexeme, Token, lex};
use crate::limits::LIMITS;

/// A node of the syntax tree; `start..end` are bytes of the formula.
#[derive(Clone, PartialEq, Debug)]
pub struct Expr {
    pub kind: ExprKind,
    pub start: usize,
    pub end: usize,
}

/// Logical connective.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Junction {
    And,
    Or,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Relation {
    Lt,
    Le,
    Gt,
    Ge,
    Eq,
    Ne,
}

#[derive(Clone, PartialEq, Debug)]
pub enum ExprKind {
    Number(f64),
    Name(String),
    /// The name of a table, in quotes.
    Text(String),
    /// `[a, b]`; a list of lists is a matrix.
    List(Vec<Expr>),
    /// Terms; true means subtracted.
    Sum(Vec<(bool, Expr)>),
    /// Factors; true means divided by.
    Product(Vec<(bool, Expr)>),
    Negate(Box<Expr>),
    Power(Box<Expr>, Box<Expr>),
    Transpose(Box<Expr>),
    Index(Box<Expr>, Vec<Expr>),
    Call(String, Vec<Expr>),
    Compare(Relation, Box<Expr>, Box<Expr>),
    Joined(Junction, Vec<Expr>),
    Not(Box<Expr>),
    /// Unreadable input, its fault already reported, and its readable parts.
    Broken(Vec<Expr>),
}

/// A fault in a formula; offsets are relative to the formula.
#[derive(Clone, PartialEq, Debug)]
pub struct Fault {
    /// A stable identifier.
    pub code: &'static str,
    pub message: String,
    pub help: Option<String>,
    pub start: usize,
    pub end: usize,
}

impl Fault {
    pub fn new(code: &'static str, start: usize, end: usize, message: impl Into<String>) -> Fault {
        Fault { code, message: message.into(), help: None, start, end }
    }
    pub fn help(mut self, help: impl Into<String>) -> Fault {
        self.help = Some(help.into());
        self
    }
}

/// A formula's tree and its syntax faults.
pub struct Parsed {
    pub expr: Expr,
    pub faults: Vec<Fault>,
}

/// Parses a whole formula. `tokens_left` is the document's remaining budget; `None` once its exhaustion is reported.
pub fn parse(text: &str, tokens_left: &mut Option<usize>) -> Parsed {
    let broken = Expr { kind: ExprKind::Broken(Vec::new()), start: 0, end: text.len() };
    let Some(left) = tokens_left else { return Parsed { expr: broken, faults: Vec::new() } };
    let lexemes = lex(text);
    if lexemes.len() > *left {
        *tokens_left = None;
        let message = format!("the formulas of a document hold at most {} tokens", LIMITS.tokens);
        let fault = Fault::new("limit", 0, text.len(), message).help("shorten the formulas");
        return Parsed { expr: broken, faults: vec![fault] };
    }
    *left -= lexemes.len();
    let mut parser = Parser { lexemes, at: 0, depth: 0, open: Vec::new(), faults: Vec::new(), ended: false };
    let expr = parser.item("an operator or the end of the formula");
    Parsed { expr, faults: parser.faults }
}

struct Parser {
    lexemes: Vec<Lexeme>,
    at: usize,
    depth: usize,
    /// Closing brackets still expected, innermost last.
    open: Vec<&'static str>,
    faults: Vec<Fault>,
    /// Suppresses further faults after an early end of the formula or a limit.
    ended: bool,
}

impl Parser {
    fn peek(&self) -> &Token {
        &self.lexemes[self.at].token
    }

    /// Start of the next token.
    fn here(&self) -> usize {
        self.lexemes[self.at].start
    }

    /// End of the last token.
    fn behind(&self) -> usize {
        self.lexemes[self.at.saturating_sub(1)].end
    }

    fn is_at(&self, symbol: &str) -> bool {
        matches!(self.peek(), Token::Symbol(s) if *s == symbol)
    }

    fn is_at_word(&self, word: &str) -> bool {
        matches!(self.peek(), Token::Name(n) if n == word)
    }

    fn eat(&mut self, symbol: &str) -> bool {
        let hit = self.is_at(symbol);
        self.at += usize::from(hit);
        hit
    }

    /// Runs `inner` one level deeper; at the depth limit reports a fault and skips the rest of the formula.
    fn nested(&mut self, inner: fn(&mut Parser) -> Expr) -> Expr {
        if self.depth == LIMITS.depth {
            let message = format!("a formula is nested at most {} deep", LIMITS.depth);
            return self.give_up(message, "give the inner part a definition of its own");
        }
        self.depth += 1;
        let result = inner(self);
        self.depth -= 1;
        result
    }

    fn expression(&mut self) -> Expr {
        self.nested(Parser::disjunction)
    }

    /// Parses parts joined by `word`; other languages spell it `foreign`.
    fn chain(
        &mut self,
        (word, foreign): (&str, &str),
        part: fn(&mut Parser) -> Expr,
        make: fn(Vec<Expr>) -> ExprKind,
    ) -> Expr {
        let mut parts = vec![part(self)];
        let mut broken = false;
        while self.is_at_word(word) || self.is_at(foreign) {
            broken |= self.tell_foreign();
            self.at += 1;
            parts.push(part(self));
        }
        let make = if broken { ExprKind::Broken } else { make };
        if parts.len() == 1 { parts.remove(0) } else { enclose(make, parts) }
    }

    fn disjunction(&mut self) -> Expr {
        self.chain(("or", "||"), Parser::conjunction, |parts| ExprKind::Joined(Junction::Or, parts))
    }

    fn conjunction(&mut self) -> Expr {
        self.chain(("and", "&&"), Parser::negation, |parts| ExprKind::Joined(Junction::And, parts))
    }

    fn negation(&mut self) -> Expr {
        if !self.is_at_word("not") {
            return self.comparison();
        }
        let start = self.here();
        self.at += 1;
        let inner = self.nested(Parser::negation);
        let end = inner.end;
        Expr { kind: ExprKind::Not(Box::new(inner)), start, end }
    }

    fn comparison(&mut self) -> Expr {
        let left = self.sum();
        let Some(relation) = self.relation() else { return left };
        let mut broken = self.tell_foreign();
        self.at += 1;
        if broken && self.behind() == self.here() && (self.is_at("<") || self.is_at(">")) {
            // `=<` and `=>`
            self.at += 1;
        }
        let mut parts = vec![left, self.sum()];
        while self.relation().is_some() {
            if !broken {
                let at = &self.lexemes[self.at];
                let fault = Fault::new("syntax", at.start, at.end, "comparisons do not chain");
                self.tell(fault.help("write `a < b and b < c`"));
            }
            broken = true;
            self.at += 1;
            parts.push(self.sum());
        }
        if broken {
            return enclose(ExprKind::Broken, parts);
        }
        let (right, left) = (parts.remove(1), parts.remove(0));
        let (start, end) = (left.start, right.end);
        Expr { kind: ExprKind::Compare(relation, Box::new(left), Box::new(right)), start, end }
    }

    fn relation(&self) -> Option<Relation> {
        let Token::Symbol(symbol) = self.peek() else { return None };
        Some(match *symbol {
            "<" => Relation::Lt,
            "<=" => Relation::Le,
            ">" => Relation::Gt,
            ">=" => Relation::Ge,
            "==" | "=" => Relation::Eq,
            "!=" => Relation::Ne,
            _ => return None,
        })
    }

    fn sum(&mut self) -> Expr {
        let mut parts = vec![(false, self.product())];
        while self.is_at("+") || self.is_at("-") {
            let negative = self.is_at("-");
            self.at += 1;
            parts.push((negative, self.product()));
        }
        if parts.len() == 1 {
            return parts.remove(0).1;
        }
        let (start, end) = (parts[0].1.start, parts[parts.len() - 1].1.end);
        Expr { kind: ExprKind::Sum(parts), start, end }
    }

    fn product(&mut self) -> Expr {
        let mut parts = vec![(false, self.unary())];
        let mut broken = false;
        loop {
            let inverse = self.is_at("/");
            if inverse || self.is_at("*") {
                self.at += 1;
            } else if self.starts_operand() {
                // Only the first is reported.
                if !std::mem::replace(&mut broken, true) {
                    self.tell_implicit(&mut parts);
                }
            } else if self.tell_modulo() {
                broken = true;
            } else {
                break;
            }
            parts.push((inverse, self.unary()));
        }
        if broken {
            return enclose(ExprKind::Broken, parts.into_iter().map(|(_, part)| part).collect());
        }
        if parts.len() == 1 {
            return parts.remove(0).1;
        }
        let (start, end) = (parts[0].1.start, parts[parts.len() - 1].1.end);
        Expr { kind: ExprKind::Product(parts), start, end }
    }

    fn unary(&mut self) -> Expr {
        let start = self.here();
        if self.eat("-") {
            let inner = self.nested(Parser::unary);
            let end = inner.end;
            return Expr { kind: ExprKind::Negate(Box::new(inner)), start, end };
        }
        if self.eat("+") {
            return self.nested(Parser::unary);
        }
        self.power()
    }

    fn power(&mut self) -> Expr {
        let base = self.postfix();
        if !(self.is_at("^") || self.is_at("**")) {
            return base;
        }
        let broken = self.tell_foreign();
        self.at += 1;
        let exponent = self.nested(Parser::unary);
        if broken {
            return enclose(ExprKind::Broken, vec![base, exponent]);
        }
        let (start, end) = (base.start, exponent.end);
        Expr { kind: ExprKind::Power(Box::new(base), Box::new(exponent)), start, end }
    }

    fn postfix(&mut self) -> Expr {
        let mut expr = self.primary();
        let mut levels = 0;
        loop {
            let (start, open) = (expr.start, self.here());
            if !(self.is_at("'") || self.is_at("[")) {
                return expr;
            }
            levels += 1;
            if levels > 8 {
                let message = "more than 8 transpositions and indices in a row";
                return self.give_up(message.into(), "a double transposition is the thing itself");
            }
            let kind = if self.eat("'") {
                ExprKind::Transpose(Box::new(expr))
            } else {
                self.at += 1;
                match self.arguments("]", open) {
                    Ok(indices) => ExprKind::Index(Box::new(expr), indices),
                    Err(mut parts) => {
                        parts.push(expr);
                        ExprKind::Broken(parts)
                    }
                }
            };
            expr = Expr { kind, start, end: self.behind() };
        }
    }

    /// Parses the list after the bracket at `open`, with its closing bracket; `Err` with the parts if that is missing.
    fn arguments(&mut self, close: &'static str, open: usize) -> Result<Vec<Expr>, Vec<Expr>> {
        let mut list = Vec::new();
        if self.eat(close) {
            return Ok(list);
        }
        self.open.push(close);
        let wanted = if close == ")" { "`,` or `)`" } else { "`,` or `]`" };
        list.push(self.item(wanted));
        while self.is_at(",") {
            let comma = self.here();
            self.at += 1;
            if self.is_at(close) {
                let fault = Fault::new("syntax", comma, comma + 1, "nothing stands behind the last `,`");
                self.tell(fault.help("remove it"));
                break;
            }
            list.push(self.item(wanted));
        }
        if self.close(close, open) { Ok(list) } else { Err(list) }
    }

    fn primary(&mut self) -> Expr {
        let Lexeme { token, start, end } = self.lexemes[self.at].clone();
        let kind = match token {
            Token::Number(value) => ExprKind::Number(value),
            Token::Text(name) => ExprKind::Text(name),
            Token::Name(name) if !is_word(&name) => {
                self.at += 1;
                let open = self.here();
                if !self.eat("(") {
                    return Expr { kind: ExprKind::Name(name), start, end };
                }
                let kind = self.arguments(")", open).map_or_else(ExprKind::Broken, |list| ExprKind::Call(name, list));
                return Expr { kind, start, end: self.behind() };
            }
            Token::Symbol("(") => {
                self.at += 1;
                return self.parenthesis(start);
            }
            Token::Symbol("[") => {
                self.at += 1;
                let kind = self.arguments("]", start).map_or_else(ExprKind::Broken, ExprKind::List);
                return Expr { kind, start, end: self.behind() };
            }
            _ => return self.no_operand(),
        };
        self.at += 1;
        Expr { kind, start, end }
    }

    /// Parses the rest after the opening parenthesis at `start`.
    fn parenthesis(&mut self, start: usize) -> Expr {
        self.open.push(")");
        let mut inner = self.item("`)`");
        if self.is_at(",") {
            let at = self.here();
            let fault = Fault::new("syntax", at, at + 1, "`,` stands where `)` is expected");
            self.tell(fault.help("vectors are written in square brackets: `[a, b]`"));
            let mut parts = vec![inner];
            while self.eat(",") {
                parts.push(self.item("`)`"));
            }
            inner = enclose(ExprKind::Broken, parts);
        }
        if !self.close(")", start) {
            inner = enclose(ExprKind::Broken, vec![inner]);
        }
        Expr { start, end: self.behind(), ..inner }
    }
}

/// True of operators that are words.
fn is_word(name: &str) -> bool {
    matches!(name, "and" | "or" | "not")
}

fn enclose(make: fn(Vec<Expr>) -> ExprKind, parts: Vec<Expr>) -> Expr {
    let (start, end) = (parts[0].start, parts[parts.len() - 1].end);
    Expr { kind: make(parts), start, end }
}
