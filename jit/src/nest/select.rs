//! Instruction selection: maps an operation of a program to vector operations.
//!
//! Pixels and rows, one per lane, share it; truth values are masks everywhere.

use isophote_symbolic::{Comparison, Op, Opcode, Tables};

use crate::vector::{Block, Element, Id, Operation, comparison};

/// The predicate byte of a comparison instruction.
fn bits(of: Comparison) -> u8 {
    match of {
        Comparison::Lt => comparison::LESS,
        Comparison::Le => comparison::AT_MOST,
        Comparison::Eq => comparison::EQUAL,
        Comparison::Ne => comparison::DIFFERENT,
    }
}

impl Block<'_> {
    /// Applies an operation to vectors; `None` for calls and for operations with other inputs.
    pub fn arithmetic(&mut self, element: Element, op: Op, operands: &[Id], tables: &Tables) -> Option<Id> {
        use Operation::*;
        Some(match (op.code, operands) {
            (Opcode::Const(x), _) => self.number(element, x.get()),
            (Opcode::Neg, &[a]) => {
                let sign = self.sign(element);
                self.compute(Xor, element, [a, sign])
            }
            (Opcode::Abs, &[a]) => {
                let magnitude = self.magnitude(element);
                self.compute(And, element, [a, magnitude])
            }
            (Opcode::Sqrt, &[a]) => self.compute(Sqrt, element, [a]),
            (Opcode::Add, &[a, b]) => self.compute(Add, element, [a, b]),
            (Opcode::Sub, &[a, b]) => self.compute(Sub, element, [a, b]),
            (Opcode::Mul, &[a, b]) => self.compute(Mul, element, [a, b]),
            (Opcode::Div, &[a, b]) => self.compute(Div, element, [a, b]),
            (Opcode::Fma, &[a, b, c]) => self.compute(Fma, element, [a, b, c]),
            (Opcode::Compare(of), &[a, b]) => self.compute(Compare(bits(of)), element, [a, b]),
            (Opcode::And, &[a, b]) => self.compute(And, element, [a, b]),
            (Opcode::Or, &[a, b]) => self.compute(Or, element, [a, b]),
            (Opcode::Not, &[a]) => self.not(element, a),
            (Opcode::Gather(lookup), &[a, b]) => self.looked_up(element, tables, lookup, [a, b]),
            (Opcode::Select, &[truth, a, b]) => self.selected(element, truth, [a, b]),
            _ => return None,
        })
    }

    /// `truth ? a : b`; by a cheaper instruction (and, and-not, min, max) if one of them is 0 or if `truth` compares them.
    pub fn selected(&mut self, element: Element, truth: Id, [a, b]: [Id; 2]) -> Id {
        // The minimum is the second operand unless the first is less, as for a selection with NaN or zeros of both signs.
        match self.less.get(&truth) {
            Some(&[x, y]) if [x, y] == [a, b] => return self.compute(Operation::Min, element, [a, b]),
            Some(&[x, y]) if [x, y] == [b, a] => return self.compute(Operation::Max, element, [a, b]),
            _ => {}
        }
        match [a, b].map(|id| self.is_zero(element, id)) {
            [_, true] => self.compute(Operation::And, element, [truth, a]),
            [true, _] => self.compute(Operation::AndNot, element, [truth, b]),
            _ => self.compute(Operation::Select, element, [truth, a, b]),
        }
    }

    /// The integers nearest to f64 below 2⁵¹, ties to even: as f64 and as integers.
    pub fn nearest(&mut self, x: Id) -> [Id; 2] {
        let magic = self.number(Element::Double, isophote_elementary::MAGIC);
        let shifted = self.compute(Operation::Add, Element::Double, [x, magic]);
        let integer = self.compute(Operation::SubBits, Element::Double, [shifted, magic]);
        [self.compute(Operation::Sub, Element::Double, [shifted, magic]), integer]
    }
}
