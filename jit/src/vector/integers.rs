//! Operations on integer variables of 64 bits: addresses, counters, bounds, branches.

use super::place::MemoryPlace;

/// A variable of 64 bits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Integer {
    /// The address of the argument block.
    Args,
    /// The pixel at which a group starts or would start, from the window's first column.
    Pixel,
    /// The start of a partial group.
    Begin,
    /// The latest start of a group.
    Furthest,
    /// The index of the current row among the prepared rows; in a loop over columns the byte offset of the current column,
    /// divided by eight.
    Row,
    /// The first row of the current block, relative to the first prepared row, while rows are prepared, looped over column by
    /// column, or finished.
    Block,
    /// The offset of the current row's sums, in units of 8 bytes.
    Sum,
    /// The address of the current row in a plane.
    Address(u8),
    /// Scratch variables, which calls change.
    A,
    B,
    C,
    D,
    E,
}

/// A position in the code.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Label(pub usize);

/// An operand.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Operand {
    Variable(Integer),
    Memory(MemoryPlace),
    Number(i32),
}

impl From<Integer> for Operand {
    fn from(variable: Integer) -> Operand {
        Operand::Variable(variable)
    }
}
impl From<MemoryPlace> for Operand {
    fn from(place: MemoryPlace) -> Operand {
        Operand::Memory(place)
    }
}
impl From<i32> for Operand {
    fn from(number: i32) -> Operand {
        Operand::Number(number)
    }
}

/// The condition of a branch, on two numbers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Condition {
    Equal,
    Different,
    /// Signed.
    Less,
    AtMost,
    AtLeast,
    More,
    /// Unsigned.
    Below,
    NotBelow,
    Above,
    NotAbove,
}

/// An operation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Step {
    /// to = from
    Set(Integer, Operand),
    /// to += from
    Add(Integer, Operand),
    /// to −= from
    Subtract(Integer, Operand),
    /// to ·= from
    Multiply(Integer, MemoryPlace),
    /// to = from · number
    Scale(Integer, Integer, i32),
    /// to = min(to, from), unsigned.
    AtMost(Integer, Integer),
    /// to = the number of its bits that are set; it is below 2³².
    CountOnes(Integer),
    /// Loads 32 bits, zero-extended.
    LoadLow(Integer, MemoryPlace),
    /// Writes 64 bits.
    Store(MemoryPlace, Integer),
    /// Writes the low 32 bits.
    StoreLow(MemoryPlace, Integer),
    /// Adds to 64 bits of memory.
    AddAt(MemoryPlace, Integer),
    /// Copies 1, 2, 4 or 8 bytes by way of a variable, which changes.
    Copy {
        to: MemoryPlace,
        from: MemoryPlace,
        by: Integer,
        bytes: usize,
    },
    /// Prefetches a place, valid or not.
    Prefetch(MemoryPlace),
    /// Branches on a comparison of 64 bits.
    Branch(Integer, Condition, Operand, Label),
    /// Branches on a comparison of the low 32 bits with memory.
    BranchLow(Integer, Condition, MemoryPlace, Label),
    Jump(Label),
    /// Defines a label.
    Label(Label),
}

/// A list of operations.
#[derive(Clone, Default, PartialEq, Debug)]
pub(crate) struct Integers(pub Vec<Step>);

/// Appends an operation.
macro_rules! steps {
    ($($name:ident($($operand:ident: $kind:ty),*) = $step:ident;)*) => {
        $(pub fn $name(&mut self, $($operand: impl Into<$kind>),*) {
            self.0.push(Step::$step($($operand.into()),*));
        })*
    };
}

impl Integers {
    steps! {
        mov(to: Integer, from: Operand) = Set;
        plus(to: Integer, from: Operand) = Add;
        minus(to: Integer, from: Operand) = Subtract;
        times(to: Integer, from: MemoryPlace) = Multiply;
        scaled(to: Integer, from: Integer, number: i32) = Scale;
        at_most(to: Integer, from: Integer) = AtMost;
        count_ones(of: Integer) = CountOnes;
        mov_low(to: Integer, from: MemoryPlace) = LoadLow;
        store(to: MemoryPlace, from: Integer) = Store;
        store_low(to: MemoryPlace, from: Integer) = StoreLow;
        plus_at(to: MemoryPlace, from: Integer) = AddAt;
        fetch(place: MemoryPlace) = Prefetch;
        jump_if(left: Integer, condition: Condition, right: Operand, to: Label) = Branch;
        jump_if_low(left: Integer, condition: Condition, right: MemoryPlace, to: Label) = BranchLow;
        jump(to: Label) = Jump;
        label(label: Label) = Label;
    }

    pub fn copy(&mut self, to: MemoryPlace, from: MemoryPlace, by: Integer, bytes: usize) {
        self.0.push(Step::Copy { to, from, by, bytes });
    }
}
