//! `Solver`: a model's kernels with a session's options, ready to fit a target anywhere in a frame. It keeps nothing of
//! earlier frames.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use isophote_jit::{PlaneView, Window};
use isophote_symbolic::{Model, Quadrature};
use smallvec::smallvec;

use super::faint;
use super::rival::Rival;
use super::window::{Margin, Reach, contains};
use crate::budget::{FrameBudget, Stop};
use crate::estimate::{Ending, Rejection, Sampled};
use crate::options::TrackerOptions;
use crate::outline::{half_widths, least_bend, shape};
use crate::photometry::Profiles;
use crate::pose::Geometry;
use crate::sight::detect::{Bank, Strength};
use crate::sight::gaps::{Gaps, overlap};
use crate::sight::grey::{brightest, row_shares};
use crate::sight::mask::Mask;
use crate::sight::view::{PerPlane, View, limit, summable};
use crate::solve::compiled::Compiled;
use crate::solve::fit::{Fit, StartKind, fit, fit_nearby};
use crate::solve::passes::FitSummary;
use crate::solve::prepare::{MissingKernels, Preparation, Preparing};
use crate::solve::readiness::{FrameReadiness, Readiness};
use crate::solve::residuals::Over;
use crate::solve::sampling::{FitMethod, Sampling, SamplingChoice};
use crate::solve::stage_kernels::{CompileFailure, PixelHandling};
use crate::solve::structure::Structure;
use isophote_frame::{Frame, Response};

/// Margin around a domain, since the walk that finds its reach is approximate.
const DOMAIN_MARGIN: Margin = Margin { share: 0.05, px: [2.0; 4] };
/// Largest number of windows for a fit: one whose domain leaves its window is repeated in another.
const WINDOWS: usize = 4;

/// The kernels, constants and camera data of a tracker's fits.
pub(crate) struct Solver {
    pub compiled: Arc<Compiled>,
    pub options: TrackerOptions,
    pub constants: Vec<f64>,
    /// Lens and target, when the model's parameters are a pose.
    pub geometry: Option<Geometry>,
    /// Templates of the target, for searches.
    pub bank: Option<Arc<Bank>>,
    /// The camera's response, where its values are not linear in light.
    response: Option<Response>,
    /// The pixels that the camera's defect map leaves out.
    pub gaps: Option<Gaps>,
    /// The variance of row offsets in each entry of `observed`, over that of a plane; empty where rows cannot be distinguished.
    pub(super) row_shares: Vec<f64>,
    pub reach: Reach,
    pub(super) profiles: Profiles,
}

/// The part of a frame that fits and searches may use.
pub(crate) struct FrameContext<'a> {
    planes: Vec<PlaneView<'a>>,
    pub window: Window,
    /// The largest value that its pixels can hold.
    largest: f64,
    /// The saturation limits of each window that was used.
    limits: Mutex<Vec<(Window, PerPlane<f64>)>>,
    /// The work budget; `None` where nothing bounds it.
    budget: Option<&'a FrameBudget<'a>>,
    /// Kernels that a fit lacked.
    requested_kernels: OnceLock<Preparation>,
    /// Kernels available to its fits beside the model's own.
    pub ready: Arc<Readiness>,
    /// The variance of row offsets, once known.
    rows: OnceLock<f64>,
}

