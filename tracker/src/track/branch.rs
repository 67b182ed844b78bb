//! Branches of a pose: what is tried when a fit may have ended on the wrong side, or leaves more unexplained than it should.
//!
//! What comes in: a fit of a model whose parameters are a pose, and what is remembered of the target. What goes out: the likeliest
//! of that fit, those from mirrored poses, and those that leave hidden pixels out; or that none of them is believed. It never
//! knows how a search or a track begins, nor which of alike spots is which: see [`super::naming`].
//!
//! ```text
//! fit ─► may be the other side? ─► mirrored poses ─► leaves too much unexplained? ─► hidden pixels left out ─► believed?
//! ```

use super::memory::Memory;
use super::past::{Past, TURNED_LEAST};
use super::solver::{Attempt, Look, Solver};
use super::window::Margin;
use crate::estimate::{Ending, Rejection};
use crate::pose::Geometry;
use crate::solve::backgrounds::MISFIT;
use crate::solve::fit::{Begin, Fit};
use crate::solve::residuals::Over;
use crate::solve::stage_kernels::{CompileFailure, Control};
use crate::solve::veil::{SpotNames, Veil};

/// Of the light of a target a document without a past may leave this share unexplained, beyond the noise: a mirrored tilt and a
/// covered spot leave more.
const UNEXPLAINED: f64 = 0.02;
/// The other side is tried again when the angle to it has grown by this factor …
const GROWN: f64 = 1.5;
/// … from at least this, rad: what is less tilted than that looks alike from both sides.
const FLAT: f64 = 0.03;
/// A target that turns by so much more than its other side is off may have come to that.
const TURNED: f64 = 2.0;
/// Spots of a target that is turned by more than this from frame to frame may have changed their names, rad.
const RENAMED: f64 = 0.5;
/// The window of a fit is larger than the domain by this share, and by so many px.
const MARGIN: (f64, f64) = (0.1, 3.0);
/// Mirrored poses are tried so many times in a row, each time from the one that won.
const ROUNDS: usize = 2;

