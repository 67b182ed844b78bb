//! Isophote against other libraries on the same frames: time per frame and error.
//!
//! A spot of [`crate::accuracy`]'s scenes moves on a steady course, from which each frame jumps by 0.1 px; the results
//! are table and figure of [docs/speed.md](../../../docs/speed.md). [`ours`] tracks it; [`theirs`] runs two programs,
//! `peers.cc` with Ceres and `peers.py` with NumPy, SciPy and OpenCV, which read the course from a file and print
//! times and centres. They get the predicted position, the window and the camera's data, and are independent of
//! isophote.

pub mod ours;
pub mod sequence;
pub mod tables;
pub mod theirs;

/// A method's answer for one frame.
#[derive(Clone, Copy, Debug)]
pub struct Answer {
    /// Time inside the method.
    pub took_us: f64,
    /// px; NaN without an answer.
    pub centre: [f64; 2],
}

/// All answers of a method in one round, in the order of the frames.
pub type Answers = Vec<(String, Vec<Answer>)>;
