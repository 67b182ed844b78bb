//! Blocks of vector operations.
//!
//! A value is assigned once; a *variable* outlives the block and is changed in place.

use std::collections::BTreeMap;

use isophote_symbolic::Value;
use smallvec::SmallVec;

use super::code::Constants;
use super::integers::Integers;
use super::operation::{Element, Operation, Portion, comparison};
use super::place::MemoryPlace;
use crate::options::VectorWidth;

/// A vector of a block.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Id(pub u32);

impl Id {
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Location of a vector that a block does not compute.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Resident {
    /// The register that holds it while the block runs.
    pub register: Option<u8>,
    pub memory: MemoryPlace,
}

/// Initial location of a vector.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Given {
    pub register: Option<u8>,
    pub memory: Option<MemoryPlace>,
    /// Its memory changes: no register may cache it.
    pub is_fleeting: bool,
}

/// An operation of a block.
#[derive(Clone, Debug)]
pub(crate) enum Act {
    /// Computes a value.
    Compute { operation: Operation, element: Element, result: Id, operands: SmallVec<[Id; 3]> },
    /// Sets a variable that a register holds.
    Move { variable: Id, element: Element, operand: Id },
    /// Adds to a variable a term, or the product of two, in the lanes where `used` holds; `None`: in all.
    Sum { variable: Id, element: Element, terms: SmallVec<[Id; 2]>, used: Option<Id> },
    /// Writes memory.
    Store { operand: Id, extent: Portion, element: Element, memory: MemoryPlace },
    /// Calls the function of the table, a few lanes at a time.
    Call { element: Element, offset: i32, operands: SmallVec<[Id; 2]>, result: Id },
    /// Loads a table number per lane, `offset` bytes after the start of its cell; `bound` is the start of the last cell.
    Gather { cells: Id, bound: Id, offset: i32, result: Id },
    /// `truth ? function(x) : usual`, out of line since `truth` rarely holds.
    Rare { truth: Id, usual: Id, x: Id, offset: i32, result: Id },
    /// Moves the truth of each lane to a bit of [`Integer::A`](super::Integer::A).
    Truths { operand: Id, element: Element },
    /// Operations on integers, which read no vectors.
    Integers(Integers),
}

/// A block under construction. Control may leave it, but never enters it.
pub(crate) struct Block<'a> {
    pool: &'a mut Constants,
    pub width: VectorWidth,
    pub acts: Vec<(Act, Option<Value>)>,
    pub givens: Vec<Given>,
    constants: BTreeMap<Vec<u8>, Id>,
    /// The operands of `less` comparisons, by result.
    pub less: BTreeMap<Id, [Id; 2]>,
    /// The lanes' cells of a table, by table and positions.
    pub cells: BTreeMap<(u16, [Id; 2]), SmallVec<[Id; 2]>>,
    value: Option<Value>,
}

