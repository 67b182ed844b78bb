//! Where every address comes from: checked on the compiler's own form, before it becomes machine code.
//!
//! What comes in: a function that takes the address of [`Args`], and how long the lists behind it are. What goes out:
//! nothing, or the first instruction whose address is none of these:
//! ```text
//! record          its stack slot, inside the slot's size          read and written
//! Args            the argument block, inside its size             read; the counts are written
//! ├─ inputs       inside the list                                 read
//! ├─ outputs      inside the list                                 read and written
//! ├─ functions    inside the table; what is read there is called  read
//! ├─ planes       inside the list of planes                       read
//! │  └─ pixels    any distance from the plane's first pixel       read
//! └─ target       any distance from the first pixel               read and written
//! ```
//! That pixels' distances stay inside the window is the lowering's proof; here it is certain that nothing else is touched.

use std::collections::BTreeMap;
use std::mem::offset_of;

use cranelift_codegen::entity::SecondaryMap;
use cranelift_codegen::ir::{BlockArg, Function, Inst, InstructionData, Opcode, StackSlot, Value, types};
use isophote_symbolic::{Program, Sink};
use smallvec::SmallVec;

use crate::abi::{Args, Functions, PlaneArgs};

/// How long the lists are that the argument block points to, in bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    pub inputs: usize,
    pub outputs: usize,
    pub planes: usize,
}

impl Extent {
    pub fn of(program: &Program) -> Extent {
        let outputs = match program.sink() {
            Sink::Sums { outputs, .. } => outputs.len(),
            Sink::Plane(_) => 0,
        };
        Extent {
            inputs: size_of::<f64>() * program.inputs().len(),
            outputs: size_of::<f64>() * outputs,
            planes: size_of::<PlaneArgs>() * program.channels(),
        }
    }
}

/// A place that an address may come from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Base {
    Record(StackSlot),
    Args,
    Inputs,
    Outputs,
    Functions,
    Planes,
    /// Of a raw plane; without a known distance.
    Pixels,
    /// Of the output plane; without a known distance.
    Target,
}

/// The numbers that a value may be; `None`: any. Few at a time: rows use two areas of the record by turns.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Numbers(Option<SmallVec<[i64; NUMBERS_MAX]>>);

/// More numbers than these are taken for any.
const NUMBERS_MAX: usize = 8;

impl Numbers {
    const ANY: Numbers = Numbers(None);

    fn one(number: i64) -> Numbers {
        Numbers(Some(SmallVec::from_slice(&[number])))
    }

    fn of(numbers: impl Iterator<Item = Option<i64>>) -> Numbers {
        let mut all = SmallVec::new();
        for number in numbers {
            let Some(number) = number else { return Numbers::ANY };
            if !all.contains(&number) {
                if all.len() == NUMBERS_MAX {
                    return Numbers::ANY;
                }
                all.push(number);
            }
        }
        all.sort_unstable();
        Numbers(Some(all))
    }

    fn or(&self, other: &Numbers) -> Numbers {
        match (&self.0, &other.0) {
            (Some(a), Some(b)) => Numbers::of(a.iter().chain(b).copied().map(Some)),
            _ => Numbers::ANY,
        }
    }

    /// What an operation makes of each pair; `None` from it: any number.
    fn with(&self, other: &Numbers, operation: impl Fn(i64, i64) -> Option<i64>) -> Numbers {
        match (&self.0, &other.0) {
            (Some(a), Some(b)) => Numbers::of(a.iter().flat_map(|a| b.iter().map(|b| operation(*a, *b)))),
            _ => Numbers::ANY,
        }
    }
}

/// What a value is.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Origin {
    /// No address.
    Number(Numbers),
    /// So many bytes behind a base. Distances that are not known are those of pixels.
    At(Base, Numbers),
    /// From the table of functions.
    Callee,
}

const NUMBER: Origin = Origin::Number(Numbers::ANY);

impl Origin {
    fn at(base: Base, distance: i64) -> Origin {
        Origin::At(base, Numbers::one(distance))
    }

    /// A distance that nobody knows is allowed among pixels only.
    fn behind(base: Base, distance: Numbers) -> Origin {
        match (base, distance) {
            (Base::Pixels | Base::Target, _) => Origin::At(base, Numbers::ANY),
            (_, Numbers::ANY) => NUMBER,
            (base, distance) => Origin::At(base, distance),
        }
    }

