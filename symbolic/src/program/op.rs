//! `Op`, an opcode with its operands, and the table of operations.
//!
//! A row has an operation's operands and result, its level and flops, its syntax in program text, and its value in any
//! [`Number`]. Checks, counts, keys, text and walks read the table; the lowering to machine code and the spellings in C
//! and Rust are in the crates that need them.

use isophote_elementary::{Function1, Function2, Lookup};

use crate::program::arithmetic::{Cell, Comparison, Number, holds};
use crate::program::ids::{AccumulatorId, ChannelId, CoordinateId, InputId, TotalId, Value};

/// Level of an instruction in the loop nest, in execution order.
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

/// A number of a program, compared by its bits: −0 is not 0 and a NaN equals itself.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Literal(u64);

impl Literal {
    /// Wraps a number.
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

/// All payloads of an opcode, for exhaustive tests; of ids one that every program has.
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

/// Kind of an operand or result.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// A number.
    Number,
    /// A truth value.
    Truth,
    /// Either, the same throughout a row.
    Either,
    /// A number of pass or row level.
    OfRow,
}

/// A row of the table. In the text `$0`, `$1`, `$2` are operands and `$_` the opcode's payload.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Row {
    /// Operand kinds, in order.
    pub operands: &'static [Kind],
    /// Result kind.
    pub result: Kind,
    /// The only level allowed; `None`: any.
    pub level: Option<Level>,
    /// By the project's convention: + − × ÷ √ count 1, FMA 2; negation, comparisons and calls 0.
    pub flops: u32,
    /// Syntax in program text.
    pub text: &'static str,
}

/// Reads an operand by its kind.
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

