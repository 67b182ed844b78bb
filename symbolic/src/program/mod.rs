//! `LoopNest`: the loops of a kernel, in SSA form with dense ids, independent of pixel memory layout.
//!
//! [`crate::schedule`] emits it, [`crate::program::interpreter`] defines its semantics, the JIT compiles it.
//!
//! ```text
//! pass:      f64, once a call            parameters, constants and what follows from them
//!   row:     f64, once a row             outer coordinates, bounds of the domain
//!     pixel: lanes of f32 or f64          one value a pixel; accumulators sum some of them over the row
//!   row end: f64, once a row with pixels row totals of accumulators, times what depends on the row
//! pass end:  f64, once a call            outputs from pass totals
//! ```
//! A pixel instruction that reads a pass or row value reads it rounded to the lane type.

pub(crate) mod arithmetic;
pub(crate) mod check;
mod ids;
pub mod interpreter;
pub(crate) mod op;
#[cfg(test)]
mod op_tests;
pub(crate) mod peephole;
pub(crate) mod print;
pub(crate) mod registers;
mod saturation;
mod summation;
pub(crate) mod walk;
mod window;

pub use arithmetic::Comparison;
pub(crate) use arithmetic::holds;
pub(crate) use ids::id;
pub use ids::{AccumulatorId, ChannelId, ConstantId, CoordinateId, InputId, ParameterId, TotalId, Value};
pub use op::{Kind, Level, Literal, Op, Opcode, Row, spelled};
pub use summation::{Lanes, Summation};

use std::sync::Arc;

use isophote_elementary::Tables;
use isophote_syntax::diagnostic::Span;

/// An input of a program besides pixels; all are f64.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Input {
    /// The parameter's value at this evaluation.
    Parameter(ParameterId),
    /// The parameter's value at the start of the pass, which fixes the pixel set and the noise weights.
    Entry(ParameterId),
    /// A constant of session or camera.
    Constant(ConstantId),
    /// The saturation limit of a channel, in pixel values.
    Saturation(ChannelId),
    /// A sub-pixel shift of a coordinate (rendering), in px.
    Shift(CoordinateId),
}

/// One instruction with its level and source.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Instruction {
    /// The operation.
    pub op: Op,
    /// Its level in the loop nest.
    pub level: Level,
    /// Its formula's span; `None` for the loop's own instructions.
    pub span: Option<Span>,
}

/// The use of the pixel values.
#[derive(Clone, PartialEq, Debug)]
pub enum Sink {
    /// Sums. `accumulators[i]` is the pixel value summed; `totals[i]` the row-end (or row, pass) value summed over the
    /// rows that have pixels; `outputs[i]` the pass-end (or pass) value returned.
    Sums {
        /// Pixel values.
        accumulators: Vec<Value>,
        /// Row-end values.
        totals: Vec<Value>,
        /// Pass-end values.
        outputs: Vec<Value>,
    },
    /// The pixel value, as f32, is *added* to the pixel of an output plane (the synthetic camera).
    Plane(Value),
}

impl Sink {
    /// The output values; empty for a plane.
    pub fn outputs(&self) -> &[Value] {
        match self {
            Sink::Sums { outputs, .. } => outputs,
            Sink::Plane(_) => &[],
        }
    }
}

/// Which pixels of the window take part. Truth values and bounds depend on entry parameters only.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct PixelSet {
    /// Row values `lo`, `hi`: only pixels with lo ≤ x ≤ hi; a NaN empties the row.
    pub bounds: Option<(Value, Value)>,
    /// A pixel truth value: only where it holds.
    pub mask: Option<Value>,
    /// A pixel truth value: where it holds the pixel is counted as saturated and left out.
    pub saturated: Option<Value>,
}

/// A loop nest; see the module documentation. One that passed its check is a [`crate::Program`].
#[derive(Clone, PartialEq, Debug)]
pub struct LoopNest {
    /// Number of coordinates, the inner one included.
    pub coordinates: u32,
    /// Number of raw planes.
    pub channels: u32,
    /// Inputs besides pixels.
    pub inputs: Vec<Input>,
    /// Lookup tables.
    pub tables: Tables,
    /// Ordered by level, operands first.
    pub instructions: Vec<Instruction>,
    /// The pixels that take part.
    pub pixel_set: PixelSet,
    /// The use of their values.
    pub sink: Sink,
    /// Names for printing.
    pub names: Arc<Names>,
    /// See [`LoopNest::is_fused`].
    pub fused: bool,
}

