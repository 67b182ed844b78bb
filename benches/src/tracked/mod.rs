//! The cost of a tracked frame.
//!
//! Targets of [`crate::accuracy`]'s scenes move on a steady course, from which each frame jumps by the desired error
//! of prediction. Makes lines of the table of [docs/speed.md](../../../docs/speed.md): a frame's time relative to one
//! pass of `thesis-spot` over as many pixels. Other libraries are in [`crate::peers`].

pub mod line;
pub mod pass;
pub mod subject;

/// Frames excluded from medians: kernels are compiled, the course is learned.
pub const SETTLING: usize = 40;

/// The quantile of that share.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get((sorted.len().saturating_sub(1) as f64 * share) as usize).copied().unwrap_or(f64::NAN)
}

/// The narrowest vectors, and the fastest ones here.
pub fn widths() -> Vec<isophote_jit::VectorWidth> {
    let begin = std::time::Instant::now();
    let fastest = isophote_jit::fastest_width(&|| begin.elapsed().as_nanos() as u64);
    let mut widths = vec![isophote_jit::VectorWidth::Bits128, fastest];
    widths.dedup();
    widths
}
