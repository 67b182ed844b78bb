//! Connected components: adjacent pixels above a level.

/// A connected component.
#[derive(Clone, Debug)]
pub(crate) struct Component {
    /// Indices into the image, row by row, slice by slice.
    pub pixels: Vec<usize>,
    /// The sum of its pixel values.
    pub mass: f64,
    /// Its largest pixel value.
    pub peak: f64,
}

/// The pixels already assigned to a component.
pub(crate) struct Labels<'a> {
    values: &'a [f64],
    size: [usize; 4],
    seen: Vec<bool>,
}

impl<'a> Labels<'a> {
    /// Starts without components.
    pub fn new(values: &'a [f64], size: [usize; 4]) -> Labels<'a> {
        Labels { values, size, seen: vec![false; values.len()] }
    }

    /// All components above `level`, of at least `pixels_min` pixels that share a side, the most massive first.
    pub fn above(mut self, level: f64, pixels_min: usize) -> Vec<Component> {
        let mut components = Vec::new();
        for start in 0..self.values.len() {
            if !self.seen[start] && self.values[start] > level {
                let component = self.grow(vec![start], level);
                if component.pixels.len() >= pixels_min {
                    components.push(component);
                }
            }
        }
        components.sort_by(|a, b| b.mass.total_cmp(&a.mass));
        components
    }

    /// The pixels above `level` connected to `seeds`.
    pub fn grow(&mut self, seeds: Vec<usize>, level: f64) -> Component {
        let mut waiting = seeds;
        for &seed in &waiting {
            self.seen[seed] = true;
        }
        let mut component = Component { pixels: Vec::new(), mass: 0.0, peak: f64::NEG_INFINITY };
        while let Some(pixel) = waiting.pop() {
            component.pixels.push(pixel);
            component.mass += self.values[pixel];
            component.peak = component.peak.max(self.values[pixel]);
            let mut stride = 1;
            for side in self.size {
                // Coordinates along this axis repeat every `stride * side` pixels.
                let (at, last) = (pixel / stride % side, side - 1);
                let before = (at > 0).then(|| pixel - stride);
                let after = (at < last).then(|| pixel + stride);
                for next in before.into_iter().chain(after) {
                    if !self.seen[next] && self.values[next] > level {
                        self.seen[next] = true;
                        waiting.push(next);
                    }
                }
                stride *= side;
                if stride == self.values.len() {
                    break;
                }
            }
        }
        component
    }
}
