//! Writes the pixel loop with vectors: full groups of pixels, then a last one that masks the lanes outside of the row.
//! Rows and passes are those of one lane.

use isophote_symbolic::{Level, Op, Opcode, Sink, Value};

use crate::body::{Body, Statements};
use crate::lines::File;
use crate::options::{ExportError, ExportSubject};
use crate::rust;
use crate::spelling::Held;
use crate::vectors::Vectors;

/// The whole file.
pub(super) fn file(source: &ExportSubject<'_>) -> Result<String, ExportError> {
    let Sink::Sums { accumulators, .. } = source.program.sink() else {
        return Err(ExportError::NotInLanes("renderings"));
    };
    let statements = Statements::new(source);
    let lanes = Lanes { source, statements: &statements, vectors: Vectors { lanes: source.options.lanes } };
    let group = lanes.group()?;
    let mut body = Body {
        pass: statements.scalar_level(Level::Pass),
        row: statements.scalar_level(Level::Row),
        row_end: statements.scalar_level(Level::RowEnd),
        pass_end: statements.scalar_level(Level::PassEnd),
        ..Body::default()
    };
    lanes.splats(&mut body);
    let mut file = File::default();
    rust::head(&mut file, source);
    file.line("use core::arch::x86_64::*;");
    file.line("");
    rust::types(&mut file, source);
    rust::helpers(&mut file, &statements);
    lanes.total(&mut file);
    rust::open(&mut file, source, &statements, "\n/// `None`, too, on a processor without the vectors.");
    let has: Vec<String> =
        lanes.vectors.features().iter().map(|name| format!("!std::is_x86_feature_detected!(\"{name}\")")).collect();
    file.open(&format!("if {} {{", has.join(" || ")));
    file.line("return None;");
    file.close("}");
    let planes: Vec<&str> = statements.words.planes.iter().map(String::as_str).collect();
    file.line("// SAFETY: the processor has the vectors, and the planes hold the window.");
    file.line(&format!("unsafe {{ {}_rows({}, window, inputs) }}", source.name, planes.join(", ")));
    file.close("}");
    file.line("");
    file.line("/// The loops, for planes that hold the window.");
    file.line(&format!("#[target_feature(enable = \"{}\")]", lanes.vectors.features().join(",")));
    file.line("#[allow(non_snake_case, unused_unsafe, clippy::all)]");
    file.open(&format!("unsafe fn {}_rows(", source.name));
    for (word, pixel) in statements.words.planes.iter().zip(&source.options.pixels) {
        file.line(&format!("{word}: Plane<'_, {}>,", pixel.name()));
    }
    file.line("window: Window,");
    file.line(&format!("inputs: &[f64; {}],", source.program.inputs().len()));
    file.turn(") -> Option<Sums> {");
    file.line("let mut pixels = 0_u64;");
    let saturates = source.program.pixel_set().saturated.is_some();
    file.line(&format!("let {}saturated = 0_u64;", if saturates { "mut " } else { "" }));
    let ramp: Vec<String> = (0..source.options.lanes).map(|i| format!("{i}.0")).collect();
    let ramp: Vec<&str> = ramp.iter().map(String::as_str).collect();
    file.line(&format!("let ramp = {};", lanes.vectors.call("setr_ps", &ramp)));
    rust::passes(&mut file, source, &statements, &body, &mut |file| lanes.row(file, &group, accumulators));
    file.close("}");
    Ok(file.text)
}

struct Lanes<'a> {
    source: &'a ExportSubject<'a>,
    statements: &'a Statements<'a>,
    vectors: Vectors,
}

