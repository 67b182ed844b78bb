//! Native code for the fused pixel loop.
//!
//! A [`Kernel`] runs the whole loop nest of a [`Program`](isophote_symbolic::Program) over pixels in memory in one call
//! and equals the interpreter bit for bit.
//! ```text
//! Program ─► check ─► nest ─► VectorCode ─┬─► clif ─► audit ─► Cranelift ─┬─► verify ─► runner (executable memory) ─► Kernel
//!                                         └─► x86, 256 and 512 bits ──────┘
//! Program ─► KernelCache ─────────────────────────────────────────────────────► Arc<Kernel>, shared
//! bytes ─► PlaneView ─► Region (window inside plane) ─────────────────────────────────────► Sums
//! ```
//! Native code imports no names, has no trapping instruction and is freed when its kernel is dropped. Every address that it
//! touches is inside a slice whose bounds a type has proven before; `runner.rs` alone contains `unsafe`.
//!
//! ```
//! use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, VectorWidth, Window, has_fma};
//! use isophote_symbolic::{Bindings, Lowering, Model, Precision, ValueKind};
//!
//! let text = r#"
//! name = "flat"
//! coordinates = ["x", "y"]
//! channels = ["phi"]
//! [parameters]
//! v0 = { start = 0.0 }
//! [model]
//! intensity = "v0"
//! "#;
//! let model = Model::from_toml(text).map_err(|faults| format!("{faults:?}"))?;
//! let lowering = Lowering { fma: has_fma(), drop_saturated: false };
//! let objective = model.value_objective(ValueKind::Entry).map_err(|faults| format!("{faults:?}"))?;
//! let program = objective.program(lowering).map_err(|faults| format!("{faults:?}"))?;
//! let (precision, width) = (Precision::F32, VectorWidth::Bits128);
//! let options = KernelOptions { precision, width, formats: vec![PixelFormat::U8], packed: true };
//! let kernel = Kernel::compile(&program, &options)?;
//!
//! let pixels = [3, 4, 5, 6, 7, 8];
//! let plane = PlaneView::new(PixelFormat::U8, &pixels, 3, 2, 3, 1)?;
//! let bindings = Bindings { parameters: &[5.0], entry: &[5.0], ..Bindings::default() };
//! let sums = kernel.sums(&bindings, &[plane], Window::whole(3, 2))?;
//! assert_eq!(sums.outputs, [4.0 + 1.0 + 0.0 + 1.0 + 4.0 + 9.0]); // Σ (φ − v0)²
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![deny(unsafe_code)]

#[cfg(test)]
extern crate self as isophote_jit; // lets unit tests share helpers with the integration tests

mod abi;
mod addresses;
mod audit;
mod cache;
mod clif;
mod compile;
mod error;
mod explain;
mod host;
mod kernel;
mod limits;
mod measure;
mod memory;
mod nest;
mod options;
mod plane;
mod runner;
#[cfg_attr(not(all(target_arch = "x86_64", unix)), allow(dead_code))] // only x86 reads which registers outlive a block
mod vector;
#[cfg(all(target_arch = "x86_64", unix))]
mod verify;
#[cfg(all(target_arch = "x86_64", unix))]
mod x86;

pub use cache::{CacheCounts, KernelCache};
pub use error::{CompileError, RunError};
pub use explain::{Explained, Line, explain};
pub use host::{Processor, has_fma};
pub use kernel::{Kernel, Sums};
pub use limits::{KernelLimits, LIMITS};
pub use measure::fastest_width;
pub use memory::{CodeMemory, CodeStep};
pub use options::{KernelOptions, VectorWidth};
pub use plane::{PixelFormat, PlaneError, PlaneView, Slices, Window};
