#![allow(clippy::unwrap_used)]
use super::*;
use crate::clif::{Bounds, function};
use crate::host::{self, Allocator, Processor};
use crate::options::{KernelOptions, VectorWidth};
use crate::plane::PixelFormat;
use cranelift_codegen::ir::{AbiParam, InstBuilder, MemFlagsData, StackSlotData, StackSlotKind};
use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext};
use isophote_symbolic::{Lowering, Model, Precision};

const FLAGS: MemFlagsData = MemFlagsData::trusted();

/// A function of one argument with a record of 32 bytes; `body` gets both addresses.
fn verdict(body: impl FnOnce(&mut FunctionBuilder<'_>, Value, Value)) -> Result<(), String> {
    let mut function = Function::new();
    function.signature.params.push(AbiParam::new(types::I64));
    let mut context = FunctionBuilderContext::new();
    let mut builder = FunctionBuilder::new(&mut function, &mut context);
    let slot = builder.create_sized_stack_slot(StackSlotData::new(StackSlotKind::ExplicitSlot, 32, 4));
    let block = builder.create_block();
    builder.append_block_params_for_function_params(block);
    builder.switch_to_block(block);
    let args = builder.block_params(block)[0];
    let record = builder.ins().stack_addr(types::I64, slot, 0);
    body(&mut builder, args, record);
    builder.ins().return_(&[]);
    builder.seal_all_blocks();
    let isa = host::isa(Processor::Host, Allocator::Backtracking).unwrap();
    builder.finalize(isa.frontend_config());
    addresses(&function, Extent { inputs: 24, outputs: 16, planes: size_of::<PlaneArgs>() })
}

fn pointer(b: &mut FunctionBuilder<'_>, args: Value, field: usize) -> Value {
    b.ins().load(types::I64, FLAGS, args, field as i32)
}

/// Calls `callee` with the address `vector`, valid or not.
fn call(b: &mut FunctionBuilder<'_>, callee: Value, vector: Value) {
    let mut signature = cranelift_codegen::ir::Signature::new(cranelift_codegen::isa::CallConv::SystemV);
    signature.params.push(AbiParam::new(types::I64));
    let signature = b.import_signature(signature);
    b.ins().call_indirect(signature, callee, &[vector]);
}

/// Calls the first function of the table.
fn call_with(b: &mut FunctionBuilder<'_>, args: Value, vector: Value) {
    let functions = pointer(b, args, offset_of!(Args, functions));
    let callee = b.ins().load(types::I64, FLAGS, functions, 0);
    call(b, callee, vector);
}

#[test]
fn accesses_of_kernels_pass() {
    let end = verdict(|b, args, record| {
        let inputs = pointer(b, args, offset_of!(Args, inputs));
        let number = b.ins().load(types::F64, FLAGS, inputs, 16);
        b.ins().store(FLAGS, number, record, 24);
        let planes = pointer(b, args, offset_of!(Args, planes));
        let first = b.ins().load(types::I64, FLAGS, planes, 0);
        // A pixel address that goes through the record and around a loop.
        b.ins().store(FLAGS, first, record, 0);
        let first = b.ins().load(types::I64, FLAGS, record, 0);
        let body = b.create_block();
        let after = b.create_block();
        let at = b.append_block_param(body, types::I64);
        b.ins().jump(body, &[first.into()]);
        b.switch_to_block(body);
        let pixel = b.ins().load(types::I32, FLAGS, at, 0);
        let next = b.ins().iadd_imm_s(at, 4);
        b.ins().brif(pixel, body, &[next.into()], after, &[]);
        b.switch_to_block(after);
        let outputs = pointer(b, args, offset_of!(Args, outputs));
        b.ins().store(FLAGS, number, outputs, 8);
        let vector = b.ins().iadd_imm_s(record, 16);
        call_with(b, args, vector);
        let count = b.ins().iconst(types::I64, 1);
        b.ins().store(FLAGS, count, args, offset_of!(Args, saturated) as i32);
    });
    assert_eq!(end, Ok(()));
}

#[test]
fn planted_addresses_are_refused() {
    type Plant = fn(&mut FunctionBuilder<'_>, Value, Value);
    let plants: [(&str, Plant); 15] = [
        ("a constant address", |b, _, _| {
            let address = b.ins().iconst(types::I64, 4096);
            b.ins().load(types::F64, FLAGS, address, 0);
        }),
        ("beyond the record", |b, _, record| {
            b.ins().load(types::F64X2, FLAGS, record, 24);
        }),
        ("before the record", |b, _, record| {
            b.ins().load(types::F64, FLAGS, record, -8);
        }),
        ("beyond the argument block", |b, args, _| {
            b.ins().load(types::I64, FLAGS, args, size_of::<Args>() as i32 - 4);
        }),
        ("beyond the inputs", |b, args, _| {
            let inputs = pointer(b, args, offset_of!(Args, inputs));
            b.ins().load(types::F64, FLAGS, inputs, 24);
        }),
        ("beyond the outputs", |b, args, _| {
            let outputs = pointer(b, args, offset_of!(Args, outputs));
            let number = b.ins().f64const(0.0);
            b.ins().store(FLAGS, number, outputs, 16);
        }),
        ("a pointer overwritten", |b, args, _| {
            b.ins().store(FLAGS, args, args, offset_of!(Args, inputs) as i32);
        }),
        ("a raw pixel overwritten", |b, args, _| {
            let planes = pointer(b, args, offset_of!(Args, planes));
            let first = b.ins().load(types::I64, FLAGS, planes, 0);
            b.ins().store(FLAGS, args, first, 0);
        }),
        ("a number as an address", |b, args, _| {
            let width = pointer(b, args, offset_of!(Args, width));
            b.ins().load(types::F64, FLAGS, width, 0);
        }),
        ("half of a pointer overwritten", |b, args, record| {
            let inputs = pointer(b, args, offset_of!(Args, inputs));
            b.ins().store(FLAGS, inputs, record, 8);
            let number = b.ins().f64const(0.0);
            b.ins().store(FLAGS, number, record, 12);
            let inputs = b.ins().load(types::I64, FLAGS, record, 8);
            b.ins().load(types::F64, FLAGS, inputs, 0);
        }),
        ("a pointer that may be another", |b, args, record| {
            let either = b.ins().select(args, args, record);
            b.ins().load(types::F64, FLAGS, either, 0);
        }),
        ("a call that is given the argument block", |b, args, _| call_with(b, args, args)),
        ("a call that is given the record's end", |b, args, record| {
            let end = b.ins().iadd_imm_s(record, 24);
            call_with(b, args, end);
        }),
        ("a call of half an address", |b, args, record| {
            let functions = pointer(b, args, offset_of!(Args, functions));
            let callee = b.ins().load(types::I64, FLAGS, functions, 4);
            call(b, callee, record);
        }),
        ("a call of a pixel", |b, args, _| {
            let planes = pointer(b, args, offset_of!(Args, planes));
            let first = b.ins().load(types::I64, FLAGS, planes, 0);
            call(b, first, args);
        }),
    ];
    for (what, plant) in plants {
        let end = verdict(plant);
        assert!(end.as_ref().is_err_and(|error| error.contains("leaves the kernel's memory")), "{what}: {end:?}");
    }
}

#[test]
fn kernels_of_all_shipped_documents_pass() {
    let isa = host::isa(Processor::Host, Allocator::Backtracking).unwrap();
    let lowering = Lowering { fma: false, drop_saturated: true };
    for file in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../models")).unwrap() {
        let path = file.unwrap().path();
        let model = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let sums = model.stages().iter().map(|stage| model.objective(&stage.parameters, stage.method).unwrap());
        let programs = sums.map(|objective| objective.program(lowering).unwrap());
        for program in programs.chain([model.rendering(lowering).unwrap()]) {
            for (precision, packed) in [(Precision::F32, true), (Precision::F64, false)] {
                let formats = vec![PixelFormat::U16; program.channels()];
                let options = KernelOptions { precision, width: VectorWidth::Bits128, formats, packed };
                let function = function(&program, &options, &*isa, Bounds::Minima);
                assert_eq!(addresses(&function, Extent::of(&program)), Ok(()), "{path:?}, {options:?}");
            }
        }
    }
}
