//! Checks the register allocation of a block: do its instructions compute what its acts mean?
//!
//! Acts and instructions are executed side by side, on symbols in place of numbers. The meaning of an act follows from the block
//! alone: an operand is the symbol of its value, wherever that is. An instruction reads the symbols of its registers and of its
//! memory, whatever the allocation wanted there. Where both give the same operation on the same symbols, they give the same
//! symbol. What a block leaves must agree:
//! - memory that it stores to, and the variables in memory, after every act and at the end;
//! - reserved registers at the end, and wherever control leaves the block: variables have their new values, all others are
//!   untouched;
//! - the lanes that a general register receives, and the functions called, with their operands;
//! - instructions on general registers, which must be those of the act.
//!
//! A value that never reaches one of these has no effect. Spill slots are assumed to be apart from all other memory, unless both
//! have the same base and index; [`crate::verify`] proves which memory code touches.

use std::collections::BTreeMap;
use std::mem::offset_of;
use std::sync::LazyLock;

use iced_x86::{Code, Instruction, Mnemonic, OpKind, Register};
use smallvec::{SmallVec, smallvec};

use super::assembler::{Instructions, Item, Reference};
use super::calls::CALL_BYTES;
use super::instructions::{self, FmaForm, InMemory};
use super::integers::register;
use crate::abi::Args;
use crate::options::VectorWidth;
use crate::vector::{Act, Anchor, Element, Given, Id, Integers, MemoryPlace, Operation, Portion, arg};

/// A block with the instructions that were written for it.
pub(super) struct Written {
    pub width: VectorWidth,
    pub givens: Vec<Given>,
    /// Registers that outlive the block, as bits.
    pub reserved: u32,
    pub acts: Vec<WrittenAct>,
}

/// An act with its instructions: in place, and out of line.
pub(super) struct WrittenAct {
    pub act: Act,
    pub body: Vec<Item>,
    pub rare: Vec<Item>,
}

/// A difference between an act and its instructions.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Fault {
    /// A register that outlives the block has another value than it should.
    Register(u8),
    /// Memory has another value than was stored.
    Memory,
    /// eax has the truth of other lanes.
    Truths,
    /// Instructions on general registers differ.
    Integers,
    /// A call passes other memory than its operands, or control flow has another form.
    Call,
    /// A gather uses a register twice.
    Gather,
    /// An instruction that the allocation never writes.
    Unexpected(Code),
}

/// Checks a block; the error is the first act with a fault.
pub(super) fn check(written: &Written) -> Result<(), (usize, Fault)> {
    let mut checker = Checker::new(written);
    for (at, act) in written.acts.iter().enumerate() {
        checker.act(at, act).map_err(|fault| (at, fault))?;
    }
    checker.settled().map_err(|fault| (written.acts.len(), fault))
}

/// Equal symbols stand for equal values.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Symbol(u32);

/// An address: base plus scaled index plus offset.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Address {
    base: Symbol,
    index: Option<Symbol>,
    scale: u32,
    offset: i32,
}

/// What a symbol stands for.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
enum Term {
    /// The initial value of a vector register, or of a general register.
    Vector(usize),
    General(usize),
    /// The address of the constants.
    Pool,
    /// Memory that the block did not write, after a number of changes of memory.
    Unwritten(Address, usize),
    /// The address itself.
    Address(Address),
    /// The first element, of so many bytes, in all lanes.
    Spread(usize, Symbol),
    /// The truth of each lane, of so many bytes.
    Truths(usize, Symbol),
    /// An instruction's result, with its immediate byte.
    Result(Code, u8, SmallVec<[Symbol; 3]>),
    /// `mask ? new : old`.
    Masked([Symbol; 3]),
    /// A function's result.
    Called(Symbol, SmallVec<[Symbol; 3]>),
    /// A general register after an instruction of the block.
    Integers([usize; 2]),
    /// Equal to nothing else.
    Unknown(usize),
}

