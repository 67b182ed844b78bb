//! The rules for one instruction, and its effect on the state.

use std::collections::BTreeMap;
use std::mem::offset_of;

use iced_x86::{Instruction, Mnemonic, OpKind, Register};

use super::known::{Distance, Fact, Few, Limit};
use super::pool::{Checked, Pool};
use super::state::{Asked, State, Word};
use super::{Permitted, listed};
use crate::abi::{Args, Functions, PlaneArgs};

/// One instruction in its context.
#[derive(Clone, Copy)]
pub(super) struct Check<'a> {
    pub instruction: &'a Instruction,
    pub reach: Permitted<'a>,
    /// Upper bounds of vector indices, by the address of the instruction that uses them.
    pub bounds: &'a BTreeMap<u64, i64>,
}

const WORD_BYTES: i64 = 8;
/// Masks that may round the stack pointer down.
const ALIGNMENTS: [i64; 3] = [-16, -32, -64];
const ASTRAY: &str = "wants an address that is a multiple of its operand's size";
/// Bytes of a vector passed to a function, and the least alignment that aligned instructions need.
const VECTOR_BYTES: i64 = 16;

/// A memory operand, in terms of facts.
struct Access {
    place: Fact,
    /// Maximum further distance through an index.
    more: i64,
    offset: i64,
    bytes: i64,
}

/// Whether it neither changes nor reads general registers and frame: a vector instruction on vector registers and constants.
pub(super) fn is_settled(i: &Instruction) -> bool {
    let is_elsewhere =
        (0..i.op_count()).any(|operand| i.op_kind(operand) == OpKind::Memory) && !i.is_ip_rel_memory_operand();
    writes_vector(i) && !is_elsewhere
}

fn writes_vector(i: &Instruction) -> bool {
    i.op_count() > 0 && i.op0_register().is_vector_register() && !listed::compares_numbers(i.mnemonic())
}

/// Checks a read of the constants.
pub(super) fn constant(i: &Instruction, pool: &Pool) -> Checked<()> {
    if !i.is_ip_rel_memory_operand() {
        return Ok(());
    }
    if pool.of(i).is_none() {
        return Err("leaves the constants");
    }
    match wanted_alignment(i) {
        // The code itself is at a multiple of 16 at least.
        Some(bytes) if bytes != VECTOR_BYTES || i.ip_rel_memory_address() as i64 % bytes != 0 => Err(ASTRAY),
        _ => Ok(()),
    }
}

/// The alignment that the instruction needs of its memory operand, in bytes; `None` for unaligned instructions.
fn wanted_alignment(i: &Instruction) -> Option<i64> {
    let bytes = i.memory_size().size() as i64;
    (bytes >= VECTOR_BYTES && listed::wants_alignment(i.mnemonic())).then_some(bytes)
}

