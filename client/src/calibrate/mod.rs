//! `isophote calibrate`: properties of a camera, and of a target, from their frames.

mod colours;
mod dark;
mod model;
mod noise;
mod pixels;
mod response;

pub use colours::{ColoursArgs, colours};
pub use model::{ModelArgs, model};
pub use noise::{NoiseArgs, noise};
pub use pixels::{PixelsArgs, pixels};
pub use response::{ResponseArgs, response};
