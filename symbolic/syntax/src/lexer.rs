//! Splits a formula into tokens with byte offsets. Never fails: unknown input becomes a token of its own.

/// A token of a formula.
#[derive(Clone, PartialEq, Debug)]
pub enum Token {
    Number(f64),
    Name(String),
    /// Text between double quotes: the name of a table.
    Text(String),
    /// An operator, bracket or comma, as written.
    Symbol(&'static str),
    /// A malformed number.
    BadNumber(String),
    /// A character outside the language.
    Unknown(char),
    End,
}

/// A token and its byte range in the formula.
#[derive(Clone, PartialEq, Debug)]
pub struct Lexeme {
    pub token: Token,
    pub start: usize,
    pub end: usize,
}

/// The longest match wins. The second line has other languages' spellings, for which the parser suggests the right one.
const SYMBOLS: [&str; 28] = [
    "<=", ">=", "==", "!=", "+", "-", "*", "/", "^", "'", "(", ")", "[", "]", ",", "<", ">", //
    "**", "&&", "||", "=", "!", ";", ":", "{", "}", "%", "|",
];

/// Splits a formula; the last lexeme is `End`.
pub fn lex(text: &str) -> Vec<Lexeme> {
    let mut lexemes = Vec::new();
    let mut at = 0;
    while let Some(first) = text[at..].chars().next() {
        let rest = &text[at..];
        if first.is_whitespace() {
            at += first.len_utf8();
            continue;
        }
        let (token, length) =
            if first.is_ascii_digit() || (first == '.' && rest[1..].starts_with(|c: char| c.is_ascii_digit())) {
                number(rest)
            } else if first.is_alphabetic() || first == '_' {
                let length = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
                (Token::Name(rest[..length].to_string()), length)
            } else if let Some(inner) = rest.strip_prefix('"').and_then(|rest| rest.split_once('"')) {
                (Token::Text(inner.0.to_string()), inner.0.len() + 2)
            } else {
                let known = SYMBOLS.iter().filter(|s| rest.starts_with(**s)).max_by_key(|s| s.len());
                known.map_or((Token::Unknown(first), first.len_utf8()), |s| (Token::Symbol(s), s.len()))
            };
        lexemes.push(Lexeme { token, start: at, end: at + length });
        at += length;
    }
    lexemes.push(Lexeme { token: Token::End, start: text.len(), end: text.len() });
    lexemes
}

/// Digits, a fraction, an exponent; a word attached to them (`2x`, `1.2.3`) makes a bad number.
fn number(text: &str) -> (Token, usize) {
    let bytes = text.as_bytes();
    let digits = |mut i: usize| {
        while i < bytes.len() && bytes[i].is_ascii_digit() {
            i += 1;
        }
        i
    };
    let mut end = digits(0);
    if end < bytes.len() && bytes[end] == b'.' {
        end = digits(end + 1);
    }
    if end < bytes.len() && (bytes[end] | 32) == b'e' {
        let sign = usize::from(end + 1 < bytes.len() && (bytes[end + 1] == b'+' || bytes[end + 1] == b'-'));
        let exponent = digits(end + 1 + sign);
        if exponent > end + 1 + sign {
            end = exponent;
        }
    }
    let word =
        text[end..].find(|c: char| !(c.is_alphanumeric() || c == '_' || c == '.')).map_or(text.len(), |i| end + i);
    match text[..word].parse::<f64>() {
        Ok(value) if word == end && value.is_finite() => (Token::Number(value), end),
        _ => (Token::BadNumber(text[..word].to_string()), word),
    }
}
