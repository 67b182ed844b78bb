//! Bounds on frame sources, in one table.

/// Bounds, checked before memory is allocated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameLimits {
    /// Pixels of one frame.
    pub frame_pixels: u64,
    /// Pixels of a frame's side.
    pub side_px: u32,
    /// Bytes of one file (image, CSV or truth).
    pub file_bytes: u64,
    /// Files of one recording.
    pub files: usize,
    /// Columns of a CSV file.
    pub columns: usize,
    /// Sub-pixel samples per pixel side of a synthetic frame.
    pub samples: u32,
    /// Bits of a pixel of a synthetic frame.
    pub bits: u32,
    /// Frames of delay before an exposure is applied, in a synthetic source.
    pub exposure_latency: u32,
    /// Entries of each list of a synthetic source's light.
    pub light_items: usize,
    /// Brightness of glare and of occluders, DN.
    pub light_dn: f64,
    /// Factor of the light: an exposure or a gain.
    pub light_factor: f64,
    /// Start or end time of a light's item, s: 300 years.
    pub light_time_s: f64,
    /// Standard deviation of defocus, px.
    pub defocus_px: f64,
    /// Standard deviation of glare and of veils, px: beyond it light is uniform, and its square is still finite.
    pub glare_px: f64,
}

/// The bounds in force.
pub const LIMITS: FrameLimits = FrameLimits {
    frame_pixels: 64 << 20,
    side_px: 32_768,
    file_bytes: 256 << 20,
    files: 1_000_000,
    columns: 256,
    samples: 32,
    bits: 16,
    exposure_latency: 64,
    light_items: 64,
    light_dn: 1e6,
    light_factor: 1e6,
    light_time_s: 1e10,
    defocus_px: 64.0,
    glare_px: 1e9,
};
