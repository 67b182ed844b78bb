//! What one instruction may do, and what is known behind it.

use std::collections::{BTreeMap, HashSet};
use std::mem::offset_of;
use std::ops::Range;
use std::sync::LazyLock;

use iced_x86::{Code, Instruction, OpKind, Register};

use super::Permitted;
use super::known::{Distance, Fact, Limit};
use crate::abi::{Args, Functions, PlaneArgs};
use crate::limits::LIMITS;
use crate::wide::calls::CALL_BYTES;
use crate::wide::operation;

/// What is known between two instructions.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct State {
    /// Of the general registers, by number.
    registers: [Fact; 16],
    /// Addresses that are kept in the frame, by their offset.
    kept: BTreeMap<i64, Fact>,
    /// The caller's registers on the stack.
    saved: Vec<Register>,
    /// Bytes of the frame, once it is there.
    frame: i64,
}

/// One instruction with its surroundings.
#[derive(Clone, Copy)]
pub(super) struct Check<'a> {
    pub instruction: &'a Instruction,
    /// The one before, if nothing jumps between them.
    pub before: Option<&'a Instruction>,
    pub reach: Permitted<'a>,
    /// Where the constants are.
    pub pool: &'a Range<u64>,
}

type Checked<T> = Result<T, &'static str>;

const ADDRESS_BYTES: i64 = 8;
/// What a called function leaves as it was: rbx, rsp, rbp, r12 to r15.
const CALLEE_SAVED: [usize; 7] = [3, 4, 5, 12, 13, 14, 15];

/// Instructions on general registers; those of vectors are the table's.
const GENERAL: [Code; 40] = [
    Code::Mov_r64_rm64,
    Code::Mov_rm64_r64,
    Code::Mov_rm64_imm32,
    Code::Mov_r32_rm32,
    Code::Mov_rm32_r32,
    Code::Mov_rm16_r16,
    Code::Mov_rm8_r8,
    Code::Movzx_r32_rm8,
    Code::Movzx_r32_rm16,
    Code::Add_r64_rm64,
    Code::Add_rm64_r64,
    Code::Add_rm64_imm32,
    Code::Sub_r64_rm64,
    Code::Sub_rm64_imm32,
    Code::And_r64_rm64,
    Code::And_rm64_imm32,
    Code::Imul_r64_rm64,
    Code::Imul_r64_rm64_imm32,
    Code::Cmp_r64_rm64,
    Code::Cmp_rm64_imm32,
    Code::Test_rm32_r32,
    Code::Cmova_r64_rm64,
    Code::Popcnt_r32_rm32,
    Code::Lea_r64_m,
    Code::Push_r64,
    Code::Pop_r64,
    Code::Call_rm64,
    Code::Retnq,
    Code::Jmp_rel32_64,
    Code::Je_rel32_64,
    Code::Jne_rel32_64,
    Code::Jl_rel32_64,
    Code::Jle_rel32_64,
    Code::Jg_rel32_64,
    Code::Jge_rel32_64,
    Code::Jae_rel32_64,
    Code::Ja_rel32_64,
    Code::VEX_Vzeroupper,
    Code::VEX_Kmovw_r32_kr,
    Code::VEX_Kmovw_kr_r32,
];
/// Conversion of the pixel count.
const SCALAR: [Code; 2] = [Code::VEX_Vcvtsi2sd_xmm_xmm_rm64, Code::VEX_Vmovsd_m64_xmm];

/// Whether the instruction is one that kernels are made of: none of them traps.
pub(super) fn is_allowed(instruction: &Instruction) -> bool {
    static ALLOWED: LazyLock<HashSet<Code>> =
        LazyLock::new(|| GENERAL.into_iter().chain(SCALAR).chain(operation::every_code()).collect());
    let is_plain = instruction.segment_prefix() == Register::None
        && !instruction.has_lock_prefix()
        && !instruction.has_rep_prefix()
        && !instruction.has_repne_prefix();
    is_plain && ALLOWED.contains(&instruction.code())
}

