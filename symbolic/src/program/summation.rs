//! Summation order of a kernel: part of a program's semantics, since other orders differ in the last bits.

use crate::program::window::Window;

/// Pixels per group. They determine which lane sums a pixel, so sums are equal bit for bit only for equal lanes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Lanes {
    /// One pixel at a time.
    One = 1,
    /// Two.
    Two = 2,
    /// Four.
    Four = 4,
    /// Eight.
    Eight = 8,
    /// Sixteen.
    Sixteen = 16,
}

impl Lanes {
    /// `None` unless `count` is a power of two up to 16.
    pub fn of(count: usize) -> Option<Lanes> {
        [Lanes::One, Lanes::Two, Lanes::Four, Lanes::Eight, Lanes::Sixteen].into_iter().find(|l| l.count() == count)
    }

    /// Number of lanes.
    pub fn count(self) -> usize {
        self as usize
    }
}

/// The order of a kernel's sums. [`Lanes`] alone stand for a loop without narrow windows that sums rows one after the
/// other.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Summation {
    /// Lanes that share a row's pixels in turn.
    pub lanes: Lanes,
    /// Rows of a block, a power of two: each has pass totals of its own, which are added at the end, the upper half to
    /// the lower one until one is left.
    pub rows: usize,
    /// Lanes in a narrow window; `None`: no window is narrow.
    pub narrow: Option<Lanes>,
}

impl From<Lanes> for Summation {
    fn from(lanes: Lanes) -> Summation {
        Summation { lanes, rows: 1, narrow: None }
    }
}

impl Summation {
    /// Most columns of a narrow window per lane, px: a lane then sums as few f32 terms as in rows of 512 px with eight
    /// lanes.
    pub const NARROW_PX_MAX: usize = 64;
    /// Fewest rows of a narrow window, over all slices: fewer leave lanes idle.
    pub const NARROW_ROWS_MIN: usize = 8;

    /// The lanes of a row if the window is narrow; they take its columns in turn.
    pub fn narrow_in(self, window: Window, rows: usize) -> Option<Lanes> {
        let is_narrow = |lanes: &Lanes| window.width <= Self::NARROW_PX_MAX * lanes.count();
        self.narrow.filter(|lanes| is_narrow(lanes) && rows >= Self::NARROW_ROWS_MIN)
    }
}