/// Names for the text form.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Names {
    /// Coordinates, inner first.
    pub coordinates: Vec<String>,
    /// Raw planes.
    pub channels: Vec<String>,
    /// Parameters in document order.
    pub parameters: Vec<String>,
    /// Constants in document order.
    pub constants: Vec<String>,
    /// Outputs.
    pub outputs: Vec<String>,
}

/// Arithmetic per pixel; rows are summed in f64.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Double precision.
    F64,
}

/// Operation counts of one program, by level.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Cost {
    /// Flops a pixel, accumulation included.
    pub flops_per_pixel: u32,
    /// Flops a row (prologue and epilogue).
    pub flops_per_row: u32,
    /// Flops a pass (prologue and epilogue).
    pub flops_per_pass: u32,
    /// Sums kept per pixel.
    pub accumulators: u32,
    /// Elementary functions a pixel, by name.
    pub calls: std::collections::BTreeMap<&'static str, u32>,
    /// Divisions and square roots among the flops a pixel.
    pub divisions: u32,
    /// Instructions a pixel, accumulation included.
    pub instructions_per_pixel: u32,
    /// Spill stores and reloads a pixel, with 16 registers and with 32.
    pub spills: [u32; 2],
}

/// Estimated cost of a pixel loop, ordered by flops, then by the rest.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Weight {
    /// By [`Op::weight`].
    pub flops: u32,
    /// Instructions, and spills to 15 registers.
    pub rest: u32,
}

impl Weight {
    /// Above any loop's.
    pub const MOST: Weight = Weight { flops: u32::MAX, rest: u32::MAX };
}

/// Values for [`LoopNest::inputs`]; slices in document order.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bindings<'a> {
    /// All parameters of the model.
    pub parameters: &'a [f64],
    /// All parameters at the start of the pass.
    pub entry: &'a [f64],
    /// All constants.
    pub constants: &'a [f64],
    /// One limit a channel; `f64::INFINITY` for a channel that never saturates.
    pub saturation: &'a [f64],
    /// One shift a coordinate, px; missing ones are 0.
    pub shift: &'a [f64],
}

