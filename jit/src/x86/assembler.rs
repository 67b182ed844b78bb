//! Assembler: instructions with labels and constants, in three sections; the constants follow the sections.

use iced_x86::{Code, Encoder, IcedError, Instruction, MemoryOperand, Register};
use isophote_symbolic::Value;

use super::integers::register;
use crate::error::CompileError;
use crate::vector::{Anchor, Constants, Label, MemoryPlace};

/// A place as an operand of an instruction.
fn operand(place: MemoryPlace) -> MemoryOperand {
    let base = match place.base {
        Anchor::Frame => Register::RSP,
        Anchor::Pool => Register::RIP,
        Anchor::At(variable) => register(variable),
    };
    let (index, scale) = place.index.map_or((Register::None, 1), |(index, scale)| (register(index), scale));
    // RIP-relative offsets are patched at the end.
    let offset = if place.base == Anchor::Pool { 0 } else { i64::from(place.offset) };
    let has_offset = u32::from(offset != 0 || place.base == Anchor::Pool);
    MemoryOperand::new(base, index, scale, offset, has_offset, place.is_spread, Register::None)
}

/// A reference to patch once all positions are known.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Reference {
    Nothing,
    Label(Label),
    /// An offset among the constants.
    Pool(i32),
}

/// One instruction, or a label before the next.
#[derive(Clone, Debug)]
pub(super) enum Item {
    Instruction { instruction: Instruction, reference: Reference, value: Option<Value> },
    Label(Label),
}

/// The sections, in the order of the code.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Section {
    /// The prologue; the frame's size is known last.
    Entry,
    Body,
    /// Code that rarely runs.
    Rare,
}

/// A list of instructions.
#[derive(Clone, Default, Debug)]
pub(super) struct Instructions {
    items: Vec<Item>,
    error: Option<IcedError>,
}

impl Instructions {
    /// Appends an instruction without references to constants or labels.
    pub fn add(&mut self, instruction: Result<Instruction, IcedError>) {
        self.push(instruction, Reference::Nothing);
    }

    /// Appends an instruction with a memory operand.
    pub fn add_at(&mut self, place: MemoryPlace, make: impl FnOnce(MemoryOperand) -> Result<Instruction, IcedError>) {
        let reference = if place.base == Anchor::Pool { Reference::Pool(place.offset) } else { Reference::Nothing };
        self.push(make(operand(place)), reference);
    }

    fn push(&mut self, instruction: Result<Instruction, IcedError>, reference: Reference) {
        match instruction {
            Ok(instruction) => self.items.push(Item::Instruction { instruction, reference, value: None }),
            Err(error) => self.error = self.error.take().or(Some(error)),
        }
    }

    /// to = from, 64 bits.
    pub fn mov(&mut self, to: Register, from: MemoryPlace) {
        self.add_at(from, |from| Instruction::with2(Code::Mov_r64_rm64, to, from));
    }
    /// to = the address of `place`
    pub fn point(&mut self, to: Register, place: MemoryPlace) {
        self.add_at(place, |place| Instruction::with2(Code::Lea_r64_m, to, place));
    }
    /// A jump by a `…_rel32_64` code.
    pub fn jump(&mut self, code: Code, to: Label) {
        self.push(Instruction::with_branch(code, 0), Reference::Label(to));
    }
    /// Defines `label` here.
    pub fn label(&mut self, label: Label) {
        self.items.push(Item::Label(label));
    }

    /// Whether these are the same instructions, for whichever value.
    pub fn are(&self, items: &[Item]) -> bool {
        let is_same = |pair: (&Item, &Item)| match pair {
            (Item::Label(a), Item::Label(b)) => a == b,
            (
                Item::Instruction { instruction: a, reference: to_a, .. },
                Item::Instruction { instruction: b, reference: to_b, .. },
            ) => a == b && to_a == to_b,
            _ => false,
        };
        self.items.len() == items.len() && self.items.iter().zip(items).all(is_same)
    }
}

/// The code under construction.
pub(super) struct Assembler {
    sections: [Instructions; 3],
    section: Section,
    labels: usize,
    value: Option<Value>,
}

