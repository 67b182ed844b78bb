//! Emulates a processor, for code that this machine cannot run: each instruction follows the manual, lane by lane; every
//! address must belong to a region.

use std::collections::BTreeMap;

use iced_x86::{Code, Instruction, Mnemonic, OpKind, Register};
use isophote_elementary::{Accuracy, Function1, Function2, Plain};
use isophote_symbolic::Precision;

use crate::abi::Functions;

#[path = "emulated_lanes_tests.rs"]
mod emulated_lanes;
use emulated_lanes::{Vector, compares, doubles, general, lanes, singles, together, words};

/// More instructions than any valid program of the tests runs.
const STEPS_MAX: usize = 1_000_000;

/// How a run ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Ended {
    Returned,
    Never,
}

/// Memory, registers, and the operands of the last comparison.
pub(crate) struct Emulator {
    /// Bytes of each region, by its address.
    pub regions: BTreeMap<u64, Vec<u8>>,
    pub general: [u64; 16],
    vectors: [Vector; 32],
    masks: [u64; 8],
    compared: [u64; 2],
    /// Address of the function table.
    pub functions: u64,
    pub steps: usize,
}

impl Emulator {
    pub fn new(functions: u64) -> Emulator {
        Emulator {
            regions: BTreeMap::new(),
            general: [0; 16],
            vectors: [[0xEE; 64]; 32],
            masks: [0; 8],
            compared: [0; 2],
            functions,
            steps: 0,
        }
    }

    fn region(&mut self, address: u64, bytes: usize) -> &mut [u8] {
        let (start, region) = self.regions.range_mut(..=address).next_back().expect("an address before all regions");
        let at = (address - start) as usize;
        assert!(at + bytes <= region.len(), "{bytes} bytes at {address:#x} leave their region");
        &mut region[at..at + bytes]
    }

    pub fn read(&mut self, address: u64, bytes: usize) -> Vec<u8> {
        self.region(address, bytes).to_vec()
    }

    fn write(&mut self, address: u64, bytes: &[u8]) {
        self.region(address, bytes.len()).copy_from_slice(bytes);
    }

    fn register(&self, register: Register) -> u64 {
        if register == Register::None {
            return 0;
        }
        let (number, bits) = general(register);
        self.general[number] & u64::MAX >> (64 - bits)
    }

    fn set_register(&mut self, register: Register, value: u64) {
        let (number, bits) = general(register);
        let written = u64::MAX >> (64 - bits);
        // A result of 32 bits clears the others.
        let kept = if bits == 32 { 0 } else { self.general[number] & !written };
        self.general[number] = kept | value & written;
    }

    fn address(&self, i: &Instruction) -> u64 {
        if i.is_ip_rel_memory_operand() {
            return i.ip_rel_memory_address();
        }
        let index = self.register(i.memory_index()).wrapping_mul(i.memory_index_scale().into());
        self.register(i.memory_base()).wrapping_add(index).wrapping_add(i.memory_displacement64())
    }

    /// A general operand; of memory, the bytes that the instruction reads.
    fn operand(&mut self, i: &Instruction, operand: u32) -> u64 {
        match i.op_kind(operand) {
            OpKind::Register => self.register(i.op_register(operand)),
            OpKind::Memory => {
                let mut bytes = self.read(self.address(i), i.memory_size().size());
                bytes.resize(8, 0);
                u64::from_le_bytes(bytes.try_into().unwrap())
            }
            _ => i.immediate(operand),
        }
    }

    fn number(register: Register) -> (usize, usize) {
        for (first, bytes) in [(Register::XMM0, 16), (Register::YMM0, 32), (Register::ZMM0, 64)] {
            if (first..=first + 31).contains(&register) {
                return (register as usize - first as usize, bytes);
            }
        }
        panic!("{register:?}")
    }

    /// A vector operand; a broadcast memory operand fills all lanes.
    fn vector(&mut self, i: &Instruction, operand: u32) -> Vector {
        match i.op_kind(operand) {
            OpKind::Register => self.vectors[Self::number(i.op_register(operand)).0],
            OpKind::Memory => {
                let bytes = self.read(self.address(i), i.memory_size().size());
                let mut vector = [0; 64];
                let times = if i.is_broadcast() { 64 / bytes.len() } else { 1 };
                vector[..bytes.len() * times].copy_from_slice(&bytes.repeat(times));
                vector
            }
            kind => panic!("{kind:?}"),
        }
    }

