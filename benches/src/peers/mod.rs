//! isophote beside other libraries on the same frames: what a frame costs, and how far its answer is from the truth.
//!
//! What comes in: a spot of [`crate::accuracy`]'s scenes on a steady course, from which each frame jumps by 0.1 px. What goes out:
//! table and figure of [docs/speed.md](../../../docs/speed.md). [`ours`] tracks it; [`theirs`] runs two programs, `peers.cc`
//! with Ceres and `peers.py` with NumPy, SciPy and OpenCV, which read the course from a file and print times and centres. They are
//! told where the target is predicted, which window to look at, and what is known of the camera; they know nothing of isophote.

pub mod course;
pub mod ours;
pub mod tables;
pub mod theirs;

/// What a method said of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Answer {
    /// Inside of the method.
    pub took_us: f64,
    /// px; NaN where there is none.
    pub centre: [f64; 2],
}

/// All answers of a method in one round, in the order of the frames.
pub type Answers = Vec<(String, Vec<Answer>)>;
