//! The host processor's features, and the compiler settings for it.

use std::sync::{Arc, OnceLock};

use cranelift_codegen::isa::{self, OwnedTargetIsa, TargetIsa};
use cranelift_codegen::settings::{self, Configurable};

use crate::error::CompileError;
use crate::options::VectorWidth;

/// The register allocator: the backtracking one takes time superlinear in the program, so functions beyond
/// [`INSTRUCTIONS_FOR_BACKTRACKING`] get the single-pass one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Allocator {
    /// Splits ranges; fewer spills.
    Backtracking,
    /// One pass; more spills.
    SinglePass,
}

/// Maximum compiler instructions for the backtracking allocator: some 50 ms, a model of about 25 parameters.
const INSTRUCTIONS_FOR_BACKTRACKING: usize = 8000;

impl Allocator {
    /// The allocator for a function of that many compiler instructions.
    pub fn for_size(instructions: usize) -> Allocator {
        if instructions > INSTRUCTIONS_FOR_BACKTRACKING { Allocator::SinglePass } else { Allocator::Backtracking }
    }
}

/// The target processor; code for either runs on this machine.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Processor {
    /// The host, with all its features.
    Host,
    /// The oldest of its kind: on x86-64 SSE2 only, without fused multiply-add.
    Baseline,
}

/// The compiler target, cached per processor and allocator.
pub(crate) fn isa(processor: Processor, allocator: Allocator) -> Result<Arc<dyn TargetIsa>, CompileError> {
    static CELLS: [OnceLock<Result<OwnedTargetIsa, String>>; 4] = [const { OnceLock::new() }; 4];
    let cell = &CELLS[2 * processor as usize + allocator as usize];
    cell.get_or_init(|| build(processor, allocator)).clone().map_err(CompileError::Host)
}

fn build(processor: Processor, allocator: Allocator) -> Result<OwnedTargetIsa, String> {
    let target = match processor {
        Processor::Host => cranelift_native::builder(),
        Processor::Baseline => cranelift_native::builder_with_options(false),
    };
    built(target.map_err(str::to_owned)?, allocator)
}

/// Builds the compiler for a target, with our settings.
pub(crate) fn built(target: isa::Builder, allocator: Allocator) -> Result<OwnedTargetIsa, String> {
    let algorithm = match allocator {
        Allocator::Backtracking => "backtracking",
        Allocator::SinglePass => "single_pass",
    };
    // The program is already free of common subexpressions and in the order that we want: `speed` finds nothing to
    // remove and undoes the order. `enable_verifier` would run the verifier after each of several passes without work
    // here; `compile` always runs it once. Stack probes touch a large frame page by page, so that it cannot skip a guard page.
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
    target.finish(settings::Flags::new(builder)).map_err(|e| e.to_string())
}

impl Processor {
    /// Whether it has fused multiply-add, which programs with `Opcode::Fma` require.
    pub fn has_fma(self) -> bool {
        match self {
            Processor::Host => host_has_fma(),
            Processor::Baseline => cfg!(not(target_arch = "x86_64")),
        }
    }

    /// Whether it has vectors of that width, and the code generator supports them.
    pub fn has(self, width: VectorWidth) -> bool {
        match (self, width) {
            (_, VectorWidth::Bits128) => true,
            (Processor::Host, wide) => host_has(wide),
            (Processor::Baseline, _) => false,
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn host_has_fma() -> bool {
    is_x86_feature_detected!("fma") && is_x86_feature_detected!("avx")
}
#[cfg(not(target_arch = "x86_64"))]
fn host_has_fma() -> bool {
    true
}

#[cfg(all(target_arch = "x86_64", unix))]
fn host_has(width: VectorWidth) -> bool {
    let narrow = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") && host_has_fma();
    let wide = || {
        is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512vl")
    };
    narrow && (width != VectorWidth::Bits512 || wide())
}
#[cfg(not(all(target_arch = "x86_64", unix)))]
fn host_has(_: VectorWidth) -> bool {
    false
}

/// Whether this machine's processor has fused multiply-add.
pub fn has_fma() -> bool {
    Processor::Host.has_fma()
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn baseline_enables_no_isa_extension() {
        for allocator in [Allocator::Backtracking, Allocator::SinglePass] {
            let isa = isa(Processor::Baseline, allocator).unwrap();
            let has = isa.isa_flags().into_iter().filter(|flag| flag.name.starts_with("has_"));
            let has: Vec<_> = has.map(|flag| (flag.name, flag.as_bool())).collect();
            assert!(has.len() > 5 && has.iter().all(|(_, has)| *has == Some(false)), "{has:?}");
        }
        assert!(!Processor::Baseline.has_fma());
    }

    /// The compiler may ignore a feature that we report, but must not use one that is missing.
    #[test]
    fn has_fma_agrees_with_the_compiler() {
        let flags = isa(Processor::Host, Allocator::Backtracking).unwrap().isa_flags();
        let has = |name: &str| flags.iter().any(|flag| flag.name == name && flag.as_bool() == Some(true));
        assert_eq!(has("has_fma") && has("has_avx"), has_fma());
        assert!(!Processor::Host.has(VectorWidth::Bits512) || Processor::Host.has(VectorWidth::Bits256));
        assert!(!Processor::Baseline.has(VectorWidth::Bits256) && Processor::Baseline.has(VectorWidth::Bits128));
    }

    /// A frame of many pages must not skip the guard page at the stack's end.
    #[test]
    fn large_frames_probe_every_page() {
        for allocator in [Allocator::Backtracking, Allocator::SinglePass] {
            let isa = isa(Processor::Host, allocator).unwrap();
            let flags = isa.flags();
            assert!(flags.enable_probestack() && flags.probestack_strategy() == settings::ProbestackStrategy::Inline);
            assert!(1 << flags.probestack_size_log2() <= 4096);
        }
    }
}
