//! Writes the instructions of each act, on allocated registers.

use std::mem::offset_of;

use iced_x86::{Code, Instruction, MemoryOperand, Register};
use isophote_symbolic::Value;
use smallvec::SmallVec;

use super::allocation::{Allocation, Read};
use super::assembler::{Assembler, Section};
use super::calls;
use super::checker::{Written, WrittenAct, check};
use super::instructions::{self, FmaForm, InMemory};
use super::slots::Slots;
use crate::abi::Args;
use crate::options::VectorWidth;
use crate::vector::{Act, Element, Given, Id, MemoryPlace, Operation, Portion, arg};

/// The mask registers of comparisons and of summed lanes, at 512 bits: comparisons between sums leave the latter, which calls
/// change.
const COMPARED: Register = Register::K1;
const SUMMED: Register = Register::K2;

/// A block of vector operations.
pub(super) struct Vectors {
    pub width: VectorWidth,
    pub acts: Vec<(Act, Option<Value>)>,
    pub givens: Vec<Given>,
    /// Registers (bits) that the block touches only as its residents.
    pub reserved: u32,
}

impl Act {
    /// The vectors that it reads.
    pub fn operands(&self) -> SmallVec<[Id; 4]> {
        match self {
            Act::Compute { operands, .. } => operands.iter().copied().collect(),
            Act::Sum { variable, terms, used, .. } => [*variable].iter().chain(terms).chain(used).copied().collect(),
            Act::Move { operand, .. } | Act::Store { operand, .. } | Act::Truths { operand, .. } => {
                [*operand].into_iter().collect()
            }
            Act::Call { operands, .. } => operands.iter().copied().collect(),
            Act::Gather { cells, bound, .. } => [*cells, *bound].into_iter().collect(),
            Act::Rare { truth, usual, x, .. } => [*truth, *usual, *x].into_iter().collect(),
            Act::Integers(_) => SmallVec::new(),
        }
    }
}

/// Allocates registers for a block and writes its instructions. Builds with debug assertions check the result.
pub(super) fn allocate(block: Vectors, slots: &mut Slots, assembler: &mut Assembler) {
    if cfg!(debug_assertions) {
        let checked = check(&recorded(block, slots, assembler));
        assert!(checked.is_ok(), "a block has the wrong registers: act and fault {checked:?}");
    } else {
        write(block, slots, assembler, None);
    }
}

/// Like [`allocate`]; returns what was written for each act.
pub(super) fn recorded(block: Vectors, slots: &mut Slots, assembler: &mut Assembler) -> Written {
    let (width, givens, reserved, mut acts) = (block.width, block.givens.clone(), block.reserved, Vec::new());
    write(block, slots, assembler, Some(&mut acts));
    Written { width, givens, reserved, acts }
}

fn write(block: Vectors, slots: &mut Slots, assembler: &mut Assembler, mut written: Option<&mut Vec<WrittenAct>>) {
    let Vectors { width, acts, givens, reserved } = block;
    let mut needed = vec![false; givens.len()];
    let mut is_kept = vec![true; acts.len()];
    for (at, (act, _)) in acts.iter().enumerate().rev() {
        is_kept[at] = !matches!(act, Act::Compute { result, .. } if !needed[result.index()]);
        if is_kept[at] {
            act.operands().iter().for_each(|id| needed[id.index()] = true);
        }
    }
    let mut uses = vec![Vec::new(); givens.len()];
    for (at, (act, _)) in acts.iter().enumerate().rev().filter(|(at, _)| is_kept[*at]) {
        act.operands().iter().for_each(|id| uses[id.index()].push(at));
    }
    let mut allocation = Allocation::new(assembler, slots, width, givens, uses, reserved);
    for (at, (act, value)) in acts.into_iter().enumerate().filter(|(at, _)| is_kept[*at]) {
        allocation.assembler.set_source(value);
        let Some(written) = &mut written else {
            allocation.act(at, act);
            continue;
        };
        let starts = [Section::Body, Section::Rare].map(|section| allocation.assembler.items(section).len());
        allocation.act(at, act.clone());
        let [body, rare] = [Section::Body, Section::Rare].map(|section| allocation.assembler.items(section));
        let (body, rare) = (body[starts[0]..].to_vec(), rare[starts[1]..].to_vec());
        written.push(WrittenAct { act, body, rare });
    }
    allocation.assembler.set_source(None);
}

