//! How each language spells an operation on single numbers: one table.

use isophote_symbolic::{Comparison, Function1, Function2, Op, Precision, Value};

use crate::options::{Language, PixelType};

/// A spelling: a language, and the arithmetic of the place.
#[derive(Clone, Copy)]
pub(super) struct Spelling {
    pub language: Language,
    pub real: Precision,
}

impl Spelling {
    /// The type of a number.
    pub fn number(self) -> &'static str {
        match (self.language, self.real) {
            (Language::C, Precision::F32) => "float",
            (Language::C, Precision::F64) => "double",
            (Language::Rust, Precision::F32) => "f32",
            (Language::Rust, Precision::F64) => "f64",
        }
    }

    /// A number, rounded to the place's arithmetic.
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
    pub fn declare(self, name: &str, truth: bool, expression: &str) -> String {
        match (self.language, truth) {
            (Language::C, true) => format!("const bool {name} = {expression};"),
            (Language::C, false) => format!("const {} {name} = {expression};", self.number()),
            (Language::Rust, true) => format!("let {name}: bool = {expression};"),
            (Language::Rust, false) => format!("let {name}: {} = {expression};", self.number()),
        }
    }

    /// A number of f64 in the place's arithmetic.
    pub fn rounded(self, name: &str) -> String {
        match self.language {
            Language::C => format!("({}){name}", self.number()),
            Language::Rust => format!("{name} as {}", self.number()),
        }
    }

    /// A truth value as 0 or 1.
    pub fn of_truth(self, name: &str) -> String {
        match self.language {
            Language::C => format!("({}){name}", self.number()),
            Language::Rust => format!("{}::from(u8::from({name}))", self.number()),
        }
    }

    /// A number of the place as f64.
    pub fn widened(self, name: &str) -> String {
        match (self.language, self.real) {
            (Language::C, Precision::F64) => name.to_string(),
            (Language::C, Precision::F32) => format!("(double){name}"),
            (Language::Rust, Precision::F64) => self.receiver(name),
            (Language::Rust, Precision::F32) => format!("f64::from({})", self.receiver(name)),
        }
    }

    /// A pixel in the place's arithmetic.
    pub fn pixel(self, place: &str, pixel: PixelType) -> String {
        match (self.language, pixel, self.real) {
            (_, PixelType::F32, Precision::F32) => place.to_string(),
            (Language::C, ..) => format!("({}){place}", self.number()),
            (Language::Rust, ..) => format!("{}::from({place})", self.number()),
        }
    }

    /// An operation that reads values; `a` gives their spelling.
    pub fn operation(self, op: Op, a: &dyn Fn(Value) -> String) -> String {
        let call1 = |c: &str, rust: &str, x: Value| match (self.language, self.real) {
            (Language::C, Precision::F32) => format!("{c}f({})", a(x)),
            (Language::C, Precision::F64) => format!("{c}({})", a(x)),
            (Language::Rust, _) => format!("{}.{rust}()", self.receiver(&a(x))),
        };
        match op {
            Op::Neg(x) if is_number(&a(x)) => format!("-({})", a(x)),
            Op::Neg(x) => format!("-{}", a(x)),
            Op::Abs(x) => call1("fabs", "abs", x),
            Op::Sqrt(x) => call1("sqrt", "sqrt", x),
            Op::Add(x, y) => format!("{} + {}", a(x), a(y)),
            Op::Sub(x, y) => format!("{} - {}", a(x), a(y)),
            Op::Mul(x, y) => format!("{} * {}", a(x), a(y)),
            Op::Div(x, y) => format!("{} / {}", a(x), a(y)),
            Op::Fma(x, y, z) => match (self.language, self.real) {
                (Language::C, Precision::F32) => format!("fmaf({}, {}, {})", a(x), a(y), a(z)),
                (Language::C, Precision::F64) => format!("fma({}, {}, {})", a(x), a(y), a(z)),
                (Language::Rust, _) => format!("{}.mul_add({}, {})", self.receiver(&a(x)), a(y), a(z)),
            },
            Op::Compare(c, x, y) => {
                let sign = match c {
                    Comparison::Lt => "<",
                    Comparison::Le => "<=",
                    Comparison::Eq => "==",
                    Comparison::Ne => "!=",
                };
                format!("{} {sign} {}", a(x), a(y))
            }
            Op::And(x, y) => format!("{} && {}", a(x), a(y)),
            Op::Or(x, y) => format!("{} || {}", a(x), a(y)),
            Op::Not(x) => format!("!{}", a(x)),
            Op::Select(c, x, y) => match self.language {
                Language::C => format!("{} ? {} : {}", a(c), a(x), a(y)),
                Language::Rust => format!("if {} {{ {} }} else {{ {} }}", a(c), a(x), a(y)),
            },
            Op::Call1(f, x) => self.elementary(f, &a(x)),
            Op::Call2(f, x, y) => self.elementary2(f, &a(x), &a(y)),
            // Leaves are written where their values come from.
            _ => unreachable!("a leaf reads no values"),
        }
    }

    /// What a method is called on: a literal says its type.
    fn receiver(self, text: &str) -> String {
        match is_number(text) {
            true => format!("({text}_{})", self.number()),
            false => text.to_string(),
        }
    }

    /// Computed in f64 and rounded once.
    fn back(self, call: String) -> String {
        match (self.language, self.real) {
            (_, Precision::F64) => call,
            (Language::C, Precision::F32) => format!("(float){call}"),
            (Language::Rust, Precision::F32) => format!("{call} as f32"),
        }
    }

    fn elementary(self, f: Function1, x: &str) -> String {
        let x = self.widened(x);
        self.back(match (self.language, f) {
            (Language::C, _) => format!("{}({x})", f.name()),
            (Language::Rust, Function1::Erf) => format!("erf({x})"),
            (Language::Rust, Function1::Log) => format!("({x}).ln()"),
            (Language::Rust, _) => format!("({x}).{}()", f.name()),
        })
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
