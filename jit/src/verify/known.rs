//! Facts about 64 bits: where they point, or what bounds them.

/// A bound of an index of pixels.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Limit {
    /// The latest start of a group.
    Furthest,
    /// The last row of a slice, the last slice, the last volume.
    Last(usize),
    /// The last row over all slices and volumes.
    LastRow,
}

/// A distance in a plane: along the row, or along an outer coordinate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Distance {
    pub channel: usize,
    /// 0: x, 1: y …
    pub axis: usize,
}

/// A small sorted set of numbers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Few {
    count: u8,
    numbers: [i32; Few::MOST],
}

impl Few {
    /// Two rows in each of two areas.
    const MOST: usize = 4;

    pub fn one(number: i64) -> Option<Few> {
        Few::of([number].into_iter())
    }

    fn of(numbers: impl Iterator<Item = i64>) -> Option<Few> {
        let mut few = Few { count: 0, numbers: [0; Few::MOST] };
        for number in numbers {
            let number = i32::try_from(number).ok()?;
            if !few.numbers[..few.count.into()].contains(&number) {
                *few.numbers.get_mut(usize::from(few.count))? = number;
                few.count += 1;
            }
        }
        few.numbers[..few.count.into()].sort_unstable();
        Some(few)
    }

    pub fn each(&self) -> impl Iterator<Item = i64> + '_ {
        self.numbers[..self.count.into()].iter().map(|number| i64::from(*number))
    }

    /// The number, if there is only one.
    pub fn only(&self) -> Option<i64> {
        (self.count == 1).then(|| self.numbers[0].into())
    }

    fn plus(&self, other: &Few) -> Option<Few> {
        Few::of(self.each().flat_map(|a| other.each().map(move |b| a + b)))
    }

    pub fn plus_number(&self, number: i64) -> Option<Few> {
        Few::of(self.each().map(|at| at.saturating_add(number)))
    }
}

/// A set of possible 64-bit values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Fact {
    /// Any number; not an address.
    Number,
    OneOf(Few),
    /// A number from 0 on, less than this.
    Below(i64),
    /// A bound of the argument block.
    Limit(Limit),
    /// A number from 0 up to such a bound, inclusive.
    Within(Limit),
    /// A multiple of such a number.
    Multiple(Limit, i64),
    /// Bytes from a pixel to the next along an axis.
    Stride(Distance),
    /// A stride times a number within the axis's bound.
    Product(Distance),
    /// Bytes from a row of the output plane to the next, and that times a number within the last row.
    TargetStride,
    TargetProduct,
    Args,
    Inputs,
    Outputs,
    Functions,
    /// The function at an offset of the table.
    Function(i64),
    Planes,
    /// A number of the tables, at most so many bytes after the first.
    Tables(i64),
    /// A pixel of a plane: the window's first, moved along each axis whose bit is set, and by `lane` pixels.
    Pixel {
        channel: usize,
        axes: u8,
        lane: usize,
    },
    /// The first pixel of a group, if a pixel has `bytes` bytes.
    Group {
        channel: usize,
        bytes: i64,
    },
    /// A row of the output plane: the first, or any.
    Target {
        is_row: bool,
    },
    /// The first pixel of a group in the output plane.
    TargetGroup,
    /// An address in the frame, so many bytes from its lower end.
    Frame(Few),
    /// The caller's stack pointer after so many pushes.
    Stack(usize),
    /// The same, rounded down to a multiple of so many bytes.
    Aligned(i64),
    /// The caller's value of the register of that number.
    Caller(usize),
}

impl Fact {
    /// Whether it is an address in the frame.
    pub fn is_in_frame(self) -> bool {
        matches!(self, Fact::Frame(_))
    }

    pub fn constant(number: i64) -> Fact {
        Few::one(number).map_or(Fact::Number, Fact::OneOf)
    }

    /// The join: a fact that contains both.
    pub fn or(self, other: Fact) -> Fact {
        self.and_so(other).or_else(|| other.and_so(self)).unwrap_or(Fact::Number)
    }

    fn and_so(self, other: Fact) -> Option<Fact> {
        use Fact::*;
        Some(match (self, other) {
            (a, b) if a == b => a,
            (Below(a), Below(b)) => Below(a.max(b)),
            (Below(a), OneOf(few)) if few.each().all(|number| (0..a).contains(&number)) => Below(a),
            // Single numbers may join; larger sets must not grow.
            (OneOf(a), OneOf(b)) => match (a.only(), b.only()) {
                (Some(a), Some(b)) => OneOf(Few::of([a, b].into_iter())?),
                _ if b.each().all(|number| a.each().any(|known| known == number)) => OneOf(a),
                _ => return None,
            },
            (Frame(a), Frame(b)) => Frame(Few::of(a.each().chain(b.each()))?),
            (Within(limit), Limit(other)) if limit == other => Within(limit),
            (Pixel { channel, axes, lane }, Pixel { channel: b, axes: more, lane: c }) if (channel, lane) == (b, c) => {
                Pixel { channel, axes: axes | more, lane }
            }
            (Tables(a), Tables(b)) => Tables(a.max(b)),
            (Target { .. }, Target { .. }) => Target { is_row: true },
            _ => return None,
        })
    }

