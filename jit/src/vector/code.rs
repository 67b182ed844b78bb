//! The code of a kernel before a backend translates it.

use std::collections::BTreeMap;

use isophote_symbolic::Value;

use super::block::{Act, Given};
use super::integers::{Integers, Label};
use super::place::{Anchor, MemoryPlace};

/// A part of the code.
pub(crate) enum Piece {
    Integers(Integers),
    Vectors {
        /// The operations, each with the value of the program that it is for.
        acts: Vec<(Act, Option<Value>)>,
        /// The initial locations of its vectors.
        givens: Vec<Given>,
        /// Registers that outlive the block, as bits: it touches them only as its residents.
        reserved: u32,
    },
}

/// The code under construction; control enters at the start and leaves at the end.
#[derive(Default)]
pub(crate) struct VectorCode {
    pub pieces: Vec<Piece>,
    pub constants: Constants,
    pub labels: usize,
}

/// Constants, each at a multiple of its size; equal constants share a place.
#[derive(Default)]
pub(crate) struct Constants {
    pub bytes: Vec<u8>,
    places: BTreeMap<Vec<u8>, i32>,
}

impl Constants {
    /// The location of a constant.
    pub fn place(&mut self, bytes: &[u8]) -> MemoryPlace {
        let offset = *self.places.entry(bytes.to_vec()).or_insert_with(|| {
            let start = self.bytes.len().next_multiple_of(bytes.len());
            self.bytes.resize(start, 0);
            self.bytes.extend(bytes);
            start as i32
        });
        MemoryPlace::new(Anchor::Pool, offset)
    }
}

impl VectorCode {
    pub fn new_label(&mut self) -> Label {
        self.labels += 1;
        Label(self.labels - 1)
    }

    /// Appends the operations of `make`.
    pub fn write(&mut self, make: impl FnOnce(&mut Integers)) {
        let mut integers = Integers::default();
        make(&mut integers);
        self.pieces.push(Piece::Integers(integers));
    }

    /// Appends a block.
    pub fn append(&mut self, (acts, givens): (Vec<(Act, Option<Value>)>, Vec<Given>), reserved: u32) {
        self.pieces.push(Piece::Vectors { acts, givens, reserved });
    }
}
