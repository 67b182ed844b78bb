//! Cranelift's code for several x86-64 levels passes, and is refused with a planted fault.
#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use super::tests::documents;
use super::*;
use crate::clif::{Bounds, function};
use crate::host::{self, Allocator};
use crate::options::VectorWidth;
use cranelift_codegen::Context;
use cranelift_codegen::control::ControlPlane;
use cranelift_codegen::isa::TargetIsa;
use cranelift_codegen::settings::Configurable;
use iced_x86::Mnemonic;
use isophote_symbolic::{Lowering, Model, Opcode, Precision};

/// Processors without any extension, with SSE4.2, with AVX, with AVX2 and FMA, with AVX-512.
const LEVELS: [&str; 5] = ["baseline", "nehalem", "sandybridge", "haswell", "skylake-avx512"];

/// Levels for planted faults.
const PLANTED: [&str; 2] = [LEVELS[0], LEVELS[3]];

fn compiler(level: &str, allocator: Allocator) -> (Arc<dyn TargetIsa>, bool) {
    let mut target = cranelift_codegen::isa::lookup_by_name("x86_64").unwrap();
    target.enable(level).unwrap();
    let isa = host::built(target, allocator).unwrap();
    let has = |name: &str| isa.isa_flags().iter().any(|flag| flag.name == name && flag.as_bool() == Some(true));
    let has_fma = has("has_fma") && has("has_avx");
    (isa, has_fma)
}

fn code(program: &Program, options: &KernelOptions, isa: &dyn TargetIsa) -> Vec<u8> {
    let mut context = Context::for_function(function(program, options, isa, Bounds::Branches));
    let compiled = context.compile(isa, &mut ControlPlane::default()).unwrap();
    assert!(compiled.buffer.relocs().is_empty(), "code that needs something filled in");
    compiled.code_buffer().to_vec()
}

fn options(program: &Program, precision: Precision, format: PixelFormat, packed: bool) -> KernelOptions {
    KernelOptions { precision, width: VectorWidth::Bits128, formats: vec![format; program.channels()], packed }
}

/// The programs of a model: the sums of each stage, and the rendering.
pub(super) fn programs(model: &Model, lowering: Lowering) -> Vec<Program> {
    let sums = |stage: &isophote_symbolic::Stage| {
        model.objective(&stage.parameters, stage.method).unwrap().program(lowering).unwrap()
    };
    model.stages().iter().map(sums).chain([model.rendering(lowering).unwrap()]).collect()
}

#[test]
fn kernels_of_all_shipped_documents_pass() {
    let mut seen = 0;
    for file in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../models")).unwrap() {
        let path = file.unwrap().path();
        let model = Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap();
        for fused in [true, false] {
            let programs = programs(&model, Lowering { fma: fused, drop_saturated: true });
            let levels = [("haswell", Allocator::Backtracking), ("skylake-avx512", Allocator::SinglePass)];
            let baseline = [("baseline", Allocator::Backtracking), ("baseline", Allocator::SinglePass)];
            for (level, allocator) in if fused { levels } else { baseline } {
                let (isa, _) = compiler(level, allocator);
                for program in &programs {
                    for precision in [Precision::F32, Precision::F64] {
                        let formats = [PixelFormat::U8, PixelFormat::U16, PixelFormat::F32];
                        for format in formats.into_iter().take(if fused { 3 } else { 1 }) {
                            let options = options(program, precision, format, program.channels() == 1);
                            let bytes = code(program, &options, &*isa);
                            let verdict = verify(&bytes, bytes.len(), Permitted::of(program, &options));
                            assert_eq!(verdict, Ok(()), "{path:?}, {level}, {options:?}");
                            seen += 1;
                        }
                    }
                }
            }
        }
    }
    assert!(seen > 400, "{seen}");
}

