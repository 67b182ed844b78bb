//! Table lookups: finds each lane's cell and loads a number per lane.
//!
//! The cell is computed in lane arithmetic, as by [`isophote_symbolic::Table`]; before it becomes an address it is clamped
//! to the last cell, unsigned, so that no number leads outside the table.

use cranelift_codegen::ir::condcodes::FloatCC;
use cranelift_codegen::ir::{self, InstBuilder, types};
use isophote_symbolic::{Axis, Lookup, Table};

use super::emit::{Emitter, RECORD, arg};

/// 2²³ and 2⁵²: a whole number added to one appears in its low bits.
const WHOLE_SINGLE: f32 = (1_u32 << 23) as f32;
const WHOLE_DOUBLE: f64 = (1_u64 << 52) as f64;

impl Emitter<'_, '_> {
    /// Looks up a number for each lane.
    pub fn looked_up(&mut self, lookup: Lookup, places: [ir::Value; 2]) -> ir::Value {
        let kind = self.b.func.dfg.value_type(places[0]);
        let addresses = self.addresses(lookup, places, kind.lane_count());
        let pair = |emit: &mut Self, pair: &[ir::Value]| {
            let [low, high] = [pair[0], pair[1]].map(|address| emit.fetched(lookup, address));
            let low = emit.b.ins().scalar_to_vector(types::F64X2, low);
            emit.b.ins().insertlane(low, high, 1)
        };
        let low = pair(self, &addresses[..2]);
        if kind == types::F64X2 {
            return low;
        }
        let high = pair(self, &addresses[2..]);
        let [low, high] = [low, high].map(|pair| self.b.ins().fvdemote(pair));
        self.low_halves(low, high)
    }

    /// Looks up a number for the first lane alone.
    pub fn looked_up_one(&mut self, lookup: Lookup, places: [ir::Value; 2]) -> ir::Value {
        let addresses = self.addresses(lookup, places, 1);
        self.fetched(lookup, addresses[0])
    }

    /// The cell addresses of `lanes` lanes, as if the table were the first; cached per block.
    fn addresses(&mut self, lookup: Lookup, places: [ir::Value; 2], lanes: u32) -> Vec<ir::Value> {
        let key = (self.b.current_block(), lookup.table, places);
        if let Some(addresses) = self.cell_addresses.get(&key) {
            return addresses.clone();
        }
        let cells = self.cells(lookup, places);
        let addresses: Vec<ir::Value> = (0..lanes).map(|lane| self.cell_address(lookup, cells, lane as u8)).collect();
        self.cell_addresses.insert(key, addresses.clone());
        addresses
    }

    fn table(&self, lookup: Lookup) -> &Table {
        match self.plan.program.tables().all().get(usize::from(lookup.table)) {
            Some(table) => table,
            None => unreachable!("the check refuses tables that do not exist"),
        }
    }

    /// Each lane's cell index, as an integer.
    fn cells(&mut self, lookup: Lookup, [a, b]: [ir::Value; 2]) -> ir::Value {
        let axes: Vec<Axis> = self.table(lookup).axes().to_vec();
        let kind = self.b.func.dfg.value_type(a);
        let mut cell = self.cell(kind, axes[0], a);
        if let Some(axis) = axes.get(1) {
            let row = self.cell(kind, *axis, b);
            let width = self.same(kind, axes[0].cells() as f64);
            let before = self.b.ins().fmul(row, width);
            cell = self.b.ins().fadd(before, cell);
        }
        let (whole, integers) = match kind {
            types::F32X4 => (f64::from(WHOLE_SINGLE), types::I32X4),
            _ => (WHOLE_DOUBLE, types::I64X2),
        };
        let whole = self.same(kind, whole);
        let shifted = self.b.ins().fadd(cell, whole);
        let [shifted, whole] = [shifted, whole].map(|value| self.cast(integers, value));
        self.b.ins().isub(shifted, whole)
    }

    /// The cell index along an axis; 0 before the first sample and for NaN.
    fn cell(&mut self, kind: ir::Type, axis: Axis, t: ir::Value) -> ir::Value {
        let [zero, one, last] = [0.0, 1.0, (axis.count - 1) as f64].map(|x| self.same(kind, x));
        let is_inside = self.b.ins().fcmp(FloatCC::GreaterThanOrEqual, t, zero);
        let is_less = self.b.ins().fcmp(FloatCC::LessThan, t, last);
        let is_less = self.cast(kind, is_less);
        let t = self.b.ins().bitselect(is_less, t, last);
        // Rounds to nearest, and subtracts one if that is above: the baseline processor has no floor instruction.
        let whole = self.same(kind, if kind == types::F32X4 { WHOLE_SINGLE.into() } else { WHOLE_DOUBLE });
        let nearest = self.b.ins().fadd(t, whole);
        let nearest = self.b.ins().fsub(nearest, whole);
        let is_above = self.b.ins().fcmp(FloatCC::LessThan, t, nearest);
        let is_above = self.cast(kind, is_above);
        let above = self.b.ins().band(is_above, one);
        let floor = self.b.ins().fsub(nearest, above);
        let cell = self.b.ins().fadd(floor, one);
        let is_inside = self.cast(kind, is_inside);
        self.b.ins().band(cell, is_inside)
    }

    /// A number in every lane.
    fn same(&mut self, kind: ir::Type, x: f64) -> ir::Value {
        let bytes = match kind {
            types::F32X4 => [(x as f32).to_le_bytes(); 4].concat(),
            _ => [x.to_le_bytes(); 2].concat(),
        };
        self.constant_vector(kind, bytes)
    }

    /// The cell address of one lane.
    fn cell_address(&mut self, lookup: Lookup, cells: ir::Value, lane: u8) -> ir::Value {
        let table = self.table(lookup);
        let (count, coefficients) = (table.numbers().len() / table.coefficients(), table.coefficients());
        let cell = self.b.ins().extractlane(cells, lane);
        let cell = match self.b.func.dfg.value_type(cell) {
            types::I64 => cell,
            _ => self.b.ins().uextend(types::I64, cell),
        };
        let last = self.integer(count as i64 - 1);
        let cell = self.b.ins().umin(cell, last);
        let bytes = (size_of::<f64>() * coefficients).trailing_zeros();
        let distance = self.b.ins().ishl_imm_u(cell, i64::from(bytes));
        let base = self.arg(types::I64, arg::TABLES);
        self.b.ins().iadd(base, distance)
    }

    /// Loads the number of a cell.
    fn fetched(&mut self, lookup: Lookup, address: ir::Value) -> ir::Value {
        let first = self.plan.program.tables().start(lookup.table) + usize::from(lookup.coefficient);
        self.b.ins().load(types::F64, RECORD, address, (size_of::<f64>() * first) as i32)
    }
}
