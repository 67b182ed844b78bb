//! Writes the file around the statements, in Rust.

use isophote_symbolic::{Level, Opcode, Precision, Sink};

use crate::body::{Body, Statements};
use crate::header;
use crate::lines::File;
use crate::options::{ExportSubject, Language};
use crate::special;

/// The whole file.
pub(super) fn file(source: &ExportSubject<'_>) -> String {
    let statements = Statements::new(source);
    let body = statements.body();
    let mut file = File::default();
    head(&mut file, source);
    types(&mut file, source);
    helpers(&mut file, &statements);
    function(&mut file, source, &statements, &body);
    file.text
}

/// The head comment.
pub(super) fn head(file: &mut File, source: &ExportSubject<'_>) {
    header::lines(source).iter().for_each(|line| file.line(format!("// {line}").trim_end()));
    file.line("//");
    file.line("// `None` for a window that is empty or leaves a plane, and for a plane whose slice is too short.");
    file.line("");
}

/// Planes, windows and sums.
pub(super) fn types(file: &mut File, source: &ExportSubject<'_>) {
    let dimensions = source.dimensions();
    file.line("/// A plane: its pixels, how many there are along each coordinate, and how far it is to the next one, in pixels.");
    file.line("#[derive(Clone, Copy)]");
    file.open("pub struct Plane<'a, T> {");
    file.line("pub pixels: &'a [T],");
    file.line(&format!("pub size: [usize; {dimensions}],"));
    file.line(&format!("pub strides: [usize; {dimensions}],"));
    file.close("}");
    file.line("");
    file.open("impl<T> Plane<'_, T> {");
    file.line("/// True when the window has pixels and all of them are in the slice.");
    file.open("fn holds(&self, window: &Window) -> bool {");
    file.line("let mut end = 1_usize;");
    file.open(&format!("for i in 0..{dimensions} {{"));
    file.open("let past = match window.first[i].checked_add(window.size[i]) {");
    file.line("Some(past) if window.size[i] > 0 && past <= self.size[i] => past,");
    file.line("_ => return false,");
    file.close("};");
    file.line(&match source.options.packed {
        true => "let stride = if i == 0 { 1 } else { self.strides[i] };".to_string(),
        false => "let stride = self.strides[i];".to_string(),
    });
    file.open("end = match (past - 1).checked_mul(stride).and_then(|last| last.checked_add(end)) {");
    file.line("Some(end) => end,");
    file.line("None => return false,");
    file.close("};");
    file.close("}");
    file.line("end <= self.pixels.len()");
    file.close("}");
    file.close("}");
    file.line("");
    file.line("/// The pixels to process: the first along each coordinate, and how many.");
    file.line("#[derive(Clone, Copy)]");
    file.open("pub struct Window {");
    file.line(&format!("pub first: [usize; {dimensions}],"));
    file.line(&format!("pub size: [usize; {dimensions}],"));
    file.close("}");
    file.line("");
    file.line("/// What is handed back.");
    file.line("#[derive(Clone, Copy, Debug)]");
    file.open("pub struct Sums {");
    if let Sink::Sums { outputs, .. } = source.program.sink() {
        file.line(&format!("pub outputs: [f64; {}],", outputs.len()));
    }
    file.line("/// Used.");
    file.line("pub pixels: u64,");
    file.line("/// Left out as saturated.");
    file.line("pub saturated: u64,");
    file.close("}");
    file.line("");
}

/// Functions that the standard library lacks, if called.
pub(super) fn helpers(file: &mut File, statements: &Statements<'_>) {
    if !statements.offsets().is_empty() {
        file.line("/// The nearest whole number, ties to even, for magnitudes below 2^51.");
        file.open("fn nearest(x: f64) -> f64 {");
        file.line("const MAGIC: f64 = 6755399441055744.0;");
        file.line("(x + MAGIC) - MAGIC");
        file.close("}");
        file.line("");
    }
    special::functions(file, statements, Language::Rust);
}

