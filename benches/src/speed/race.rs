//! Contenders that take turns.
//!
//! Each round runs every contender once, and a ratio is the median of the ratios of the rounds, so that what disturbs the
//! machine for a while disturbs all of them. Wall time of one thread.

use std::hint::black_box;
use std::time::Instant;

/// Rounds of a race.
pub const ROUNDS: usize = 100;

/// One turn: the sums, and how many pixels they are of.
pub type Turn<'a> = Box<dyn Fn() -> (Vec<f64>, u64) + 'a>;

/// Who runs.
pub struct Contender<'a> {
    /// For tables.
    pub name: String,
    /// One pass.
    pub turn: Turn<'a>,
    /// Of the function.
    pub code_bytes: Option<usize>,
}

/// How a contender did.
#[derive(Clone, Debug)]
pub struct Standing {
    /// For tables.
    pub name: String,
    /// Nanoseconds a pixel: median.
    pub median_ns: f64,
    /// Nanoseconds a pixel: minimum and maximum.
    pub range_ns: [f64; 2],
    /// How many times the first contender's time: median over the rounds.
    pub ratio: f64,
    /// Of the function.
    pub code_bytes: Option<usize>,
}

/// Several passes as one turn: the sums of the last, the pixels of all.
pub fn repeated(passes: usize, pass: impl Fn() -> (Vec<f64>, u64)) -> (Vec<f64>, u64) {
    let (mut sums, mut pixels) = (Vec::new(), 0);
    for _ in 0..passes {
        let (of_pass, more) = pass();
        (sums, pixels) = (of_pass, pixels + more);
    }
    (sums, pixels)
}

/// The middle one.
fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Runs all.
pub fn race(contenders: &[Contender<'_>]) -> Vec<Standing> {
    let once = |contender: &Contender| {
        let start = Instant::now();
        let (_, pixels) = black_box((contender.turn)());
        start.elapsed().as_secs_f64() * 1e9 / pixels as f64
    };
    contenders.iter().for_each(|contender| drop((contender.turn)()));
    let rounds: Vec<Vec<f64>> = (0..ROUNDS).map(|_| contenders.iter().map(once).collect()).collect();
    let standing = |(i, contender): (usize, &Contender)| {
        let all: Vec<f64> = rounds.iter().map(|round| round[i]).collect();
        Standing {
            name: contender.name.clone(),
            range_ns: [all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(0.0, f64::max)],
            median_ns: median(all),
            ratio: median(rounds.iter().map(|round| round[i] / round[0]).collect()),
            code_bytes: contender.code_bytes,
        }
    };
    contenders.iter().enumerate().map(standing).collect()
}

/// What an error of each output is measured by: of F itself, of dF/du √(F Fuu), of Fuv √(Fuu Fvv). Outputs are F, n
/// derivatives and the upper triangle of the Hessian, row by row.
pub fn scales(outputs: &[f64]) -> Vec<f64> {
    let n = (1..20).find(|n| 1 + n + n * (n + 1) / 2 == outputs.len()).unwrap();
    let mut places = outputs[1 + n..].iter();
    let mut diagonal = Vec::new();
    for i in 0..n {
        diagonal.push(places.next().unwrap().abs());
        places.by_ref().take(n - 1 - i).for_each(drop);
    }
    let value = outputs[0].abs();
    let first = diagonal.iter().map(|d| (d * value).sqrt());
    let second = (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).map(|(i, j)| (diagonal[i] * diagonal[j]).sqrt());
    [value].into_iter().chain(first).chain(second).collect()
}

/// True when both sums say the same, to a share of their scale.
fn agree(ours: &[f64], theirs: &[f64], scales: &[f64], share: f64) -> bool {
    let near = |((a, b), scale): ((&f64, &f64), &f64)| (a - b).abs() <= share * scale;
    ours.len() == theirs.len() && scales.len() == ours.len() && ours.iter().zip(theirs).zip(scales).all(near)
}

/// Stops the benchmark when a contender computes something else; its sums less one part in a hundred are such a thing.
pub fn refuse_wrong(name: &str, ours: &[f64], theirs: &[f64], scales: &[f64], share: f64) {
    assert!(agree(ours, theirs, scales, share), "{name}: {theirs:?} instead of {ours:?}");
    let wrong: Vec<f64> = theirs.iter().map(|sum| sum * 0.99).collect();
    assert!(!agree(ours, &wrong, scales, share), "{name}: a planted fault is not noticed");
}
