//! Checks the origin of every address in CLIF, on processors whose machine code is not verified.
//!
//! The function takes the address of [`Args`]. The check fails at the first instruction whose address is none of these:
//! ```text
//! record          its stack slot, inside the slot's size          read and written
//! Args            the argument block, inside its size             read; the counts are written
//! ├─ inputs       inside the list                                 read
//! ├─ outputs      inside the list                                 read and written
//! ├─ functions    inside the table; what is read there is called  read
//! ├─ planes       inside the list of planes                       read
//! │  └─ pixels    any distance from the plane's first pixel       read
//! ├─ tables       any distance from the first number              read
//! └─ target       any distance from the first pixel               read and written
//! ```
//! The lowering keeps pixel distances inside the window; this check makes sure that nothing else is touched.

mod origin;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::mem::offset_of;

use cranelift_codegen::entity::SecondaryMap;
use cranelift_codegen::ir::{BlockArg, Function, Inst, InstructionData, Opcode, StackSlot, Value, types};
use isophote_symbolic::Program;

use self::origin::{Base, NUMBER, Origin, PossibleNumbers};

use crate::abi::{Args, Functions, PlaneArgs};

/// Lengths in bytes of the lists that the argument block points to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    pub inputs: usize,
    pub outputs: usize,
    pub planes: usize,
}

impl Extent {
    pub fn of(program: &Program) -> Extent {
        Extent {
            inputs: size_of::<f64>() * program.inputs().len(),
            outputs: size_of::<f64>() * program.sink().outputs().len(),
            planes: size_of::<PlaneArgs>() * program.channels(),
        }
    }
}

/// Checks a function before compilation; names the first invalid instruction.
pub(crate) fn addresses(function: &Function, extent: Extent) -> Result<(), String> {
    let mut origins = Origins { function, known: SecondaryMap::new(), kept: BTreeMap::new(), is_all_kept: false };
    if let Some(entry) = function.layout.entry_block() {
        let parameters = function.dfg.block_params(entry).iter();
        parameters.for_each(|value| origins.known[*value] = Some(Origin::at(Base::Args, 0)));
    }
    // The origin of a value only widens, from nothing over a few numbers to any, so that the rounds terminate. The first
    // fixpoint finds the pointers; in the second, a load where none is stored gives a number.
    let relevant = relevant(function);
    while origins.round(&relevant) {}
    origins.is_all_kept = true;
    while origins.round(&relevant) {}
    for block in function.layout.blocks() {
        for instruction in function.layout.block_insts(block) {
            if !origins.is_allowed(instruction, extent) {
                return Err(format!("{} leaves the kernel's memory", function.dfg.display_inst(instruction)));
            }
        }
    }
    Ok(())
}

/// The instructions that produce, store or pass on a potential address (a 64-bit integer).
fn relevant(function: &Function) -> Vec<Inst> {
    let dfg = &function.dfg;
    let wide = |value: Value| dfg.value_type(value) == types::I64;
    let is_relevant = |instruction: &Inst| match dfg.insts[*instruction] {
        InstructionData::Store { args: [value, _], .. } => wide(value),
        _ => dfg.inst_results(*instruction).iter().any(|v| wide(*v)) || dfg.insts[*instruction].opcode().is_branch(),
    };
    let all = function.layout.blocks().flat_map(|block| function.layout.block_insts(block));
    all.filter(is_relevant).collect()
}

struct Origins<'a> {
    function: &'a Function,
    /// Origins of 64-bit integers; `None`: not reached yet.
    known: SecondaryMap<Value, Option<Origin>>,
    /// Origins of the 64-bit integers stored in the record, by slot and offset.
    kept: BTreeMap<(StackSlot, i64), Origin>,
    /// Whether `kept` holds every pointer, so that anything else is a number.
    is_all_kept: bool,
}

/// The size of an address.
const ADDRESS_BYTES: i64 = 8;
/// Bytes that a called function accesses at an address.
const VECTOR_BYTES: i64 = 16;

