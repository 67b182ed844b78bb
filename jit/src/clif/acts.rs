//! Translates blocks of vector operations.

use std::collections::BTreeMap;
use std::mem::offset_of;

use cranelift_codegen::ir::{self, AbiParam, BlockArg, InstBuilder, Signature, SourceLoc, types};
use cranelift_frontend::FunctionBuilder;
use isophote_symbolic::Value;
use smallvec::SmallVec;

use super::{PIXELS, RECORD, Translator, VECTOR_BYTES};
use crate::abi::Args;
use crate::vector::{Act, Anchor, Element, Given, Id, Integer, MemoryPlace, Portion};

/// The vectors of a block.
pub(super) struct Vectors<'b> {
    givens: &'b [Given],
    /// The values that acts have computed.
    values: Vec<Option<ir::Value>>,
    /// The addresses of the lanes' table cells.
    cells: BTreeMap<Id, [ir::Value; 2]>,
    /// Constants that are moved or stored as they are.
    stored: BTreeMap<Id, ir::Value>,
}

/// The vector types of numbers and of bits.
pub(super) fn numbers(element: Element) -> ir::Type {
    match element {
        Element::Single => types::F32X4,
        Element::Double => types::F64X2,
    }
}
pub(super) fn bits(element: Element) -> ir::Type {
    match element {
        Element::Single => types::I32X4,
        Element::Double => types::I64X2,
    }
}

impl Vectors<'_> {
    /// Whether reading it takes a load.
    pub fn is_in_memory(&self, id: Id) -> bool {
        self.values[id.index()].is_none() && self.givens[id.index()].register.is_none()
    }

    pub fn memory(&self, id: Id) -> MemoryPlace {
        match self.givens[id.index()].memory {
            Some(memory) => memory,
            None => unreachable!("a value is made before it is read"),
        }
    }

    /// The type of a computed vector.
    pub fn kind(&self, b: &FunctionBuilder<'_>, id: Id) -> Option<ir::Type> {
        self.values[id.index()].map(|value| b.func.dfg.value_type(value))
    }

    pub fn learn(&mut self, id: Id, value: ir::Value) {
        self.values[id.index()] = Some(value);
    }
}