impl<'a> FrameContext<'a> {
    /// The same within a budget.
    pub fn with_budget(self, budget: &'a FrameBudget<'a>) -> FrameContext<'a> {
        FrameContext { budget: Some(budget), ..self }
    }

    /// The same with the kernels that its fits had before, to replay a frame.
    pub fn with_readiness(self, ready: Option<FrameReadiness>) -> FrameContext<'a> {
        FrameContext { ready: Arc::new(Readiness::of(ready)), ..self }
    }

    /// The same for a part of its work, with a `requested_kernels` of its own.
    pub fn for_part<'b>(&self, budget: &'b FrameBudget<'b>) -> FrameContext<'b>
    where
        'a: 'b,
    {
        let limits = self.limits.lock().unwrap_or_else(PoisonError::into_inner).clone();
        FrameContext {
            rows: self.rows.clone(),
            planes: self.planes.clone(),
            limits: Mutex::new(limits),
            budget: Some(budget),
            requested_kernels: OnceLock::new(),
            ready: self.ready.clone(),
            ..*self
        }
    }

    /// Takes over the row variance that a part learned, and the kernels that it lacked.
    pub fn take_from(&self, part: &FrameContext) {
        part.requested_kernels().cloned().into_iter().for_each(|preparation| self.request_kernels(preparation));
        part.row_variance().into_iter().for_each(|variance| self.learn_rows(variance));
    }

    /// A budget for a part of its work.
    pub fn budget(&self, work: u64) -> FrameBudget<'_> {
        FrameBudget::part(work, self.budget)
    }

    /// Spends units of its budget.
    pub fn spend(&self, units: u64) -> Result<(), Stop> {
        self.budget.map_or(Ok(()), |budget| budget.spend(units))
    }

    /// The ending, when the budget stopped it.
    pub fn unfinished(&self) -> Option<Ending> {
        self.budget.and_then(FrameBudget::stopped).map(Ending::from)
    }

    /// The same for a smaller window; `None` where that is outside.
    pub fn narrowed(&self, window: Window) -> Option<FrameContext<'a>> {
        let (planes, limits, requested_kernels) = (self.planes.clone(), Mutex::default(), OnceLock::new());
        let (ready, rows) = (self.ready.clone(), self.rows.clone());
        Some(FrameContext {
            planes,
            window: overlap(window, self.window)?,
            limits,
            requested_kernels,
            ready,
            rows,
            ..*self
        })
    }

    /// Requests a search of the whole window from the budget.
    pub fn search(&self) -> Result<(), Stop> {
        self.budget.map_or(Ok(()), FrameBudget::search)
    }

    /// Requests kernels that a fit lacked; the first request is kept.
    pub fn request_kernels(&self, preparation: Preparation) {
        self.requested_kernels.get_or_init(|| preparation);
    }

    /// The variance of row offsets, pixel values², where it is known.
    pub fn row_variance(&self) -> Option<f64> {
        self.rows.get().copied()
    }

    /// Sets the variance of row offsets, unless it is known.
    pub fn learn_rows(&self, variance: f64) {
        self.rows.get_or_init(|| variance);
    }

    /// The kernels that fits lacked.
    pub fn requested_kernels(&self) -> Option<&Preparation> {
        self.requested_kernels.get()
    }
}

/// One fit of a frame, or none.
#[derive(Clone, Debug)]
pub(crate) struct Attempt {
    pub fit: Option<Fit>,
    pub ending: Ending,
    pub rejection: Option<Rejection>,
    /// Of poses: the less likely one.
    pub rival: Option<Rival>,
    /// Of a search: the strongest detection by the document's own image.
    pub strongest: Option<Strength>,
    /// Of poses: the mirrored ones were tried.
    pub is_other_tried: bool,
}

impl Attempt {
    /// A fit, and why it is rejected, if it is.
    pub fn of(fit: Fit, rejection: Option<Rejection>) -> Attempt {
        let nothing = Attempt::none(fit.ending);
        Attempt { fit: Some(fit), rejection, ..nothing }
    }

    /// An attempt without a fit.
    pub fn none(ending: Ending) -> Attempt {
        let rejection = Some(Rejection::Ending);
        Attempt { fit: None, ending, rejection, rival: None, strongest: None, is_other_tried: false }
    }

    pub fn is_good(&self) -> bool {
        self.rejection.is_none()
    }

    /// χ²/ν.
    pub fn reduced_chi_square(&self) -> Option<f64> {
        self.fit.as_ref()?.summary.as_ref()?.reduced_chi_square
    }
}

impl Solver {
    /// `options` must suit the model.
    pub fn new(compiled: Arc<Compiled>, options: TrackerOptions) -> Solver {
        let constants = options.constants_of(compiled.model());
        let reach = Reach::of(compiled.model(), &constants);
        let geometry = Geometry::of(compiled.model(), &constants);
        let bank = compiled.bank(&constants);
        let gaps = options.camera.defect_map.as_ref().and_then(Gaps::of);
        // An invalid response was rejected with the options.
        let response = options.camera.linear_response().ok().flatten();
        let row_shares = row_shares(compiled.model(), &constants);
        let profiles = Profiles::default();
        Solver { compiled, options, constants, geometry, bank, response, gaps, row_shares, reach, profiles }
    }

    pub fn model(&self) -> &Model {
        self.compiled.model()
    }

