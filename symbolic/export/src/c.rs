//! Writes the file around the statements, in C99.

use std::collections::BTreeSet;

use isophote_symbolic::{Level, Opcode, Sink};

use crate::body::{Body, Statements};
use crate::header;
use crate::lines::File;
use crate::options::{ExportSubject, Language, PixelType};
use crate::special;

/// The whole file.
pub(super) fn file(source: &ExportSubject<'_>) -> String {
    let statements = Statements::new(source);
    let body = statements.body();
    let mut file = File::default();
    file.line("/*");
    for line in header::lines(source) {
        file.line(format!(" * {line}").trim_end());
    }
    file.line(" *");
    file.line(" * Returns 1; 0, and nothing is written, for a window that is empty or leaves a plane.");
    file.line(" */");
    types(&mut file, source);
    special::functions(&mut file, &statements, Language::C);
    function(&mut file, source, &statements, &body);
    file.text
}

fn c_type(pixel: PixelType) -> &'static str {
    match pixel {
        PixelType::U8 => "uint8_t",
        PixelType::U16 => "uint16_t",
        PixelType::F32 => "float",
    }
}

fn types(file: &mut File, source: &ExportSubject<'_>) {
    let (name, dimensions) = (&source.name, source.dimensions());
    for header in ["math", "stdbool", "stddef", "stdint"] {
        file.line(&format!("#include <{header}.h>"));
    }
    file.line("");
    for pixel in source.options.pixels.iter().collect::<BTreeSet<_>>() {
        file.line("/* A plane: its first pixel, pixels along each coordinate, and how far it is to the next one, in pixels. */");
        file.line("typedef struct {");
        file.line(&format!("    const {} *pixels;", c_type(*pixel)));
        file.line(&format!("    size_t size[{dimensions}];"));
        file.line(&format!("    size_t strides[{dimensions}];"));
        file.line(&format!("}} {name}_plane_{};", pixel.name()));
        file.line("");
    }
    file.line("/* The pixels to process: the first along each coordinate, and how many. */");
    file.line("typedef struct {");
    file.line(&format!("    size_t first[{dimensions}];"));
    file.line(&format!("    size_t size[{dimensions}];"));
    file.line(&format!("}} {name}_window;"));
    file.line("");
    file.line("typedef struct {");
    if let Sink::Sums { outputs, .. } = source.program.sink() {
        file.line(&format!("    double outputs[{}];", outputs.len().max(1)));
    }
    file.line("    uint64_t pixels;    /* used */");
    file.line("    uint64_t saturated; /* left out as saturated */");
    file.line(&format!("}} {name}_sums;"));
    file.line("");
}

fn function(file: &mut File, source: &ExportSubject<'_>, statements: &Statements<'_>, body: &Body) {
    let (name, program) = (&source.name, source.program);
    let planes = statements.words.planes.iter().zip(&source.options.pixels);
    let planes: Vec<String> = planes.map(|(word, pixel)| format!("{name}_plane_{} {word}", pixel.name())).collect();
    let inputs = program.inputs().len().max(1);
    let out = if matches!(program.sink(), Sink::Plane(_)) { ", float *restrict out" } else { "" };
    let head = format!(
        "int {name}({}, {name}_window window, const double inputs[{inputs}], {name}_sums *sums{out})",
        planes.join(", ")
    );
    file.line(&format!("{head};"));
    file.line("");
    file.line(&head);
    file.open("{");
    checks(file, source, statements);
    if !program
        .instructions()
        .iter()
        .zip(&statements.live)
        .any(|(x, live)| *live && matches!(x.op.code, Opcode::Input(_)))
    {
        file.line("(void)inputs;");
    }
    file.line("uint64_t pixels = 0, saturated = 0;");
    if let Sink::Sums { totals, .. } = program.sink() {
        (0..totals.len()).for_each(|i| file.line(&format!("double total{i} = 0.0;")));
    }
    file.line("/* pass */");
    file.lines(&body.pass);
    let loops: Vec<(usize, &str)> =
        [(3, "volume"), (2, "slice"), (1, "row")].into_iter().filter(|(d, _)| *d < source.dimensions()).collect();
    for (d, word) in &loops {
        file.open(&format!("for (size_t {word} = 0; {word} < window.size[{d}]; {word}++) {{"));
    }
    row(file, source, statements, body);
    loops.iter().for_each(|_| file.close("}"));
    file.line("/* pass end */");
    file.lines(&body.pass_end);
    if let Sink::Sums { outputs, .. } = program.sink() {
        for (i, value) in outputs.iter().enumerate() {
            file.line(&format!("sums->outputs[{i}] = {};", statements.read(*value, Level::PassEnd)));
        }
    }
    file.line("sums->pixels = pixels;");
    file.line("sums->saturated = saturated;");
    file.line("return 1;");
    file.close("}");
}

fn checks(file: &mut File, source: &ExportSubject<'_>, statements: &Statements<'_>) {
    file.open(&format!("for (size_t i = 0; i < {}; i++) {{", source.dimensions()));
    file.line("if (window.size[i] == 0) return 0;");
    for plane in &statements.words.planes {
        file.line(&format!("if (window.first[i] > {plane}.size[i]) return 0;"));
        file.line(&format!("if (window.size[i] > {plane}.size[i] - window.first[i]) return 0;"));
    }
    file.close("}");
}

