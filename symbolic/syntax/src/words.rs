//! The words of the formula language: names that a document cannot give.

use isophote_elementary::Function1;

/// Names that the language keeps for itself, besides the functions of one argument.
pub const RESERVED: [&str; 14] =
    ["and", "or", "not", "if", "piecewise", "sum", "product", "min", "max", "abs", "sqrt", "pi", "atan2", "table"];

/// True of those, and of the functions of one argument.
pub fn is_reserved(name: &str) -> bool {
    RESERVED.contains(&name) || Function1::named(name).is_some()
}

/// The language's own functions, by name.
pub fn functions() -> Vec<&'static str> {
    let names = Function1::ALL.iter().map(|f| f.name()).chain(RESERVED);
    let mut names: Vec<&str> = names.filter(|name| is_function(name)).collect();
    names.sort_unstable();
    names
}

/// True of the language's own functions.
pub fn is_function(name: &str) -> bool {
    is_reserved(name) && !matches!(name, "and" | "or" | "not" | "pi")
}
