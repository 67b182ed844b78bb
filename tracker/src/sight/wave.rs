//! The strongest wave of a window, by frequency, direction and phase, for documents with `spectrum.frequency`,
//! `spectrum.angle` or `spectrum.phase`.
//!
//! The window is weighted by Hann's function, whose lines are three entries wide, so that the two largest entries of a line
//! give its position between them.

use std::f64::consts::{PI, TAU};

use isophote_symbolic::{Estimator, Model, Start};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use crate::sight::grey::Grey;
use crate::statistics::median;

/// Most pixels per side, from the centre.
const SIDE_MAX: usize = 512;
/// Least distance of a line from the mean, in entries: the mean's own line is as wide.
const ENTRY_MIN: usize = 2;
/// Largest share of windows in which noise alone may be taken for a wave.
const FALSE_ALARMS: f64 = 0.01;
/// Waves below this share of the mean are rounding.
const ROUNDING: f64 = 1e-9;

/// `mean + amplitude · cos(2π frequency · x + phase)`, x in px of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wave {
    /// Cycles per pixel, by axis.
    frequency: [f64; 2],
    /// At the window's first pixel, rad.
    phase: f64,
    amplitude: f64,
    mean: f64,
}

/// Fills `given` from the wave for the parameters that estimate it; `None` where one is needed and there is none. If no
/// parameter estimates a position or a size, background and amplitude are the wave's, too. A pixel of `grey` is `step`
/// pixels of the frame wide; `origin` is its first corner in the frame.
pub(crate) fn given_by_wave(
    model: &Model,
    given: &[Option<f64>],
    grey: &Grey,
    step: f64,
    origin: [f64; 4],
) -> Option<Vec<Option<f64>>> {
    let asked = |estimator: Option<Estimator>| {
        matches!(estimator, Some(Estimator::Frequency | Estimator::Direction | Estimator::Phase))
    };
    let level =
        |estimator: Option<Estimator>| matches!(estimator, None | Some(Estimator::Background | Estimator::Amplitude));
    let wanted = |(parameter, given): (&isophote_symbolic::Parameter, &Option<f64>)| match parameter.start {
        Start::Estimator(estimator) if given.is_none() => Some(estimator),
        _ => None,
    };
    let wanted: Vec<Option<Estimator>> = model.parameters().iter().zip(given).map(wanted).collect();
    if !wanted.iter().any(|estimator| asked(*estimator)) {
        return Some(given.to_vec());
    }
    let wave = Wave::strongest(grey)?;
    let frequency = wave.frequency.map(|frequency| frequency / step);
    let middle = [0, 1].map(|axis| origin[axis] + 0.5 * (step - 1.0)); // of the first pixel
    let is_alone = wanted.iter().all(|estimator| asked(*estimator) || level(*estimator));
    let value = |(given, estimator): (&Option<f64>, &Option<Estimator>)| match estimator {
        Some(Estimator::Frequency) => Some(frequency[0].hypot(frequency[1])),
        Some(Estimator::Direction) => Some(frequency[1].atan2(frequency[0])),
        Some(Estimator::Phase) => {
            Some(wrapped(wave.phase - TAU * (frequency[0] * middle[0] + frequency[1] * middle[1])))
        }
        Some(Estimator::Background) if is_alone => Some(wave.mean),
        Some(Estimator::Amplitude) if is_alone => Some(wave.amplitude),
        _ => *given,
    };
    Some(given.iter().zip(&wanted).map(value).collect())
}

impl Wave {
    /// `None` where nothing exceeds the spectrum's noise. Uses the first slice of a stack.
    fn strongest(grey: &Grey) -> Option<Wave> {
        let size = [0, 1].map(|axis| grey.size[axis].min(SIDE_MAX));
        let first = [0, 1].map(|axis| (grey.size[axis] - size[axis]) / 2);
        let weights = size.map(hann);
        let at = |x: usize, y: usize| grey.values[(y + first[1]) * grey.size[0] + x + first[0]];
        let pixels = || (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
        let weight = |x: usize, y: usize| weights[0][x] * weights[1][y];
        let total: f64 = pixels().map(|(x, y)| weight(x, y)).sum();
        let mean = pixels().map(|(x, y)| weight(x, y) * at(x, y)).sum::<f64>() / total;
        let weighted = pixels().map(|(x, y)| Complex::from(weight(x, y) * (at(x, y) - mean))).collect();
        let spectrum = Spectrum::of(weighted, size);
        let line = spectrum.line()?;
        let frequency = [0, 1].map(|axis| spectrum.line_position(line, axis) / size[axis] as f64);
        // Half of the plane suffices: a wave running backwards equals one running forwards with the opposite phase.
        let frequency = if frequency < [0.0, 0.0] { frequency.map(|f| -f) } else { frequency };
        let turn = |x: usize, y: usize| {
            let position = [x + first[0], y + first[1]].map(|at| at as f64);
            Complex::cis(-TAU * (frequency[0] * position[0] + frequency[1] * position[1]))
        };
        let sum: Complex<f64> = pixels().map(|(x, y)| turn(x, y) * (weight(x, y) * (at(x, y) - mean))).sum();
        let wave = Wave { frequency, phase: sum.arg(), amplitude: 2.0 * sum.norm() / total, mean };
        (wave.amplitude > ROUNDING * mean.abs()).then_some(wave)
    }
}

/// The spectrum of a weighted window.
struct Spectrum {
    entries: Vec<Complex<f64>>,
    size: [usize; 2],
}

impl Spectrum {
    fn of(mut values: Vec<Complex<f64>>, size: [usize; 2]) -> Spectrum {
        let mut planner = FftPlanner::new();
        planner.plan_fft_forward(size[0]).process(&mut values);
        let mut column = vec![Complex::default(); size[1]];
        let along_columns = planner.plan_fft_forward(size[1]);
        for x in 0..size[0] {
            column.iter_mut().enumerate().for_each(|(y, entry)| *entry = values[y * size[0] + x]);
            along_columns.process(&mut column);
            column.iter().enumerate().for_each(|(y, entry)| values[y * size[0] + x] = *entry);
        }
        Spectrum { entries: values, size }
    }

