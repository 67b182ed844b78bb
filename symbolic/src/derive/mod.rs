//! Rewrites F and its derivatives, as nodes, into few per-pixel sums ([`FactoredSums`](crate::schedule::sums)) for one
//! choice of cuts, and searches the choice whose loop costs least. It knows nothing of the check of programs.

pub(crate) mod absorb;
pub(crate) mod cuts;
pub(crate) mod derivation;
pub(crate) mod derivatives;
pub(crate) mod features;
pub(crate) mod joint;
pub(crate) mod monomial;
pub(crate) mod polynomials;
pub(crate) mod rank;
pub(crate) mod search;
pub(crate) mod square;
