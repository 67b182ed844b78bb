//! Wide code with table lookups passes with exactly its tables, and is refused with a planted fault.
#![allow(clippy::unwrap_used)]

use iced_x86::OpKind;
use isophote_symbolic::{Lowering, Model, Precision, Program};

use super::super::compiled_tests::{TABLES, programs};
use super::super::{Decoded, Permitted, check, decode};
use super::*;
use crate::options::{KernelOptions, VectorWidth};
use crate::plane::PixelFormat;

/// Code of a program, with the memory that it may access.
struct Subject {
    program: Program,
    options: KernelOptions,
    decoded: Decoded,
}

fn subjects() -> Vec<Subject> {
    let mut subjects = Vec::new();
    for program in programs(&Model::from_toml(TABLES).unwrap(), Lowering { fma: true, drop_saturated: false }) {
        for width in [VectorWidth::Bits256, VectorWidth::Bits512] {
            for precision in [Precision::F32, Precision::F64] {
                let formats = vec![PixelFormat::U16; program.channels()];
                let options = KernelOptions { precision, width, formats, packed: true };
                let (assembled, _) = crate::x86::code(&program, &options).unwrap();
                let decoded = decode(&assembled.bytes, assembled.code_end).unwrap();
                subjects.push(Subject { program: program.clone(), options, decoded });
            }
        }
    }
    subjects
}

/// Spoils each gather with `plant`, which also gets the instruction before; all such code is refused, with `told` as reason.
fn refused(told: &str, plant: impl Fn(&mut Instruction, &mut Instruction)) {
    let mut planted = 0;
    for Subject { program, options, decoded } in subjects() {
        let reach = Permitted::of(&program, &options);
        for at in (0..decoded.instructions.len()).filter(|at| decoded.instructions[*at].is_vsib()) {
            let mut wrong = decoded.instructions.clone();
            let (before, gather) = wrong.split_at_mut(at);
            plant(&mut before[at - 1], &mut gather[0]);
            let found = check(&wrong, &decoded.pool, reach).unwrap_err();
            assert!(found.contains(told), "{found}");
            planted += 1;
        }
    }
    assert!(planted > 100, "{planted}");
}

#[test]
fn gathers_stop_at_the_last_number() {
    for Subject { program, options, mut decoded } in subjects() {
        let reach = Permitted::of(&program, &options);
        assert_eq!(check(&decoded.instructions, &decoded.pool, reach), Ok(()), "{options:?}");
        let short = Permitted { tables: reach.tables - 1, ..reach };
        let found = check(&decoded.instructions, &decoded.pool, short).unwrap_err();
        assert!(found.contains("leaves its list"), "{found}");
        // Bounds larger by one.
        let is_bound = |i: &&Instruction| bounded(i, i.op0_register(), &decoded.pool).is_some();
        let bounds = decoded.instructions.iter().filter(is_bound).map(Instruction::ip_rel_memory_address);
        for bound in bounds.collect::<std::collections::BTreeSet<u64>>() {
            decoded.pool.bytes[(bound - decoded.pool.first) as usize] += 1;
        }
        let found = check(&decoded.instructions, &decoded.pool, reach).unwrap_err();
        assert!(found.contains("leaves its list"), "{found}");
    }
}

#[test]
fn indices_without_a_bound_are_refused() {
    let told = "gathers by indices that nothing bounds";
    refused(told, |before, _| before.set_op0_register(before.op1_register()));
    refused(told, |before, gather| gather.set_memory_index(before.op1_register()));
    refused(told, |before, _| {
        before.set_code(match before.code() {
            Code::VEX_Vpminud_ymm_ymm_ymmm256 => Code::VEX_Vpaddq_ymm_ymm_ymmm256,
            _ => Code::EVEX_Vpaddq_zmm_k1z_zmm_zmmm512b64,
        });
    });
    refused(told, |before, _| before.set_memory_base(Register::RSP));
    refused("nothing bounds", |before, gather| match gather.op_mask() {
        Register::None => before.set_code(Code::VEX_Vpsubq_ymm_ymm_ymmm256),
        mask => before.set_op_mask(mask),
    });
}

#[test]
fn jumps_past_the_bound_are_refused() {
    let mut planted = 0;
    for Subject { program, options, decoded } in subjects() {
        let reach = Permitted::of(&program, &options);
        let gather = decoded.instructions.iter().find(|i| i.is_vsib()).unwrap().ip();
        for at in
            (0..decoded.instructions.len()).filter(|at| decoded.instructions[*at].op0_kind() == OpKind::NearBranch64)
        {
            let mut wrong = decoded.instructions.clone();
            wrong[at].set_near_branch64(gather);
            let found = check(&wrong, &decoded.pool, reach).unwrap_err();
            assert!(found.contains("nothing bounds"), "{found}");
            planted += 1;
        }
    }
    assert!(planted > 4, "{planted}");
}

#[test]
fn illegal_gathers_and_other_bases_are_refused() {
    let refuse = "registers that processors refuse";
    refused(refuse, |_, gather| gather.set_op0_register(gather.memory_index()));
    refused(refuse, |_, gather| match gather.code() {
        Code::VEX_Vgatherqpd_ymm_vm64y_ymm => gather.set_op2_register(gather.memory_index()),
        _ => gather.set_op_mask(Register::None),
    });
    refused("reads where nothing is known to be", |_, gather| gather.set_memory_base(Register::RBX));
    refused("reads where nothing is known to be", |_, gather| gather.set_memory_base(Register::RSP));
    refused("leaves its list", |_, gather| gather.set_memory_displacement64(1 << 12));
    refused("leaves its list", |_, gather| gather.set_memory_displacement64(-8_i64 as u64));
}
