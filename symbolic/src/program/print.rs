//! Text form of a [`LoopNest`], for reading and snapshot tests.

use crate::program::{Comparison, Input, Level, LoopNest, Names, Op, Opcode, Sink, Value, spelled};

impl std::fmt::Display for LoopNest {
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
            writeln!(f, "bounds: v{} <= {} <= v{}", lo.0, coordinate(self.names(), 0), hi.0)?;
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
                for (i, value) in outputs.iter().enumerate() {
                    writeln!(f, "{} = v{}", name(&self.names().outputs, "o", i), value.0)?;
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

impl LoopNest {
    /// The operation of `value` as in the program's text: `fma(v1, v2, v3)`.
    pub fn operation_text(&self, value: Value) -> String {
        operation(self, self.instruction(value).op)
    }
}

fn list(values: &[Value]) -> String {
    values.iter().map(|v| format!("v{}", v.0)).collect::<Vec<_>>().join(" ")
}

/// The name, else `letter` and the position.
fn name(names: &[String], letter: &str, position: usize) -> String {
    names.get(position).cloned().unwrap_or_else(|| format!("{letter}{position}"))
}

fn coordinate(names: &Names, position: usize) -> String {
    name(&names.coordinates, "x", position)
}

fn channel(names: &Names, position: usize) -> String {
    name(&names.channels, "i", position)
}

fn input_name(names: &Names, input: Input) -> String {
    match input {
        Input::Parameter(p) => name(&names.parameters, "p", p.index()),
        Input::Entry(p) => format!("{}@entry", name(&names.parameters, "p", p.index())),
        Input::Constant(c) => name(&names.constants, "c", c.index()),
        Input::Saturation(c) => format!("limit({})", channel(names, c.index())),
        Input::Shift(c) => format!("shift({})", coordinate(names, c.index())),
    }
}

/// An opcode's payload as text; for an offset the inner coordinate.
fn held(program: &LoopNest, code: Opcode) -> String {
    let names = program.names();
    match code {
        Opcode::Const(x) => x.get().to_string(),
        Opcode::Input(i) => input_name(names, program.inputs()[i.index()]),
        Opcode::Outer(c) => coordinate(names, c.index()),
        Opcode::Offset => coordinate(names, 0),
        Opcode::Channel(c) => channel(names, c.index()),
        Opcode::Compare(c) => c.sign().to_string(),
        Opcode::Call1(function) => function.name().to_string(),
        Opcode::Call2(function) => function.name().to_string(),
        Opcode::Gather(l) => format!("table{}.{}", l.table, l.coefficient),
        Opcode::RowTotal(a) => a.0.to_string(),
        Opcode::PassTotal(t) => t.0.to_string(),
        _ => String::new(),
    }
}

fn operation(program: &LoopNest, op: Op) -> String {
    let (code, operands) = op.parts();
    spelled(code.row().text, |mark| match mark.to_digit(10) {
        Some(i) => operands.get(i as usize).map_or_else(String::new, |v| format!("v{}", v.0)),
        None => held(program, code),
    })
}

#[cfg(test)]
#[path = "print_tests.rs"]
mod tests;