/// A byte range, and the value it was emitted for.
pub(crate) struct Spoken {
    pub start: usize,
    pub end: usize,
    pub value: Value,
}

/// Machine code: instructions, a gap, constants.
pub(crate) struct Assembled {
    pub bytes: Vec<u8>,
    /// Where the instructions end.
    pub code_end: usize,
    pub spans: Vec<Spoken>,
}

/// Alignment of the constants, so that each is at a multiple of its size.
pub(crate) const ALIGNMENT: usize = 64;

impl Assembler {
    /// For code that has so many labels already.
    pub fn new(labels: usize) -> Assembler {
        Assembler { sections: Default::default(), section: Section::Body, labels, value: None }
    }

    pub fn new_label(&mut self) -> Label {
        self.labels += 1;
        Label(self.labels - 1)
    }

    /// Switches to `section`; returns the previous one.
    pub fn switch_to(&mut self, section: Section) -> Section {
        std::mem::replace(&mut self.section, section)
    }

    /// The instructions and labels of a section so far.
    pub fn items(&self, section: Section) -> &[Item] {
        &self.sections[section as usize].items
    }

    /// Attributes the next instructions to `value`.
    pub fn set_source(&mut self, value: Option<Value>) {
        self.value = value;
    }

    /// Appends the instructions of `make`.
    pub fn write(&mut self, make: impl FnOnce(&mut Instructions)) {
        let mut items = Instructions::default();
        make(&mut items);
        self.append(items);
    }

    /// Appends a list of instructions.
    pub fn append(&mut self, items: Instructions) {
        let section = &mut self.sections[self.section as usize];
        section.error = section.error.take().or(items.error);
        section.items.extend(items.items.into_iter().map(|item| match item {
            Item::Instruction { instruction, reference, .. } => {
                Item::Instruction { instruction, reference, value: self.value }
            }
            label => label,
        }));
    }

    /// Encodes everything.
    ///
    /// # Errors
    /// If an instruction cannot be encoded (a bug).
    pub fn assemble(self, constants: Constants) -> Result<Assembled, CompileError> {
        let bug = |error: String| CompileError::Compiler(format!("the assembler refused an instruction: {error}"));
        let (mut bytes, mut labels, mut open, mut spans) = (Vec::new(), vec![0; self.labels], Vec::new(), Vec::new());
        let mut encoder = Encoder::new(64);
        for section in self.sections {
            if let Some(error) = section.error {
                return Err(bug(error.to_string()));
            }
            for item in section.items {
                let (instruction, reference, value) = match item {
                    Item::Label(Label(label)) => {
                        labels[label] = bytes.len();
                        continue;
                    }
                    Item::Instruction { instruction, reference, value } => (instruction, reference, value),
                };
                let start = bytes.len();
                encoder.encode(&instruction, start as u64).map_err(|e| bug(format!("{e}: {instruction:?}")))?;
                bytes.extend(encoder.take_buffer());
                let at = match reference {
                    Reference::Nothing => None,
                    Reference::Label(_) => Some(bytes.len() - size_of::<i32>()),
                    Reference::Pool(_) => Some(start + encoder.get_constant_offsets().displacement_offset()),
                };
                open.extend(at.map(|at| (at, bytes.len(), reference)));
                spans.extend(value.map(|value| Spoken { start, end: bytes.len(), value }));
            }
        }
        let code_end = bytes.len();
        let pool_start = code_end.next_multiple_of(ALIGNMENT);
        for (at, next, reference) in open {
            let target = match reference {
                Reference::Nothing => continue,
                Reference::Label(Label(label)) => labels[label] as i64,
                Reference::Pool(offset) => pool_start as i64 + i64::from(offset),
            };
            bytes[at..at + size_of::<i32>()].copy_from_slice(&((target - next as i64) as i32).to_le_bytes());
        }
        bytes.resize(pool_start, 0);
        bytes.extend(constants.bytes);
        Ok(Assembled { bytes, code_end, spans })
    }
}
