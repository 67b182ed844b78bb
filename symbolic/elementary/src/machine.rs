//! `Machine`: the arithmetic over which an elementary function is written.
//!
//! A function is straight-line code over a machine, so that evaluation and vector instructions do the same operations
//! in the same order. Nothing branches: `select` picks per lane.

use crate::function::Function1;

/// Required accuracy of a value.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Accuracy {
    /// About 30 bits: the argument is an f32, and the result will be rounded to one.
    Single,
    /// An f64.
    Double,
}

/// Operations on numbers, truth values and bit patterns, one lane or several at once: f64, but f32 for functions that
/// [say so](Function1::is_single), whose patterns have 32 bits.
pub trait Machine {
    /// A number, or one in each lane.
    type Number: Copy;
    /// A truth value, or one in each lane.
    type Truth: Copy;
    /// The bits of a number, or of one in each lane.
    type Bits: Copy;

    /// True when [`Machine::mul_add`] rounds once.
    fn is_fused(&self) -> bool;
    /// A constant number.
    fn constant(&self, x: f64) -> Self::Number;
    /// a + b
    fn add(&self, a: Self::Number, b: Self::Number) -> Self::Number;
    /// a − b
    fn sub(&self, a: Self::Number, b: Self::Number) -> Self::Number;
    /// a · b
    fn mul(&self, a: Self::Number, b: Self::Number) -> Self::Number;
    /// a / b
    fn div(&self, a: Self::Number, b: Self::Number) -> Self::Number;
    /// √a
    fn sqrt(&self, a: Self::Number) -> Self::Number;
    /// |a|: clears the sign bit.
    fn abs(&self, a: Self::Number) -> Self::Number;
    /// −a: flips the sign bit.
    fn neg(&self, a: Self::Number) -> Self::Number;
    /// a · b + c, rounded once by a fused machine, else twice.
    fn mul_add(&self, a: Self::Number, b: Self::Number, c: Self::Number) -> Self::Number;

    /// a < b; false for NaN.
    fn less(&self, a: Self::Number, b: Self::Number) -> Self::Truth;
    /// a = b; false for NaN.
    fn equal(&self, a: Self::Number, b: Self::Number) -> Self::Truth;
    /// a and b.
    fn and(&self, a: Self::Truth, b: Self::Truth) -> Self::Truth;
    /// a or b.
    fn or(&self, a: Self::Truth, b: Self::Truth) -> Self::Truth;
    /// Not a.
    fn not(&self, a: Self::Truth) -> Self::Truth;
    /// `truth ? a : b`
    fn select(&self, truth: Self::Truth, a: Self::Number, b: Self::Number) -> Self::Number;

    /// The bits of a number.
    fn bits(&self, a: Self::Number) -> Self::Bits;
    /// The number of these bits.
    fn number(&self, a: Self::Bits) -> Self::Number;
    /// Constant bits.
    fn pattern(&self, bits: u64) -> Self::Bits;
    /// a + b, wrapping.
    fn bits_add(&self, a: Self::Bits, b: Self::Bits) -> Self::Bits;
    /// Bitwise and.
    fn bits_and(&self, a: Self::Bits, b: Self::Bits) -> Self::Bits;
    /// Bitwise or.
    fn bits_or(&self, a: Self::Bits, b: Self::Bits) -> Self::Bits;
    /// Bitwise exclusive or.
    fn bits_xor(&self, a: Self::Bits, b: Self::Bits) -> Self::Bits;
    /// a · 2^by, dropping overflowing bits.
    fn shift_left(&self, a: Self::Bits, by: u8) -> Self::Bits;
    /// a / 2^by, rounded down.
    fn shift_right(&self, a: Self::Bits, by: u8) -> Self::Bits;
    /// a = b
    fn bits_equal(&self, a: Self::Bits, b: Self::Bits) -> Self::Truth;

    /// `truth ? function.value(x) : usual`, for rare arguments of sin, cos and tan: vector code computes this out of
    /// line, only if a lane needs it.
    fn elsewhere(&self, truth: Self::Truth, usual: Self::Number, function: Function1, x: Self::Number) -> Self::Number;
}