impl Lanes<'_> {
    fn word(&self, value: Value) -> &str {
        &self.statements.words.values[value.index()]
    }

    fn held(&self, value: Value) -> Held {
        self.statements.held[value.index()]
    }

    /// A value in the pixel loop.
    fn read(&self, value: Value) -> String {
        let instruction = self.source.program.instruction(value);
        match instruction.op.constant() {
            Some(x) => self.vectors.splat(&self.statements.spelling(Level::Pixel).literal(x)),
            None if instruction.level == Level::Pixel => self.word(value).to_string(),
            _ => format!("{}_v", self.word(value)),
        }
    }

    /// Broadcasts the outer values that the loop reads.
    fn splats(&self, body: &mut Body) {
        for value in self.statements.read_by_pixels() {
            let word = self.word(value);
            let splat = match self.held(value) {
                Held::Truth => self.vectors.splat_truth(word),
                Held::Number => self.vectors.splat(&format!("{word} as f32")),
            };
            let line = format!("let {word}_v = {splat};");
            let pass = self.source.program.instruction(value).level == Level::Pass;
            if pass { body.pass.push(line) } else { body.row.push(line) }
        }
    }

    /// The statements of a group, without its pixels.
    fn group(&self) -> Result<Vec<String>, ExportError> {
        let (mut lines, mut shown) = (Vec::new(), None);
        for (value, op, span) in self.statements.at(Level::Pixel) {
            let word = self.word(value);
            let expression = match op.code {
                Opcode::Channel(_) => continue,
                Opcode::Offset => {
                    self.vectors.call("add_ps", &[&format!("{word}_at"), &self.vectors.splat(&format!("{word}_part"))])
                }
                _ => {
                    let spelled = self.vectors.operation(op, self.held(value), &|v| self.read(v));
                    spelled.ok_or(ExportError::NotInLanes("elementary functions"))?
                }
            };
            self.statements.show(span, &mut shown, &mut lines);
            lines.push(format!("let {word} = {expression};"));
        }
        Ok(lines)
    }

    /// The channels read, each with its plane.
    fn channels(&self) -> Vec<(Value, usize)> {
        let channel = |(value, op, _): (Value, Op, _)| {
            if let Opcode::Channel(c) = op.code { Some((value, c.index())) } else { None }
        };
        self.statements.at(Level::Pixel).filter_map(channel).collect()
    }

    fn row(&self, file: &mut File, group: &[String], accumulators: &[Value]) {
        let (lanes, packed) = (self.source.options.lanes, self.source.options.packed);
        for (_, plane) in rust::planes_read(self.statements) {
            let length = if packed { "count".to_string() } else { format!("(count - 1) * {plane}.strides[0] + 1") };
            file.line(&format!("let at = {};", rust::place(self.source, plane)));
            file.line(&format!("let {plane}_row = &{plane}.pixels[at..at + {length}];"));
        }
        let offsets = self.statements.offsets();
        if !offsets.is_empty() {
            file.line("let x_first = (window.first[0] + start) as f64;");
        }
        for (value, c) in offsets {
            let (word, c) = (self.word(value), self.statements.read(c, Level::Row));
            file.line(&format!("let {word}_n = nearest(-({c}));"));
            file.line(&format!("let {word}_part = ({c} + {word}_n) as f32;"));
            let first = self.vectors.splat(&format!("(x_first - {word}_n) as f32"));
            file.line(&format!("let mut {word}_at = {};", self.vectors.call("add_ps", &[&first, "ramp"])));
        }
        for i in 0..accumulators.len() {
            file.line(&format!("let mut sum{i} = {};", self.vectors.call("setzero_ps", &[])));
        }
        let set = self.source.program.pixel_set();
        let counted = set.mask.is_some() || set.saturated.is_some();
        file.line(if counted { "let mut row_pixels = 0_usize;" } else { "let row_pixels = count;" });
        file.line("let mut i = 0;");
        file.open(&format!("while i + {lanes} < count {{"));
        file.line("// pixels, as many as there are lanes");
        for (value, c) in self.channels() {
            let plane = &self.statements.words.planes[c];
            let load = match packed {
                true => self.vectors.load(self.source.options.pixels[c], &format!("{plane}_row.as_ptr().add(i)")),
                false => {
                    file.line(&format!(
                        "let {plane}_group: [_; {lanes}] = core::array::from_fn(|l| {plane}_row[(i + l) * {plane}.strides[0]]);"
                    ));
                    self.vectors.load(self.source.options.pixels[c], &format!("{plane}_group.as_ptr()"))
                }
            };
            file.line(&format!("let {} = {load};", self.word(value)));
        }
        file.lines(group);
        self.add(file, None, accumulators);
        for (value, _) in self.statements.offsets() {
            let word = self.word(value);
            let step = self.vectors.splat(&format!("{lanes}.0"));
            file.line(&format!("{word}_at = {};", self.vectors.call("add_ps", &[&format!("{word}_at"), &step])));
        }
        file.line(&format!("i += {lanes};"));
        file.close("}");
        file.line("// the last group: begins further left where it would leave the window; other lanes repeat a pixel of the row");
        file.line(&format!("let early = (start + i).saturating_sub(window.size[0].saturating_sub({lanes}));"));
        file.line(&format!(
            "let inside = {};",
            self.vectors.between("ramp", "early as f32", "(early + count - i) as f32")
        ));
        for (value, _) in self.statements.offsets() {
            let word = self.word(value);
            let early = self.vectors.splat("early as f32");
            file.line(&format!("{word}_at = {};", self.vectors.call("sub_ps", &[&format!("{word}_at"), &early])));
        }
        for (value, c) in self.channels() {
            let plane = &self.statements.words.planes[c];
            let place = "(i + l).saturating_sub(early).min(count - 1)";
            let place = if packed { place.to_string() } else { format!("{place} * {plane}.strides[0]") };
            file.line(&format!("let {plane}_group: [_; {lanes}] = core::array::from_fn(|l| {plane}_row[{place}]);"));
            let load = self.vectors.load(self.source.options.pixels[c], &format!("{plane}_group.as_ptr()"));
            file.line(&format!("let {} = {load};", self.word(value)));
        }
        file.lines(group);
        self.add(file, Some("inside"), accumulators);
        for i in 0..accumulators.len() {
            file.line(&format!("let sum{i} = total(core::mem::transmute(sum{i}));"));
        }
    }

    /// Adds to the sums where the pixel set holds.
    fn add(&self, file: &mut File, inside: Option<&str>, accumulators: &[Value]) {
        let set = self.source.program.pixel_set();
        let mut used = inside.map(String::from);
        if let Some(mask) = set.mask {
            let mask = self.read(mask);
            file.line(&format!("let used = {};", used.map_or(mask.clone(), |used| self.vectors.both(&used, &mask))));
            used = Some("used".into());
        }
        if let Some(saturated) = set.saturated {
            let saturated = self.read(saturated);
            let (all, left) = match &used {
                Some(used) => (self.vectors.both(used, &saturated), self.vectors.without(&saturated, used)),
                None => (saturated.clone(), self.vectors.not(&saturated)),
            };
            file.line(&format!("let out = {all};"));
            file.line(&format!("saturated += u64::from({});", self.vectors.count("out")));
            file.line(&format!("let used = {left};"));
            used = Some("used".into());
        }
        if set.mask.is_some() || set.saturated.is_some() {
            file.line(&format!("row_pixels += {} as usize;", self.vectors.count("used")));
        }
        for (i, value) in accumulators.iter().enumerate() {
            let sum = format!("sum{i}");
            let added = match self.statements.contractions[i] {
                None => self.vectors.add_where(used.as_deref(), &sum, &self.read(*value)),
                Some((a, b)) => {
                    let [a, b] = [a, b].map(|v| self.read(v));
                    self.vectors.add_product_where(used.as_deref(), &sum, [&a, &b])
                }
            };
            file.line(&format!("{sum} = {added};"));
        }
    }

    /// The function that adds lanes in f64: halves the vector until one lane is left.
    fn total(&self, file: &mut File) {
        let lanes = self.source.options.lanes;
        file.line("/// The lanes of a row's sum: the upper half is added to the lower one until one is left.");
        file.open(&format!("fn total(lanes: [f32; {lanes}]) -> f64 {{"));
        file.line("let mut sums = lanes.map(f64::from);");
        let mut count = lanes;
        while count > 1 {
            count /= 2;
            file.open(&format!("for i in 0..{count} {{"));
            file.line(&format!("sums[i] += sums[i + {count}];"));
            file.close("}");
        }
        file.line("sums[0]");
        file.close("}");
        file.line("");
    }
}