impl Allocation<'_> {
    fn act(&mut self, at: usize, act: Act) {
        let operands = act.operands();
        self.begin(at, &operands);
        match act {
            Act::Compute { operation, element, result, operands } => {
                self.compute(operation, element, result, &operands)
            }
            Act::Move { variable, element, operand } => self.set(variable, element, operand),
            Act::Sum { variable, element, terms, used } => self.sum(variable, element, &terms, used),
            Act::Store { operand, extent, element, memory } => {
                let register = self.fetch(operand, element);
                self.store(register, extent, element, memory);
            }
            Act::Call { element, offset, operands, result } => {
                for (operand, place) in operands.iter().zip(self.slots.arguments(self.width.bytes())) {
                    let register = self.fetch(*operand, element);
                    self.store(register, Portion::Whole, element, place);
                }
                self.release(&operands);
                let live = self.live();
                self.call(offset, operands.len(), live);
                let register = self.take();
                let [place, _] = self.slots.arguments(self.width.bytes());
                self.load(register, place, element);
                self.keep(result, register);
            }
            Act::Gather { cells, bound, offset, result } => self.gather([cells, bound], offset, result),
            Act::Rare { truth, usual, x, offset, result } => self.rare([truth, usual, x], offset, result),
            Act::Truths { operand, element } => {
                let register = self.fetch(operand, element);
                self.truths_to_general(register, element);
            }
            Act::Integers(integers) => self.write(|i| i.integers(&integers)),
        }
        self.release(&operands);
    }

    /// Writes `code to, a, b`, with an optional immediate byte; `masked`: only in the summed lanes.
    fn three(
        &mut self,
        code: Code,
        [to, a]: [Register; 2],
        b: (Read, Portion),
        immediate: Option<u32>,
        masked: Masked,
    ) {
        let mask = move |instruction: Result<Instruction, _>| {
            instruction.map(|mut instruction: Instruction| {
                if masked == Masked::Yes {
                    instruction.set_op_mask(SUMMED);
                }
                instruction
            })
        };
        match b.0 {
            Read::Register(b_register) => {
                let b = self.name(b_register, b.1);
                self.write(|i| {
                    i.add(mask(match immediate {
                        Some(byte) => Instruction::with4(code, to, a, b, byte),
                        None => Instruction::with3(code, to, a, b),
                    }))
                });
            }
            Read::Memory(memory) => self.write(|i| {
                i.add_at(memory, |b: MemoryOperand| {
                    mask(match immediate {
                        Some(byte) => Instruction::with4(code, to, a, b, byte),
                        None => Instruction::with3(code, to, a, b),
                    })
                })
            }),
        }
    }

    fn compute(&mut self, operation: Operation, element: Element, result: Id, operands: &[Id]) {
        let code = operation.code(element, self.width);
        let immediate = operation.immediate(self.width);
        let [to_extent, last_extent] = operation.extents(element);
        match *operands {
            [a] => {
                let fetched = operation.source(element);
                let read = match operation.in_memory() {
                    InMemory::Never => Read::Register(self.fetch(a, fetched)),
                    // The instruction broadcasts by itself.
                    InMemory::Always => Read::Memory(MemoryPlace { is_spread: false, ..self.memory(a) }),
                    InMemory::Any => self.read(a, fetched),
                };
                self.release(operands);
                let register = self.take();
                let to = self.name(register, to_extent);
                match read {
                    Read::Register(from) => {
                        let from = self.name(from, last_extent);
                        self.write(|i| {
                            i.add(match immediate {
                                Some(byte) => Instruction::with3(code, to, from, byte),
                                None => Instruction::with2(code, to, from),
                            })
                        });
                    }
                    Read::Memory(from) => self.write(|i| i.add_at(from, |from| Instruction::with2(code, to, from))),
                }
                self.keep(result, register);
            }
            [mut a, mut b] => {
                if operation.is_commutative() && !self.is_in_register(a) && self.is_in_register(b) {
                    std::mem::swap(&mut a, &mut b);
                }
                let first = self.fetch(a, element);
                let second = match operation.in_memory() {
                    InMemory::Never => Read::Register(self.fetch(b, element)),
                    InMemory::Always => Read::Memory(self.memory(b)),
                    InMemory::Any => self.read(b, element),
                };
                self.release(operands);
                let register = self.take();
                let first = self.name(first, Portion::Whole);
                let is_comparison = matches!(operation, Operation::Compare(_) | Operation::EqualBits);
                if is_comparison && self.width == VectorWidth::Bits512 {
                    self.three(code, [COMPARED, first], (second, last_extent), immediate, Masked::No);
                    let (code, to) = (instructions::truth_of_mask(element), self.name(register, Portion::Whole));
                    self.write(|i| i.add(Instruction::with2(code, to, COMPARED)));
                } else {
                    let to = self.name(register, to_extent);
                    self.three(code, [to, first], (second, last_extent), immediate, Masked::No);
                }
                self.keep(result, register);
            }
            [a, b, c] if operation == Operation::Fma => self.fma(element, result, [a, b, c]),
            [truth, a, b] if self.width == VectorWidth::Bits512 => {
                let [condition, a] = [truth, a].map(|id| self.fetch(id, element));
                let b = self.read(b, element);
                let register = self.changed(truth, condition);
                let [to, a] = [register, a].map(|register| self.name(register, Portion::Whole));
                self.three(code, [to, a], (b, Portion::Whole), immediate, Masked::No);
                self.release(operands);
                self.keep(result, register);
            }
            [truth, a, b] => {
                let [condition, b] = [truth, b].map(|id| self.fetch(id, element));
                let a = self.read(a, element);
                self.release(operands);
                let register = self.take();
                self.blend(element, [register, b], a, condition);
                self.keep(result, register);
            }
            _ => unreachable!("no operation reads more than three vectors"),
        }
    }

    /// `condition ? a : b` at 256 bits.
    fn blend(&mut self, element: Element, [to, b]: [u8; 2], a: Read, condition: u8) {
        let code = Operation::Select.code(element, self.width);
        let [to, b, condition] = [to, b, condition].map(|register| self.name(register, Portion::Whole));
        match a {
            Read::Register(a) => {
                let a = self.name(a, Portion::Whole);
                self.write(|i| i.add(Instruction::with4(code, to, b, a, condition)));
            }
            Read::Memory(a) => self.write(|i| i.add_at(a, |a| Instruction::with4(code, to, b, a, condition))),
        }
    }

    /// A register with `id` that may be overwritten: its own if nothing else reads it, else a copy.
    fn changed(&mut self, id: Id, register: u8) -> u8 {
        if self.is_own(id, register) && self.is_dying(id) {
            return register;
        }
        let copy = self.take();
        self.copy(copy, register);
        copy
    }

    fn fma(&mut self, element: Element, result: Id, [x, y, z]: [Id; 3]) {
        // The result overwrites an operand: one that dies, else one that has to be loaded.
        let order = [z, x, y];
        let dies = |id: &Id| self.is_in_register(*id) && self.is_dying(*id);
        let fetched = |id: &Id| !self.is_in_register(*id);
        let over = order.iter().position(dies).or_else(|| order.iter().position(fetched)).unwrap_or(0);
        let (place, form_of_z) = (order[over], over == 0);
        let [first, second] = match over {
            0 => [x, y],
            1 => [y, z],
            _ => [x, z],
        };
        let [mut a, mut b] = [first, second];
        let mut form = if form_of_z { FmaForm::F231 } else { FmaForm::F213 };
        // The memory operand comes last.
        if !self.is_in_register(a) && self.is_in_register(b) {
            std::mem::swap(&mut a, &mut b);
            form = if form_of_z { FmaForm::F231 } else { FmaForm::F132 };
        }
        let a_register = self.fetch(a, element);
        let b_read = self.read(b, element);
        let register = match self.register_of(place) {
            Some(register) => self.changed(place, register),
            None => {
                let register = self.take();
                self.load(register, self.memory(place), element);
                register
            }
        };
        let [to, a] = [register, a_register].map(|register| self.name(register, Portion::Whole));
        self.three(form.code(element, self.width), [to, a], (b_read, Portion::Whole), None, Masked::No);
        self.release(&order);
        self.keep(result, register);
    }

    /// Sets the register of a variable.
    fn set(&mut self, variable: Id, element: Element, operand: Id) {
        let Some(to) = self.register_of(variable) else { unreachable!("a variable in memory is stored to") };
        match self.register_of(operand) {
            Some(from) => self.copy(to, from),
            None => self.load(to, self.memory(operand), element),
        }
    }

    /// Adds to a variable; at 512 bits, masked instructions skip the lanes that take no part.
    fn sum(&mut self, variable: Id, element: Element, terms: &[Id], used: Option<Id>) {
        let masked = self.mask(used, element);
        let Some(register) = self.register_of(variable) else {
            return self.sum_in_memory(variable, element, terms, masked);
        };
        self.add(self.name(register, Portion::Whole), element, terms, masked);
    }

    /// Moves the summed lanes to the mask register, unless it has them.
    fn mask(&mut self, used: Option<Id>, element: Element) -> Masked {
        let Some(used) = used else { return Masked::No };
        if self.mask_of != Some(used) {
            let register = self.fetch(used, element);
            self.truths_to(SUMMED, register, element);
            self.mask_of = Some(used);
        }
        Masked::Yes
    }

    /// Adds to a register.
    fn add(&mut self, to: Register, element: Element, terms: &[Id], masked: Masked) {
        match *terms {
            [term] => {
                let term = (self.read(term, element), Portion::Whole);
                self.three(Operation::Add.code(element, self.width), [to, to], term, None, masked);
            }
            [mut a, mut b] => {
                if !self.is_in_register(a) {
                    std::mem::swap(&mut a, &mut b);
                }
                let a = self.fetch(a, element);
                let (a, b) = (self.name(a, Portion::Whole), self.read(b, element));
                self.three(FmaForm::F231.code(element, self.width), [to, a], (b, Portion::Whole), None, masked);
            }
            _ => unreachable!("a sum adds a term or a product"),
        }
    }

    /// A sum without a register, as a memory operand of the addition if that saves a load.
    fn sum_in_memory(&mut self, variable: Id, element: Element, terms: &[Id], masked: Masked) {
        let memory = self.memory(variable);
        let in_memory = (Read::Memory(memory), Portion::Whole);
        let dies = |id: &Id| self.register_of(*id).filter(|register| self.is_dying(*id) && self.is_own(*id, *register));
        // The register of a dying factor takes the sum.
        let room = match *terms {
            [a, b] if masked == Masked::No => dies(&a).map(|sum| (sum, b)).or(dies(&b).map(|sum| (sum, a))),
            _ => None,
        };
        let sum = match (terms, room) {
            (&[term], _) if masked == Masked::No => {
                let term = self.fetch(term, element);
                let sum = self.take_temporary();
                let [to, term] = [sum, term].map(|register| self.name(register, Portion::Whole));
                self.three(Operation::Add.code(element, self.width), [to, term], in_memory, None, Masked::No);
                sum
            }
            (_, Some((sum, other))) => {
                let other = self.fetch(other, element);
                let [to, other] = [sum, other].map(|register| self.name(register, Portion::Whole));
                self.three(FmaForm::F213.code(element, self.width), [to, other], in_memory, None, Masked::No);
                sum
            }
            _ => {
                let sum = self.take_temporary();
                self.load(sum, memory, element);
                self.add(self.name(sum, Portion::Whole), element, terms, masked);
                sum
            }
        };
        self.store(sum, Portion::Whole, element, memory);
    }

    fn truths_to(&mut self, to: Register, register: u8, element: Element) {
        let (code, from) = (instructions::truths(element, self.width), self.name(register, Portion::Whole));
        self.write(|i| i.add(Instruction::with2(code, to, from)));
    }

    fn truths_to_general(&mut self, register: u8, element: Element) {
        if self.width != VectorWidth::Bits512 {
            return self.truths_to(Register::EAX, register, element);
        }
        self.truths_to(COMPARED, register, element);
        self.write(|i| i.add(Instruction::with2(Code::VEX_Kmovw_r32_kr, Register::EAX, COMPARED)));
    }

    fn rare(&mut self, [truth, usual, x]: [Id; 3], offset: i32, result: Id) {
        let element = Element::Double;
        let [condition, value, argument] = [truth, usual, x].map(|id| self.fetch(id, element));
        let register = if usual == x || usual == truth { self.copied(value) } else { self.changed(usual, value) };
        self.truths_to_general(condition, element);
        let [rare, after] = [self.assembler.new_label(), self.assembler.new_label()];
        self.write(|i| {
            i.add(Instruction::with2(Code::Test_rm32_r32, Register::EAX, Register::EAX));
            i.jump(Code::Jne_rel32_64, rare);
            i.label(after);
        });
        let before = self.assembler.switch_to(Section::Rare);
        self.write(|i| i.label(rare));
        let [place, _] = self.slots.arguments(self.width.bytes());
        self.store(argument, Portion::Whole, element, place);
        let live = self.taken();
        self.call(offset, 1, live);
        if self.width == VectorWidth::Bits512 {
            self.truths_to(COMPARED, condition, element);
            let (code, to) = (Operation::Load.code(element, self.width), self.name(register, Portion::Whole));
            self.write(|i| {
                i.add_at(place, |place| {
                    Instruction::with2(code, to, place).map(|mut instruction| {
                        instruction.set_op_mask(COMPARED);
                        instruction
                    })
                })
            });
        } else {
            self.blend(element, [register, register], Read::Memory(place), condition);
        }
        self.write(|i| i.jump(Code::Jmp_rel32_64, after));
        self.assembler.switch_to(before);
        self.release(&[truth, usual, x]);
        self.keep(result, register);
    }

    /// Gathers the number `offset` bytes after the start of each lane's cell.
    fn gather(&mut self, [cells, bound]: [Id; 2], offset: i32, result: Id) {
        let (element, width) = (Element::Double, self.width);
        let from = self.fetch(cells, element);
        let [to, index, all] = [self.take(), self.take_temporary(), self.take_temporary()];
        let [to_name, index, all, from] = [to, index, all, from].map(|register| self.name(register, Portion::Whole));
        let all = if width == VectorWidth::Bits512 { COMPARED } else { all };
        let bound = self.memory(bound);
        let scale = size_of::<f64>() as u32;
        let table = MemoryOperand::new(Register::RAX, index, scale, offset.into(), 1, false, Register::None);
        self.write(|i| {
            i.mov(Register::RAX, arg(offset_of!(Args, tables)));
            // Equal to itself: every lane.
            i.add(Instruction::with3(Operation::EqualBits.code(element, width), all, from, from));
            let least = Operation::Least.code(element, width);
            i.add_at(bound, |bound| Instruction::with3(least, index, from, bound));
            let gather = instructions::gather(width);
            i.add(match width {
                VectorWidth::Bits512 => Instruction::with2(gather, to_name, table).map(|mut instruction| {
                    instruction.set_op_mask(all);
                    instruction
                }),
                _ => Instruction::with3(gather, to_name, table, all),
            });
        });
        self.keep(result, to);
    }

    /// Calls a function; live registers survive, the mask does not.
    fn call(&mut self, offset: i32, operands: usize, live: u32) {
        self.mask_of = None;
        calls::call(self, offset, operands, live);
    }

    fn copied(&mut self, register: u8) -> u8 {
        let copy = self.take();
        self.copy(copy, register);
        copy
    }
}

/// The lanes that an instruction changes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Masked {
    No,
    /// Those of the mask register.
    Yes,
}