    /// The factor of a number within the latest start of a group.
    fn along_a_row(self) -> Option<i64> {
        match self {
            Fact::Limit(Limit::Furthest) | Fact::Within(Limit::Furthest) => Some(1),
            Fact::Multiple(Limit::Furthest, by) => Some(by),
            _ => None,
        }
    }

    /// The sum.
    pub fn plus(self, other: Fact) -> Fact {
        self.moved(other).or_else(|| other.moved(self)).unwrap_or(Fact::Number)
    }

    fn moved(self, by: Fact) -> Option<Fact> {
        Some(match (self, by) {
            (Fact::OneOf(a), Fact::OneOf(b)) => Fact::OneOf(a.plus(&b)?),
            (Fact::Frame(at), Fact::OneOf(few)) => Fact::Frame(at.plus(&few)?),
            (Fact::Tables(most), Fact::Below(count)) => Fact::Tables(most.checked_add(count - 1)?),
            (Fact::Pixel { channel, axes, lane: 0 }, Fact::Product(way))
                if way.channel == channel && axes & 1 << way.axis == 0 =>
            {
                Fact::Pixel { channel, axes: axes | 1 << way.axis, lane: 0 }
            }
            (Fact::Pixel { channel, axes, lane }, Fact::Stride(way)) if way == (Distance { channel, axis: 0 }) => {
                Fact::Pixel { channel, axes, lane: lane + 1 }
            }
            (Fact::Pixel { channel, axes, lane: 0 }, across) if axes & 1 == 0 => {
                Fact::Group { channel, bytes: across.along_a_row()? }
            }
            (Fact::Target { is_row: false }, Fact::TargetProduct) => Fact::Target { is_row: true },
            (Fact::Target { .. }, across) if across.along_a_row()? == size_of::<f32>() as i64 => Fact::TargetGroup,
            _ => return None,
        })
    }

    /// The product with a small constant.
    pub fn scaled(self, by: i64) -> Fact {
        match self {
            known if by == 1 => known,
            Fact::OneOf(few) => {
                Few::of(few.each().map(|number| number.saturating_mul(by))).map_or(Fact::Number, Fact::OneOf)
            }
            Fact::Below(count) if (0..=1 << 24).contains(&count) && (1..=1 << 16).contains(&by) => {
                Fact::Below((count - 1) * by + 1)
            }
            Fact::Limit(limit) | Fact::Within(limit) => Fact::Multiple(limit, by),
            _ => Fact::Number,
        }
    }

    /// The product.
    pub fn times(self, other: Fact) -> Fact {
        self.often(other).or_else(|| other.often(self)).unwrap_or(Fact::Number)
    }

    fn often(self, stride: Fact) -> Option<Fact> {
        let (Fact::Within(limit) | Fact::Limit(limit)) = self else { return None };
        match (limit, stride) {
            (Limit::Furthest, Fact::Stride(way)) if way.axis == 0 => Some(Fact::Product(way)),
            (Limit::Last(outer), Fact::Stride(way)) if way.axis == outer + 1 => Some(Fact::Product(way)),
            (Limit::LastRow, Fact::TargetStride) => Some(Fact::TargetProduct),
            _ => None,
        }
    }

    /// Refines a fact by a bound; keeps it if it is more precise.
    pub fn and(self, bound: Fact) -> Fact {
        match (self, bound) {
            (Fact::Number, _)
            | (Fact::OneOf(_) | Fact::Below(_), Fact::Within(_))
            | (Fact::Multiple(..), Fact::Below(_)) => bound,
            _ => self,
        }
    }

    /// The fact of a number that is at most this one, both unsigned.
    pub fn bounds_equal(self) -> Option<Fact> {
        match self {
            Fact::OneOf(few) => Some(Fact::Below(few.only().filter(|most| *most >= 0)? + 1)),
            _ => self.bounds_less(),
        }
    }

    /// The fact of a number that is less than this one, both unsigned.
    pub fn bounds_less(self) -> Option<Fact> {
        match self {
            Fact::Limit(limit) | Fact::Within(limit) => Some(Fact::Within(limit)),
            Fact::OneOf(few) => Some(Fact::Below(few.only().filter(|end| *end > 0)?)),
            _ => None,
        }
    }
}