    fn mask_number(register: Register) -> usize {
        register as usize - Register::K0 as usize
    }

    /// Writes a result to the first operand; with a mask, only its elements of `element` bytes.
    fn leave(&mut self, i: &Instruction, result: Vector, element: usize) {
        if i.op0_kind() == OpKind::Memory {
            let bytes = i.memory_size().size();
            return self.write(self.address(i), &result[..bytes]);
        }
        let (number, bytes) = Self::number(i.op0_register());
        let old = self.vectors[number];
        let mask = match i.op_mask() {
            Register::None => u64::MAX,
            mask => self.masks[Self::mask_number(mask)],
        };
        let lane = |at: usize| mask >> (at / element) & 1 == 1;
        self.vectors[number] = std::array::from_fn(|at| match at < bytes {
            true if lane(at) => result[at],
            true => old[at],
            false => 0,
        });
    }

    /// Runs until the code returns or the step limit is reached.
    pub fn run(&mut self, instructions: &[Instruction]) -> Ended {
        self.watched(instructions, |_, _| {})
    }

    /// Like [`Emulator::run`]; `see` inspects the processor before each instruction, given its index.
    pub fn watched(&mut self, instructions: &[Instruction], mut see: impl FnMut(&mut Emulator, usize)) -> Ended {
        let places: BTreeMap<u64, usize> = instructions.iter().enumerate().map(|(at, i)| (i.ip(), at)).collect();
        let mut at = 0;
        loop {
            let i = &instructions[at];
            see(self, at);
            self.steps += 1;
            if self.steps > STEPS_MAX {
                return Ended::Never;
            }
            let [a, b] = self.compared;
            let [x, y] = [a, b].map(|number| number as i64);
            let jumps = match i.code() {
                Code::Retnq => return Ended::Returned,
                Code::Jmp_rel32_64 => true,
                Code::Je_rel32_64 => a == b,
                Code::Jne_rel32_64 => a != b,
                Code::Jl_rel32_64 => x < y,
                Code::Jle_rel32_64 => x <= y,
                Code::Jg_rel32_64 => x > y,
                Code::Jge_rel32_64 => x >= y,
                Code::Jae_rel32_64 => a >= b,
                Code::Jb_rel32_64 => a < b,
                Code::Ja_rel32_64 => a > b,
                Code::Jbe_rel32_64 => a <= b,
                _ => {
                    if !self.general_instruction(i) {
                        self.vector_instruction(i);
                    }
                    false
                }
            };
            at = if jumps { places[&i.near_branch64()] } else { at + 1 };
        }
    }

    fn general_instruction(&mut self, i: &Instruction) -> bool {
        let result = match i.mnemonic() {
            Mnemonic::Mov | Mnemonic::Movzx => self.operand(i, 1),
            Mnemonic::Lea => self.address(i),
            Mnemonic::Add => self.operand(i, 0).wrapping_add(self.operand(i, 1)),
            Mnemonic::Sub => self.operand(i, 0).wrapping_sub(self.operand(i, 1)),
            Mnemonic::And => self.operand(i, 0) & self.operand(i, 1),
            Mnemonic::Or => self.operand(i, 0) | self.operand(i, 1),
            Mnemonic::Xor => self.operand(i, 0) ^ self.operand(i, 1),
            Mnemonic::Neg => self.operand(i, 0).wrapping_neg(),
            Mnemonic::Shl => self.operand(i, 0) << (i.immediate8() & 63),
            Mnemonic::Sete => u64::from(self.compared[0] == self.compared[1]),
            Mnemonic::Cmovae if self.compared[0] >= self.compared[1] => self.operand(i, 1),
            Mnemonic::Cmovbe if self.compared[0] <= self.compared[1] => self.operand(i, 1),
            Mnemonic::Imul if i.op_count() == 3 => self.operand(i, 1).wrapping_mul(self.operand(i, 2)),
            Mnemonic::Imul => self.operand(i, 0).wrapping_mul(self.operand(i, 1)),
            Mnemonic::Popcnt => self.operand(i, 1).count_ones().into(),
            Mnemonic::Shr => self.operand(i, 0) >> i.immediate8(),
            Mnemonic::Cmovb if self.compared[0] < self.compared[1] => self.operand(i, 1),
            Mnemonic::Cmova if self.compared[0] > self.compared[1] => self.operand(i, 1),
            Mnemonic::Cmp => {
                self.compared = [self.operand(i, 0), self.operand(i, 1)];
                if i.code() == Code::Cmp_r32_rm32 {
                    // The order of the two is preserved.
                    self.compared = self.compared.map(|number| number as i32 as u64);
                }
                return true;
            }
            Mnemonic::Test => {
                self.compared = [self.operand(i, 0) & self.operand(i, 1), 0];
                return true;
            }
            Mnemonic::Cmova | Mnemonic::Cmovb | Mnemonic::Cmovae | Mnemonic::Cmovbe => return true,
            Mnemonic::Vzeroupper | Mnemonic::Prefetcht0 => return true,
            Mnemonic::Push => {
                self.general[4] -= 8;
                self.write(self.general[4], &self.register(i.op0_register()).to_le_bytes());
                return true;
            }
            Mnemonic::Pop => {
                let bytes = self.read(self.general[4], 8);
                self.set_register(i.op0_register(), u64::from_le_bytes(bytes.try_into().unwrap()));
                self.general[4] += 8;
                return true;
            }
            Mnemonic::Call => {
                self.call((self.address(i) - self.functions) as i32);
                return true;
            }
            _ => return false,
        };
        use Mnemonic::{Add, And, Imul, Neg, Or, Shl, Sub, Xor};
        match i.mnemonic() {
            Sub => self.compared = [self.operand(i, 0), self.operand(i, 1)],
            Add | And | Imul | Neg | Or | Shl | Xor => self.compared = [result, 0],
            _ => {}
        }
        match i.op0_kind() {
            OpKind::Register => self.set_register(i.op0_register(), result),
            _ => self.write(self.address(i), &result.to_le_bytes()[..i.memory_size().size()]),
        }
        true
    }

