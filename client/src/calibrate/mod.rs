//! `isophote calibrate`: what belongs to the camera and not to the model, from its frames.

mod colours;
mod noise;
mod pixels;

pub use colours::{ColoursArgs, colours};
pub use noise::{NoiseArgs, noise};
pub use pixels::{PixelsArgs, pixels};
