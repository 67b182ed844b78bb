//! Elementary functions: inlined as vector code, or called where that would be too much code.
//!
//! The algorithms are those of [`isophote_elementary`], generic over a [`Machine`]; this machine maps each step to an
//! operation on whole vectors of f64. Lanes of f32 are widened in two halves and rounded once, except for functions with an
//! f32 form of their own.

use std::cell::RefCell;

use isophote_elementary::{Accuracy, Counter, Function1, Machine, Plain, call1, call2};
use isophote_symbolic::{Level, Opcode, Precision, Program, Value};

use crate::abi::Functions;
use crate::options::VectorWidth;
use crate::vector::{Act, Block, Element, Id, Operation, comparison};

/// Maximum operations of all inlined elementary functions of a level.
const INLINED_MAX: usize = 3000;

/// How the functions of a level are evaluated.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Evaluation {
    pub precision: Precision,
    /// Uses fused multiply-add.
    pub is_fused: bool,
    /// Inlined as vector code; else called.
    pub is_inlined: bool,
}

impl Evaluation {
    /// For the pixel instructions of a program.
    pub fn new(program: &Program, pixels: &[Value], precision: Precision) -> Evaluation {
        let codes = pixels.iter().map(|v| program.instruction(*v).op.code);
        // A group of f32 takes two vectors of f64.
        let vectors = if precision == Precision::F32 { 2 } else { 1 };
        Evaluation { precision, is_fused: program.is_fused(), is_inlined: false }.inlined(codes, vectors)
    }

    /// For a level outside the pixel loop, where nothing is fused and the code is written `parts` times. At 128 bits, where
    /// compiling takes longer, they are called.
    pub fn outer(program: &Program, level: Level, parts: usize, width: VectorWidth) -> Evaluation {
        let of_level = program.instructions().iter().filter(|instruction| instruction.level == level);
        let codes = of_level.map(|instruction| instruction.op.code);
        let called = Evaluation { precision: Precision::F64, is_fused: false, is_inlined: false };
        if width == VectorWidth::Bits128 { called } else { called.inlined(codes, parts) }
    }

    /// Inlines the functions if the code stays within [`INLINED_MAX`].
    fn inlined(self, mut codes: impl Iterator<Item = Opcode>, vectors: usize) -> Evaluation {
        let (accuracy, counter) = (self.accuracy(), Counter::of(&Plain { fused: self.is_fused }));
        let is_inlined = codes.all(|code| {
            match code {
                Opcode::Call1(f) => call1(&counter, f, accuracy, ()),
                Opcode::Call2(f) => call2(&counter, f, accuracy, (), ()),
                _ => {}
            }
            counter.count() * vectors <= INLINED_MAX
        });
        Evaluation { is_inlined, ..self }
    }

    fn accuracy(self) -> Accuracy {
        match self.precision {
            Precision::F32 => Accuracy::Single,
            Precision::F64 => Accuracy::Double,
        }
    }
}

impl Block<'_> {
    /// Applies a function to each lane.
    pub(super) fn function(&mut self, evaluation: Evaluation, code: Opcode, operands: &[Id]) -> Option<Id> {
        let Evaluation { precision, is_fused: fused, is_inlined } = evaluation;
        if !is_inlined {
            let offset = match code {
                Opcode::Call1(f) => Functions::lanes1(precision, Plain { fused }, f),
                Opcode::Call2(f) => Functions::lanes2(precision, Plain { fused }, f),
                _ => return None,
            };
            let element = match precision {
                Precision::F32 => Element::Single,
                Precision::F64 => Element::Double,
            };
            return Some(self.call(element, offset, operands));
        }
        let accuracy = evaluation.accuracy();
        match (code, operands) {
            (Opcode::Call1(f), &[x]) if precision == Precision::F32 && f.is_single() => {
                Some(call1(&Lanes::of(self, Element::Single, fused), f, accuracy, x))
            }
            (Opcode::Call1(f), &[x]) => Some(self.wide(evaluation, [x], |lanes, [x]| call1(lanes, f, accuracy, x))),
            (Opcode::Call2(f), &[a, b]) => {
                Some(self.wide(evaluation, [a, b], |lanes, [a, b]| call2(lanes, f, accuracy, a, b)))
            }
            _ => None,
        }
    }

    fn call(&mut self, element: Element, offset: i32, operands: &[Id]) -> Id {
        let result = self.new_value();
        self.act(Act::Call { element, offset, operands: operands.iter().copied().collect(), result });
        result
    }

    /// Applies `f` to vectors of f64: to the lanes directly, or to both halves of f32.
    fn wide<const N: usize>(
        &mut self,
        evaluation: Evaluation,
        operands: [Id; N],
        f: impl Fn(&Lanes<'_, '_>, [Id; N]) -> Id,
    ) -> Id {
        let fused = evaluation.is_fused;
        let run = |block: &mut Self, operands| f(&Lanes::of(block, Element::Double, fused), operands);
        if evaluation.precision == Precision::F64 {
            return run(self, operands);
        }
        let low = operands.map(|x| self.compute(Operation::Widen, Element::Double, [x]));
        let low = run(self, low);
        let low = self.compute(Operation::Narrow, Element::Double, [low]);
        let high = operands.map(|x| {
            let upper = self.compute(Operation::UpperHalf, Element::Single, [x]);
            self.compute(Operation::Widen, Element::Double, [upper])
        });
        let high = run(self, high);
        let high = self.compute(Operation::Narrow, Element::Double, [high]);
        self.compute(Operation::Join, Element::Single, [low, high])
    }
}