    /// Calls a function of the table; clobbers caller-saved registers.
    fn call(&mut self, offset: i32) {
        let [first, second] = [self.general[7], self.general[6]];
        let mut found = false;
        for fused in [false, true] {
            let machine = Plain { fused };
            for (precision, accuracy) in [(Precision::F32, Accuracy::Single), (Precision::F64, Accuracy::Double)] {
                for f in Function1::EVERY.iter().filter(|f| Functions::lanes1(precision, machine, **f) == offset) {
                    self.apply(precision, [first, first], |x, _| f.value_with(machine, accuracy, x));
                    found = true;
                }
                for f in Function2::ALL.iter().filter(|f| Functions::lanes2(precision, machine, **f) == offset) {
                    self.apply(precision, [first, second], |x, y| f.value_with(machine, accuracy, x, y));
                    found = true;
                }
            }
        }
        assert!(found, "no function at {offset}");
        [0, 1, 2, 6, 7, 8, 9, 10, 11].iter().for_each(|register| self.general[*register] = 0xDEAD);
        self.vectors = [[0xDD; 64]; 32];
        self.masks = [0xDDDD; 8];
    }

    fn apply(&mut self, precision: Precision, [first, second]: [u64; 2], f: impl Fn(f64, f64) -> f64) {
        let [a, b] = [first, second].map(|address| self.read(address, 16));
        let result: Vec<u8> = match precision {
            Precision::F32 => {
                let number = |lane: &[u8]| f64::from(f32::from_le_bytes(lane.try_into().unwrap()));
                let lanes = a.chunks(4).zip(b.chunks(4));
                lanes.flat_map(|(a, b)| (f(number(a), number(b)) as f32).to_le_bytes()).collect()
            }
            Precision::F64 => {
                let number = |lane: &[u8]| f64::from_le_bytes(lane.try_into().unwrap());
                a.chunks(8).zip(b.chunks(8)).flat_map(|(a, b)| f(number(a), number(b)).to_le_bytes()).collect()
            }
        };
        self.write(first, &result);
    }

