//! Compiles CLIF to machine code, audited before and after.

use cranelift_codegen::control::ControlPlane;
use cranelift_codegen::ir::Function;
use cranelift_codegen::{CompiledCode, Context, verify_function};
use isophote_symbolic::{Opcode, Program, Sink, Value};

use crate::addresses::{Extent, addresses};
use crate::audit;
use crate::clif::{self, Bounds};
use crate::error::CompileError;
use crate::host::{self, Allocator, Processor};
use crate::limits::{KernelLimits, LIMITS};
use crate::options::{KernelOptions, VectorWidth};
#[cfg(all(target_arch = "x86_64", unix))]
use crate::verify::{Permitted, verify};
#[cfg(all(target_arch = "x86_64", unix))]
use crate::x86::Assembled;

/// Machine code without relocations, within [`LIMITS`].
pub(crate) struct Native {
    pub bytes: Vec<u8>,
    pub alignment: u64,
    /// Upper bound of the end of the instructions; constants follow.
    pub code_end: usize,
    /// Bytes of stack that a call takes.
    pub frame_bytes: usize,
    /// Wide vectors only: byte ranges and the value each was emitted for, ascending.
    pub sources: Vec<(usize, usize, Value)>,
}

/// Machine code of a program.
pub(crate) fn native(program: &Program, options: &KernelOptions, processor: Processor) -> Result<Native, CompileError> {
    let native = match options.width {
        VectorWidth::Bits128 => narrow(program, options, processor),
        _ => wide(program, options, processor),
    }?;
    within(LIMITS, native.bytes.len(), native.frame_bytes)?;
    #[cfg(all(target_arch = "x86_64", unix))]
    verify(&native.bytes, native.code_end, Permitted::of(program, options)).map_err(CompileError::Audit)?;
    Ok(native)
}

/// Compiles with Cranelift.
fn narrow(program: &Program, options: &KernelOptions, processor: Processor) -> Result<Native, CompileError> {
    let (function, allocator) = audited(program, options, processor)?;
    let mut context = Context::for_function(function);
    let compiled = translate(&mut context, processor, allocator)?;
    let bytes = compiled.code_buffer().to_vec();
    let frame_bytes = frame_bytes(compiled)?;
    let (code_end, alignment) = (bytes.len(), u64::from(compiled.buffer.alignment));
    Ok(Native { bytes, alignment, code_end, frame_bytes, sources: Vec::new() })
}

/// Compiles with vectors that Cranelift lacks.
#[cfg(all(target_arch = "x86_64", unix))]
fn wide(program: &Program, options: &KernelOptions, processor: Processor) -> Result<Native, CompileError> {
    check(program, options, processor)?;
    let (assembled, frame_bytes) = crate::x86::code(program, options)?;
    let sources = assembled.spans.iter().map(|spoken| (spoken.start, spoken.end, spoken.value)).collect();
    let Assembled { bytes, code_end, .. } = assembled;
    Ok(Native { bytes, alignment: crate::x86::ALIGNMENT as u64, code_end, frame_bytes, sources })
}

/// Wide vectors exist on x86-64 Unix only.
#[cfg(not(all(target_arch = "x86_64", unix)))]
fn wide(_: &Program, options: &KernelOptions, _: Processor) -> Result<Native, CompileError> {
    Err(CompileError::NoVectors { bits: 8 * options.width.bytes() })
}

/// Spilled values, the record, saved registers, and the return address with the caller's frame pointer.
fn frame_bytes(compiled: &CompiledCode) -> Result<usize, CompileError> {
    let unknown = || CompileError::Compiler("it does not say how much stack a call takes".into());
    let layout = compiled.buffer.frame_layout().ok_or_else(unknown)?;
    Ok(layout.frame_to_fp_offset as usize + 2 * size_of::<usize>())
}

fn within(limits: KernelLimits, code_bytes: usize, frame_bytes: usize) -> Result<(), CompileError> {
    if code_bytes > limits.code_bytes {
        return Err(CompileError::CodeTooLarge { bytes: code_bytes });
    }
    if frame_bytes > limits.frame_bytes {
        return Err(CompileError::FrameTooLarge { bytes: frame_bytes });
    }
    Ok(())
}

/// The program as audited CLIF, and the register allocator for it.
pub(crate) fn audited(
    program: &Program,
    options: &KernelOptions,
    processor: Processor,
) -> Result<(Function, Allocator), CompileError> {
    check(program, options, processor)?;
    let isa = host::isa(processor, Allocator::Backtracking)?;
    let is_verified = cfg!(all(target_arch = "x86_64", unix));
    let bounds = if is_verified { Bounds::Branches } else { Bounds::Minima };
    let function = clif::function(program, options, &*isa, bounds);
    verify_function(&function, &*isa).map_err(|errors| CompileError::Compiler(errors.to_string()))?;
    audit::function(&function).map_err(CompileError::Audit)?;
    // Where the machine code is verified, this check is redundant.
    if !is_verified {
        addresses(&function, Extent::of(program)).map_err(CompileError::Audit)?;
    }
    let allocator = Allocator::for_size(function.dfg.num_insts());
    Ok((function, allocator))
}

/// Machine code of the function in `context`.
pub(crate) fn translate(
    context: &mut Context,
    processor: Processor,
    allocator: Allocator,
) -> Result<&CompiledCode, CompileError> {
    let isa = host::isa(processor, allocator)?;
    let compiled = context
        .compile(&*isa, &mut ControlPlane::default())
        .map_err(|error| CompileError::Compiler(format!("{:?}", error.inner)))?;
    audit::relocations(compiled.buffer.relocs()).map_err(CompileError::Audit)?;
    Ok(compiled)
}

/// Checks the preconditions of the loop nest.
fn check(program: &Program, options: &KernelOptions, processor: Processor) -> Result<(), CompileError> {
    let any = program.instructions().iter().any(|i| matches!(i.op.code, Opcode::Channel(_)));
    if !processor.has(options.width) {
        return Err(CompileError::NoVectors { bits: 8 * options.width.bytes() });
    }
    let (channels, formats) = (program.channels(), options.formats.len());
    let renders = matches!(program.sink(), Sink::Plane(_));
    if formats != channels && (any || !renders || formats != 0) {
        return Err(CompileError::Formats { channels, formats });
    }
    if renders && any {
        return Err(CompileError::RendersPixels);
    }
    // Elementary functions of a fused program also use fused multiply-add.
    let fused = program.is_fused() || program.instructions().iter().any(|i| i.op.code == Opcode::Fma);
    if fused && !processor.has_fma() {
        return Err(CompileError::NoFma);
    }
    program.check().map_err(CompileError::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_hold_to_the_byte() {
        let KernelLimits { code_bytes, frame_bytes } = LIMITS;
        assert_eq!(within(LIMITS, code_bytes - 1, frame_bytes - 1), Ok(()));
        assert_eq!(within(LIMITS, code_bytes, frame_bytes), Ok(()));
        let (code, frame) = (code_bytes + 1, frame_bytes + 1);
        assert_eq!(within(LIMITS, code, frame_bytes), Err(CompileError::CodeTooLarge { bytes: code }));
        assert_eq!(within(LIMITS, code_bytes, frame), Err(CompileError::FrameTooLarge { bytes: frame }));
    }
}