/// Operations in every order, at every level, on formats of every kind.
#[test]
fn generated_programs_pass() {
    let (mut seen, mut refused) = (0, std::collections::BTreeSet::new());
    for level in LEVELS {
        for allocator in [Allocator::Backtracking, Allocator::SinglePass] {
            let (isa, has_fma) = compiler(level, allocator);
            for seed in 0..400 {
                let (program, precision, stage, _) = crate::x86::emulation_tests::subject(seed, VectorWidth::Bits128);
                let fused = program.is_fused() || program.instructions().iter().any(|i| i.op.code == Opcode::Fma);
                if fused && !has_fma {
                    continue;
                }
                let options = stage.options(precision, VectorWidth::Bits128);
                let bytes = code(&program, &options, &*isa);
                let decoded = decode(&bytes, bytes.len()).unwrap();
                let strangers = decoded.instructions.iter().filter(|i| !listed::is_allowed(i));
                refused.extend(strangers.map(|i| format!("{:?}", i.code())));
                let verdict = verify(&bytes, bytes.len(), Permitted::of(&program, &options));
                refused.extend(
                    verdict.err().map(|rule| format!("{level}, seed {seed}: {rule}")).filter(|_| refused.is_empty()),
                );
                seen += 1;
            }
        }
    }
    assert!(refused.is_empty() && seen > 1000, "{seen}: {refused:#?}");
}

struct Subject {
    program: Program,
    options: KernelOptions,
    decoded: Decoded,
}

/// Code with masks, functions and slices, and code without, for every level.
fn subjects(levels: &[&str]) -> Vec<Subject> {
    let mut subjects = Vec::new();
    for level in levels {
        let (isa, fma) = compiler(level, Allocator::Backtracking);
        for program in documents(fma) {
            for precision in [Precision::F32, Precision::F64] {
                for (format, packed) in [(PixelFormat::U8, true), (PixelFormat::F64, true), (PixelFormat::U16, false)] {
                    let options = options(&program, precision, format, packed);
                    let bytes = code(&program, &options, &*isa);
                    let decoded = decode(&bytes, bytes.len()).unwrap();
                    subjects.push(Subject { program: program.clone(), options, decoded });
                }
            }
        }
    }
    subjects
}

impl Subject {
    fn check(&self, instructions: &[Instruction]) -> Result<(), String> {
        check(instructions, &self.decoded.pool, Permitted::of(&self.program, &self.options))
    }
}

/// The number of instructions that `plant` changes, given the one before as well; every change is refused.
fn refused(plant: impl Fn(&Instruction, &mut Instruction) -> bool) -> usize {
    let mut planted = 0;
    for subject in subjects(&PLANTED) {
        let instructions = &subject.decoded.instructions;
        for at in 1..instructions.len() {
            let mut wrong = instructions.clone();
            if plant(&instructions[at - 1], &mut wrong[at]) {
                planted += 1;
                let verdict = subject.check(&wrong);
                assert!(verdict.is_err(), "{:?} at {at} of {:?} passes", wrong[at], subject.options);
            }
        }
    }
    planted
}

fn has_memory(i: &Instruction) -> bool {
    i.mnemonic() != Mnemonic::Lea && (0..i.op_count()).any(|operand| i.op_kind(operand) == OpKind::Memory)
}

/// Pixels indexed in their row. Arrays of rows in the frame also have an index; general registers read larger elements of them.
fn is_pixel(i: &Instruction) -> bool {
    has_memory(i)
        && i.memory_index() != Register::None
        && i.memory_size().size() < 8
        && i.op0_kind() == OpKind::Register
        && i.op0_register().is_gpr()
}

/// Changes the displacement if `is_meant`.
fn moved(is_meant: bool, i: &mut Instruction, by: i64) -> bool {
    if is_meant {
        i.set_memory_displacement64((i.memory_displacement64() as i64 + by) as u64);
    }
    is_meant
}

#[test]
fn compiled_code_passes() {
    for subject in subjects(&LEVELS) {
        assert_eq!(subject.check(&subject.decoded.instructions), Ok(()), "{:?}", subject.options);
    }
}

#[test]
fn loads_out_of_the_window_are_refused() {
    let behind = refused(|_, i| moved(is_pixel(i), i, 4 * 8));
    let before = refused(|_, i| moved(is_pixel(i), i, -8));
    let scaled = refused(|_, i| {
        let is_meant = is_pixel(i);
        if is_meant {
            i.set_memory_index_scale(if i.memory_index_scale() == 8 { 4 } else { 8 });
        }
        is_meant
    });
    let based = refused(|_, i| {
        let is_meant = is_pixel(i);
        if is_meant {
            i.set_memory_base(Register::RSP);
        }
        is_meant
    });
    assert!(behind > 50 && behind == before && behind == scaled && behind == based, "{behind}");
}

