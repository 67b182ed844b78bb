//! The text form of a [`Program`], to read and to keep as an expected file.

use crate::program::{Comparison, Input, Level, Op, Program, Sink, Value};

impl std::fmt::Display for Program {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut level = None;
        for (i, instruction) in self.instructions().iter().enumerate() {
            if level != Some(instruction.level) {
                level = Some(instruction.level);
                let title = match instruction.level {
                    Level::Pass => "pass",
                    Level::Row => "row",
                    Level::Pixel => "pixel",
                    Level::RowEnd => "row end",
                    Level::PassEnd => "pass end",
                };
                writeln!(f, "{title}:")?;
            }
            writeln!(f, "  v{i} = {}", operation(self, instruction.op))?;
        }
        let set = self.pixel_set();
        if let Some((lo, hi)) = set.bounds {
            writeln!(f, "bounds: v{} <= {} <= v{}", lo.0, self.names().coordinates[0], hi.0)?;
        }
        for (name, value) in [("mask", set.mask), ("saturated", set.saturated)] {
            if let Some(value) = value {
                writeln!(f, "{name}: v{}", value.0)?;
            }
        }
        match self.sink() {
            Sink::Plane(value) => writeln!(f, "plane: v{}", value.0),
            Sink::Sums { accumulators, totals, outputs } => {
                writeln!(f, "accumulators: {}", list(accumulators))?;
                writeln!(f, "totals: {}", list(totals))?;
                for (value, name) in outputs.iter().zip(&self.names().outputs) {
                    writeln!(f, "{name} = v{}", value.0)?;
                }
                Ok(())
            }
        }
    }
}

impl Comparison {
    /// Its sign in the formula language.
    pub fn sign(self) -> &'static str {
        match self {
            Comparison::Lt => "<",
            Comparison::Le => "<=",
            Comparison::Eq => "==",
            Comparison::Ne => "!=",
        }
    }
}

impl Program {
    /// What `value` is computed from, as in the program's text: `fma(v1, v2, v3)`.
    pub fn operation_text(&self, value: Value) -> String {
        operation(self, self.instruction(value).op)
    }
}

fn list(values: &[Value]) -> String {
    values.iter().map(|v| format!("v{}", v.0)).collect::<Vec<_>>().join(" ")
}

fn input_name(names: &crate::program::Names, input: Input) -> String {
    match input {
        Input::Parameter(p) => names.parameters[p.index()].clone(),
        Input::Entry(p) => format!("{}@entry", names.parameters[p.index()]),
        Input::Constant(c) => names.constants[c.index()].clone(),
        Input::Saturation(c) => format!("limit({})", names.channels[c.index()]),
        Input::Shift(c) => format!("shift({})", names.coordinates[c.index()]),
    }
}

fn operation(program: &Program, op: Op) -> String {
    let names = program.names();
    match op {
        Op::Const(x) => format!("{x}"),
        Op::Input(i) => input_name(names, program.inputs()[i.index()]),
        Op::Outer(c) => names.coordinates[c.index()].clone(),
        Op::Offset(c) => format!("{} + v{}", names.coordinates[0], c.0),
        Op::Channel(c) => format!("pixel({})", names.channels[c.index()]),
        Op::Neg(a) => format!("-v{}", a.0),
        Op::Abs(a) => format!("abs(v{})", a.0),
        Op::Sqrt(a) => format!("sqrt(v{})", a.0),
        Op::Add(a, b) => format!("v{} + v{}", a.0, b.0),
        Op::Sub(a, b) => format!("v{} - v{}", a.0, b.0),
        Op::Mul(a, b) => format!("v{} * v{}", a.0, b.0),
        Op::Div(a, b) => format!("v{} / v{}", a.0, b.0),
        Op::Fma(a, b, c) => format!("fma(v{}, v{}, v{})", a.0, b.0, c.0),
        Op::Compare(c, a, b) => format!("v{} {} v{}", a.0, c.sign(), b.0),
        Op::And(a, b) => format!("v{} and v{}", a.0, b.0),
        Op::Or(a, b) => format!("v{} or v{}", a.0, b.0),
        Op::Not(a) => format!("not v{}", a.0),
        Op::Select(c, a, b) => format!("if(v{}, v{}, v{})", c.0, a.0, b.0),
        Op::Call1(function, a) => format!("{}(v{})", function.name(), a.0),
        Op::Call2(function, a, b) => format!("{}(v{}, v{})", function.name(), a.0, b.0),
        Op::RowTotal(a) => format!("row sum {}", a.0),
        Op::RowCount => "row pixels".into(),
        Op::PassTotal(t) => format!("total {}", t.0),
        Op::PassCount => "pixels".into(),
    }
}
