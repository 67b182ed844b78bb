//! `isophote calibrate`: what belongs to the camera and not to the model, from its frames.

mod colours;
mod pixels;

pub use colours::{ColoursArgs, colours};
pub use pixels::{PixelsArgs, pixels};
