//! Writes the statements of each level, one number at a time.
//!
//! Unused values are omitted, constants are inlined, and values of outer levels that the pixel loop reads are rounded
//! once, in front of the loop.

use std::collections::BTreeSet;

use isophote_symbolic::{CoordinateId, Level, Op, Opcode, Precision, Program, Sink, Span, Value};

use crate::header::comment;
use crate::names::Words;
use crate::options::{ExportSubject, Language};
use crate::spelling::{Dialect, Held};

/// Statements of each level, one a line.
#[derive(Default)]
pub(super) struct Body {
    pub pass: Vec<String>,
    pub row: Vec<String>,
    /// In front of the pixel loop, after the row's first pixel is known.
    pub before_pixels: Vec<String>,
    pub pixel: Vec<String>,
    /// At the end of each pixel.
    pub step: Vec<String>,
    pub row_end: Vec<String>,
    pub pass_end: Vec<String>,
}

/// Writes statements.
pub(super) struct Statements<'a> {
    pub source: &'a ExportSubject<'a>,
    pub words: Words,
    pub live: Vec<bool>,
    pub held: Vec<Held>,
    /// Factors of products that are added to a sum with one rounding, by accumulator.
    pub contractions: Vec<Option<(Value, Value)>>,
}

impl<'a> Statements<'a> {
    pub fn new(source: &'a ExportSubject<'a>) -> Statements<'a> {
        let program = source.program;
        let held = |i: u32| if program.is_truth(Value(i)) { Held::Truth } else { Held::Number };
        let held = (0..program.instructions().len() as u32).map(held).collect();
        let contractions = program.contractions();
        let live = live(program, &contractions);
        Statements { source, words: Words::of(program), live, held, contractions }
    }

    pub fn program(&self) -> &'a Program {
        self.source.program
    }

    /// The dialect of a level.
    pub fn spelling(&self, level: Level) -> Dialect {
        let real = if level == Level::Pixel { self.source.options.precision } else { Precision::F64 };
        Dialect { language: self.source.options.language, real }
    }

    fn level(&self, value: Value) -> Level {
        self.program().instruction(value).level
    }

    /// True when the pixel loop reads a rounded copy of this value.
    fn is_rounded(&self, value: Value) -> bool {
        self.level(value) < Level::Pixel
            && self.source.options.precision == Precision::F32
            && self.held[value.index()] == Held::Number
            && self.program().instruction(value).op.constant().is_none()
    }

    /// A value as a level reads it.
    pub fn read(&self, value: Value, level: Level) -> String {
        if let Some(x) = self.program().instruction(value).op.constant() {
            return self.spelling(level).literal(x);
        }
        let word = &self.words.values[value.index()];
        if level == Level::Pixel && self.is_rounded(value) { format!("{word}_f") } else { word.clone() }
    }

    /// The values declared at a level.
    pub fn at(&self, level: Level) -> impl Iterator<Item = (Value, Op, Option<Span>)> + '_ {
        self.program().instructions().iter().enumerate().filter_map(move |(i, x)| {
            let written = x.level == level && self.live[i] && x.op.constant().is_none();
            written.then_some((Value(i as u32), x.op, x.span))
        })
    }

    /// The expression of a leaf outside of the pixel level.
    fn leaf(&self, op: Op) -> Option<String> {
        let rust = self.source.options.language == Language::Rust;
        let double = |text: &str| if rust { format!("{text} as f64") } else { format!("(double){text}") };
        let outer = |c: CoordinateId| ["column", "row", "slice", "volume"][c.index()];
        Some(match op.code {
            Opcode::Input(i) => format!("inputs[{}]", i.index()),
            Opcode::Outer(c) => double(&format!("(window.first[{}] + {})", c.index(), outer(c))),
            Opcode::RowTotal(a) => self.spelling(Level::Pixel).widened(&format!("sum{}", a.index())),
            Opcode::RowCount => double("row_pixels"),
            Opcode::PassTotal(t) => format!("total{}", t.index()),
            Opcode::PassCount => double("pixels"),
            _ => return None,
        })
    }

    /// The statements of a level outside of the pixel loop.
    pub fn scalar_level(&self, level: Level) -> Vec<String> {
        let (mut lines, mut shown) = (Vec::new(), None);
        for (value, op, span) in self.at(level) {
            if self.leaf(op).is_none() {
                self.show(span, &mut shown, &mut lines);
            }
            let spelling = self.spelling(level);
            let expression = self.leaf(op).unwrap_or_else(|| spelling.operation(op, &|v| self.read(v, level)));
            lines.push(spelling.declare(&self.words.values[value.index()], self.held[value.index()], &expression));
        }
        lines
    }

    /// Adds a comment with the formula, if it differs from the previous one.
    pub fn show(&self, span: Option<Span>, shown: &mut Option<Span>, lines: &mut Vec<String>) {
        if span == *shown || span.is_none() {
            return;
        }
        *shown = span;
        let text = span.and_then(|span| self.source.model.words(span));
        if let Some(text) = text.filter(|text| !text.is_empty()) {
            lines.push(match self.source.options.language {
                Language::C => format!("/* {} */", comment(text)),
                Language::Rust => format!("// {}", comment(text)),
            });
        }
    }

    /// The values of outer levels that the pixel loop reads, without inlined constants.
    pub fn read_by_pixels(&self) -> BTreeSet<Value> {
        let mut read: BTreeSet<Value> = BTreeSet::new();
        for (_, op, _) in self.at(Level::Pixel).filter(|(_, op, _)| op.code != Opcode::Offset) {
            read.extend(op.operands());
        }
        match self.program().sink() {
            Sink::Sums { accumulators, .. } => read.extend(summed(accumulators, &self.contractions)),
            Sink::Plane(value) => read.extend([value]),
        }
        let set = self.program().pixel_set();
        read.extend(set.mask.into_iter().chain(set.saturated));
        let constant = |v: &Value| self.program().instruction(*v).op.constant().is_some();
        read.retain(|v| self.level(*v) < Level::Pixel && !constant(v));
        read
    }

    /// The offsets, each with its distance from x.
    pub fn offsets(&self) -> Vec<(Value, Value)> {
        let offset = |(value, op, _): (Value, Op, _)| match op.parts() {
            (Opcode::Offset, &[c]) => Some((value, c)),
            _ => None,
        };
        self.at(Level::Pixel).filter_map(offset).collect()
    }

    /// All statements, one pixel at a time.
    pub fn body(&self) -> Body {
        let spelling = self.spelling(Level::Pixel);
        let rust = spelling.language == Language::Rust;
        let mut body = Body {
            pass: self.scalar_level(Level::Pass),
            row: self.scalar_level(Level::Row),
            row_end: self.scalar_level(Level::RowEnd),
            pass_end: self.scalar_level(Level::PassEnd),
            ..Body::default()
        };
        for value in self.read_by_pixels().into_iter().filter(|v| self.is_rounded(*v)) {
            let word = &self.words.values[value.index()];
            let line = spelling.declare(&format!("{word}_f"), Held::Number, &spelling.rounded(word));
            if self.level(value) == Level::Pass { body.pass.push(line) } else { body.row.push(line) }
        }
        for (value, c) in self.offsets() {
            let (word, c) = (&self.words.values[value.index()], self.read(c, Level::Row));
            let outer = self.spelling(Level::Row);
            body.before_pixels.push(outer.declare(&format!("{word}_n"), Held::Number, &self.nearest(&c)));
            let part = spelling.rounded(&format!("({c} + {word}_n)"));
            body.before_pixels.push(spelling.declare(&format!("{word}_part"), Held::Number, &part));
            let whole = spelling.rounded(&format!("(x_first - {word}_n)"));
            let number = spelling.number();
            body.before_pixels.push(match rust {
                true => format!("let mut {word}_at: {number} = {whole};"),
                false => format!("{number} {word}_at = {whole};"),
            });
            body.step.push(format!("{word}_at += {};", spelling.literal(1.0)));
        }
        let mut shown = None;
        for (value, op, span) in self.at(Level::Pixel) {
            self.show(span, &mut shown, &mut body.pixel);
            let word = &self.words.values[value.index()];
            let expression = match op.code {
                Opcode::Offset => format!("{word}_at + {word}_part"),
                Opcode::Channel(c) => {
                    let row = format!("{}_row", self.words.planes[c.index()]);
                    let stride = format!("{}.strides[0]", self.words.planes[c.index()]);
                    let place = if self.source.options.packed { "i".into() } else { format!("i * {stride}") };
                    spelling.pixel(&format!("{row}[{place}]"), self.source.options.pixels[c.index()])
                }
                _ => spelling.operation(op, &|v| self.read(v, Level::Pixel)),
            };
            body.pixel.push(spelling.declare(word, self.held[value.index()], &expression));
        }
        body
    }

    /// Adds a pixel to a sum.
    pub fn added(&self, i: usize, value: Value) -> String {
        let read = |v: Value| self.read(v, Level::Pixel);
        let sum = format!("sum{i}");
        match self.contractions[i] {
            None => format!("{sum} += {};", read(value)),
            // The sum is the third operand, under a value number that no program has.
            Some((a, b)) => {
                let third = Value(u32::MAX);
                let spelled = |v: Value| if v == third { sum.clone() } else { read(v) };
                format!("{sum} = {};", self.spelling(Level::Pixel).operation(Opcode::Fma.of([a, b, third]), &spelled))
            }
        }
    }

    /// −c rounded to the nearest whole number, ties to even.
    fn nearest(&self, c: &str) -> String {
        match self.source.options.language {
            Language::C => format!("rint(-({c}))"),
            Language::Rust => format!("nearest(-({c}))"),
        }
    }
}

/// The values that the sums read: one each, or two factors.
fn summed(accumulators: &[Value], contractions: &[Option<(Value, Value)>]) -> impl Iterator<Item = Value> {
    accumulators
        .iter()
        .zip(contractions)
        .flat_map(|(value, factors)| match *factors {
            Some((a, b)) => [Some(a), Some(b)],
            None => [Some(*value), None],
        })
        .flatten()
}

/// The values in use.
fn live(program: &Program, contractions: &[Option<(Value, Value)>]) -> Vec<bool> {
    let set = program.pixel_set();
    let mut roots: Vec<Value> = set.mask.into_iter().chain(set.saturated).collect();
    roots.extend(set.bounds.into_iter().flat_map(|(lo, hi)| [lo, hi]));
    match program.sink() {
        Sink::Sums { accumulators, totals, outputs } => {
            roots.extend(summed(accumulators, contractions));
            roots.extend([totals, outputs].into_iter().flatten());
        }
        Sink::Plane(value) => roots.push(*value),
    }
    program.made_of(roots)
}
