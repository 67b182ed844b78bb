//! Register allocation of a block.
//!
//! When registers run out, the value with the furthest next use is evicted (Belady); a value that memory holds anyway is
//! evicted without a store, and instructions read it from there.

use iced_x86::{Instruction, Register};

use super::assembler::{Assembler, Instructions};
use super::instructions;
use super::slots::Slots;
use crate::options::VectorWidth;
use crate::vector::{Element, Given, Id, MemoryPlace, Operation, Portion};

/// An operand: a register or memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Read {
    Register(u8),
    Memory(MemoryPlace),
}

/// State of the allocation of a block.
pub(super) struct Allocation<'a> {
    pub assembler: &'a mut Assembler,
    pub slots: &'a mut Slots,
    pub width: VectorWidth,
    givens: Vec<Given>,
    /// The acts that read a value, the next one last.
    uses: Vec<Vec<usize>>,
    /// The register of each value.
    registers: Vec<Option<u8>>,
    /// The value in each register.
    occupants: Vec<Option<Id>>,
    /// Registers that outlive the block, as bits.
    pub reserved: u32,
    /// Registers that the current act needs, and those that it frees at its end.
    locked: u32,
    temporary: u32,
    /// Free spill slots, by number.
    free_spills: Vec<usize>,
    dying_spills: Vec<usize>,
    spills: usize,
    spill_of: Vec<Option<usize>>,
    /// The truth values whose lanes the mask register has, at 512 bits.
    pub mask_of: Option<Id>,
}

/// Number of vector registers.
pub(super) fn count(width: VectorWidth) -> usize {
    if width == VectorWidth::Bits512 { 32 } else { 16 }
}