impl LoopNest {
    /// Number of coordinates, the inner one included.
    pub fn coordinates(&self) -> usize {
        self.coordinates as usize
    }
    /// Number of raw planes that the model declares; a kernel receives all, read or not.
    pub fn channels(&self) -> usize {
        self.channels as usize
    }
    /// The inputs, in the order of [`Opcode::Input`].
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }
    /// The tables of [`Opcode::Gather`].
    pub fn tables(&self) -> &Tables {
        &self.tables
    }
    /// Whether it reads a table.
    pub fn looks_up(&self) -> bool {
        self.instructions.iter().any(|i| matches!(i.op.code, Opcode::Gather(_)))
    }
    /// All instructions, ordered by level, operands first. `Value(i)` is the result of instruction i.
    pub fn instructions(&self) -> &[Instruction] {
        &self.instructions
    }
    /// The pixels that take part.
    pub fn pixel_set(&self) -> &PixelSet {
        &self.pixel_set
    }
    /// The use of their values.
    pub fn sink(&self) -> &Sink {
        &self.sink
    }
    /// Names for printing.
    pub fn names(&self) -> &Names {
        &self.names
    }
    /// Whether the pixel level uses fused multiply-add (one rounding): in elementary functions and in
    /// [`Self::contractions`]. No other level does.
    pub fn is_fused(&self) -> bool {
        self.fused
    }
    /// The instruction that computes `value`.
    pub fn instruction(&self, value: Value) -> &Instruction {
        &self.instructions[value.index()]
    }
    /// For each accumulator of a fused program: the factors of its pixel value, if that is a product that nothing else
    /// reads. It is added with one rounding.
    pub fn contractions(&self) -> Vec<Option<(Value, Value)>> {
        let Sink::Sums { accumulators, .. } = &self.sink else { return Vec::new() };
        if !self.fused {
            return vec![None; accumulators.len()];
        }
        let mut reads = vec![0_u32; self.instructions.len()];
        let set = self.pixel_set.mask.into_iter().chain(self.pixel_set.saturated);
        let operands = self.instructions.iter().flat_map(|i| i.op.operands());
        operands.chain(set).chain(accumulators.iter().copied()).for_each(|v| reads[v.index()] += 1);
        let factors = |v: &Value| match self.instruction(*v).op.parts() {
            (Opcode::Mul, &[a, b]) if reads[v.index()] == 1 && self.instruction(*v).level == Level::Pixel => {
                Some((a, b))
            }
            _ => None,
        };
        accumulators.iter().map(factors).collect()
    }
    /// Marks the roots and everything they depend on, by value. Operands precede their readers.
    pub fn made_of(&self, roots: impl IntoIterator<Item = Value>) -> Vec<bool> {
        let mut needed = vec![false; self.instructions.len()];
        roots.into_iter().for_each(|v| needed[v.index()] = true);
        for (i, instruction) in self.instructions.iter().enumerate().rev() {
            if needed[i] {
                instruction.op.operands().for_each(|v| needed[v.index()] = true);
            }
        }
        needed
    }
    /// Replaces all references to values.
    fn rename(&mut self, to: impl Fn(Value) -> Value) {
        self.instructions.iter_mut().for_each(|instruction| instruction.op = instruction.op.renamed(&to));
        let set = &mut self.pixel_set;
        set.bounds = set.bounds.map(|(lo, hi)| (to(lo), to(hi)));
        set.mask = set.mask.map(&to);
        set.saturated = set.saturated.map(&to);
        match &mut self.sink {
            Sink::Sums { accumulators, totals, outputs } => {
                accumulators.iter_mut().chain(totals).chain(outputs).for_each(|v| *v = to(*v));
            }
            Sink::Plane(value) => *value = to(*value),
        }
    }
    /// True when `value` is a truth value.
    pub fn is_truth(&self, mut value: Value) -> bool {
        loop {
            let op = self.instruction(value).op;
            match op.code.row().result {
                Kind::Truth => return true,
                Kind::Number | Kind::OfRow => return false,
                Kind::Either => {
                    match op.operands().zip(op.code.row().operands).find(|(_, kind)| **kind == Kind::Either) {
                        Some((operand, _)) => value = operand,
                        None => return false,
                    }
                }
            }
        }
    }
    /// The numbers for [`LoopNest::inputs`], in order. A missing shift is 0; any other missing entry is a bug of the
    /// caller and NaN.
    pub fn gather(&self, bindings: &Bindings) -> impl Iterator<Item = f64> {
        let Bindings { parameters, entry, constants, saturation, shift } = *bindings;
        let lists = [parameters, entry, constants, saturation, shift];
        self.inputs.iter().map(move |input| {
            let (list, i) = match *input {
                Input::Parameter(p) => (0, p.index()),
                Input::Entry(p) => (1, p.index()),
                Input::Constant(c) => (2, c.index()),
                Input::Saturation(c) => (3, c.index()),
                Input::Shift(c) => (4, c.index()),
            };
            lists[list].get(i).copied().unwrap_or(if list == 4 { 0.0 } else { f64::NAN })
        })
    }

    /// Estimated cost of the pixel loop, accumulation included; `None` for a plane or if not below `below`.
    pub(crate) fn weight(&self, below: Weight) -> Option<Weight> {
        let Sink::Sums { accumulators, .. } = &self.sink else { return None };
        let mut flops = accumulators.len() as u32;
        let mut rest = flops;
        for instruction in self.instructions.iter().filter(|i| i.level == Level::Pixel) {
            flops += instruction.op.weight();
            rest += u32::from(instruction.op.flops() > 0);
        }
        if flops > below.flops {
            return None;
        }
        rest += registers::spills(self, registers::OF_16);
        Some(Weight { flops, rest }).filter(|weight| *weight < below)
    }

    /// Counts operations; F itself counts when the program sums it.
    pub fn cost(&self) -> Cost {
        let mut cost = Cost::default();
        for instruction in &self.instructions {
            let flops = instruction.op.flops();
            match instruction.level {
                Level::Pixel => cost.flops_per_pixel += flops,
                Level::Row | Level::RowEnd => cost.flops_per_row += flops,
                Level::Pass | Level::PassEnd => cost.flops_per_pass += flops,
            }
            if instruction.level == Level::Pixel {
                cost.instructions_per_pixel += u32::from(flops > 0);
                cost.divisions += u32::from(matches!(instruction.op.code, Opcode::Div | Opcode::Sqrt));
                let name = match instruction.op.code {
                    Opcode::Call1(function) => function.name(),
                    Opcode::Call2(function) => function.name(),
                    _ => continue,
                };
                *cost.calls.entry(name).or_default() += 1;
            }
        }
        if let Sink::Sums { accumulators, totals, .. } = &self.sink {
            cost.accumulators = accumulators.len() as u32;
            cost.flops_per_pixel += accumulators.len() as u32;
            cost.instructions_per_pixel += accumulators.len() as u32;
            cost.flops_per_row += totals.len() as u32;
        }
        cost.spills = [registers::OF_16, registers::OF_32].map(|count| registers::spills(self, count));
        cost
    }
}