impl<'a> Block<'a> {
    pub fn new(pool: &'a mut Constants, width: VectorWidth) -> Block<'a> {
        let (constants, less, cells) = Default::default();
        Block { pool, width, acts: Vec::new(), givens: Vec::new(), constants, less, cells, value: None }
    }

    /// The operations, and the initial locations of the vectors.
    pub fn into_parts(self) -> (Vec<(Act, Option<Value>)>, Vec<Given>) {
        (self.acts, self.givens)
    }

    /// Attributes the next acts to `value`.
    pub fn set_source(&mut self, value: Option<Value>) {
        self.value = value;
    }

    pub fn act(&mut self, act: Act) {
        self.acts.push((act, self.value));
    }

    fn id(&mut self, given: Given) -> Id {
        self.givens.push(given);
        Id(self.givens.len() as u32 - 1)
    }

    /// A value for an act to compute.
    pub fn new_value(&mut self) -> Id {
        self.id(Given::default())
    }

    /// A value that memory holds while the block runs.
    pub fn kept(&mut self, memory: MemoryPlace) -> Id {
        self.id(Given { memory: Some(memory), ..Given::default() })
    }

    /// A value read from memory at each use.
    pub fn fleeting(&mut self, memory: MemoryPlace) -> Id {
        self.id(Given { memory: Some(memory), is_fleeting: true, ..Given::default() })
    }

    /// A value that outlives the block.
    pub fn held(&mut self, held: Resident) -> Id {
        self.id(Given { register: held.register, memory: Some(held.memory), is_fleeting: false })
    }

    /// A variable that outlives the block.
    pub fn variable(&mut self, held: Resident) -> Id {
        self.id(Given { register: held.register, memory: Some(held.memory), is_fleeting: true })
    }

    /// The same bytes in every lane: at 256 bits a whole vector, at 512 one element to broadcast.
    pub fn constant_bytes(&mut self, element: &[u8]) -> Id {
        let bytes = match self.width {
            VectorWidth::Bits512 => element.to_vec(),
            _ => element.repeat(self.width.bytes() / element.len()),
        };
        let is_spread = self.width == VectorWidth::Bits512;
        self.constant_of(bytes, is_spread)
    }

    /// A vector with a constant per lane.
    pub fn constant_lanes(&mut self, element: Element, lane: impl Fn(usize) -> f64) -> Id {
        let lanes = 0..self.width.bytes() / element.bytes();
        self.constant_of(lanes.flat_map(|i| bytes(element, lane(i))).collect(), false)
    }

    fn constant_of(&mut self, bytes: Vec<u8>, is_spread: bool) -> Id {
        if let Some(id) = self.constants.get(&bytes) {
            return *id;
        }
        let memory = MemoryPlace { is_spread, ..self.pool.place(&bytes) };
        let id = self.kept(memory);
        self.constants.insert(bytes, id);
        id
    }

    /// A number in every lane, rounded to the element.
    pub fn number(&mut self, element: Element, number: f64) -> Id {
        self.constant_bytes(&bytes(element, number))
    }

    /// Whether it is +0 in every lane.
    pub fn is_zero(&self, element: Element, id: Id) -> bool {
        let element = bytes(element, 0.0);
        let copies = if self.width == VectorWidth::Bits512 { 1 } else { self.width.bytes() / element.len() };
        self.constants.get(&element.repeat(copies)) == Some(&id)
    }

    /// A pattern of bits in every lane of f64.
    pub fn pattern(&mut self, bits: u64) -> Id {
        self.constant_bytes(&bits.to_le_bytes())
    }

    /// The sign bit in every lane.
    pub fn sign(&mut self, element: Element) -> Id {
        self.number(element, -0.0)
    }

    pub fn compute<const N: usize>(&mut self, operation: Operation, element: Element, operands: [Id; N]) -> Id {
        let result = self.new_value();
        if let (Operation::Compare(comparison::LESS), &[a, b]) = (operation, &operands[..]) {
            self.less.insert(result, [a, b]);
        }
        self.act(Act::Compute { operation, element, result, operands: operands.into_iter().collect() });
        result
    }

    /// All bits but the sign bit, in every lane.
    pub fn magnitude(&mut self, element: Element) -> Id {
        match element {
            Element::Single => self.constant_bytes(&(u32::MAX >> 1).to_le_bytes()),
            Element::Double => self.pattern(u64::MAX >> 1),
        }
    }

    /// Inverts all bits.
    pub fn not(&mut self, element: Element, truth: Id) -> Id {
        let all = self.constant_bytes(&u64::MAX.to_le_bytes()[..element.bytes()]);
        self.compute(Operation::Xor, element, [truth, all])
    }

    /// Adds a term, or the product of two, to a variable, where `used` holds.
    pub fn sum(&mut self, variable: Id, element: Element, terms: SmallVec<[Id; 2]>, used: Option<Id>) {
        self.act(Act::Sum { variable, element, terms, used });
    }

    pub fn store(&mut self, element: Element, extent: Portion, operand: Id, memory: MemoryPlace) {
        self.act(Act::Store { operand, extent, element, memory });
    }

    /// Sets a vector that outlives the block.
    pub fn set(&mut self, element: Element, held: Resident, operand: Id) {
        match held.register {
            Some(_) => {
                let variable = self.variable(held);
                self.act(Act::Move { variable, element, operand });
            }
            None => self.store(element, Portion::Whole, operand, held.memory),
        }
    }

    /// Operations on integers.
    pub fn integers(&mut self, make: impl FnOnce(&mut Integers)) {
        let mut integers = Integers::default();
        make(&mut integers);
        self.act(Act::Integers(integers));
    }
}

/// The bytes of a number as an element.
fn bytes(element: Element, number: f64) -> Vec<u8> {
    match element {
        Element::Single => (number as f32).to_le_bytes().to_vec(),
        Element::Double => number.to_le_bytes().to_vec(),
    }
}