/// The number of a general register, by its 64-bit or 32-bit name.
fn number(register: Register) -> Option<usize> {
    let firsts = [(Register::RAX, Register::R15), (Register::EAX, Register::R15D)];
    let first = firsts.into_iter().find(|(first, last)| (*first..=*last).contains(&register))?.0;
    Some(register as usize - first as usize)
}

impl State {
    /// What the caller hands over.
    pub fn at_entry() -> State {
        let mut registers = [Fact::Number; 16];
        registers[number_of(Register::RDI)] = Fact::Args;
        registers[number_of(Register::RSP)] = Fact::Stack(0);
        State { registers, kept: BTreeMap::new(), saved: Vec::new(), frame: 0 }
    }

    /// What holds in either.
    pub fn or(&self, other: &State) -> State {
        let kept = self.kept.iter().filter_map(|(at, known)| {
            let known = known.or(*other.kept.get(at)?);
            known.is_pointer().then_some((*at, known))
        });
        State {
            registers: std::array::from_fn(|i| self.registers[i].or(other.registers[i])),
            kept: kept.collect(),
            saved: if self.saved == other.saved { self.saved.clone() } else { Vec::new() },
            frame: if self.frame == other.frame { self.frame } else { 0 },
        }
    }

    fn of(&self, register: Register) -> Fact {
        number(register).map_or(Fact::Number, |number| self.registers[number])
    }

    fn set(&mut self, register: Register, known: Fact) {
        if let Some(number) = number(register) {
            self.registers[number] = known;
        }
    }

    /// Whether an address is kept in so many bytes of the frame.
    fn keeps(&self, start: i64, end: i64) -> bool {
        self.kept.range(start - ADDRESS_BYTES + 1..end).next().is_some()
    }
}

fn number_of(register: Register) -> usize {
    number(register).unwrap_or_default()
}

/// A memory operand, in the terms of what is known.
struct Access {
    base: Fact,
    index: Option<(Fact, i64)>,
    offset: i64,
    bytes: i64,
}

