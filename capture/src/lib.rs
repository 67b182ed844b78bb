//! Where frames come from.
//!
//! In: a path ([`Recording`]), a model with numbers ([`Synthetic`]), or bytes of an image ([`decode()`]).
//! Out: [`Captured`] frames in capture order, through one door, [`FrameSource`].
//! It never waits and never looks at a clock: pace is kept by whoever owns the source (the server's camera thread), so a
//! recording and a simulated minute run as fast as the machine goes. It knows no solver, no session and no socket.
//!
//! ```text
//! PNG, JPEG ─────────────► decode ─┐
//! TIFF, FITS, Y4M, MCAP ──► pages ─┴─► stack ─┐
//! CSV ────────────────────► table ────────────┼─► Recording ─┐
//! truth.jsonl ────────────────────────────────┘              ├─► FrameSource ─► Frame (tracker)
//! Model ─► sampling ─► noise ─► Synthetic ───────────────────┘
//! ```
//! The door for a camera is [`FrameSource`] as well: a V4L2 `Camera` is one more file here (its ioctls the only place of
//! the crate where `unsafe` may stand), whose frames lease the driver's buffers ([`isophote_tracker::Lease`]) and carry
//! the driver's time stamp. It blocks in `next` until the driver has a frame; nothing else in this crate ever does.

pub mod decode;
pub mod encode;
mod exposure;
mod fits;
mod levels;
pub mod limits;
mod mcap;
mod motion;
mod noise;
mod order;
mod pages;
mod planes;
pub mod recording;
mod sampling;
pub mod source;
mod stack;
pub mod synthetic;
mod table;
mod tiff;
mod truth;
mod y4m;

pub use decode::decode;
pub use encode::{encode_png, encode_png_planes};
pub use exposure::Exposure;
pub use limits::LIMITS;
pub use recording::Recording;
pub use source::{Captured, FrameSource, SourceError};
pub use synthetic::{Pace, Synthetic, SyntheticError, SyntheticSpec};
pub use tiff::encode_tiff;
