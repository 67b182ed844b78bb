//! Which numbers a kernel adds together, and in which order: it is part of what a program means, since sums of other orders differ
//! in their last bits.

use crate::program::window::Window;

/// Pixels that one group holds. Which of them a lane sums follows from their number, so that sums are equal bit for bit only
/// among the same.
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
    /// So many lanes; `None` where that is no power of two up to 16.
    pub fn of(count: usize) -> Option<Lanes> {
        [Lanes::One, Lanes::Two, Lanes::Four, Lanes::Eight, Lanes::Sixteen].into_iter().find(|l| l.count() == count)
    }

    /// How many they are.
    pub fn count(self) -> usize {
        self as usize
    }
}

/// The order of a kernel's sums. [`Lanes`] alone stand for the order of a loop that knows no narrow windows and sums rows one
/// after the other.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Summation {
    /// Lanes that share a row's pixels in turn.
    pub lanes: Lanes,
    /// Totals of a pass are kept so many times: one for each row of a block of so many, which are added together at the end,
    /// the upper half to the lower one until one is left. A power of two.
    pub rows: usize,
    /// The same as `lanes`, of a narrow window; `None`: no window is.
    pub narrow: Option<Lanes>,
}

impl From<Lanes> for Summation {
    fn from(lanes: Lanes) -> Summation {
        Summation { lanes, rows: 1, narrow: None }
    }
}

impl Summation {
    /// Columns that a narrow window has at most for each lane of a row, px: terms of a sum of f32 then, as few as those of rows of
    /// 512 px in each of eight lanes.
    pub const NARROW_PX_MAX: usize = 64;
    /// Rows that a narrow window has at least, over all slices: fewer leave lanes idle.
    pub const NARROW_ROWS_MIN: usize = 8;

    /// The lanes of a row, if the window is narrow: its columns belong to them in turn.
    pub fn narrow_in(self, window: Window, rows: usize) -> Option<Lanes> {
        let is_narrow = |lanes: &Lanes| window.width <= Self::NARROW_PX_MAX * lanes.count();
        self.narrow.filter(|lanes| is_narrow(lanes) && rows >= Self::NARROW_ROWS_MIN)
    }
}
