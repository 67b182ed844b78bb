//! Typesets names in LaTeX and MathML.
//!
//! A single letter is italic, a Greek letter's name becomes the letter, digits at the end are an index (a1 → a₁), and
//! so is a coordinate after one letter (bx → bₓ). All else is upright as spelled. No two names look alike: Greek
//! letters that look Latin are spelled out, a name with `_` is never split, and of two names with one look (`phi` and
//! `φ`) the later is spelled out.

use std::collections::BTreeMap;

/// Letter, name, LaTeX command.
const GREEK: [(char, &str, &str); 28] = [
    ('α', "alpha", "alpha"),
    ('β', "beta", "beta"),
    ('γ', "gamma", "gamma"),
    ('δ', "delta", "delta"),
    ('ε', "epsilon", "varepsilon"),
    ('ζ', "zeta", "zeta"),
    ('η', "eta", "eta"),
    ('θ', "theta", "theta"),
    ('κ', "kappa", "kappa"),
    ('λ', "lambda", "lambda"),
    ('μ', "mu", "mu"),
    ('ξ', "xi", "xi"),
    ('ρ', "rho", "rho"),
    ('σ', "sigma", "sigma"),
    ('τ', "tau", "tau"),
    ('φ', "phi", "varphi"),
    ('χ', "chi", "chi"),
    ('ψ', "psi", "psi"),
    ('ω', "omega", "omega"),
    ('Γ', "Gamma", "Gamma"),
    ('Δ', "Delta", "Delta"),
    ('Θ', "Theta", "Theta"),
    ('Λ', "Lambda", "Lambda"),
    ('Ξ', "Xi", "Xi"),
    ('Σ', "Sigma", "Sigma"),
    ('Φ', "Phi", "Phi"),
    ('Ψ', "Psi", "Psi"),
    ('Ω', "Omega", "Omega"),
];

/// A name without its index.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Stem {
    /// Italic.
    Letter(char),
    /// The letter and its LaTeX command.
    Greek(char, &'static str),
    /// Upright, as spelled.
    Word(String),
}

/// A typeset name.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) struct Glyph {
    pub stem: Stem,
    pub index: Option<String>,
}

/// How a model's names are typeset.
pub(crate) struct Looks {
    coordinates: Vec<char>,
    spelled: BTreeMap<String, Glyph>,
}

impl Looks {
    pub fn new(coordinates: &[String], names: &[&str]) -> Looks {
        let letter = |name: &String| {
            let mut letters = name.chars();
            letters.next().filter(|_| letters.next().is_none())
        };
        let mut looks =
            Looks { coordinates: coordinates.iter().filter_map(letter).collect(), spelled: BTreeMap::new() };
        let mut taken = std::collections::BTreeSet::new();
        for name in names {
            if !taken.insert(looks.of(name)) {
                looks.spelled.insert(name.to_string(), Glyph { stem: Stem::Word(name.to_string()), index: None });
            }
        }
        looks
    }

    pub fn of(&self, name: &str) -> Glyph {
        if let Some(look) = self.spelled.get(name) {
            return look.clone();
        }
        let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
        if stem.is_empty() || name.contains('_') {
            return Glyph { stem: Stem::Word(name.to_string()), index: None };
        }
        if stem.len() < name.len() {
            return Glyph {
                stem: sign(stem).unwrap_or_else(|| Stem::Word(stem.to_string())),
                index: Some(name[stem.len()..].to_string()),
            };
        }
        if let Some(sign) = sign(name) {
            return Glyph { stem: sign, index: None };
        }
        let before = name.char_indices().next_back().filter(|(_, last)| self.coordinates.contains(last));
        match before.and_then(|(at, last)| sign(&name[..at]).map(|stem| (stem, last))) {
            Some((stem, last)) => Glyph { stem, index: Some(last.to_string()) },
            None => Glyph { stem: Stem::Word(name.to_string()), index: None },
        }
    }
}

/// One letter, Latin or Greek.
fn sign(name: &str) -> Option<Stem> {
    let mut letters = name.chars();
    let only = letters.next().filter(|_| letters.next().is_none());
    let greek = GREEK.iter().find(|(letter, spelled, _)| *spelled == name || only == Some(*letter));
    match greek {
        Some((letter, _, command)) => Some(Stem::Greek(*letter, command)),
        None => only.filter(char::is_ascii_alphabetic).map(Stem::Letter),
    }
}
