//! Races of alternating contenders.
//!
//! Each round runs every contender once, and a ratio is the median over the rounds, so that disturbances of the
//! machine affect all alike. Wall time of one thread.

use std::hint::black_box;
use std::time::Instant;

/// Rounds of a race.
pub const ROUNDS: usize = 100;

/// One turn: the sums, and the number of pixels.
pub type Turn<'a> = Box<dyn Fn() -> (Vec<f64>, u64) + 'a>;

/// A contender.
pub struct Contender<'a> {
    /// Name in the tables.
    pub name: String,
    /// One pass.
    pub turn: Turn<'a>,
    /// Code size of the function, bytes.
    pub code_bytes: Option<usize>,
}

/// Result of a contender.
#[derive(Clone, Debug)]
pub struct ContenderTime {
    /// Name in the tables.
    pub name: String,
    /// Nanoseconds per pixel: median.
    pub median_ns: f64,
    /// Nanoseconds per pixel: minimum and maximum.
    pub range_ns: [f64; 2],
    /// Time relative to the first contender: median over the rounds.
    pub ratio: f64,
    /// Code size of the function, bytes.
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

/// The median.
fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Runs the race.
pub fn race(contenders: &[Contender<'_>]) -> Vec<ContenderTime> {
    let once = |contender: &Contender| {
        let start = Instant::now();
        let (_, pixels) = black_box((contender.turn)());
        start.elapsed().as_secs_f64() * 1e9 / pixels as f64
    };
    contenders.iter().for_each(|contender| drop((contender.turn)()));
    let rounds: Vec<Vec<f64>> = (0..ROUNDS).map(|_| contenders.iter().map(once).collect()).collect();
    let time_of = |(i, contender): (usize, &Contender)| {
        let all: Vec<f64> = rounds.iter().map(|round| round[i]).collect();
        ContenderTime {
            name: contender.name.clone(),
            range_ns: [all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(0.0, f64::max)],
            median_ns: median(all),
            ratio: median(rounds.iter().map(|round| round[i] / round[0]).collect()),
            code_bytes: contender.code_bytes,
        }
    };
    contenders.iter().enumerate().map(time_of).collect()
}

/// Error scale of each output: F for F, √(F Fuu) for dF/du, √(Fuu Fvv) for Fuv. Outputs are F, n derivatives and the
/// upper triangle of the Hessian, row by row.
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

/// Whether both sums agree within a share of their scales.
fn agree(ours: &[f64], theirs: &[f64], scales: &[f64], share: f64) -> bool {
    let near = |((a, b), scale): ((&f64, &f64), &f64)| (a - b).abs() <= share * scale;
    ours.len() == theirs.len() && scales.len() == ours.len() && ours.iter().zip(theirs).zip(scales).all(near)
}

/// Panics if a contender computes something else; checks that sums 1 % smaller would be detected.
pub fn refuse_wrong(name: &str, ours: &[f64], theirs: &[f64], scales: &[f64], share: f64) {
    assert!(agree(ours, theirs, scales, share), "{name}: {theirs:?} instead of {ours:?}");
    let wrong: Vec<f64> = theirs.iter().map(|sum| sum * 0.99).collect();
    assert!(!agree(ours, &wrong, scales, share), "{name}: a planted fault is not noticed");
}
