//! `Tracker`: follows a target from frame to frame.
//!
//! What comes in: frames, in order. What goes out: one [`Estimate`] each, always. It never knows where frames come from nor
//! what time it is.
//!
//! A frame is fitted from the last estimate when there is one (warm), and from starting values of its own when there is
//! none or when the warm fit is not believed (cold). A target that a cold fit does not find either is lost, and every later
//! frame is searched again.

use std::sync::Arc;

use isophote_jit::Window;
use isophote_symbolic::Roles;
use nalgebra::DMatrix;

use crate::cold::Cold;
use crate::compiled::{CompileFailure, Compiled, Control};
use crate::estimate::{Ending, Estimate, Rejection, TrackState};
use crate::fit::{Fit, View, fit};
use crate::frame::Frame;
use crate::options::{TrackError, TrackerOptions};
use crate::pose::{Fitted, Geometry, Pose, of_ellipses};
use crate::stage::QUANTISATION;

#[path = "rival.rs"]
mod rival;
use rival::Rival;

/// A brightness of less than this many standard deviations is nothing.
const SIGNIFICANT: f64 = 5.0;
/// A reduced χ² this many times the last one asks for a second opinion.
const MISFIT: f64 = 9.0;
/// A brightness that changed by more than this factor from one frame to the next asks for one, too: a fit that lost its
/// target settles on whatever faint thing is near.
const FADED: f64 = 4.0;

/// Follows one target, or the several of one model.
pub struct Tracker {
    compiled: Arc<Compiled>,
    options: TrackerOptions,
    constants: Vec<f64>,
    memory: Memory,
}

/// What is remembered from frame to frame.
#[derive(Clone, Debug, Default)]
struct Memory {
    /// Where the next fit starts: all parameters, those of a swapped model that have a value, or nothing.
    warm: Option<Vec<Option<f64>>>,
    /// The last good parameters.
    last: Vec<f64>,
    /// χ²/ν of the last good fit.
    reduced: Option<f64>,
    /// The last good fit met saturated pixels.
    clipped: bool,
    /// The target was found once.
    found: bool,
    /// The other pose that may be the true one.
    rival: Option<Rival>,
}

/// What a swap does to the parameters of the new model.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Carried {
    /// Names of those that keep their values.
    pub carried: Vec<String>,
    /// Names of those that start anew.
    pub reset: Vec<String>,
}

/// One try on a frame.
struct Attempt {
    fit: Option<Fit>,
    ending: Ending,
    rejection: Option<Rejection>,
    /// Of poses: the runner-up.
    rival: Option<Rival>,
}

impl Attempt {
    fn none(ending: Ending) -> Attempt {
        Attempt { fit: None, ending, rejection: Some(Rejection::Ending), rival: None }
    }

    fn is_good(&self) -> bool {
        self.rejection.is_none()
    }

    fn reduced(&self) -> Option<f64> {
        self.fit.as_ref()?.worth.as_ref()?.reduced
    }
}

impl Tracker {
    /// A tracker that searches.
    ///
    /// # Errors
    /// When a start or constant is given that the model does not have, or one that cannot be.
    pub fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Result<Tracker, TrackError> {
        options.check(compiled.model())?;
        if options.precision != compiled.precision() {
            return Err(TrackError::Precision { wanted: options.precision, compiled: compiled.precision() });
        }
        let constants = options.constants_of(compiled.model());
        Ok(Tracker { compiled, options, constants, memory: Memory::default() })
    }

    /// The model's kernels.
    pub fn compiled(&self) -> &Arc<Compiled> {
        &self.compiled
    }

    /// Takes another model from the next frame on. Parameters of the same name keep their values if they lie inside the new
    /// bounds, and the track goes on from them; the others start anew. Starts and constants that the new model does not
    /// have are left alone: they belonged to the old one.
    pub fn swap(&mut self, compiled: Arc<Compiled>, options: TrackerOptions) -> Carried {
        let (old, new) = (self.compiled.model().clone(), compiled.model().clone());
        let warm = self.memory.warm.as_ref();
        let value = |name: &str| warm.and_then(|warm| warm[old.parameter(name)?.index()]);
        let mut carried = Carried::default();
        let mut values = Vec::new();
        for parameter in new.parameters() {
            let inside = |v: &f64| parameter.min.is_none_or(|min| *v > min) && parameter.max.is_none_or(|max| *v < max);
            let value = value(&parameter.name).filter(inside);
            let names = if value.is_some() { &mut carried.carried } else { &mut carried.reset };
            names.push(parameter.name.clone());
            values.push(value);
        }
        let warm = values.iter().any(Option::is_some).then_some(values);
        self.constants = options.constants_of(&new);
        self.memory = Memory { warm, clipped: self.memory.clipped, found: self.memory.found, ..Memory::default() };
        self.compiled = compiled;
        self.options = options;
        carried
    }

