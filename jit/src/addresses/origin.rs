//! Abstract values of the address check: a base and a distance, or a set of numbers.

use cranelift_codegen::ir::StackSlot;
use smallvec::SmallVec;

/// The base of an address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Base {
    Record(StackSlot),
    Args,
    Inputs,
    Outputs,
    Functions,
    Planes,
    /// At an unknown distance.
    Tables,
    /// Pixels of a raw plane, at an unknown distance.
    Pixels,
    /// Pixels of the output plane, at an unknown distance.
    Target,
}

/// The possible numbers of a value; `None`: any. There may be several, since values of rows are in arrays.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct PossibleNumbers(pub Option<SmallVec<[i64; NUMBERS_MAX]>>);

/// Larger sets become "any".
pub(super) const NUMBERS_MAX: usize = 8;

impl PossibleNumbers {
    pub const ANY: PossibleNumbers = PossibleNumbers(None);

    pub fn one(number: i64) -> PossibleNumbers {
        PossibleNumbers(Some(SmallVec::from_slice(&[number])))
    }

    pub fn of(numbers: impl Iterator<Item = Option<i64>>) -> PossibleNumbers {
        let mut all = SmallVec::new();
        for number in numbers {
            let Some(number) = number else { return PossibleNumbers::ANY };
            if !all.contains(&number) {
                if all.len() == NUMBERS_MAX {
                    return PossibleNumbers::ANY;
                }
                all.push(number);
            }
        }
        all.sort_unstable();
        PossibleNumbers(Some(all))
    }

    pub fn or(&self, other: &PossibleNumbers) -> PossibleNumbers {
        match (&self.0, &other.0) {
            (Some(a), Some(b)) => PossibleNumbers::of(a.iter().chain(b).copied().map(Some)),
            _ => PossibleNumbers::ANY,
        }
    }

    /// The results of `operation` on all pairs; `None` from it: any number.
    pub fn with(&self, other: &PossibleNumbers, operation: impl Fn(i64, i64) -> Option<i64>) -> PossibleNumbers {
        match (&self.0, &other.0) {
            (Some(a), Some(b)) => PossibleNumbers::of(a.iter().flat_map(|a| b.iter().map(|b| operation(*a, *b)))),
            _ => PossibleNumbers::ANY,
        }
    }
}

/// The origin of a value.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Origin {
    /// Not an address.
    Number(PossibleNumbers),
    /// A base plus a distance, which is unknown for pixels and tables only.
    At(Base, PossibleNumbers),
    /// A function from the table.
    Callee,
}

pub(super) const NUMBER: Origin = Origin::Number(PossibleNumbers::ANY);

impl Origin {
    pub fn at(base: Base, distance: i64) -> Origin {
        Origin::At(base, PossibleNumbers::one(distance))
    }

    /// An address; a distance may be unknown for pixels and tables only.
    pub fn behind(base: Base, distance: PossibleNumbers) -> Origin {
        match (base, distance) {
            (Base::Pixels | Base::Target | Base::Tables, _) => Origin::At(base, PossibleNumbers::ANY),
            (_, PossibleNumbers::ANY) => NUMBER,
            (base, distance) => Origin::At(base, distance),
        }
    }

    /// The numbers that a small one bounds, unsigned; `None`: it is no such number.
    pub fn up_to(&self) -> Option<PossibleNumbers> {
        let Origin::Number(PossibleNumbers(Some(numbers))) = self else { return None };
        let is_few = |most: &&i64| (0..NUMBERS_MAX as i64).contains(*most);
        let most = numbers.first().filter(|most| numbers.len() == 1 && is_few(most))?;
        Some(PossibleNumbers::of((0..=*most).map(Some)))
    }

    /// The origin of a value that may have either.
    pub fn or(&self, other: &Origin) -> Origin {
        match (self, other) {
            (Origin::Number(a), Origin::Number(b)) => Origin::Number(a.or(b)),
            (Origin::At(base, a), Origin::At(other, b)) if base == other => Origin::behind(*base, a.or(b)),
            (Origin::Callee, Origin::Callee) => Origin::Callee,
            _ => NUMBER,
        }
    }

    pub fn plus(&self, other: &Origin) -> Origin {
        match (self, other) {
            (Origin::Number(a), Origin::Number(b)) => Origin::Number(a.with(b, i64::checked_add)),
            (Origin::At(base, at), Origin::Number(n)) | (Origin::Number(n), Origin::At(base, at)) => {
                Origin::behind(*base, at.with(n, i64::checked_add))
            }
            _ => NUMBER,
        }
    }

    pub fn shifted(&self, bits: &Origin) -> Origin {
        let shift =
            |n: i64, bits: i64| u32::try_from(bits).ok().and_then(|bits| n.checked_mul(1_i64.checked_shl(bits)?));
        match (self, bits) {
            (Origin::Number(a), Origin::Number(bits)) => Origin::Number(a.with(bits, shift)),
            _ => NUMBER,
        }
    }
}
