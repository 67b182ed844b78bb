//! Words for the values of a program: the document's own where it has one, never a word of C or Rust, never one twice.

use std::collections::BTreeSet;

use crate::program::{Input, Op, Program};

/// Words that a value cannot have: of C, of Rust, of C's headers, and those that the exported function uses itself.
const TAKEN: &str = "auto break case char const continue default do double else enum extern float for goto if inline int long \
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false \
    as async await crate dyn fn impl in let loop match mod move mut pub ref self super trait type unsafe use where abstract become \
    box final macro override priv try typeof unsized virtual yield gen \
    main size_t ptrdiff_t y0 y1 yn j0 j1 jn gamma log2 index \
    window inputs sums out plane row slice volume start end count lo hi first last distance at pixels saturated row_pixels x_first \
    i i64 u64 f64 f32 usize u8 u16 core std";

/// True for what may name a function: it is written into both languages and onto file systems.
pub(super) fn is_function_name(name: &str) -> bool {
    let word = name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
    word && name.starts_with(|c: char| c.is_ascii_lowercase()) && name.len() <= 128 && !is_taken(name)
}

fn is_taken(name: &str) -> bool {
    TAKEN.split_whitespace().any(|word| word == name)
        || crate::function::Function1::named(name).is_some()
        || ["sqrt", "abs", "fabs", "pow", "atan2", "fma", "rint", "signal", "raise"].contains(&name)
}

/// Words of ours carry a number behind one of these.
fn is_numbered(name: &str) -> bool {
    let number = name.find(|c: char| c.is_ascii_digit()).filter(|at| ["t", "sum", "total"].contains(&&name[..*at]));
    number.is_some_and(|at| name[at..].bytes().all(|b| b.is_ascii_digit()))
}

/// The words of a program.
pub(super) struct Words {
    /// One a value.
    pub values: Vec<String>,
    /// One a channel: its plane.
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
        let channels: Vec<String> = names.channels.iter().map(|name| take(name.clone())).collect();
        let planes = names.channels.iter().map(|name| take(format!("{name}_plane"))).collect();
        let input = |input: &Input| match *input {
            Input::Parameter(p) => names.parameters[p.index()].clone(),
            Input::Entry(p) => format!("{}_entry", names.parameters[p.index()]),
            Input::Constant(c) => names.constants[c.index()].clone(),
            Input::Saturation(c) => format!("{}_limit", names.channels[c.index()]),
            Input::Shift(c) => format!("{}_shift", names.coordinates[c.index()]),
        };
        let inputs: Vec<String> = program.inputs().iter().map(|i| take(input(i))).collect();
        let coordinates: Vec<String> = names.coordinates.iter().map(|name| take(name.clone())).collect();
        let mut seen = BTreeSet::new();
        let value = |(i, op): (usize, Op)| {
            let word = match op {
                Op::Input(input) => Some(inputs[input.index()].clone()),
                Op::Outer(c) => Some(coordinates[c.index()].clone()),
                Op::Channel(c) => Some(channels[c.index()].clone()),
                _ => None,
            };
            // A program may hold the same leaf twice; the second one gets a number.
            word.filter(|word| seen.insert(word.clone())).unwrap_or_else(|| format!("t{i}"))
        };
        let values = program.instructions().iter().map(|x| x.op).enumerate().map(value).collect();
        Words { values, planes }
    }
}

/// Endings that the text puts behind a word of ours or of the document.
fn is_suffixed(word: &str) -> bool {
    ["_f", "_v", "_m", "_n", "_row", "_at", "_part"].iter().any(|ending| word.ends_with(ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_the_languages_and_ours_are_refused() {
        for word in ["double", "fn", "exp", "sqrt", "window", "", "9a", "A", "a-b", "a b", "ä"] {
            assert!(!is_function_name(word), "{word}");
        }
        assert!(is_function_name("isophote_9") && is_function_name("spot"));
        assert!(
            is_numbered("t1")
                && is_numbered("sum20")
                && !is_numbered("t0_")
                && !is_numbered("tau1")
                && !is_numbered("t")
        );
    }
}