#[derive(Default)]
struct Terms {
    symbols: BTreeMap<Term, Symbol>,
    /// By symbol.
    terms: Vec<Term>,
}

impl Terms {
    fn of(&mut self, term: Term) -> Symbol {
        if let Some(symbol) = self.symbols.get(&term) {
            return *symbol;
        }
        let symbol = Symbol(self.terms.len() as u32);
        self.terms.push(term.clone());
        self.symbols.insert(term, symbol);
        symbol
    }

    fn unknown(&mut self) -> Symbol {
        self.of(Term::Unknown(self.terms.len()))
    }

    fn term(&self, symbol: Symbol) -> &Term {
        &self.terms[symbol.0 as usize]
    }
}

/// Registers and memory. The memory has the bytes of each symbol.
#[derive(Clone)]
struct State {
    vectors: [Symbol; 32],
    general: [Symbol; 16],
    masks: [Symbol; 8],
    memory: BTreeMap<Address, (usize, Symbol)>,
}

impl State {
    fn write(&mut self, address: Address, bytes: usize, symbol: Symbol) {
        self.forget(address, bytes);
        self.memory.insert(address, (bytes, symbol));
    }

    /// Removes what a write of so many bytes overlaps.
    fn forget(&mut self, address: Address, bytes: usize) {
        self.memory.retain(|other, (size, _)| {
            let is_apart =
                address.offset + bytes as i32 <= other.offset || other.offset + *size as i32 <= address.offset;
            Address { offset: 0, ..*other } != Address { offset: 0, ..address } || is_apart
        });
    }
}

struct Checker<'w> {
    written: &'w Written,
    terms: Terms,
    /// The state that the acts mean; of the vector registers only those that outlive the block.
    meant: State,
    /// The state that the instructions make.
    made: State,
    /// The values that acts have computed.
    values: Vec<Option<Symbol>>,
    /// The last act that may have changed memory.
    changed_at: usize,
    /// Calls of the current act so far, and what the flags compare with 0.
    calls: usize,
    tested: Option<Symbol>,
}

