//! `Emitter`: the function under construction, and access to the record.

use std::collections::BTreeMap;

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{
    self, Block, BlockArg, Endianness, InstBuilder, MemFlagsData, SigRef, SourceLoc, StackSlot, StackSlotData,
    StackSlotKind, types,
};
use cranelift_codegen::isa::{TargetFrontendConfig, TargetIsa};
use cranelift_frontend::FunctionBuilder;
use isophote_symbolic::{Level, Op, Precision, Value};

use super::elementary;
use crate::options::KernelOptions;
use crate::plan::{Area, Plan, Slot};

/// Byte offsets of [`crate::abi::Args`].
pub(super) mod arg {
    use crate::abi::Args;
    use std::mem::offset_of;
    pub const INPUTS: i32 = offset_of!(Args, inputs) as i32;
    pub const OUTPUTS: i32 = offset_of!(Args, outputs) as i32;
    pub const FUNCTIONS: i32 = offset_of!(Args, functions) as i32;
    pub const PLANES: i32 = offset_of!(Args, planes) as i32;
    pub const TABLES: i32 = offset_of!(Args, tables) as i32;
    pub const TARGET: i32 = offset_of!(Args, target) as i32;
    pub const X: i32 = offset_of!(Args, x) as i32;
    pub const Y: i32 = offset_of!(Args, y) as i32;
    pub const WIDTH: i32 = offset_of!(Args, width) as i32;
    pub const HEIGHT: i32 = offset_of!(Args, height) as i32;
    pub const Z: i32 = offset_of!(Args, z) as i32;
    pub const W: i32 = offset_of!(Args, w) as i32;
    pub const DEPTH: i32 = offset_of!(Args, depth) as i32;
    pub const LENGTH: i32 = offset_of!(Args, length) as i32;
    pub const FURTHEST: i32 = offset_of!(Args, furthest) as i32;
    pub const LAST: i32 = offset_of!(Args, last) as i32;
    pub const LAST_ROW: i32 = offset_of!(Args, last_row) as i32;
    pub const TARGET_STRIDE: i32 = offset_of!(Args, target_stride) as i32;
    pub const PIXELS: i32 = offset_of!(Args, pixels) as i32;
    pub const SATURATED: i32 = offset_of!(Args, saturated) as i32;
}

pub(super) struct Emitter<'a, 'p> {
    pub b: FunctionBuilder<'a>,
    pub plan: &'p Plan<'p>,
    pub options: &'p KernelOptions,
    /// The vector types of a group's numbers (4 × f32 or 2 × f64) and of its truth values.
    pub number: ir::Type,
    pub truth: ir::Type,
    /// The results of the level being emitted, by value.
    pub results: Vec<Option<ir::Value>>,
    /// Vectors held in registers during a row's loop, by value.
    pub held: Vec<Option<ir::Value>>,
    /// Pixel count of the row at its end, or of the pass at its end.
    pub count: Option<ir::Value>,
    /// Accumulators at the end of the row; `None` if in the record.
    pub sums: Vec<Option<ir::Value>>,
    /// Of the row, by channel: the address of the window's first pixel and, unless packed, the pixel stride.
    pub rows: Vec<Option<(ir::Value, Option<ir::Value>)>>,
    /// The address of the row of the output plane.
    pub target: Option<ir::Value>,
    /// The addresses of the rows' areas.
    pub areas: Option<Areas>,
    /// The addresses of the lanes' table cells, by block, table and position.
    pub cell_addresses: BTreeMap<(Option<Block>, u16, [ir::Value; 2]), Vec<ir::Value>>,
    record: StackSlot,
    /// The addresses of the record and of the argument block.
    bases: Option<[ir::Value; 2]>,
    pub frontend: TargetFrontendConfig,
    /// Whether elementary functions of the pixel level are inlined as vector code; else they are called.
    pub inlined: bool,
    signatures: [Option<SigRef>; 4],
}

/// The record: aligned, never faults.
pub(super) const RECORD: MemFlagsData = MemFlagsData::trusted();
/// Pixels: inside their plane by construction, of any alignment.
pub(super) const PIXELS: MemFlagsData = MemFlagsData::new().with_notrap();

