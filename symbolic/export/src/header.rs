//! Writes the head comment of an exported file: origin, inputs and outputs, their order and units.

use isophote_symbolic::{Input, Precision, Sink};

use crate::options::ExportSubject;

/// A document's text for a comment of C or Rust: it cannot end the comment, nor start another.
pub(super) fn comment(text: &str) -> String {
    // Compilers refuse files with bidirectional control characters.
    let turns = |c: char| matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let printable = |c: char| if c.is_control() || turns(c) { ' ' } else { c };
    let mut words: String =
        text.chars().map(printable).collect::<String>().split_whitespace().collect::<Vec<_>>().join(" ");
    for pair in ["*/", "/*", "??"] {
        let (a, b) = pair.split_at(1);
        while words.contains(pair) {
            words = words.replace(pair, &format!("{a} {b}"));
        }
    }
    words.trim_end_matches('\\').to_string()
}

/// The lines of the head, without comment marks.
pub(super) fn lines(source: &ExportSubject<'_>) -> Vec<String> {
    let (model, program, options) = (source.model, source.program, source.options);
    let mut lines = vec![format!("{}: {}", model.name(), comment(model.description()))];
    lines.push(format!("Written by isophote {} from the model {}", env!("CARGO_PKG_VERSION"), model.digest()));
    lines.push(String::new());
    lines.push(match program.sink() {
        Sink::Sums { .. } => "Sums over the pixels of a window:".into(),
        Sink::Plane(_) => {
            "Adds the model's intensity to each pixel of `out`, which has the window's size, row by row.".into()
        }
    });
    if let Sink::Sums { outputs, .. } = program.sink() {
        for (i, name) in program.names().outputs.iter().enumerate().take(outputs.len()) {
            lines.push(format!("  outputs[{i}]  {name}"));
        }
    }
    lines.push(String::new());
    lines.push("What goes in:".into());
    for (i, input) in program.inputs().iter().enumerate() {
        lines.push(format!("  inputs[{i}]  {}", meaning(source, *input)));
    }
    for (channel, pixel) in program.names().channels.iter().zip(&options.pixels) {
        lines.push(format!("  plane of `{channel}`: {}, pixel values as stored", pixel.name()));
    }
    lines.push(String::new());
    lines.push("Coordinates are pixels of the whole plane, centres at whole numbers, the inner loop first:".into());
    let (dimensions, stride) =
        (source.dimensions(), if options.packed { "; strides[0] is not read, it is 1" } else { "" });
    let named = program.names().coordinates.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    lines
        .push(format!("  {named}; a plane has size and strides along {dimensions} of them, counted in pixels{stride}"));
    if program.coordinates() == 1 {
        lines.push("  rows are rows of a picture; the model is the same in each".into());
    }
    lines.push(String::new());
    lines.extend(arithmetic(source));
    lines
}

fn arithmetic(source: &ExportSubject<'_>) -> Vec<String> {
    let (program, options) = (source.program, source.options);
    let pixel = match options.precision {
        Precision::F32 => "f32 a pixel; f64 for rows and passes",
        Precision::F64 => "f64 throughout",
    };
    let calls = program.instructions().iter().any(|x| x.op.is_call());
    let calls = if calls { ", but for elementary functions, which are the platform's" } else { "" };
    vec![
        format!(
            "Arithmetic: {pixel}, {} pixel(s) at a time. It is the interpreter's, bit for bit{calls},",
            options.lanes
        ),
        "as long as the compiler neither contracts a * b + c (-ffp-contract=off) nor reorders sums; -ffast-math would besides lose".into(),
        "the test that leaves out rows without pixels, whose bounds are NaN: add -fno-finite-math-only to it".into(),
    ]
}

fn meaning(source: &ExportSubject<'_>, input: Input) -> String {
    let (model, names) = (source.model, source.program.names());
    match input {
        Input::Parameter(p) => {
            let unit = model.parameters()[p.index()].unit.as_ref().map(|unit| format!(", {}", comment(unit)));
            format!("{}{}", names.parameters[p.index()], unit.unwrap_or_default())
        }
        Input::Entry(p) => {
            format!("{} when the pass was entered: it fixes which pixels take part", names.parameters[p.index()])
        }
        Input::Constant(c) => {
            format!("{}, a constant; {} by default", names.constants[c.index()], model.constants()[c.index()].value)
        }
        Input::Saturation(c) => format!("the value from which on `{}` is saturated", names.channels[c.index()]),
        Input::Shift(c) => format!("shift of `{}`, px", names.coordinates[c.index()]),
    }
}

#[cfg(test)]
mod tests {
    use super::comment;

    #[test]
    fn text_cannot_end_its_comment() {
        for text in ["a */ b", "**//", "/*/ x", "??/\n\\", "a\n#include <b>\\", "*\u{7}/", "*\u{202e}/"] {
            let made = comment(text);
            assert!(!made.contains("*/") && !made.contains("/*") && !made.contains("??"), "{made}");
            assert!(!made.contains('\n') && !made.ends_with('\\') && !made.contains('\u{202e}'), "{made}");
        }
        assert_eq!(comment("X' *\n A"), "X' * A");
    }
}