/// Wraps a result by its kind.
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
        $text:literal, $value:expr;
    )*) => {
        /// An operation with its payload, without operands.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum Opcode {
            $($(#[$doc])* $name $(($payload))?,)*
        }

        impl Opcode {
            /// Its row of the table.
            pub fn row(self) -> &'static Row {
                match self {
                    $(Opcode::$name { .. } => &const {
                        Row {
                            operands: &[$(Kind::$kind),*],
                            result: Kind::$result,
                            level: $level,
                            flops: $flops,
                            text: $text,
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

        /// Evaluates an operation; `leaf` evaluates one that reads no cell.
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
    Const(x: Literal) [] -> Number, ANY, 0, "$_", x.get().into();
    /// One of [`crate::LoopNest::inputs`].
    Input(i: InputId) [] -> Number, Some(Level::Pass), 0, "$_", leaf();
    /// A coordinate of an outer loop (never 0).
    Outer(c: CoordinateId) [] -> Number, Some(Level::Row), 0, "$_", leaf();
    /// The inner coordinate plus a pass or row value `c`. With `n = nearest(-c)` in f64 (ties to even, see
    /// [`crate::interpreter::nearest`]), `fraction = lane(c + n)` and `t = lane(x_first - n) + [0, 1, …]`, where `x_first` is
    /// the first pixel of the row's range, the value is `t + fraction`; after each group `t += LANES`. In a narrow window
    /// ([`crate::Summation`]) `t` is `lane(x_first - n) + (x - x_first)`. So rounding of `c` to f32 costs nothing.
    Offset [c: OfRow] -> Number, Some(Level::Pixel), 1, "$_ + $0", leaf();
    /// The pixel of a raw plane, converted to the lane type.
    Channel(c: ChannelId) [] -> Number, Some(Level::Pixel), 0, "pixel($_)", leaf();
    /// -a (flips the sign bit).
    Neg [a: Number] -> Number, ANY, 0, "-$0", -a;
    /// |a| (clears the sign bit).
    Abs [a: Number] -> Number, ANY, 0, "abs($0)", a.abs();
    /// √a.
    Sqrt [a: Number] -> Number, ANY, 1, "sqrt($0)", a.sqrt();
    /// a + b.
    Add [a: Number, b: Number] -> Number, ANY, 1, "$0 + $1", a + b;
    /// a − b.
    Sub [a: Number, b: Number] -> Number, ANY, 1, "$0 - $1", a - b;
    /// a · b.
    Mul [a: Number, b: Number] -> Number, ANY, 1, "$0 * $1", a * b;
    /// a / b.
    Div [a: Number, b: Number] -> Number, ANY, 1, "$0 / $1", a / b;
    /// a · b + c, rounded once.
    Fma [a: Number, b: Number, c: Number] -> Number, ANY, 2, "fma($0, $1, $2)", a.fma(b, c);
    /// Compares two numbers.
    Compare(c: Comparison) [a: Number, b: Number] -> Truth, ANY, 0, "$0 $_ $1", holds(c, a, b);
    /// Both hold.
    And [a: Truth, b: Truth] -> Truth, ANY, 0, "$0 and $1", a && b;
    /// At least one holds.
    Or [a: Truth, b: Truth] -> Truth, ANY, 0, "$0 or $1", a || b;
    /// Not a.
    Not [a: Truth] -> Truth, ANY, 0, "not $0", !a;
    /// `c ? a : b`.
    Select [c: Truth, a: Either, b: Either] -> Either, ANY, 0, "if($0, $1, $2)", if c { a } else { b };
    /// An elementary function.
    Call1(f: Function1) [a: Number] -> Number, ANY, 0, "$_($0)", a.call1(f);
    /// An elementary function of two arguments.
    Call2(f: Function2) [a: Number, b: Number] -> Number, ANY, 0, "$_($0, $1)", a.call2(f, b);
    /// A coefficient of a table's cell, see [`isophote_elementary::Table`].
    Gather(l: Lookup) [a: Number, b: Number] -> Number, ANY, 0, "$_[$0, $1]", leaf();
    /// The row's total of an accumulator.
    RowTotal(a: AccumulatorId) [] -> Number, Some(Level::RowEnd), 0, "row sum $_", leaf();
    /// Number of pixels used in the row.
    RowCount [] -> Number, Some(Level::RowEnd), 0, "row pixels", leaf();
    /// The pass' total.
    PassTotal(t: TotalId) [] -> Number, Some(Level::PassEnd), 0, "total $_", leaf();
    /// Number of pixels used in the pass.
    PassCount [] -> Number, Some(Level::PassEnd), 0, "pixels", leaf();
}

/// One operation: an opcode and the earlier values that it reads.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Op {
    /// Its opcode.
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
    /// The operation on these values. A missing one becomes an invalid value, which [`crate::LoopNest::check`] rejects.
    pub fn of<const N: usize>(self, operands: [Value; N]) -> Op {
        let given = |i: usize| operands.get(i).filter(|_| i < self.row().operands.len());
        Op { code: self, operands: std::array::from_fn(|i| given(i).copied().unwrap_or(Value(u32::MAX))) }
    }

    /// A number.
    pub fn number(x: f64) -> Opcode {
        Opcode::Const(Literal::new(x))
    }

    /// Every opcode with each of its payloads; of numbers and ids one.
    pub fn every() -> Vec<Opcode> {
        opcodes()
    }
}

impl Op {
    /// The values that it reads, in order.
    pub fn operands(&self) -> impl Iterator<Item = Value> + use<> {
        self.operands.into_iter().take(self.code.row().operands.len())
    }

    /// Opcode and operands, to match.
    pub fn parts(&self) -> (Opcode, &[Value]) {
        (self.code, &self.operands[..self.code.row().operands.len()])
    }

    /// Flops by the project's convention, see [`Row::flops`].
    pub fn flops(&self) -> u32 {
        self.code.row().flops
    }

    /// Flops as the search counts them: division, root, fraction and gather 4, other elementary functions 20.
    pub(crate) fn weight(&self) -> u32 {
        match self.code {
            Opcode::Div | Opcode::Sqrt => 4,
            Opcode::Call1(Function1::Fraction) | Opcode::Gather(_) => 4,
            Opcode::Call1(_) | Opcode::Call2(_) => 20,
            code => code.row().flops,
        }
    }

    /// Its number, if it is a constant.
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

    /// Its level: the only one allowed, else the latest of its operands' by `level`.
    pub fn level(&self, level: impl Fn(Value) -> Level) -> Level {
        let latest = || self.operands().map(level).max().unwrap_or(Level::Pass);
        self.code.row().level.unwrap_or_else(latest)
    }
}

/// Expands the `$` marks of a table's text.
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