    fn vector_instruction(&mut self, i: &Instruction) {
        use Mnemonic::*;
        let operands = (0..i.op_count()).filter(|at| {
            let is_mask =
                i.op_kind(*at) == OpKind::Register && (Register::K0..=Register::K7).contains(&i.op_register(*at));
            let is_general = i.op_kind(*at) == OpKind::Register && i.op_register(*at).is_gpr();
            matches!(i.op_kind(*at), OpKind::Register | OpKind::Memory) && !is_mask && !is_general
        });
        if i.is_vsib() {
            return self.gather(i);
        }
        let stores = i.op0_kind() == OpKind::Memory;
        let all: Vec<u32> = operands.filter(|at| !(stores && *at == 0)).collect();
        let v: Vec<Vector> = all.into_iter().map(|at| self.vector(i, at)).collect();
        let zero = [0; 64];
        let at = |n: usize| v.get(n).unwrap_or(&zero);
        let three = |a: usize, b: usize, c: usize| [at(a), at(b), at(c)];
        let byte =
            i.op_count().checked_sub(1).filter(|last| i.op_kind(*last) == OpKind::Immediate8).map(|_| i.immediate8());
        let (result, element) = match i.mnemonic() {
            Vaddps => (singles(|_, a, b| a + b, three(0, 1, 2)), 4),
            Vaddpd => (doubles(|_, a, b| a + b, three(0, 1, 2)), 8),
            Vsubps => (singles(|_, a, b| a - b, three(0, 1, 2)), 4),
            Vsubpd => (doubles(|_, a, b| a - b, three(0, 1, 2)), 8),
            Vmulps => (singles(|_, a, b| a * b, three(0, 1, 2)), 4),
            Vmulpd => (doubles(|_, a, b| a * b, three(0, 1, 2)), 8),
            Vdivps => (singles(|_, a, b| a / b, three(0, 1, 2)), 4),
            Vdivpd => (doubles(|_, a, b| a / b, three(0, 1, 2)), 8),
            Vsqrtps => (singles(|_, a, _| a.sqrt(), three(0, 1, 1)), 4),
            Vsqrtpd => (doubles(|_, a, _| a.sqrt(), three(0, 1, 1)), 8),
            Vfmadd132ps => (singles(|a, b, c| a.mul_add(c, b), three(0, 1, 2)), 4),
            Vfmadd132pd => (doubles(|a, b, c| a.mul_add(c, b), three(0, 1, 2)), 8),
            Vfmadd213ps => (singles(|a, b, c| b.mul_add(a, c), three(0, 1, 2)), 4),
            Vfmadd213pd => (doubles(|a, b, c| b.mul_add(a, c), three(0, 1, 2)), 8),
            Vfmadd231ps => (singles(|a, b, c| b.mul_add(c, a), three(0, 1, 2)), 4),
            Vfmadd231pd => (doubles(|a, b, c| b.mul_add(c, a), three(0, 1, 2)), 8),
            Vandps | Vandpd => (words(|_, a, b| a & b, three(0, 1, 2)), 8),
            Vandnps | Vandnpd => (words(|_, a, b| !a & b, three(0, 1, 2)), 8),
            Vorps | Vorpd => (words(|_, a, b| a | b, three(0, 1, 2)), 8),
            Vxorps | Vxorpd => (words(|_, a, b| a ^ b, three(0, 1, 2)), 8),
            Vpminud => (singles(|_, a, b| f32::from_bits(a.to_bits().min(b.to_bits())), three(0, 1, 2)), 4),
            Vminps => (singles(|_, a, b| if a < b { a } else { b }, three(0, 1, 2)), 4),
            Vminpd => (doubles(|_, a, b| if a < b { a } else { b }, three(0, 1, 2)), 8),
            Vmaxps => (singles(|_, a, b| if a > b { a } else { b }, three(0, 1, 2)), 4),
            Vmaxpd => (doubles(|_, a, b| if a > b { a } else { b }, three(0, 1, 2)), 8),
            Vpminuq => (words(|_, a, b| a.min(b), three(0, 1, 2)), 8),
            Vpaddd => (singles(|_, a, b| f32::from_bits(a.to_bits().wrapping_add(b.to_bits())), three(0, 1, 2)), 4),
            Vpaddq => (words(|_, a, b| a.wrapping_add(b), three(0, 1, 2)), 8),
            Vpsubq => (words(|_, a, b| a.wrapping_sub(b), three(0, 1, 2)), 8),
            Vpsllq => (words(|_, a, _| a << i.immediate8(), three(0, 1, 1)), 8),
            Vpsrld => (singles(|_, a, _| f32::from_bits(a.to_bits() >> i.immediate8()), three(0, 1, 1)), 4),
            Vpsrlq => (words(|_, a, _| a >> i.immediate8(), three(0, 1, 1)), 8),
            Vpternlogd | Vpternlogq => {
                assert_eq!(byte, Some(0xca));
                (words(|a, b, c| a & b | !a & c, three(0, 1, 2)), 8)
            }
            Vblendvps => (singles(|a, b, c| if c.is_sign_negative() { b } else { a }, three(1, 2, 3)), 4),
            Vblendvpd => (doubles(|a, b, c| if c.is_sign_negative() { b } else { a }, three(1, 2, 3)), 8),
            Vcmpps | Vcmppd | Vpcmpeqq => return self.compare(i, &v, byte),
            Vcvtps2pd => {
                let wide = lanes::<4>(at(1)).into_iter().map(|x| f64::from(f32::from_le_bytes(x)).to_le_bytes());
                (together(wide.take(8)), 8)
            }
            Vcvtpd2ps => {
                let narrow = lanes::<8>(at(1)).into_iter().map(|x| (f64::from_le_bytes(x) as f32).to_le_bytes());
                (together(narrow), 4)
            }
            Vcvtdq2ps => {
                (together(lanes::<4>(at(1)).into_iter().map(|x| (i32::from_le_bytes(x) as f32).to_le_bytes())), 4)
            }
            Vcvtdq2pd => {
                let wide = lanes::<4>(at(1)).into_iter().map(|x| f64::from(i32::from_le_bytes(x)).to_le_bytes());
                (together(wide.take(8)), 8)
            }
            Vpmovzxbd => (together(at(1).iter().take(16).map(|x| u32::from(*x).to_le_bytes())), 4),
            Vpmovzxwd => {
                let words = lanes::<2>(at(1)).into_iter().take(16);
                (together(words.map(|x| u32::from(u16::from_le_bytes(x)).to_le_bytes())), 4)
            }
            Vextractf128 => (together(lanes::<16>(at(1)).into_iter().skip(1).take(1)), 4),
            Vextractf64x4 => (together(lanes::<32>(at(1)).into_iter().skip(1)), 8),
            Vinsertf128 => (together([lanes::<16>(at(1))[0], lanes::<16>(at(2))[0]]), 4),
            Vinsertf64x4 => (together([lanes::<32>(at(1))[0], lanes::<32>(at(2))[0]]), 8),
            Vunpcklps | Vunpckhps => {
                let first = if i.mnemonic() == Vunpckhps { 2 } else { 0 };
                let both = [at(1), at(2)].map(lanes::<4>);
                (together((0..16).map(|n| both[n % 2][n / 4 * 4 + first + n % 4 / 2])), 4)
            }
            Vunpcklpd | Vunpckhpd => {
                let second = usize::from(i.mnemonic() == Vunpckhpd);
                let [a, b] = [at(1), at(2)].map(lanes::<8>);
                (together((0..8).map(|n| if n % 2 == 0 { a[n + second] } else { b[n - 1 + second] })), 8)
            }
            Vperm2f128 | Vshuff64x2 => {
                let [a, b] = [at(1), at(2)].map(lanes::<16>);
                let bits = |first: u8, count: u8| usize::from(byte.unwrap() >> first & ((1 << count) - 1));
                match i.mnemonic() {
                    // Of each pair of bits, the upper says which vector, the lower which half.
                    Vperm2f128 => {
                        let both = [a[0], a[1], b[0], b[1]];
                        (together([both[bits(0, 2)], both[bits(4, 2)]]), 8)
                    }
                    _ => (together([a[bits(0, 2)], a[bits(2, 2)], b[bits(4, 2)], b[bits(6, 2)]]), 8),
                }
            }
            Vbroadcastss => (together([lanes::<4>(at(1))[0]; 16]), 4),
            Vbroadcastsd => (together([lanes::<8>(at(1))[0]; 8]), 8),
            Vmovaps => {
                let memory = (0..i.op_count()).any(|at| i.op_kind(at) == OpKind::Memory);
                let bytes = i.memory_size().size() as u64;
                assert!(!memory || self.address(i).is_multiple_of(bytes), "{:#x} is not at {bytes}", self.address(i));
                (if stores { *at(0) } else { *at(1) }, 4)
            }
            Vmovups | Vmovss | Vmovsd if stores => (*at(0), 4),
            Vmovups => (*at(1), 4),
            Vmovupd => (*at(1), 8),
            Vcvtsi2sd => {
                let mut number = lanes::<8>(at(1));
                number[0] = (self.register(i.op2_register()) as i64 as f64).to_le_bytes();
                (together(number.into_iter().take(2)), 8)
            }
            Vmovmskps | Vmovmskpd | Vpmovd2m | Vpmovq2m | Vpmovm2d | Vpmovm2q | Kmovw => return self.masks(i, &v),
            other => panic!("{other:?}"),
        };
        let element = if i.op_mask() == Register::None { 1 } else { element };
        self.leave(i, result, element);
    }

