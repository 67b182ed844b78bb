//! Spells numbers, functions and operations in each language.

use isophote_symbolic::{Function1, Function2, Lookup, Op, Opcode, Precision, Value, spelled};

use crate::options::{Language, PixelType};

/// An operation in C and in Rust: `$0`, `$1`, `$2` are operands, `$_` is the opcode's payload, `$s` the first operand in
/// a form that takes a method call, and `$f` is `f` for single precision. Empty for what depends on context: a leaf on
/// the loops around it, an elementary function on the language's library.
fn syntax(code: Opcode) -> [&'static str; 2] {
    match code {
        Opcode::Neg => ["-$s", "-$s"],
        Opcode::Abs => ["fabs$f($0)", "$s.abs()"],
        Opcode::Sqrt => ["sqrt$f($0)", "$s.sqrt()"],
        Opcode::Add => ["$0 + $1", "$0 + $1"],
        Opcode::Sub => ["$0 - $1", "$0 - $1"],
        Opcode::Mul => ["$0 * $1", "$0 * $1"],
        Opcode::Div => ["$0 / $1", "$0 / $1"],
        Opcode::Fma => ["fma$f($0, $1, $2)", "$s.mul_add($1, $2)"],
        Opcode::Compare(_) => ["$0 $_ $1", "$0 $_ $1"],
        Opcode::And => ["$0 && $1", "$0 && $1"],
        Opcode::Or => ["$0 || $1", "$0 || $1"],
        Opcode::Not => ["!$0", "!$0"],
        Opcode::Select => ["$0 ? $1 : $2", "if $0 { $1 } else { $2 }"],
        Opcode::Call1(_) | Opcode::Call2(_) | Opcode::Gather(_) => ["", ""],
        Opcode::Const(_) | Opcode::Input(_) | Opcode::Outer(_) | Opcode::Offset | Opcode::Channel(_) => ["", ""],
        Opcode::RowTotal(_) | Opcode::RowCount | Opcode::PassTotal(_) | Opcode::PassCount => ["", ""],
    }
}

/// The type of a variable.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Held {
    Number,
    Truth,
}

/// A language, and the arithmetic of the current level.
#[derive(Clone, Copy)]
pub(super) struct Dialect {
    pub language: Language,
    pub real: Precision,
}

