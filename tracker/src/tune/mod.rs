//! Which schedule of stages suits a model: the thesis' assembly of a solver by benchmark (section 1.3.1), and where F is
//! convex (Table 4.1).
//!
//! It provides schedules to try ([`schedules`]), starts at given distances from a known answer ([`Bench::start`]), fits
//! from there ([`Bench::run`]), and whether the Hessian is positive definite there ([`Bench::convexity`]). It has no
//! clock and no frame source: callers time the fits.

mod bench;
mod convexity;
pub mod figures;
mod schedules;
mod starts;

pub use bench::{Bench, Goal, Run};
pub use convexity::{Convexity, Grid};
pub use schedules::{Schedule, Subset, newton_of_each, schedules, subsets};
pub use starts::Offset;

#[cfg(test)]
mod tests;