impl<'a> Allocation<'a> {
    pub fn new(
        assembler: &'a mut Assembler,
        slots: &'a mut Slots,
        width: VectorWidth,
        givens: Vec<Given>,
        uses: Vec<Vec<usize>>,
        reserved: u32,
    ) -> Allocation<'a> {
        Allocation {
            registers: givens.iter().map(|given| given.register).collect(),
            spill_of: vec![None; givens.len()],
            occupants: vec![None; count(width)],
            assembler,
            slots,
            width,
            givens,
            uses,
            reserved,
            locked: 0,
            temporary: 0,
            free_spills: Vec::new(),
            dying_spills: Vec::new(),
            spills: 0,
            mask_of: None,
        }
    }

    /// Advances to act `at`.
    pub fn begin(&mut self, at: usize, operands: &[Id]) {
        (self.locked, self.temporary) = (0, 0);
        self.free_spills.append(&mut self.dying_spills);
        for id in operands {
            while self.uses[id.index()].last().is_some_and(|next| *next <= at) {
                self.uses[id.index()].pop();
            }
            if let Some(register) = self.registers[id.index()] {
                self.locked |= 1 << register;
            }
        }
    }

    // Instructions.

    /// The register as an operand.
    pub fn name(&self, register: u8, extent: Portion) -> Register {
        instructions::register(register, extent, self.width)
    }

    pub fn write(&mut self, make: impl FnOnce(&mut Instructions)) {
        self.assembler.write(make);
    }

    pub fn load(&mut self, to: u8, memory: MemoryPlace, element: Element) {
        let operation = if memory.is_spread { Operation::Spread } else { Operation::Load };
        let (code, to) = (operation.code(element, self.width), self.name(to, Portion::Whole));
        // The instruction itself spreads.
        let memory = MemoryPlace { is_spread: false, ..memory };
        self.write(|i| i.add_at(memory, |from| Instruction::with2(code, to, from)));
    }

    pub fn store(&mut self, register: u8, extent: Portion, element: Element, to: MemoryPlace) {
        let (code, from) = (instructions::store(extent, element, self.width), self.name(register, extent));
        self.write(|i| i.add_at(to, |to| Instruction::with2(code, to, from)));
    }

    pub fn copy(&mut self, to: u8, from: u8) {
        let code = Operation::Load.code(Element::Single, self.width);
        let [to, from] = [to, from].map(|register| self.name(register, Portion::Whole));
        self.write(|i| i.add(Instruction::with2(code, to, from)));
    }

    // Registers.

    pub fn is_dying(&self, id: Id) -> bool {
        let given = self.givens[id.index()];
        self.uses[id.index()].is_empty() && given.register.is_none() && !given.is_fleeting
    }

    /// Registers in use, as bits.
    pub fn live(&self) -> u32 {
        let occupied = self.occupants.iter().enumerate().filter(|(_, id)| id.is_some());
        occupied.fold(self.reserved, |bits, (register, _)| bits | 1 << register)
    }

    /// Registers in use, including those of the current act.
    pub fn taken(&self) -> u32 {
        self.live() | self.temporary | self.locked
    }

    /// Whether no other value has the register of a value.
    pub fn is_own(&self, id: Id, register: u8) -> bool {
        self.occupants[usize::from(register)] == Some(id) || self.temporary & 1 << register != 0
    }

    pub fn register_of(&self, id: Id) -> Option<u8> {
        self.registers[id.index()]
    }

    /// A free register, by eviction if necessary; the act keeps it.
    pub fn take(&mut self) -> u8 {
        let taken = self.taken();
        let free = (0..count(self.width) as u8).find(|register| taken & 1 << register == 0);
        let register = free.unwrap_or_else(|| self.evict());
        self.locked |= 1 << register;
        register
    }

    /// Evicts the value with the furthest next use.
    fn evict(&mut self) -> u8 {
        let fixed = self.reserved | self.locked | self.temporary;
        let open = self.occupants.iter().enumerate().filter(|(register, _)| fixed & 1 << register == 0);
        let last = open.filter_map(|(register, id)| Some((register, (*id)?))).max_by_key(|(_, id)| {
            let has_memory = self.givens[id.index()].memory.is_some();
            (self.uses[id.index()].last().copied().unwrap_or(usize::MAX), has_memory)
        });
        let Some((register, id)) = last else { unreachable!("an act needs fewer registers than there are free ones") };
        if self.givens[id.index()].memory.is_none() {
            let spill = self.free_spills.pop().unwrap_or_else(|| {
                self.spills += 1;
                self.spills - 1
            });
            let place = self.slots.spill(spill, self.width.bytes());
            self.spill_of[id.index()] = Some(spill);
            self.givens[id.index()].memory = Some(place);
            self.store(register as u8, Portion::Whole, Element::Single, place);
        }
        self.registers[id.index()] = None;
        self.occupants[register] = None;
        register as u8
    }

    /// A register for the act alone.
    pub fn take_temporary(&mut self) -> u8 {
        let register = self.take();
        self.temporary |= 1 << register;
        register
    }

    pub fn keep(&mut self, id: Id, register: u8) {
        if self.uses[id.index()].is_empty() {
            return; // nothing reads it
        }
        self.registers[id.index()] = Some(register);
        self.occupants[usize::from(register)] = Some(id);
    }

    /// Frees values that nothing reads any more.
    pub fn release(&mut self, ids: &[Id]) {
        for id in ids {
            if !self.is_dying(*id) {
                continue;
            }
            if let Some(register) = self.registers[id.index()].take() {
                self.occupants[usize::from(register)] = None;
                self.locked &= !(1 << register);
            }
            // The current act may still read it.
            self.dying_spills.extend(self.spill_of[id.index()].take());
        }
    }

    pub fn memory(&self, id: Id) -> MemoryPlace {
        match self.givens[id.index()].memory {
            Some(memory) => memory,
            None => unreachable!("a value is made before it is read, and leaves its register for a place in memory"),
        }
    }

    /// The register of a value, loaded if necessary.
    pub fn fetch(&mut self, id: Id, element: Element) -> u8 {
        if let Some(register) = self.registers[id.index()] {
            return register;
        }
        let register = self.take();
        self.load(register, self.memory(id), element);
        if self.givens[id.index()].is_fleeting || self.uses[id.index()].is_empty() {
            self.temporary |= 1 << register;
        } else {
            self.registers[id.index()] = Some(register);
            self.occupants[usize::from(register)] = Some(id);
        }
        register
    }

    /// A value in place, if an instruction can read it there.
    pub fn read(&mut self, id: Id, element: Element) -> Read {
        match self.registers[id.index()] {
            Some(register) => Read::Register(register),
            None if self.memory(id).is_spread && self.width != VectorWidth::Bits512 => {
                Read::Register(self.fetch(id, element))
            }
            None => Read::Memory(self.memory(id)),
        }
    }

    pub fn is_in_register(&self, id: Id) -> bool {
        self.registers[id.index()].is_some()
    }
}