#[test]
fn missing_bounds_are_refused() {
    // The index of a row or group, unbounded.
    let taken = refused(|_, i| {
        let is_meant = i.code() == Code::Cmovb_r64_rm64;
        if is_meant {
            i.set_code(Code::Mov_r64_rm64);
            i.set_op1_register(i.op0_register());
        }
        is_meant
    });
    // A full group, or an array of rows, with a signed comparison of its start.
    let unasked = refused(|before, i| {
        let code = match i.code() {
            Code::Jb_rel32_64 => Code::Jl_rel32_64,
            Code::Jae_rel32_64 => Code::Jge_rel32_64,
            Code::Ja_rel32_64 => Code::Jg_rel32_64,
            Code::Jbe_rel32_64 => Code::Jle_rel32_64,
            _ => return false,
        };
        i.set_code(code);
        before.mnemonic() == Mnemonic::Cmp
    });
    assert!(taken > 100 && unasked > 50, "{taken}, {unasked}");
}

#[test]
fn stores_elsewhere_are_refused() {
    let is_store = |i: &Instruction| has_memory(i) && i.op0_kind() == OpKind::Memory && i.op_count() == 2;
    let in_frame = |i: &Instruction| has_memory(i) && i.memory_base() == Register::RSP;
    let is_written = |i: &Instruction| is_store(i) && !matches!(i.mnemonic(), Mnemonic::Cmp | Mnemonic::Test);
    let above = refused(|_, i| moved(in_frame(i), i, 1 << 19));
    let below = refused(|_, i| moved(in_frame(i), i, -(1 << 19)));
    let based = refused(|_, i| {
        let is_meant = in_frame(i);
        if is_meant {
            i.set_memory_base(Register::RBP);
        }
        is_meant
    });
    let elsewhere = refused(|_, i| moved(is_written(i) && !in_frame(i), i, -(1 << 16)));
    assert!(above > 5000 && above == below && above == based && elsewhere > 200, "{above}, {elsewhere}");
}

#[test]
fn unlisted_instructions_and_lost_registers_are_refused() {
    let strangers = refused(|_, i| {
        let is_meant = i.code() == Code::Retnq;
        if is_meant {
            i.set_code(Code::Syscall);
        }
        is_meant
    });
    let popped = refused(|_, i| {
        let is_meant = i.code() == Code::Pop_r64;
        if is_meant {
            i.set_op0_register(Register::R11);
        }
        is_meant
    });
    let constants = refused(|_, i| moved(i.is_ip_rel_memory_operand(), i, 1 << 19));
    let calls = refused(|_, i| {
        let is_meant = i.code() == Code::Call_rm64;
        if is_meant {
            i.set_op0_register(Register::RSP);
        }
        is_meant
    });
    let astray = refused(|_, i| {
        let is_meant = i.op_count() == 1 && i.op0_kind() == OpKind::NearBranch64;
        if is_meant {
            i.set_near_branch64(i.near_branch64() + 1);
        }
        is_meant
    });
    assert!(strangers == subjects(&PLANTED).len() && popped == strangers, "{strangers}, {popped}");
    assert!(constants > 1000 && calls > 100 && astray > 500, "{constants}, {calls}, {astray}");
}

/// A profile over one axis, followed by one over two.
pub(super) const TABLES: &str = r#"
name = "tables"
coordinates = ["x", "y"]
channels = ["phi"]
[tables]
line = { first = 0, step = 1, values = [1, 3, 2, 1, 0] }
plane = { first = [0, 0], step = [2, 3], values = [[1, 3, 2, 1], [2, 5, 3, 1], [1, 2, 2, 0], [0, 1, 1, 0]] }
[parameters]
bx = { start = 10.0 }
by = { start = 7.0 }
[model]
intensity = 'table("line", x - bx) + table("plane", x - bx, y - by) + table("line", by)'
"#;

#[test]
fn table_reads_stop_at_the_last_number() {
    let model = Model::from_toml(TABLES).unwrap();
    for level in LEVELS {
        let (isa, fma) = compiler(level, Allocator::Backtracking);
        for program in programs(&model, Lowering { fma, drop_saturated: false }) {
            for precision in [Precision::F32, Precision::F64] {
                let options = options(&program, precision, PixelFormat::U16, true);
                let bytes = code(&program, &options, &*isa);
                let reach = Permitted::of(&program, &options);
                assert_eq!(verify(&bytes, bytes.len(), reach), Ok(()), "{level}");
                let short = Permitted { tables: reach.tables - 1, ..reach };
                let found = verify(&bytes, bytes.len(), short).unwrap_err();
                assert!(found.contains("leaves its list"), "{level}: {found}");
            }
        }
    }
}
