//! Logistic regression, and scores of probabilities as classifiers.

use nalgebra::{DMatrix, DVector};

/// ln odds of each example's class: `prior + weights · numbers`.
#[derive(Clone, Debug)]
pub struct Logistic {
    /// One weight per feature.
    pub weights: Vec<f64>,
    /// ln odds where all features are 0.
    pub prior: f64,
}

/// Ridge penalty: a Gaussian prior with standard deviation 1 on the weight of each standardised feature.
const RIDGE: f64 = 1.0;
/// Newton iterations.
const STEPS: usize = 50;
/// Clamp of ln odds.
const MOST: f64 = 30.0;

/// A training example.
#[derive(Clone, Debug)]
pub struct TrainingExample {
    /// Its features.
    pub numbers: Vec<f64>,
    /// ln odds of an alternative outside the regression, against the example.
    pub beside: f64,
    /// Its class.
    pub is_right: bool,
}

impl Logistic {
    /// The maximum-likelihood fit, with ridge penalty.
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
                // dp/d(log odds); Fisher scoring uses the expected curvature.
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

    /// The probability of an example.
    pub fn probability(&self, numbers: &[f64], beside: f64) -> f64 {
        let sum: f64 = self.weights.iter().zip(numbers).map(|(weight, number)| weight * number).sum();
        probability(self.prior + sum, beside)
    }
}

/// Probability of a class against others by log odds, and against another alternative with log odds `beside`.
fn probability(log_odds: f64, beside: f64) -> f64 {
    1.0 / (1.0 + (-log_odds.clamp(-MOST, MOST)).exp() + beside.min(MOST).exp())
}

/// Area under the ROC curve: the probability that a right example scores higher than a wrong one.
pub fn area_under_curve(predictions: &[(f64, bool)]) -> f64 {
    let mut sorted = predictions.to_vec();
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

/// Mean −ln of the probability of the actual class.
pub fn log_loss(predictions: &[(f64, bool)]) -> f64 {
    let own = |(p, is_right): &(f64, bool)| {
        let p = p.clamp(0.001, 0.999);
        -(if *is_right { p } else { 1.0 - p }).ln()
    };
    predictions.iter().map(own).sum::<f64>() / predictions.len() as f64
}

/// Share of wrong examples accepted at that recall of right ones.
pub fn wrong_at(predictions: &[(f64, bool)], recall: f64) -> f64 {
    let of = |wanted: bool| {
        let mut all: Vec<f64> = predictions.iter().filter(|(_, is)| *is == wanted).map(|(p, _)| *p).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let (right, wrong) = (of(true), of(false));
    let place = ((1.0 - recall) * right.len() as f64).floor() as usize;
    let Some(least) = right.get(place) else { return 0.0 };
    wrong.iter().filter(|p| *p >= least).count() as f64 / wrong.len().max(1) as f64
}

/// A decile of examples by probability.
#[derive(Clone, Copy, Debug)]
pub struct Class {
    count: f64,
    /// The mean probability.
    mean: f64,
    /// The share that is right.
    right: f64,
    /// Variance of the sum, if probabilities are calibrated.
    variance: f64,
}

impl Class {
    /// The mean probability, and the share that is right.
    pub fn point(&self) -> [f64; 2] {
        [self.mean, self.right]
    }
}

/// Deciles of examples.
pub fn classes(predictions: &[(f64, bool)]) -> Vec<Class> {
    let mut sorted = predictions.to_vec();
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

/// Calibration error: mean difference of probability and frequency over the deciles, less the expected deviation of
/// calibrated probabilities (the mean magnitude of a normal variable).
pub fn gap(predictions: &[(f64, bool)]) -> f64 {
    let chance = |class: &Class| (class.variance / std::f64::consts::FRAC_PI_2).sqrt() / class.count;
    let classes = classes(predictions);
    let off = classes.iter().map(|class| (class.mean - class.right).abs() - chance(class));
    off.sum::<f64>() / classes.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regressions_are_recovered_and_scored() {
        // Half of the examples compete with noise in one of three cases.
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
        let predictions: Vec<(f64, bool)> =
            examples.iter().map(|one| (line.probability(&one.numbers, one.beside), one.is_right)).collect();
        assert!((0.8..0.95).contains(&area_under_curve(&predictions)), "{}", area_under_curve(&predictions));
        assert!(gap(&predictions) < 0.01, "{}", gap(&predictions));
        let bolder: Vec<(f64, bool)> = predictions.iter().map(|(p, is)| (p.sqrt(), *is)).collect();
        assert!(gap(&bolder) > 0.1, "{}", gap(&bolder));
        assert!(area_under_curve(&[(0.1, false), (0.9, true)]) == 1.0 && wrong_at(&predictions, 1.0) > 0.9);
    }
}