impl<'a, 'p> Emitter<'a, 'p> {
    pub fn new(
        mut b: FunctionBuilder<'a>,
        plan: &'p Plan<'p>,
        options: &'p KernelOptions,
        isa: &dyn TargetIsa,
    ) -> Self {
        let slot = StackSlotData::new(StackSlotKind::ExplicitSlot, plan.pass_bytes + 2 * plan.rows_bytes, 4);
        let record = b.create_sized_stack_slot(slot);
        let (number, truth) = match options.precision {
            Precision::F32 => (types::F32X4, types::I32X4),
            Precision::F64 => (types::F64X2, types::I64X2),
        };
        let count = plan.program.instructions().len();
        Emitter {
            b,
            plan,
            options,
            number,
            truth,
            results: vec![None; count],
            held: vec![None; count],
            count: None,
            sums: Vec::new(),
            rows: vec![None; plan.program.channels()],
            target: None,
            areas: None,
            cell_addresses: BTreeMap::new(),
            record,
            bases: None,
            frontend: isa.frontend_config(),
            inlined: elementary::inlined(plan, options.precision),
            signatures: [None; 4],
        }
    }

    /// Opens the entry block.
    pub fn enter(&mut self) {
        let entry = self.b.create_block();
        self.b.append_block_params_for_function_params(entry);
        self.b.switch_to_block(entry);
        // Source locations are stored relative to the base; with base 0 none of them equals the default ("no location").
        self.b.func.params.ensure_base_srcloc(SourceLoc::new(0));
        let record = self.b.ins().stack_addr(types::I64, self.record, 0);
        self.bases = Some([record, self.b.block_params(entry)[0]]);
    }

    /// Attributes the code that follows to `value`, or to the loop itself, for `explain`.
    pub fn set_source(&mut self, value: Option<Value>) {
        let number = value.map_or(SourceLoc::default(), |value| SourceLoc::new(value.0));
        self.b.set_srcloc(number);
    }

    pub fn lanes(&self) -> usize {
        self.options.lanes().count()
    }

    pub fn integer(&mut self, value: i64) -> ir::Value {
        self.b.ins().iconst(types::I64, value)
    }

    pub fn parameters<const N: usize>(&mut self, block: Block, types: [ir::Type; N]) -> [ir::Value; N] {
        types.map(|t| self.b.append_block_param(block, t))
    }

    fn bases(&self) -> [ir::Value; 2] {
        match self.bases {
            Some(bases) => bases,
            None => unreachable!("the entry block is opened first"),
        }
    }

    /// A field of the argument block.
    pub fn arg(&mut self, kind: ir::Type, offset: i32) -> ir::Value {
        let [_, args] = self.bases();
        self.b.ins().load(kind, RECORD, args, offset)
    }

    pub fn set_arg(&mut self, value: ir::Value, offset: i32) {
        let [_, args] = self.bases();
        self.b.ins().store(RECORD, value, args, offset);
    }

    /// The addresses of the two row areas.
    pub fn row_areas(&mut self) -> [ir::Value; 2] {
        let [record, _] = self.bases();
        let [first, second] = [0, 1].map(|n| i64::from(self.plan.pass_bytes + n * self.plan.rows_bytes));
        [self.b.ins().iadd_imm_s(record, first), self.b.ins().iadd_imm_s(record, second)]
    }

    fn areas(&self) -> Areas {
        match self.areas {
            Some(areas) => areas,
            None => unreachable!("rows come after `row_areas`"),
        }
    }

    /// The base address for reading a slot.
    fn base(&self, slot: Slot) -> ir::Value {
        match (slot.area, slot.bytes) {
            (Area::Pass, _) => self.bases()[0],
            (Area::Rows, 8) => self.areas().scalars,
            (Area::Rows, _) => self.areas().vectors,
        }
    }

    /// The address of a pass slot.
    pub fn address(&mut self, slot: Slot) -> ir::Value {
        let base = self.base(slot);
        self.b.ins().iadd_imm_s(base, i64::from(slot.offset))
    }

    /// Loads a slot. Emitted right before its reader, the load becomes that instruction's memory operand.
    pub fn load(&mut self, kind: ir::Type, slot: Slot) -> ir::Value {
        let base = self.base(slot);
        self.b.ins().load(kind, RECORD, base, slot.offset)
    }

    /// Stores to a slot: of the pass, or of the first of the two rows being prepared.
    pub fn store(&mut self, value: ir::Value, slot: Slot) {
        self.store_of(value, slot, 0);
    }

    /// Stores to a slot of one of the two rows being prepared. A vector in a scalar slot serves both.
    pub fn store_of(&mut self, value: ir::Value, slot: Slot, row: i32) {
        let base = match slot.area {
            Area::Pass => self.bases()[0],
            Area::Rows => self.areas().ahead,
        };
        self.b.ins().store(RECORD, value, base, slot.offset + row * slot.bytes);
    }

