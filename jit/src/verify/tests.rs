#![allow(clippy::unwrap_used)]
use super::*;
use crate::options::{KernelOptions, VectorWidth};
use iced_x86::{MemoryOperand, Register};
use isophote_symbolic::{Lowering, Method, Model, Precision, Program};

const PLAIN: &str = r#"
name = "plain"
coordinates = ["x", "y"]
channels = ["r", "g"]
[parameters]
bx = { start = 10.0 }
v1 = { start = 1.0 }
[model]
observed = "r - 0.5 * g"
intensity = "v1 * (x - bx)^2"
domain = "(x - bx)^2 + y^2 <= 90"
"#;

const TEXT: &str = r#"
name = "masked"
coordinates = ["x", "y", "z"]
channels = ["r", "g"]
[parameters]
bx = { start = 10.0 }
by = { start = 7.0 }
v1 = { start = 1.0 }
[definitions]
d = "(x - bx) / by"
[model]
observed = "r - 0.5 * g"
intensity = "v1 * sin(d) + exp(-d^2) * z"
domain = "abs(x - bx) + sin(y) <= 9 and not (x * y > 150) or y < 2"
"#;

/// Programs that sum and that render.
pub(super) fn documents(fma: bool) -> [Program; 4] {
    let of = |text: &str, parameters: u32, drop_saturated: bool| {
        let model = Model::from_toml(text).unwrap();
        let all: Vec<_> = (0..parameters).map(isophote_symbolic::ParameterId).collect();
        let lowering = Lowering { fma, drop_saturated };
        let sums = model.objective(&all, Method::Newton).unwrap().program(lowering).unwrap();
        [sums, model.rendering(lowering).unwrap()]
    };
    let [sums, plane] = of(TEXT, 3, true);
    // Without a mask per pixel and without functions, row addresses are in registers.
    let [plain, plain_plane] = of(PLAIN, 2, false);
    [sums, plane, plain, plain_plane]
}

/// The programs, each with options.
fn subjects() -> Vec<(Program, KernelOptions)> {
    let [sums, plane, plain, plain_plane] = documents(true);
    let mut subjects = Vec::new();
    for width in [VectorWidth::Bits256, VectorWidth::Bits512] {
        for precision in [Precision::F32, Precision::F64] {
            for packed in [true, false] {
                let options = |formats| KernelOptions { precision, width, formats, packed };
                for sums in [&sums, &plain] {
                    subjects.push((sums.clone(), options(vec![PixelFormat::U8, PixelFormat::F64])));
                }
                for plane in [&plane, &plain_plane] {
                    subjects.push((plane.clone(), options(vec![PixelFormat::U8; plane.channels()])));
                }
            }
        }
    }
    subjects
}

/// Calls `see` with the instructions of each subject, and a check for modified ones.
fn each(mut see: impl FnMut(&[Instruction], &dyn Fn(&[Instruction]) -> Result<(), String>)) {
    for (program, options) in subjects() {
        let (assembled, _) = crate::x86::code(&program, &options).unwrap();
        let decoded = decode(&assembled.bytes, assembled.code_end).unwrap();
        let reach = Permitted::of(&program, &options);
        see(&decoded.instructions, &|instructions| check(instructions, &decoded.pool, reach));
    }
}

/// The number of instructions that `plant` changes in all subjects; every change is refused.
fn refused(plant: impl Fn(&mut Instruction) -> bool) -> usize {
    let mut planted = 0;
    each(|instructions, check| {
        for at in 0..instructions.len() {
            let mut wrong = instructions.to_vec();
            if !plant(&mut wrong[at]) {
                continue;
            }
            planted += 1;
            assert!(check(&wrong).is_err(), "{:?} instead of {:?} passes", wrong[at], instructions[at]);
        }
    });
    planted
}

fn has_memory(instruction: &Instruction) -> bool {
    (0..instruction.op_count()).any(|i| instruction.op_kind(i) == OpKind::Memory)
}

#[test]
fn kernels_pass() {
    let mut seen = 0;
    each(|instructions, check| {
        assert_eq!(check(instructions), Ok(()));
        seen += instructions.len();
    });
    assert!(seen > 5000, "{seen}");
}

