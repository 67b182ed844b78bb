//! From the compiler's own form to bytes of machine code, audited on both sides.

use cranelift_codegen::control::ControlPlane;
use cranelift_codegen::ir::Function;
use cranelift_codegen::{Context, verify_function};
use isophote_symbolic::Program;

use crate::audit;
use crate::error::CompileError;
use crate::host::{self, Allocator};
use crate::kernel::{KernelOptions, check};
use crate::lower::lower;

/// Machine code that needs nothing filled in.
pub(crate) struct Native {
    pub bytes: Vec<u8>,
    pub alignment: u64,
    /// The text of the instructions, where it was asked for.
    pub text: Option<String>,
}

/// What became of a program, to be read.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Explained {
    /// The compiler's input.
    pub clif: String,
    /// Its output: instructions with registers assigned.
    pub disassembly: String,
}

/// The program as the compiler sees it and as the processor will.
pub fn explain(program: &Program, options: &KernelOptions) -> Result<Explained, CompileError> {
    check(program, options)?;
    let (function, allocator) = audited(program, options)?;
    let clif = function.display().to_string();
    let native = translate(function, allocator, true)?;
    Ok(Explained { clif, disassembly: native.text.unwrap_or_default() })
}

/// Machine code of a program that [`check`] has passed.
pub(crate) fn native(program: &Program, options: &KernelOptions) -> Result<Native, CompileError> {
    let (function, allocator) = audited(program, options)?;
    translate(function, allocator, false)
}

fn audited(program: &Program, options: &KernelOptions) -> Result<(Function, Allocator), CompileError> {
    let isa = host::isa(Allocator::Backtracking)?;
    let function = lower(program, options, &*isa);
    verify_function(&function, &*isa).map_err(|errors| CompileError::Compiler(errors.to_string()))?;
    audit::function(&function).map_err(CompileError::Audit)?;
    let allocator = Allocator::for_size(function.dfg.num_insts());
    Ok((function, allocator))
}

fn translate(function: Function, allocator: Allocator, text: bool) -> Result<Native, CompileError> {
    let isa = host::isa(allocator)?;
    let mut context = Context::for_function(function);
    context.set_disasm(text);
    let compiled = context
        .compile(&*isa, &mut ControlPlane::default())
        .map_err(|error| CompileError::Compiler(format!("{:?}", error.inner)))?;
    audit::relocations(compiled.buffer.relocs()).map_err(CompileError::Audit)?;
    Ok(Native {
        bytes: compiled.code_buffer().to_vec(),
        alignment: u64::from(compiled.buffer.alignment),
        text: compiled.vcode.clone(),
    })
}
