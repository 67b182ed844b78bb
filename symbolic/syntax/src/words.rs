//! Reserved words of the formula language.

use isophote_elementary::Function1;

/// Reserved names besides the functions of one argument.
pub const RESERVED: [&str; 14] =
    ["and", "or", "not", "if", "piecewise", "sum", "product", "min", "max", "abs", "sqrt", "pi", "atan2", "table"];

/// True of [`RESERVED`] and the functions of one argument.
pub fn is_reserved(name: &str) -> bool {
    RESERVED.contains(&name) || Function1::named(name).is_some()
}

/// The built-in functions, sorted.
pub fn functions() -> Vec<&'static str> {
    let names = Function1::ALL.iter().map(|f| f.name()).chain(RESERVED);
    let mut names: Vec<&str> = names.filter(|name| is_function(name)).collect();
    names.sort_unstable();
    names
}

/// True of the built-in functions.
pub fn is_function(name: &str) -> bool {
    is_reserved(name) && !matches!(name, "and" | "or" | "not" | "pi")
}
