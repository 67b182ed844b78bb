//! `Mask`: an ellipsoid that a search ignores.

use crate::sight::grey::place_of;

/// The ellipsoid `(x − centre)ᵀ A (x − centre) ≤ 1` inside a box; px of the window.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Mask {
    /// First pixels of the box.
    pub first: [usize; 4],
    /// Pixels of the box along each coordinate.
    pub size: [usize; 4],
    /// Centre.
    pub centre: [f64; 4],
    /// A, px⁻².
    pub extent: [[f64; 4]; 4],
}

impl Mask {
    /// Zeroes the pixels inside.
    pub fn clear(&self, values: &mut [f64], size: [usize; 4]) {
        let count: usize = self.size.iter().product();
        for i in 0..count {
            let within = place_of(i, self.size);
            let place: [usize; 4] = std::array::from_fn(|axis| self.first[axis] + within[axis] as usize);
            let d: [f64; 4] = std::array::from_fn(|axis| place[axis] as f64 - self.centre[axis]);
            let s: f64 = (0..4).flat_map(|i| (0..4).map(move |j| d[i] * self.extent[i][j] * d[j])).sum();
            if s <= 1.0 {
                values[place[0] + size[0] * (place[1] + size[1] * (place[2] + size[2] * place[3]))] = 0.0;
            }
        }
    }
}
