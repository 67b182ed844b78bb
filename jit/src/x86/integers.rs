//! Writes operations on integers as instructions on general registers.

use iced_x86::{Code, Instruction, MemoryOperand, Register};

use super::assembler::Instructions;
use crate::vector::{Condition, Integer, Integers, MemoryPlace, Operand, Step};

/// The register of a variable. Rows and columns, pixels and blocks of rows, and two more are never in use together.
pub(super) fn register(variable: Integer) -> Register {
    match variable {
        Integer::A => Register::RAX,
        Integer::B => Register::RCX,
        Integer::C => Register::RDX,
        Integer::D => Register::RSI,
        Integer::E | Integer::Sum => Register::RDI,
        // Calls change these, and those above.
        Integer::Address(n) => Register::R8 + u32::from(n),
        Integer::Args => Register::RBX,
        Integer::Pixel | Integer::Block => Register::R12,
        Integer::Begin => Register::R13,
        Integer::Row => Register::R14,
        Integer::Furthest => Register::R15,
    }
}

/// The low 32 bits of a register.
fn low(register: Register) -> Register {
    Register::EAX + (register as u32 - Register::RAX as u32)
}

/// The conditional jump.
fn jump(condition: Condition) -> Code {
    match condition {
        Condition::Equal => Code::Je_rel32_64,
        Condition::Different => Code::Jne_rel32_64,
        Condition::Less => Code::Jl_rel32_64,
        Condition::AtMost => Code::Jle_rel32_64,
        Condition::AtLeast => Code::Jge_rel32_64,
        Condition::More => Code::Jg_rel32_64,
        Condition::Below => Code::Jb_rel32_64,
        Condition::NotBelow => Code::Jae_rel32_64,
        Condition::Above => Code::Ja_rel32_64,
        Condition::NotAbove => Code::Jbe_rel32_64,
    }
}

/// Codes of an instruction of 64 bits, by its second operand: a register, memory, a number.
const MOV: [Code; 3] = [Code::Mov_r64_rm64, Code::Mov_r64_rm64, Code::Mov_rm64_imm32];
const ADD: [Code; 3] = [Code::Add_r64_rm64, Code::Add_r64_rm64, Code::Add_rm64_imm32];
const SUB: [Code; 3] = [Code::Sub_r64_rm64, Code::Sub_r64_rm64, Code::Sub_rm64_imm32];
const CMP: [Code; 3] = [Code::Cmp_r64_rm64, Code::Cmp_r64_rm64, Code::Cmp_rm64_imm32];

impl Instructions {
    fn two(&mut self, [by_register, by_memory, by_number]: [Code; 3], to: Integer, from: Operand) {
        let to = register(to);
        match from {
            Operand::Variable(from) => self.add(Instruction::with2(by_register, to, register(from))),
            Operand::Memory(from) => self.load(by_memory, to, from),
            Operand::Number(number) => self.add(Instruction::with2(by_number, to, number)),
        }
    }

    fn load(&mut self, code: Code, to: Register, from: MemoryPlace) {
        self.add_at(from, |from| Instruction::with2(code, to, from));
    }

    fn save(&mut self, code: Code, to: MemoryPlace, from: Register) {
        self.add_at(to, |to: MemoryOperand| Instruction::with2(code, to, from));
    }

    /// Appends operations on integers.
    pub fn integers(&mut self, integers: &Integers) {
        integers.0.iter().for_each(|step| self.step(*step));
    }

    fn step(&mut self, step: Step) {
        match step {
            Step::Set(to, from) => self.two(MOV, to, from),
            Step::Add(to, from) => self.two(ADD, to, from),
            Step::Subtract(to, from) => self.two(SUB, to, from),
            Step::Multiply(to, from) => self.load(Code::Imul_r64_rm64, register(to), from),
            Step::Scale(to, from, number) => {
                self.add(Instruction::with3(Code::Imul_r64_rm64_imm32, register(to), register(from), number));
            }
            Step::AtMost(to, from) => {
                self.two(CMP, to, from.into());
                self.add(Instruction::with2(Code::Cmova_r64_rm64, register(to), register(from)));
            }
            Step::CountOnes(of) => {
                let of = low(register(of));
                self.add(Instruction::with2(Code::Popcnt_r32_rm32, of, of));
            }
            Step::LoadLow(to, from) => self.load(Code::Mov_r32_rm32, low(register(to)), from),
            Step::Store(to, from) => self.save(Code::Mov_rm64_r64, to, register(from)),
            Step::StoreLow(to, from) => self.save(Code::Mov_rm32_r32, to, low(register(from))),
            Step::AddAt(to, from) => self.save(Code::Add_rm64_r64, to, register(from)),
            Step::Copy { to, from, by, bytes } => {
                let by = register(by);
                let number = by as u32 - Register::RAX as u32;
                let (load, store, narrow) = match bytes {
                    1 => (Code::Movzx_r32_rm8, Code::Mov_rm8_r8, Register::AL + number),
                    2 => (Code::Movzx_r32_rm16, Code::Mov_rm16_r16, Register::AX + number),
                    4 => (Code::Mov_r32_rm32, Code::Mov_rm32_r32, low(by)),
                    _ => (Code::Mov_r64_rm64, Code::Mov_rm64_r64, by),
                };
                self.load(load, if bytes == 8 { by } else { low(by) }, from);
                self.save(store, to, narrow);
            }
            Step::Prefetch(place) => self.add_at(place, |place| Instruction::with1(Code::Prefetcht0_m8, place)),
            Step::Branch(left, condition, right, to) => {
                self.two(CMP, left, right);
                self.jump(jump(condition), to);
            }
            Step::BranchLow(left, condition, right, to) => {
                self.load(Code::Cmp_r32_rm32, low(register(left)), right);
                self.jump(jump(condition), to);
            }
            Step::Jump(to) => self.jump(Code::Jmp_rel32_64, to),
            Step::Label(label) => self.label(label),
        }
    }
}
