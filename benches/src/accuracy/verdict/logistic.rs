//! A logistic line through examples, and how well probabilities tell right from wrong.
//!
//! What comes in: numbers and whether each example is right. What goes out: weights, and scores. It never knows a picture.

use nalgebra::{DMatrix, DVector};

/// ln odds of each example's class: `prior + weights · numbers`.
#[derive(Clone, Debug)]
pub struct Logistic {
    /// One a number.
    pub weights: Vec<f64>,
    /// Where all numbers are 0.
    pub prior: f64,
}

/// Weights of numbers of variance 1 are this much drawn to 0: a standard deviation of 1 for each.
const RIDGE: f64 = 1.0;
/// Newton's steps.
const STEPS: usize = 50;
/// Larger logarithms of odds say no more.
const MOST: f64 = 30.0;

/// An example to learn from.
#[derive(Clone, Debug)]
pub struct TrainingExample {
    /// Its features.
    pub numbers: Vec<f64>,
    /// ln odds, against the example, of what the line says nothing of.
    pub beside: f64,
    /// Its class.
    pub is_right: bool,
}

impl Logistic {
    /// The likeliest.
    pub fn fit(examples: &[TrainingExample]) -> Logistic {
        let count = examples[0].numbers.len();
        let mean = |of: &dyn Fn(&Vec<f64>) -> f64| {
            examples.iter().map(|example| of(&example.numbers)).sum::<f64>() / examples.len() as f64
        };
        let scales: Vec<f64> = (0..count)
            .map(|i| {
                let middle = mean(&|numbers| numbers[i]);
                mean(&|numbers| (numbers[i] - middle).powi(2)).sqrt().max(1e-9)
            })
            .collect();
        let row = |numbers: &[f64]| {
            DVector::from_fn(count + 1, |i, _| if i == 0 { 1.0 } else { numbers[i - 1] / scales[i - 1] })
        };
        let mut weights = DVector::zeros(count + 1);
        for _ in 0..STEPS {
            let ridge = |i: usize| if i == 0 { 0.0 } else { RIDGE };
            let mut gradient = DVector::from_fn(count + 1, |i, _| ridge(i) * weights[i]);
            let mut hessian = DMatrix::from_diagonal(&DVector::from_fn(count + 1, |i, _| ridge(i) + 1e-9));
            for TrainingExample { numbers, beside, is_right } in examples {
                let row = row(numbers);
                let p = probability(row.dot(&weights), *beside);
                // By how much p changes with the log odds; scoring takes the expected curvature.
                let slope = p * (1.0 - p * (1.0 + beside.min(MOST).exp()));
                let spread = (p * (1.0 - p)).max(1e-12);
                gradient += &row * ((p - f64::from(u8::from(*is_right))) * slope / spread);
                hessian += &row * row.transpose() * (slope * slope / spread);
            }
            let Some(step) = hessian.cholesky().map(|factors| factors.solve(&gradient)) else { break };
            weights -= &step;
            if step.norm() < 1e-9 {
                break;
            }
        }
        let scaled = (0..count).map(|i| weights[i + 1] / scales[i]).collect();
        Logistic { weights: scaled, prior: weights[0] }
    }

    /// Of an example.
    pub fn probability(&self, numbers: &[f64], beside: f64) -> f64 {
        let sum: f64 = self.weights.iter().zip(numbers).map(|(weight, number)| weight * number).sum();
        probability(self.prior + sum, beside)
    }
}

/// Of a class against one kind of others by these log odds, and against another kind whose odds have the logarithm `beside`.
fn probability(log_odds: f64, beside: f64) -> f64 {
    1.0 / (1.0 + (-log_odds.clamp(-MOST, MOST)).exp() + beside.min(MOST).exp())
}

/// The probability that a right example is said to be likelier than a wrong one.
pub fn area_under_curve(told: &[(f64, bool)]) -> f64 {
    let mut sorted = told.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut below, mut wins, mut rights) = (0.0, 0.0, 0.0);
    for alike in sorted.chunk_by(|a, b| a.0 == b.0) {
        let right = alike.iter().filter(|(_, is_right)| *is_right).count() as f64;
        let wrong = alike.len() as f64 - right;
        wins += right * (below + 0.5 * wrong);
        (below, rights) = (below + wrong, rights + right);
    }
    wins / (rights * below)
}