/// The function's signature and checks, up to the first statement of the pass.
pub(super) fn open(file: &mut File, source: &ExportSubject<'_>, statements: &Statements<'_>, attributes: &str) {
    let program = source.program;
    let planes = statements.words.planes.iter().zip(&source.options.pixels);
    file.line(&format!(
        "/// Runs the loops over a window; what `inputs` and `outputs` are stands at the top.{attributes}"
    ));
    file.line("#[allow(non_snake_case, clippy::all)]");
    file.open(&format!("pub fn {}(", source.name));
    planes.for_each(|(word, pixel)| file.line(&format!("{word}: Plane<'_, {}>,", pixel.name())));
    file.line("window: Window,");
    let reads = program
        .instructions()
        .iter()
        .zip(&statements.live)
        .any(|(x, live)| *live && matches!(x.op.code, Opcode::Input(_)));
    file.line(&format!("{}inputs: &[f64; {}],", if reads { "" } else { "_" }, program.inputs().len()));
    if let Sink::Plane(_) = program.sink() {
        file.line("out: &mut [f32],");
    }
    file.turn(") -> Option<Sums> {");
    let checks: Vec<String> = statements.words.planes.iter().map(|plane| format!("!{plane}.holds(&window)")).collect();
    file.open(&format!("if {} {{", checks.join(" || ")));
    file.line("return None;");
    file.close("}");
    if let Sink::Plane(_) = program.sink() {
        file.open("if window.size.iter().product::<usize>() > out.len() {");
        file.line("return None;");
        file.close("}");
    }
}

fn function(file: &mut File, source: &ExportSubject<'_>, statements: &Statements<'_>, body: &Body) {
    let program = source.program;
    open(file, source, statements, "");
    file.line("let mut pixels = 0_u64;");
    file.line(&format!("let {}saturated = 0_u64;", if program.pixel_set().saturated.is_some() { "mut " } else { "" }));
    passes(file, source, statements, body, &mut |file| pixel_loop(file, source, statements, body));
    file.close("}");
}

/// The loops and outer levels around a row's inner part.
pub(super) fn passes(
    file: &mut File,
    source: &ExportSubject<'_>,
    statements: &Statements<'_>,
    body: &Body,
    inner: &mut dyn FnMut(&mut File),
) {
    let program = source.program;
    if let Sink::Sums { totals, .. } = program.sink() {
        (0..totals.len()).for_each(|i| file.line(&format!("let mut total{i} = 0.0_f64;")));
    }
    file.line("// pass");
    file.lines(&body.pass);
    let loops: Vec<(usize, &str)> =
        [(3, "volume"), (2, "slice"), (1, "row")].into_iter().filter(|(d, _)| *d < source.dimensions()).collect();
    for (d, word) in &loops {
        file.open(&format!("for {word} in 0..window.size[{d}] {{"));
    }
    range(file, statements, body);
    inner(file);
    file.line("pixels += row_pixels as u64;");
    file.line("// row end");
    if let Sink::Sums { totals, .. } = program.sink() {
        if program.pixel_set().mask.is_some() || program.pixel_set().saturated.is_some() {
            leave_unless(file, "row_pixels > 0");
        }
        file.lines(&body.row_end);
        for (i, value) in totals.iter().enumerate() {
            file.line(&format!("total{i} += {};", statements.read(*value, Level::RowEnd)));
        }
    }
    loops.iter().for_each(|_| file.close("}"));
    file.line("// pass end");
    file.lines(&body.pass_end);
    if let Sink::Sums { outputs, .. } = program.sink() {
        let values: Vec<String> = outputs.iter().map(|v| statements.read(*v, Level::PassEnd)).collect();
        file.line(&format!("let outputs = [{}];", values.join(", ")));
        file.line("Some(Sums { outputs, pixels, saturated })");
    } else {
        file.line("Some(Sums { pixels, saturated })");
    }
}

/// The row's statements and the range of its pixels: `start`, `end`, `count`.
fn range(file: &mut File, statements: &Statements<'_>, body: &Body) {
    file.line("// row");
    file.lines(&body.row);
    match statements.program().pixel_set().bounds {
        None => {
            file.line("let start = 0;");
            file.line("let end = window.size[0] - 1;");
        }
        Some((lo, hi)) => {
            file.line("// from the first to the last pixel of the domain, if the row has any");
            file.line("let first = window.first[0] as f64;");
            file.line("let last = (window.first[0] + window.size[0] - 1) as f64;");
            let (lo, hi) = (statements.read(lo, Level::Row), statements.read(hi, Level::Row));
            file.line(&format!("let (lo, hi) = ({lo}, {hi});"));
            leave_unless(file, "lo <= hi");
            file.line("let lo = if lo > first { lo } else { first };");
            file.line("let hi = if hi < last { hi } else { last };");
            leave_unless(file, "lo <= hi");
            file.line("let mut start = (lo - first) as usize;");
            file.open("if (start as f64) < lo - first {");
            file.line("start += 1;");
            file.close("}");
            file.line("let end = (hi - first) as usize;");
            leave_unless(file, "start <= end");
        }
    }
    file.line("let count = end - start + 1;");
}

