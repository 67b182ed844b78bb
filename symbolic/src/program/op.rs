//! `Op`, an opcode with its operands, and the one table of all there is to know of an operation.
//!
//! What comes in: a row an operation. What goes out: what it reads and gives, where it may stand, its flops, how it is written
//! in a program's text, in C and in Rust, and what it computes in any [`Number`]. Checks, counts, keys, text, exports and
//! walks read the table; only how it becomes machine code stands elsewhere.
//! It must never know: the order in which instructions run.

use isophote_elementary::{Function1, Function2, Lookup};

use crate::program::arithmetic::{Cell, Comparison, Number, holds};
use crate::program::ids::{AccumulatorId, ChannelId, CoordinateId, InputId, TotalId, Value};

/// Where in the loop nest an instruction stands. The order is the order of execution.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Level {
    /// Once a call, f64.
    Pass,
    /// Once a row, f64.
    Row,
    /// Once a group of pixels, lanes.
    Pixel,
    /// Once a row that has pixels, f64.
    RowEnd,
    /// Once a call, f64.
    PassEnd,
}

/// A number of a program: the same where its bits are, so that −0 is not 0 and a NaN is itself.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Literal(u64);

impl Literal {
    /// Of a number.
    pub fn new(number: f64) -> Literal {
        Literal(number.to_bits())
    }
    /// The number.
    pub fn get(self) -> f64 {
        f64::from_bits(self.0)
    }
}

impl std::fmt::Debug for Literal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.get().fmt(f)
    }
}

