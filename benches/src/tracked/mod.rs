//! What a tracked frame costs.
//!
//! What comes in: targets of [`crate::accuracy`]'s scenes on a steady course, from which each frame jumps as far as a prediction is
//! to be wrong. What goes out: lines of the table of [docs/speed.md](../../../docs/speed.md), a frame's time by that of one pass
//! of `thesis-spot` over as many pixels. It knows no other library: that is [`crate::peers`].

pub mod line;
pub mod pass;
pub mod subject;

/// What is left out before medians: kernels are made, the course is learned.
pub const SETTLING: usize = 40;

/// The value that this share of them do not exceed.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get((sorted.len().saturating_sub(1) as f64 * share) as usize).copied().unwrap_or(f64::NAN)
}

/// The narrowest vectors, and those that are fastest here.
pub fn widths() -> Vec<isophote_jit::VectorWidth> {
    let begin = std::time::Instant::now();
    let fastest = isophote_jit::fastest_width(&|| begin.elapsed().as_nanos() as u64);
    let mut widths = vec![isophote_jit::VectorWidth::Bits128, fastest];
    widths.dedup();
    widths
}