    /// Gathers 64 bits for each lane in the mask, and clears the mask.
    fn gather(&mut self, i: &Instruction) {
        let (to, bytes) = Self::number(i.op0_register());
        let index = lanes::<8>(&self.vectors[Self::number(i.memory_index()).0]);
        let base = self.register(i.memory_base()).wrapping_add(i.memory_displacement64());
        let mut result = self.vectors[to];
        for (lane, index) in index.into_iter().enumerate().take(bytes / 8) {
            let place = 8 * lane..8 * lane + 8;
            let is_asked = match i.op_mask() {
                Register::None => self.vectors[Self::number(i.op2_register()).0][place.end - 1] >> 7 == 1,
                mask => self.masks[Self::mask_number(mask)] >> lane & 1 == 1,
            };
            if is_asked {
                let far = u64::from_le_bytes(index).wrapping_mul(i.memory_index_scale().into());
                result[place].copy_from_slice(&self.read(base.wrapping_add(far), 8));
            }
        }
        self.leave(i, result, 8);
        match i.op_mask() {
            Register::None => self.vectors[Self::number(i.op2_register()).0] = [0; 64],
            mask => self.masks[Self::mask_number(mask)] = 0,
        }
    }

    fn compare(&mut self, i: &Instruction, v: &[Vector], byte: Option<u8>) {
        let is_mask = (Register::K0..=Register::K7).contains(&i.op0_register());
        let (a, b) = if is_mask { (&v[0], &v[1]) } else { (&v[1], &v[2]) };
        let truths: Vec<bool> = match (i.mnemonic(), byte) {
            (Mnemonic::Vpcmpeqq, _) => lanes::<8>(a).iter().zip(lanes::<8>(b)).map(|(a, b)| *a == b).collect(),
            (Mnemonic::Vcmppd, Some(how)) => {
                let number = f64::from_le_bytes;
                lanes::<8>(a).iter().zip(lanes::<8>(b)).map(|(a, b)| compares(how, number(*a), number(b))).collect()
            }
            (_, Some(how)) => {
                let number = |lane: [u8; 4]| f64::from(f32::from_le_bytes(lane));
                lanes::<4>(a).iter().zip(lanes::<4>(b)).map(|(a, b)| compares(how, number(*a), number(b))).collect()
            }
            (other, None) => panic!("{other:?}"),
        };
        if is_mask {
            self.masks[Self::mask_number(i.op0_register())] =
                truths.iter().enumerate().fold(0, |bits, (lane, truth)| bits | u64::from(*truth) << lane);
            return;
        }
        let bytes = 64 / truths.len();
        let result = std::array::from_fn(|at| if truths[at / bytes] { 0xFF } else { 0 });
        self.leave(i, result, 1);
    }

