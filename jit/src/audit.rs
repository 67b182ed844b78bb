//! Audits every function for traps and imports, before and after compilation.
//!
//! A trapping instruction (converting a NaN to an integer, dividing by an integer zero) ends the process; an imported name
//! is looked up among all symbols of the process. So a function may use only listed operations, accesses memory with flags
//! that promise not to fault, and declares no function, no global and no table.

use cranelift_codegen::FinalizedMachReloc;
use cranelift_codegen::ir::{Function, InstructionData, Opcode};

/// Checks a function before compilation; returns the reason for a rejection.
pub(crate) fn function(function: &Function) -> Result<(), String> {
    if !function.dfg.ext_funcs.is_empty() || !function.global_values.is_empty() {
        return Err("it imports a name".into());
    }
    for block in function.layout.blocks() {
        for instruction in function.layout.block_insts(block) {
            let form = &function.dfg.insts[instruction];
            let flags = match form {
                InstructionData::Load { flags, .. } | InstructionData::Store { flags, .. } => Some(*flags),
                _ => None,
            };
            if !allowed(form.opcode()) {
                return Err(format!("{} is not on the list", function.dfg.display_inst(instruction)));
            }
            if flags.is_some_and(|flags| !function.dfg.mem_flags[flags].notrap()) {
                return Err(format!("{} may fault", function.dfg.display_inst(instruction)));
            }
        }
    }
    Ok(())
}

/// Checks machine code: any relocation would be an import.
pub(crate) fn relocations(relocations: &[FinalizedMachReloc]) -> Result<(), String> {
    match relocations.first() {
        None => Ok(()),
        Some(first) => Err(format!("it needs {:?}", first.target)),
    }
}

/// Operations that cannot trap (memory accesses depend on their flags), and calls through the function table.
fn allowed(opcode: Opcode) -> bool {
    use Opcode::*;
    let control = matches!(opcode, Jump | Brif | Return | CallIndirect);
    let memory = matches!(opcode, Load | Store | Uload8 | Uload16 | Uload16x4 | StackAddr);
    let integer = matches!(
        opcode,
        Iconst
            | Iadd
            | Isub
            | Imul
            | Ishl
            | Ushr
            | Icmp
            | Umin
            | Band
            | Bor
            | Bxor
            | Bnot
            | Uextend
            | Ireduce
            | Popcnt
            | Bmask
    );
    let float = matches!(
        opcode,
        Fadd | Fsub | Fmul | Fdiv | Fma | Fneg | Fabs | Sqrt | Fcmp | Select | Fpromote | Fdemote | FcvtFromSint
    );
    let vector = matches!(
        opcode,
        Vconst
            | Splat
            | Bitcast
            | Bitselect
            | Insertlane
            | Extractlane
            | ScalarToVector
            | Shuffle
            | VhighBits
            | UwidenLow
            | SwidenLow
            | Fvdemote
            | FvpromoteLow
    );
    control || memory || integer || float || vector
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::function as audit;
    use crate::host::{self, Allocator, Processor};
    use cranelift_codegen::ir::{self, Function, InstBuilder, MemFlagsData, types};
    use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext};

    fn build(body: impl FnOnce(&mut FunctionBuilder<'_>)) -> Function {
        let mut function = Function::new();
        let mut context = FunctionBuilderContext::new();
        let mut builder = FunctionBuilder::new(&mut function, &mut context);
        let block = builder.create_block();
        builder.switch_to_block(block);
        body(&mut builder);
        builder.ins().return_(&[]);
        builder.seal_all_blocks();
        builder.finalize(host::isa(Processor::Host, Allocator::Backtracking).unwrap().frontend_config());
        function
    }

    #[test]
    fn trap_free_code_passes() {
        let function = build(|b| {
            let number = b.ins().iconst(types::I64, -1);
            let number = b.ins().fcvt_from_sint(types::F64, number);
            b.ins().sqrt(number);
        });
        assert_eq!(audit(&function), Ok(()));
    }

    #[test]
    fn a_planted_trap_is_caught() {
        let function = build(|b| {
            let number = b.ins().iconst(types::I64, -1);
            let number = b.ins().fcvt_from_sint(types::F64, number);
            b.ins().fcvt_to_sint(types::I64, number);
        });
        assert!(audit(&function).unwrap_err().contains("fcvt_to_sint"));
    }

    #[test]
    fn a_planted_fault_is_caught() {
        let function = build(|b| {
            let address = b.ins().iconst(types::I64, 8);
            b.ins().load(types::I64, MemFlagsData::new(), address, 0);
        });
        assert!(audit(&function).unwrap_err().contains("may fault"));
    }

    #[test]
    fn a_planted_import_is_caught() {
        let function = build(|b| {
            let signature = b.import_signature(ir::Signature::new(cranelift_codegen::isa::CallConv::SystemV));
            let name = ir::ExternalName::testcase("abs");
            b.import_function(ir::ExtFuncData { name, signature, colocated: false, patchable: false });
        });
        assert!(audit(&function).unwrap_err().contains("imports"));
    }
}