impl Check<'_> {
    /// Checks the instruction, and applies it to the state.
    pub fn run(&self, state: &mut State) -> Checked<()> {
        let i = self.instruction;
        if i.mnemonic() == Mnemonic::Prefetcht0 {
            // It has no visible result, and cannot fault wherever it points.
            return Ok(());
        }
        let has_memory = (0..i.op_count()).any(|operand| i.op_kind(operand) == OpKind::Memory);
        let access = (has_memory && i.mnemonic() != Mnemonic::Lea).then(|| self.access(state));
        if let Some(access) = &access {
            if wanted_alignment(i).is_some_and(|bytes| !self.is_aligned(state, access, bytes)) {
                return Err(ASTRAY);
            }
            let only_reads = matches!(i.mnemonic(), Mnemonic::Cmp | Mnemonic::Test | Mnemonic::Call);
            match i.op0_kind() == OpKind::Memory && !only_reads {
                true => self.write(state, access)?,
                false => self.read(state, access)?,
            }
        }
        if writes_vector(i) {
            return Ok(());
        }
        match i.mnemonic() {
            Mnemonic::Push => return state.push(i.op0_register()),
            Mnemonic::Pop => return state.pop(i.op0_register(), self.names()[0]),
            Mnemonic::Call => return self.call(state, &access),
            Mnemonic::Ret => return state.may_return(),
            Mnemonic::Cmp => return self.compare(state, &access),
            mnemonic if !listed::keeps_flags(mnemonic) => state.compared = None,
            _ => {}
        }
        if i.op_count() == 0
            || i.op0_kind() != OpKind::Register
            || !i.op0_register().is_gpr()
            || i.mnemonic() == Mnemonic::Test
        {
            return Ok(());
        }
        let known = self.result(state, &access)?;
        state.set(i.op0_register(), known, self.names()[0])
    }

    /// Fresh names for values of this instruction.
    fn names(&self) -> [u64; 2] {
        [1, 2].map(|n| 2 * self.instruction.ip() + n)
    }

    fn compare(&self, state: &mut State, access: &Option<Access>) -> Checked<()> {
        for operand in 0..2 {
            state.name(self.instruction.op_register(operand), self.names()[operand as usize]);
        }
        state.compared = self.is_of_words().then(|| [0, 1].map(|operand| self.operand(state, operand, access)));
        Ok(())
    }

    /// Whether its operands have 64 bits.
    fn is_of_words(&self) -> bool {
        let i = self.instruction;
        match i.op0_kind() {
            OpKind::Memory => i.memory_size().size() as i64 == WORD_BYTES,
            _ => (Register::RAX..=Register::R15).contains(&i.op0_register()),
        }
    }

    fn operand(&self, state: &State, operand: u32, access: &Option<Access>) -> Word {
        let i = self.instruction;
        match (i.op_kind(operand), access) {
            (OpKind::Register, _) => state.of(i.op_register(operand)),
            (OpKind::Memory, Some(access)) => self.fetched(state, access),
            (OpKind::Memory, None) => Word::unnamed(Fact::Number),
            _ => Word::unnamed(Fact::constant(i.immediate(operand) as i64)),
        }
    }

    /// The new word of the destination register.
    fn result(&self, state: &mut State, access: &Option<Access>) -> Checked<Word> {
        let i = self.instruction;
        let unnamed = |fact: Fact| Ok(Word::unnamed(fact));
        // Moves of 8 and 16 bits have other kinds of immediates.
        let is_constant = i.op_count() == 2 && matches!(i.op1_kind(), OpKind::Immediate32 | OpKind::Immediate64);
        if i.mnemonic() == Mnemonic::Mov && (self.is_of_words() || is_constant) {
            state.name(i.op1_register(), self.names()[1]);
            return Ok(self.operand(state, 1, access));
        }
        // A 32-bit result clears the upper half, one of 8 or 16 bits leaves the rest.
        let is_whole = i.op0_register().is_gpr32() || i.op0_register().is_gpr64();
        if i.mnemonic() == Mnemonic::Xor && i.op0_register() == i.op1_register() && is_whole {
            return unnamed(Fact::constant(0));
        }
        if !self.is_of_words() {
            return unnamed(Fact::Number);
        }
        let before = state.of(i.op0_register());
        let other = |state: &State| self.operand(state, 1, access);
        if State::is_rsp(i.op0_register()) {
            let bytes = if i.op_count() == 2 && i.op1_kind() != OpKind::Register { i.immediate(1) as i64 } else { 0 };
            match i.mnemonic() {
                Mnemonic::Add => return unnamed(state.shrink(bytes)),
                Mnemonic::Sub => return state.grow(bytes).map(Word::unnamed),
                Mnemonic::And if ALIGNMENTS.contains(&bytes) && state.has_no_frame() => {
                    return unnamed(Fact::Aligned(-bytes));
                }
                _ => {}
            }
        }
        unnamed(match i.mnemonic() {
            Mnemonic::Add => before.fact.plus(other(state).fact),
            Mnemonic::Shl => match other(state).fact {
                Fact::OneOf(bits) => bits.only().map_or(Fact::Number, |bits| before.fact.scaled(1 << (bits & 63))),
                _ => Fact::Number,
            },
            Mnemonic::Imul if i.op_count() == 3 => other(state).fact.scaled(i.immediate(2) as i64),
            Mnemonic::Imul => before.fact.times(other(state).fact),
            Mnemonic::Lea => match i.memory_displacement64() as i64 {
                0 => self.sum(state),
                offset => self.sum(state).plus(Fact::constant(offset)),
            },
            mnemonic if listed::is_conditional_move(mnemonic) => match Asked::by(mnemonic) {
                Some(asked) => state.under(asked, other(state)).or(state.under(asked.otherwise(), before)),
                None => before.fact.or(other(state).fact),
            },
            _ => Fact::Number,
        })
    }

    /// Base plus scaled index.
    fn sum(&self, state: &State) -> Fact {
        let i = self.instruction;
        let of = |register: Register| match register {
            Register::None => Fact::constant(0),
            register => state.of(register).fact,
        };
        let index = of(i.memory_index()).scaled(i.memory_index_scale().into());
        match (i.memory_base(), i.memory_index()) {
            (base, Register::None) => of(base),
            (Register::None, _) => index,
            (base, _) => of(base).plus(index),
        }
    }

    /// The memory operand.
    fn access(&self, state: &State) -> Access {
        let i = self.instruction;
        let (offset, bytes) = (i.memory_displacement64() as i64, i.memory_size().size() as i64);
        let [base, index] = [i.memory_base(), i.memory_index()].map(|register| state.of(register).fact);
        if i.is_vsib() {
            let indices = self.bounds.get(&i.ip()).map_or(Fact::Number, |bound| Fact::Below(bound + 1));
            let place = base.plus(indices.scaled(i.memory_index_scale().into()));
            return Access { place, more: 0, offset, bytes };
        }
        match (base, index) {
            (Fact::Frame(_), Fact::Below(count)) => {
                Access { place: base, more: (count - 1) * i64::from(i.memory_index_scale()), offset, bytes }
            }
            _ => Access { place: self.sum(state), more: 0, offset, bytes },
        }
    }

    fn is_aligned(&self, state: &State, access: &Access, bytes: i64) -> bool {
        match access.place {
            _ if self.instruction.is_ip_rel_memory_operand() => true,
            // With an index, the address may have any alignment.
            Fact::Frame(places) if access.more == 0 => {
                state.is_frame_aligned(bytes) && places.each().all(|at| (at + access.offset) % bytes == 0)
            }
            _ => false,
        }
    }

    /// A memory operand in the frame, over all values of its index: the offsets of its first byte, and how many bytes it spans.
    fn in_frame(&self, state: &State, places: Few, access: &Access) -> Checked<(Few, i64)> {
        let bytes = access.more + access.bytes;
        let is_inside = |at: i64| at >= 0 && at + bytes <= state.frame();
        let places = places.plus_number(access.offset).ok_or("leaves the frame")?;
        if places.each().all(is_inside) { Ok((places, bytes)) } else { Err("leaves the frame") }
    }

    /// Checks that it lies inside `bytes` bytes.
    fn list(&self, access: &Access, bytes: usize) -> Checked<()> {
        let is_inside = access.offset >= 0 && access.offset + access.bytes <= bytes as i64;
        if is_inside { Ok(()) } else { Err("leaves its list") }
    }

    fn read(&self, state: &State, access: &Access) -> Checked<()> {
        let i = self.instruction;
        if i.is_ip_rel_memory_operand() {
            return Ok(());
        }
        match access.place {
            Fact::Frame(places) => self.in_frame(state, places, access).map(drop),
            Fact::Args => self.list(access, size_of::<Args>()),
            Fact::Inputs => self.list(access, size_of::<f64>() * self.reach.inputs),
            Fact::Functions => self.list(access, size_of::<Functions>()),
            Fact::Tables(most) => {
                let furthest = Access { bytes: most + access.bytes, ..*access };
                self.list(&furthest, size_of::<f64>() * self.reach.tables)
            }
            Fact::Planes => self.list(access, size_of::<PlaneArgs>() * self.reach.formats.len()),
            Fact::Pixel { channel, lane, .. } => {
                let is_inside =
                    access.offset == 0 && access.bytes <= self.pixel_bytes(channel)? && lane < self.reach.lanes;
                if is_inside { Ok(()) } else { Err("reads pixels that are not known to be in the window") }
            }
            Fact::Group { channel, bytes } if self.reach.packed && bytes == self.pixel_bytes(channel)? => {
                self.group(access, bytes)
            }
            Fact::TargetGroup => self.group(access, size_of::<f32>() as i64),
            _ => Err("reads where nothing is known to be"),
        }
    }

    fn pixel_bytes(&self, channel: usize) -> Checked<i64> {
        let format = self.reach.formats.get(channel).ok_or("reads a plane that does not exist")?;
        Ok(format.bytes_per_pixel() as i64)
    }

    /// Checks that it lies inside a group, whose pixels are all in the window.
    fn group(&self, access: &Access, pixel_bytes: i64) -> Checked<()> {
        let is_inside = access.offset >= 0 && access.offset + access.bytes <= pixel_bytes * self.reach.lanes as i64;
        if is_inside { Ok(()) } else { Err("touches pixels that are not known to be in the window") }
    }

    fn write(&self, state: &mut State, access: &Access) -> Checked<()> {
        let i = self.instruction;
        match access.place {
            Fact::Frame(places) => {
                let (places, bytes) = self.in_frame(state, places, access)?;
                let is_word = i.mnemonic() == Mnemonic::Mov && bytes == WORD_BYTES;
                if is_word {
                    state.name(i.op1_register(), self.names()[1]);
                }
                let known = is_word.then(|| self.operand(state, 1, &None));
                state.store(&places, bytes, known);
                Ok(())
            }
            Fact::Args if access.offset < offset_of!(Args, pixels) as i64 => Err("writes over arguments"),
            Fact::Args => self.list(access, size_of::<Args>()),
            Fact::Outputs => self.list(access, size_of::<f64>() * self.reach.outputs),
            Fact::TargetGroup => self.group(access, size_of::<f32>() as i64),
            _ => Err("writes where nothing may be written"),
        }
    }

    /// The word that a memory operand holds.
    fn fetched(&self, state: &State, access: &Access) -> Word {
        let is_word = access.bytes == WORD_BYTES && access.more == 0;
        let fact = match access.place {
            Fact::Frame(places) if is_word => {
                let places = places.plus_number(access.offset);
                return places.map_or(Word::unnamed(Fact::Number), |places| state.fetched(&places));
            }
            Fact::Args if is_word => argument(access.offset),
            Fact::Planes if is_word => plane(access.offset),
            Fact::Functions if is_word && access.offset % WORD_BYTES == 0 => Fact::Function(access.offset),
            _ => Fact::Number,
        };
        Word::unnamed(fact)
    }

    /// Checks a call of a table function with vectors in the frame.
    fn call(&self, state: &mut State, access: &Option<Access>) -> Checked<()> {
        let Fact::Function(offset) = self.operand(state, 0, access).fact else {
            return Err("calls something that is not in the table");
        };
        let operands = usize::try_from(offset).ok().and_then(Functions::vectors).ok_or("calls no function")?;
        for (operand, register) in [Register::RDI, Register::RSI].into_iter().take(operands).enumerate() {
            let Fact::Frame(places) = state.of(register).fact else { return Err("hands over no vector of the frame") };
            let vector = Access { place: Fact::Number, more: 0, offset: 0, bytes: VECTOR_BYTES };
            let (places, bytes) = self.in_frame(state, places, &vector)?;
            if operand == 0 {
                state.store(&places, bytes, None);
            }
        }
        if !state.is_frame_aligned(VECTOR_BYTES) {
            return Err("calls without a frame, or with one that is not at a multiple of 16");
        }
        state.forget_registers();
        Ok(())
    }
}

/// A field of the argument block.
fn argument(at: i64) -> Fact {
    let last = offset_of!(Args, last);
    let fields = [
        (offset_of!(Args, inputs), Fact::Inputs),
        (offset_of!(Args, outputs), Fact::Outputs),
        (offset_of!(Args, functions), Fact::Functions),
        (offset_of!(Args, planes), Fact::Planes),
        (offset_of!(Args, tables), Fact::Tables(0)),
        (offset_of!(Args, target), Fact::Target { is_row: false }),
        (offset_of!(Args, furthest), Fact::Limit(Limit::Furthest)),
        (last, Fact::Limit(Limit::Last(0))),
        (last + size_of::<i64>(), Fact::Limit(Limit::Last(1))),
        (last + 2 * size_of::<i64>(), Fact::Limit(Limit::Last(2))),
        (offset_of!(Args, last_row), Fact::Limit(Limit::LastRow)),
        (offset_of!(Args, target_stride), Fact::TargetStride),
    ];
    fields.iter().find(|(field, _)| *field as i64 == at).map_or(Fact::Number, |(_, fact)| *fact)
}

/// A field in the list of planes.
fn plane(at: i64) -> Fact {
    let Ok(at) = usize::try_from(at) else { return Fact::Number };
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
