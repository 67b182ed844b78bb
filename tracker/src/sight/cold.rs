//! A cold start: complete starting values from a window alone.

use isophote_symbolic::{Estimator, Model, ParameterId, Roles, Start};

use crate::pose;
use crate::sight::colours::{Colours, Whereabouts};
use crate::sight::detect::{Bank, DetectOptions, DetectionThreshold, Strength};
use crate::sight::grey::{Grey, Mixture};
use crate::sight::halved::find_halved;
use crate::sight::mask::Mask;
use crate::sight::start::{Detection, FindOptions, Sign, find};
use crate::sight::view::View;
use crate::sight::wave::given_by_wave;

/// The candidates of a cold start.
pub(crate) struct ColdStarts {
    /// Candidates for the target, the likeliest first.
    pub candidates: Vec<CandidateStarts>,
    /// Saturated pixels of the window.
    pub saturated: usize,
    /// The first candidate is at the given position of the target.
    pub is_at_given_position: bool,
}

/// The resolution of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Resolution {
    /// Full resolution.
    Full,
    /// Cells of four pixels.
    Halved,
}

/// Starting values for one candidate.
pub(crate) struct CandidateStarts {
    /// Full parameter vectors.
    pub starts: Vec<Vec<f64>>,
    /// Starts with other outlines, tighter for significant things, wider for faint ones: tried when none of `starts` leads
    /// to an acceptable fit, and where the document lists numbers.
    pub alternatives: Vec<Vec<f64>>,
    /// The square of its height times its area; absent where nothing was seen.
    pub energy: Option<f64>,
}

/// From this many saturated pixels on the visible amplitude is too small.
const CLIPPED_PIXELS: usize = 10;
/// Factor on the amplitude of an additional start for saturated targets.
const BRIGHTER: f64 = 2.5;
/// Number of further candidates where targets are distinguished by colour.
const EXTRA_DETECTIONS: usize = 5;
/// Factor on A for the tighter start. Where the domain ends at the outline and nothing models what lies beyond, a fit that
/// begins with too large an outline takes the surroundings for its rim and grows without limit; one that begins inside the
/// target does not.
const TIGHTER: f64 = 2.5;
/// Factor on a faint candidate's outline for its other start.
const WIDER: f64 = 1.5;
/// Factors on the outline of a candidate that may be the tip of something larger.
const WIDER_OUTLINES: [f64; 2] = [2.0, 4.0];
/// Error of a given position, in sizes of the target.
const POSITION_ERROR: f64 = 4.0;
/// Largest share of frames in which noise alone may be detected.
pub(crate) const FALSE_ALARMS: f64 = 0.01;