impl Dialect {
    /// The type of a number.
    pub fn number(self) -> &'static str {
        match (self.language, self.real) {
            (Language::C, Precision::F32) => "float",
            (Language::C, Precision::F64) => "double",
            (Language::Rust, Precision::F32) => "f32",
            (Language::Rust, Precision::F64) => "f64",
        }
    }

    /// A number, rounded to the level's arithmetic.
    pub fn literal(self, value: f64) -> String {
        let value = match self.real {
            Precision::F32 => f64::from(value as f32),
            Precision::F64 => value,
        };
        if value.is_nan() || value.is_infinite() {
            let sign = if value < 0.0 { "-" } else { "" };
            return match (self.language, value.is_nan()) {
                (Language::C, true) => "NAN".into(),
                (Language::C, false) => format!("({sign}INFINITY)"),
                (Language::Rust, true) => format!("{}::NAN", self.number()),
                (Language::Rust, false) => format!("({sign}{}::INFINITY)", self.number()),
            };
        }
        match (self.language, self.real) {
            (Language::C, Precision::F32) => format!("{:?}f", value as f32),
            (Language::Rust, Precision::F32) => format!("{:?}", value as f32),
            (_, Precision::F64) => format!("{value:?}"),
        }
    }

    /// `const float name = expression;`
    pub fn declare(self, name: &str, held: Held, expression: &str) -> String {
        match (self.language, held) {
            (Language::C, Held::Truth) => format!("const bool {name} = {expression};"),
            (Language::C, Held::Number) => format!("const {} {name} = {expression};", self.number()),
            (Language::Rust, Held::Truth) => format!("let {name}: bool = {expression};"),
            (Language::Rust, Held::Number) => format!("let {name}: {} = {expression};", self.number()),
        }
    }

    /// An f64 converted to the level's arithmetic.
    pub fn rounded(self, name: &str) -> String {
        match self.language {
            Language::C => format!("({}){name}", self.number()),
            Language::Rust => format!("{name} as {}", self.number()),
        }
    }

    /// A number of the level as f64.
    pub fn widened(self, name: &str) -> String {
        match (self.language, self.real) {
            (Language::C, Precision::F64) => name.to_string(),
            (Language::C, Precision::F32) => format!("(double){name}"),
            (Language::Rust, Precision::F64) => self.receiver(name),
            (Language::Rust, Precision::F32) => format!("f64::from({})", self.receiver(name)),
        }
    }

    /// A pixel in the level's arithmetic.
    pub fn pixel(self, place: &str, pixel: PixelType) -> String {
        match (self.language, pixel, self.real) {
            (_, PixelType::F32, Precision::F32) => place.to_string(),
            (Language::C, ..) => format!("({}){place}", self.number()),
            (Language::Rust, ..) => format!("{}::from({place})", self.number()),
        }
    }

    /// An operation; `a` spells its operands.
    pub fn operation(self, op: Op, a: &dyn Fn(Value) -> String) -> String {
        match op.parts() {
            (Opcode::Call1(f), &[x]) => self.elementary(f, &a(x)),
            (Opcode::Gather(lookup), &[x, y]) => self.looked_up(lookup, &a(x), &a(y)),
            (Opcode::Call2(f), &[x, y]) => self.elementary2(f, &a(x), &a(y)),
            (code, operands) => {
                let text = syntax(code)[if self.language == Language::C { 0 } else { 1 }];
                spelled(text, |mark| match (mark, code) {
                    ('f', _) if self.real == Precision::F32 => "f".into(),
                    ('f', _) => String::new(),
                    ('s', _) => self.receiver(&a(operands[0])),
                    ('_', Opcode::Compare(comparison)) => comparison.sign().into(),
                    (mark, _) => operands[mark as usize - '0' as usize..].first().map_or_else(String::new, |v| a(*v)),
                })
            }
        }
    }

    /// A method's receiver or a sign's operand: a literal gets brackets, and its type where possible.
    fn receiver(self, text: &str) -> String {
        match (is_number(text), self.language) {
            (true, Language::C) => format!("({text})"),
            (true, Language::Rust) => format!("({text}_{})", self.number()),
            (false, _) => text.to_string(),
        }
    }

    /// Rounds the f64 result of a call once.
    fn back(self, call: String) -> String {
        match (self.language, self.real) {
            (_, Precision::F64) => call,
            (Language::C, Precision::F32) => format!("(float){call}"),
            (Language::Rust, Precision::F32) => format!("{call} as f32"),
        }
    }

    fn elementary(self, f: Function1, x: &str) -> String {
        let x = self.widened(x);
        let special = |name: &str, order: u32| format!("{name}({order}, {x})");
        self.back(match (self.language, f) {
            (_, Function1::BesselJ0) => special("bessel_ratio", 0),
            (Language::C, Function1::BesselJ1) => format!("({x} * {})", special("bessel_ratio", 1)),
            // Brackets around a whole assignment cause a warning.
            (Language::Rust, Function1::BesselJ1) => {
                format!("core::ops::Mul::mul({x}, {})", special("bessel_ratio", 1))
            }
            (_, Function1::BesselRatio1) => special("bessel_ratio", 1),
            (_, Function1::BesselRatio2) => special("bessel_ratio", 2),
            (_, Function1::Sinc) => special("sinc_ratio", 0),
            (_, Function1::SincRatio) => special("sinc_ratio", 1),
            (Language::C, _) => format!("{}({x})", f.name()),
            (Language::Rust, Function1::Erf | Function1::Erfc | Function1::Fraction) => format!("{}({x})", f.name()),
            (Language::Rust, Function1::Log | Function1::LogVariance) => format!("({x}).ln()"),
            (Language::Rust, _) => format!("({x}).{}()", f.name()),
        })
    }

    /// Calls the function that is written into the file for each table.
    fn looked_up(self, lookup: Lookup, x: &str, y: &str) -> String {
        let (x, y) = (self.widened(x), self.widened(y));
        self.back(format!("table_{}({}, {x}, {y})", lookup.table, lookup.coefficient))
    }

    fn elementary2(self, f: Function2, x: &str, y: &str) -> String {
        let (x, y) = (self.widened(x), self.widened(y));
        self.back(match (self.language, f) {
            (Language::C, _) => format!("{}({x}, {y})", f.name()),
            (Language::Rust, Function2::Atan2) => format!("({x}).atan2({y})"),
            (Language::Rust, Function2::Pow) => format!("({x}).powf({y})"),
        })
    }
}

fn is_number(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_digit() || c == '-')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operation_has_a_spelling_in_every_language() {
        let operand = |v: Value| ["a", "b", "c"][v.index()].to_string();
        for code in Opcode::every() {
            let op = match code.row().operands.len() {
                1 => code.of([Value(0)]),
                2 => code.of([Value(0), Value(1)]),
                3 => code.of([Value(0), Value(1), Value(2)]),
                _ => continue, // leaves are written elsewhere
            };
            // No language has likelihood functions or the inner coordinate.
            let has_no_word = matches!(code, Opcode::Offset | Opcode::Call1(Function1::LogTail | Function1::Hazard));
            for (language, real) in [
                (Language::C, Precision::F32),
                (Language::C, Precision::F64),
                (Language::Rust, Precision::F32),
                (Language::Rust, Precision::F64),
            ] {
                let text = Dialect { language, real }.operation(op, &operand);
                let is_whole = op.operands().all(|v| text.contains(&operand(v))) && !text.contains('$');
                assert!(is_whole || has_no_word, "{code:?} in {language:?}: `{text}`");
            }
        }
    }
}
