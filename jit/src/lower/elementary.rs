//! Elementary functions of the pixel level: inlined as vector code, or called where that would be too much code.
//!
//! The algorithms are those of [`isophote_elementary`], generic over a [`Machine`]; this machine emits one instruction per
//! operation, on 2 × f64. Lanes of f32 are widened in two halves and rounded once, except for functions with an f32 form
//! of their own.

use std::cell::RefCell;

use cranelift_codegen::ir::condcodes::{FloatCC, IntCC};
use cranelift_codegen::ir::{self, BlockArg, InstBuilder, types};
use isophote_elementary::{Accuracy, Counter, Function1, Function2, Machine, Plain, call1, call2};
use isophote_symbolic::{Opcode, Precision};

use super::emit::{CallForm, Emitter};
use crate::abi::Functions;
use crate::options::VectorWidth;
use crate::plan::Plan;

/// Maximum instructions of all inlined elementary functions of a group. Compile time grows with them; a document may have
/// thousands of calls.
const INLINED_MAX: usize = 3000;

/// Whether the functions of the pixel level are inlined.
pub(super) fn inlined(plan: &Plan<'_>, precision: Precision) -> bool {
    let counter = Counter::of(&Plain { fused: plan.program.is_fused() });
    let accuracy = accuracy(precision);
    let mut halves = plan.pixels.iter().map(|v| match plan.program.instruction(*v).op.code {
        Opcode::Call1(f) => call1(&counter, f, accuracy, ()),
        Opcode::Call2(f) => call2(&counter, f, accuracy, (), ()),
        _ => {}
    });
    // A program instruction is a few dozen operations at most, so that the sum stays small.
    halves.all(|()| counter.count() * VectorWidth::Bits128.lanes(precision).count() / 2 <= INLINED_MAX)
}

fn accuracy(precision: Precision) -> Accuracy {
    match precision {
        Precision::F32 => Accuracy::Single,
        Precision::F64 => Accuracy::Double,
    }
}

impl Emitter<'_, '_> {
    /// Applies a unary function to each lane.
    pub fn function1(&mut self, function: Function1, x: ir::Value) -> ir::Value {
        let machine = Plain { fused: self.plan.program.is_fused() };
        if !self.inlined {
            let offset = Functions::lanes1(self.options.precision, machine, function);
            return self.call_lanes(self.number, offset, CallForm::Lanes1, &[x]);
        }
        let accuracy = accuracy(self.options.precision);
        if accuracy == Accuracy::Single && function.is_single() {
            return call1(&Lanes::of(self, LaneTypes::SINGLE), function, accuracy, x);
        }
        self.wide([x], |lanes, [x]| call1(lanes, function, accuracy, x))
    }

    /// Applies a binary function to each pair of lanes.
    pub fn function2(&mut self, function: Function2, a: ir::Value, b: ir::Value) -> ir::Value {
        let machine = Plain { fused: self.plan.program.is_fused() };
        if !self.inlined {
            let offset = Functions::lanes2(self.options.precision, machine, function);
            return self.call_lanes(self.number, offset, CallForm::Lanes2, &[a, b]);
        }
        let accuracy = accuracy(self.options.precision);
        self.wide([a, b], |lanes, [a, b]| call2(lanes, function, accuracy, a, b))
    }

    /// Calls a function, which takes its lanes and leaves its result in the record.
    fn call_lanes(&mut self, kind: ir::Type, offset: i32, form: CallForm, operands: &[ir::Value]) -> ir::Value {
        let slots = self.plan.operands;
        operands.iter().zip(slots).for_each(|(value, slot)| self.store(*value, slot));
        let addresses: Vec<ir::Value> = slots[..operands.len()].iter().map(|slot| self.address(*slot)).collect();
        self.call(offset, form, &addresses);
        self.load(kind, slots[0])
    }

    /// Applies `f` to 2 × f64: to the lanes directly, or to both halves of 4 × f32.
    fn wide<const N: usize>(
        &mut self,
        operands: [ir::Value; N],
        f: impl Fn(&Lanes<'_, '_, '_>, [ir::Value; N]) -> ir::Value,
    ) -> ir::Value {
        let emit = |emit: &mut Self, operands| f(&Lanes::of(emit, LaneTypes::DOUBLE), operands);
        if self.options.precision == Precision::F64 {
            return emit(self, operands);
        }
        let low = operands.map(|x| self.b.ins().fvpromote_low(x));
        let low = emit(self, low);
        let high = operands.map(|x| {
            let high = self.upper(x);
            self.b.ins().fvpromote_low(high)
        });
        let high = emit(self, high);
        let [low, high] = [low, high].map(|x| self.b.ins().fvdemote(x));
        self.low_halves(low, high)
    }
}

/// The vector types of numbers, and of truth values and bits.
#[derive(Clone, Copy)]
struct LaneTypes {
    number: ir::Type,
    bits: ir::Type,
}

impl LaneTypes {
    const SINGLE: LaneTypes = LaneTypes { number: types::F32X4, bits: types::I32X4 };
    const DOUBLE: LaneTypes = LaneTypes { number: types::F64X2, bits: types::I64X2 };
}

/// A [`Machine`] that emits vector code.
struct Lanes<'m, 'a, 'p> {
    emit: RefCell<&'m mut Emitter<'a, 'p>>,
    types: LaneTypes,
    fused: bool,
}

