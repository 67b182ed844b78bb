//! Where frames come from.
//!
//! In: a path ([`Recording`]), a model with numbers ([`Synthetic`]), bytes of an image ([`decode()`]), or a device
//! ([`LiveCamera`]).
//! Out: [`Captured`] frames in capture order, through one door, [`FrameSource`]; a camera has its own, since it waits, stalls,
//! is lost and comes back.
//! But for the camera it never waits and never looks at a clock: pace is kept by whoever owns the source (the server's
//! camera thread), so a recording and a simulated minute run as fast as the machine goes. It knows no solver, no session
//! and no socket.
//!
//! ```text
//! files (one a format) ─► paged ─► stack ─┐
//! truth.jsonl ─► clock ───────────────────┴─► Recording ──┐
//! Model ─► sampling ─► light ─► noise ─► Synthetic ───────┴─► FrameSource ─► Frame
//! V4L2 ─► camera ─► pixels ─► LiveCamera ──────────────────────────────────► Frame
//! Frame, and what is said of it ─► record ─► MCAP
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