    /// What a value is that may be either.
    fn or(&self, other: &Origin) -> Origin {
        match (self, other) {
            (Origin::Number(a), Origin::Number(b)) => Origin::Number(a.or(b)),
            (Origin::At(base, a), Origin::At(other, b)) if base == other => Origin::behind(*base, a.or(b)),
            (Origin::Callee, Origin::Callee) => Origin::Callee,
            _ => NUMBER,
        }
    }

    fn plus(&self, other: &Origin) -> Origin {
        match (self, other) {
            (Origin::Number(a), Origin::Number(b)) => Origin::Number(a.with(b, i64::checked_add)),
            (Origin::At(base, at), Origin::Number(n)) | (Origin::Number(n), Origin::At(base, at)) => {
                Origin::behind(*base, at.with(n, i64::checked_add))
            }
            _ => NUMBER,
        }
    }

    fn shifted(&self, bits: &Origin) -> Origin {
        let shift =
            |n: i64, bits: i64| u32::try_from(bits).ok().and_then(|bits| n.checked_mul(1_i64.checked_shl(bits)?));
        match (self, bits) {
            (Origin::Number(a), Origin::Number(bits)) => Origin::Number(a.with(bits, shift)),
            _ => NUMBER,
        }
    }
}

/// Checks a function before compilation; says which instruction goes astray.
pub(crate) fn addresses(function: &Function, extent: Extent) -> Result<(), String> {
    let mut origins = Origins { function, known: SecondaryMap::new(), kept: BTreeMap::new(), is_all_kept: false };
    if let Some(entry) = function.layout.entry_block() {
        let parameters = function.dfg.block_params(entry).iter();
        parameters.for_each(|value| origins.known[*value] = Some(Origin::at(Base::Args, 0)));
    }
    // What is known of a value only grows, from nothing over a few numbers to any: the rounds end. Pointers are found
    // first; then what was read where none was kept is a number.
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

/// The instructions that make, keep or hand on what may be an address: 64-bit integers.
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
    /// Of 64-bit integers; `None`: not reached yet.
    known: SecondaryMap<Value, Option<Origin>>,
    /// What 64-bit integers are stored in the record, by slot and offset.
    kept: BTreeMap<(StackSlot, i64), Origin>,
    /// Whether `kept` has every pointer, so that anything else is a number.
    is_all_kept: bool,
}

/// The size of an address.
const ADDRESS_BYTES: i64 = 8;

