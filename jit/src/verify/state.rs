//! The abstract state between two instructions: the registers, and words stored in the frame.

use iced_x86::{Mnemonic, Register};

use super::known::{Fact, Few};
use crate::limits::LIMITS;

/// 64 bits: a fact, and a name shared by all copies of the value. 0: no name.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Word {
    pub fact: Fact,
    pub name: u64,
}

impl Word {
    pub fn unnamed(fact: Fact) -> Word {
        Word { fact, name: 0 }
    }
}

/// Which of two unsigned numbers is not greater, by the condition of a jump or a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Asked {
    is_left_less: bool,
    is_strict: bool,
}

impl Asked {
    /// The condition of an instruction, on the operands of the last comparison.
    pub fn by(mnemonic: Mnemonic) -> Option<Asked> {
        let (is_left_less, is_strict) = match mnemonic {
            Mnemonic::Jb | Mnemonic::Cmovb => (true, true),
            Mnemonic::Jbe | Mnemonic::Cmovbe => (true, false),
            Mnemonic::Ja | Mnemonic::Cmova => (false, true),
            Mnemonic::Jae | Mnemonic::Cmovae => (false, false),
            _ => return None,
        };
        Some(Asked { is_left_less, is_strict })
    }

    pub fn otherwise(self) -> Asked {
        Asked { is_left_less: !self.is_left_less, is_strict: !self.is_strict }
    }
}

/// The abstract state between two instructions.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct State {
    /// The general registers, by number.
    registers: [Word; 16],
    /// Words stored in eight bytes of the frame, in the order of their offsets.
    kept: Vec<(i64, Word)>,
    /// The registers pushed before there was a frame.
    saved: Vec<Fact>,
    /// Bytes of the frame, once made; the alignment that the stack was rounded down to for it, or 0.
    frame: i64,
    alignment: i64,
    /// The two numbers compared last, while the flags hold the result.
    pub compared: Option<[Word; 2]>,
}

/// Maximum bytes of a frame.
pub(super) const FRAME_BYTES_MAX: i64 = LIMITS.frame_bytes as i64;
const WORD_BYTES: i64 = 8;
/// Alignment of the stack pointer at a call, in bytes.
const CALL_BYTES: i64 = 16;
const RSP: usize = 4;
/// Callee-saved registers: rbx, rsp, rbp, r12 to r15.
const CALLEE_SAVED: [usize; 7] = [3, RSP, 5, 12, 13, 14, 15];

/// The number of a general register, by its 64-bit name.
fn number(register: Register) -> Option<usize> {
    let is_whole = (Register::RAX..=Register::R15).contains(&register);
    is_whole.then(|| register as usize - Register::RAX as usize)
}

/// The number of a general register, by any of its names.
fn written(register: Register) -> Option<usize> {
    let from = |first: Register, last: Register| {
        (first..=last).contains(&register).then(|| register as usize - first as usize)
    };
    // The lowest bytes of four, their second bytes, the lowest bytes of the others.
    let byte = from(Register::AL, Register::R15L).map(|n| if n < 4 { n } else { n - 4 });
    let word = from(Register::AX, Register::R15W).or_else(|| from(Register::EAX, Register::R15D));
    byte.or(word).or_else(|| number(register))
}

impl State {
    /// The state on entry.
    pub fn at_entry() -> State {
        let mut registers = [Word::unnamed(Fact::Number); 16];
        CALLEE_SAVED.iter().for_each(|saved| registers[*saved].fact = Fact::Caller(*saved));
        registers[number(Register::RDI).unwrap_or_default()].fact = Fact::Args;
        registers[RSP].fact = Fact::Stack(0);
        State { registers, kept: Vec::new(), saved: Vec::new(), frame: 0, alignment: 0, compared: None }
    }

    /// The join of two states at the instruction at `place`. Values that differ get a name made of the position of the first word
    /// with them, which no live value can have: words that are equal in both states remain equal.
    pub fn or(&self, other: &State, place: usize) -> State {
        let mut names: Vec<([u64; 2], u64)> = Vec::new();
        let mut joined = |a: &Word, b: &Word, at: i64| {
            let fact = a.fact.or(b.fact);
            if a.name == b.name {
                return Word { fact, name: a.name };
            }
            let (both, new) = ([a.name, b.name], 1 << 63 | (place as u64) << 32 | at as u32 as u64);
            let known = names.iter().find(|(names, _)| *names == both && !both.contains(&0));
            let name = known.map_or(new, |(_, name)| *name);
            names.push((both, name));
            Word { fact, name }
        };
        // Names of registers follow those of all frame offsets.
        let mut register = |i: usize| joined(&self.registers[i], &other.registers[i], i64::from(u32::MAX) - i as i64);
        let mut state = State {
            registers: std::array::from_fn(&mut register),
            kept: Vec::new(),
            saved: self.saved.iter().zip(&other.saved).map(|(a, b)| a.or(*b)).collect(),
            frame: self.frame,
            alignment: self.alignment,
            compared: None,
        };
        if (self.frame, self.alignment, self.saved.len()) == (other.frame, other.alignment, other.saved.len()) {
            let kept = self.kept.iter().filter_map(|(at, known)| Some((*at, joined(known, other.kept_at(*at)?, *at))));
            state.kept = kept.collect();
        } else {
            // Nothing is known of a stack that may be one of two.
            state.leave_frame();
            state.registers[RSP].fact = Fact::Number;
        }
        state
    }

