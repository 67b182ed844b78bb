//! Windows: the pixels of a picture, or of a stack, that a program runs over.

/// The third and fourth coordinate of a window: which slices of which volumes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Slices {
    /// First slice, first volume.
    pub first: [usize; 2],
    /// Slices of each volume, number of volumes.
    pub count: [usize; 2],
}

impl Slices {
    /// The one slice of a picture.
    pub const ONE: Slices = Slices { first: [0, 0], count: [1, 1] };
    /// All slices.
    pub const ALL: Slices = Slices { first: [0, 0], count: [usize::MAX, usize::MAX] };
}

/// A rectangle of pixels of an image, px; (x, y) is its top-left pixel. In a stack, the same rectangle of several slices.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Window {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Its slices; [`Slices::ONE`] for a picture.
    pub slices: Slices,
}

impl Window {
    /// All of a picture.
    pub fn whole(width: usize, height: usize) -> Window {
        Window::of_size([width, height, 1, 1])
    }

    /// All of a stack.
    pub fn of_size([width, height, depth, length]: [usize; 4]) -> Window {
        Window { x: 0, y: 0, width, height, slices: Slices { first: [0, 0], count: [depth, length] } }
    }

    /// The first pixel along each coordinate.
    pub fn first(self) -> [usize; 4] {
        [self.x, self.y, self.slices.first[0], self.slices.first[1]]
    }

    /// Pixels along each coordinate.
    pub fn size(self) -> [usize; 4] {
        [self.width, self.height, self.slices.count[0], self.slices.count[1]]
    }

    /// The part inside a picture of `width` × `height` pixels; `None` when no pixel is left.
    pub fn clipped(self, width: usize, height: usize) -> Option<Window> {
        self.clipped_to([width, height, 1, 1])
    }

    /// The part inside a stack; `None` when no pixel is left.
    pub fn clipped_to(self, size: [usize; 4]) -> Option<Window> {
        let mut clipped = [0; 4];
        for (axis, clipped) in clipped.iter_mut().enumerate() {
            let (first, count) = (self.first()[axis], self.size()[axis]);
            *clipped = first.saturating_add(count).min(size[axis]).checked_sub(first).filter(|left| *left > 0)?;
        }
        let [width, height, depth, length] = clipped;
        Some(Window { width, height, slices: Slices { count: [depth, length], ..self.slices }, ..self })
    }

    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.size().iter().product()
    }
}