/// A [`Machine`] of vector operations: numbers, truth values and bits are vectors of lanes of one size.
struct Lanes<'m, 'a> {
    block: RefCell<&'m mut Block<'a>>,
    element: Element,
    fused: bool,
}

impl<'m, 'a> Lanes<'m, 'a> {
    fn of(block: &'m mut Block<'a>, element: Element, fused: bool) -> Lanes<'m, 'a> {
        Lanes { block: RefCell::new(block), element, fused }
    }

    fn compute<const N: usize>(&self, operation: Operation, operands: [Id; N]) -> Id {
        self.block.borrow_mut().compute(operation, self.element, operands)
    }
}

/// Steps that map to one operation.
macro_rules! operations {
    ($($name:ident($($operand:ident),*) = $operation:expr;)*) => {
        $(fn $name(&self, $($operand: Id),*) -> Id {
            self.compute($operation, [$($operand),*])
        })*
    };
}

impl Machine for Lanes<'_, '_> {
    type Number = Id;
    type Truth = Id;
    type Bits = Id;

    operations! {
        add(a, b) = Operation::Add;
        sub(a, b) = Operation::Sub;
        mul(a, b) = Operation::Mul;
        div(a, b) = Operation::Div;
        sqrt(a) = Operation::Sqrt;
        and(a, b) = Operation::And;
        or(a, b) = Operation::Or;
        less(a, b) = Operation::Compare(comparison::LESS);
        equal(a, b) = Operation::Compare(comparison::EQUAL);
        bits_add(a, b) = Operation::AddBits;
        bits_and(a, b) = Operation::And;
        bits_or(a, b) = Operation::Or;
        bits_xor(a, b) = Operation::Xor;
        bits_equal(a, b) = Operation::EqualBits;
    }

    fn is_fused(&self) -> bool {
        self.fused
    }
    fn select(&self, truth: Id, a: Id, b: Id) -> Id {
        self.block.borrow_mut().selected(self.element, truth, [a, b])
    }
    fn constant(&self, x: f64) -> Id {
        self.block.borrow_mut().number(self.element, x)
    }
    fn pattern(&self, bits: u64) -> Id {
        self.block.borrow_mut().constant_bytes(&bits.to_le_bytes()[..self.element.bytes()])
    }
    fn abs(&self, a: Id) -> Id {
        let magnitude = self.block.borrow_mut().magnitude(self.element);
        self.compute(Operation::And, [a, magnitude])
    }
    fn neg(&self, a: Id) -> Id {
        let sign = self.block.borrow_mut().sign(self.element);
        self.compute(Operation::Xor, [a, sign])
    }
    fn not(&self, a: Id) -> Id {
        self.block.borrow_mut().not(self.element, a)
    }
    fn mul_add(&self, a: Id, b: Id, c: Id) -> Id {
        match self.fused {
            true => self.compute(Operation::Fma, [a, b, c]),
            false => self.add(self.mul(a, b), c),
        }
    }
    fn bits(&self, a: Id) -> Id {
        a
    }
    fn number(&self, a: Id) -> Id {
        a
    }
    fn shift_left(&self, a: Id, by: u8) -> Id {
        self.compute(Operation::ShiftLeft(by), [a])
    }
    fn shift_right(&self, a: Id, by: u8) -> Id {
        self.compute(Operation::ShiftRight(by), [a])
    }

    /// A call out of line, skipped unless a lane needs it.
    fn elsewhere(&self, truth: Id, usual: Id, function: Function1, x: Id) -> Id {
        let block = &mut *self.block.borrow_mut();
        let result = block.new_value();
        let offset = Functions::lanes1(Precision::F64, Plain { fused: false }, function);
        block.act(Act::Rare { truth, usual, x, offset, result });
        result
    }
}
