//! Checks gathers, which load a number per lane at vector indices. Nothing is known of the indices but the instruction right
//! before: the minimum of each and a constant.

use iced_x86::{Code, Instruction, Register};

use super::pool::{Checked, Pool};

/// Upper bound of the indices of a gather, `before` being the instruction in front of it.
///
/// # Errors
/// If `before` does not bound the indices, or the gather is illegal.
pub(super) fn bound(before: Option<&Instruction>, gather: &Instruction, pool: &Pool) -> Checked<i64> {
    let index = gather.memory_index();
    // Processors reject equal registers, and a missing mask.
    let is_legal = gather.op0_register() != index
        && match gather.code() {
            Code::VEX_Vgatherqpd_ymm_vm64y_ymm => ![gather.op0_register(), index].contains(&gather.op2_register()),
            _ => gather.op_mask() != Register::None,
        };
    if !is_legal {
        return Err("gathers with registers that processors refuse");
    }
    before.and_then(|before| bounded(before, index, pool)).ok_or("gathers by indices that nothing bounds")
}

/// The largest of the constants that bound 64-bit integers in a register, if the instruction bounds all lanes. Halves that do
/// not exceed those of a number form one that does not exceed it.
fn bounded(i: &Instruction, register: Register, pool: &Pool) -> Option<i64> {
    let is_least = match i.code() {
        Code::VEX_Vpminud_ymm_ymm_ymmm256 => true,
        Code::EVEX_Vpminuq_zmm_k1z_zmm_zmmm512b64 => i.op_mask() == Register::None,
        _ => false,
    };
    if !is_least || i.op0_register() != register || !i.is_ip_rel_memory_operand() {
        return None;
    }
    let most =
        pool.of(i)?.chunks_exact(size_of::<u64>()).map(|lane| lane.try_into().map_or(u64::MAX, u64::from_le_bytes));
    most.max().and_then(|most| u32::try_from(most).ok()).map(i64::from)
}

#[cfg(test)]
#[path = "gathered_tests.rs"]
mod tests;
