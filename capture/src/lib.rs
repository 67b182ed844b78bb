//! Frame sources: recordings, synthetic scenes and cameras.
//!
//! [`Recording`] reads files, [`Synthetic`] renders a model, [`decode()`] decodes image bytes, and [`LiveCamera`] reads a
//! device. Recordings and scenes deliver [`Captured`] frames in order through [`FrameSource`]; a camera has an interface of
//! its own, because it waits, stalls, disconnects and reconnects.
//!
//! Apart from the camera nothing waits or reads a clock: the owner of a source (the server's camera thread) paces it, so
//! recordings and simulations run at full speed.
//!
//! ```text
//! files (one a format) ─► paged ─► stack ─┐
//! truth.jsonl ─► clock ───────────────────┴─► Recording ──┐
//! Model ─► sampling ─► light ─► noise ─► Synthetic ───────┴─► FrameSource ─► Frame
//! V4L2 ─► camera ─► pixels ─► LiveCamera ──────────────────────────────────► Frame
//! Frame, and its results ─► record ─► MCAP
//! ```

pub mod camera;
mod clock;
pub mod decode;
pub mod encode;
mod exposure;
mod files;
mod levels;
pub mod light;
pub mod limits;
mod movement;
mod moving;
mod noise;
mod order;
mod paged;
mod picture;
pub mod pixels;
mod planes;
pub mod record;
pub mod recording;
pub mod regular;
mod sampling;
pub mod scene;
pub mod source;
pub mod spec;
mod stack;
pub mod synthetic;
mod truth;
mod wake;

pub use camera::{CameraError, CameraSpec, CameraState, LiveCamera};
pub use decode::decode;
pub use encode::{encode_jpeg, encode_png, encode_png_planes};
pub use exposure::Exposure;
pub use files::mcap::{LogMessage, LogReader};
pub use files::tiff::encode_tiff;
pub use light::Light;
pub use limits::LIMITS;
pub use moving::Moving;
pub use pixels::{Colour, Encoding, PixelsError};
pub use recording::Recording;
pub use regular::{ReadableFolder, open_regular, read_regular};
pub use scene::{SceneKnob, SceneSpec};
pub use source::{Captured, FrameSource, Reel, SourceError};
pub use spec::{SyntheticError, SyntheticSpec};
pub use synthetic::Synthetic;
pub use wake::Wake;