#[test]
fn loads_out_of_the_window_are_refused() {
    let in_pixels = |i: &Instruction| {
        let is_of_row = matches!(i.memory_index(), Register::R12 | Register::R13);
        has_memory(i) && is_of_row && i.memory_base() != Register::RSP
    };
    let moved = refused(|i| {
        let is_meant = in_pixels(i);
        if is_meant {
            i.set_memory_displacement64(i.memory_displacement64() + 64 * 8);
        }
        is_meant
    });
    let before = refused(|i| {
        let is_meant = in_pixels(i);
        if is_meant {
            i.set_memory_displacement64(u64::MAX);
        }
        is_meant
    });
    let scaled = refused(|i| {
        let is_meant = in_pixels(i);
        if is_meant {
            i.set_memory_index_scale(if i.memory_index_scale() == 8 { 4 } else { 8 });
        }
        is_meant
    });
    let unbounded = refused(|i| {
        let is_meant = in_pixels(i);
        if is_meant {
            i.set_memory_index(Register::RDX);
        }
        is_meant
    });
    assert!(moved > 20 && moved == before && moved == scaled && moved == unbounded, "{moved}");
}

#[test]
fn a_missing_bound_is_refused() {
    // A full group that does not check for too late a start.
    let unasked = refused(|i| {
        let is_meant = i.code() == Code::Ja_rel32_64;
        if is_meant {
            i.set_code(Code::Jl_rel32_64);
        }
        is_meant
    });
    assert!(unasked > 20, "{unasked}");
    let mut planted = 0;
    each(|instructions, check| {
        for at in 0..instructions.len() {
            let bounded = instructions[at].op0_register();
            let is_bound =
                instructions[at].code() == Code::Cmova_r64_rm64 && instructions[at].op1_register() != Register::RDX;
            // A bound that only determines the lanes of a group is not needed for safety.
            let is_copy = |i: &Instruction| i.code() == Code::Mov_r64_rm64 && i.op1_kind() == OpKind::Register;
            let is_counted = instructions.get(at + 1).is_some_and(is_copy);
            if is_bound && !is_counted {
                let mut wrong = instructions.to_vec();
                wrong[at].set_code(Code::Mov_r64_rm64);
                wrong[at].set_op1_register(Register::R12);
                assert!(check(&wrong).is_err(), "{bounded:?} without a bound passes");
                planted += 1;
            }
        }
    });
    assert!(planted > 40, "{planted}");
}

#[test]
fn wrong_registers_are_refused() {
    let based = refused(|i| {
        let is_meant = has_memory(i) && matches!(i.memory_base(), Register::RSP | Register::RBX | Register::RAX);
        if is_meant {
            i.set_memory_base(Register::R12);
        }
        is_meant && i.code() != Code::Lea_r64_m
    });
    assert!(based > 2000, "{based}");
}

/// Whether it stores the address of a row.
fn keeps_address(i: &Instruction) -> bool {
    i.code() == Code::Mov_rm64_r64 && i.op1_register() == Register::RSI
}

#[test]
fn frame_overruns_and_overwritten_addresses_are_refused() {
    let below = refused(|i| {
        let is_meant = has_memory(i) && i.memory_base() == Register::RSP && i.code() != Code::Lea_r64_m;
        if is_meant {
            i.set_memory_displacement64((-64_i64) as u64);
        }
        is_meant
    });
    let above = refused(|i| {
        let is_meant = has_memory(i) && i.memory_base() == Register::RSP && i.code() != Code::Lea_r64_m;
        if is_meant {
            i.set_memory_displacement64(1 << 20);
        }
        is_meant
    });
    assert!(below > 2000 && above == below, "{below}");
    // A number in the place of a row address.
    let mut planted = 0;
    each(|instructions, check| {
        for (at, instruction) in instructions.iter().enumerate() {
            // In narrow windows, all row addresses are stored together, and nothing else before they are used.
            let near = &instructions[at.saturating_sub(100)..instructions.len().min(at + 100)];
            if keeps_address(instruction) && near.iter().filter(|i| keeps_address(i)).count() < 8 {
                let mut again = *instruction;
                again.set_op1_register(Register::RAX);
                again.set_code(Code::Mov_rm32_r32);
                again.set_op1_register(Register::EAX);
                let mut wrong = instructions.to_vec();
                // Replaces the next store into the frame.
                let Some(next) = wrong[at + 1..].iter_mut().find(|i| i.code() == Code::Mov_rm32_r32) else { continue };
                again.set_ip(next.ip());
                again.set_next_ip(next.next_ip());
                *next = again;
                planted += 1;
                assert!(check(&wrong).is_err());
            }
        }
    });
    assert!(planted > 8, "{planted}");
    // Nor any other number in their place.
    let others = refused(|i| {
        let is_meant = keeps_address(i);
        if is_meant {
            i.set_op1_register(Register::RAX);
        }
        is_meant
    });
    // Eight rows of two channels, of four programs that sum.
    assert!(others > 8 * 2 * 4, "{others}");
}