impl ColdStarts {
    /// Starting values by precedence: `given` numbers, the model's own numbers, then its estimators; for up to
    /// `candidates_max` candidates with a model of one target. `None` when an estimator is needed and no target is
    /// found.
    pub fn search(
        model: &Model,
        view: &View,
        constants: &[f64],
        given: &[Option<f64>],
        candidates_max: usize,
        masks: Vec<Mask>,
        resolution: Resolution,
    ) -> Option<ColdStarts> {
        view.spend(view.window.pixels()).ok()?;
        let spend = |units| view.budget.map_or(Ok(()), |budget| budget.spend(units));
        let mixture = Mixture::observed(model, constants);
        let read = if resolution == Resolution::Halved { Grey::read_halved } else { Grey::read };
        let grey = read(&view.planes, view.window, &view.saturation, &mixture);
        let saturated = grey.saturated();
        let origin = view.window.first().map(|at| at as f64);
        let step = if resolution == Resolution::Halved { 2.0 } else { 1.0 };
        let given = &given_by_wave(model, given, &grey, step, origin)?[..];
        let estimators = estimators(model, given);
        if estimators.iter().all(Option::is_none) {
            let candidates = vec![starts(model, given, &[], &estimators, origin)];
            return Some(ColdStarts { candidates, saturated, is_at_given_position: true });
        }
        let mut options = find_options(model, given, origin);
        if let Some(geometry) = pose::Geometry::of(model, constants) {
            options.targets_max = pose::OUTLINES_MAX.max(geometry.target.spots.len());
            (options.faint, options.masks) = (true, masks);
            let found = find(&grey, &options, &spend).ok()?;
            let starts = pose_starts(model, &geometry, &found.detections, given, view)?;
            let candidates = vec![CandidateStarts { starts, alternatives: Vec::new(), energy: None }];
            return Some(ColdStarts { candidates, saturated, is_at_given_position: false });
        }
        let targets = model.roles().len().max(1);
        let several = if targets == 1 { candidates_max } else { 1 };
        let colours = Colours::of(model, constants);
        (options.targets_max, options.faint, options.masks) = (targets.max(several), several > 1, masks);
        if colours.is_some() && targets > 1 {
            // The faintest target may be far below the brightest, with other things in between.
            (options.targets_max, options.faint) = (targets + EXTRA_DETECTIONS, true);
        }
        let find = if resolution == Resolution::Halved { find_halved } else { find };
        let found = find(&grey, &options, &spend).ok()?;
        if found.detections.len() < targets {
            return None;
        }
        let is_at_given_position = options.near.is_some();
        let first = if is_at_given_position { Whereabouts::Known } else { Whereabouts::Unknown };
        let groups: Vec<&[Detection]> = match (&colours, targets) {
            (_, 1) => found.detections.iter().map(std::slice::from_ref).collect(),
            (Some(_), _) => vec![&found.detections[..]],
            (None, _) => vec![&found.detections[..targets]],
        };
        let start = |detections: &[Detection]| match &colours {
            Some(colours) => {
                let (detections, given) = colours.sorted(view, detections, given, first)?;
                Some(starts(model, &given, &detections, &estimators, origin))
            }
            None => Some(starts(model, given, detections, &estimators, origin)),
        };
        let candidates: Vec<CandidateStarts> = groups.into_iter().filter_map(start).collect();
        (!candidates.is_empty()).then_some(ColdStarts { candidates, saturated, is_at_given_position })
    }
}

/// Detections by the document's own image, as starting values.
pub(crate) struct TemplateStarts {
    /// The strongest first; with a given position, the nearest.
    pub candidates: Vec<CandidateStarts>,
    /// Larger things whose tips these may be: tried when no fit of the others is acceptable.
    pub larger: Vec<CandidateStarts>,
    /// The strongest peak, significant or not.
    pub strongest: Option<Strength>,
    /// Saturated pixels of the window.
    pub saturated: usize,
}

impl TemplateStarts {
    /// Detects with a bank of templates; the document states the sign.
    pub fn detect(
        model: &Model,
        view: &View,
        constants: &[f64],
        given: &[Option<f64>],
        bank: &Bank,
        criteria: DetectOptions,
    ) -> Option<TemplateStarts> {
        view.spend(view.window.pixels()).ok()?;
        let mixture = Mixture::observed(model, constants);
        let grey = Grey::read(&view.planes, view.window, &view.saturation, &mixture);
        let origin = view.window.first().map(|at| at as f64);
        let FindOptions { sign, near, .. } = find_options(model, given, origin);
        let spend = |units| view.budget.map_or(Ok(()), |budget| budget.spend(units));
        let options = DetectOptions { sign, ..criteria };
        let mut detections = bank.detect(model, constants, &grey, &options, &spend).ok()?;
        let is_uneven = detections.bumps > 0.0;
        let is_wanted = matches!(options.threshold, DetectionThreshold::Snr(_));
        // An overexposed target needs no detection except among bumps, and its rim matches anything.
        let is_clear = |detection: &Detection| grey.saturated_about(detection.centre, detection.size) <= CLIPPED_PIXELS;
        detections.all.retain(|detection| is_uneven || is_wanted || is_clear(detection));
        let to = |near: [f64; 4], detection: &Detection| {
            (detection.centre[0] - near[0]).hypot(detection.centre[1] - near[1])
        };
        let off = |detection: &Detection| near.map_or(f64::INFINITY, |near| to(near, detection));
        detections.all.sort_by(|a, b| off(a).total_cmp(&off(b)));
        // A given position is approximate: a detection there is the target.
        let found = found_places(model, given);
        let of = |detection: &Detection, by: f64| {
            let is_at_position = off(detection) <= POSITION_ERROR * detection.size[0].max(detection.size[1]);
            let given = if is_at_position { &found[..] } else { given };
            starts(model, given, &[detection.widened(by)], &estimators(model, given), origin)
        };
        // Where a fit with a small outline vanishes in the noise, a wider one starts with more light.
        let start =
            |detection: &Detection| CandidateStarts { alternatives: of(detection, WIDER).starts, ..of(detection, 1.0) };
        // Where bumps grow with their size the tip of something large is more significant than all of it.
        let factors = if is_uneven { &WIDER_OUTLINES[..] } else { &[] };
        let whole = |detection: &Detection| {
            let tip = of(detection, 1.0).starts;
            factors
                .iter()
                .map(|by| of(detection, *by))
                .filter(|whole| whole.starts != tip)
                .collect::<Vec<CandidateStarts>>()
        };
        Some(TemplateStarts {
            candidates: detections.all.iter().map(start).collect(),
            larger: detections.all.iter().flat_map(whole).collect(),
            strongest: detections.strongest.map(|strength| strength.placed(origin)),
            saturated: grey.saturated(),
        })
    }
}

