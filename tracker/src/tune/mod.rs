//! Which schedule of stages suits a model: the thesis' assembly of a solver by benchmark (section 1.3.1), and where F is
//! convex (Table 4.1).
//!
//! What comes in: a model, kernels for each schedule, frames whose answers are known. What goes out: schedules to try
//! ([`schedules`]), starts at stated distances from the answer ([`Bench::start`]), how a fit from there went
//! ([`Bench::run`]), and whether the Hessian is positive definite there ([`Bench::convexity`]). It never knows a clock, and
//! not where frames come from: whoever times fits does it above.

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
