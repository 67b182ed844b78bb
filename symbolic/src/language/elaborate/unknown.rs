//! Undeclared names, with suggestions.

use isophote_elementary::Function1;

use super::{Binding, Elaborator, Poison, fault};
use isophote_syntax::diagnostic::quoted;
use isophote_syntax::parser::Expr;
use isophote_syntax::words::{RESERVED, functions};

/// Names in other languages, with a hint.
const FOREIGN: [(&str, &str); 34] = [
    ("ln", "the natural logarithm is `log`"),
    ("log10", "write `log(x) / log(10)`"),
    ("log2", "write `log(x) / log(2)`"),
    ("exp2", "write `2^x`"),
    ("pow", "write `x^y`"),
    ("sqr", "write `x^2`"),
    ("square", "write `x^2`"),
    ("cbrt", "write `x^(1/3)`"),
    ("hypot", "write `sqrt(x^2 + y^2)`"),
    ("norm", "write `sqrt(v' * v)`"),
    ("dot", "a dot product is `u' * v`"),
    ("transpose", "a transposition is written `v'`"),
    ("det", "write it out: `A[0, 0]*A[1, 1] - A[0, 1]*A[1, 0]`"),
    ("inv", "write it out; a 2×2 inverse is `[[d, -b], [-c, a]] / (a*d - b*c)`"),
    ("fabs", "write `abs`"),
    ("sign", "write `if(x < 0, -1, 1)`"),
    ("sgn", "write `if(x < 0, -1, 1)`"),
    ("heaviside", "write `if(x < 0, 0, 1)`"),
    ("clamp", "write `min(max(x, low), high)`"),
    ("where", "write `if(condition, a, b)`"),
    ("select", "write `if(condition, a, b)`"),
    ("prod", "write `product(e, i, lo, hi)`"),
    ("arcsin", "write `asin`"),
    ("arccos", "write `acos`"),
    ("arctan", "write `atan`"),
    ("arctan2", "write `atan2(y, x)`"),
    ("j0", "write `bessel_j0`"),
    ("j1", "write `bessel_j1`"),
    ("floor", "there is no rounding in formulas: they must have derivatives"),
    ("round", "there is no rounding in formulas: they must have derivatives"),
    ("mod", "there is no remainder in formulas: they must have derivatives"),
    ("e", "write `exp(1)`, or `1e3` for a number with an exponent"),
    ("π", "write `pi`"),
    ("true", "write a condition: `s <= 1`"),
];

/// The message for calls.
pub const NO_FUNCTION: &str = "is not a function";

impl Elaborator<'_> {
    /// Reports an undeclared name.
    pub fn unknown(&mut self, name: &str, at: &Expr, what: &str) -> Poison {
        if self.workings.lacks_names {
            return Poison::Unknown;
        }
        // Marks the name alone, not the call.
        let mut fault = fault("unknown-name", at, format!("{} {what}", quoted(name)));
        fault.end = at.start + name.len();
        let help = match self.meant(name) {
            help if what == NO_FUNCTION => format!("{help} (functions: {})", functions().join(", ")),
            help => help,
        };
        self.tell(fault.help(help))
    }

    fn meant(&mut self, name: &str) -> String {
        let declare = "declare it under [parameters], [constants] or [definitions]";
        let is_power = |c: char| "⁰¹²³⁴⁵⁶⁷⁸⁹".contains(c);
        if let Some(base) = name.find(is_power).map(|i| &name[..i])
            && !base.is_empty()
        {
            return format!("powers are written `^`: `{base}^2`");
        }
        if let Some((_, help)) = FOREIGN.iter().find(|(foreign, _)| *foreign == name) {
            return (*help).into();
        }
        let declared = self.names.iter().filter(|(_, b)| !matches!(b, Binding::Poisoned));
        let of_language = Function1::ALL.iter().map(|f| f.name()).chain(RESERVED);
        let of_document = declared.map(|(name, _)| name.as_str()).chain(self.locals.iter().map(|l| l.name.as_str()));
        match self.workings.spellings.nearest(name, of_language.chain(of_document)) {
            Some(near) => format!("did you mean `{near}`?"),
            None => declare.into(),
        }
    }
}
