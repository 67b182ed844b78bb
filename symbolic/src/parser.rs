//! Tokens in, a syntax tree out. Precedence, loosest first: `or`, `and`, `not`, comparisons, `+ -`, `* /`, unary minus,
//! `^` (right-associative), `'` and indexing. Long chains are lists, so that the tree is no deeper than its brackets.

use crate::diagnostic::quoted;
use crate::lexer::{Lexeme, Token, lex};
use crate::limits::LIMITS;

/// A node of the syntax tree; `start..end` are bytes of the formula.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Expr {
    pub kind: Kind,
    pub start: usize,
    pub end: usize,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Relation {
    Lt,
    Le,
    Gt,
    Ge,
    Eq,
    Ne,
}

#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Kind {
    Number(f64),
    Name(String),
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
    And(Vec<Expr>),
    Or(Vec<Expr>),
    Not(Box<Expr>),
}

/// A fault inside a formula, before the document knows where the formula stands.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Fault {
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

/// Parses a whole formula. `tokens_left` is the document's remaining budget.
pub(crate) fn parse(text: &str, tokens_left: &mut usize) -> Result<Expr, Fault> {
    let lexemes = lex(text);
    if lexemes.len() > *tokens_left {
        let message = format!("the formulas of a document hold at most {} tokens", LIMITS.tokens);
        return Err(Fault::new("limit", 0, text.len(), message).help("shorten the formulas"));
    }
    *tokens_left -= lexemes.len();
    let mut parser = Parser { lexemes, at: 0, depth: 0 };
    let expr = parser.expression()?;
    match parser.peek() {
        Token::End => Ok(expr),
        _ => Err(parser.unexpected("an operator or the end of the formula")),
    }
}

struct Parser {
    lexemes: Vec<Lexeme>,
    at: usize,
    depth: usize,
}

type Parsed = Result<Expr, Fault>;

impl Parser {
    fn peek(&self) -> &Token {
        &self.lexemes[self.at].token
    }

    fn eat(&mut self, symbol: &str) -> bool {
        let hit = matches!(self.peek(), Token::Symbol(s) if *s == symbol);
        self.at += usize::from(hit);
        hit
    }

    fn eat_word(&mut self, word: &str) -> bool {
        let hit = matches!(self.peek(), Token::Name(n) if n == word);
        self.at += usize::from(hit);
        hit
    }

    fn expect(&mut self, symbol: &str, opened: Option<usize>) -> Result<(), Fault> {
        if self.eat(symbol) {
            return Ok(());
        }
        let fault = self.unexpected(&format!("`{symbol}`"));
        Err(match opened {
            Some(start) if matches!(self.peek(), Token::End) => {
                Fault::new("syntax", start, start + 1, "this bracket is never closed").help(format!("add `{symbol}`"))
            }
            _ => fault,
        })
    }

    fn unexpected(&self, wanted: &str) -> Fault {
        let Lexeme { token, start, end } = &self.lexemes[self.at];
        let fault = |message: String| Fault::new("syntax", *start, (*end).max(start + 1), message);
        match token {
            Token::End => fault(format!("the formula ends where {wanted} is expected")),
            Token::BadNumber(text) => {
                let sticks = text.chars().any(char::is_alphabetic);
                let help = if sticks {
                    "write the multiplication: `2*x`, not `2x`"
                } else {
                    "write a finite number such as `0.5` or `1e-3`"
                };
                Fault::new("bad-number", *start, *end, format!("{} is not a number", quoted(text))).help(help)
            }
            Token::Unknown(c) => fault(format!("no formula holds the character {}", quoted(&c.to_string())))
                .help("formulas are made of numbers, names and + - * / ^ ' ( ) [ ] , < <= > >= == !="),
            Token::Symbol(s) => {
                let fault = fault(format!("`{s}` stands where {wanted} is expected"));
                match *s {
                    "**" => fault.help("powers are written `^`"),
                    "&&" => fault.help("write `and`"),
                    "||" => fault.help("write `or`"),
                    "!" => fault.help("write `not`"),
                    "=" => fault.help("comparisons are written `==`, `<=`, `>=`"),
                    _ => fault,
                }
            }
            Token::Name(name) => fault(format!("{} stands where {wanted} is expected", quoted(name)))
                .help("there is no implicit multiplication: write `*`"),
            Token::Number(_) => fault(format!("a number stands where {wanted} is expected"))
                .help("there is no implicit multiplication: write `*`"),
        }
    }

    /// Runs `inner` one level deeper, or says that the formula is nested too deeply.
    fn nested(&mut self, inner: impl FnOnce(&mut Parser) -> Parsed) -> Parsed {
        self.depth += 1;
        if self.depth > LIMITS.depth {
            let at = &self.lexemes[self.at];
            let message = format!("a formula is nested at most {} deep", LIMITS.depth);
            return Err(
                Fault::new("limit", at.start, at.end, message).help("give the inner part a definition of its own")
            );
        }
        let result = inner(self);
        self.depth -= 1;
        result
    }

    fn expression(&mut self) -> Parsed {
        self.nested(Parser::disjunction)
    }

    fn chain(&mut self, word: &str, part: fn(&mut Parser) -> Parsed, make: fn(Vec<Expr>) -> Kind) -> Parsed {
        let first = part(self)?;
        let mut parts = vec![first];
        while self.eat_word(word) {
            parts.push(part(self)?);
        }
        Ok(if parts.len() == 1 { parts.remove(0) } else { enclose(make, parts) })
    }

    fn disjunction(&mut self) -> Parsed {
        self.chain("or", Parser::conjunction, Kind::Or)
    }

    fn conjunction(&mut self) -> Parsed {
        self.chain("and", Parser::negation, Kind::And)
    }

