//! State that runs along a row in registers: the offsets' vectors, some of the sums, the counts.

use cranelift_codegen::ir::{self, Block, BlockArg};
use isophote_symbolic::Precision;

use super::emit::Emitter;

/// The state that one group passes to the next.
#[derive(Clone)]
pub(super) struct Running {
    /// The running part of each `Opcode::Offset`, in the order of the plan.
    pub offsets: Vec<ir::Value>,
    /// Accumulators held in registers, by index.
    pub sums: Vec<Option<ir::Value>>,
    /// Pixels left out, and the saturated ones among them, if counted.
    pub unused: Option<ir::Value>,
    pub saturated: Option<ir::Value>,
}

impl Running {
    /// The state before the first group of a row. Stores the fraction of each offset in `held`.
    pub fn start(emit: &mut Emitter<'_, '_>) -> Running {
        let plan = emit.plan;
        let mut offsets = Vec::new();
        for offset in &plan.offsets {
            emit.held[offset.value.index()] = Some(emit.load(emit.number, offset.fraction));
            offsets.push(emit.load(emit.number, offset.first));
        }
        let zero = vector(emit, |_| 0.0);
        let mut sums = Vec::new();
        for home in &plan.accumulators {
            sums.push(home.register.then_some(zero));
            if !home.register {
                emit.store(zero, home.slot);
            }
        }
        let mut counter = |wanted: bool| wanted.then(|| emit.integer(0));
        let unused = counter(plan.is_masked());
        let saturated = counter(plan.program.pixel_set().saturated.is_some());
        Running { offsets, sums, unused, saturated }
    }

    fn each(&self) -> impl Iterator<Item = ir::Value> {
        let sums = self.sums.iter().copied().flatten();
        self.offsets.iter().copied().chain(sums).chain(self.unused).chain(self.saturated)
    }

    /// As arguments of a jump.
    pub fn values(&self) -> Vec<BlockArg> {
        self.each().map(BlockArg::from).collect()
    }

    /// As parameters of a block.
    pub fn parameters(&self, emit: &mut Emitter<'_, '_>, block: Block) -> Running {
        let mut state = self.clone();
        let fields = state.offsets.iter_mut().chain(state.sums.iter_mut().flatten());
        for field in fields.chain(&mut state.unused).chain(&mut state.saturated) {
            let kind = emit.b.func.dfg.value_type(*field);
            *field = emit.b.append_block_param(block, kind);
        }
        state
    }
}

/// A constant vector.
pub(super) fn vector(emit: &mut Emitter<'_, '_>, lane: impl Fn(usize) -> f64) -> ir::Value {
    let bytes: Vec<u8> = match emit.options.precision {
        Precision::F32 => (0..4).flat_map(|i| (lane(i) as f32).to_le_bytes()).collect(),
        Precision::F64 => (0..2).flat_map(|i| lane(i).to_le_bytes()).collect(),
    };
    emit.constant_vector(emit.number, bytes)
}
