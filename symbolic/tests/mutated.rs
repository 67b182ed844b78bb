//! No document makes the reader panic: the shipped models, TOML and JSON, changed at random, are read or refused, and what is
//! told of them can be shown. `MUTATIONS=10000` changes each of them so often.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::panic::catch_unwind;
use std::path::Path;

use isophote_symbolic::{Diagnostics, Model};

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % count.max(1) as u64) as usize
    }
}

/// What is put in: quotes, escapes, line ends, brackets, words of the language, characters of one to four bytes.
const PIECES: [&str; 40] = [
    "\"",
    "'",
    "\"\"\"",
    "'''",
    "\\",
    "\\\n",
    "\\\r\n  ",
    "\\u00e9",
    "\\U0001f600",
    "\\uD83D",
    "\\x",
    "\n",
    "\r",
    "\t",
    "=",
    "#",
    "[",
    "]",
    "{",
    "}",
    "(",
    ")",
    ",",
    ".",
    "[[stages]]",
    "-",
    "^",
    "*",
    "1e999",
    "0x",
    "not ",
    "sum(",
    "é",
    "\u{a0}",
    "\u{301}",
    "明",
    "😀",
    "\u{202e}",
    "\u{feff}",
    "\0",
];

/// The text with one to six changes.
fn changed(text: &str, random: &mut Random) -> String {
    let mut text: Vec<char> = text.chars().collect();
    for _ in 0..=random.below(5) {
        let at = random.below(text.len() + 1);
        let end = (at + random.below(12)).min(text.len());
        let piece = PIECES[random.below(PIECES.len())].chars();
        match random.below(6) {
            0 => drop(text.splice(at..at, piece)),
            1 => drop(text.splice(at..end, piece)),
            2 => drop(text.drain(at..end)),
            3 => drop(text.splice(at..at, text[at..end].to_vec())),
            4 if random.below(4) == 0 => text.truncate(at),
            _ => {
                let other = random.below(text.len());
                if at < text.len() {
                    text.swap(at, other);
                }
            }
        }
    }
    let mut bytes = text.into_iter().collect::<String>().into_bytes();
    if random.below(4) == 0 && !bytes.is_empty() {
        let at = random.below(bytes.len());
        bytes[at] ^= 1 << random.below(8);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// What is wrong with what is told.
fn fault_of(faults: &Diagnostics, document: &str) -> Option<String> {
    let is_told = |d: &&isophote_symbolic::Diagnostic| {
        let (start, end) = (d.span.start as usize, d.span.end as usize);
        let lines = document.split('\n').count();
        start <= end
            && document.get(start..end).is_some()
            && (1..=lines).contains(&(d.line as usize))
            && d.column >= 1
            && d.render("document").starts_with("error[")
    };
    match faults.iter().find(|d| !is_told(d)) {
        _ if faults.is_empty() => Some("refused without a word".into()),
        found => found.map(|d| format!("{d:?}")),
    }
}

#[test]
fn no_change_of_a_shipped_model_makes_the_reader_panic() {
    let count: u64 = std::env::var("MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(60);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    let mut refused = 0;
    for path in &paths {
        let toml = fs::read_to_string(path).unwrap();
        let json = serde_json::to_string_pretty(Model::from_toml(&toml).unwrap().document()).unwrap();
        for seed in 0..count {
            for (is_json, text) in [(false, &toml), (true, &json)] {
                let document = changed(text, &mut Random(seed));
                let read = || if is_json { Model::from_json(&document) } else { Model::from_toml(&document) };
                let told = catch_unwind(|| read().map(drop).map_err(|faults| fault_of(&faults, &document)));
                let name = path.file_name().unwrap().to_string_lossy();
                match told {
                    Err(_) => panic!("{name}, seed {seed}, JSON: {is_json}: panicked at {document:?}"),
                    Ok(Err(Some(fault))) => panic!("{name}, seed {seed}, JSON: {is_json}: {fault}"),
                    Ok(Err(None)) => refused += 1,
                    Ok(Ok(())) => {}
                }
            }
        }
    }
    assert!(2 * refused as u64 > count * paths.len() as u64, "only {refused} changes were told");
}
