//! What a fit saw, for people: pictures of the frame and of what the model leaves unexplained, and what is drawn over them.
//!
//! What comes in: a frame and what was estimated from it. What goes out: pixels to be sent, outlines, a cross-section, saturated
//! pixels, the axes of poses. It never knows how an estimate was found, nor who looks.

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
