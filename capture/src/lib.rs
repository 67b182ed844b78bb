//! Where frames come from.
//!
//! In: a path ([`Recording`]), a model with numbers ([`Synthetic`]), bytes of an image ([`decode()`]), or a device
//! ([`Camera`]).
//! Out: [`Captured`] frames in capture order, through one door, [`FrameSource`]; a camera has its own, since it waits, stalls,
//! is lost and comes back.
//! But for the camera it never waits and never looks at a clock: pace is kept by whoever owns the source (the server's
//! camera thread), so a recording and a simulated minute run as fast as the machine goes. It knows no solver, no session
//! and no socket.
//!
//! ```text
//! PNG, JPEG ─────────────► decode ─┐
//! TIFF, FITS, Y4M, MCAP ──► pages ─┴─► stack ─┐
//! CSV ────────────────────► table ────────────┼─► Recording ─┐
//! truth.jsonl ────────────────────────────────┘              ├─► FrameSource ─► Frame (tracker)
//! Model ─► sampling ─► light ─► noise ─► Synthetic ──────────┘
//! V4L2 ─► camera ─► pixels ─► Camera ──────────────────────────────────────────► Frame
//! ```

pub mod camera;
mod clock;
pub mod decode;
pub mod encode;
mod exposure;
mod fits;
mod levels;
pub mod light;
pub mod limits;
mod mcap;
mod motion;
mod moving;
mod noise;
mod order;
mod pages;
pub mod pixels;
mod planes;
pub mod recording;
mod sampling;
pub mod source;
pub mod spec;
mod stack;
pub mod synthetic;
mod table;
mod tiff;
mod truth;
mod wake;
mod y4m;

pub use camera::{Camera, CameraError, CameraSpec, CameraState};
pub use decode::decode;
pub use encode::{encode_png, encode_png_planes};
pub use exposure::Exposure;
pub use light::Light;
pub use limits::LIMITS;
pub use moving::Moving;
pub use pixels::{Colour, Encoding, PixelsError};
pub use recording::Recording;
pub use source::{Captured, FrameSource, SourceError};
pub use spec::{Pace, SyntheticError, SyntheticSpec};
pub use synthetic::Synthetic;
pub use tiff::encode_tiff;
pub use wake::Wake;
