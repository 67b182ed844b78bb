//! The radial profile of a fitted spot along s, and the weight of each contour in the fit.

use isophote_symbolic::{Model, Roles, Sample};

/// Largest s of a profile; the shipped models' domains end here.
pub(crate) const REACH: f64 = 2.2;
/// End of the fine part of the table, s.
const FINE_REACH: f64 = 1.25;
/// Step of the fine part.
const FINE: f64 = 0.0125;
/// Step of the coarse part.
const COARSE: f64 = 0.05;
/// Cells of the fine part.
const FINE_CELLS: usize = 100;
/// Cells of the coarse part.
const COARSE_CELLS: usize = 20;

/// Pixel value and weight by s.
///
/// A pixel with several observed values, e.g. one per channel, has a layer for each. All layers have the same contours
/// at different heights: the highest represents all, with the total weight `Σ (height / highest)² / variance`.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    /// The highest first.
    layers: Vec<Layer>,
}

/// One value of a pixel.
#[derive(Clone, Debug)]
struct Layer {
    values: Vec<f64>,
    weights: Vec<f64>,
    /// Its height over that of the highest.
    share: f64,
    /// s where the profile leaves saturation, if it does.
    clipped_to: Option<f64>,
}

impl Profile {
    /// Samples the model's formulas along the x axis of the spot with these roles, all other spots dark. Pixels at or
    /// above `saturation` are excluded. `None` when the model has no such shape or is not finite.
    pub fn of(model: &Model, roles: &Roles, parameters: &[f64], constants: &[f64], saturation: f64) -> Option<Profile> {
        let (&[x, y], &[a1, ..]) = (&roles.centre[..], &roles.shape[..]) else { return None };
        let mut alone = parameters.to_vec();
        for other in model.roles().iter().filter(|other| other.brightness != roles.brightness) {
            if let Some(brightness) = other.brightness {
                alone[brightness.index()] = 0.0;
            }
        }
        let at = |id: isophote_symbolic::ParameterId| alone[id.index()];
        let (centre, stretch) = ([at(x), at(y)], at(a1).sqrt().recip());
        let places: Vec<Vec<f64>> =
            (0..=FINE_CELLS + COARSE_CELLS).map(|i| vec![centre[0] + stretch * place(i).sqrt(), centre[1]]).collect();
        let samples = model.samples(&places, &alone, constants);
        let mut layers: Vec<Layer> =
            (0..model.entries()).map(|entry| Layer::of(&samples, entry, saturation)).collect::<Option<_>>()?;
        layers.sort_by(|a, b| b.height().abs().total_cmp(&a.height().abs()));
        let highest = layers.first()?.height();
        layers.iter_mut().for_each(|layer| layer.share = if highest == 0.0 { 1.0 } else { layer.height() / highest });
        Some(Profile { layers })
    }

    /// Pixel value at s, and its slope.
    pub fn at(&self, s: f64) -> (f64, f64) {
        let (cell, share, step) = cell(s);
        let values = &self.layers[0].values;
        let (a, b) = (values[cell], values[cell + 1]);
        (a + share * (b - a), (b - a) / step)
    }

    /// Weight of a pixel at s: 1 / variance; 0 when excluded.
    pub fn weight(&self, s: f64) -> f64 {
        self.layers.iter().map(|layer| layer.share.powi(2) * layer.weight(s)).sum()
    }

    /// s where each layer leaves saturation.
    pub fn clipped_to(&self) -> impl Iterator<Item = f64> + '_ {
        self.layers.iter().filter_map(|layer| layer.clipped_to)
    }
}

impl Layer {
    fn of(samples: &[Sample], entry: usize, saturation: f64) -> Option<Layer> {
        let values: Vec<f64> = samples.iter().map(|sample| sample.entries[entry].0).collect();
        let weight = |sample: &Sample| match sample.entries[entry] {
            (intensity, _) if !sample.inside || intensity >= saturation => 0.0,
            (_, Some(variance)) if variance > 0.0 => variance.recip(),
            (_, Some(_)) => 0.0,
            (_, None) => 1.0,
        };
        let weights: Vec<f64> = samples.iter().map(weight).collect();
        if !values.iter().chain(&weights).all(|v| v.is_finite()) {
            return None;
        }
        let first_kept = values.iter().position(|value| *value < saturation).filter(|first| *first > 0);
        let clipped_to = first_kept.map(|first| {
            let (above, below) = (values[first - 1], values[first]);
            place(first - 1) + (place(first) - place(first - 1)) * (above - saturation) / (above - below)
        });
        Some(Layer { values, weights, share: 1.0, clipped_to })
    }

    /// Over the background.
    fn height(&self) -> f64 {
        self.values[0] - self.values[FINE_CELLS + COARSE_CELLS]
    }

    fn weight(&self, s: f64) -> f64 {
        let (cell, share, _) = cell(s);
        let (a, b) = (self.weights[cell], self.weights[cell + 1]);
        match self.clipped_to {
            Some(edge) if s < edge => 0.0,
            // No interpolation between an included and an excluded pixel.
            _ if a == 0.0 || b == 0.0 => a.max(b),
            _ => a + share * (b - a),
        }
    }
}