    /// The frame as fits see it: linearised where the camera has a response, without values too large for sums, and
    /// with defects mended where there is a map. Response and map are skipped if they are for another frame size.
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
            // Values of a camera, and values computed from them, are within its range.
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

    /// The usable part of a mended frame; `None` when the frame does not suit the model.
    pub fn context<'a>(&self, frame: &'a Frame) -> Option<FrameContext<'a>> {
        let model = self.model();
        let dimensions = model.coordinates().len();
        let has_dimensions = frame.size().len() == dimensions || (dimensions == 1 && frame.rows() == 1);
        let suits = has_dimensions && self.options.check_size(model, frame.size()).is_ok();
        let planes = frame.planes_of(model.channels()).filter(|_| suits)?;
        let full_frame = Window::of_size(frame.sides());
        let window = self.options.window.unwrap_or(full_frame).clipped_to(frame.sides())?;
        let planes = planes.into_iter().map(|plane| frame.plane_view(plane)).collect();
        let largest = frame.largest.unwrap_or(f64::INFINITY);
        let (limits, requested_kernels, ready) = (Mutex::default(), OnceLock::new(), Arc::default());
        let context = FrameContext {
            planes,
            window,
            largest,
            limits,
            budget: None,
            requested_kernels,
            ready,
            rows: OnceLock::new(),
        };
        self.options.camera.row_variance().into_iter().for_each(|variance| context.learn_rows(variance));
        Some(context)
    }

    /// A window of the usable part, with its limits, gaps and row offsets.
    pub fn view<'a>(&self, context: &FrameContext<'a>, window: Window) -> View<'a> {
        let view = View::new(context.planes.clone(), window, self.limits(context, window), self.compiled.precision());
        let gaps = self.gaps.as_ref().map(|gaps| gaps.inside(window)).unwrap_or_default();
        let view = View { budget: context.budget, gaps, ..view };
        self.with_rows(context, view, context.row_variance())
    }

    /// One saturation limit per plane: the camera's (in light where it has a response), else the one that the window's
    /// pixels show, at most what the source's pixels can hold. Computed once per frame and window.
    fn limits(&self, context: &FrameContext, window: Window) -> PerPlane<f64> {
        let of_light = self.response.as_ref().map(|_| context.largest);
        if let Some(limit) = of_light.or(self.options.camera.saturation) {
            return smallvec![limit; context.planes.len()];
        }
        let mut known = context.limits.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, limits)) = known.iter().find(|(seen, _)| *seen == window) {
            return limits.clone();
        }
        let limits: PerPlane<f64> = context.planes.iter().map(|plane| limit(plane, window, context.largest)).collect();
        known.push((window, limits.clone()));
        limits
    }

    /// The window around targets with these parameters; the whole one where that cannot be computed.
    pub fn window(&self, context: &FrameContext, parameters: &[f64], margin: Margin) -> Window {
        self.reach.window(self.model(), parameters, margin, context.window).unwrap_or(context.window)
    }

    /// Fits from `start` in the window around it, and again in the window around the result where that leaves the first.
    pub fn attempt(
        &self,
        context: &FrameContext,
        start: &[f64],
        start_kind: StartKind,
        handling: PixelHandling,
        margin: Margin,
    ) -> Result<Attempt, CompileFailure> {
        let mut window = self.window(context, start, margin);
        let mut view = self.view(context, window);
        let mut fitted = self.fit(context, &view, start, start_kind, handling)?;
        for _ in 1..WINDOWS {
            if !fitted.ending.is_fit() || contains(window, self.window(context, &fitted.parameters, Margin::NONE)) {
                break;
            }
            window = self.window(context, &fitted.parameters, margin);
            view = self.view(context, window);
            let again = self.fit(context, &view, &fitted.parameters, StartKind::Anywhere, handling)?;
            fitted = again.after(&fitted.stages);
        }
        let rejection = self.rejection(&fitted, &view, context.window);
        Ok(Attempt::of(fitted, rejection))
    }

    /// A fit in a window. One that begins nearby chooses its sampling where the model leaves the quadrature open.
    fn fit(
        &self,
        context: &FrameContext,
        view: &View,
        start: &[f64],
        start_kind: StartKind,
        handling: PixelHandling,
    ) -> Result<Fit, CompileFailure> {
        let StartKind::Nearby(before) = start_kind else {
            return fit(&self.compiled, view, &self.constants, start, handling);
        };
        let short = match self.sampling(context, view) {
            Some(sampling) => self.sampled_fit(&sampling, view, start, before, FitMethod::RefineOnly),
            None => fit_nearby(&self.compiled, view, &self.constants, start)?,
        };
        short.map_or_else(|| fit(&self.compiled, view, &self.constants, start, handling), Ok)
    }

    /// A fit with chosen sampling. If its kernels cannot be made, later fits do without.
    pub(super) fn sampled_fit(
        &self,
        sampling: &Sampling,
        view: &View,
        start: &[f64],
        before: Option<&SamplingChoice>,
        method: FitMethod,
    ) -> Option<Fit> {
        let domain =
            |at: &[f64]| self.reach.window(self.model(), at, DOMAIN_MARGIN, view.window).unwrap_or(view.window);
        let fit = sampling.fit(view, &domain, &self.constants, start, before, method);
        fit.inspect_err(|_| self.compiled.prepared_sampling().mark_failed()).ok().flatten()
    }

    /// The sampling kernels, where the model leaves the quadrature open; `None` while they are being prepared, and
    /// where there are none.
    pub(super) fn sampling(&self, context: &FrameContext, view: &View) -> Option<Arc<Sampling>> {
        if !Sampling::applies(&self.compiled) || self.geometry.is_some() {
            return None;
        }
        let ready = match self.options.preparing {
            Preparing::AtOnce => Some(self.compiled.sampling()),
            Preparing::Beside => context.ready.sampling(&self.compiled, &view.layout),
        };
        if ready.is_none() {
            context.request_kernels(Preparation::new(&self.compiled, view, MissingKernels::Sampling));
        }
        ready.filter(|sampling| !sampling.is_empty())
    }

    /// How a fit sampled pixels, where the model leaves the quadrature open.
    pub fn sampled(&self, fit: &Fit) -> Option<Sampled> {
        let points = Quadrature::AUTO as u32;
        let unchosen = (self.model().quadrature() == Quadrature::Auto).then_some(Sampled { points, slopes: points });
        fit.sampling_choice.as_ref().map(|sampling_choice| sampling_choice.sampled).or(unchosen)
    }

    /// The correlation of a fit's residuals, and the variance of row offsets where the fit did not model them.
    pub(super) fn structure(&self, context: &FrameContext, fit: &Fit) -> Option<(Structure, Option<f64>)> {
        let view = self.view(context, self.window(context, &fit.parameters, Margin::NONE));
        let predictions = self.compiled.predictions()?;
        let mut seen = predictions.residuals(&view, &fit.parameters, &self.constants, Over::Domain)?;
        let width = view.window.width;
        let rows = seen.first_mut().filter(|_| self.asks_for_rows(context)).and_then(|seen| {
            let variance = seen.row_variance(width)?;
            seen.without_offsets(width, variance);
            self.of_plane(variance)
        });
        let structure = Structure::of(&seen, [width, view.window.height], self.model().coordinates().len())?;
        Some((structure, rows))
    }

    /// The window around targets inside `bounds`; `None` where nothing of the domain is inside.
    pub fn reach_window(&self, parameters: &[f64], margin: Margin, bounds: Window) -> Option<Window> {
        self.reach.window(self.model(), parameters, margin, bounds)
    }

    /// The saturation limit around a target; infinite where there is none.
    pub fn limit(&self, context: &FrameContext, parameters: &[f64]) -> Option<f64> {
        self.limits(context, self.window(context, parameters, Margin::NONE)).into_iter().reduce(f64::min)
    }

    /// True when windows around targets are smaller than the frame.
    pub fn reaches(&self) -> bool {
        self.reach.is_known()
    }

    /// The domain of a target that is followed, to be left out of a search; `None` where it is not known.
    pub fn mask(&self, context: &FrameContext, parameters: &[f64]) -> Option<Mask> {
        let window = self.window(context, parameters, Margin::NONE);
        let roles = self.model().roles().first().filter(|_| self.reaches())?;
        let dimensions = self.model().coordinates().len();
        let (a, reach) = (shape(roles, dimensions, parameters)?, self.reach.outlines()?);
        let origin = context.window.first();
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

    /// Why a fit is rejected.
    pub(super) fn rejection(&self, fit: &Fit, view: &View, bounds: Window) -> Option<Rejection> {
        let model = self.model();
        if !fit.is_usable() {
            return Some(Rejection::Ending);
        }
        // One spot of several leaves the spin open: there is a pose for each of its values.
        let is_known =
            |summary: &FitSummary| summary.covariance.is_some() || summary.determines_position && !self.fits_pose();
        if !fit.summary.as_ref().is_none_or(is_known) {
            return Some(Rejection::Ending);
        }
        if !model.constraints_hold(&fit.parameters, &self.constants) {
            return Some(Rejection::OutsideBounds);
        }
        let (first, size) = (bounds.first(), bounds.size());
        let dimensions = model.coordinates().len();
        if !self.is_of_wanted_size(&fit.parameters) {
            return Some(Rejection::OutsideBounds);
        }
        // A pose has spots to spare: it is accepted while two of them shine.
        let (mut shining, mut known) = (0, 0);
        for roles in model.roles() {
            for ((parameter, first), size) in roles.centre.iter().zip(first).zip(size) {
                let position = fit.parameters[parameter.index()] - first as f64;
                if !(position >= -0.5 && position <= size as f64 - 0.5) {
                    return Some(Rejection::OutsideWindow);
                }
            }
            if let Some(least) = least_bend(roles, dimensions, &fit.parameters).filter(|_| dimensions > 1) {
                let longest = size.into_iter().max().unwrap_or(1) as f64;
                if least * longest.powi(2) < 1.0 {
                    return Some(Rejection::Oversized);
                }
            }
            // Integer pixel values are rounded: a blank frame's noise is no less than that.
            let floor = if model.has_noise() { 0.0 } else { view.quantisation() };
            let reduced = fit.summary.as_ref().and_then(|summary| summary.reduced_chi_square).unwrap_or(0.0);
            let blank = if reduced < floor { floor / reduced.max(floor * f64::EPSILON) } else { 1.0 };
            let order = self.compiled.last_parameters();
            let brightness = match self.options.snr_min {
                Some(least) => faint::snr(order, fit, roles).map(|snr| snr >= least),
                None => faint::is_bright(order, fit, roles, blank, view.window.pixels()),
            };
            known += usize::from(brightness.is_some());
            shining += usize::from(brightness == Some(true));
            if !self.fits_pose() && brightness == Some(false) {
                return Some(Rejection::Faint);
            }
        }
        // One spot alone leaves the spin open, and may be any of them.
        let needed = if self.geometry.as_ref().is_some_and(Geometry::has_spin) { known.min(2) } else { known.min(1) };
        (self.fits_pose() && shining < needed).then_some(Rejection::Faint)
    }

    /// e-folds between the size and brightness that a session's starting values state, and those of a fit; 0 where none are stated.
    pub fn off_stated(&self, parameters: &[f64]) -> f64 {
        let start = self.options.start_of(self.model());
        let stated: Vec<f64> = start.iter().map(|value| value.unwrap_or(f64::NAN)).collect();
        let (stated, fitted) = (self.ln_size_and_brightness(&stated), self.ln_size_and_brightness(parameters));
        let off = |stated: Option<f64>, fitted: Option<f64>| stated.zip(fitted).map_or(0.0, |(a, b)| a - b);
        off(stated.0, fitted.0).hypot(off(stated.1, fitted.1))
    }

    /// False for sizes outside of the session's range.
    pub fn is_of_wanted_size(&self, parameters: &[f64]) -> bool {
        let dimensions = self.model().coordinates().len() as f64;
        let mean = self.ln_size_and_brightness(parameters).0.map(|ln_size| (ln_size / dimensions).exp());
        let wanted = self.options.sizes_px.zip(mean);
        wanted.is_none_or(|([least, most], size)| (least..=most).contains(&size))
    }

    /// ln of the product of the outlines' half widths and ln |brightness|, of the first target; absent without the roles.
    pub fn ln_size_and_brightness(&self, parameters: &[f64]) -> (Option<f64>, Option<f64>) {
        let Some(roles) = self.model().roles().first() else { return (None, None) };
        let dimensions = self.model().coordinates().len();
        let widths = half_widths(roles, dimensions, parameters);
        let size = widths.map(|widths| widths.product::<f64>().ln()).filter(|size| size.is_finite());
        let brightness = roles.brightness.map(|parameter| parameters[parameter.index()].abs().ln());
        (size.filter(|_| !roles.shape.is_empty()), brightness.filter(|brightness| brightness.is_finite()))
    }
}