    /// Drops the frame: addresses in it become numbers.
    fn leave_frame(&mut self) {
        self.frame = 0;
        self.kept.clear();
        let facts = self.registers.iter_mut().map(|known| &mut known.fact).chain(&mut self.saved);
        facts.filter(|fact| fact.is_in_frame()).for_each(|fact| *fact = Fact::Number);
    }

    /// The state on first reaching an instruction.
    pub fn before_all(&self) -> State {
        State { compared: None, ..self.clone() }
    }

    /// Applies the effect of the stack probe.
    pub fn forget_probe(&mut self) {
        self.registers[11] = Word::unnamed(Fact::Number);
        self.compared = None;
    }

    /// The word of a 64-bit register; a number for narrower ones.
    pub fn of(&self, register: Register) -> Word {
        number(register).map_or(Word::unnamed(Fact::Number), |number| self.registers[number])
    }

    /// Removes a name from all words, before another value gets it.
    fn free(&mut self, name: u64) {
        let all = self.registers.iter_mut().chain(self.kept.iter_mut().map(|(_, known)| known));
        all.filter(|known| known.name == name).for_each(|known| known.name = 0);
        let is_compared = |known: &[Word; 2]| known.iter().any(|known| known.name == name);
        self.compared = self.compared.filter(|compared| !is_compared(compared));
    }

