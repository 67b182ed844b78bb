//! `Plain`: the machine that evaluates a function, one f64 at a time. What it computes is what the function means.

use super::large;
use super::machine::Machine;
use crate::function::Function1;

/// One f64 at a time: the meaning.
#[derive(Clone, Copy, Debug)]
pub struct Plain {
    /// Whether a · b + c is rounded once.
    pub fused: bool,
}

impl Machine for Plain {
    type Number = f64;
    type Truth = bool;
    type Bits = u64;

    #[inline(always)]
    fn is_fused(&self) -> bool {
        self.fused
    }
    #[inline(always)]
    fn constant(&self, x: f64) -> f64 {
        x
    }
    #[inline(always)]
    fn add(&self, a: f64, b: f64) -> f64 {
        a + b
    }
    #[inline(always)]
    fn sub(&self, a: f64, b: f64) -> f64 {
        a - b
    }
    #[inline(always)]
    fn mul(&self, a: f64, b: f64) -> f64 {
        a * b
    }
    #[inline(always)]
    fn div(&self, a: f64, b: f64) -> f64 {
        a / b
    }
    #[inline(always)]
    fn sqrt(&self, a: f64) -> f64 {
        a.sqrt()
    }
    #[inline(always)]
    fn abs(&self, a: f64) -> f64 {
        a.abs()
    }
    #[inline(always)]
    fn neg(&self, a: f64) -> f64 {
        -a
    }
    #[inline(always)]
    fn mul_add(&self, a: f64, b: f64, c: f64) -> f64 {
        if self.fused { a.mul_add(b, c) } else { a * b + c }
    }
    #[inline(always)]
    fn less(&self, a: f64, b: f64) -> bool {
        a < b
    }
    #[inline(always)]
    fn equal(&self, a: f64, b: f64) -> bool {
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
    fn select(&self, truth: bool, a: f64, b: f64) -> f64 {
        if truth { a } else { b }
    }
    #[inline(always)]
    fn bits(&self, a: f64) -> u64 {
        a.to_bits()
    }
    #[inline(always)]
    fn number(&self, a: u64) -> f64 {
        f64::from_bits(a)
    }
    #[inline(always)]
    fn pattern(&self, bits: u64) -> u64 {
        bits
    }
    #[inline(always)]
    fn bits_add(&self, a: u64, b: u64) -> u64 {
        a.wrapping_add(b)
    }
    #[inline(always)]
    fn bits_and(&self, a: u64, b: u64) -> u64 {
        a & b
    }
    #[inline(always)]
    fn bits_or(&self, a: u64, b: u64) -> u64 {
        a | b
    }
    #[inline(always)]
    fn bits_xor(&self, a: u64, b: u64) -> u64 {
        a ^ b
    }
    #[inline(always)]
    fn shift_left(&self, a: u64, by: u8) -> u64 {
        a << by
    }
    #[inline(always)]
    fn shift_right(&self, a: u64, by: u8) -> u64 {
        a >> by
    }
    #[inline(always)]
    fn bits_equal(&self, a: u64, b: u64) -> bool {
        a == b
    }
    #[inline(always)]
    fn elsewhere(&self, truth: bool, usual: f64, function: Function1, x: f64) -> f64 {
        if truth { large::value(function, x) } else { usual }
    }
}
