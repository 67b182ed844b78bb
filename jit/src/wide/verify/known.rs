//! What is known of a general register: where it points, or what bounds it.

/// What bounds a number that pixels are counted with.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Limit {
    /// Where a group begins at the latest.
    Furthest,
    /// The last row of a slice, the last slice, the last volume.
    Last(usize),
    /// The last row of all.
    LastRow,
}

/// A distance in a plane: along the row, or along an outer coordinate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Distance {
    pub channel: usize,
    /// 0: x, 1: y …
    pub axis: usize,
}

/// What is known of 64 bits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Fact {
    /// Any number; no address.
    Number,
    /// A number from 0 on, less than this.
    Below(i64),
    /// One of the argument block's bounds, …
    Limit(Limit),
    /// … and a number from 0 on that is not greater.
    Within(Limit),
    /// Bytes from a pixel to the next along an axis, …
    Stride(Distance),
    /// … and as often as the axis allows.
    Product(Distance),
    /// Bytes from a row of the output plane to the next, and as often as there are rows.
    TargetStride,
    TargetProduct,
    Args,
    Inputs,
    Outputs,
    Functions,
    Planes,
    /// A pixel of a plane: from the window's first so far along each axis of which the bit is set, and so many pixels on.
    Pixel {
        channel: usize,
        axes: u8,
        lane: usize,
    },
    /// A row of the output plane; of the first, or of any.
    Target {
        is_row: bool,
    },
    /// The frame, so many bytes from its lower end.
    Frame(i64),
    /// The stack as the caller left it, so many registers later.
    Stack(usize),
    /// The same, rounded down.
    Aligned,
}

impl Fact {
    /// What holds of either.
    pub fn or(self, other: Fact) -> Fact {
        match (self, other) {
            (Fact::Below(a), Fact::Below(b)) => Fact::Below(a.max(b)),
            (a, b) if a == b => a,
            _ => Fact::Number,
        }
    }

    /// Whether it may serve as an address.
    pub fn is_pointer(self) -> bool {
        use Fact::*;
        !matches!(
            self,
            Number | Below(_) | Limit(_) | Within(_) | Stride(_) | Product(_) | TargetStride | TargetProduct
        )
    }

    /// The sum.
    pub fn plus(self, other: Fact) -> Fact {
        match (self, other) {
            (Fact::Pixel { channel, axes, lane: 0 }, Fact::Product(way))
            | (Fact::Product(way), Fact::Pixel { channel, axes, lane: 0 })
                if way.channel == channel && axes & 1 << way.axis == 0 =>
            {
                Fact::Pixel { channel, axes: axes | 1 << way.axis, lane: 0 }
            }
            (Fact::Pixel { channel, axes, lane }, Fact::Stride(way)) if way == (Distance { channel, axis: 0 }) => {
                Fact::Pixel { channel, axes, lane: lane + 1 }
            }
            (Fact::Target { is_row: false }, Fact::TargetProduct) => Fact::Target { is_row: true },
            _ => Fact::Number,
        }
    }

    /// So many times a number that is small.
    pub fn scaled(self, by: i64) -> Fact {
        match self {
            Fact::Below(count) if (0..=1 << 16).contains(&count) && (1..=1 << 8).contains(&by) => {
                Fact::Below((count - 1) * by + 1)
            }
            _ => Fact::Number,
        }
    }

    /// The product.
    pub fn times(self, other: Fact) -> Fact {
        match (self, other) {
            (Fact::Within(Limit::Furthest), Fact::Stride(way)) if way.axis == 0 => Fact::Product(way),
            (Fact::Within(Limit::Last(outer)), Fact::Stride(way)) if way.axis == outer + 1 => Fact::Product(way),
            (Fact::Within(Limit::LastRow), Fact::TargetStride) => Fact::TargetProduct,
            _ => Fact::Number,
        }
    }
}