#[test]
fn columns_and_blocks_without_a_bound_are_refused() {
    // In narrow windows, r12 is the block, r14 the column or a row.
    let indexed = |i: &Instruction| {
        has_memory(i) && i.memory_base() == Register::RSP && matches!(i.memory_index(), Register::R12 | Register::R14)
    };
    for number in [Register::R13, Register::R15] {
        let unbounded = refused(|i| {
            let is_meant = indexed(i);
            if is_meant {
                i.set_memory_index(number);
            }
            is_meant
        });
        assert!(unbounded > 1000, "{unbounded}");
    }
    let mut planted = 0;
    each(|instructions, check| {
        for at in 1..instructions.len() {
            // An unsigned comparison with a constant bounds an index into the frame.
            let [before, jump] = [instructions[at - 1], instructions[at]];
            let is_bound = before.code() == Code::Cmp_rm64_imm32
                && matches!(before.op0_register(), Register::R12 | Register::R14)
                && jump.code() == Code::Jae_rel32_64;
            if is_bound {
                let mut wrong = instructions.to_vec();
                wrong[at].set_code(Code::Jge_rel32_64);
                planted += 1;
                assert!(check(&wrong).is_err(), "a jump at {:#x} without a bound passes", jump.ip());
            }
        }
    });
    assert!(planted > 40, "{planted}");
}

#[test]
fn invalid_arguments_lists_constants_and_calls_are_refused() {
    let arguments = refused(|i| {
        let is_meant = i.op_count() == 2 && i.op0_kind() == OpKind::Memory && i.memory_base() == Register::RBX;
        if is_meant {
            i.set_memory_displacement64(0);
        }
        is_meant
    });
    let constants = refused(|i| {
        let is_meant = i.is_ip_rel_memory_operand();
        if is_meant {
            i.set_memory_displacement64(i.memory_displacement64() + (1 << 20));
        }
        is_meant
    });
    let lists = refused(|i| {
        let is_meant = has_memory(i) && i.memory_base() == Register::RSI && i.code() != Code::Prefetcht0_m8;
        if is_meant {
            i.set_memory_displacement64(8 * 1000);
        }
        is_meant
    });
    let calls = refused(|i| {
        let is_meant = i.code() == Code::Call_rm64;
        if is_meant {
            i.set_memory_displacement64(4);
        }
        is_meant
    });
    let handed = refused(|i| {
        let is_meant = i.code() == Code::Lea_r64_m;
        if is_meant {
            i.set_memory_displacement64(1 << 20);
        }
        is_meant
    });
    assert!(arguments > 20 && constants > 200 && lists > 50 && calls > 20 && handed > 20);
}

/// Rows of the next block are prefetched, whether they exist or not; reading there is refused.
#[test]
fn prefetches_may_point_anywhere() {
    let mut elsewhere = 0;
    each(|instructions, check| {
        for at in (0..instructions.len()).filter(|at| instructions[*at].code() == Code::Prefetcht0_m8) {
            let mut other = instructions.to_vec();
            other[at].set_memory_displacement64(8 * 1000);
            assert_eq!(check(&other), Ok(()));
            elsewhere += 1;
        }
    });
    let read = refused(|i| {
        let is_meant = i.code() == Code::Prefetcht0_m8;
        if is_meant {
            let place = MemoryOperand::new(i.memory_base(), i.memory_index(), 8, 0, 0, false, Register::None);
            let mut load = Instruction::with2(Code::Mov_r64_rm64, Register::RAX, place).unwrap();
            load.set_len(i.len());
            load.set_ip(i.ip());
            *i = load;
        }
        is_meant
    });
    assert!(elsewhere > 40 && read == elsewhere, "{elsewhere}, {read}");
}

#[test]
fn unlisted_instructions_and_lost_registers_are_refused() {
    let strangers = refused(|i| {
        let is_meant = i.code() == Code::VEX_Vzeroupper;
        if is_meant {
            i.set_code(Code::Syscall);
        }
        is_meant
    });
    let lost = refused(|i| {
        let is_meant = i.code() == Code::Pop_r64;
        if is_meant {
            i.set_op0_register(Register::R11);
        }
        is_meant
    });
    let astray = refused(|i| {
        let is_meant = i.op_count() == 1 && i.op0_kind() == OpKind::NearBranch64;
        if is_meant {
            i.set_near_branch64(i.near_branch64() + 1);
        }
        is_meant
    });
    assert!(strangers > 20 && lost == 6 * subjects().len() && astray > 100);
}