/// s of a table entry.
fn place(i: usize) -> f64 {
    if i <= FINE_CELLS { FINE * i as f64 } else { FINE_REACH + COARSE * (i - FINE_CELLS) as f64 }
}

/// The cell around s, how far into it, and its width; beyond the table its last cell.
fn cell(s: f64) -> (usize, f64, f64) {
    let (first, step, at) =
        if s < FINE_REACH { (0, FINE, s.max(0.0) / FINE) } else { (FINE_CELLS, COARSE, (s - FINE_REACH) / COARSE) };
    let whole = (at as usize).min(FINE_CELLS + COARSE_CELLS - 1 - first);
    (first + whole, (at - whole as f64).min(1.0), step)
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// The thesis' cubic with k1 = −1.5, k2 = 0, over a background of 20, with noise of 19.6 electrons a pixel value.
    pub fn cubic(brightness: f64, saturation: f64) -> Profile {
        let text = "name = \"s\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\nbx = { start = 0.0 }\n\
            by = { start = 0.0 }\na1 = { start = 1.0 }\na2 = { start = 0.0 }\na3 = { start = 1.0 }\nv1 = { start = 100.0 }\n\
            [roles]\ncentre = [\"bx\", \"by\"]\nshape = [\"a1\", \"a2\", \"a3\"]\nbrightness = \"v1\"\n[definitions]\n\
            s = \"a1*(x-bx)^2 + 2*a2*(x-bx)*(y-by) + a3*(y-by)^2\"\n[model]\n\
            intensity = \"20 + v1 * if(s <= 1, 1 - 1.5*s + 0.5*s^3, 0)\"\ndomain = \"s <= 2.21\"\n\
            noise = \"0.58 + 0.051 * intensity\"\n";
        let model = Model::from_toml(text).unwrap();
        let parameters = [3.0, 4.0, 0.01, 0.0, 0.02, brightness];
        Profile::of(&model, &model.roles()[0], &parameters, &[], saturation).unwrap()
    }

    impl Profile {
        /// Every pixel alike.
        pub fn flatten(&mut self) {
            self.layers[0].weights.fill(1.0);
        }
    }

    #[test]
    fn a_table_of_the_formula() {
        let profile = cubic(100.0, f64::INFINITY);
        for s in [0.0, 0.33, 0.99, 1.0, 1.1, 1.7, 2.2, 5.0] {
            let exact = if s < 1.0 { 20.0 + 100.0 * (1.0 - 1.5 * s + 0.5 * s * s * s) } else { 20.0 };
            assert!((profile.at(s).0 - exact).abs() < 0.01, "{s}: {} is not {exact}", profile.at(s).0);
            assert!((profile.weight(s) - 1.0 / (0.58 + 0.051 * exact)).abs() < 1e-3);
        }
        assert!((profile.at(0.505).1 + 150.0 * (1.0 - 0.505_f64.powi(2))).abs() < 1.0);
        assert_eq!(profile.clipped_to().next(), None);
    }

    #[test]
    fn saturated_contours_weigh_nothing() {
        let profile = cubic(400.0, 255.0);
        let edge = profile.clipped_to().next().unwrap();
        assert!((profile.at(edge).0 - 255.0).abs() < 0.1);
        assert_eq!(profile.weight(edge - 1e-3), 0.0);
        assert!((profile.weight(edge + 1e-3) - 1.0 / (0.58 + 0.051 * 255.0)).abs() < 1e-3);
    }

    /// Each channel of a camera that mixes colours shows a spot at its own height, and clips for itself.
    #[test]
    fn channels_weigh_by_their_unsaturated_light() {
        let model = Model::from_toml(include_str!("../../../models/three-spots-raw.toml")).unwrap();
        let at = |name: &str| model.parameter(name).unwrap().index();
        let mut parameters = vec![0.0; model.parameters().len()];
        for name in ["r", "g", "b"] {
            (parameters[at(&format!("{name}1"))], parameters[at(&format!("{name}3"))]) = (0.01, 0.01);
            (parameters[at(&format!("v{name}"))], parameters[at(&format!("v0{name}"))]) = (400.0, 20.0);
        }
        let constants: Vec<f64> = model.constants().iter().map(|constant| constant.value).collect();
        // The second spot: green reads all of it, red 12 % and blue 8 %.
        let profile = Profile::of(&model, &model.roles()[1], &parameters, &constants, 255.0).unwrap();
        let variance = |intensity: f64| 0.765_f64.powi(2) + 1.0 / 12.0 + 0.051 * intensity;
        let light = |s: f64| 400.0 * (1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s);
        assert!((profile.at(0.3).0 - 20.0 - light(0.3)).abs() < 4.0, "{}", profile.at(0.3).0);
        let [edge] = profile.clipped_to().collect::<Vec<f64>>()[..] else { panic!("green clips") };
        let dim = |s: f64| [0.12, 0.08].map(|m: f64| m * m / variance(20.0 + m * light(s))).iter().sum::<f64>();
        let near = |is: f64, should: f64| assert!((is / should - 1.0).abs() < 0.03, "{is} is not {should}");
        near(profile.weight(edge - 0.1), dim(edge - 0.1));
        near(profile.weight(edge + 0.1), dim(edge + 0.1) + 1.0 / variance(20.0 + light(edge + 0.1)));
    }
}