impl<'w> Checker<'w> {
    fn new(written: &'w Written) -> Checker<'w> {
        let mut terms = Terms::default();
        let vectors = std::array::from_fn(|n| terms.of(Term::Vector(n)));
        let general = std::array::from_fn(|n| terms.of(Term::General(n)));
        let masks = std::array::from_fn(|_| terms.unknown());
        let meant = State { vectors, general, masks, memory: BTreeMap::new() };
        let values = vec![None; written.givens.len()];
        let (made, changed_at, calls, tested) = (meant.clone(), 0, 0, None);
        let mut checker = Checker { written, terms, meant, made, values, changed_at, calls, tested };
        for given in written.givens.iter().filter(|given| !given.is_fleeting) {
            let Some(memory) = given.memory else { continue };
            let address = checker.place(memory);
            let symbol = match given.register {
                Some(register) => checker.meant.vectors[usize::from(register)],
                None => checker.terms.of(Term::Unwritten(address, 0)),
            };
            for state in [&mut checker.meant, &mut checker.made] {
                state.memory.insert(address, (if memory.is_spread { 1 } else { written.width.bytes() }, symbol));
            }
        }
        checker
    }

    /// Checks all that outlives the block, which control may leave here.
    fn settled(&self) -> Result<(), Fault> {
        for register in (0..32).filter(|register| self.written.reserved & 1 << register != 0) {
            if self.meant.vectors[usize::from(register)] != self.made.vectors[usize::from(register)] {
                return Err(Fault::Register(register));
            }
        }
        let is_kept = |(address, meant)| self.made.memory.get(address) == Some(meant);
        if self.meant.memory.iter().all(is_kept) { Ok(()) } else { Err(Fault::Memory) }
    }

    fn act(&mut self, at: usize, WrittenAct { act, body, rare }: &WrittenAct) -> Result<(), Fault> {
        (self.calls, self.tested) = (0, None);
        if let Act::Integers(integers) = act {
            return self.integers(at, integers, body);
        }
        // The meaning of an act reads memory before its instructions change it.
        let expected = self.meaning(act);
        match (act, expected) {
            (Act::Rare { truth, usual, .. }, Some(result)) => {
                let [truth, usual] = [truth, usual].map(|id| self.operand(*id, Element::Double));
                self.rare([truth, usual, result], body, rare)?;
            }
            _ => self.all(body)?,
        }
        match act {
            Act::Store { memory, .. } => {
                self.changed_at = at + 1;
                self.agrees_at(*memory)
            }
            Act::Sum { variable, .. } => {
                self.changed_at = at + 1;
                let given = self.written.givens[variable.index()];
                match (given.register, given.memory) {
                    (None, Some(memory)) => self.agrees_at(memory),
                    _ => Ok(()),
                }
            }
            Act::Truths { .. } if Some(self.made.general[RAX]) != expected => Err(Fault::Truths),
            _ => Ok(()),
        }
    }

    /// Checks memory that an act has written.
    fn agrees_at(&mut self, memory: MemoryPlace) -> Result<(), Fault> {
        let address = self.place(memory);
        let [meant, made] = [&self.meant, &self.made].map(|state| state.memory.get(&address));
        if meant == made { Ok(()) } else { Err(Fault::Memory) }
    }

    // The meaning of acts.

    /// The address of a memory operand, by the general registers that acts mean.
    fn place(&mut self, place: MemoryPlace) -> Address {
        let base = match place.base {
            Anchor::Frame => self.meant.general[number(Register::RSP)],
            Anchor::Pool => self.terms.of(Term::Pool),
            Anchor::At(variable) => self.meant.general[number(register(variable))],
        };
        let index = place.index.map(|(index, _)| self.meant.general[number(register(index))]);
        Address { base, index, scale: place.index.map_or(1, |(_, scale)| scale), offset: place.offset }
    }

    /// Memory as acts mean it.
    fn meant_at(&mut self, address: Address) -> Symbol {
        let known = self.meant.memory.get(&address).map(|(_, symbol)| *symbol);
        known.unwrap_or_else(|| self.terms.of(Term::Unwritten(address, self.changed_at)))
    }

    /// A vector in memory, before it is spread.
    fn in_memory(&mut self, id: Id) -> Symbol {
        match self.written.givens[id.index()].memory {
            Some(memory) => {
                let address = self.place(memory);
                self.meant_at(address)
            }
            None => self.terms.unknown(),
        }
    }

    fn operand(&mut self, id: Id, element: Element) -> Symbol {
        let given = self.written.givens[id.index()];
        match (self.values[id.index()], given.register) {
            (Some(value), _) => value,
            (None, Some(register)) => self.meant.vectors[usize::from(register)],
            (None, None) => {
                let value = self.in_memory(id);
                let is_spread = given.memory.is_some_and(|memory| memory.is_spread);
                if is_spread { self.terms.of(Term::Spread(element.bytes(), value)) } else { value }
            }
        }
    }

    fn operation<const N: usize>(&mut self, operation: Operation, element: Element, operands: [Symbol; N]) -> Symbol {
        let code = operation.code(element, self.written.width);
        let immediate = operation.immediate(self.written.width).unwrap_or(0) as u8;
        self.result(code, immediate, SmallVec::from_slice(&operands))
    }

    /// The result of an instruction, which has the same symbol for either order of commuting operands.
    fn result(&mut self, code: Code, immediate: u8, mut operands: SmallVec<[Symbol; 3]>) -> Symbol {
        let commutes = matches!(FORMS.get(&code), Some(Form::Commuting | Form::Fma(..)));
        if let Some(pair) = operands.get_mut(..2).filter(|_| commutes) {
            pair.sort();
        }
        self.terms.of(Term::Result(code, immediate, operands))
    }

    /// Applies an act to the meant state; the symbol that it makes.
    fn meaning(&mut self, act: &Act) -> Option<Symbol> {
        let width = self.written.width;
        match act {
            Act::Compute { operation, element, result, operands } => {
                let value = self.computed(*operation, *element, operands);
                self.values[result.index()] = Some(value);
                Some(value)
            }
            Act::Sum { variable, element, terms, used } => {
                let sum = self.operand(*variable, *element);
                let sum = self.added(sum, *element, terms, *used);
                let given = self.written.givens[variable.index()];
                match (given.register, given.memory) {
                    (Some(register), _) => self.meant.vectors[usize::from(register)] = sum,
                    (None, Some(memory)) => {
                        let address = self.place(memory);
                        self.meant.write(address, width.bytes(), sum);
                    }
                    (None, None) => {}
                }
                Some(sum)
            }
            Act::Move { variable, element, operand } => {
                let value = self.operand(*operand, *element);
                if let Some(register) = self.written.givens[variable.index()].register {
                    self.meant.vectors[usize::from(register)] = value;
                }
                Some(value)
            }
            Act::Store { operand, extent, element, memory } => {
                let (value, address) = (self.operand(*operand, *element), self.place(*memory));
                let bytes = match extent {
                    Portion::Whole => width.bytes(),
                    Portion::Half => width.bytes() / 2,
                    Portion::Least => element.bytes(),
                };
                self.meant.write(address, bytes, value);
                Some(value)
            }
            Act::Call { element, offset, operands, result } => {
                let operands = operands.iter().map(|id| self.operand(*id, *element)).collect();
                let called = self.called(*offset, operands);
                self.values[result.index()] = Some(called);
                Some(called)
            }
            Act::Rare { truth, usual, x, offset, result } => {
                let [truth, usual, x] = [truth, usual, x].map(|id| self.operand(*id, Element::Double));
                let called = self.called(*offset, smallvec![x]);
                let value = match width {
                    VectorWidth::Bits512 => {
                        let mask = self.terms.of(Term::Truths(Element::Double.bytes(), truth));
                        self.terms.of(Term::Masked([mask, called, usual]))
                    }
                    _ => self.operation(Operation::Select, Element::Double, [usual, called, truth]),
                };
                self.values[result.index()] = Some(value);
                Some(value)
            }
            Act::Gather { cells, bound, offset, result } => {
                let [cells, bound] = [cells, bound].map(|id| self.operand(*id, Element::Double));
                let tables = self.place(arg(offset_of!(Args, tables)));
                let base = self.meant_at(tables);
                let start = Address { base, index: None, scale: size_of::<f64>() as u32, offset: *offset };
                let start = self.terms.of(Term::Address(start));
                let index = self.operation(Operation::Least, Element::Double, [cells, bound]);
                let mut all = self.operation(Operation::EqualBits, Element::Double, [cells, cells]);
                if width == VectorWidth::Bits512 {
                    all = self.terms.of(Term::Truths(Element::Double.bytes(), all));
                }
                let value = self.result(instructions::gather(width), 0, smallvec![start, index, all]);
                self.values[result.index()] = Some(value);
                Some(value)
            }
            Act::Truths { operand, element } => {
                let operand = self.operand(*operand, *element);
                Some(self.terms.of(Term::Truths(element.bytes(), operand)))
            }
            Act::Integers(_) => None,
        }
    }

    fn computed(&mut self, operation: Operation, element: Element, operands: &[Id]) -> Symbol {
        if let (InMemory::Always, &[from]) = (operation.in_memory(), operands) {
            let from = self.in_memory(from);
            return match operation {
                Operation::Load => from,
                Operation::Spread => self.terms.of(Term::Spread(element.bytes(), from)),
                _ => self.operation(operation, element, [from]),
            };
        }
        let from = operation.source(element);
        let operands: SmallVec<[Symbol; 3]> = operands.iter().map(|id| self.operand(*id, from)).collect();
        match operands[..] {
            [truth, a, b] if operation == Operation::Select && self.written.width != VectorWidth::Bits512 => {
                self.operation(operation, element, [b, a, truth])
            }
            [a] => self.operation(operation, element, [a]),
            [a, b] => self.operation(operation, element, [a, b]),
            [a, b, c] => self.operation(operation, element, [a, b, c]),
            _ => self.terms.unknown(),
        }
    }

    fn added(&mut self, sum: Symbol, element: Element, terms: &[Id], used: Option<Id>) -> Symbol {
        let terms: SmallVec<[Symbol; 2]> = terms.iter().map(|id| self.operand(*id, element)).collect();
        let new = match terms[..] {
            [a, b] => self.operation(Operation::Fma, element, [a, b, sum]),
            _ => self.operation(Operation::Add, element, [sum, terms[0]]),
        };
        let Some(used) = used.map(|used| self.operand(used, element)) else { return new };
        let mask = self.terms.of(Term::Truths(element.bytes(), used));
        self.terms.of(Term::Masked([mask, new, sum]))
    }

    /// The result of the function at an offset of the table.
    fn called(&mut self, offset: i32, operands: SmallVec<[Symbol; 3]>) -> Symbol {
        let functions = self.place(arg(offset_of!(Args, functions)));
        let base = self.meant_at(functions);
        let function = self.meant_at(Address { base, index: None, scale: 1, offset });
        self.terms.of(Term::Called(function, operands))
    }

    // The effect of instructions.

    /// Instructions on general registers, which act on both states.
    fn integers(&mut self, at: usize, integers: &Integers, body: &[Item]) -> Result<(), Fault> {
        let mut meant = Instructions::default();
        meant.integers(integers);
        if !meant.are(body) {
            return Err(Fault::Integers);
        }
        for (n, item) in body.iter().enumerate() {
            let Item::Instruction { instruction, reference, .. } = item else { continue };
            if matches!(reference, Reference::Label(_)) {
                self.settled()?;
            }
            let symbol = self.terms.of(Term::Integers([at, n]));
            for is_meant in [true, false] {
                let address = has_memory(instruction).then(|| self.address(instruction, *reference, is_meant));
                let state = if is_meant { &mut self.meant } else { &mut self.made };
                match (instruction.op0_kind(), address) {
                    (OpKind::Memory, Some(address)) => state.forget(address, instruction.memory_size().size()),
                    (OpKind::Register, _) if instruction.op0_register().is_gpr() => {
                        state.general[number(instruction.op0_register())] = symbol;
                    }
                    _ => {}
                }
            }
        }
        self.changed_at = at + 1;
        Ok(())
    }

    fn all(&mut self, items: &[Item]) -> Result<(), Fault> {
        for item in items {
            match item {
                Item::Instruction { reference: Reference::Label(_), .. } | Item::Label(_) => return Err(Fault::Call),
                Item::Instruction { instruction, reference, .. } => self.execute(instruction, *reference)?,
            }
        }
        Ok(())
    }

    /// A branch to `rare`, which returns behind it.
    fn rare(&mut self, [truth, usual, result]: [Symbol; 3], body: &[Item], rare: &[Item]) -> Result<(), Fault> {
        let jump = |item: &Item| match item {
            Item::Instruction { instruction, reference: Reference::Label(label), .. } => {
                Some((instruction.code(), *label))
            }
            _ => None,
        };
        let [before @ .., branch, Item::Label(after)] = body else { return Err(Fault::Call) };
        let [Item::Label(start), inside @ .., end] = rare else { return Err(Fault::Call) };
        let is_there =
            jump(branch) == Some((Code::Jne_rel32_64, *start)) && jump(end) == Some((Code::Jmp_rel32_64, *after));
        self.all(before)?;
        let truths = self.terms.of(Term::Truths(Element::Double.bytes(), truth));
        if !is_there || self.tested != Some(truths) {
            return Err(Fault::Call);
        }
        let usually = self.made.clone();
        self.all(inside)?;
        let rarely = std::mem::replace(&mut self.made, usually);
        let unknown = self.terms.unknown();
        for (made, rarely) in self.made.vectors.iter_mut().zip(rarely.vectors) {
            *made = match (*made, rarely) {
                (a, b) if a == b => a,
                (a, b) if a == usual && b == result => result,
                _ => unknown,
            };
        }
        let general = self.made.general.iter_mut().zip(rarely.general);
        let masks = self.made.masks.iter_mut().zip(rarely.masks);
        general.chain(masks).filter(|(made, rarely)| **made != *rarely).for_each(|(made, _)| *made = unknown);
        self.made.memory.retain(|address, content| rarely.memory.get(address) == Some(content));
        Ok(())
    }

    /// The address of an instruction's memory operand.
    fn address(&mut self, i: &Instruction, reference: Reference, is_meant: bool) -> Address {
        let general = if is_meant { self.meant.general } else { self.made.general };
        let index = (i.memory_index() != Register::None && !i.is_vsib()).then(|| general[number(i.memory_index())]);
        let (base, offset) = match reference {
            Reference::Pool(offset) => (self.terms.of(Term::Pool), offset),
            _ => (general[number(i.memory_base())], i.memory_displacement64() as i32),
        };
        Address { base, index, scale: i.memory_index_scale(), offset }
    }

    fn loaded(&mut self, address: Address) -> Symbol {
        let known = self.made.memory.get(&address).map(|(_, symbol)| *symbol);
        known.unwrap_or_else(|| self.terms.of(Term::Unwritten(address, self.changed_at)))
    }

    /// The symbol of an operand.
    fn read(&mut self, i: &Instruction, operand: u32, reference: Reference) -> Symbol {
        match i.op_kind(operand) {
            OpKind::Memory => {
                let address = self.address(i, reference, false);
                let value = self.loaded(address);
                let bytes = i.memory_size().size();
                if i.is_broadcast() { self.terms.of(Term::Spread(bytes, value)) } else { value }
            }
            OpKind::Register => {
                let register = i.op_register(operand);
                match register {
                    _ if register.is_gpr() => self.made.general[number(register)],
                    _ if register.is_k() => self.made.masks[number(register)],
                    _ => self.made.vectors[number(register)],
                }
            }
            _ => self.terms.unknown(),
        }
    }

    fn execute(&mut self, i: &Instruction, reference: Reference) -> Result<(), Fault> {
        let vector = |code: Code| code == i.code();
        let width = self.written.width;
        let elements = [Element::Single, Element::Double];
        match i.mnemonic() {
            Mnemonic::Call => return self.call(i, reference),
            Mnemonic::Test => self.tested = Some(self.read(i, 0, reference)),
            Mnemonic::Vzeroupper => self.made.vectors = std::array::from_fn(|_| self.terms.unknown()),
            Mnemonic::Lea => {
                let address = self.address(i, reference, false);
                self.made.general[number(i.op0_register())] = self.terms.of(Term::Address(address));
            }
            Mnemonic::Vmovmskps | Mnemonic::Vmovmskpd | Mnemonic::Vpmovd2m | Mnemonic::Vpmovq2m => {
                let Some(element) = elements.into_iter().find(|of| vector(instructions::truths(*of, width))) else {
                    return Err(Fault::Unexpected(i.code()));
                };
                let from = self.read(i, 1, reference);
                let truths = self.terms.of(Term::Truths(element.bytes(), from));
                self.assign(i.op0_register(), truths);
            }
            Mnemonic::Vpmovm2d | Mnemonic::Vpmovm2q => {
                let (from, unknown) = (self.read(i, 1, reference), self.terms.unknown());
                let is_meant = |bytes: usize| {
                    elements.iter().any(|of| of.bytes() == bytes && vector(instructions::truth_of_mask(*of)))
                };
                let truth = match self.terms.term(from) {
                    Term::Truths(bytes, truth) if is_meant(*bytes) => *truth,
                    _ => unknown,
                };
                self.assign(i.op0_register(), truth);
            }
            Mnemonic::Mov
            | Mnemonic::Kmovw
            | Mnemonic::Vmovups
            | Mnemonic::Vmovupd
            | Mnemonic::Vmovss
            | Mnemonic::Vmovsd
                if i.op0_kind() == OpKind::Memory =>
            {
                let (from, address) = (self.read(i, 1, reference), self.address(i, reference, false));
                self.made.write(address, i.memory_size().size(), from);
            }
            Mnemonic::Mov | Mnemonic::Kmovw => {
                let from = self.read(i, 1, reference);
                self.assign(i.op0_register(), from);
            }
            Mnemonic::Vgatherqpd => self.gather(i, reference)?,
            _ if !i.op0_register().is_vector_register() && !i.op0_register().is_k() => {
                return Err(Fault::Unexpected(i.code()));
            }
            _ => self.compute(i, reference),
        }
        Ok(())
    }

    fn assign(&mut self, register: Register, symbol: Symbol) {
        match register {
            _ if register.is_gpr() => self.made.general[number(register)] = symbol,
            _ if register.is_k() => self.made.masks[number(register)] = symbol,
            _ => self.made.vectors[number(register)] = symbol,
        }
    }

    /// An instruction that computes a vector, or compares two.
    fn compute(&mut self, i: &Instruction, reference: Reference) {
        let has_byte = i.op_count() > 0 && i.op_kind(i.op_count() - 1) == OpKind::Immediate8;
        let immediate = if has_byte { i.immediate8() } else { 0 };
        let sources = i.op_count() - u32::from(has_byte);
        let mut operands: SmallVec<[Symbol; 3]> = (1..sources).map(|n| self.read(i, n, reference)).collect();
        let old = self.read(i, 0, reference);
        let mut new = match (FORMS.get(&i.code()), &operands[..]) {
            (Some(Form::Fma(form, code)), &[second, third]) => {
                let operands = match form {
                    FmaForm::F132 => smallvec![old, third, second],
                    FmaForm::F213 => smallvec![second, old, third],
                    FmaForm::F231 => smallvec![second, third, old],
                };
                self.result(*code, 0, operands)
            }
            (Some(Form::Loading), &[from]) => from,
            (Some(Form::Spreading), &[from]) if i.op1_kind() == OpKind::Memory => {
                self.terms.of(Term::Spread(i.memory_size().size(), from))
            }
            (Some(Form::Selecting), _) => {
                operands.insert(0, old);
                self.result(i.code(), immediate, operands)
            }
            _ => self.result(i.code(), immediate, operands),
        };
        if i.op0_register().is_k() {
            let element = if i.mnemonic() == Mnemonic::Vcmpps { Element::Single } else { Element::Double };
            new = self.terms.of(Term::Truths(element.bytes(), new));
        }
        if i.op_mask() != Register::None {
            new = self.terms.of(Term::Masked([self.made.masks[number(i.op_mask())], new, old]));
        }
        self.assign(i.op0_register(), new);
    }

    fn gather(&mut self, i: &Instruction, reference: Reference) -> Result<(), Fault> {
        let start = self.address(i, reference, false);
        let start = self.terms.of(Term::Address(start));
        let (to, index) = (number(i.op0_register()), number(i.memory_index()));
        let mask = if i.op_mask() == Register::None { i.op_register(2) } else { i.op_mask() };
        let is_vector = mask.is_vector_register();
        if !is_vector && !mask.is_k() {
            return Err(Fault::Unexpected(i.code()));
        }
        if to == index || is_vector && [to, index].contains(&number(mask)) {
            return Err(Fault::Gather);
        }
        let all = if is_vector { self.made.vectors[number(mask)] } else { self.made.masks[number(mask)] };
        let (index, cleared) = (self.made.vectors[index], self.terms.unknown());
        let gathered = self.result(i.code(), 0, smallvec![start, index, all]);
        self.assign(mask, cleared);
        self.assign(i.op0_register(), gathered);
        Ok(())
    }

    /// A call replaces a part of the vector at rdi; the calls of an act together replace it all.
    fn call(&mut self, i: &Instruction, reference: Reference) -> Result<(), Fault> {
        let function = self.address(i, reference, false);
        let function = self.loaded(function);
        let part = (self.calls * CALL_BYTES) as i32;
        let operand =
            |checker: &Self, register: Register| match checker.terms.term(checker.made.general[number(register)]) {
                Term::Address(address) => Some(Address { offset: address.offset - part, ..*address }),
                _ => None,
            };
        let (first, second) = (operand(self, Register::RDI), operand(self, Register::RSI));
        let first = first.ok_or(Fault::Call)?;
        self.calls += 1;
        if self.calls * CALL_BYTES == self.written.width.bytes() {
            let mut operands = smallvec![self.loaded(first)];
            operands.extend(second.map(|second| self.loaded(second)));
            let called = self.terms.of(Term::Called(function, operands));
            self.made.write(first, self.written.width.bytes(), called);
        }
        self.made.vectors = std::array::from_fn(|_| self.terms.unknown());
        self.made.masks = std::array::from_fn(|_| self.terms.unknown());
        for register in CLOBBERED {
            self.made.general[number(register)] = self.terms.unknown();
        }
        Ok(())
    }
}

const RAX: usize = 0;

/// General registers that a call may change.
const CLOBBERED: [Register; 9] = [
    Register::RAX,
    Register::RCX,
    Register::RDX,
    Register::RSI,
    Register::RDI,
    Register::R8,
    Register::R9,
    Register::R10,
    Register::R11,
];

/// The number of a register among those of its kind.
fn number(register: Register) -> usize {
    use Register::{AL, AX, EAX, K0, R15, R15D, R15L, R15W, RAX, XMM0, XMM31, YMM0, YMM31, ZMM0, ZMM31};
    let kinds = [(RAX, R15), (EAX, R15D), (AX, R15W), (XMM0, XMM31), (YMM0, YMM31), (ZMM0, ZMM31), (K0, Register::K7)];
    let kind = kinds.into_iter().find(|(first, last)| (*first..=*last).contains(&register));
    let first = kind.map_or(AL, |(first, _)| first);
    let number = register as usize - first as usize;
    // Among the lowest bytes, the second bytes of four registers follow the first four.
    if (AL..=R15L).contains(&register) && number > 3 { number - 4 } else { number }
}

fn has_memory(i: &Instruction) -> bool {
    (0..i.op_count()).any(|operand| i.op_kind(operand) == OpKind::Memory)
}

/// The form of an instruction on vectors.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Form {
    /// The first two operands may change places.
    Commuting,
    /// Reads the register that it overwrites: an fma, whose other forms mean the same as that code; a selection.
    Fma(FmaForm, Code),
    Selecting,
    /// A move, or an element of memory in all lanes.
    Loading,
    Spreading,
}

/// The instructions that have a form.
static FORMS: LazyLock<BTreeMap<Code, Form>> = LazyLock::new(|| {
    use Operation::{Add, AddBits, And, EqualBits, Mul, Or, Xor};
    let mut forms = BTreeMap::new();
    for (width, element) in [
        (VectorWidth::Bits256, Element::Single),
        (VectorWidth::Bits256, Element::Double),
        (VectorWidth::Bits512, Element::Single),
        (VectorWidth::Bits512, Element::Double),
    ] {
        let code = |operation: Operation| operation.code(element, width);
        forms.extend([Add, Mul, And, Or, Xor, AddBits, EqualBits].map(|operation| (code(operation), Form::Commuting)));
        let usual = FmaForm::F231.code(element, width);
        let fma = [FmaForm::F132, FmaForm::F213, FmaForm::F231];
        forms.extend(fma.map(|form| (form.code(element, width), Form::Fma(form, usual))));
        forms.extend([(code(Operation::Load), Form::Loading), (code(Operation::Spread), Form::Spreading)]);
        if width == VectorWidth::Bits512 {
            forms.insert(code(Operation::Select), Form::Selecting);
        }
    }
    forms
});