    /// The largest entry away from the mean, if significant.
    fn line(&self) -> Option<[usize; 2]> {
        let [width, height] = self.size;
        let away = |index: usize, size: usize| index.min(size - index) >= ENTRY_MIN;
        let bins = (0..height).flat_map(|y| (0..=width / 2).map(move |x| [x, y]));
        let bins: Vec<[usize; 2]> = bins.filter(|[x, y]| away(*x, width) || away(*y, height)).collect();
        let power = |bin: &[usize; 2]| self.entries[bin[1] * width + bin[0]].norm_sqr();
        let line = bins.iter().copied().max_by(|a, b| power(a).total_cmp(&power(b)))?;
        // Powers of white noise are exponentially distributed; lines do not affect the median.
        let mut powers: Vec<f64> = bins.iter().map(power).collect();
        let noise = median(&mut powers)? / std::f64::consts::LN_2;
        (power(&line) > noise * (bins.len() as f64 / FALSE_ALARMS).ln()).then_some(line)
    }

    /// Position of a line along an axis, in entries, negative in the upper half: from the ratio of the two largest entries,
    /// for a pure wave under Hann's weights.
    fn line_position(&self, line: [usize; 2], axis: usize) -> f64 {
        let size = self.size[axis];
        let entry = |index: usize| {
            let mut bin = line;
            bin[axis] = index % size;
            self.entries[bin[1] * self.size[0] + bin[0]].norm()
        };
        let index = line[axis];
        let (before, after) = (entry(index + size - 1), entry(index + 1));
        let ratio = before.max(after) / entry(index);
        let shift = if size < 4 { 0.0 } else { ((2.0 * ratio - 1.0) / (ratio + 1.0)).copysign(after - before) };
        let signed = if 2 * index > size { index as f64 - size as f64 } else { index as f64 };
        signed + shift
    }
}

/// Hann's weights; 1 for a single pixel.
fn hann(count: usize) -> Vec<f64> {
    let weight = |i: usize| (PI * (i as f64 + 0.5) / count as f64).sin().powi(2);
    if count == 1 { vec![1.0] } else { (0..count).map(weight).collect() }
}

/// Wraps an angle to −π … π.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::picture::Noise;

    fn grey(size: [usize; 2], value: impl Fn(f64, f64) -> f64) -> Grey {
        let values = (0..size[0] * size[1]).map(|i| value((i % size[0]) as f64, (i / size[0]) as f64)).collect();
        Grey { values, size: [size[0], size[1], 1, 1], saturation: 255.0, step: 1.0 }
    }

    #[test]
    fn waves_of_all_directions_are_found() {
        let mut noise = Noise(3);
        for (fx, fy, phase) in [(0.08, 0.0, 1.0), (0.0131, 0.052, -2.0), (0.11, -0.24, 0.3), (0.0, 0.31, 3.0)] {
            for size in [[160, 120], [63, 201], [700, 40]] {
                let seen = grey(size, |x, y| 90.0 + 30.0 * (TAU * (fx * x + fy * y) + phase).cos());
                let values = seen.values.iter().map(|value| value + 10.0 * noise.normal()).collect();
                let mut wave = Wave::strongest(&Grey { values, ..seen }).unwrap();
                if wave.frequency[0] * fx + wave.frequency[1] * fy < 0.0 {
                    (wave.frequency, wave.phase) = (wave.frequency.map(|f| -f), -wave.phase); // the same wave
                }
                // In entries of the spectrum: 0.1 corresponds to a phase of 0.3 rad over half the window.
                let off = [(fx, 0), (fy, 1)].map(|(f, axis)| (wave.frequency[axis] - f) * size[axis].min(512) as f64);
                assert!(off.iter().all(|off| off.abs() < 0.1), "{size:?} {fx} {fy}: {off:?}");
                assert!((wave.mean - 90.0).abs() < 2.0 && (wave.amplitude - 30.0).abs() < 3.0, "{wave:?}");
                let done = [0, 1].map(|axis| size[axis] as f64 / 2.0);
                let at = |f: [f64; 2], phase: f64| TAU * (f[0] * done[0] + f[1] * done[1]) + phase;
                let error = wrapped(at(wave.frequency, wave.phase) - at([fx, fy], phase));
                assert!(error.abs() < 0.1, "{size:?} {fx} {fy}: {error} rad in the middle");
            }
        }
    }

    #[test]
    fn noise_is_no_wave() {
        let mut noise = Noise(5);
        let found = (0..50).filter(|_| {
            let flat = grey([64, 48], |_, _| 20.0);
            let values = flat.values.iter().map(|value| value + 3.0 * noise.normal()).collect();
            Wave::strongest(&Grey { values, ..flat }).is_some()
        });
        assert!(found.count() <= 3);
        assert_eq!(Wave::strongest(&grey([64, 48], |_, _| 20.0)), None);
    }
}
