//! Connected components: the pixels above a level that hang together.

/// A component, as indices of its pixels.
#[derive(Clone, Debug)]
pub(crate) struct Component {
    /// Indices into the image, row by row.
    pub pixels: Vec<usize>,
    /// The sum of its pixel values.
    pub mass: f64,
    /// Its largest pixel value.
    pub peak: f64,
}

/// Which pixels already belong to a component.
pub(crate) struct Labels<'a> {
    values: &'a [f64],
    width: usize,
    seen: Vec<bool>,
}

impl<'a> Labels<'a> {
    /// No pixel belongs to anything yet.
    pub fn new(values: &'a [f64], width: usize) -> Labels<'a> {
        Labels { values, width, seen: vec![false; values.len()] }
    }

    /// All components above `level`, of at least `pixels_min` pixels (4-connected), the most massive first.
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

    /// Everything above `level` that hangs together with `seeds`.
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
            let x = pixel % self.width;
            let neighbours = [
                (x > 0).then(|| pixel - 1),
                (x + 1 < self.width).then_some(pixel + 1),
                pixel.checked_sub(self.width),
                Some(pixel + self.width).filter(|&next| next < self.values.len()),
            ];
            for next in neighbours.into_iter().flatten() {
                if !self.seen[next] && self.values[next] > level {
                    self.seen[next] = true;
                    waiting.push(next);
                }
            }
        }
        component
    }
}