/// Given numbers without those of a centre that the document estimates from the picture.
fn found_places(model: &Model, given: &[Option<f64>]) -> Vec<Option<f64>> {
    let mut found = given.to_vec();
    for centre in model.roles().iter().flat_map(|roles| &roles.centre) {
        if let Start::Estimator(_) = model.parameters()[centre.index()].start {
            found[centre.index()] = None;
        }
    }
    found
}

/// For each parameter its estimator, where no number is given.
fn estimators(model: &Model, given: &[Option<f64>]) -> Vec<Option<Estimator>> {
    let estimator = |(parameter, given): (&isophote_symbolic::Parameter, &Option<f64>)| match (given, parameter.start) {
        (None, Start::Estimator(estimator)) => Some(estimator),
        _ => None,
    };
    model.parameters().iter().zip(given).map(estimator).collect()
}

/// The starting values for the candidates, one for each of the model's roles.
fn starts(
    model: &Model,
    given: &[Option<f64>],
    targets: &[Detection],
    estimators: &[Option<Estimator>],
    origin: [f64; 4],
) -> CandidateStarts {
    let start = |brighter: f64, tighter: f64| -> Vec<f64> {
        let parameters = model.parameters().iter().enumerate();
        let value = |(index, parameter): (usize, &isophote_symbolic::Parameter)| match (given[index], parameter.start) {
            (Some(number), _) | (None, Start::Number(number)) => number,
            (None, Start::Estimator(estimator)) => {
                let value = target_of(model, targets, index).value(estimator, origin);
                match estimator {
                    Estimator::Amplitude => brighter * value,
                    Estimator::Extent(..) => tighter * value,
                    Estimator::Size(_) => value / tighter.sqrt(),
                    _ => value,
                }
            }
        };
        parameters.map(value).collect()
    };
    let mut starts = listed(model, given, start(1.0, 1.0));
    let clipped = targets.iter().any(|target| target.saturated > CLIPPED_PIXELS);
    if clipped && estimators.contains(&Some(Estimator::Amplitude)) {
        starts.extend(listed(model, given, start(BRIGHTER, 1.0)));
    }
    let sized = |e: &Option<Estimator>| matches!(e, Some(Estimator::Extent(0, 0) | Estimator::Size(0)));
    let is_sized = estimators.iter().any(sized);
    let tighter = if is_sized { listed(model, given, start(1.0, TIGHTER)) } else { Vec::new() };
    let energy = match targets {
        [target] => {
            Some(target.amplitude.powi(2) * target.size.iter().map(|size| 2.0 * size.max(0.5)).product::<f64>())
        }
        _ => None,
    };
    CandidateStarts { starts, alternatives: tighter, energy }
}

/// The start and one for each other combination of the numbers that the document lists; a given number replaces a list. The
/// document's limits bound the count.
fn listed(model: &Model, given: &[Option<f64>], start: Vec<f64>) -> Vec<Vec<f64>> {
    let mut all = vec![start];
    for (index, parameter) in model.parameters().iter().enumerate().filter(|(index, _)| given[*index].is_none()) {
        for number in 0..all.len() * parameter.others.len() {
            let (other, of) = (parameter.others[number % parameter.others.len()], number / parameter.others.len());
            let mut start = all[of].clone();
            start[index] = other;
            all.push(start);
        }
    }
    all
}