impl Check<'_> {
    /// Checks the instruction, and moves the state behind it.
    pub fn run(&self, state: &mut State) -> Checked<()> {
        let i = self.instruction;
        let writes_memory = i.op0_kind() == OpKind::Memory
            && !matches!(i.code(), Code::Cmp_rm64_imm32 | Code::Test_rm32_r32 | Code::Call_rm64 | Code::Push_r64);
        let access = (i.code() != Code::Lea_r64_m).then(|| self.access(state)).flatten();
        if let Some(access) = &access {
            match writes_memory {
                true => self.write(state, access)?,
                false => self.read(state, access)?,
            }
        }
        match i.code() {
            Code::Push_r64 => return push(state, i.op0_register()),
            Code::Pop_r64 => return pop(state, i.op0_register()),
            Code::Call_rm64 => return self.call(state, access),
            Code::Retnq => return returned(state),
            Code::Cmp_r64_rm64 | Code::Cmp_rm64_imm32 | Code::Test_rm32_r32 => return Ok(()),
            _ => {}
        }
        if i.op_count() == 0 || i.op0_kind() != OpKind::Register || !i.op0_register().is_gpr() {
            return Ok(());
        }
        let to = i.op0_register();
        let Some(number) = number(to) else { return Err("changes a part of a register") };
        let from = match (i.op_count() > 1).then(|| i.op1_kind()) {
            Some(OpKind::Register) => state.of(i.op1_register()),
            Some(OpKind::Memory) => access.map_or(Fact::Number, |access| self.fetched(state, &access)),
            _ => Fact::Number,
        };
        let known = match i.code() {
            Code::Mov_r64_rm64 | Code::Mov_rm64_r64 => from,
            Code::Mov_rm64_imm32 if i.immediate32to64() == 0 => Fact::Below(1),
            Code::Add_r64_rm64 => state.of(to).plus(from),
            Code::Imul_r64_rm64 => state.of(to).times(from),
            Code::Imul_r64_rm64_imm32 => from.scaled(i.immediate32to64()),
            Code::Cmova_r64_rm64 => self.bounded(state, to),
            Code::Lea_r64_m if i.memory_base() == Register::RSP && i.memory_index() == Register::None => {
                match state.of(Register::RSP) {
                    Fact::Frame(at) => Fact::Frame(at + i.memory_displacement64() as i64),
                    _ => Fact::Number,
                }
            }
            Code::And_rm64_imm32 if state.of(to) == Fact::Stack(state.saved.len()) => Fact::Aligned,
            Code::Sub_rm64_imm32 if state.of(to) == Fact::Aligned => {
                let bytes = i.immediate32to64();
                if to != Register::RSP || state.frame != 0 || !(0..=LIMITS.frame_bytes as i64).contains(&bytes) {
                    return Err("makes a frame that is too large, or a second one");
                }
                state.frame = bytes;
                Fact::Frame(0)
            }
            _ => Fact::Number,
        };
        let is_stack = |known: Fact| matches!(known, Fact::Stack(_) | Fact::Aligned | Fact::Frame(0));
        if number == number_of(Register::RSP) && !is_stack(known) {
            return Err("loses the stack");
        }
        state.registers[number] = known;
        Ok(())
    }

    /// What a conditional jump that was not taken says: `cmp r, n; jae` leaves r below n, `cmp r, limit; ja` within the limit.
    pub fn refine(&self, state: &mut State) {
        let Some(before) = self.before.filter(|before| before.op0_kind() == OpKind::Register) else { return };
        let known = match (self.instruction.code(), before.code()) {
            (Code::Jae_rel32_64, Code::Cmp_rm64_imm32) if before.immediate32to64() > 0 => {
                Fact::Below(before.immediate32to64())
            }
            (Code::Ja_rel32_64, Code::Cmp_r64_rm64) if before.op1_kind() == OpKind::Register => {
                let Fact::Limit(limit) = state.of(before.op1_register()) else { return };
                Fact::Within(limit)
            }
            _ => return,
        };
        state.set(before.op0_register(), known);
    }

    /// `cmp r, limit; cmova r, limit` leaves r within the limit, as a number without a sign.
    fn bounded(&self, state: &State, to: Register) -> Fact {
        let (Some(before), Fact::Limit(limit)) = (self.before, state.of(self.instruction.op1_register())) else {
            return Fact::Number;
        };
        let is_same = before.code() == Code::Cmp_r64_rm64
            && before.op1_kind() == OpKind::Register
            && self.instruction.op1_kind() == OpKind::Register
            && before.op0_register() == to
            && before.op1_register() == self.instruction.op1_register();
        if is_same { Fact::Within(limit) } else { Fact::Number }
    }

    /// The memory operand, if there is one; constants are checked here.
    fn access(&self, state: &State) -> Option<Access> {
        let i = self.instruction;
        let operands = (0..i.op_count()).any(|operand| i.op_kind(operand) == OpKind::Memory);
        operands.then(|| {
            let index = i.memory_index();
            Access {
                base: state.of(i.memory_base()),
                index: (index != Register::None).then(|| (state.of(index), i.memory_index_scale().into())),
                offset: i.memory_displacement64() as i64,
                bytes: i.memory_size().size() as i64,
            }
        })
    }

    /// A place in the frame: its first byte, and the one behind its last, wherever the index leads.
    fn in_frame(&self, state: &State, access: &Access) -> Checked<(i64, i64)> {
        let Fact::Frame(at) = access.base else { return Err("is not in the frame") };
        let furthest = match access.index {
            None => 0,
            Some((Fact::Below(count), scale)) => (count - 1) * scale,
            Some(_) => return Err("has an index in the frame that nothing bounds"),
        };
        let (start, end) = (at + access.offset, at + access.offset + furthest + access.bytes);
        if start >= 0 && end <= state.frame { Ok((start, end)) } else { Err("leaves the frame") }
    }

    fn read(&self, state: &State, access: &Access) -> Checked<()> {
        let i = self.instruction;
        if i.is_ip_rel_memory_operand() {
            let start = i.ip_rel_memory_address();
            let is_inside = self.pool.start <= start && start.saturating_add(access.bytes as u64) <= self.pool.end;
            return if is_inside && access.index.is_none() { Ok(()) } else { Err("leaves the constants") };
        }
        let list = |bytes: usize| {
            let is_inside = access.offset >= 0 && access.offset + access.bytes <= bytes as i64;
            if access.index.is_none() && is_inside { Ok(()) } else { Err("leaves its list") }
        };
        match access.base {
            Fact::Frame(_) => self.in_frame(state, access).map(drop),
            Fact::Args => list(size_of::<Args>()),
            Fact::Inputs => list(size_of::<f64>() * self.reach.inputs),
            Fact::Functions => list(size_of::<Functions>()),
            Fact::Planes => list(size_of::<PlaneArgs>() * self.reach.formats.len()),
            Fact::Pixel { channel, axes, lane } => self.pixel(channel, axes, lane, access),
            Fact::Target { .. } => self.target(access),
            _ => Err("reads where nothing is known to be"),
        }
    }

    fn write(&self, state: &mut State, access: &Access) -> Checked<()> {
        let i = self.instruction;
        match access.base {
            Fact::Frame(_) => {
                let (start, end) = self.in_frame(state, access)?;
                let stored = match i.code() {
                    Code::Mov_rm64_r64 => state.of(i.op1_register()),
                    _ => Fact::Number,
                };
                if stored.is_pointer() && access.index.is_none() {
                    state.kept.remove(&start);
                    if state.keeps(start, end) {
                        return Err("writes over a part of an address");
                    }
                    state.kept.insert(start, stored);
                } else if state.keeps(start, end) {
                    return Err("writes over an address");
                }
                Ok(())
            }
            Fact::Args if access.index.is_none() => {
                let is_count = access.offset >= offset_of!(Args, pixels) as i64;
                let is_inside = access.offset + access.bytes <= size_of::<Args>() as i64;
                if is_count && is_inside { Ok(()) } else { Err("writes over arguments") }
            }
            Fact::Outputs if access.index.is_none() => {
                let bytes = (size_of::<f64>() * self.reach.outputs) as i64;
                let is_inside = access.offset >= 0 && access.offset + access.bytes <= bytes;
                if is_inside { Ok(()) } else { Err("leaves the outputs") }
            }
            Fact::Target { .. } => self.target(access),
            _ => Err("writes where nothing may be written"),
        }
    }

    /// Pixels of a group: all at once from a bounded one on, or one after the other.
    fn pixel(&self, channel: usize, axes: u8, lane: usize, access: &Access) -> Checked<()> {
        let size = self.reach.formats.get(channel).ok_or("reads a plane that does not exist")?.bytes_per_pixel() as i64;
        let is_inside = match access.index {
            Some((Fact::Within(Limit::Furthest), scale)) => {
                let end = access.offset + access.bytes;
                axes & 1 == 0
                    && lane == 0
                    && scale == size
                    && access.offset >= 0
                    && end <= size * self.reach.lanes as i64
            }
            Some(_) => false,
            None => access.offset == 0 && access.bytes <= size && lane < self.reach.lanes,
        };
        if is_inside { Ok(()) } else { Err("reads pixels that are not known to be in the window") }
    }

    fn target(&self, access: &Access) -> Checked<()> {
        let size = size_of::<f32>() as i64;
        let is_inside = matches!(access.index, Some((Fact::Within(Limit::Furthest), scale)) if scale == size)
            && access.offset >= 0
            && access.offset + access.bytes <= size * self.reach.lanes as i64;
        if is_inside { Ok(()) } else { Err("touches pixels that are not known to be in the window") }
    }

    /// What 64 bits of memory are.
    fn fetched(&self, state: &State, access: &Access) -> Fact {
        if access.bytes != ADDRESS_BYTES || access.index.is_some() || access.offset < 0 {
            return Fact::Number;
        }
        let at = access.offset as usize;
        match access.base {
            Fact::Args => {
                let last = offset_of!(Args, last);
                let fields = [
                    (offset_of!(Args, inputs), Fact::Inputs),
                    (offset_of!(Args, outputs), Fact::Outputs),
                    (offset_of!(Args, functions), Fact::Functions),
                    (offset_of!(Args, planes), Fact::Planes),
                    (offset_of!(Args, target), Fact::Target { is_row: false }),
                    (offset_of!(Args, furthest), Fact::Limit(Limit::Furthest)),
                    (last, Fact::Limit(Limit::Last(0))),
                    (last + size_of::<i64>(), Fact::Limit(Limit::Last(1))),
                    (last + 2 * size_of::<i64>(), Fact::Limit(Limit::Last(2))),
                    (offset_of!(Args, last_row), Fact::Limit(Limit::LastRow)),
                    (offset_of!(Args, target_stride), Fact::TargetStride),
                ];
                fields.iter().find(|(field, _)| *field == at).map_or(Fact::Number, |(_, known)| *known)
            }
            Fact::Planes => {
                let (channel, field) = (at / size_of::<PlaneArgs>(), at % size_of::<PlaneArgs>());
                let strides = [
                    offset_of!(PlaneArgs, pixel_stride),
                    offset_of!(PlaneArgs, row_stride),
                    offset_of!(PlaneArgs, slice_stride),
                    offset_of!(PlaneArgs, volume_stride),
                ];
                if field == offset_of!(PlaneArgs, first) {
                    return Fact::Pixel { channel, axes: 0, lane: 0 };
                }
                let axis = strides.iter().position(|stride| *stride == field);
                axis.map_or(Fact::Number, |axis| Fact::Stride(Distance { channel, axis }))
            }
            Fact::Frame(start) => state.kept.get(&(start + access.offset)).copied().unwrap_or(Fact::Number),
            _ => Fact::Number,
        }
    }

    /// A function of the table, with vectors of the frame that hold no address.
    fn call(&self, state: &mut State, access: Option<Access>) -> Checked<()> {
        let Some(Access { base: Fact::Functions, index: None, offset, .. }) = access else {
            return Err("calls something that is not in the table");
        };
        let operands = Functions::operands_of_lanes(offset as usize).ok_or("calls no function of lanes")?;
        for register in [Register::RDI, Register::RSI].into_iter().take(operands) {
            let Fact::Frame(start) = state.of(register) else { return Err("hands over no vector of the frame") };
            let end = start + CALL_BYTES as i64;
            if start < 0 || end > state.frame || state.keeps(start, end) {
                return Err("hands over a place that is no vector");
            }
        }
        if state.of(Register::RSP) != Fact::Frame(0) {
            return Err("calls without a frame");
        }
        for (number, known) in state.registers.iter_mut().enumerate() {
            if !CALLEE_SAVED.contains(&number) {
                *known = Fact::Number;
            }
        }
        Ok(())
    }
}

fn push(state: &mut State, register: Register) -> Checked<()> {
    let depth = state.saved.len();
    if state.of(Register::RSP) != Fact::Stack(depth) || state.frame != 0 {
        return Err("pushes behind the beginning");
    }
    state.saved.push(register);
    state.set(Register::RSP, Fact::Stack(depth + 1));
    Ok(())
}

fn pop(state: &mut State, register: Register) -> Checked<()> {
    let depth = state.saved.len();
    if state.of(Register::RSP) != Fact::Stack(depth) || state.saved.pop() != Some(register) {
        return Err("gives a register another value than the caller's");
    }
    state.set(Register::RSP, Fact::Stack(depth - 1));
    state.set(register, Fact::Number);
    Ok(())
}

fn returned(state: &State) -> Checked<()> {
    if state.of(Register::RSP) == Fact::Stack(0) && state.saved.is_empty() {
        return Ok(());
    }
    Err("returns with another stack than the caller's")
}
