//! Translates operations on integers.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{self, InstBuilder, types};

use super::{Bounds, INTEGERS, PIXELS, Translator};
use crate::vector::{Condition, Integer, Integers, Label, Operand, Step};

fn compared(condition: Condition) -> IntCC {
    match condition {
        Condition::Equal => IntCC::Equal,
        Condition::Different => IntCC::NotEqual,
        Condition::Less => IntCC::SignedLessThan,
        Condition::AtMost => IntCC::SignedLessThanOrEqual,
        Condition::AtLeast => IntCC::SignedGreaterThanOrEqual,
        Condition::More => IntCC::SignedGreaterThan,
        Condition::Below => IntCC::UnsignedLessThan,
        Condition::NotBelow => IntCC::UnsignedGreaterThanOrEqual,
        Condition::Above => IntCC::UnsignedGreaterThan,
        Condition::NotAbove => IntCC::UnsignedLessThanOrEqual,
    }
}

impl Translator<'_> {
    /// A variable's value.
    pub fn integer(&mut self, variable: Integer) -> ir::Value {
        match INTEGERS.iter().position(|known| *known == variable) {
            Some(place) => self.b.use_var(self.variables[place]),
            None => self.args,
        }
    }

    pub fn set(&mut self, variable: Integer, value: ir::Value) {
        let place = INTEGERS.iter().position(|known| *known == variable);
        let Some(place) = place else { unreachable!("the address of the argument block never changes") };
        self.b.def_var(self.variables[place], value);
    }

    fn operand(&mut self, operand: Operand) -> ir::Value {
        match operand {
            Operand::Variable(variable) => self.integer(variable),
            Operand::Memory(place) => self.load(types::I64, place),
            Operand::Number(number) => self.b.ins().iconst(types::I64, i64::from(number)),
        }
    }

    pub fn integers(&mut self, integers: &Integers) {
        integers.0.iter().for_each(|step| self.step(*step));
    }

    fn step(&mut self, step: Step) {
        match step {
            Step::Set(to, from) => {
                let value = self.operand(from);
                self.set(to, value);
            }
            Step::Add(to, from) => {
                let (a, b) = (self.integer(to), self.operand(from));
                let sum = self.b.ins().iadd(a, b);
                self.set(to, sum);
            }
            Step::Subtract(to, from) => {
                let (a, b) = (self.integer(to), self.operand(from));
                let difference = self.b.ins().isub(a, b);
                self.set(to, difference);
            }
            Step::Multiply(to, from) => {
                let (a, b) = (self.integer(to), self.operand(from.into()));
                let product = self.b.ins().imul(a, b);
                self.set(to, product);
            }
            Step::AtMost(to, from) => {
                let (a, b) = (self.integer(to), self.integer(from));
                let least = self.b.ins().umin(a, b);
                self.set(to, least);
            }
            Step::CountOnes(of) => {
                let bits = self.low(of);
                let ones = self.b.ins().popcnt(bits);
                let ones = self.b.ins().uextend(types::I64, ones);
                self.set(of, ones);
            }
            Step::Store(to, from) => {
                let value = self.integer(from);
                self.store(value, to);
            }
            Step::StoreLow(to, from) => {
                let value = self.low(from);
                self.store(value, to);
            }
            Step::AddAt(to, from) => {
                let (a, b) = (self.load(types::I64, to), self.integer(from));
                let sum = self.b.ins().iadd(a, b);
                self.store(sum, to);
            }
            Step::Copy { to, from, bytes, .. } => {
                let (at, offset) = self.address(from);
                let element = match bytes {
                    1 => self.b.ins().uload8(types::I32, PIXELS, at, offset),
                    2 => self.b.ins().uload16(types::I32, PIXELS, at, offset),
                    4 => self.b.ins().load(types::F32, PIXELS, at, offset),
                    _ => self.b.ins().load(types::F64, PIXELS, at, offset),
                };
                // The buffer is filled from its start.
                drop(self.copies.split_off(&to.offset));
                self.copies.insert(to.offset, element);
            }
            Step::Branch(left, condition, right, to) => {
                let a = self.integer(left);
                let b = self.operand(right);
                self.branch([a, b], condition, to);
                if let (Condition::NotBelow, Operand::Number(number), Bounds::Minima) = (condition, right, self.bounds)
                {
                    // It is less here.
                    let most = self.b.ins().iconst(types::I64, i64::from(number) - 1);
                    let value = self.b.ins().umin(a, most);
                    self.set(left, value);
                }
            }
            Step::Jump(to) => {
                self.b.ins().jump(self.labels[to.0], &[]);
                self.is_open = false;
            }
            Step::Label(Label(label)) => {
                let block = self.labels[label];
                if self.is_open {
                    self.b.ins().jump(block, &[]);
                }
                self.b.switch_to_block(block);
                self.is_open = true;
                self.sums.clear();
            }
            Step::Scale(..) | Step::LoadLow(..) | Step::BranchLow(..) | Step::Prefetch(_) => {
                unreachable!("{step:?} is for wider vectors")
            }
        }
    }

    /// The low 32 bits of a variable.
    fn low(&mut self, variable: Integer) -> ir::Value {
        let value = self.integer(variable);
        self.b.ins().ireduce(types::I32, value)
    }

    fn branch(&mut self, [a, b]: [ir::Value; 2], condition: Condition, to: Label) {
        let holds = self.b.ins().icmp(compared(condition), a, b);
        let next = self.b.create_block();
        self.b.ins().brif(holds, self.labels[to.0], &[], next, &[]);
        self.b.switch_to_block(next);
        self.b.seal_block(next);
    }
}
