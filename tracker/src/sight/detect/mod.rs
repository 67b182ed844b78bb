//! Matched-filter detection of faint targets with the model's own image.
//!
//! 1. The picture is halved again and again, so that a target of any size is a few pixels wide in one of the octaves.
//! 2. The local background, the median over blocks much larger than a target, is subtracted ([`level`]).
//! 3. The rest is correlated with a [`template`], the document's image minus its mean over the disc around it ([`filter`]): the
//!    part that no even background can imitate. Divided by its robust standard deviation over the picture, that is the square root
//!    of twice the log-likelihood ratio of a target against background alone.
//! 4. A detection exceeds the threshold for a given share of frames with false alarms ([`alarm`]). Where the background is
//!    structured, the noise is not normal, and the threshold is higher.

mod alarm;
mod bank;
mod filter;
mod level;
mod peaks;
mod template;

pub(crate) use bank::Bank;

use isophote_symbolic::Model;
use serde::{Deserialize, Serialize};

use crate::budget::{Spend, Stop};
use crate::sight::grey::Grey;
use crate::sight::mask::Mask;
use crate::sight::start::{Detection, Sign};
use alarm::{FalseAlarmThreshold, Thresholds};
use filter::Filter;
use level::{Mended, Octave};
use peaks::{BackgroundKind, Peak, Peaks};
use template::Template;

/// Of two peaks nearer than this, in sizes of the larger one, only the stronger remains, unless it may be the tip of the
/// other.
const APART: f64 = 1.5;

/// Parameters of a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DetectOptions<'a> {
    /// Bright or dark; `None`: both.
    pub sign: Option<Sign>,
    /// Least and greatest half width, px.
    pub sizes_px: [f64; 2],
    /// Regions to ignore.
    pub masks: &'a [Mask],
    /// Largest number of detections.
    pub count_max: usize,
    /// Least response.
    pub threshold: DetectionThreshold,
}

/// The least response to a template.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum DetectionThreshold {
    /// Noise alone exceeds it in this share of frames.
    FalseAlarms(f64),
    /// This many standard deviations of the noise.
    Snr(f64),
}

/// The result of a search.
#[derive(Clone, Debug, Default)]
pub(crate) struct Detections {
    /// Detections as starting values, the strongest first.
    pub all: Vec<Detection>,
    /// The strongest peak, significant or not; absent where nothing could be searched.
    pub strongest: Option<Strength>,
    /// The largest share of the background's variance, over all octaves, that is not noise.
    pub bumps: f64,
}

/// Strength of a response to the document's image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Strength {
    /// Response of the matched filter, in standard deviations of the noise.
    pub score: f64,
    /// Detection threshold of the score; noise alone rarely reaches it.
    pub threshold: f64,
    /// Position, px.
    pub place: [f64; 2],
    /// Half the width, px.
    pub size_px: f64,
}

impl Strength {
    /// The strength with its position in a frame in which the window begins at `origin`.
    pub(crate) fn placed(self, origin: [f64; 4]) -> Strength {
        Strength { place: [self.place[0] + origin[0], self.place[1] + origin[1]], ..self }
    }
}

impl Bank {
    /// Everything significant in a two-dimensional picture of full resolution. Each octave is charged by its pixels, once
    /// for itself and once for each template.
    ///
    /// # Errors
    /// When `spend` ends the search.
    pub fn detect(
        &self,
        model: &Model,
        constants: &[f64],
        grey: &Grey,
        options: &DetectOptions,
        spend: Spend,
    ) -> Result<Detections, Stop> {
        let side = grey.size[0].min(grey.size[1]);
        let templates = self.templates(model, constants, options.sizes_px, side);
        let levels = || templates.iter().map(|template| template.level);
        let (Some(finest), Some(coarsest)) = (levels().min(), levels().max()) else {
            return Ok(Detections::default());
        };
        let signs = if options.sign.is_none() { 2.0 } else { 1.0 };
        let independent_positions =
            templates.iter().map(|template| signs * template.independent_positions(grey.size[0] * grey.size[1])).sum();
        let mut picture = Mended::of(grey, options.masks);
        for _ in 0..finest {
            picture = picture.halved();
        }
        let mut level = Octave::of(picture.clone(), finest);
        let mut peaks = Peaks::default();
        let mut filter = Filter::default();
        let (mut bumps, mut most) = (0.0_f64, 0.0_f64);
        for number in finest..=coarsest {
            let next = picture.halved().learned(&level);
            let coarser = Octave::of(next.clone(), number + 1);
            bumps = level.bumps(&coarser).unwrap_or(bumps);
            most = most.max(bumps);
            let own: Vec<&Template> = templates.iter().copied().filter(|template| template.level == number).collect();
            spend(((1 + own.len()) * level.values.len()) as u64)?;
            for (template, map) in own.iter().zip(filter.maps(&level, &own)) {
                let limits = match options.threshold {
                    DetectionThreshold::FalseAlarms(rate) => {
                        let alarm = FalseAlarmThreshold::new(rate, independent_positions);
                        alarm.limits(template, level.skewness, options.sign).among_bumps(bumps)
                    }
                    DetectionThreshold::Snr(least) => Thresholds::even(least, options.sign),
                };
                peaks.collect(map, template, &level, limits, options.count_max);
            }
            (picture, level) = (next, coarser);
        }
        let (kept, strongest) = peaks.strongest(
            options.count_max,
            APART,
            if most > 0.0 { BackgroundKind::Uneven } else { BackgroundKind::Even },
        );
        Ok(Detections {
            all: kept.iter().map(Peak::detection).collect(),
            strongest: strongest.map(|peak| peak.strength),
            bumps: most,
        })
    }
}

#[cfg(test)]
mod tests;
