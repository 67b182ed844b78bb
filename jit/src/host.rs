//! The processor that we run on: what it offers, and the compiler's settings for it.

use std::sync::{Arc, OnceLock};

use cranelift_codegen::isa::{OwnedTargetIsa, TargetIsa};
use cranelift_codegen::settings::{self, Configurable};

use crate::error::CompileError;

/// Which register allocator: the better one takes time that grows faster than the program, so that functions beyond
/// [`INSTRUCTIONS_FOR_BACKTRACKING`] get the linear one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Allocator {
    /// Splits ranges; fewer spills.
    Backtracking,
    /// One pass; more spills.
    SinglePass,
}

/// Compiler instructions up to which the backtracking allocator is affordable: some 50 ms, a model of about 25 parameters.
const INSTRUCTIONS_FOR_BACKTRACKING: usize = 8000;

impl Allocator {
    /// The allocator for a function of that many compiler instructions.
    pub fn for_size(instructions: usize) -> Allocator {
        if instructions > INSTRUCTIONS_FOR_BACKTRACKING { Allocator::SinglePass } else { Allocator::Backtracking }
    }
}

/// The target of native code on this machine.
pub(crate) fn isa(allocator: Allocator) -> Result<Arc<dyn TargetIsa>, CompileError> {
    static BACKTRACKING: OnceLock<Result<OwnedTargetIsa, String>> = OnceLock::new();
    static SINGLE_PASS: OnceLock<Result<OwnedTargetIsa, String>> = OnceLock::new();
    let cell = match allocator {
        Allocator::Backtracking => &BACKTRACKING,
        Allocator::SinglePass => &SINGLE_PASS,
    };
    cell.get_or_init(|| build(allocator)).clone().map_err(CompileError::Host)
}

fn build(allocator: Allocator) -> Result<OwnedTargetIsa, String> {
    let algorithm = match allocator {
        Allocator::Backtracking => "backtracking",
        Allocator::SinglePass => "single_pass",
    };
    // The program is already free of common subexpressions and in the order that we want: `speed` finds nothing to
    // remove and undoes the order. The flag would run the verifier after each of several passes that have nothing to do
    // here; `compile` runs it once, always. A large frame touches its pages one by one, so that it cannot step over a guard page.
    let flags = [
        ("opt_level", "none"),
        ("enable_verifier", "false"),
        ("regalloc_algorithm", algorithm),
        ("is_pic", "false"),
        ("use_colocated_libcalls", "false"),
        ("unwind_info", "false"),
        ("enable_probestack", "true"),
        ("probestack_strategy", "inline"),
    ];
    let mut builder = settings::builder();
    for (name, value) in flags {
        builder.set(name, value).map_err(|e| format!("{name}: {e}"))?;
    }
    let host = cranelift_native::builder().map_err(str::to_owned)?;
    host.finish(settings::Flags::new(builder)).map_err(|e| e.to_string())
}

/// Whether this processor multiplies and adds with one rounding. Only then may a program with `Op::Fma` be compiled.
pub fn has_fma() -> bool {
    match isa(Allocator::Backtracking) {
        Ok(isa) if cfg!(target_arch = "x86_64") => isa
            .isa_flags()
            .iter()
            .filter(|flag| flag.name == "has_fma" || flag.name == "has_avx")
            .all(|flag| flag.as_bool() == Some(true)),
        Ok(_) => true,
        Err(_) => false,
    }
}
