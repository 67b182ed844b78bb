//! Photographs from outside the project: accuracy of estimates on them, as tables of docs/real.md. Without their
//! folder, which is not part of the repository, a message is printed.

pub mod beam;
pub mod board;
pub mod fitted;
pub mod frames;
