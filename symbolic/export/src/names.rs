//! Chooses unique identifiers for a program's values: the document's names where they exist, never a word of C or Rust.

use std::collections::BTreeSet;

use isophote_symbolic::{Input, Op, Opcode, Program};

/// Reserved identifiers: words of C, of Rust, of C's headers, and those that the exported function uses itself.
const TAKEN: &str = "auto break case char const continue default do double else enum extern float for goto if inline int long \
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false \
    as async await crate dyn fn impl in let loop match mod move mut pub ref self super trait type unsafe use where abstract become \
    box final macro override priv try typeof unsized virtual yield gen \
    main size_t ptrdiff_t y0 y1 yn j0 j1 jn gamma log2 index \
    window inputs sums out plane row slice volume start end count lo hi first last distance at pixels saturated row_pixels x_first \
    i i64 u64 f64 f32 usize u8 u16 core std";

/// True for a valid function name in both languages and on file systems. An underscore keeps it apart from the
/// functions of both languages' libraries and from those of the file.
pub(super) fn is_function_name(name: &str) -> bool {
    let word = name.contains('_') && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
    word && name.starts_with(|c: char| c.is_ascii_lowercase()) && name.len() <= 128 && !is_taken(name)
}

fn is_taken(name: &str) -> bool {
    TAKEN.split_whitespace().any(|word| word == name)
        || isophote_symbolic::Function1::named(name).is_some()
        || ["sqrt", "abs", "fabs", "pow", "atan2", "fma", "rint", "signal", "raise", "bessel_ratio", "sinc_ratio"]
            .contains(&name)
}

/// A document's name as an identifier. The languages and their libraries have many words, but few of up to three small
/// letters and digits, and those are [`TAKEN`]; none of theirs or ours ends in an underscore.
fn worded(name: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut word: String = name.chars().map(letter).collect();
    let is_short = word.len() <= 3 && word.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
    if !is_short || !word.starts_with(|c: char| c.is_ascii_lowercase()) {
        word.push('_');
    }
    if word.starts_with('_') { format!("p{word}") } else { word }
}

/// True for a generated identifier: one of these prefixes and a number.
fn is_numbered(name: &str) -> bool {
    let number = name.find(|c: char| c.is_ascii_digit()).filter(|at| ["t", "sum", "total"].contains(&&name[..*at]));
    number.is_some_and(|at| name[at..].bytes().all(|b| b.is_ascii_digit()))
}

/// The identifiers of a program.
pub(super) struct Words {
    /// One per value.
    pub values: Vec<String>,
    /// One per channel's plane.
    pub planes: Vec<String>,
}

impl Words {
    pub fn of(program: &Program) -> Words {
        let mut used = BTreeSet::new();
        let mut take = |wish: String| {
            let mut word = wish;
            while is_taken(&word) || is_numbered(&word) || used.contains(&word) || is_suffixed(&word) {
                word.push('_');
            }
            used.insert(word.clone());
            word
        };
        let names = program.names();
        let channels: Vec<String> = names.channels.iter().map(|name| take(worded(name))).collect();
        let planes = names.channels.iter().map(|name| take(format!("{}_plane", worded(name)))).collect();
        let input = |input: &Input| match *input {
            Input::Parameter(p) => worded(&names.parameters[p.index()]),
            Input::Entry(p) => format!("{}_entry", worded(&names.parameters[p.index()])),
            Input::Constant(c) => worded(&names.constants[c.index()]),
            Input::Saturation(c) => format!("{}_limit", worded(&names.channels[c.index()])),
            Input::Shift(c) => format!("{}_shift", worded(&names.coordinates[c.index()])),
        };
        let inputs: Vec<String> = program.inputs().iter().map(|i| take(input(i))).collect();
        let coordinates: Vec<String> = names.coordinates.iter().map(|name| take(worded(name))).collect();
        let mut seen = BTreeSet::new();
        let value = |(i, op): (usize, Op)| {
            let word = match op.code {
                Opcode::Input(input) => Some(inputs[input.index()].clone()),
                Opcode::Outer(c) => Some(coordinates[c.index()].clone()),
                Opcode::Channel(c) => Some(channels[c.index()].clone()),
                _ => None,
            };
            // A program may hold the same leaf twice; the second gets a number.
            word.filter(|word| seen.insert(word.clone())).unwrap_or_else(|| format!("t{i}"))
        };
        let values = program.instructions().iter().map(|x| x.op).enumerate().map(value).collect();
        Words { values, planes }
    }
}

/// True for endings that the writers append to identifiers.
fn is_suffixed(word: &str) -> bool {
    ["_f", "_v", "_m", "_n", "_row", "_at", "_part"].iter().any(|ending| word.ends_with(ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_could_be_reserved_end_in_an_underscore() {
        let names = ["bx", "phi", "nearest", "None", "_", "a²", "read_noise", "NAN", "sqrtf"];
        let words = ["bx", "phi", "nearest_", "None_", "p__", "a__", "read_noise_", "NAN_", "sqrtf_"];
        assert_eq!(names.map(worded), words);
    }

    #[test]
    fn reserved_words_are_refused_as_function_names() {
        for word in ["double", "fn", "exp", "round", "nearest", "window", "", "9_a", "A_", "a-b_", "a b_", "ä_"] {
            assert!(!is_function_name(word), "{word}");
        }
        assert!(is_function_name("isophote_9") && is_function_name("my_spot"));
        assert!(
            is_numbered("t1")
                && is_numbered("sum20")
                && !is_numbered("t0_")
                && !is_numbered("tau1")
                && !is_numbered("t")
        );
    }
}
