//! `isophote calibrate`: what belongs to the camera and not to the model, from its frames.

mod colours;
mod dark;
mod noise;
mod pixels;
mod response;

pub use colours::{ColoursArgs, colours};
pub use noise::{NoiseArgs, noise};
pub use pixels::{PixelsArgs, pixels};
pub use response::{ResponseArgs, response};
