//! Translates vector operations.

use cranelift_codegen::ir::condcodes::{FloatCC, IntCC};
use cranelift_codegen::ir::{self, InstBuilder, types};

use super::acts::{Vectors, bits, numbers};
use super::{PIXELS, Translator};
use crate::vector::{Anchor, Element, Id, MemoryPlace, Operation, comparison};

/// The condition of a predicate byte.
fn condition(predicate: u8) -> FloatCC {
    match predicate {
        comparison::EQUAL => FloatCC::Equal,
        comparison::DIFFERENT => FloatCC::NotEqual,
        comparison::LESS => FloatCC::LessThan,
        _ => FloatCC::LessThanOrEqual,
    }
}

impl Translator<'_> {
    /// The result of an operation.
    pub fn computed(
        &mut self,
        vectors: &Vectors<'_>,
        operation: Operation,
        element: Element,
        operands: &[Id],
    ) -> ir::Value {
        use Operation::*;
        let (number, integer) = (numbers(element), bits(element));
        match (operation, operands) {
            (Add | Mul | And | Or | Xor, _) => {
                let operands = self.factors(vectors, operands, number);
                let (a, b) = (operands[0], operands[1]);
                match operation {
                    Add => self.b.ins().fadd(a, b),
                    Mul => self.b.ins().fmul(a, b),
                    And => self.b.ins().band(a, b),
                    Or => self.b.ins().bor(a, b),
                    _ => self.b.ins().bxor(a, b),
                }
            }
            (Sub | Div | Compare(_) | Min | Max, &[a, b]) => {
                let [a, b] = [a, b].map(|id| self.vector(vectors, id, number));
                match operation {
                    Sub => self.b.ins().fsub(a, b),
                    Div => self.b.ins().fdiv(a, b),
                    Compare(predicate) => {
                        let truth = self.b.ins().fcmp(condition(predicate), a, b);
                        self.cast(number, truth)
                    }
                    Min => self.lesser(a, b, [a, b]),
                    _ => self.lesser(b, a, [a, b]),
                }
            }
            (AddBits | SubBits | EqualBits | AndNot, &[a, b]) => {
                let [a, b] = [a, b].map(|id| self.vector(vectors, id, integer));
                match operation {
                    AddBits => self.b.ins().iadd(a, b),
                    SubBits => self.b.ins().isub(a, b),
                    EqualBits => self.b.ins().icmp(IntCC::Equal, a, b),
                    _ => self.b.ins().band_not(b, a),
                }
            }
            (Fma, &[a, b, c]) => {
                let [a, b, c] = [a, b, c].map(|id| self.vector(vectors, id, number));
                self.b.ins().fma(a, b, c)
            }
            (Select, &[truth, a, b]) => {
                // In the type of the truth values, the compiler sees the comparison, and blends.
                let kind = vectors.kind(&self.b, truth).unwrap_or(number);
                let [truth, a, b] = [truth, a, b].map(|id| self.vector(vectors, id, kind));
                self.b.ins().bitselect(truth, a, b)
            }
            (Sqrt, &[a]) => {
                let a = self.vector(vectors, a, number);
                self.b.ins().sqrt(a)
            }
            (ShiftLeft(by), &[a]) => {
                let a = self.vector(vectors, a, types::I64X2);
                let by = self.b.ins().iconst(types::I32, i64::from(by));
                self.b.ins().ishl(a, by)
            }
            (ShiftRight(by), &[a]) => {
                let a = self.vector(vectors, a, integer);
                let by = self.b.ins().iconst(types::I32, i64::from(by));
                self.b.ins().ushr(a, by)
            }
            (Widen, &[a]) => {
                let a = self.lower_half(vectors, a, types::F32X4);
                self.b.ins().fvpromote_low(a)
            }
            (Narrow, &[a]) => {
                let a = self.vector(vectors, a, types::F64X2);
                self.b.ins().fvdemote(a)
            }
            (Join | Firsts, &[a, b]) => {
                let [a, b] = [a, b].map(|id| self.vector(vectors, id, types::F64X2));
                let second = self.b.ins().extractlane(b, 0);
                self.b.ins().insertlane(a, second, 1)
            }
            (UpperHalf, &[a]) => self.seconds(vectors, [a, a]),
            (Seconds, &[a, b]) => self.seconds(vectors, [a, b]),
            (FromIntegers, &[a]) if element == Element::Single => {
                let integers = self.vector(vectors, a, types::I32X4);
                self.b.ins().fcvt_from_sint(types::F32X4, integers)
            }
            (FromIntegers, &[a]) => {
                let integers = self.lower_half(vectors, a, types::I32X4);
                let integers = self.b.ins().swiden_low(integers);
                self.b.ins().fcvt_from_sint(types::F64X2, integers)
            }
            (FromBytes | FromWords | Load, &[a]) if self.has_copied(vectors.memory(a)) => {
                let kind = if operation == Load { number } else { types::I32X4 };
                self.loaded(vectors.memory(a), kind)
            }
            (FromBytes, &[a]) => {
                let (at, offset) = self.address(vectors.memory(a));
                let bytes = match element {
                    Element::Single => self.b.ins().load(types::I32, PIXELS, at, offset),
                    Element::Double => self.b.ins().uload16(types::I32, PIXELS, at, offset),
                };
                let bytes = self.b.ins().scalar_to_vector(types::I32X4, bytes);
                let bytes = self.cast(types::I8X16, bytes);
                let words = self.b.ins().uwiden_low(bytes);
                self.b.ins().uwiden_low(words)
            }
            (FromWords, &[a]) => {
                let (at, offset) = self.address(vectors.memory(a));
                if element == Element::Single {
                    return self.b.ins().uload16x4(PIXELS, at, offset);
                }
                let words = self.b.ins().load(types::I32, PIXELS, at, offset);
                let words = self.b.ins().scalar_to_vector(types::I32X4, words);
                let words = self.cast(types::I16X8, words);
                self.b.ins().uwiden_low(words)
            }
            (Load, &[a]) => self.load(number, vectors.memory(a)),
            (LoadHalf, &[a]) => self.half(vectors.memory(a), number),
            (Spread, &[a]) => {
                let lane = self.load(number.lane_type(), vectors.memory(a));
                self.b.ins().splat(number, lane)
            }
            (SpreadFirst, &[a]) => {
                let a = self.vector(vectors, a, number);
                let lane = self.b.ins().extractlane(a, 0);
                self.b.ins().splat(number, lane)
            }
            _ => unreachable!("{operation:?} is for wider vectors"),
        }
    }

    /// The lower half of a vector; of one in memory, nothing else is read.
    fn lower_half(&mut self, vectors: &Vectors<'_>, id: Id, kind: ir::Type) -> ir::Value {
        let is_half = |place: MemoryPlace| !place.is_spread && place.base != Anchor::Pool;
        match vectors.is_in_memory(id) && is_half(vectors.memory(id)) {
            true => self.half(vectors.memory(id), kind),
            false => self.vector(vectors, id, kind),
        }
    }

    /// `less < more ? a : b`.
    fn lesser(&mut self, less: ir::Value, more: ir::Value, [a, b]: [ir::Value; 2]) -> ir::Value {
        let is_less = self.b.ins().fcmp(FloatCC::LessThan, less, more);
        let kind = self.b.func.dfg.value_type(a);
        let is_less = self.cast(kind, is_less);
        self.b.ins().bitselect(is_less, a, b)
    }

    /// The second f64 of both.
    fn seconds(&mut self, vectors: &Vectors<'_>, [a, b]: [Id; 2]) -> ir::Value {
        let low = self.vector(vectors, a, types::I8X16);
        let high = if a == b { low } else { self.vector(vectors, b, types::I8X16) };
        let bytes: Vec<u8> = (8..16).chain(24..32).collect();
        let mask = self.b.func.dfg.immediates.push(bytes.into());
        self.b.ins().shuffle(low, high, mask)
    }
}
