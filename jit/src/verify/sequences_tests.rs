//! Generates machine code similar to that of kernels: frames that grow, are released and are rounded, addresses in the frame, parts
//! of registers, comparisons, jumps, aligned moves. Independent of the verifier.

use std::mem::offset_of;

use iced_x86::{Code, Encoder, Instruction, MemoryOperand, Register};

use crate::abi::Args;

/// Length of the list of inputs.
pub(super) const INPUTS: usize = 4;
/// Caller-saved registers.
const FREE: [(Register, Register, Register); 6] = [
    (Register::RAX, Register::EAX, Register::AL),
    (Register::RCX, Register::ECX, Register::CL),
    (Register::RDX, Register::EDX, Register::DL),
    (Register::R8, Register::R8D, Register::R8L),
    (Register::R9, Register::R9D, Register::R9L),
    (Register::RSI, Register::ESI, Register::SIL),
];
const VECTORS: [(Register, i64); 3] = [(Register::XMM1, 16), (Register::YMM1, 32), (Register::ZMM1, 64)];
const JUMPS: [Code; 6] = [
    Code::Ja_rel32_64,
    Code::Jae_rel32_64,
    Code::Jb_rel32_64,
    Code::Jbe_rel32_64,
    Code::Je_rel32_64,
    Code::Jne_rel32_64,
];
const MOVES: [Code; 4] = [Code::Cmova_r64_rm64, Code::Cmovae_r64_rm64, Code::Cmovb_r64_rm64, Code::Cmovbe_r64_rm64];

/// A seeded random number generator (SplitMix64).
pub(super) struct Random(pub u64);

impl Random {
    pub fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % count as u64) as usize
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }

    fn is_once_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }
}

fn at(base: Register, index: Register, scale: u32, offset: i64) -> MemoryOperand {
    MemoryOperand::new(base, index, scale, offset, 8, false, Register::None)
}

/// A sequence under construction.
struct Sequence<'r> {
    random: &'r mut Random,
    code: Vec<Instruction>,
    /// Indices of jumps, and of their targets.
    jumps: Vec<(usize, usize)>,
    /// Bytes of the frame on the straight path.
    frame: i64,
}

/// A whole function: pushes, makes a frame, acts, and returns.
pub(super) fn sequence(random: &mut Random) -> Vec<Instruction> {
    let saved: Vec<Register> = [Register::RBX, Register::RBP].into_iter().take(random.below(3)).collect();
    let mut sequence = Sequence { random, code: Vec::new(), jumps: Vec::new(), frame: 0 };
    saved.iter().for_each(|register| sequence.one(Code::Push_r64, *register));
    let is_rounded = saved.len() == 2 && sequence.random.is_once_in(3);
    if is_rounded {
        sequence.two(Code::Mov_rm64_r64, Register::RBP, Register::RSP);
        let bytes = sequence.random.of(&[-16, -32, -64]);
        sequence.with(Instruction::with2(Code::And_rm64_imm8, Register::RSP, bytes));
    }
    sequence.grow();
    for _ in 0..4 + sequence.random.below(16) {
        sequence.act(is_rounded);
    }
    if is_rounded {
        sequence.two(Code::Mov_rm64_r64, Register::RSP, Register::RBP);
    } else {
        let bytes = sequence.frame;
        sequence.number(Code::Add_rm64_imm32, Register::RSP, bytes);
    }
    let end = sequence.code.len();
    saved.iter().rev().for_each(|register| sequence.one(Code::Pop_r64, *register));
    sequence.code.push(Instruction::with(Code::Retnq));
    sequence.placed(end)
}

