//! `Solver`: a model's kernels with a session's options, ready to fit a target anywhere in a frame.
//!
//! What comes in: a frame, starting values. What goes out: an [`Attempt`], a fit and whether it is believed. It never knows
//! what was seen in earlier frames.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use isophote_jit::{PlaneView, Window};
use isophote_symbolic::{Model, Quadrature};
use smallvec::smallvec;

use super::faint;
use super::rival::Rival;
use super::window::{Margin, Reach, holds};
use crate::budget::{FrameBudget, Stop};
use crate::estimate::{Ending, Rejection, Sampled};
use crate::options::TrackerOptions;
use crate::outline::{half_widths, least_bend, shape};
use crate::pose::Geometry;
use crate::sight::detect::{Bank, Strength};
use crate::sight::gaps::{Gaps, overlap};
use crate::sight::grey::{brightest, row_shares};
use crate::sight::mask::Mask;
use crate::sight::view::{PerPlane, View, limit, summable};
use crate::solve::compiled::Compiled;
use crate::solve::fit::{Begin, Fit, fit, fit_nearby};
use crate::solve::passes::Worth;
use crate::solve::prepare::{Lacking, Preparation, Preparing};
use crate::solve::readiness::{FrameReadiness, Readiness};
use crate::solve::residuals::Over;
use crate::solve::sampling::{Chosen, Sampling, Way};
use crate::solve::stage_kernels::{CompileFailure, Control};
use crate::solve::structure::Structure;
use isophote_frame::{Frame, Response};

/// About a domain, for what its walk through the model may have missed.
const DOMAIN_MARGIN: Margin = Margin { share: 0.05, px: [2.0; 4] };
/// A fit whose domain leaves its window is repeated in a larger one, so many times.
const WINDOWS: usize = 4;

/// What a tracker of some model and session fits with.
pub(crate) struct Solver {
    pub compiled: Arc<Compiled>,
    pub options: TrackerOptions,
    pub constants: Vec<f64>,
    /// Lens and target, when the model's parameters are a pose.
    pub geometry: Option<Geometry>,
    /// What its target looks like, for searches.
    pub bank: Option<Arc<Bank>>,
    /// What makes light of the camera's values, where they are not light as they are.
    response: Option<Response>,
    /// What the camera's map of defects leaves out.
    pub gaps: Option<Gaps>,
    /// The variance of rows' offsets in each entry of `observed`, over that of a plane; none where rows cannot be told apart.
    pub(super) row_shares: Vec<f64>,
    pub reach: Reach,
    /// The share of its outline that a target's light would fill at full height.
    pub(super) fullness: OnceLock<f64>,
}

/// A frame's pixels that may be looked at.
pub(crate) struct Look<'a> {
    planes: Vec<PlaneView<'a>>,
    pub window: Window,
    /// What its pixels can hold at most.
    largest: f64,
    /// Where its pixels are clipped, for each window that was looked at.
    limits: Mutex<Vec<(Window, PerPlane<f64>)>>,
    /// What it may cost; none where nothing bounds it.
    budget: Option<&'a FrameBudget<'a>>,
    /// What a fit went on without.
    wanted: OnceLock<Preparation>,
    /// What its fits have beside the model's kernels.
    pub ready: Arc<Readiness>,
    /// The variance of what its rows are off by, as soon as that is known.
    rows: OnceLock<f64>,
}

