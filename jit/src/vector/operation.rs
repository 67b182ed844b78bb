//! The vector operations.

/// The type of a lane.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Element {
    /// f32.
    Single,
    /// f64.
    Double,
}

impl Element {
    pub fn bytes(self) -> usize {
        match self {
            Element::Single => 4,
            Element::Double => 8,
        }
    }
}

/// Predicate bytes of comparison instructions.
pub(crate) mod comparison {
    /// =, false for NaN.
    pub const EQUAL: u8 = 0x00;
    /// ≠, true for NaN.
    pub const DIFFERENT: u8 = 0x04;
    /// <, false for NaN.
    pub const LESS: u8 = 0x11;
    /// ≤, false for NaN.
    pub const AT_MOST: u8 = 0x12;
}

/// Which 128-bit pieces of two vectors an instruction picks, and in which order: at 256 bits one of each, at 512 two.
pub(crate) mod pieces {
    /// At 256 bits: the first of each, the second of each.
    pub const OF_TWO: [u8; 2] = [0x20, 0x31];
    /// At 512 bits: the lower half of each, the upper half of each.
    pub const HALVES: [u8; 2] = [0x44, 0xEE];
    /// At 512 bits: the first and the third of each, the second and the fourth of each.
    pub const EVERY_OTHER: [u8; 2] = [0x88, 0xDD];
}

/// A vector operation. Truth values are lanes with all bits set or none.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Operation {
    Add,
    Sub,
    Mul,
    Div,
    And,
    /// The complement of the first, and the second.
    AndNot,
    Or,
    Xor,
    /// Adds integers as wide as the elements.
    AddBits,
    /// Subtracts 64-bit integers.
    SubBits,
    /// Compares 64-bit integers; a truth value.
    EqualBits,
    /// The unsigned minimum of 64-bit integers; at 256 bits of their halves, which does not exceed the second operand either.
    Least,
    /// A truth value, see [`comparison`].
    Compare(u8),
    Sqrt,
    /// a · b + c, rounded once.
    Fma,
    /// `truth ? a : b`.
    Select,
    /// Of 64-bit lanes.
    ShiftLeft(u8),
    /// Of lanes as wide as the elements.
    ShiftRight(u8),
    /// The lower half of f32, as f64.
    Widen,
    /// f64 as f32, in the lower half.
    Narrow,
    /// Copies the upper half to the lower one.
    UpperHalf,
    /// Joins a lower half, and another as the upper one.
    Join,
    /// The lesser; the second where neither is.
    Min,
    /// The greater; the second where neither is.
    Max,
    /// Of each 128 bits the lower two f32, from both in turn.
    Lows,
    /// Of each 128 bits the upper two f32, from both in turn.
    Highs,
    /// Of each 128 bits the first f64, from both.
    Firsts,
    /// Of each 128 bits the second f64, from both.
    Seconds,
    /// Pieces of 128 bits, see [`pieces`].
    Pieces(u8),
    /// 32-bit integers as numbers; of f64 those in the lower half.
    FromIntegers,
    /// Bytes in memory as 32-bit integers, as many as there are lanes.
    FromBytes,
    /// 16-bit words in memory as 32-bit integers, as many as there are lanes.
    FromWords,
    /// A vector of memory.
    Load,
    /// Half a vector of memory.
    LoadHalf,
    /// One element of memory in all lanes.
    Spread,
    /// The first element in all lanes.
    SpreadFirst,
}

/// The portion of a register that an instruction uses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Portion {
    Whole,
    Half,
    /// 128 bits.
    Least,
}
