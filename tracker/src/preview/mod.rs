//! Previews of a fit: images of the frame and of the residuals, and the overlay on them: outlines, a cross-section,
//! saturated pixels, the axes of poses.

mod contour;
mod level;
mod overlay;
mod picture;
mod predicted;
mod section;
mod viewer;

pub use overlay::{PixelRun, PoseAxis, PreviewOverlay};
pub use picture::{PreviewDepth, PreviewPart, PreviewPicture};
pub use section::CrossSection;
pub use viewer::{FrameScene, Viewer};

#[cfg(test)]
mod documents_tests;
