//! Photographs that nobody in the project made: how far estimates can be trusted there.
//!
//! What comes in: the folder of real frames, where it is. What goes out: tables of docs/real.md. Without the folder there is
//! a line that says so and nothing else: the frames do not belong to the repository.

pub mod beam;
pub mod board;
pub mod fitted;
pub mod frames;