/// What an opcode may hold, for those who try them all; of ids one that every program may have.
trait Every: Sized + 'static {
    const EVERY: &'static [Self];
}
macro_rules! held {
    ($($held:ty: $every:expr;)*) => { $(impl Every for $held { const EVERY: &'static [Self] = &$every; })* };
}
held! {
    Literal: [Literal(0.5_f64.to_bits())];
    InputId: [InputId(0)];
    CoordinateId: [CoordinateId(1)];
    ChannelId: [ChannelId(0)];
    AccumulatorId: [AccumulatorId(0)];
    TotalId: [TotalId(0)];
    Comparison: [Comparison::Lt, Comparison::Le, Comparison::Eq, Comparison::Ne];
    Function1: Function1::EVERY;
    Function2: Function2::ALL;
    Lookup: [Lookup { table: 0, coefficient: 1 }, Lookup { table: 1, coefficient: 9 }];
}

/// What an operand or a result is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// A number.
    Number,
    /// A truth value.
    Truth,
    /// Either, the same wherever it stands in a row.
    Either,
    /// A number that the row knows.
    OfRow,
}

/// A row of the table. In the texts `$0`, `$1`, `$2` are operands and `$_` what the opcode itself holds; in C and Rust `$s` is
/// the first operand as something that can be called upon, and `$f` is `f` for single precision. An empty text is one that
/// depends on the place: of a leaf on the loops around it, of an elementary function on the language's library.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Row {
    /// What it reads, in order.
    pub operands: &'static [Kind],
    /// What it gives.
    pub result: Kind,
    /// The only level that has it; `None`: any.
    pub level: Option<Level>,
    /// By the project's convention: + − × ÷ √ count 1, FMA 2; negation, comparisons and calls 0.
    pub flops: u32,
    /// In the text of a program.
    pub text: &'static str,
    /// In C.
    pub c: &'static str,
    /// In Rust.
    pub rust: &'static str,
}

/// Reads an operand as its kind has it.
macro_rules! read {
    (Number, $cell:expr) => {
        $cell.number()
    };
    (Truth, $cell:expr) => {
        $cell.truth()
    };
    (Either, $cell:expr) => {
        $cell
    };
    (OfRow, $cell:expr) => {
        ()
    };
}

/// Gives a result as its kind has it.
macro_rules! give {
    (Either, $result:expr) => {
        $result
    };
    ($kind:ident, $result:expr) => {
        Cell::$kind($result)
    };
}

/// The opcodes of a row.
macro_rules! every {
    ($name:ident) => {
        [Opcode::$name]
    };
    ($name:ident, $payload:ty) => {
        <$payload>::EVERY.iter().copied().map(Opcode::$name)
    };
}

macro_rules! operations {
    ($leaf:ident; $(
        $(#[$doc:meta])*
        $name:ident $(($held:ident: $payload:ty))? [$($operand:ident: $kind:ident),*] -> $result:ident, $level:expr, $flops:literal,
        $text:literal, $c:literal, $rust:literal, $value:expr;
    )*) => {
        /// What an operation does, with what it needs to know besides its operands.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum Opcode {
            $($(#[$doc])* $name $(($payload))?,)*
        }

        impl Opcode {
            /// What there is to know of it.
            pub fn row(self) -> &'static Row {
                match self {
                    $(Opcode::$name { .. } => &const {
                        Row {
                            operands: &[$(Kind::$kind),*],
                            result: Kind::$result,
                            level: $level,
                            flops: $flops,
                            text: $text,
                            c: $c,
                            rust: $rust,
                        }
                    },)*
                }
            }
        }

        fn opcodes() -> Vec<Opcode> {
            let mut all = Vec::new();
            $(all.extend(every!($name $(, $payload)?));)*
            all
        }

        /// The value of an operation; `leaf` gives that of one that reads no cell.
        #[allow(unused_variables, clippy::let_unit_value)]
        #[inline]
        pub(crate) fn apply<N: Number>(op: Op, cells: &[Cell<N>], leaf: &impl Fn(Op) -> N) -> Cell<N> {
            let $leaf = || leaf(op);
            match op.code {
                $(Opcode::$name $(($held))? => {
                    let [$($operand,)* ..] = op.operands;
                    $(let $operand = read!($kind, cells[$operand.index()]);)*
                    give!($result, $value)
                })*
            }
        }
    };
}

const ANY: Option<Level> = None;

operations! { leaf;
    /// A number.
    Const(x: Literal) [] -> Number, ANY, 0, "$_", "", "", x.get().into();
    /// One of [`crate::Program::inputs`].
    Input(i: InputId) [] -> Number, Some(Level::Pass), 0, "$_", "", "", leaf();
    /// A coordinate of an outer loop (never 0).
    Outer(c: CoordinateId) [] -> Number, Some(Level::Row), 0, "$_", "", "", leaf();
    /// The inner coordinate plus a pass or row value `c`. With `n = nearest(-c)` in f64 (ties to even, see
    /// [`crate::interpreter::nearest`]), `fraction = lane(c + n)` and `t = lane(x_first - n) + [0, 1, …]`, where `x_first` is
    /// the first pixel of the row's range, the value is `t + fraction`; after each group `t += LANES`. In a narrow window
    /// ([`crate::Summation`]) `t` is `lane(x_first - n) + (x - x_first)`. So rounding of `c` to f32 costs nothing.
    Offset [c: OfRow] -> Number, Some(Level::Pixel), 1, "$_ + $0", "", "", leaf();
    /// The pixel of a raw plane, converted to the lane type.
    Channel(c: ChannelId) [] -> Number, Some(Level::Pixel), 0, "pixel($_)", "", "", leaf();
    /// -a (flips the sign bit).
    Neg [a: Number] -> Number, ANY, 0, "-$0", "-$s", "-$s", -a;
    /// |a| (clears the sign bit).
    Abs [a: Number] -> Number, ANY, 0, "abs($0)", "fabs$f($0)", "$s.abs()", a.abs();
    /// √a.
    Sqrt [a: Number] -> Number, ANY, 1, "sqrt($0)", "sqrt$f($0)", "$s.sqrt()", a.sqrt();
    /// a + b.
    Add [a: Number, b: Number] -> Number, ANY, 1, "$0 + $1", "$0 + $1", "$0 + $1", a + b;
    /// a − b.
    Sub [a: Number, b: Number] -> Number, ANY, 1, "$0 - $1", "$0 - $1", "$0 - $1", a - b;
    /// a · b.
    Mul [a: Number, b: Number] -> Number, ANY, 1, "$0 * $1", "$0 * $1", "$0 * $1", a * b;
    /// a / b.
    Div [a: Number, b: Number] -> Number, ANY, 1, "$0 / $1", "$0 / $1", "$0 / $1", a / b;
    /// a · b + c, rounded once.
    Fma [a: Number, b: Number, c: Number] -> Number, ANY, 2,
        "fma($0, $1, $2)", "fma$f($0, $1, $2)", "$s.mul_add($1, $2)", a.fma(b, c);
    /// Whether two numbers compare so.
    Compare(c: Comparison) [a: Number, b: Number] -> Truth, ANY, 0, "$0 $_ $1", "$0 $_ $1", "$0 $_ $1", holds(c, a, b);
    /// Both.
    And [a: Truth, b: Truth] -> Truth, ANY, 0, "$0 and $1", "$0 && $1", "$0 && $1", a && b;
    /// At least one.
    Or [a: Truth, b: Truth] -> Truth, ANY, 0, "$0 or $1", "$0 || $1", "$0 || $1", a || b;
    /// Not a.
    Not [a: Truth] -> Truth, ANY, 0, "not $0", "!$0", "!$0", !a;
    /// `c ? a : b`.
    Select [c: Truth, a: Either, b: Either] -> Either, ANY, 0,
        "if($0, $1, $2)", "$0 ? $1 : $2", "if $0 { $1 } else { $2 }", if c { a } else { b };
    /// An elementary function.
    Call1(f: Function1) [a: Number] -> Number, ANY, 0, "$_($0)", "", "", a.call1(f);
    /// An elementary function of two arguments.
    Call2(f: Function2) [a: Number, b: Number] -> Number, ANY, 0, "$_($0, $1)", "", "", a.call2(f, b);
    /// A number of a table's cell, see [`isophote_elementary::Table`].
    Gather(l: Lookup) [a: Number, b: Number] -> Number, ANY, 0, "$_[$0, $1]", "", "", leaf();
    /// The row's total of an accumulator.
    RowTotal(a: AccumulatorId) [] -> Number, Some(Level::RowEnd), 0, "row sum $_", "", "", leaf();
    /// How many pixels the row contributed.
    RowCount [] -> Number, Some(Level::RowEnd), 0, "row pixels", "", "", leaf();
    /// The pass' total.
    PassTotal(t: TotalId) [] -> Number, Some(Level::PassEnd), 0, "total $_", "", "", leaf();
    /// How many pixels the pass used.
    PassCount [] -> Number, Some(Level::PassEnd), 0, "pixels", "", "", leaf();
}

/// One operation: an opcode and the earlier values that it reads.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Op {
    /// What it does.
    pub code: Opcode,
    operands: [Value; 3],
}

impl std::fmt::Debug for Op {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.code)?;
        f.debug_list().entries(self.operands().map(|v| v.0)).finish()
    }
}