impl Sequence<'_> {
    fn with<E: std::fmt::Debug>(&mut self, instruction: Result<Instruction, E>) {
        self.code.push(instruction.expect("operands that fit the code"));
    }
    fn one(&mut self, code: Code, register: Register) {
        self.with(Instruction::with1(code, register));
    }
    fn two(&mut self, code: Code, to: Register, from: Register) {
        self.with(Instruction::with2(code, to, from));
    }
    fn number(&mut self, code: Code, register: Register, number: i64) {
        self.with(Instruction::with2(code, register, number as i32));
    }

    fn grow(&mut self) {
        let bytes = self.random.of(&[8, 24, 64, 64, 72, 128]);
        self.number(Code::Sub_rm64_imm32, Register::RSP, bytes);
        self.frame += bytes;
    }

    /// An offset in the frame, mostly at a multiple of `bytes`.
    fn offset(&mut self, bytes: i64) -> i64 {
        let most = ((self.frame - bytes) / 8).max(0) as usize + 1;
        let offset = 8 * self.random.below(most) as i64;
        if self.random.is_once_in(6) { offset + self.random.of(&[4, 8, 16]) } else { offset / bytes * bytes }
    }

    fn act(&mut self, is_rounded: bool) {
        let (whole, half, byte) = self.random.of(&FREE);
        let (other, other_half, other_byte) = self.random.of(&FREE);
        let none = Register::None;
        match self.random.below(24) {
            0 | 1 => {
                let number = self.random.of(&[0, 1, 3, 8, 16, 24, 300, -1]);
                self.number(Code::Mov_r32_imm32, half, number);
            }
            2 => self.two(Code::Xor_r8_rm8, byte, byte),
            3 => self.two(Code::Xor_r32_rm32, half, half),
            4 => {
                let code = self.random.of(&[Code::Mov_rm8_r8, Code::Or_r8_rm8, Code::And_r8_rm8]);
                self.two(code, byte, other_byte);
            }
            5 => self.one(Code::Sete_rm8, byte),
            6 => {
                let code = self.random.of(&[Code::Mov_rm32_r32, Code::Add_r32_rm32, Code::Or_r32_rm32]);
                self.two(code, half, other_half);
            }
            7 | 8 => {
                let code =
                    self.random.of(&[Code::Mov_rm64_r64, Code::Add_r64_rm64, Code::Or_r64_rm64, Code::Sub_r64_rm64]);
                self.two(code, whole, other);
            }
            9 => {
                let bits = self.random.of(&[0, 1, 3, 32, 63, 64]);
                self.with(Instruction::with2(Code::Shl_rm64_imm8, whole, bits));
            }
            10 => {
                let by = self.random.of(&[2, 8, -1]);
                self.with(Instruction::with3(Code::Imul_r64_rm64_imm8, whole, other, by));
            }
            11 | 12 => {
                let offset = self.offset(8);
                self.with(Instruction::with2(Code::Lea_r64_m, whole, at(Register::RSP, none, 1, offset)));
            }
            13 => {
                let offset = self.offset(8);
                self.with(Instruction::with2(Code::Mov_rm64_r64, at(Register::RSP, none, 1, offset), whole));
            }
            14 => {
                let offset = self.offset(8);
                self.with(Instruction::with2(Code::Mov_r64_rm64, whole, at(Register::RSP, none, 1, offset)));
            }
            15 => {
                let (vector, bytes) = self.random.of(&VECTORS);
                let offset = self.offset(bytes);
                let code = match bytes {
                    16 => Code::VEX_Vmovaps_xmmm128_xmm,
                    32 => Code::VEX_Vmovaps_ymmm256_ymm,
                    _ => Code::EVEX_Vmovaps_zmmm512_k1z_zmm,
                };
                self.with(Instruction::with2(code, at(Register::RSP, none, 1, offset), vector));
            }
            // A number of the caller, which a preceding comparison may bound.
            16 => {
                let field =
                    self.random.of(&[offset_of!(Args, inputs), offset_of!(Args, furthest), offset_of!(Args, last)]);
                self.with(Instruction::with2(Code::Mov_r64_rm64, whole, at(Register::RDI, none, 1, field as i64)));
                if field == offset_of!(Args, inputs) {
                    let place = 8 * self.random.below(INPUTS) as i64;
                    self.with(Instruction::with2(Code::Mov_r64_rm64, other, at(whole, none, 1, place)));
                }
            }
            17 => self.indexed(whole),
            // A freshly computed address.
            18 => {
                let offset = self.offset(16);
                self.with(Instruction::with2(Code::Lea_r64_m, whole, at(Register::RSP, none, 1, offset)));
                if self.random.is_once_in(2) {
                    self.two(Code::Xor_r8_rm8, other_byte, other_byte);
                }
                let further = at(whole, none, 1, 8 * self.random.below(2) as i64);
                self.with(Instruction::with2(Code::Mov_rm64_r64, further, other));
            }
            19 => {
                self.compare(whole, other);
                let code = self.random.of(&MOVES);
                let (to, _, _) = self.random.of(&FREE);
                self.two(code, to, whole);
            }
            20 | 21 => {
                self.compare(whole, other);
                self.jump();
            }
            22 => self.grow(),
            _ if is_rounded => {}
            _ => {
                let bytes = self.frame;
                self.number(Code::Add_rm64_imm32, Register::RSP, bytes);
                self.frame = 0;
                self.grow();
            }
        }
    }

    fn compare(&mut self, whole: Register, other: Register) {
        match self.random.below(3) {
            0 => self.two(Code::Cmp_r64_rm64, whole, other),
            _ => {
                let number = self.random.of(&[0, 2, 4, 8]);
                self.number(Code::Cmp_rm64_imm32, whole, number);
            }
        }
    }

    /// A store at an index that a comparison bounds.
    fn indexed(&mut self, index: Register) {
        let count = self.random.of(&[2, 4]);
        self.number(Code::Cmp_rm64_imm32, index, count);
        let jump = self.random.of(&[Code::Jae_rel32_64, Code::Jae_rel32_64, Code::Ja_rel32_64]);
        let from = self.code.len();
        self.with(Instruction::with_branch(jump, 0));
        let offset = self.offset(8 * count);
        let place = at(Register::RSP, index, 8, offset);
        self.with(Instruction::with2(Code::Mov_rm64_r64, place, index));
        self.jumps.push((from, self.code.len()));
    }

    /// A jump over some of the code that follows, or back.
    fn jump(&mut self) {
        let from = self.code.len();
        let jump = self.random.of(&JUMPS);
        self.with(Instruction::with_branch(jump, 0));
        let to = if self.random.is_once_in(4) { self.random.below(from + 1) } else { from + 1 + self.random.below(6) };
        self.jumps.push((from, to));
    }

    /// Assigns addresses, and resolves jumps, to `end` at the latest.
    fn placed(mut self, end: usize) -> Vec<Instruction> {
        let mut encoder = Encoder::new(64);
        let mut ip = 0;
        let mut starts = Vec::new();
        for instruction in &self.code {
            starts.push(ip);
            ip += encoder.encode(instruction, ip).expect("an instruction") as u64;
        }
        for (from, to) in &self.jumps {
            self.code[*from].set_near_branch64(starts[(*to).min(end)]);
        }
        starts.push(ip);
        for (at, instruction) in self.code.iter_mut().enumerate() {
            instruction.set_len((starts[at + 1] - starts[at]) as usize);
            instruction.set_ip(starts[at]); // after its length, from which iced counts back
        }
        self.code
    }
}