fn row(file: &mut File, source: &ExportSubject<'_>, statements: &Statements<'_>, body: &Body) {
    let (program, set) = (source.program, source.program.pixel_set());
    let number = statements.spelling(Level::Pixel).number();
    file.line("/* row */");
    file.lines(&body.row);
    file.line("size_t start = 0, end = window.size[0] - 1;");
    if let Some((lo, hi)) = set.bounds {
        file.line("/* from the first to the last pixel of the domain, if the row has any */");
        file.line("const double first = (double)window.first[0], last = (double)(window.first[0] + end);");
        file.line(&format!(
            "double lo = {}, hi = {};",
            statements.read(lo, Level::Row),
            statements.read(hi, Level::Row)
        ));
        file.line("if (!(lo <= hi)) continue;");
        file.line("lo = lo > first ? lo : first;");
        file.line("hi = hi < last ? hi : last;");
        file.line("if (!(lo <= hi)) continue;");
        file.line("start = (size_t)(lo - first);");
        file.line("start += (double)start < lo - first;");
        file.line("end = (size_t)(hi - first);");
        file.line("if (start > end) continue;");
    }
    file.line("const size_t count = end - start + 1;");
    let reads = |c: usize| {
        statements.at(Level::Pixel).any(|(_, op, _)| matches!(op.code, Opcode::Channel(id) if id.index() == c))
    };
    for (c, plane) in statements.words.planes.iter().enumerate().filter(|(c, _)| reads(*c)) {
        let first = if source.options.packed {
            "window.first[0] + start"
        } else {
            "(window.first[0] + start) * PLANE.strides[0]"
        };
        let outer = |(d, word): (usize, &str)| format!(" + (window.first[{d}] + {word}) * PLANE.strides[{d}]");
        let outer: String = [(1, "row"), (2, "slice"), (3, "volume")]
            .into_iter()
            .filter(|(d, _)| *d < source.dimensions())
            .map(outer)
            .collect();
        let place = format!("{first}{outer}").replace("PLANE", plane);
        file.line(&format!(
            "const {} *const {plane}_row = {plane}.pixels + ({place});",
            c_type(source.options.pixels[c])
        ));
    }
    if !body.before_pixels.is_empty() {
        file.line("const double x_first = (double)(window.first[0] + start);");
    }
    file.lines(&body.before_pixels);
    if let Sink::Sums { accumulators, .. } = program.sink() {
        let zero = statements.spelling(Level::Pixel).literal(0.0);
        (0..accumulators.len()).for_each(|i| file.line(&format!("{number} sum{i} = {zero};")));
    }
    let counted = set.mask.is_some() || set.saturated.is_some();
    file.line(if counted { "size_t row_pixels = 0;" } else { "const size_t row_pixels = count;" });
    if let Sink::Plane(_) = program.sink() {
        let mut place = String::from("row");
        for (d, word) in [(2, "slice"), (3, "volume")].into_iter().filter(|(d, _)| *d < source.dimensions()) {
            place = if d == 2 {
                format!("(slice * window.size[1] + {place})")
            } else {
                format!("(({word} * window.size[2] + slice) * window.size[1] + row)")
            };
        }
        file.line(&format!("float *const out_row = out + {place} * window.size[0] + start;"));
    }
    file.open("for (size_t i = 0; i < count; i++) {");
    file.line("/* pixel */");
    file.lines(&body.pixel);
    pixel_end(file, statements);
    file.lines(&body.step);
    file.close("}");
    file.line("pixels += row_pixels;");
    file.line("/* row end */");
    if let Sink::Sums { totals, .. } = program.sink() {
        if counted {
            file.line("if (row_pixels == 0) continue;");
        }
        file.lines(&body.row_end);
        for (i, value) in totals.iter().enumerate() {
            file.line(&format!("total{i} += {};", statements.read(*value, Level::RowEnd)));
        }
    }
}

/// Adds a pixel where the mask holds and it is not saturated.
fn pixel_end(file: &mut File, statements: &Statements<'_>) {
    let set = statements.program().pixel_set();
    let read = |value| statements.read(value, Level::Pixel);
    let mut open = 0;
    if let Some(mask) = set.mask {
        file.open(&format!("if ({}) {{", read(mask)));
        open += 1;
    }
    if let Some(saturated) = set.saturated {
        file.open(&format!("if ({}) {{", read(saturated)));
        file.line("saturated++;");
        file.turn("} else {");
        open += 1;
    }
    if open > 0 {
        file.line("row_pixels++;");
    }
    match statements.program().sink() {
        Sink::Sums { accumulators, .. } => {
            for (i, value) in accumulators.iter().enumerate() {
                file.line(&statements.added(i, *value));
            }
        }
        Sink::Plane(value) => file.line(&format!("out_row[i] += (float){};", statements.read(*value, Level::Pixel))),
    }
    (0..open).for_each(|_| file.close("}"));
}