impl Solver {
    /// Of a fit around a prediction what is to be believed.
    pub fn branched(
        &self,
        look: &Look,
        mut attempt: Attempt,
        start: &[f64],
        memory: &Memory,
        control: Control,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(attempt) };
        let (past, turned) = (&memory.past, memory.past.turned().cloned());
        if !self.is_usual(&attempt, past) || self.is_other_side(geometry, &attempt, memory) {
            let others = geometry.mirrored(start).into_iter().take(1).chain(turned.clone());
            attempt = self.against_mirrored(look, attempt, others.collect(), control)?;
        }
        let starts: Vec<Vec<f64>> = std::iter::once(start.to_vec()).chain(turned).collect();
        self.unveiled(look, attempt, &starts, past)
    }

    /// Of a cold fit.
    pub fn branched_cold(&self, look: &Look, attempt: Attempt, control: Control) -> Result<Attempt, CompileFailure> {
        if self.geometry.is_none() {
            return Ok(attempt);
        }
        let attempt = self.against_mirrored(look, attempt, Vec::new(), control)?;
        let attempt = self.named(look, attempt, control)?;
        let attempt = self.unveiled(look, attempt, &[], &Past::default())?;
        let is_wrong = self.has_false_spot(look, &attempt);
        Ok(if is_wrong { Attempt { rejection: Some(Rejection::Misfit), ..attempt } } else { attempt })
    }

    /// A good fit that leaves no more unexplained than others of the same document did.
    fn is_usual(&self, attempt: &Attempt, past: &Past) -> bool {
        let Some(fit) = attempt.fit.as_ref().filter(|_| attempt.is_good()) else { return false };
        !self.model().has_noise() || attempt.reduced().is_none_or(|reduced| reduced <= past.limit(fit))
    }

    /// Whether the target may have come to the other side since that was tried, or be there.
    fn is_other_side(&self, geometry: &Geometry, attempt: &Attempt, memory: &Memory) -> bool {
        let Some(fit) = &attempt.fit else { return false };
        let here = geometry.to_mirrored(&fit.parameters);
        if here < FLAT {
            return false;
        }
        let grown = memory.rival.is_none() && memory.past.tried.is_none_or(|tried| here > GROWN * tried.max(FLAT));
        let last = memory.last_start().unwrap_or_else(|| fit.parameters.clone());
        // A target that turned and seems to have stopped may be on the other side, and turning.
        let before = memory.past.step.map_or(0.0, |step| step.norm());
        let turned = geometry.apart(&last, &fit.parameters).max(before);
        let mut others = geometry.mirrored(&fit.parameters).into_iter();
        let other = others.next().map_or(f64::INFINITY, |other| geometry.apart(&last, &other));
        grown || (turned > TURNED_LEAST && other < TURNED * turned)
    }

    /// The likeliest of a fit, those from `others`, and those from mirrored poses, as long as one of these wins.
    fn against_mirrored(
        &self,
        look: &Look,
        mut best: Attempt,
        mut others: Vec<Vec<f64>>,
        control: Control,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(best) };
        let margin = Margin::even(MARGIN.0, MARGIN.1);
        for _ in 0..ROUNDS {
            let Some(before) = best.fit.as_ref().map(|fit| fit.parameters.clone()) else { return Ok(best) };
            if look.unfinished().is_some() || !before.iter().all(|value| value.is_finite()) {
                return Ok(best);
            }
            let facing = geometry.facing(&before);
            let is_behind = facing.is_some();
            others.extend(geometry.mirrored(facing.as_ref().unwrap_or(&before)));
            others.extend(facing);
            let mut tried = Vec::new();
            for start in others.drain(..) {
                tried.push(self.attempt(look, &start, Begin::Anywhere, control, margin)?);
            }
            if (!best.is_good() || is_behind)
                && let Some(good) = tried.iter().position(Attempt::is_good)
            {
                best = tried.swap_remove(good);
            }
            best = self.likeliest_pose(look, best, tried)?;
            if best.fit.as_ref().is_none_or(|fit| geometry.apart(&before, &fit.parameters) < FLAT) {
                break;
            }
        }
        best.is_other_tried = look.unfinished().is_none();
        Ok(best)
    }

    /// The attempt, when it leaves no more unexplained than usual, else one that leaves hidden pixels out, else none.
    fn unveiled(
        &self,
        look: &Look,
        attempt: Attempt,
        starts: &[Vec<f64>],
        past: &Past,
    ) -> Result<Attempt, CompileFailure> {
        let Some(geometry) = &self.geometry else { return Ok(attempt) };
        if attempt.ending == Ending::Budget {
            return Ok(self.judged(attempt, past));
        }
        if self.is_usual(&attempt, past) || !self.model().has_noise() || look.unfinished().is_some() {
            return Ok(attempt);
        }
        let view = self.view(look, look.window);
        let is_ready = self.may_be_robust(look, &view);
        let Some(predictions) = is_ready.then(|| self.compiled.predictions()).flatten() else {
            return Ok(self.judged(attempt, past));
        };
        let ends = attempt.fit.iter().map(|fit| fit.parameters.clone());
        let names = if starts.is_empty() { SpotNames::Guessed } else { SpotNames::Known };
        let veil =
            Veil { kernels: &self.compiled, predictions, view: &view, constants: &self.constants, geometry, names };
        let starts: Vec<Vec<f64>> = starts.iter().cloned().chain(ends).collect();
        let found = veil.unveiled(&starts);
        let found = found.inspect_err(|_| self.compiled.backgrounds_shelf().give_up()).ok().flatten();
        let clear = found.map(|fit| {
            let rejection = self.rejection(&fit, &view, look.window);
            Attempt::of(fit, rejection)
        });
        // What is left must be explained as well as all was before.
        match clear.filter(|clear| self.is_usual(clear, past)) {
            Some(clear) => Ok(clear),
            None => Ok(self.judged(attempt, past)),
        }
    }

    /// The attempt, not believed where it leaves more unexplained than the document ever did.
    fn judged(&self, attempt: Attempt, past: &Past) -> Attempt {
        let Some(reduced) = attempt.reduced().filter(|_| attempt.is_good() && self.model().has_noise()) else {
            return attempt;
        };
        let most = match past.usual {
            Some(usual) if usual <= MISFIT => MISFIT * usual.max(1.0),
            usual => (1.0 + UNEXPLAINED * self.light(&attempt)).max(usual.map_or(0.0, |usual| MISFIT * usual)),
        };
        match reduced <= most {
            true => attempt,
            false => Attempt { rejection: Some(Rejection::Misfit), ..attempt },
        }
    }

    /// A spot leaves a larger share of its own light unexplained than a document may: it is of something else.
    fn has_false_spot(&self, look: &Look, attempt: &Attempt) -> bool {
        let Some(geometry) = self.geometry.as_ref().filter(|geometry| geometry.target.spots.len() > 1) else {
            return false;
        };
        let is_doubtful = attempt.is_good() && attempt.reduced().is_some_and(|reduced| reduced > MISFIT);
        let Some(fit) = attempt.fit.as_ref().filter(|fit| is_doubtful && fit.choice.is_none()) else { return false };
        let view = self.view(look, self.window(look, &fit.parameters, Margin::NONE));
        let seen = self
            .compiled
            .predictions()
            .and_then(|predictions| predictions.residuals(&view, &fit.parameters, &self.constants, Over::Domain));
        let Some(seen) = seen else { return false };
        let mut spot_of = vec![None; view.window.pixels()];
        for (pixel, spot) in geometry.nearest(&fit.parameters, view.window, 1.0) {
            spot_of[pixel] = Some(spot);
        }
        let mut excess = vec![0.0; geometry.target.spots.len()];
        for residual in seen.iter().flat_map(|seen| &seen.residuals) {
            spot_of[residual.pixel].into_iter().for_each(|spot: usize| excess[spot] += residual.whitened.powi(2) - 1.0);
        }
        excess.into_iter().enumerate().any(|(spot, excess)| {
            let roles = geometry.roles(self.model(), spot);
            roles.and_then(|roles| self.light_of(fit, roles)).is_some_and(|light| excess > UNEXPLAINED * light)
        })
    }

    /// By how much χ²/ν would be larger without the target's light.
    fn light(&self, attempt: &Attempt) -> f64 {
        let Some((fit, worth)) = attempt.fit.as_ref().and_then(|fit| Some((fit, fit.worth.as_ref()?))) else {
            return 0.0;
        };
        let lights = self.model().roles().iter().filter_map(|roles| self.light_of(fit, roles));
        lights.sum::<f64>() / worth.pixels.max(1) as f64
    }

    /// By how much χ² would be larger without the light of one spot.
    fn light_of(&self, fit: &Fit, roles: &isophote_symbolic::Roles) -> Option<f64> {
        let brightness = roles.brightness?;
        let row = self.compiled.last_parameters().iter().position(|&parameter| parameter == brightness)?;
        let square = fit.parameters[brightness.index()].powi(2) / fit.worth.as_ref()?.variance_alone[row];
        Some(square).filter(|square| square.is_finite())
    }

    /// A pose of a picture of which a part was left out: far from where it was expected it is none.
    pub fn is_veiled_pose(&self, attempt: &Attempt) -> bool {
        self.fits_pose() && attempt.choice().is_some()
    }

    /// A pose that not all of its spots speak for, turned so far from where it was that they may have changed their names.
    pub fn is_renamed(&self, attempt: &Attempt, memory: &Memory) -> bool {
        let Some((geometry, last)) = self.geometry.as_ref().zip(memory.last_start()) else { return false };
        let Some(fit) = attempt.fit.as_ref().filter(|_| geometry.target.spots.len() > 1) else { return false };
        let is_turned = |from: &Vec<f64>| geometry.apart(from, &fit.parameters) > RENAMED;
        let is_whole = fit.choice.is_none() && self.dark_spots(geometry, fit).is_empty();
        !is_whole && is_turned(&last) && memory.past.turned().is_none_or(is_turned)
    }

    /// A fit that the search found, by what is known of the document.
    pub fn is_believed(&self, attempt: &Attempt, past: &Past) -> bool {
        !self.fits_pose() || self.judged(attempt.clone(), past).is_good()
    }
}