fn leave_unless(file: &mut File, condition: &str) {
    file.open(&format!("if !({condition}) {{"));
    file.line("continue;");
    file.close("}");
}

/// The index of a row's first pixel in a plane's slice.
pub(super) fn place(source: &ExportSubject<'_>, plane: &str) -> String {
    let first = match source.options.packed {
        true => "window.first[0] + start".to_string(),
        false => format!("(window.first[0] + start) * {plane}.strides[0]"),
    };
    let outer = |(d, word): (usize, &str)| format!(" + (window.first[{d}] + {word}) * {plane}.strides[{d}]");
    let loops = [(1, "row"), (2, "slice"), (3, "volume")].into_iter().filter(|(d, _)| *d < source.dimensions());
    first + &loops.map(outer).collect::<String>()
}

/// The planes that the pixel loop reads.
pub(super) fn planes_read<'s>(statements: &'s Statements<'_>) -> impl Iterator<Item = (usize, &'s String)> {
    let reads = |c: usize| {
        statements.at(Level::Pixel).any(|(_, op, _)| matches!(op.code, Opcode::Channel(id) if id.index() == c))
    };
    statements.words.planes.iter().enumerate().filter(move |(c, _)| reads(*c))
}

/// The index of the window's row in `out`.
pub(super) fn out_row(source: &ExportSubject<'_>) -> String {
    match source.dimensions() {
        2 => "row".into(),
        3 => "(slice * window.size[1] + row)".into(),
        _ => "((volume * window.size[2] + slice) * window.size[1] + row)".into(),
    }
}

fn pixel_loop(file: &mut File, source: &ExportSubject<'_>, statements: &Statements<'_>, body: &Body) {
    let set = source.program.pixel_set();
    for (_, plane) in planes_read(statements) {
        let length =
            if source.options.packed { "count".to_string() } else { format!("(count - 1) * {plane}.strides[0] + 1") };
        file.line(&format!("let at = {};", place(source, plane)));
        file.line(&format!("let {plane}_row = &{plane}.pixels[at..at + {length}];"));
    }
    if !body.before_pixels.is_empty() {
        file.line("let x_first = (window.first[0] + start) as f64;");
    }
    file.lines(&body.before_pixels);
    let spelling = statements.spelling(Level::Pixel);
    if let Sink::Sums { accumulators, .. } = source.program.sink() {
        (0..accumulators.len()).for_each(|i| file.line(&format!("let mut sum{i}: {} = 0.0;", spelling.number())));
    } else {
        file.line(&format!("let at = {} * window.size[0] + start;", out_row(source)));
        file.line("let out_row = &mut out[at..at + count];");
    }
    let counted = set.mask.is_some() || set.saturated.is_some();
    file.line(if counted { "let mut row_pixels = 0_usize;" } else { "let row_pixels = count;" });
    file.open("for i in 0..count {");
    file.line("// pixel");
    file.lines(&body.pixel);
    let read = |value| statements.read(value, Level::Pixel);
    let mut depth = 0;
    if let Some(mask) = set.mask {
        file.open(&format!("if {} {{", read(mask)));
        depth += 1;
    }
    if let Some(saturated) = set.saturated {
        file.open(&format!("if {} {{", read(saturated)));
        file.line("saturated += 1;");
        file.turn("} else {");
        depth += 1;
    }
    if depth > 0 {
        file.line("row_pixels += 1;");
    }
    match source.program.sink() {
        Sink::Sums { accumulators, .. } => {
            for (i, value) in accumulators.iter().enumerate() {
                file.line(&statements.added(i, *value));
            }
        }
        Sink::Plane(value) => {
            let narrow = if source.options.precision == Precision::F64 { " as f32" } else { "" };
            file.line(&format!("out_row[i] += {}{narrow};", statements.read(*value, Level::Pixel)));
        }
    }
    (0..depth).for_each(|_| file.close("}"));
    file.lines(&body.step);
    file.close("}");
}