    fn masks(&mut self, i: &Instruction, v: &[Vector]) {
        let signs = |element: usize, bytes: usize| {
            let tops = (0..bytes / element).map(|lane| v[0][lane * element + element - 1] >> 7);
            tops.enumerate().fold(0, |bits, (lane, top)| bits | u64::from(top) << lane)
        };
        let (to, from) = (i.op0_register(), i.op1_register());
        match i.mnemonic() {
            Mnemonic::Vmovmskps => self.set_register(to, signs(4, 32)),
            Mnemonic::Vmovmskpd => self.set_register(to, signs(8, 32)),
            Mnemonic::Vpmovd2m => self.masks[Self::mask_number(to)] = signs(4, 64),
            Mnemonic::Vpmovq2m => self.masks[Self::mask_number(to)] = signs(8, 64),
            Mnemonic::Kmovw if to.is_gpr() => self.set_register(to, self.masks[Self::mask_number(from)] & 0xFFFF),
            Mnemonic::Kmovw => self.masks[Self::mask_number(to)] = self.register(from) & 0xFFFF,
            made => {
                let element = if made == Mnemonic::Vpmovm2d { 4 } else { 8 };
                let mask = self.masks[Self::mask_number(from)];
                let result = std::array::from_fn(|at| if mask >> (at / element) & 1 == 1 { 0xFF } else { 0 });
                self.leave(i, result, 1);
            }
        }
    }
}