    /// Sets a register; `name` applies if the word has none.
    pub fn set(&mut self, register: Register, known: Word, name: u64) -> Result<(), &'static str> {
        let Some(number) = written(register) else { return Ok(()) };
        let known = if known.name == 0 { self.named(known.fact, name) } else { known };
        self.registers[number] = known;
        if number != RSP {
            return Ok(());
        }
        match known.fact {
            Fact::Frame(at) if at.only() == Some(0) => Ok(()),
            Fact::Stack(_) | Fact::Aligned(_) => {
                self.leave_frame();
                Ok(())
            }
            _ => Err("loses the stack"),
        }
    }

    fn named(&mut self, fact: Fact, name: u64) -> Word {
        self.free(name);
        Word { fact, name }
    }

    /// Names a register's value, for its copies.
    pub fn name(&mut self, register: Register, name: u64) {
        if let Some(number) = number(register).filter(|number| self.registers[*number].name == 0) {
            self.registers[number] = self.named(self.registers[number].fact, name);
        }
    }

    pub fn rsp(&self) -> Fact {
        self.registers[RSP].fact
    }

    pub fn is_rsp(register: Register) -> bool {
        written(register) == Some(RSP)
    }

    pub fn frame(&self) -> i64 {
        self.frame
    }

    /// Whether the frame starts at a multiple of `bytes`; the caller's stack is at a multiple of 16 before the call.
    pub fn is_frame_aligned(&self, bytes: i64) -> bool {
        let below = WORD_BYTES * (self.saved.len() as i64 + 1);
        let (alignment, from) = if self.alignment > 0 { (self.alignment, 0) } else { (CALL_BYTES, below) };
        matches!(self.rsp(), Fact::Frame(_)) && alignment % bytes == 0 && (from + self.frame) % bytes == 0
    }

    /// Makes a frame of `bytes` bytes, or enlarges an unused one; returns the new stack pointer.
    pub fn grow(&mut self, bytes: i64) -> Result<Fact, &'static str> {
        let is_used = self.registers.iter().enumerate().any(|(i, known)| i != RSP && known.fact.is_in_frame());
        self.alignment = match self.rsp() {
            Fact::Aligned(alignment) => alignment,
            Fact::Stack(depth) if depth == self.saved.len() => 0,
            Fact::Frame(_) if self.kept.is_empty() && !is_used => self.alignment,
            _ => return Err("makes a second frame"),
        };
        let frame = self.frame + bytes;
        if bytes < 0 || frame > FRAME_BYTES_MAX {
            return Err("makes a frame that is too large");
        }
        self.frame = frame;
        Few::one(0).map(Fact::Frame).ok_or("makes no frame")
    }

    /// Releases a frame of `bytes` bytes; returns the new stack pointer.
    pub fn shrink(&self, bytes: i64) -> Fact {
        let is_all = matches!(self.rsp(), Fact::Frame(_)) && bytes == self.frame && self.alignment == 0;
        if is_all { Fact::Stack(self.saved.len()) } else { Fact::Number }
    }

    /// Whether the stack pointer is where it was before the frame.
    pub fn has_no_frame(&self) -> bool {
        self.rsp() == Fact::Stack(self.saved.len())
    }

    pub fn push(&mut self, register: Register) -> Result<(), &'static str> {
        if !self.has_no_frame() {
            return Err("pushes behind the beginning");
        }
        self.saved.push(self.of(register).fact);
        self.registers[RSP].fact = Fact::Stack(self.saved.len());
        Ok(())
    }

    pub fn pop(&mut self, register: Register, name: u64) -> Result<(), &'static str> {
        let fact = self.saved.pop().filter(|_| self.rsp() == Fact::Stack(self.saved.len() + 1));
        let fact = fact.ok_or("pops what was not pushed")?;
        self.registers[RSP].fact = Fact::Stack(self.saved.len());
        self.set(register, Word::unnamed(fact), name)
    }

    pub fn may_return(&self) -> Result<(), &'static str> {
        if self.rsp() != Fact::Stack(0) || !self.saved.is_empty() {
            return Err("returns with another stack than the caller's");
        }
        let is_kept = |saved: &usize| *saved == RSP || self.registers[*saved].fact == Fact::Caller(*saved);
        if CALLEE_SAVED.iter().all(is_kept) { Ok(()) } else { Err("returns with another register than the caller's") }
    }

    /// Forgets caller-saved registers after a call.
    pub fn forget_registers(&mut self) {
        for (number, known) in self.registers.iter_mut().enumerate() {
            if !CALLEE_SAVED.contains(&number) {
                *known = Word::unnamed(Fact::Number);
            }
        }
        self.compared = None;
    }

    fn kept_at(&self, at: i64) -> Option<&Word> {
        let place = self.kept.binary_search_by_key(&at, |(place, _)| *place).ok()?;
        Some(&self.kept[place].1)
    }

    /// The word in eight bytes of the frame, at any of the offsets.
    pub fn fetched(&self, places: &Few) -> Word {
        let mut each = places.each().map(|at| self.kept_at(at).copied().unwrap_or(Word::unnamed(Fact::Number)));
        match (places.only(), each.next()) {
            (Some(_), Some(known)) => known,
            (_, first) => {
                let facts = first.into_iter().chain(each).map(|known| known.fact);
                Word::unnamed(facts.reduce(Fact::or).unwrap_or(Fact::Number))
            }
        }
    }

    /// Stores `bytes` bytes to the frame: `known`, if they are eight.
    pub fn store(&mut self, places: &Few, bytes: i64, known: Option<Word>) {
        for at in places.each() {
            let before = self.kept_at(at).copied();
            let first = self.kept.partition_point(|(place, _)| *place <= at - WORD_BYTES);
            let count = self.kept[first..].iter().take_while(|(place, _)| *place < at + bytes).count();
            self.kept.drain(first..first + count);
            let now = match places.only() {
                Some(_) => known,
                // At one of several offsets: the old word may still be there.
                None => known.zip(before).map(|(known, before)| Word::unnamed(known.fact.or(before.fact))),
            };
            if let Some(known) = now {
                self.kept.insert(first, (at, known));
            }
        }
    }

    /// If the last comparison satisfies `asked`: the name of the smaller number, and its fact.
    fn bound(&self, asked: Asked) -> Option<(u64, Fact)> {
        let [left, right] = self.compared?;
        let (less, more) = if asked.is_left_less { (left, right) } else { (right, left) };
        let bound = if asked.is_strict { more.fact.bounds_less() } else { more.fact.bounds_equal() };
        Some((less.name, bound?)).filter(|(name, _)| *name != 0)
    }

    /// The fact of a number under that condition.
    pub fn under(&self, asked: Asked, known: Word) -> Fact {
        match self.bound(asked) {
            Some((name, bound)) if name == known.name => known.fact.and(bound),
            _ => known.fact,
        }
    }

    /// Refines all words by a condition that holds.
    pub fn learn(&mut self, asked: Asked) {
        let Some((name, bound)) = self.bound(asked) else { return };
        let all = self.registers.iter_mut().chain(self.kept.iter_mut().map(|(_, known)| known));
        all.filter(|known| known.name == name).for_each(|known| known.fact = known.fact.and(bound));
    }
}

#[cfg(test)]
#[path = "claims_tests.rs"]
pub(super) mod claims;