impl Origins<'_> {
    fn of(&self, value: Value) -> Option<Origin> {
        self.known[self.function.dfg.resolve_aliases(value)].clone()
    }

    /// Widens the origin of a value; returns whether it changed.
    fn learn(&mut self, value: Value, origin: Option<Origin>) -> bool {
        let Some(origin) = origin else { return false };
        let known = &mut self.known[value];
        let joined = known.as_ref().map_or_else(|| origin.clone(), |known| known.or(&origin));
        let news = known.as_ref() != Some(&joined);
        *known = Some(joined);
        news
    }

    /// Visits the instructions once; returns whether anything changed.
    fn round(&mut self, relevant: &[Inst]) -> bool {
        let function = self.function;
        let mut news = false;
        for instruction in relevant {
            if let [result] = function.dfg.inst_results(*instruction) {
                let origin = self.result(*instruction, *result);
                news |= self.learn(*result, origin);
            }
            news |= self.keep(*instruction);
            let data = &function.dfg.insts[*instruction];
            for call in data.branch_destination(&function.dfg.jump_tables, &function.dfg.exception_tables) {
                let target = call.block(&function.dfg.value_lists);
                let parameters = function.dfg.block_params(target);
                for (parameter, argument) in parameters.iter().zip(call.args(&function.dfg.value_lists)) {
                    if function.dfg.value_type(*parameter) != types::I64 {
                        continue;
                    }
                    let origin = match argument {
                        BlockArg::Value(value) => self.of(value),
                        _ => Some(NUMBER),
                    };
                    news |= self.learn(*parameter, origin);
                }
            }
        }
        news
    }

    fn result(&self, instruction: Inst, result: Value) -> Option<Origin> {
        let dfg = &self.function.dfg;
        let arguments = dfg.inst_args(instruction);
        match &dfg.insts[instruction] {
            InstructionData::UnaryImm { opcode: Opcode::Iconst, imm } => {
                Some(Origin::Number(PossibleNumbers::one(imm.bits())))
            }
            InstructionData::StackAddr { stack_slot, offset, .. } => {
                Some(Origin::at(Base::Record(*stack_slot), i64::from(i32::from(*offset))))
            }
            InstructionData::Binary { opcode: Opcode::Iadd, .. } if dfg.value_type(result) == types::I64 => {
                Some(self.of(arguments[0])?.plus(&self.of(arguments[1])?))
            }
            InstructionData::Binary { opcode: Opcode::Ishl, .. } if dfg.value_type(result) == types::I64 => {
                Some(self.of(arguments[0])?.shifted(&self.of(arguments[1])?))
            }
            InstructionData::Binary { opcode: Opcode::Umin, .. } => {
                let [a, b] = [self.of(arguments[0])?, self.of(arguments[1])?];
                Some(Origin::Number(a.up_to().or_else(|| b.up_to()).unwrap_or(PossibleNumbers::ANY)))
            }
            InstructionData::Ternary { opcode: Opcode::Select, .. } => {
                Some(self.of(arguments[1])?.or(&self.of(arguments[2])?))
            }
            InstructionData::Load { opcode: Opcode::Load, arg, offset, .. } if dfg.value_type(result) == types::I64 => {
                let offset = i64::from(i32::from(*offset));
                match self.of(*arg)? {
                    Origin::At(base, PossibleNumbers(Some(at))) => {
                        at.iter().filter_map(|at| self.loaded(base, at + offset)).reduce(|a, b| a.or(&b))
                    }
                    _ => Some(NUMBER),
                }
            }
            _ => Some(NUMBER),
        }
    }

    /// The origin of the eight bytes at an address; `None`: nothing stored there yet.
    fn loaded(&self, base: Base, at: i64) -> Option<Origin> {
        let pointers = [
            (offset_of!(Args, inputs), Base::Inputs),
            (offset_of!(Args, outputs), Base::Outputs),
            (offset_of!(Args, functions), Base::Functions),
            (offset_of!(Args, planes), Base::Planes),
            (offset_of!(Args, tables), Base::Tables),
            (offset_of!(Args, target), Base::Target),
        ];
        let planes = size_of::<PlaneArgs>() as i64;
        Some(match base {
            Base::Args => pointers
                .iter()
                .find(|(offset, _)| *offset as i64 == at)
                .map_or(NUMBER, |(_, base)| Origin::at(*base, 0)),
            Base::Planes if at.rem_euclid(planes) == offset_of!(PlaneArgs, first) as i64 => Origin::at(Base::Pixels, 0),
            Base::Functions if at % ADDRESS_BYTES == 0 => Origin::Callee,
            Base::Record(slot) => {
                let found = self.overlapping(slot, at, ADDRESS_BYTES);
                let found = found.map(|(from, origin)| if from == at { origin.clone() } else { NUMBER });
                return found.reduce(|a, b| a.or(&b)).or(self.is_all_kept.then_some(NUMBER));
            }
            _ => NUMBER,
        })
    }

    /// The stored origins that overlap a range of the record, with their offsets.
    fn overlapping(&self, slot: StackSlot, at: i64, bytes: i64) -> impl Iterator<Item = (i64, &Origin)> {
        let near = self.kept.range((slot, at - ADDRESS_BYTES + 1)..(slot, at + bytes));
        near.map(|((_, from), origin)| (*from, origin))
    }

    /// Records a store to the record; returns whether anything changed.
    fn keep(&mut self, instruction: Inst) -> bool {
        let dfg = &self.function.dfg;
        let InstructionData::Store { args: [value, address], offset, .. } = dfg.insts[instruction] else {
            return false;
        };
        let (Some(Origin::At(Base::Record(slot), PossibleNumbers(Some(places)))), Some(origin)) =
            (self.of(address), self.of(value))
        else {
            return false;
        };
        if dfg.value_type(value) != types::I64 {
            return false;
        }
        let mut news = false;
        for at in places {
            let place = (slot, at + i64::from(i32::from(offset)));
            let before = self.kept.get(&place);
            let joined = before.map_or_else(|| origin.clone(), |before| before.or(&origin));
            news |= before != Some(&joined);
            self.kept.insert(place, joined);
        }
        news
    }

    /// Whether a call targets the function table, with numbers or addresses of vectors in the record that hold no pointers.
    fn is_call_allowed(&self, arguments: &[Value]) -> bool {
        let Some((callee, given)) = arguments.split_first() else { return false };
        let is_vector = |value: &Value| match self.of(*value) {
            Some(Origin::At(Base::Record(slot), PossibleNumbers(Some(at)))) => at.iter().all(|at| {
                let size = i64::from(self.function.sized_stack_slots[slot].size);
                let free = self.overlapping(slot, *at, VECTOR_BYTES).all(|(_, kept)| matches!(kept, Origin::Number(_)));
                *at >= 0 && at + VECTOR_BYTES <= size && free
            }),
            _ => false,
        };
        let is_wide = |value: &&Value| self.function.dfg.value_type(**value) == types::I64;
        self.of(*callee) == Some(Origin::Callee) && given.iter().filter(is_wide).all(is_vector)
    }

    /// Whether a store writes a 64-bit integer.
    fn is_integer(&self, instruction: Inst) -> bool {
        let dfg = &self.function.dfg;
        matches!(dfg.insts[instruction], InstructionData::Store { args: [value, _], .. } if dfg.value_type(value) == types::I64)
    }

    fn is_allowed(&self, instruction: Inst, extent: Extent) -> bool {
        let dfg = &self.function.dfg;
        let (address, offset, bytes, writes) = match dfg.insts[instruction] {
            InstructionData::Load { opcode, arg, offset, .. } => {
                let bytes = match opcode {
                    Opcode::Uload8 => 1,
                    Opcode::Uload16 => 2,
                    Opcode::Uload16x4 => 8,
                    _ => dfg.value_type(dfg.first_result(instruction)).bytes(),
                };
                (arg, offset, bytes, false)
            }
            InstructionData::Store { args: [value, address], offset, .. } => {
                (address, offset, dfg.value_type(value).bytes(), true)
            }
            InstructionData::CallIndirect { .. } => {
                return self.is_call_allowed(dfg.inst_args(instruction));
            }
            _ => return true,
        };
        let Some(Origin::At(base, at)) = self.of(address) else { return false };
        let (offset, bytes) = (i64::from(i32::from(offset)), i64::from(bytes));
        let starts = || at.0.iter().flatten().map(|at| at + offset);
        let counts = offset_of!(Args, pixels) as i64;
        let is_pointer = |origin: &Origin| !matches!(origin, Origin::Number(_));
        let size = match base {
            // Only a whole 64-bit integer may overwrite a pointer.
            Base::Record(slot)
                if writes
                    && (bytes != ADDRESS_BYTES || !self.is_integer(instruction))
                    && starts().any(|start| self.overlapping(slot, start, bytes).any(|(_, kept)| is_pointer(kept))) =>
            {
                return false;
            }
            Base::Record(slot) => self.function.sized_stack_slots[slot].size as usize,
            Base::Args if writes && starts().any(|start| start < counts) => return false,
            Base::Args => size_of::<Args>(),
            Base::Outputs => extent.outputs,
            Base::Target => return true,
            _ if writes => return false,
            Base::Inputs => extent.inputs,
            Base::Functions => size_of::<Functions>(),
            Base::Planes => extent.planes,
            Base::Pixels | Base::Tables => return true,
        };
        at.0.is_some() && starts().all(|start| start >= 0 && start + bytes <= size as i64)
    }
}