impl Origins<'_> {
    fn of(&self, value: Value) -> Option<Origin> {
        self.known[self.function.dfg.resolve_aliases(value)].clone()
    }

    /// Adds to what is known of a value; true when that is news.
    fn learn(&mut self, value: Value, origin: Option<Origin>) -> bool {
        let Some(origin) = origin else { return false };
        let known = &mut self.known[value];
        let joined = known.as_ref().map_or_else(|| origin.clone(), |known| known.or(&origin));
        let news = known.as_ref() != Some(&joined);
        *known = Some(joined);
        news
    }

    /// Walks over the function once; true when something new came out.
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
            InstructionData::UnaryImm { opcode: Opcode::Iconst, imm } => Some(Origin::Number(Numbers::one(imm.bits()))),
            InstructionData::StackAddr { stack_slot, offset, .. } => {
                Some(Origin::at(Base::Record(*stack_slot), i64::from(i32::from(*offset))))
            }
            InstructionData::Binary { opcode: Opcode::Iadd, .. } if dfg.value_type(result) == types::I64 => {
                Some(self.of(arguments[0])?.plus(&self.of(arguments[1])?))
            }
            InstructionData::Binary { opcode: Opcode::Ishl, .. } if dfg.value_type(result) == types::I64 => {
                Some(self.of(arguments[0])?.shifted(&self.of(arguments[1])?))
            }
            InstructionData::Ternary { opcode: Opcode::Select, .. } => {
                Some(self.of(arguments[1])?.or(&self.of(arguments[2])?))
            }
            InstructionData::Load { opcode: Opcode::Load, arg, offset, .. } if dfg.value_type(result) == types::I64 => {
                let offset = i64::from(i32::from(*offset));
                match self.of(*arg)? {
                    Origin::At(base, Numbers(Some(at))) => {
                        at.iter().filter_map(|at| self.loaded(base, at + offset)).reduce(|a, b| a.or(&b))
                    }
                    _ => Some(NUMBER),
                }
            }
            _ => Some(NUMBER),
        }
    }

    /// What eight bytes at a place are; `None`: nothing has been stored there yet.
    fn loaded(&self, base: Base, at: i64) -> Option<Origin> {
        let pointers = [
            (offset_of!(Args, inputs), Base::Inputs),
            (offset_of!(Args, outputs), Base::Outputs),
            (offset_of!(Args, functions), Base::Functions),
            (offset_of!(Args, planes), Base::Planes),
            (offset_of!(Args, target), Base::Target),
        ];
        let planes = size_of::<PlaneArgs>() as i64;
        Some(match base {
            Base::Args => pointers
                .iter()
                .find(|(offset, _)| *offset as i64 == at)
                .map_or(NUMBER, |(_, base)| Origin::at(*base, 0)),
            Base::Planes if at.rem_euclid(planes) == offset_of!(PlaneArgs, first) as i64 => Origin::at(Base::Pixels, 0),
            Base::Functions => Origin::Callee,
            Base::Record(slot) => {
                let found = self.overlapping(slot, at, ADDRESS_BYTES);
                let found = found.map(|(from, origin)| if from == at { origin.clone() } else { NUMBER });
                return found.reduce(|a, b| a.or(&b)).or(self.is_all_kept.then_some(NUMBER));
            }
            _ => NUMBER,
        })
    }

    /// What is kept somewhere in so many bytes of the record, with its offset.
    fn overlapping(&self, slot: StackSlot, at: i64, bytes: i64) -> impl Iterator<Item = (i64, &Origin)> {
        let near = self.kept.range((slot, at - ADDRESS_BYTES + 1)..(slot, at + bytes));
        near.map(|((_, from), origin)| (*from, origin))
    }

    /// Notes what a store leaves in the record; true when that is news.
    fn keep(&mut self, instruction: Inst) -> bool {
        let dfg = &self.function.dfg;
        let InstructionData::Store { args: [value, address], offset, .. } = dfg.insts[instruction] else {
            return false;
        };
        let (Some(Origin::At(Base::Record(slot), Numbers(Some(places)))), Some(origin)) =
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
                return dfg
                    .inst_args(instruction)
                    .first()
                    .is_some_and(|callee| self.of(*callee) == Some(Origin::Callee));
            }
            _ => return true,
        };
        let Some(Origin::At(base, at)) = self.of(address) else { return false };
        let (offset, bytes) = (i64::from(i32::from(offset)), i64::from(bytes));
        let starts = || at.0.iter().flatten().map(|at| at + offset);
        let counts = offset_of!(Args, pixels) as i64;
        let is_pointer = |origin: &Origin| !matches!(origin, Origin::Number(_));
        let size = match base {
            // Nothing but an address may be written over a part of one.
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
            Base::Pixels => return true,
        };
        at.0.is_some() && starts().all(|start| start >= 0 && start + bytes <= size as i64)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::host::{self, Allocator, Processor};
    use cranelift_codegen::ir::{AbiParam, InstBuilder, MemFlagsData, StackSlotData, StackSlotKind};
    use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext};

    const FLAGS: MemFlagsData = MemFlagsData::trusted();

    /// A function of one argument with a record of 32 bytes; `body` gets both addresses.
    fn verdict(body: impl FnOnce(&mut FunctionBuilder<'_>, Value, Value)) -> Result<(), String> {
        let mut function = Function::new();
        function.signature.params.push(AbiParam::new(types::I64));
        let mut context = FunctionBuilderContext::new();
        let mut builder = FunctionBuilder::new(&mut function, &mut context);
        let slot = builder.create_sized_stack_slot(StackSlotData::new(StackSlotKind::ExplicitSlot, 32, 4));
        let block = builder.create_block();
        builder.append_block_params_for_function_params(block);
        builder.switch_to_block(block);
        let args = builder.block_params(block)[0];
        let record = builder.ins().stack_addr(types::I64, slot, 0);
        body(&mut builder, args, record);
        builder.ins().return_(&[]);
        builder.seal_all_blocks();
        let isa = host::isa(Processor::Host, Allocator::Backtracking).unwrap();
        builder.finalize(isa.frontend_config());
        addresses(&function, Extent { inputs: 24, outputs: 16, planes: size_of::<PlaneArgs>() })
    }

    fn pointer(b: &mut FunctionBuilder<'_>, args: Value, field: usize) -> Value {
        b.ins().load(types::I64, FLAGS, args, field as i32)
    }

    #[test]
    fn what_kernels_do_passes() {
        let end = verdict(|b, args, record| {
            let inputs = pointer(b, args, offset_of!(Args, inputs));
            let number = b.ins().load(types::F64, FLAGS, inputs, 16);
            b.ins().store(FLAGS, number, record, 24);
            let planes = pointer(b, args, offset_of!(Args, planes));
            let first = b.ins().load(types::I64, FLAGS, planes, 0);
            // A running address, through the record and around a loop.
            b.ins().store(FLAGS, first, record, 0);
            let first = b.ins().load(types::I64, FLAGS, record, 0);
            let body = b.create_block();
            let after = b.create_block();
            let at = b.append_block_param(body, types::I64);
            b.ins().jump(body, &[first.into()]);
            b.switch_to_block(body);
            let pixel = b.ins().load(types::I32, FLAGS, at, 0);
            let next = b.ins().iadd_imm_s(at, 4);
            b.ins().brif(pixel, body, &[next.into()], after, &[]);
            b.switch_to_block(after);
            let outputs = pointer(b, args, offset_of!(Args, outputs));
            b.ins().store(FLAGS, number, outputs, 8);
            let count = b.ins().iconst(types::I64, 1);
            b.ins().store(FLAGS, count, args, offset_of!(Args, saturated) as i32);
        });
        assert_eq!(end, Ok(()));
    }

    #[test]
    fn planted_addresses_are_refused() {
        type Plant = fn(&mut FunctionBuilder<'_>, Value, Value);
        let plants: [(&str, Plant); 12] = [
            ("a constant address", |b, _, _| {
                let address = b.ins().iconst(types::I64, 4096);
                b.ins().load(types::F64, FLAGS, address, 0);
            }),
            ("beyond the record", |b, _, record| {
                b.ins().load(types::F64X2, FLAGS, record, 24);
            }),
            ("before the record", |b, _, record| {
                b.ins().load(types::F64, FLAGS, record, -8);
            }),
            ("beyond the argument block", |b, args, _| {
                b.ins().load(types::I64, FLAGS, args, size_of::<Args>() as i32 - 4);
            }),
            ("beyond the inputs", |b, args, _| {
                let inputs = pointer(b, args, offset_of!(Args, inputs));
                b.ins().load(types::F64, FLAGS, inputs, 24);
            }),
            ("beyond the outputs", |b, args, _| {
                let outputs = pointer(b, args, offset_of!(Args, outputs));
                let number = b.ins().f64const(0.0);
                b.ins().store(FLAGS, number, outputs, 16);
            }),
            ("a pointer overwritten", |b, args, _| {
                b.ins().store(FLAGS, args, args, offset_of!(Args, inputs) as i32);
            }),
            ("a raw pixel overwritten", |b, args, _| {
                let planes = pointer(b, args, offset_of!(Args, planes));
                let first = b.ins().load(types::I64, FLAGS, planes, 0);
                b.ins().store(FLAGS, args, first, 0);
            }),
            ("a number as an address", |b, args, _| {
                let width = pointer(b, args, offset_of!(Args, width));
                b.ins().load(types::F64, FLAGS, width, 0);
            }),
            ("half of a pointer overwritten", |b, args, record| {
                let inputs = pointer(b, args, offset_of!(Args, inputs));
                b.ins().store(FLAGS, inputs, record, 8);
                let number = b.ins().f64const(0.0);
                b.ins().store(FLAGS, number, record, 12);
                let inputs = b.ins().load(types::I64, FLAGS, record, 8);
                b.ins().load(types::F64, FLAGS, inputs, 0);
            }),
            ("a pointer that may be another", |b, args, record| {
                let either = b.ins().select(args, args, record);
                b.ins().load(types::F64, FLAGS, either, 0);
            }),
            ("a call of a pixel", |b, args, _| {
                let planes = pointer(b, args, offset_of!(Args, planes));
                let first = b.ins().load(types::I64, FLAGS, planes, 0);
                let convention = cranelift_codegen::isa::CallConv::SystemV;
                let signature = b.import_signature(cranelift_codegen::ir::Signature::new(convention));
                b.ins().call_indirect(signature, first, &[]);
            }),
        ];
        for (what, plant) in plants {
            let end = verdict(plant);
            assert!(end.as_ref().is_err_and(|error| error.contains("leaves the kernel's memory")), "{what}: {end:?}");
        }
    }
}