    fn negation(&mut self) -> Parsed {
        let start = self.lexemes[self.at].start;
        if self.eat_word("not") {
            let inner = self.nested(Parser::negation)?;
            let end = inner.end;
            return Ok(Expr { kind: Kind::Not(Box::new(inner)), start, end });
        }
        self.comparison()
    }

    fn comparison(&mut self) -> Parsed {
        let left = self.sum()?;
        let Some(relation) = self.relation() else { return Ok(left) };
        self.at += 1;
        let right = self.sum()?;
        if self.relation().is_some() {
            let at = &self.lexemes[self.at];
            return Err(
                Fault::new("syntax", at.start, at.end, "comparisons do not chain").help("write `a < b and b < c`")
            );
        }
        let (start, end) = (left.start, right.end);
        Ok(Expr { kind: Kind::Compare(relation, Box::new(left), Box::new(right)), start, end })
    }

    fn relation(&self) -> Option<Relation> {
        let Token::Symbol(symbol) = self.peek() else { return None };
        Some(match *symbol {
            "<" => Relation::Lt,
            "<=" => Relation::Le,
            ">" => Relation::Gt,
            ">=" => Relation::Ge,
            "==" => Relation::Eq,
            "!=" => Relation::Ne,
            _ => return None,
        })
    }

    fn list_of(
        &mut self,
        plus: &str,
        minus: &str,
        part: fn(&mut Parser) -> Parsed,
        make: fn(Vec<(bool, Expr)>) -> Kind,
    ) -> Parsed {
        let mut parts = vec![(false, part(self)?)];
        loop {
            let inverse = if self.eat(plus) {
                false
            } else if self.eat(minus) {
                true
            } else {
                break;
            };
            parts.push((inverse, part(self)?));
        }
        if parts.len() == 1 {
            return Ok(parts.remove(0).1);
        }
        let (start, end) = (parts[0].1.start, parts[parts.len() - 1].1.end);
        Ok(Expr { kind: make(parts), start, end })
    }

    fn sum(&mut self) -> Parsed {
        self.list_of("+", "-", Parser::product, Kind::Sum)
    }

    fn product(&mut self) -> Parsed {
        self.list_of("*", "/", Parser::unary, Kind::Product)
    }

    fn unary(&mut self) -> Parsed {
        let start = self.lexemes[self.at].start;
        if self.eat("-") {
            let inner = self.nested(Parser::unary)?;
            let end = inner.end;
            return Ok(Expr { kind: Kind::Negate(Box::new(inner)), start, end });
        }
        if self.eat("+") {
            return self.nested(Parser::unary);
        }
        self.power()
    }

    fn power(&mut self) -> Parsed {
        let base = self.postfix()?;
        if !self.eat("^") {
            return Ok(base);
        }
        let exponent = self.nested(Parser::unary)?;
        let (start, end) = (base.start, exponent.end);
        Ok(Expr { kind: Kind::Power(Box::new(base), Box::new(exponent)), start, end })
    }

    fn postfix(&mut self) -> Parsed {
        let mut expr = self.primary()?;
        let mut levels = 0;
        loop {
            let (start, open) = (expr.start, self.lexemes[self.at].start);
            let kind = if self.eat("'") {
                Kind::Transpose(Box::new(expr))
            } else if self.eat("[") {
                let indices = self.arguments("]", open)?;
                Kind::Index(Box::new(expr), indices)
            } else {
                return Ok(expr);
            };
            levels += 1;
            if levels > 8 {
                let fault = Fault::new("limit", open, open + 1, "more than 8 transpositions and indices in a row");
                return Err(fault.help("a double transposition is the thing itself"));
            }
            expr = Expr { kind, start, end: self.lexemes[self.at - 1].end };
        }
    }

    /// What stands between brackets, `open` being where they opened; eats the closing one.
    fn arguments(&mut self, close: &str, open: usize) -> Result<Vec<Expr>, Fault> {
        let mut list = Vec::new();
        if self.eat(close) {
            return Ok(list);
        }
        loop {
            list.push(self.expression()?);
            if !self.eat(",") {
                self.expect(close, Some(open))?;
                return Ok(list);
            }
        }
    }

    fn primary(&mut self) -> Parsed {
        let Lexeme { token, start, end } = self.lexemes[self.at].clone();
        let kind = match token {
            Token::Number(value) => Kind::Number(value),
            Token::Name(name) if !matches!(name.as_str(), "and" | "or" | "not") => {
                self.at += 1;
                let open = self.lexemes[self.at].start;
                if !self.eat("(") {
                    return Ok(Expr { kind: Kind::Name(name), start, end });
                }
                let arguments = self.arguments(")", open)?;
                return Ok(Expr { kind: Kind::Call(name, arguments), start, end: self.lexemes[self.at - 1].end });
            }
            Token::Symbol("(") => {
                self.at += 1;
                let inner = self.expression()?;
                self.expect(")", Some(start))?;
                return Ok(Expr { start, end: self.lexemes[self.at - 1].end, ..inner });
            }
            Token::Symbol("[") => {
                self.at += 1;
                let list = self.arguments("]", start)?;
                return Ok(Expr { kind: Kind::List(list), start, end: self.lexemes[self.at - 1].end });
            }
            _ => return Err(self.unexpected("a number, a name or a bracket")),
        };
        self.at += 1;
        Ok(Expr { kind, start, end })
    }
}

fn enclose(make: fn(Vec<Expr>) -> Kind, parts: Vec<Expr>) -> Expr {
    let (start, end) = (parts[0].start, parts[parts.len() - 1].end);
    Expr { kind: make(parts), start, end }
}
