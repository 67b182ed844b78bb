//! `Plain` and `PlainSingle`: the machines that evaluate a function, one number at a time, and define its value.

use super::large;
use super::machine::Machine;
use crate::function::Function1;

/// Evaluates one f64 at a time.
#[derive(Clone, Copy, Debug)]
pub struct Plain {
    /// True when a · b + c is rounded once.
    pub fused: bool,
}

/// Evaluates one f32 at a time, for functions whose lanes of f32 are not widened.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlainSingle {
    /// True when a · b + c is rounded once.
    pub fused: bool,
}

/// Every operation of a machine, in a type's own arithmetic.
macro_rules! machine {
    ($machine:ident, $number:ident, $bits:ident) => {
        impl Machine for $machine {
            type Number = $number;
            type Truth = bool;
            type Bits = $bits;

            #[inline(always)]
            fn is_fused(&self) -> bool {
                self.fused
            }
            #[inline(always)]
            fn constant(&self, x: f64) -> $number {
                x as $number
            }
            #[inline(always)]
            fn add(&self, a: $number, b: $number) -> $number {
                a + b
            }
            #[inline(always)]
            fn sub(&self, a: $number, b: $number) -> $number {
                a - b
            }
            #[inline(always)]
            fn mul(&self, a: $number, b: $number) -> $number {
                a * b
            }
            #[inline(always)]
            fn div(&self, a: $number, b: $number) -> $number {
                a / b
            }
            #[inline(always)]
            fn sqrt(&self, a: $number) -> $number {
                a.sqrt()
            }
            #[inline(always)]
            fn abs(&self, a: $number) -> $number {
                a.abs()
            }
            #[inline(always)]
            fn neg(&self, a: $number) -> $number {
                -a
            }
            #[inline(always)]
            fn mul_add(&self, a: $number, b: $number, c: $number) -> $number {
                if self.fused { a.mul_add(b, c) } else { a * b + c }
            }
            #[inline(always)]
            fn less(&self, a: $number, b: $number) -> bool {
                a < b
            }
            #[inline(always)]
            fn equal(&self, a: $number, b: $number) -> bool {
                a == b
            }
            #[inline(always)]
            fn and(&self, a: bool, b: bool) -> bool {
                a & b
            }
            #[inline(always)]
            fn or(&self, a: bool, b: bool) -> bool {
                a | b
            }
            #[inline(always)]
            fn not(&self, a: bool) -> bool {
                !a
            }
            #[inline(always)]
            fn select(&self, truth: bool, a: $number, b: $number) -> $number {
                if truth { a } else { b }
            }
            #[inline(always)]
            fn bits(&self, a: $number) -> $bits {
                a.to_bits()
            }
            #[inline(always)]
            fn number(&self, a: $bits) -> $number {
                $number::from_bits(a)
            }
            #[inline(always)]
            fn pattern(&self, bits: u64) -> $bits {
                bits as $bits
            }
            #[inline(always)]
            fn bits_add(&self, a: $bits, b: $bits) -> $bits {
                a.wrapping_add(b)
            }
            #[inline(always)]
            fn bits_and(&self, a: $bits, b: $bits) -> $bits {
                a & b
            }
            #[inline(always)]
            fn bits_or(&self, a: $bits, b: $bits) -> $bits {
                a | b
            }
            #[inline(always)]
            fn bits_xor(&self, a: $bits, b: $bits) -> $bits {
                a ^ b
            }
            #[inline(always)]
            fn shift_left(&self, a: $bits, by: u8) -> $bits {
                a << by
            }
            #[inline(always)]
            fn shift_right(&self, a: $bits, by: u8) -> $bits {
                a >> by
            }
            #[inline(always)]
            fn bits_equal(&self, a: $bits, b: $bits) -> bool {
                a == b
            }
            #[inline(always)]
            fn elsewhere(&self, truth: bool, usual: $number, function: Function1, x: $number) -> $number {
                if truth { large::value(function, x.into()) as $number } else { usual }
            }
        }
    };
}
machine!(Plain, f64, u64);
machine!(PlainSingle, f32, u32);
