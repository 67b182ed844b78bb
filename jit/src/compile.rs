//! From the compiler's own form to bytes of machine code, audited on both sides.

use cranelift_codegen::control::ControlPlane;
use cranelift_codegen::ir::Function;
use cranelift_codegen::{CompiledCode, Context, verify_function};
use isophote_symbolic::Program;

use crate::addresses::{Extent, addresses};
use crate::audit;
use crate::error::CompileError;
use crate::host::{self, Allocator, Processor};
use crate::kernel::KernelOptions;
use crate::lower::lower;

/// Machine code that needs nothing filled in.
pub(crate) struct Native {
    pub bytes: Vec<u8>,
    pub alignment: u64,
}

/// Machine code of a program that [`check`](crate::kernel::check) has passed.
pub(crate) fn native(program: &Program, options: &KernelOptions, processor: Processor) -> Result<Native, CompileError> {
    let (function, allocator) = audited(program, options, processor)?;
    let mut context = Context::for_function(function);
    let compiled = translate(&mut context, processor, allocator)?;
    Ok(Native { bytes: compiled.code_buffer().to_vec(), alignment: u64::from(compiled.buffer.alignment) })
}

/// The program in the compiler's own form, and which register allocator it gets.
pub(crate) fn audited(
    program: &Program,
    options: &KernelOptions,
    processor: Processor,
) -> Result<(Function, Allocator), CompileError> {
    let isa = host::isa(processor, Allocator::Backtracking)?;
    let function = lower(program, options, &*isa);
    verify_function(&function, &*isa).map_err(|errors| CompileError::Compiler(errors.to_string()))?;
    audit::function(&function).map_err(CompileError::Audit)?;
    addresses(&function, Extent::of(program)).map_err(CompileError::Audit)?;
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