/// −ln of the probability of what is so, the mean.
pub fn log_loss(told: &[(f64, bool)]) -> f64 {
    let own = |(p, is_right): &(f64, bool)| {
        let p = p.clamp(0.001, 0.999);
        -(if *is_right { p } else { 1.0 - p }).ln()
    };
    told.iter().map(own).sum::<f64>() / told.len() as f64
}

/// The share of wrong examples that are taken where so large a share of the right ones is.
pub fn wrong_at(told: &[(f64, bool)], recall: f64) -> f64 {
    let of = |wanted: bool| {
        let mut all: Vec<f64> = told.iter().filter(|(_, is)| *is == wanted).map(|(p, _)| *p).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let (right, wrong) = (of(true), of(false));
    let place = ((1.0 - recall) * right.len() as f64).floor() as usize;
    let Some(least) = right.get(place) else { return 0.0 };
    wrong.iter().filter(|p| *p >= least).count() as f64 / wrong.len().max(1) as f64
}

/// A tenth of what was told, by its probability.
#[derive(Clone, Copy, Debug)]
pub struct Class {
    count: f64,
    /// The mean probability.
    mean: f64,
    /// The share that is right.
    right: f64,
    /// Of the sum, where probabilities are right.
    variance: f64,
}

impl Class {
    /// The mean probability, and the share that is right.
    pub fn point(&self) -> [f64; 2] {
        [self.mean, self.right]
    }
}

/// Ten classes of equally many.
pub fn classes(told: &[(f64, bool)]) -> Vec<Class> {
    let mut sorted = told.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let class = |class: &[(f64, bool)]| {
        let count = class.len() as f64;
        Class {
            count,
            mean: class.iter().map(|(p, _)| p).sum::<f64>() / count,
            right: class.iter().filter(|(_, is_right)| *is_right).count() as f64 / count,
            variance: class.iter().map(|(p, _)| p * (1.0 - p)).sum(),
        }
    };
    sorted.chunks(sorted.len().div_ceil(10).max(1)).map(class).collect()
}

/// By how much probabilities differ from what is so, the mean over the classes, beyond what chance makes of probabilities that are
/// right: the mean magnitude of a normal variable.
pub fn gap(told: &[(f64, bool)]) -> f64 {
    let chance = |class: &Class| (class.variance / std::f64::consts::FRAC_PI_2).sqrt() / class.count;
    let classes = classes(told);
    let off = classes.iter().map(|class| (class.mean - class.right).abs() - chance(class));
    off.sum::<f64>() / classes.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_again_and_scored() {
        // Half of the examples are noise in one of three cases.
        let beside = [f64::NEG_INFINITY, 0.5_f64.ln()];
        let examples: Vec<TrainingExample> = (0..4000)
            .map(|i| {
                let x = f64::from(i % 100) / 25.0 - 2.0;
                let beside = beside[(i / 100) as usize % 2];
                let share = probability(1.5 * x - 0.5, beside);
                TrainingExample { numbers: vec![x], beside, is_right: f64::from(i / 200) + 0.5 < 20.0 * share }
            })
            .collect();
        let line = Logistic::fit(&examples);
        assert!((line.weights[0] - 1.5).abs() < 0.1 && (line.prior + 0.5).abs() < 0.1, "{line:?}");
        let told: Vec<(f64, bool)> =
            examples.iter().map(|one| (line.probability(&one.numbers, one.beside), one.is_right)).collect();
        assert!((0.8..0.95).contains(&area_under_curve(&told)), "{}", area_under_curve(&told));
        assert!(gap(&told) < 0.01, "{}", gap(&told));
        let bolder: Vec<(f64, bool)> = told.iter().map(|(p, is)| (p.sqrt(), *is)).collect();
        assert!(gap(&bolder) > 0.1, "{}", gap(&bolder));
        assert!(area_under_curve(&[(0.1, false), (0.9, true)]) == 1.0 && wrong_at(&told, 1.0) > 0.9);
    }
}