impl<'a> Look<'a> {
    /// The same within a bound.
    pub fn within(self, budget: &'a FrameBudget<'a>) -> Look<'a> {
        Look { budget: Some(budget), ..self }
    }

    /// The same, with what its fits had when it was looked at before.
    pub fn again(self, ready: Option<FrameReadiness>) -> Look<'a> {
        Look { ready: Arc::new(Readiness::of(ready)), ..self }
    }

    /// The same for a part of its work; what that goes on without is its own.
    pub fn bounded<'b>(&self, budget: &'b FrameBudget<'b>) -> Look<'b>
    where
        'a: 'b,
    {
        let limits = self.limits.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Look {
            rows: self.rows.clone(),
            planes: self.planes.clone(),
            limits: Mutex::new(limits),
            budget: Some(budget),
            wanted: OnceLock::new(),
            ready: self.ready.clone(),
            ..*self
        }
    }

    /// What was found out, and gone on without, in a part of its work.
    pub fn take_from(&self, part: &Look) {
        part.wanted().cloned().into_iter().for_each(|preparation| self.want(preparation));
        part.row_variance().into_iter().for_each(|variance| self.learn_rows(variance));
    }

    /// Units for a part of its work.
    pub fn budget(&self, work: u64) -> FrameBudget<'_> {
        FrameBudget::part(work, self.budget)
    }

    /// Takes units of its budget.
    pub fn spend(&self, units: u64) -> Result<(), Stop> {
        self.budget.map_or(Ok(()), |budget| budget.spend(units))
    }

    /// How it ended, when it was not looked at to the end.
    pub fn unfinished(&self) -> Option<Ending> {
        self.budget.and_then(FrameBudget::stopped).map(Ending::from)
    }

    /// The same, of a part of what may be looked at; `None` where that is outside.
    pub fn narrowed(&self, window: Window) -> Option<Look<'a>> {
        let (planes, limits, wanted) = (self.planes.clone(), Mutex::default(), OnceLock::new());
        let (ready, rows) = (self.ready.clone(), self.rows.clone());
        Some(Look { planes, window: overlap(window, self.window)?, limits, wanted, ready, rows, ..*self })
    }

    /// Asks for a search of all that may be looked at.
    pub fn search(&self) -> Result<(), Stop> {
        self.budget.map_or(Ok(()), FrameBudget::search)
    }

    /// Says what a fit went on without.
    pub fn want(&self, preparation: Preparation) {
        self.wanted.get_or_init(|| preparation);
    }

    /// The variance of what rows are off by, in pixel values², where it is known.
    pub fn row_variance(&self) -> Option<f64> {
        self.rows.get().copied()
    }

    /// It is known from now on.
    pub fn learn_rows(&self, variance: f64) {
        self.rows.get_or_init(|| variance);
    }

    /// What fits went on without.
    pub fn wanted(&self) -> Option<&Preparation> {
        self.wanted.get()
    }
}

/// One try on a frame.
#[derive(Clone, Debug)]
pub(crate) struct Attempt {
    pub fit: Option<Fit>,
    pub ending: Ending,
    pub rejection: Option<Rejection>,
    /// Of poses: the runner-up.
    pub rival: Option<Rival>,
    /// Of a search: the strongest thing that the document's own image found.
    pub strongest: Option<Strength>,
    /// Of poses: the mirrored ones were tried.
    pub is_other_tried: bool,
}

impl Attempt {
    /// A fit, and why it is not believed.
    pub fn of(fit: Fit, rejection: Option<Rejection>) -> Attempt {
        let nothing = Attempt::none(fit.ending);
        Attempt { fit: Some(fit), rejection, ..nothing }
    }

    /// Nothing was fitted.
    pub fn none(ending: Ending) -> Attempt {
        let rejection = Some(Rejection::Ending);
        Attempt { fit: None, ending, rejection, rival: None, strongest: None, is_other_tried: false }
    }

    pub fn is_good(&self) -> bool {
        self.rejection.is_none()
    }

    /// χ²/ν.
    pub fn reduced(&self) -> Option<f64> {
        self.fit.as_ref()?.worth.as_ref()?.reduced
    }
}

impl Solver {
    /// Options that suit the model.
    pub fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Solver {
        let constants = options.constants_of(compiled.model());
        let reach = Reach::of(compiled.model(), &constants);
        let geometry = Geometry::of(compiled.model(), &constants);
        let bank = compiled.bank(&constants);
        let gaps = options.camera.defect_map.as_ref().and_then(Gaps::of);
        // A response that cannot be was refused with the options.
        let response = options.camera.linear_response().ok().flatten();
        let row_shares = row_shares(compiled.model(), &constants);
        let fullness = OnceLock::new();
        Solver { compiled, options, constants, geometry, bank, response, gaps, row_shares, reach, fullness }
    }

    pub fn model(&self) -> &Model {
        self.compiled.model()
    }