    /// Fits one frame.
    pub fn track(&mut self, frame: &Frame) -> Estimate {
        let grey; // colour frames for a one-channel model
        let frame = match self.compiled.model().channels().len() == 1 && frame.planes().len() == 3 {
            true => {
                grey = frame.luma();
                &grey
            }
            false => frame,
        };
        let view = self.view(frame);
        let attempt = match &view {
            Some(view) => self.attempt(view).unwrap_or(Attempt::none(Ending::NoKernel)),
            None => Attempt::none(Ending::WrongFrame),
        };
        let pose = view.and_then(|view| self.pose(&view, &attempt));
        self.remember(&attempt);
        Estimate { pose, ..self.publish(frame, attempt) }
    }

    /// The part of a frame to look at; `None` when the frame does not suit the model.
    fn view<'a>(&self, frame: &'a Frame) -> Option<View<'a>> {
        let model = self.compiled.model();
        let dimensions = model.coordinates().len();
        let suits = frame.size().len() == dimensions || (dimensions == 1 && frame.rows() == 1);
        if !suits || frame.planes().len() != model.channels().len() {
            return None;
        }
        let whole = Window::of_size(frame.sides());
        let window = self.options.window.unwrap_or(whole).clipped_to(frame.sides())?;
        let planes = (0..frame.planes().len()).map(|channel| frame.plane_view(channel)).collect();
        Some(View::new(planes, window, self.options.camera.saturation, self.compiled.precision()))
    }

    /// Warm, then cold when the warm fit is not believed.
    fn attempt(&self, view: &View) -> Result<Attempt, CompileFailure> {
        let Some(warm) = &self.memory.warm else {
            return self.cold(view, &self.options.start_of(self.compiled.model()));
        };
        let warm = self.warm(view, warm)?;
        if !warm.is_good() {
            let cold = self.cold(view, &self.options.start_of(self.compiled.model()))?;
            return Ok(if cold.fit.is_some() || warm.fit.is_none() { cold } else { warm });
        }
        let fades = self.brightness_change(&warm) > FADED;
        if fades || self.is_jump(&warm, view) {
            let cold = self.cold(view, &self.options.start_of(self.compiled.model()))?;
            let truer = fades && self.brightness_change(&cold) < self.brightness_change(&warm);
            if cold.is_good() && (truer || cold.reduced() < warm.reduced()) {
                return Ok(cold);
            }
        }
        Ok(warm)
    }

    fn warm(&self, view: &View, warm: &[Option<f64>]) -> Result<Attempt, CompileFailure> {
        let full: Option<Vec<f64>> = warm.iter().copied().collect();
        let Some(start) = full else { return self.cold(view, warm) };
        let control = if self.memory.clipped { Control::Dropping } else { Control::Plain };
        let warm = self.judged(fit(&self.compiled, view, &self.constants, &start, control)?, view);
        self.against_rival(view, warm, control)
    }

    /// From starting values: `given` numbers first, then the model's own, then what the window shows. The believable fit
    /// with the smallest χ²/ν, if any is.
    fn cold(&self, view: &View, given: &[Option<f64>]) -> Result<Attempt, CompileFailure> {
        let Some(cold) = Cold::look(self.compiled.model(), view, &self.constants, given) else {
            return Ok(Attempt::none(Ending::NoTarget));
        };
        let mut best: Option<Attempt> = None;
        let mut others = Vec::new();
        for start in cold.starts.iter().chain(&cold.tighter) {
            let last_resort = Some(start) == cold.tighter.as_ref();
            if last_resort && best.as_ref().is_some_and(Attempt::is_good) {
                break;
            }
            let attempt = self.judged(fit(&self.compiled, view, &self.constants, start, cold.control)?, view);
            let rank = |attempt: &Attempt| (!attempt.is_good(), attempt.reduced().unwrap_or(f64::INFINITY));
            if best.as_ref().is_none_or(|best| rank(&attempt) < rank(best)) {
                others.extend(best.replace(attempt));
            } else {
                others.push(attempt);
            }
        }
        self.likeliest_pose(view, best.unwrap_or(Attempt::none(Ending::NoTarget)), others)
    }

    /// By which factor a brightness changed since the last good fit, up or down, the largest of all targets (of a pose's spots the least); 1 where unknown.
    fn brightness_change(&self, attempt: &Attempt) -> f64 {
        let Some(fit) = &attempt.fit else { return 1.0 };
        let ratio = |roles: &Roles| {
            let index = roles.brightness?.index();
            let (old, new) = (self.memory.last.get(index)?.abs(), fit.parameters[index].abs());
            Some((new / old).max(old / new))
        };
        let ratios = self.compiled.model().roles().iter().filter_map(ratio);
        // A pose goes on while one of its spots is as it was.
        if self.fits_pose() { ratios.reduce(f64::min).unwrap_or(1.0) } else { ratios.fold(1.0, f64::max) }
    }

    /// The parameters are a pose.
    fn fits_pose(&self) -> bool {
        self.compiled.model().roles().iter().any(|roles| !roles.position.is_empty())
    }

    /// A χ²/ν far above the last one.
    fn is_jump(&self, attempt: &Attempt, view: &View) -> bool {
        let floor = if self.compiled.model().has_noise() { 1.0 } else { QUANTISATION.max(view.rounding.powi(2)) };
        let last = self.memory.reduced.map(|reduced| MISFIT * reduced.max(floor));
        last.is_some_and(|limit| attempt.reduced().is_some_and(|reduced| reduced > limit))
    }

    /// A fit, and why it is not believed.
    fn judged(&self, fit: Fit, view: &View) -> Attempt {
        let rejection = self.rejection(&fit, view);
        Attempt { ending: fit.ending, fit: Some(fit), rejection, rival: None }
    }

    fn rejection(&self, fit: &Fit, view: &View) -> Option<Rejection> {
        let model = self.compiled.model();
        if !fit.ending.is_fit() {
            return Some(Rejection::Ending);
        }
        if !model.constraints_hold(&fit.parameters, &self.constants) {
            return Some(Rejection::OutsideBounds);
        }
        let (first, size) = (view.window.first(), view.window.size());
        // A pose has spots to spare: it is believed while one of them shines.
        let mut shining = false;
        for roles in model.roles() {
            for ((parameter, first), size) in roles.centre.iter().zip(first).zip(size) {
                let place = fit.parameters[parameter.index()] - first as f64;
                if !(place >= -0.5 && place <= size as f64 - 0.5) {
                    return Some(Rejection::OutsideWindow);
                }
            }
            // The least eigenvalue of A belongs to the longest semi-axis, 1/√λ.
            if let Some(least) = least_eigenvalue(roles, model.coordinates().len(), &fit.parameters) {
                let longest = size.into_iter().max().unwrap_or(1) as f64;
                if least * longest.powi(2) < 1.0 {
                    return Some(Rejection::Oversized);
                }
            }
            let brightness = roles.brightness.and_then(|parameter| {
                let index = self.compiled.last_parameters().iter().position(|&p| p == parameter)?;
                let worth = fit.worth.as_ref()?;
                let variance = worth.covariance.as_ref().map_or(worth.variance_alone[index], |c| c[(index, index)]);
                // Whole pixel values are rounded: a blank frame is not known better than that.
                let floor = if view.holds_whole_values() && !model.has_noise() { QUANTISATION } else { 0.0 };
                let reduced = worth.reduced.unwrap_or(0.0);
                let blank = if reduced < floor { floor / reduced.max(floor * f64::EPSILON) } else { 1.0 };
                Some(fit.parameters[parameter.index()].abs() / (variance * blank).sqrt())
            });
            shining |= brightness.is_some_and(|significance| significance >= SIGNIFICANT);
            if !self.fits_pose() && brightness.is_some_and(|significance| significance < SIGNIFICANT) {
                return Some(Rejection::Faint);
            }
        }
        (self.fits_pose() && !shining).then_some(Rejection::Faint)
    }

    /// From the parameters where they are a pose, else from the spots' ellipses where lens and target are given.
    fn pose(&self, view: &View, attempt: &Attempt) -> Option<Pose> {
        let fit = attempt.fit.as_ref().filter(|_| attempt.is_good())?;
        let (model, order) = (self.compiled.model(), self.compiled.last_parameters());
        let covariance = fit.worth.as_ref()?.covariance.as_ref();
        if let Some(geometry) = Geometry::of(model, &self.constants) {
            let alternatives = attempt.rival.iter().filter_map(|rival| rival.alternative(&geometry)).collect();
            return Some(Pose { alternatives, ..geometry.published(&fit.parameters, order, covariance) });
        }
        let (lens, target) = (self.options.camera.intrinsics.as_ref()?, self.options.target.as_ref()?);
        let saturation = match view.saturation[..] {
            [limit] => limit,
            _ => f64::INFINITY,
        };
        let fitted = Fitted {
            parameters: &fit.parameters,
            constants: &self.constants,
            order,
            covariance: covariance?,
            saturation,
        };
        of_ellipses(model, lens, target, &fitted)
    }

    fn remember(&mut self, attempt: &Attempt) {
        let memory = &mut self.memory;
        match &attempt.fit {
            Some(fit) if attempt.is_good() => {
                let mut next = fit.parameters.clone();
                if let Some(geometry) = Geometry::of(self.compiled.model(), &self.constants) {
                    geometry.fold(&mut next);
                }
                memory.warm = Some(next.into_iter().map(Some).collect());
                memory.last = fit.parameters.clone();
                memory.rival = attempt.rival.clone();
                memory.reduced = attempt.reduced();
                memory.clipped = fit.worth.as_ref().is_some_and(|worth| worth.saturated > 0.0);
                memory.found = true;
            }
            _ => {
                memory.warm = None;
                memory.reduced = None;
                memory.rival = None;
            }
        }
    }

    fn publish(&self, frame: &Frame, attempt: Attempt) -> Estimate {
        let model = self.compiled.model();
        let good = attempt.is_good();
        let state = match (good, self.memory.found) {
            (true, _) => TrackState::Tracking,
            (false, true) => TrackState::Lost,
            (false, false) => TrackState::Searching,
        };
        let (stages, worth) = attempt.fit.map_or((Vec::new(), None), |fit| (fit.stages, fit.worth));
        let told = worth.as_ref().filter(|_| good);
        let covariance = told.and_then(|worth| worth.covariance.as_ref());
        Estimate {
            target: match model.roles() {
                [roles] => roles.name.clone().unwrap_or_else(|| "0".to_string()),
                _ => "0".to_string(),
            },
            sequence: frame.sequence,
            capture_ns: frame.capture_ns,
            state,
            parameters: self.memory.last.clone(),
            order: self.compiled.last_parameters().to_vec(),
            covariance: covariance.map(|c| c.row_iter().map(|row| row.iter().copied().collect()).collect()),
            objective: told.map(|worth| worth.objective),
            reduced_chi_square: told.and_then(|worth| worth.reduced),
            pixels: worth.as_ref().map_or(0, |worth| worth.pixels),
            saturated: worth.as_ref().map_or(0.0, |worth| worth.saturated),
            iterations: stages.iter().map(|stage| stage.iterations).collect(),
            converged: good && attempt.ending == Ending::SmallStep,
            ending: attempt.ending,
            rejection: attempt.rejection,
            stages,
            pose: None,
        }
    }
}

/// Of A, in two dimensions and more; `None` without the role `shape`.
fn least_eigenvalue(roles: &Roles, dimensions: usize, parameters: &[f64]) -> Option<f64> {
    let mut upper = roles.shape.iter().map(|parameter| parameters[parameter.index()]);
    let mut a = DMatrix::zeros(dimensions, dimensions);
    for row in 0..dimensions {
        for column in row..dimensions {
            let entry = upper.next()?;
            a[(row, column)] = entry;
            a[(column, row)] = entry;
        }
    }
    (dimensions > 1).then(|| a.symmetric_eigenvalues().min())
}

#[cfg(test)]
#[path = "tracker_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "circular_start_tests.rs"]
mod circular_start_tests;
