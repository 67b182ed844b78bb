//! Each act of a block as instructions, on registers that it asks for.

use iced_x86::{Code, Instruction, MemoryOperand, Register};
use smallvec::SmallVec;

use super::allocation::{Allocation, Read};
use super::assembler::{MemoryPlace, Section};
use super::block::{Act, AddedTerm, Block, Id};
use super::calls;
use super::frame::StackFrame;
use super::operation::{self, Element, FmaForm, InMemory, Operation, Portion};
use crate::options::VectorWidth;

/// The mask register of a comparison, and those that say which lanes are summed.
pub(super) const COMPARED: Register = Register::K1;
const SUMMED: [Register; 2] = [Register::K2, Register::K3];

/// Writes the instructions of a block; those registers that are bits of `reserved` are not touched but through what the block
/// was told of them.
pub(super) fn allocate(block: Block<'_>, frame: &mut StackFrame, reserved: u32) {
    let Block { assembler, width, acts, givens, .. } = block;
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
    let mut allocation = Allocation::new(assembler, frame, width, givens, uses, reserved);
    for (at, (act, value)) in acts.into_iter().enumerate().filter(|(at, _)| is_kept[*at]) {
        allocation.assembler.speak_for(value);
        allocation.act(at, act);
    }
    allocation.assembler.speak_for(None);
}

