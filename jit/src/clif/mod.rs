//! Translates vector code to CLIF, the compiler's input, for vectors of 128 bits on every processor.
//!
//! The function takes one argument, the address of [`Args`](crate::abi::Args). Variables of the code become variables of the
//! function: the compiler finds their registers. A vector in memory is loaded for each of its readers, so that the load becomes
//! that instruction's memory operand.

mod acts;
mod computed;
mod integers;

use std::collections::BTreeMap;

use cranelift_codegen::ir::{
    self, AbiParam, Endianness, Function, InstBuilder, MemFlagsData, Signature, SourceLoc, StackSlotData,
    StackSlotKind, UserFuncName, types,
};
use cranelift_codegen::isa::TargetIsa;
use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext, Variable};
use isophote_symbolic::{Precision, Program};

use crate::nest;
use crate::options::{KernelOptions, VectorWidth};
use crate::vector::{Anchor, Integer, MemoryPlace, Piece};

/// The frame and the lists of arguments: aligned, never faults.
const RECORD: MemFlagsData = MemFlagsData::trusted();
/// Of any alignment; pixels are inside their plane by construction.
const PIXELS: MemFlagsData = MemFlagsData::new().with_notrap();
const VECTOR_BYTES: usize = 16;

/// How a check knows the bounds of indices in the frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Bounds {
    /// By the branches before, as the verifier of machine code.
    Branches,
    /// By minima, as [`crate::addresses`].
    Minima,
}

/// The function of `program`, for `isa`'s calling convention.
pub(crate) fn function(program: &Program, options: &KernelOptions, isa: &dyn TargetIsa, bounds: Bounds) -> Function {
    let (code, mut frame) = nest::code(program, options);
    let arguments = [(); 2].map(|()| frame.take(VECTOR_BYTES, VECTOR_BYTES));
    let mut signature = Signature::new(isa.default_call_conv());
    signature.params.push(AbiParam::new(types::I64));
    let mut function = Function::with_name_signature(UserFuncName::default(), signature);
    let mut context = FunctionBuilderContext::new();
    let mut b = FunctionBuilder::new(&mut function, &mut context);
    let entry = b.create_block();
    b.append_block_params_for_function_params(entry);
    b.switch_to_block(entry);
    b.seal_block(entry);
    // Source locations are stored relative to the base; with base 0 none of them equals the default ("no location").
    b.func.params.ensure_base_srcloc(SourceLoc::new(0));
    let slot = StackSlotData::new(StackSlotKind::ExplicitSlot, frame.bytes() as u32, VECTOR_BYTES.ilog2() as u8);
    let slot = b.create_sized_stack_slot(slot);
    let frame = b.ins().stack_addr(types::I64, slot, 0);
    let args = b.block_params(entry)[0];
    let number = match options.precision {
        Precision::F32 => types::F32X4,
        Precision::F64 => types::F64X2,
    };
    let variables = INTEGERS.map(|_| b.declare_var(types::I64));
    let residents = std::array::from_fn(|_| b.declare_var(number));
    let labels = (0..code.labels).map(|_| b.create_block()).collect();
    let mut translator = Translator {
        b,
        bounds,
        number,
        frame,
        args,
        pool: &code.constants.bytes,
        arguments,
        variables,
        residents,
        labels,
        is_open: true,
        sums: BTreeMap::new(),
        copies: BTreeMap::new(),
    };
    for piece in &code.pieces {
        match piece {
            Piece::Integers(integers) => translator.integers(integers),
            Piece::Vectors { acts, givens, .. } => translator.block(acts, givens),
        }
    }
    translator.b.ins().return_(&[]);
    translator.b.seal_all_blocks();
    translator.b.finalize(isa.frontend_config());
    function
}

/// Every variable but the address of the argument block, which never changes.
const INTEGERS: [Integer; 15] = [
    Integer::Pixel,
    Integer::Begin,
    Integer::Furthest,
    Integer::Row,
    Integer::Block,
    Integer::Sum,
    Integer::Address(0),
    Integer::Address(1),
    Integer::Address(2),
    Integer::Address(3),
    Integer::A,
    Integer::B,
    Integer::C,
    Integer::D,
    Integer::E,
];
/// Vectors that outlive blocks.
const RESIDENTS: usize = 16;

struct Translator<'t> {
    b: FunctionBuilder<'t>,
    bounds: Bounds,
    /// A vector of pixels.
    number: ir::Type,
    /// The addresses of the frame and of the argument block.
    frame: ir::Value,
    args: ir::Value,
    pool: &'t [u8],
    /// Two vectors that are passed to functions.
    arguments: [MemoryPlace; 2],
    /// By the order of [`INTEGERS`].
    variables: [Variable; INTEGERS.len()],
    residents: [Variable; RESIDENTS],
    labels: Vec<ir::Block>,
    /// Whether control reaches what comes next.
    is_open: bool,
    /// Bases plus scaled indices, since the last label.
    sums: BTreeMap<(ir::Value, ir::Value, u32), ir::Value>,
    /// Elements that the block copies to the frame, by offset. It alone reads them, so that they are not stored.
    copies: BTreeMap<i32, ir::Value>,
}

impl Translator<'_> {
    /// The base and the offset of a place.
    fn address(&mut self, place: MemoryPlace) -> (ir::Value, i32) {
        let base = match place.base {
            Anchor::Frame => self.frame,
            Anchor::At(variable) => self.integer(variable),
            Anchor::Pool => unreachable!("constants are part of instructions"),
        };
        let Some((index, scale)) = place.index else { return (base, place.offset) };
        let index = self.integer(index);
        let known = self.sums.get(&(base, index, scale)).copied();
        let sum = known.unwrap_or_else(|| {
            let distance = self.b.ins().ishl_imm_u(index, i64::from(scale.ilog2()));
            self.b.ins().iadd(base, distance)
        });
        self.sums.insert((base, index, scale), sum);
        (sum, place.offset)
    }

    fn flags(place: MemoryPlace) -> MemFlagsData {
        let is_aligned =
            place.index.is_none() && place.base == Anchor::Frame && place.offset % VECTOR_BYTES as i32 == 0;
        if is_aligned { RECORD } else { PIXELS }
    }

    fn load(&mut self, kind: ir::Type, place: MemoryPlace) -> ir::Value {
        let (base, offset) = self.address(place);
        self.b.ins().load(kind, Translator::flags(place), base, offset)
    }

    fn store(&mut self, value: ir::Value, place: MemoryPlace) {
        let (base, offset) = self.address(place);
        self.b.ins().store(Translator::flags(place), value, base, offset);
    }

    /// The same bits as another vector type.
    fn cast(&mut self, kind: ir::Type, value: ir::Value) -> ir::Value {
        if self.b.func.dfg.value_type(value) == kind {
            return value;
        }
        self.b.ins().bitcast(kind, MemFlagsData::new().with_endianness(Endianness::Little), value)
    }
}

const _: () = assert!(VectorWidth::Bits128.bytes() == VECTOR_BYTES && VectorWidth::Bits128.registers() == RESIDENTS);