    /// Continues in a new block if `condition` holds, else jumps to `otherwise`.
    pub fn go_on_if(&mut self, condition: ir::Value, otherwise: Block, arguments: &[BlockArg]) {
        let block = self.b.create_block();
        self.b.ins().brif(condition, block, &[], otherwise, arguments);
        self.b.switch_to_block(block);
    }

    /// A pass, row, row-end or pass-end value as f64 (or truth value), read by `level`.
    pub fn scalar(&mut self, value: Value, level: Level) -> ir::Value {
        if let Some(number) = self.plan.program.instruction(value).op.constant() {
            return self.constant(number);
        }
        if self.plan.program.instruction(value).level == level
            && let Some(result) = self.results[value.index()]
        {
            return result;
        }
        let is_truth = self.plan.program.is_truth(value);
        match self.plan.scalars[value.index()] {
            Some(slot) if is_truth && slot.area == Area::Rows => {
                let mask = self.load(types::I64, slot);
                self.b.ins().icmp_imm_s(IntCC::NotEqual, mask, 0)
            }
            Some(slot) => self.load(if is_truth { types::I8 } else { types::F64 }, slot),
            None => unreachable!("the plan gives a slot to every value that crosses levels"),
        }
    }

    /// A number from the constant pool: one load, where an immediate takes two instructions.
    pub fn constant(&mut self, number: f64) -> ir::Value {
        let pair = self.pair(number);
        self.b.ins().extractlane(pair, 0)
    }

    /// The same number twice.
    pub fn pair(&mut self, number: f64) -> ir::Value {
        self.constant_vector(types::F64X2, [number; 2].iter().flat_map(|n| n.to_le_bytes()).collect())
    }

    /// A vector of constants, from the bytes of its lanes.
    pub fn constant_vector(&mut self, kind: ir::Type, bytes: Vec<u8>) -> ir::Value {
        let constant = self.b.func.dfg.constants.insert(bytes.into());
        self.b.ins().vconst(kind, constant)
    }

    /// The instructions of a level with their values.
    pub fn instructions(&self, level: Level) -> Vec<(Value, Op)> {
        let all = self.plan.program.instructions().iter().enumerate();
        all.filter(|(_, i)| i.level == level).map(|(at, i)| (Value(at as u32), i.op)).collect()
    }

    /// Calls the elementary function at byte `offset` of the table.
    pub fn call(&mut self, offset: i32, form: CallForm, arguments: &[ir::Value]) -> Option<ir::Value> {
        let signature = self.signature(form);
        let table = self.arg(types::I64, arg::FUNCTIONS);
        let function = self.b.ins().load(types::I64, RECORD, table, offset);
        let call = self.b.ins().call_indirect(signature, function, arguments);
        self.b.inst_results(call).first().copied()
    }

    fn signature(&mut self, form: CallForm) -> SigRef {
        if let Some(signature) = self.signatures[form as usize] {
            return signature;
        }
        let (kind, count) = match form {
            CallForm::Scalar1 => (types::F64, 1),
            CallForm::Scalar2 => (types::F64, 2),
            CallForm::Lanes1 => (types::I64, 1),
            CallForm::Lanes2 => (types::I64, 2),
        };
        let mut signature = ir::Signature::new(self.frontend.default_call_conv);
        signature.params.resize(count, ir::AbiParam::new(kind));
        if kind == types::F64 {
            signature.returns.push(ir::AbiParam::new(kind));
        }
        let signature = self.b.import_signature(signature);
        self.signatures[form as usize] = Some(signature);
        signature
    }

    /// The same bits as another vector type.
    pub fn cast(&mut self, kind: ir::Type, value: ir::Value) -> ir::Value {
        if self.b.func.dfg.value_type(value) == kind {
            return value;
        }
        self.b.ins().bitcast(kind, MemFlagsData::new().with_endianness(Endianness::Little), value)
    }
}

/// Base addresses of the row areas.
#[derive(Clone, Copy)]
pub(super) struct Areas {
    /// Of the row being processed: base of 8-byte slots.
    pub scalars: ir::Value,
    /// Of the row being processed: base of 16-byte slots.
    pub vectors: ir::Value,
    /// Of the two rows being prepared.
    pub ahead: ir::Value,
}

/// The signature of an elementary function, see [`crate::abi::Functions`].
#[derive(Clone, Copy)]
pub(super) enum CallForm {
    Scalar1,
    Scalar2,
    Lanes1,
    Lanes2,
}