/// Starts for every pose consistent with the spots, and brighter ones where spots are clipped; `None` when there is no
/// pose.
fn pose_starts(
    model: &Model,
    geometry: &pose::Geometry,
    detections: &[Detection],
    given: &[Option<f64>],
    view: &View,
) -> Option<Vec<Vec<f64>>> {
    let origin = view.window.first().map(|at| at as f64);
    let spend = |units| view.budget.map_or(Ok(()), |budget| budget.spend(units));
    let spots = &geometry.target.spots;
    let clipped = detections.iter().any(|detection| detection.saturated > CLIPPED_PIXELS);
    let mut starts = Vec::new();
    let outlines: Vec<pose::Five> = detections.iter().map(|detection| outline(detection, origin)).collect();
    for pose_start in pose::starts(geometry, &outlines, &spend) {
        let sight_of = |parameter: usize| {
            let is_own = |roles: &&Roles| roles.brightness.is_some_and(|id| id.index() == parameter);
            let name = model.roles().iter().find(is_own).and_then(|roles| roles.name.as_ref());
            let spot = spots.iter().position(|spot| Some(&spot.name) == name);
            let own = spot.and_then(|spot| pose_start.outlines[spot]);
            own.or_else(|| pose_start.outlines.iter().flatten().next().copied()).map(|index| &detections[index])
        };
        for brighter in if clipped { vec![1.0, BRIGHTER] } else { vec![1.0] } {
            let value = |(index, parameter): (usize, &isophote_symbolic::Parameter)| match parameter.start {
                Start::Number(number) => Some(number),
                Start::Estimator(Estimator::Amplitude) => Some(brighter * sight_of(index)?.amplitude),
                Start::Estimator(estimator) => Some(sight_of(index)?.value(estimator, origin)),
            };
            let mut start = model.parameters().iter().enumerate().map(value).collect::<Option<Vec<f64>>>()?;
            geometry.put(&pose_start.pose, &mut start);
            start.iter_mut().zip(given).for_each(|(start, given)| *start = given.unwrap_or(*start));
            starts.extend(listed(model, given, start));
        }
    }
    (!starts.is_empty()).then_some(starts)
}

/// A candidate's outline in frame coordinates.
fn outline(detection: &Detection, origin: [f64; 4]) -> pose::Five {
    let a = &detection.extent;
    pose::Five::new(detection.centre[0] + origin[0], detection.centre[1] + origin[1], a[0][0], a[0][1], a[1][1])
}

/// The target with the parameter among its roles, else the first.
fn target_of<'a>(model: &Model, targets: &'a [Detection], parameter: usize) -> &'a Detection {
    let is = |id: &ParameterId| id.index() == parameter;
    let names = |roles: &Roles| {
        roles.centre.iter().chain(&roles.shape).chain(&roles.background).chain(&roles.brightness).any(is)
    };
    let index = model.roles().iter().position(names).unwrap_or(0);
    &targets[index.min(targets.len() - 1)]
}

/// Prior knowledge of the targets from the model and the given numbers.
fn find_options(model: &Model, given: &[Option<f64>], origin: [f64; 4]) -> FindOptions {
    let first = model.roles().first();
    let near = first.filter(|roles| !roles.centre.is_empty()).and_then(|roles| {
        let mut near = [0.0; 4];
        for ((near, parameter), origin) in near.iter_mut().zip(&roles.centre).zip(origin) {
            *near = given[parameter.index()]? - origin;
        }
        Some(near)
    });
    let estimated = |start: &Start| *start == Start::Estimator(Estimator::Amplitude);
    let brightness = model.parameters().iter().find(|parameter| estimated(&parameter.start));
    let sign = brightness.and_then(|parameter| match (parameter.min, parameter.max) {
        (Some(min), _) if min >= 0.0 => Some(Sign::Bright),
        (_, Some(max)) if max <= 0.0 => Some(Sign::Dark),
        _ => None,
    });
    FindOptions { sign, near, ..FindOptions::default() }
}