    /// The frame as fits see it: in light where the camera has a response, without values that are too large for sums, its defects
    /// mended where it has a map of them; as it is where these are of other frames.
    pub fn mended<'a>(&self, frame: &'a Frame) -> Cow<'a, Frame> {
        let document = self.options.camera.response.as_ref();
        let frame = match &self.response {
            Some(response) if document.is_some_and(|document| document.check_size(frame.size()).is_ok()) => {
                Cow::Owned(frame.linear(response))
            }
            _ => Cow::Borrowed(frame),
        };
        let precision = self.compiled.precision();
        let frame = match frame {
            // No value of a camera's is out of its range, nor one that is worked out of such.
            Cow::Borrowed(frame) if frame.largest.is_some() => Cow::Borrowed(frame),
            Cow::Borrowed(frame) => frame.within(brightest(frame).min(summable(precision))),
            Cow::Owned(frame) => Cow::Owned(frame.within(summable(precision)).into_owned()),
        };
        let map = self.options.camera.defect_map.as_ref();
        match &self.gaps {
            Some(gaps) if map.is_some_and(|map| map.check_size(frame.size()).is_ok()) => {
                Cow::Owned(gaps.mended(&frame))
            }
            _ => frame,
        }
    }

    /// The part of a mended frame to look at; `None` when the frame does not suit the model.
    pub fn look<'a>(&self, frame: &'a Frame) -> Option<Look<'a>> {
        let model = self.model();
        let dimensions = model.coordinates().len();
        let has_dimensions = frame.size().len() == dimensions || (dimensions == 1 && frame.rows() == 1);
        let suits = has_dimensions && self.options.check_size(model, frame.size()).is_ok();
        let planes = frame.planes_of(model.channels()).filter(|_| suits)?;
        let whole = Window::of_size(frame.sides());
        let window = self.options.window.unwrap_or(whole).clipped_to(frame.sides())?;
        let planes = planes.into_iter().map(|plane| frame.plane_view(plane)).collect();
        let largest = frame.largest.unwrap_or(f64::INFINITY);
        let (limits, wanted, ready) = (Mutex::default(), OnceLock::new(), Arc::default());
        let look = Look { planes, window, largest, limits, budget: None, wanted, ready, rows: OnceLock::new() };
        self.options.camera.row_variance().into_iter().for_each(|variance| look.learn_rows(variance));
        Some(look)
    }

    /// A part of what may be looked at.
    pub fn view<'a>(&self, look: &Look<'a>, window: Window) -> View<'a> {
        let view = View::new(look.planes.clone(), window, self.limits(look, window), self.compiled.precision());
        let gaps = self.gaps.as_ref().map(|gaps| gaps.inside(window)).unwrap_or_default();
        let view = View { budget: look.budget, gaps, ..view };
        self.with_rows(look, view, look.row_variance())
    }

    /// One limit a plane: the camera's (that of light where it has a response), else what the window's pixels show, but not above what the source's pixels can hold.
    /// Looked for once a frame and window.
    fn limits(&self, look: &Look, window: Window) -> PerPlane<f64> {
        let of_light = self.response.as_ref().map(|_| look.largest);
        if let Some(limit) = of_light.or(self.options.camera.saturation) {
            return smallvec![limit; look.planes.len()];
        }
        let mut known = look.limits.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, limits)) = known.iter().find(|(seen, _)| *seen == window) {
            return limits.clone();
        }
        let limits: PerPlane<f64> = look.planes.iter().map(|plane| limit(plane, window, look.largest)).collect();
        known.push((window, limits.clone()));
        limits
    }

    /// The window around targets with these parameters; all there is where that cannot be said.
    pub fn window(&self, look: &Look, parameters: &[f64], margin: Margin) -> Window {
        self.reach.window(self.model(), parameters, margin, look.window).unwrap_or(look.window)
    }

    /// Fits from `start` in the window around it, and in a larger one when the fit leads out of that.
    pub fn attempt(
        &self,
        look: &Look,
        start: &[f64],
        begin: Begin,
        control: Control,
        margin: Margin,
    ) -> Result<Attempt, CompileFailure> {
        let mut window = self.window(look, start, margin);
        let mut view = self.view(look, window);
        let mut fitted = self.fit(look, &view, start, begin, control)?;
        for _ in 1..WINDOWS {
            if !fitted.ending.is_fit() || holds(window, self.window(look, &fitted.parameters, Margin::NONE)) {
                break;
            }
            window = self.window(look, &fitted.parameters, margin);
            view = self.view(look, window);
            let again = self.fit(look, &view, &fitted.parameters, Begin::Anywhere, control)?;
            fitted = again.after(&fitted.stages);
        }
        let rejection = self.rejection(&fitted, &view, look.window);
        Ok(Attempt::of(fitted, rejection))
    }

    /// A fit in a window. Where the model leaves its quadrature open, one that begins nearby samples as it has to. `NoTarget` where
    /// one that does not lead there has nothing to fit.
    fn fit(
        &self,
        look: &Look,
        view: &View,
        start: &[f64],
        begin: Begin,
        control: Control,
    ) -> Result<Fit, CompileFailure> {
        let Begin::Nearby(before) = begin else {
            return fit(&self.compiled, view, &self.constants, start, control);
        };
        let short = match self.sampling(look, view) {
            Some(sampling) => self.sampled_fit(&sampling, view, start, before, Way::Short),
            None => fit_nearby(&self.compiled, view, &self.constants, start)?,
        };
        match short {
            Some(fit) => Ok(fit),
            // Where there is no short way, that none led there says nothing.
            None if self.compiled.short_stage().is_some() && self.is_gone(view, start) => {
                Ok(Fit { ending: Ending::NoTarget, ..Fit::at(start.to_vec()) })
            }
            None => fit(&self.compiled, view, &self.constants, start, control),
        }
    }

    /// A fit that samples as it has to. Where its kernels cannot be made, fits go on without from then on.
    pub(super) fn sampled_fit(
        &self,
        sampling: &Sampling,
        view: &View,
        start: &[f64],
        before: Option<&Chosen>,
        way: Way,
    ) -> Option<Fit> {
        let domain =
            |at: &[f64]| self.reach.window(self.model(), at, DOMAIN_MARGIN, view.window).unwrap_or(view.window);
        let fit = sampling.fit(view, &domain, &self.constants, start, before, way);
        fit.inspect_err(|_| self.compiled.sampling_shelf().give_up()).ok().flatten()
    }

    /// What a fit samples with, where the model leaves that open; `None` while it is being prepared, and where there is nothing.
    pub(super) fn sampling(&self, look: &Look, view: &View) -> Option<Arc<Sampling>> {
        if !Sampling::applies(&self.compiled) || self.geometry.is_some() {
            return None;
        }
        let ready = match self.options.preparing {
            Preparing::AtOnce => Some(self.compiled.sampling()),
            Preparing::Beside => look.ready.sampling(&self.compiled, &view.layout),
        };
        if ready.is_none() {
            look.want(Preparation::new(&self.compiled, view, Lacking::Sampling));
        }
        ready.filter(|sampling| !sampling.is_empty())
    }

    /// How a fit sampled pixels, where the model leaves that open.
    pub fn sampled(&self, fit: &Fit) -> Option<Sampled> {
        let points = Quadrature::AUTO as u32;
        let unchosen = (self.model().quadrature() == Quadrature::Auto).then_some(Sampled { points, slopes: points });
        fit.chosen.as_ref().map(|chosen| chosen.sampled).or(unchosen)
    }

    /// What hangs together in the residuals of a fit; the variance of what rows are off by where the fit did not know.
    pub(super) fn structure(&self, look: &Look, fit: &Fit) -> Option<(Structure, Option<f64>)> {
        let view = self.view(look, self.window(look, &fit.parameters, Margin::NONE));
        let predictions = self.compiled.predictions()?;
        let mut seen = predictions.residuals(&view, &fit.parameters, &self.constants, Over::Domain)?;
        let width = view.window.width;
        let rows = seen.first_mut().filter(|_| self.asks_for_rows(look)).and_then(|seen| {
            let variance = seen.row_variance(width)?;
            seen.without_offsets(width, variance);
            self.of_plane(variance)
        });
        let structure = Structure::of(&seen, [width, view.window.height], self.model().coordinates().len())?;
        Some((structure, rows))
    }

    /// The same in a frame of that size; `None` where nothing of the domain is inside.
    pub fn reach_window(&self, parameters: &[f64], margin: Margin, whole: Window) -> Option<Window> {
        self.reach.window(self.model(), parameters, margin, whole)
    }

    /// The pixel value at which the camera clips, as it shows around a target; infinite where it does not.
    pub fn limit(&self, look: &Look, parameters: &[f64]) -> Option<f64> {
        self.limits(look, self.window(look, parameters, Margin::NONE)).into_iter().reduce(f64::min)
    }

    /// True when windows around targets are smaller than the frame.
    pub fn reaches(&self) -> bool {
        self.reach.is_known()
    }

    /// The domain of a target that is followed, to be left out of a search; `None` where it is not known.
    pub fn mask(&self, look: &Look, parameters: &[f64]) -> Option<Mask> {
        let window = self.window(look, parameters, Margin::NONE);
        let roles = self.model().roles().first().filter(|_| self.reaches())?;
        let dimensions = self.model().coordinates().len();
        let (a, reach) = (shape(roles, dimensions, parameters)?, self.reach.outlines()?);
        let origin = look.window.first();
        let mut mask = Mask {
            first: std::array::from_fn(|axis| window.first()[axis] - origin[axis]),
            size: window.size(),
            centre: [0.0; 4],
            extent: [[0.0; 4]; 4],
        };
        for (axis, parameter) in roles.centre.iter().enumerate() {
            mask.centre[axis] = parameters[parameter.index()] - origin[axis] as f64;
            for other in 0..dimensions {
                mask.extent[axis][other] = a[(axis, other)] / (reach * reach);
            }
        }
        Some(mask)
    }

    /// Why a fit is not believed.
    pub(super) fn rejection(&self, fit: &Fit, view: &View, whole: Window) -> Option<Rejection> {
        let model = self.model();
        if !fit.is_usable() {
            return Some(Rejection::Ending);
        }
        // One spot of several leaves the spin open: there is a pose for each of its values.
        let is_known = |worth: &Worth| worth.covariance.is_some() || worth.is_placed && !self.fits_pose();
        if !fit.worth.as_ref().is_none_or(is_known) {
            return Some(Rejection::Ending);
        }
        if !model.constraints_hold(&fit.parameters, &self.constants) {
            return Some(Rejection::OutsideBounds);
        }
        let (first, size) = (whole.first(), whole.size());
        let dimensions = model.coordinates().len();
        // A pose has spots to spare: it is believed while two of them shine.
        let (mut shining, mut known) = (0, 0);
        for roles in model.roles() {
            for ((parameter, first), size) in roles.centre.iter().zip(first).zip(size) {
                let place = fit.parameters[parameter.index()] - first as f64;
                if !(place >= -0.5 && place <= size as f64 - 0.5) {
                    return Some(Rejection::OutsideWindow);
                }
            }
            if let Some(least) = least_bend(roles, dimensions, &fit.parameters).filter(|_| dimensions > 1) {
                let longest = size.into_iter().max().unwrap_or(1) as f64;
                if least * longest.powi(2) < 1.0 {
                    return Some(Rejection::Oversized);
                }
            }
            // Whole pixel values are rounded: a blank frame is not known better than that.
            let floor = if model.has_noise() { 0.0 } else { view.quantisation() };
            let reduced = fit.worth.as_ref().and_then(|worth| worth.reduced).unwrap_or(0.0);
            let blank = if reduced < floor { floor / reduced.max(floor * f64::EPSILON) } else { 1.0 };
            let brightness = faint::is_bright(self.compiled.last_parameters(), fit, roles, blank, view.window.pixels());
            known += usize::from(brightness.is_some());
            shining += usize::from(brightness == Some(true));
            if !self.fits_pose() && brightness == Some(false) {
                return Some(Rejection::Faint);
            }
        }
        // One spot alone leaves the spin open, and does not say which of them it is.
        let needed = if self.geometry.as_ref().is_some_and(Geometry::has_spin) { known.min(2) } else { known.min(1) };
        (self.fits_pose() && shining < needed).then_some(Rejection::Faint)
    }

    /// e-folds between the size and brightness that a session's starting values state, and those of a fit; 0 where none are stated.
    pub fn off_stated(&self, parameters: &[f64]) -> f64 {
        let start = self.options.start_of(self.model());
        let stated: Vec<f64> = start.iter().map(|value| value.unwrap_or(f64::NAN)).collect();
        let (stated, fitted) = (self.looks(&stated), self.looks(parameters));
        let off = |stated: Option<f64>, fitted: Option<f64>| stated.zip(fitted).map_or(0.0, |(a, b)| a - b);
        off(stated.0, fitted.0).hypot(off(stated.1, fitted.1))
    }

    /// ln of the product of the outlines' half widths and ln |brightness|, of the first target; absent without the roles.
    pub fn looks(&self, parameters: &[f64]) -> (Option<f64>, Option<f64>) {
        let Some(roles) = self.model().roles().first() else { return (None, None) };
        let dimensions = self.model().coordinates().len();
        let widths = half_widths(roles, dimensions, parameters);
        let size = widths.map(|widths| widths.product::<f64>().ln()).filter(|size| size.is_finite());
        let brightness = roles.brightness.map(|parameter| parameters[parameter.index()].abs().ln());
        (size.filter(|_| !roles.shape.is_empty()), brightness.filter(|brightness| brightness.is_finite()))
    }
}