impl Translator<'_> {
    /// Translates a block.
    pub fn block(&mut self, acts: &[(Act, Option<Value>)], givens: &[Given]) {
        self.copies.clear();
        let mut vectors =
            Vectors { givens, values: vec![None; givens.len()], cells: BTreeMap::new(), stored: BTreeMap::new() };
        for (act, source) in acts {
            self.b.set_srcloc(source.map_or(SourceLoc::default(), |value| SourceLoc::new(value.0)));
            self.act(act, &mut vectors);
        }
        self.b.set_srcloc(SourceLoc::default());
    }

    /// A vector as `kind`.
    pub fn vector(&mut self, vectors: &Vectors<'_>, id: Id, kind: ir::Type) -> ir::Value {
        let value = match (vectors.values[id.index()], vectors.givens[id.index()].register) {
            (Some(value), _) => value,
            (None, Some(register)) => self.b.use_var(self.residents[usize::from(register)]),
            (None, None) => self.loaded(vectors.memory(id), kind),
        };
        self.cast(kind, value)
    }

    /// A vector of memory, or of the constants.
    pub fn loaded(&mut self, place: MemoryPlace, kind: ir::Type) -> ir::Value {
        if place.base == Anchor::Pool {
            let start = place.offset as usize;
            let bytes = self.pool[start..start + VECTOR_BYTES].to_vec();
            let constant = self.b.func.dfg.constants.insert(bytes.into());
            return self.b.ins().vconst(kind, constant);
        }
        if let Some(copied) = self.copied(place, kind) {
            return copied;
        }
        if place.is_spread {
            let lane = self.load(kind.lane_type(), place);
            return self.b.ins().splat(kind, lane);
        }
        self.load(kind, place)
    }

    fn act(&mut self, act: &Act, vectors: &mut Vectors<'_>) {
        match act {
            Act::Compute { operation, element, result, operands } => {
                let value = self.computed(vectors, *operation, *element, operands);
                vectors.learn(*result, value);
            }
            Act::Move { variable, operand, .. } => {
                let value = self.whole(vectors, *operand, self.number);
                self.assign(vectors, *variable, value);
            }
            Act::Sum { variable, element, terms, used } => {
                let kind = numbers(*element);
                let terms: SmallVec<[ir::Value; 2]> = self.factors(vectors, terms, kind);
                let used = used.map(|used| self.vector(vectors, used, kind));
                let old = self.vector(vectors, *variable, kind);
                let new = match (&terms[..], used) {
                    (&[a, b], None) => self.b.ins().fma(a, b, old),
                    (&[a, b], Some(used)) => {
                        let new = self.b.ins().fma(a, b, old);
                        self.b.ins().bitselect(used, new, old)
                    }
                    (_, None) => self.b.ins().fadd(old, terms[0]),
                    // A sum starts with 0, so that it is never −0, which 0 would change.
                    (_, Some(used)) => {
                        let term = self.b.ins().band(terms[0], used);
                        self.b.ins().fadd(old, term)
                    }
                };
                self.assign(vectors, *variable, new);
            }
            Act::Store { operand, extent, element, memory } => {
                let value = match extent {
                    Portion::Whole => self.whole(vectors, *operand, numbers(*element)),
                    Portion::Half => self.first(vectors, *operand, types::F64X2),
                    Portion::Least => self.first(vectors, *operand, numbers(*element)),
                };
                self.store(value, *memory);
            }
            Act::Call { element, offset, operands, result } => {
                let kind = numbers(*element);
                let operands: SmallVec<[ir::Value; 2]> =
                    operands.iter().map(|id| self.vector(vectors, *id, kind)).collect();
                let value = self.call(*offset, &operands);
                vectors.learn(*result, value);
            }
            Act::Rare { truth, usual, x, offset, result } => {
                let value = self.rare(vectors, [*truth, *usual, *x], *offset);
                vectors.learn(*result, value);
            }
            Act::Gather { cells, bound, offset, result } => {
                let value = self.gather(vectors, [*cells, *bound], *offset);
                vectors.learn(*result, value);
            }
            Act::Truths { operand, element } => {
                let truth = self.vector(vectors, *operand, bits(*element));
                let lanes = self.b.ins().vhigh_bits(types::I64, truth);
                self.set(Integer::A, lanes);
            }
            Act::Integers(integers) => self.integers(integers),
        }
    }

    /// A vector to move or to store. Constants are loaded once.
    fn whole(&mut self, vectors: &mut Vectors<'_>, id: Id, kind: ir::Type) -> ir::Value {
        let known = vectors.stored.get(&id).copied();
        let value = known.unwrap_or_else(|| self.vector(vectors, id, kind));
        if vectors.is_in_memory(id) && vectors.memory(id).base == Anchor::Pool {
            vectors.stored.insert(id, value);
        }
        self.cast(kind, value)
    }

    /// The first lane.
    fn first(&mut self, vectors: &Vectors<'_>, id: Id, kind: ir::Type) -> ir::Value {
        let value = self.vector(vectors, id, kind);
        self.b.ins().extractlane(value, 0)
    }

    /// Sets a variable.
    fn assign(&mut self, vectors: &Vectors<'_>, variable: Id, value: ir::Value) {
        match vectors.givens[variable.index()].register {
            Some(register) => {
                let value = self.cast(self.number, value);
                self.b.def_var(self.residents[usize::from(register)], value);
            }
            None => self.store(value, vectors.memory(variable)),
        }
    }

    /// Operands of a product or a sum, one in memory last, where an instruction can fetch it.
    pub fn factors(&mut self, vectors: &Vectors<'_>, ids: &[Id], kind: ir::Type) -> SmallVec<[ir::Value; 2]> {
        match *ids {
            [a, b] if vectors.is_in_memory(a) && !vectors.is_in_memory(b) => {
                [b, a].iter().map(|id| self.vector(vectors, *id, kind)).collect()
            }
            _ => ids.iter().map(|id| self.vector(vectors, *id, kind)).collect(),
        }
    }

    /// Calls the function at byte `offset` of the table, which leaves its result in the place of its first operand.
    fn call(&mut self, offset: i32, operands: &[ir::Value]) -> ir::Value {
        let kind = self.b.func.dfg.value_type(operands[0]);
        let places = self.arguments;
        let mut signature = Signature::new(self.b.func.signature.call_conv);
        signature.params.resize(operands.len(), AbiParam::new(types::I64));
        let mut addresses: SmallVec<[ir::Value; 2]> = SmallVec::new();
        for (operand, place) in operands.iter().zip(places) {
            self.store(*operand, place);
            addresses.push(self.b.ins().iadd_imm_s(self.frame, i64::from(place.offset)));
        }
        let signature = self.b.import_signature(signature);
        let table = self.b.ins().load(types::I64, RECORD, self.args, offset_of!(Args, functions) as i32);
        let function = self.b.ins().load(types::I64, RECORD, table, offset);
        self.b.ins().call_indirect(signature, function, &addresses);
        self.load(kind, places[0])
    }

    /// A call in a cold block, skipped unless a lane needs it.
    fn rare(&mut self, vectors: &Vectors<'_>, [truth, usual, x]: [Id; 3], offset: i32) -> ir::Value {
        let truth = self.vector(vectors, truth, types::I64X2);
        let [usual, x] = [usual, x].map(|id| self.vector(vectors, id, types::F64X2));
        let (rare, after) = (self.b.create_block(), self.b.create_block());
        self.b.set_cold_block(rare);
        let value = self.b.append_block_param(after, types::F64X2);
        let any = self.b.ins().vhigh_bits(types::I32, truth);
        self.b.ins().brif(any, rare, &[], after, &[BlockArg::from(usual)]);
        self.b.switch_to_block(rare);
        self.b.seal_block(rare);
        let called = self.call(offset, &[x]);
        let truth = self.cast(types::F64X2, truth);
        let picked = self.b.ins().bitselect(truth, called, usual);
        self.b.ins().jump(after, &[BlockArg::from(picked)]);
        self.b.switch_to_block(after);
        self.b.seal_block(after);
        value
    }

    /// A table number per lane, `offset` bytes after the start of its cell.
    fn gather(&mut self, vectors: &mut Vectors<'_>, [cells, bound]: [Id; 2], offset: i32) -> ir::Value {
        let addresses = match vectors.cells.get(&cells) {
            Some(addresses) => *addresses,
            None => {
                let addresses = self.cells(vectors, [cells, bound]);
                *vectors.cells.entry(cells).or_insert(addresses)
            }
        };
        let [low, high] = addresses.map(|address| self.b.ins().load(types::F64, RECORD, address, offset));
        let low = self.b.ins().scalar_to_vector(types::F64X2, low);
        self.b.ins().insertlane(low, high, 1)
    }

    fn cells(&mut self, vectors: &Vectors<'_>, [cells, bound]: [Id; 2]) -> [ir::Value; 2] {
        let start = vectors.memory(bound).offset as usize;
        let bound = self.pool[start..].first_chunk().map_or(0, |bytes| i64::from_le_bytes(*bytes));
        let cells = self.vector(vectors, cells, types::I64X2);
        [0, 1].map(|lane| {
            let cell = self.b.ins().extractlane(cells, lane);
            let last = self.b.ins().iconst(types::I64, bound);
            let cell = self.b.ins().umin(cell, last);
            let distance = self.b.ins().ishl_imm_u(cell, i64::from(size_of::<f64>().ilog2()));
            let base = self.b.ins().load(types::I64, RECORD, self.args, offset_of!(Args, tables) as i32);
            self.b.ins().iadd(base, distance)
        })
    }

    /// Whether the block copied elements to a place.
    pub fn has_copied(&self, place: MemoryPlace) -> bool {
        place.base == Anchor::Frame && place.index.is_none() && self.copies.contains_key(&place.offset)
    }

    /// The elements that the block copied to a place, as many as there are from there on.
    pub fn copied(&mut self, place: MemoryPlace, kind: ir::Type) -> Option<ir::Value> {
        if !self.has_copied(place) {
            return None;
        }
        let after = place.offset + VECTOR_BYTES as i32;
        let lanes: SmallVec<[ir::Value; 4]> = self.copies.range(place.offset..after).map(|(_, lane)| *lane).collect();
        let first = *lanes.first()?;
        let all =
            self.b.func.dfg.value_type(first).by(VECTOR_BYTES as u32 * 8 / self.b.func.dfg.value_type(first).bits())?;
        let mut vector = self.b.ins().scalar_to_vector(all, first);
        for (lane, element) in lanes.iter().enumerate().skip(1).take(all.lane_count() as usize - 1) {
            vector = self.b.ins().insertlane(vector, *element, lane as u8);
        }
        Some(self.cast(kind, vector))
    }

    /// Half a vector of memory, in the lower half.
    pub fn half(&mut self, place: MemoryPlace, kind: ir::Type) -> ir::Value {
        if let Some(copied) = self.copied(place, kind) {
            return copied;
        }
        let (base, offset) = self.address(place);
        let half = self.b.ins().load(types::F64, PIXELS, base, offset);
        let half = self.b.ins().scalar_to_vector(types::F64X2, half);
        self.cast(kind, half)
    }
}