impl Opcode {
    /// The operation on these values. One too few is a value that no program has, which [`crate::Program::check`] refuses.
    pub fn of<const N: usize>(self, operands: [Value; N]) -> Op {
        let given = |i: usize| operands.get(i).filter(|_| i < self.row().operands.len());
        Op { code: self, operands: std::array::from_fn(|i| given(i).copied().unwrap_or(Value(u32::MAX))) }
    }

    /// A number.
    pub fn number(x: f64) -> Opcode {
        Opcode::Const(Literal::new(x))
    }

    /// Every opcode, with everything that it may hold; of numbers and ids with one.
    pub fn every() -> Vec<Opcode> {
        opcodes()
    }
}

impl Op {
    /// The values that it reads, in order.
    pub fn operands(&self) -> impl Iterator<Item = Value> + use<> {
        self.operands.into_iter().take(self.code.row().operands.len())
    }

    /// The opcode with the values that it reads, to match.
    pub fn parts(&self) -> (Opcode, &[Value]) {
        (self.code, &self.operands[..self.code.row().operands.len()])
    }

    /// Flops by the project's convention, see [`Row::flops`].
    pub fn flops(&self) -> u32 {
        self.code.row().flops
    }

    /// Flops as the search counts them: a division or a root as four, an elementary function as twenty.
    pub(crate) fn weight(&self) -> u32 {
        match self.code {
            Opcode::Div | Opcode::Sqrt => 4,
            Opcode::Call1(Function1::Fraction) | Opcode::Gather(_) => 4,
            Opcode::Call1(_) | Opcode::Call2(_) => 20,
            code => code.row().flops,
        }
    }

    /// The number that it is.
    pub fn constant(&self) -> Option<f64> {
        match self.code {
            Opcode::Const(x) => Some(x.get()),
            _ => None,
        }
    }

    /// True when an elementary function is called.
    pub fn is_call(&self) -> bool {
        matches!(self.code, Opcode::Call1(_) | Opcode::Call2(_))
    }

    /// The same operation on other values.
    pub fn renamed(mut self, to: impl Fn(Value) -> Value) -> Op {
        let count = self.code.row().operands.len();
        self.operands[..count].iter_mut().for_each(|v| *v = to(*v));
        self
    }

    /// The level at which it stands, `level` being that of a value: the only one that has it, else the latest of its operands'.
    pub fn level(&self, level: impl Fn(Value) -> Level) -> Level {
        let latest = || self.operands().map(level).max().unwrap_or(Level::Pass);
        self.code.row().level.unwrap_or_else(latest)
    }
}

/// A text of the table with its marks replaced.
pub fn spelled(text: &str, mut mark: impl FnMut(char) -> String) -> String {
    let mut pieces = text.split('$');
    let mut out = pieces.next().unwrap_or_default().to_string();
    for piece in pieces {
        let mut rest = piece.chars();
        out.extend(rest.next().map(&mut mark));
        out += rest.as_str();
    }
    out
}
