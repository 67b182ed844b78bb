//! Calls elementary functions through the table, a few lanes at a time.

use std::mem::offset_of;

use iced_x86::{Code, Instruction, Register};

use super::allocation::Allocation;
use crate::abi::Args;
use crate::vector::{Anchor, Element, Integer, MemoryPlace, Portion, arg};

/// Bytes of lanes per call.
pub(super) const CALL_BYTES: usize = 16;

/// Calls the function at byte `offset` of the table with `operands` vectors in the frame; `live` registers survive.
pub(super) fn call(allocation: &mut Allocation<'_>, offset: i32, operands: usize, live: u32) {
    let vector_bytes = allocation.width.bytes();
    let live: Vec<u8> = (0..32).filter(|register| live & 1 << register != 0).collect();
    for register in &live {
        let place = allocation.slots.saved(*register, vector_bytes);
        allocation.store(*register, Portion::Whole, Element::Single, place);
    }
    let [first, second] = allocation.slots.arguments(vector_bytes);
    allocation.write(|i| {
        // Dirty upper halves would slow down called SSE code.
        i.add(Ok(Instruction::with(Code::VEX_Vzeroupper)));
        for chunk in 0..vector_bytes / CALL_BYTES {
            i.point(Register::RDI, first.plus(CALL_BYTES * chunk));
            if operands == 2 {
                i.point(Register::RSI, second.plus(CALL_BYTES * chunk));
            }
            i.mov(Register::RAX, arg(offset_of!(Args, functions)));
            let function = MemoryPlace::new(Anchor::At(Integer::A), offset);
            i.add_at(function, |function| Instruction::with1(Code::Call_rm64, function));
        }
    });
    for register in live {
        let place = allocation.slots.saved(register, vector_bytes);
        allocation.load(register, place, Element::Single);
    }
}
