//! Detection by the document itself: where in a picture the model's own image stands out of the noise, however faint.
//!
//! What comes in: a [`Bank`] of [`template`]s rendered from a document, and a picture. What goes out: [`Detections`]: places,
//! sizes and heights, the strongest first, and how strong the strongest was where none is strong enough. It must never know a
//! fit.
//!
//! 1. The picture is halved again and again, so that a target of any size is a few pixels wide in one of them.
//! 2. The local ground, the median over blocks much larger than a target, is taken away ([`level`]).
//! 3. What is left is correlated with the document's image, less its mean over the disc around it ([`filter`]): the part of it
//!    that no even ground can pretend. Divided by its standard deviation over the picture, which is found robustly, that is
//!    the square root of twice the log-likelihood ratio of a target against ground alone.
//! 4. What noise alone exceeds in no more than a given share of frames is a detection ([`alarm`]). Where the ground itself is full
//!    of bumps, they are not normal, and more is asked for.

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
use crate::sight::start::{Sight, Sign};
use alarm::Alarm;
use filter::Filter;
use level::{Mended, Octave};
use peaks::{Footing, Peak, Peaks};
use template::Template;

/// Detections that are told of at most.
const DETECTIONS_MAX: usize = 12;
/// Of two peaks nearer than this, in sizes of the larger one, the stronger one remains, unless it may be the tip of the other.
const APART: f64 = 1.5;
/// A size that is expected may be off by this factor, either way.
const SIZES_OFF: f64 = 2.1;

/// What to look for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sought<'a> {
    /// Bright or dark; `None`: both.
    pub sign: Option<Sign>,
    /// Half the target's width, px, where it is known.
    pub size_px: Option<f64>,
    /// Places that are taken.
    pub masks: &'a [Mask],
    /// In so large a share of frames noise alone may be a detection.
    pub false_alarms: f64,
}

/// What a picture shows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Detections {
    /// What stands out, as starting values, the strongest first.
    pub sights: Vec<Sight>,
    /// The strongest thing, whether it stands out or not; absent where nothing could be looked at.
    pub strongest: Option<Strength>,
    /// The largest share of the ground's variance, of all octaves, that is no noise.
    pub bumps: f64,
}

/// How strong something is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Strength {
    /// Standard deviations of the noise, after the filter.
    pub score: f64,
    /// From this many on noise alone is rarely the reason.
    pub threshold: f64,
    /// Where, px.
    pub place: [f64; 2],
    /// Half its width, px.
    pub size_px: f64,
}

impl Strength {
    /// The same in a frame of which the window begins at `origin`.
    pub(crate) fn placed(self, origin: [f64; 4]) -> Strength {
        Strength { place: [self.place[0] + origin[0], self.place[1] + origin[1]], ..self }
    }
}

impl Bank {
    /// Everything in a picture that stands out. The picture is one of two dimensions, in whole pixels. Each octave is charged by its
    /// pixels, once for itself and once for each template.
    ///
    /// # Errors
    /// When `spend` ends the search.
    pub fn detect(
        &self,
        model: &Model,
        constants: &[f64],
        grey: &Grey,
        sought: &Sought,
        spend: Spend,
    ) -> Result<Detections, Stop> {
        let range = sought.size_px.map_or([0.0, f64::INFINITY], |size| [size / SIZES_OFF, size * SIZES_OFF]);
        let side = grey.size[0].min(grey.size[1]);
        let templates = self.templates(model, constants, range, side);
        let levels = || templates.iter().map(|template| template.level);
        let (Some(finest), Some(coarsest)) = (levels().min(), levels().max()) else {
            return Ok(Detections::default());
        };
        let signs = if sought.sign.is_none() { 2.0 } else { 1.0 };
        let places = templates.iter().map(|template| signs * template.places(grey.size[0] * grey.size[1])).sum();
        let alarm = Alarm::new(sought.false_alarms, places);
        let mut picture = Mended::of(grey, sought.masks);
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
                let limits = alarm.limits(template, level.skewness, sought.sign);
                peaks.collect(map, template, &level, limits.among_bumps(bumps));
            }
            (picture, level) = (next, coarser);
        }
        let (kept, strongest) =
            peaks.strongest(DETECTIONS_MAX, APART, if most > 0.0 { Footing::Uneven } else { Footing::Even });
        Ok(Detections {
            sights: kept.iter().map(Peak::sight).collect(),
            strongest: strongest.map(|peak| peak.strength),
            bumps: most,
        })
    }
}

#[cfg(test)]
mod tests;