impl<'m, 'a, 'p> Lanes<'m, 'a, 'p> {
    fn of(emit: &'m mut Emitter<'a, 'p>, types: LaneTypes) -> Lanes<'m, 'a, 'p> {
        let fused = emit.plan.program.is_fused();
        Lanes { emit: RefCell::new(emit), types, fused }
    }

    /// Each reader gets its own constant load, which becomes that instruction's memory operand.
    fn vector(&self, kind: ir::Type, bits: u64) -> ir::Value {
        let bytes = bits.to_le_bytes()[..kind.lane_type().bytes() as usize].repeat(kind.lane_count() as usize);
        self.emit.borrow_mut().constant_vector(kind, bytes)
    }

    fn cast(&self, kind: ir::Type, value: ir::Value) -> ir::Value {
        self.emit.borrow_mut().cast(kind, value)
    }
}

/// Operations that map to one instruction.
macro_rules! instructions {
    ($($name:ident($($operand:ident),*) = $instruction:ident;)*) => {
        $(fn $name(&self, $($operand: ir::Value),*) -> ir::Value {
            self.emit.borrow_mut().b.ins().$instruction($($operand),*)
        })*
    };
}

impl Machine for Lanes<'_, '_, '_> {
    type Number = ir::Value;
    type Truth = ir::Value;
    type Bits = ir::Value;

    instructions! {
        add(a, b) = fadd;
        sub(a, b) = fsub;
        mul(a, b) = fmul;
        div(a, b) = fdiv;
        sqrt(a) = sqrt;
        abs(a) = fabs;
        neg(a) = fneg;
        and(a, b) = band;
        or(a, b) = bor;
        not(a) = bnot;
        bits_add(a, b) = iadd;
        bits_and(a, b) = band;
        bits_or(a, b) = bor;
        bits_xor(a, b) = bxor;
    }

    fn is_fused(&self) -> bool {
        self.fused
    }
    fn constant(&self, x: f64) -> ir::Value {
        let is_single = self.types.number == types::F32X4;
        self.vector(self.types.number, if is_single { (x as f32).to_bits().into() } else { x.to_bits() })
    }
    fn pattern(&self, bits: u64) -> ir::Value {
        self.vector(self.types.bits, bits)
    }
    fn mul_add(&self, a: ir::Value, b: ir::Value, c: ir::Value) -> ir::Value {
        if self.fused {
            return self.emit.borrow_mut().b.ins().fma(a, b, c);
        }
        self.add(self.mul(a, b), c)
    }
    fn less(&self, a: ir::Value, b: ir::Value) -> ir::Value {
        self.emit.borrow_mut().b.ins().fcmp(FloatCC::LessThan, a, b)
    }
    fn equal(&self, a: ir::Value, b: ir::Value) -> ir::Value {
        self.emit.borrow_mut().b.ins().fcmp(FloatCC::Equal, a, b)
    }
    fn bits_equal(&self, a: ir::Value, b: ir::Value) -> ir::Value {
        self.emit.borrow_mut().b.ins().icmp(IntCC::Equal, a, b)
    }
    /// Selects among integers, so that the compiler sees the comparison and picks a blend.
    fn select(&self, truth: ir::Value, a: ir::Value, b: ir::Value) -> ir::Value {
        let (a, b) = (self.bits(a), self.bits(b));
        let picked = self.emit.borrow_mut().b.ins().bitselect(truth, a, b);
        self.number(picked)
    }
    fn bits(&self, a: ir::Value) -> ir::Value {
        self.cast(self.types.bits, a)
    }
    fn number(&self, a: ir::Value) -> ir::Value {
        self.cast(self.types.number, a)
    }
    fn shift_left(&self, a: ir::Value, by: u8) -> ir::Value {
        let emit = &mut *self.emit.borrow_mut();
        let by = emit.b.ins().iconst(types::I32, i64::from(by));
        emit.b.ins().ishl(a, by)
    }
    fn shift_right(&self, a: ir::Value, by: u8) -> ir::Value {
        let emit = &mut *self.emit.borrow_mut();
        let by = emit.b.ins().iconst(types::I32, i64::from(by));
        emit.b.ins().ushr(a, by)
    }

    /// A call in a cold block, skipped unless a lane needs it.
    fn elsewhere(&self, truth: ir::Value, usual: ir::Value, function: Function1, x: ir::Value) -> ir::Value {
        let emit = &mut *self.emit.borrow_mut();
        let (rare, after) = (emit.b.create_block(), emit.b.create_block());
        emit.b.set_cold_block(rare);
        let value = emit.b.append_block_param(after, types::F64X2);
        let any = emit.b.ins().vhigh_bits(types::I32, truth);
        emit.b.ins().brif(any, rare, &[], after, &[BlockArg::from(usual)]);
        emit.b.switch_to_block(rare);
        let offset = Functions::lanes1(Precision::F64, Plain { fused: false }, function);
        let called = emit.call_lanes(types::F64X2, offset, CallForm::Lanes1, &[x]);
        let truth = emit.cast(types::F64X2, truth);
        let picked = emit.b.ins().bitselect(truth, called, usual);
        emit.b.ins().jump(after, &[BlockArg::from(picked)]);
        emit.b.switch_to_block(after);
        value
    }
}
