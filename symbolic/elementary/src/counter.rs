//! `Counter`: a machine that computes nothing and counts the operations.

use std::cell::Cell;

use super::machine::Machine;
use crate::function::Function1;

/// Counts the instructions of a function.
#[derive(Clone, Debug, Default)]
pub struct Counter {
    fused: bool,
    count: Cell<usize>,
}

impl Counter {
    /// A new counter for a machine.
    pub fn of(machine: &impl Machine) -> Counter {
        Counter { fused: machine.is_fused(), count: Cell::new(0) }
    }
    /// Number of instructions.
    pub fn count(&self) -> usize {
        self.count.get()
    }
    fn more(&self, operations: usize) {
        self.count.set(self.count.get() + operations);
    }
}

macro_rules! counted {
    ($($name:ident($($kind:ty),*))*) => {
        $(fn $name(&self, $(_: $kind),*) {
            self.more(1);
        })*
    };
}

impl Machine for Counter {
    type Number = ();
    type Truth = ();
    type Bits = ();

    fn is_fused(&self) -> bool {
        self.fused
    }
    fn mul_add(&self, _: (), _: (), _: ()) {
        self.more(if self.fused { 1 } else { 2 });
    }
    /// A test, a branch and the call.
    fn elsewhere(&self, _: (), _: (), _: Function1, _: ()) {
        self.more(8);
    }
    counted! {
        constant(f64) add((), ()) sub((), ()) mul((), ()) div((), ()) sqrt(()) abs(()) neg(())
        less((), ()) equal((), ()) and((), ()) or((), ()) not(()) select((), (), ())
        bits(()) number(()) pattern(u64) bits_add((), ()) bits_and((), ()) bits_or((), ()) bits_xor((), ())
        shift_left((), u8) shift_right((), u8) bits_equal((), ())
    }
}