impl Allocation<'_> {
    fn act(&mut self, at: usize, act: Act) {
        let operands = act.operands();
        self.begin(at, &operands);
        match act {
            Act::Compute { operation, element, result, operands } => {
                self.compute(operation, element, result, &operands)
            }
            Act::Sum { variable, element, addends } => self.sum(variable, element, &addends),
            Act::Store { operand, extent, element, memory } => {
                let register = self.fetch(operand, element);
                self.store(register, extent, element, memory);
            }
            Act::Call { element, offset, operands, result } => {
                for (operand, place) in operands.iter().zip(self.frame.arguments(self.width.bytes())) {
                    let register = self.fetch(*operand, element);
                    self.store(register, Portion::Whole, element, place);
                }
                self.release(&operands);
                let live = self.live();
                self.call(offset, operands.len(), live);
                let register = self.take();
                let [place, _] = self.frame.arguments(self.width.bytes());
                self.load(register, place, element);
                self.keep(result, register);
            }
            Act::Gather { cells, bound, offset, result } => self.gather([cells, bound], offset, result),
            Act::Rare { truth, usual, x, offset, result } => self.rare([truth, usual, x], offset, result),
            Act::Truths { operand, element } => {
                let register = self.fetch(operand, element);
                self.truths_to_general(register, element);
            }
            Act::Mask { operand, element, number } => {
                let register = self.fetch(operand, element);
                self.truths_to(SUMMED[number as usize], register, element);
                self.has_mask[number as usize] = true;
            }
            Act::Scalar(instructions) => self.assembler.append(instructions),
        }
        self.release(&operands);
    }

    /// `code to, a, b`, with a byte behind it or not; `masked`: in the lanes that are summed.
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
                if let Masked::By(mask) = masked {
                    instruction.set_op_mask(mask);
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
                // Integers in memory are of 32 bits whatever becomes of them.
                let fetched = if operation == Operation::FromIntegers { Element::Single } else { element };
                let read = match operation.in_memory() {
                    InMemory::Never => Read::Register(self.fetch(a, fetched)),
                    // The instruction itself spreads.
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
                    let (code, to) = (operation::truth_of_mask(element), self.name(register, Portion::Whole));
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

    /// At 256 bits: `condition ? a : b`.
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

    /// A register that holds `id` and may be written over: its own where nothing else reads it.
    fn changed(&mut self, id: Id, register: u8) -> u8 {
        if self.is_own(id, register) && self.is_dying(id) {
            return register;
        }
        let copy = self.take();
        self.copy(copy, register);
        copy
    }

    fn fma(&mut self, element: Element, result: Id, [x, y, z]: [Id; 3]) {
        // The result takes the place of an operand: of one that is not needed any more, else of one that has to be fetched.
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
        // What is in memory comes last.
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

    /// At 512 bits an instruction leaves out the lanes that take no part by itself.
    fn sum(&mut self, variable: Id, element: Element, addends: &[AddedTerm]) {
        let Some(register) = self.register_of(variable) else {
            return self.sum_in_memory(variable, element, addends);
        };
        let to = self.name(register, Portion::Whole);
        addends.iter().for_each(|addend| self.add(to, addend, element));
    }

    /// to += an addend
    fn add(&mut self, to: Register, addend: &AddedTerm, element: Element) {
        let masked = addend.only.map_or(Masked::No, |number| Masked::By(SUMMED[number as usize]));
        match *addend.terms {
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
            _ => unreachable!("an addend is a term or a product"),
        }
    }

    /// A sum that has no register; an operand of the first addition where that saves its load.
    fn sum_in_memory(&mut self, variable: Id, element: Element, addends: &[AddedTerm]) {
        let memory = self.memory(variable);
        let in_memory = (Read::Memory(memory), Portion::Whole);
        let dies = |id: &Id| self.register_of(*id).filter(|register| self.is_dying(*id) && self.is_own(*id, *register));
        let Some((first, others)) = addends.split_first() else { return };
        // A factor that nobody needs any more makes room for the sum.
        let room = match *first.terms {
            [a, b] if first.only.is_none() && others.is_empty() => {
                dies(&a).map(|sum| (sum, b)).or(dies(&b).map(|sum| (sum, a)))
            }
            _ => None,
        };
        let (sum, others) = match (&first.terms[..], room) {
            (&[term], _) if first.only.is_none() => {
                let term = self.fetch(term, element);
                let sum = self.take_temporary();
                let [to, term] = [sum, term].map(|register| self.name(register, Portion::Whole));
                self.three(Operation::Add.code(element, self.width), [to, term], in_memory, None, Masked::No);
                (sum, others)
            }
            (_, Some((sum, other))) => {
                let other = self.fetch(other, element);
                let [to, other] = [sum, other].map(|register| self.name(register, Portion::Whole));
                self.three(FmaForm::F213.code(element, self.width), [to, other], in_memory, None, Masked::No);
                (sum, others)
            }
            _ => {
                let sum = self.take_temporary();
                self.load(sum, memory, element);
                (sum, addends)
            }
        };
        let to = self.name(sum, Portion::Whole);
        others.iter().for_each(|addend| self.add(to, addend, element));
        self.store(sum, Portion::Whole, element, memory);
    }

    fn truths_to(&mut self, to: Register, register: u8, element: Element) {
        let (code, from) = (operation::truths(element, self.width), self.name(register, Portion::Whole));
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
        let [place, _] = self.frame.arguments(self.width.bytes());
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

    /// Calls a function; besides the registers that are live, masks survive.
    fn call(&mut self, offset: i32, operands: usize, live: u32) {
        let masks = SUMMED.into_iter().zip(self.has_mask).filter(|(_, is_set)| *is_set);
        let masks: SmallVec<[_; 2]> = masks.map(|(mask, _)| mask).zip(self.frame.masks()).collect();
        for (mask, saved) in &masks {
            self.write(|i| {
                i.add(Instruction::with2(Code::VEX_Kmovw_r32_kr, Register::EAX, *mask));
                i.store_low(*saved, Register::EAX);
            });
        }
        calls::call(self, offset, operands, live);
        for (mask, saved) in &masks {
            self.write(|i| {
                i.add_at(*saved, |saved| Instruction::with2(Code::Mov_r32_rm32, Register::EAX, saved));
                i.add(Instruction::with2(Code::VEX_Kmovw_kr_r32, *mask, Register::EAX));
            });
        }
    }

    fn copied(&mut self, register: u8) -> u8 {
        let copy = self.take();
        self.copy(copy, register);
        copy
    }
}

/// Which lanes an instruction changes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Masked {
    No,
    By(Register),
}
