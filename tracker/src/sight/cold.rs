//! A cold start: from nothing but the window to complete starting values.

use isophote_symbolic::{Estimator, Model, ParameterId, Roles, Start};

use crate::pose;
use crate::sight::colours::{Colours, Whereabouts};
use crate::sight::detect::{Bank, Sought, Strength};
use crate::sight::grey::{Grey, Mixture};
use crate::sight::halved::find_halved;
use crate::sight::mask::Mask;
use crate::sight::start::{Sight, Sign, Wanted, find};
use crate::sight::view::View;
use crate::sight::wave::given_by_wave;

/// What a cold start may begin with.
pub(crate) struct Cold {
    /// What may be the target, the likeliest first.
    pub sights: Vec<Starts>,
    /// Saturated pixels of the window.
    pub saturated: usize,
    /// The first of them stands where the target was said to be.
    pub is_placed: bool,
}

/// How closely a picture is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Grain {
    /// Pixel by pixel.
    Full,
    /// Four pixels at a time.
    Halved,
}

/// Starting values to try for one thing that may be the target.
pub(crate) struct Starts {
    /// Full parameter vectors.
    pub starts: Vec<Vec<f64>>,
    /// Other outlines, tighter ones of what stands out, wider ones of what is faint: to be tried when none of the others leads
    /// to a believable fit, and where numbers are listed.
    pub others: Vec<Vec<f64>>,
    /// The square of its height over its area; absent where nothing was seen.
    pub energy: Option<f64>,
}

/// From this many saturated pixels on, what is seen of the amplitude is too little, …
const CLIPPED_PIXELS: usize = 10;
/// … and this many times as much is tried as well.
const BRIGHTER: f64 = 2.5;
/// Where targets are told apart by colour, so many other things are looked at.
const OTHERS: usize = 5;
/// A is this many times the estimated one for the tighter start. Where the domain ends at the outline and nothing is said of
/// what lies beyond, a fit that begins with too large an outline takes the surroundings for its rim and grows without end;
/// one that begins inside the target does not.
const TIGHTER: f64 = 2.5;
/// The outline of something faint is so many times as large for its other start.
const WIDER: f64 = 1.5;
/// What something may be the tip of is so many times as large.
const WHOLES: [f64; 2] = [2.0, 4.0];
/// Whoever says where a target is may be so many times its size off.
const MEANT: f64 = 4.0;
/// In so large a share of frames noise alone may be taken for something.
pub(crate) const FALSE_ALARMS: f64 = 0.01;

impl Cold {
    /// `given` numbers first, then the model's own numbers, then what its estimators see: of up to `sights_max` things for
    /// a model of one target. `None` when an estimator is needed and there is no target for it.
    pub fn look(
        model: &Model,
        view: &View,
        constants: &[f64],
        given: &[Option<f64>],
        sights_max: usize,
        masks: Vec<Mask>,
        grain: Grain,
    ) -> Option<Cold> {
        view.spend(view.window.pixels()).ok()?;
        let spend = |units| view.budget.map_or(Ok(()), |budget| budget.spend(units));
        let mixture = Mixture::observed(model, constants);
        let read = if grain == Grain::Halved { Grey::read_halved } else { Grey::read };
        let grey = read(&view.planes, view.window, &view.saturation, &mixture);
        let saturated = grey.saturated();
        let origin = view.window.first().map(|at| at as f64);
        let step = if grain == Grain::Halved { 2.0 } else { 1.0 };
        let given = &given_by_wave(model, given, &grey, step, origin)?[..];
        let estimators = estimators(model, given);
        if estimators.iter().all(Option::is_none) {
            let sights = vec![starts(model, given, &[], &estimators, origin)];
            return Some(Cold { sights, saturated, is_placed: true });
        }
        let mut wanted = wanted(model, given, origin);
        if let Some(geometry) = pose::Geometry::of(model, constants) {
            (wanted.targets_max, wanted.masks) = (geometry.target.spots.len() + pose::SPARE, masks);
            let found = find(&grey, &wanted, &spend).ok()?;
            let starts = pose_starts(model, &geometry, &found.sights, given, view)?;
            let sights = vec![Starts { starts, others: Vec::new(), energy: None }];
            return Some(Cold { sights, saturated, is_placed: false });
        }
        let targets = model.roles().len().max(1);
        let several = if targets == 1 { sights_max } else { 1 };
        let colours = Colours::of(model, constants);
        (wanted.targets_max, wanted.faint, wanted.masks) = (targets.max(several), several > 1, masks);
        if colours.is_some() && targets > 1 {
            // The faintest of them may be far below the brightest, with other things in between.
            (wanted.targets_max, wanted.faint) = (targets + OTHERS, true);
        }
        let look = if grain == Grain::Halved { find_halved } else { find };
        let found = look(&grey, &wanted, &spend).ok()?;
        if found.sights.len() < targets {
            return None;
        }
        let is_placed = wanted.near.is_some();
        let first = if is_placed { Whereabouts::Known } else { Whereabouts::Unknown };
        let sights: Vec<&[Sight]> = match (&colours, targets) {
            (_, 1) => found.sights.iter().map(std::slice::from_ref).collect(),
            (Some(_), _) => vec![&found.sights[..]],
            (None, _) => vec![&found.sights[..targets]],
        };
        let start = |sights: &[Sight]| match &colours {
            Some(colours) => {
                let (sights, given) = colours.sorted(view, sights, given, first)?;
                Some(starts(model, &given, &sights, &estimators, origin))
            }
            None => Some(starts(model, given, sights, &estimators, origin)),
        };
        let sights: Vec<Starts> = sights.into_iter().filter_map(start).collect();
        (!sights.is_empty()).then_some(Cold { sights, saturated, is_placed })
    }
}

/// What of a picture stands out by the document's own image, as starting values.
pub(crate) struct Spotted {
    /// The strongest first; where the target was said to be, the nearest.
    pub sights: Vec<Starts>,
    /// What these may be the tips of: to be tried when nothing likely has come of them.
    pub wholes: Vec<Starts>,
    /// The strongest thing, whether it stands out or not.
    pub strongest: Option<Strength>,
    /// Saturated pixels of the window.
    pub saturated: usize,
}

impl Spotted {
    /// Looks with a bank of templates; `size_px`: half the target's width, when it is known.
    pub fn look(
        model: &Model,
        view: &View,
        constants: &[f64],
        given: &[Option<f64>],
        bank: &Bank,
        size_px: Option<f64>,
        masks: &[Mask],
    ) -> Option<Spotted> {
        view.spend(view.window.pixels()).ok()?;
        let mixture = Mixture::observed(model, constants);
        let grey = Grey::read(&view.planes, view.window, &view.saturation, &mixture);
        let origin = view.window.first().map(|at| at as f64);
        let Wanted { sign, near, .. } = wanted(model, given, origin);
        let spend = |units| view.budget.map_or(Ok(()), |budget| budget.spend(units));
        let sought = Sought { sign, size_px, masks, false_alarms: FALSE_ALARMS };
        let mut detections = bank.detect(model, constants, &grey, &sought, &spend).ok()?;
        let is_uneven = detections.bumps > 0.0;
        // What is overexposed stands out by itself except among bumps, and its rim is like anything.
        let is_clear = |sight: &Sight| grey.saturated_about(sight.centre, sight.size) <= CLIPPED_PIXELS;
        detections.sights.retain(|sight| is_uneven || is_clear(sight));
        let to = |near: [f64; 4], sight: &Sight| (sight.centre[0] - near[0]).hypot(sight.centre[1] - near[1]);
        let off = |sight: &Sight| near.map_or(f64::INFINITY, |near| to(near, sight));
        detections.sights.sort_by(|a, b| off(a).total_cmp(&off(b)));
        // Who says where it is says so roughly: what is found there is what is meant.
        let found = found_places(model, given);
        let of = |sight: &Sight, by: f64| {
            let is_meant = off(sight) <= MEANT * sight.size[0].max(sight.size[1]);
            let given = if is_meant { &found[..] } else { given };
            starts(model, given, &[sight.widened(by)], &estimators(model, given), origin)
        };
        // Where a fit that begins with a small outline vanishes in the noise, a wider one has more light to begin with.
        let start = |sight: &Sight| Starts { others: of(sight, WIDER).starts, ..of(sight, 1.0) };
        // Where bumps grow with their size the tip of something large stands out more than all of it.
        let wholes = if is_uneven { &WHOLES[..] } else { &[] };
        let whole = |sight: &Sight| {
            let tip = of(sight, 1.0).starts;
            wholes.iter().map(|by| of(sight, *by)).filter(|whole| whole.starts != tip).collect::<Vec<Starts>>()
        };
        Some(Spotted {
            sights: detections.sights.iter().map(start).collect(),
            wholes: detections.sights.iter().flat_map(whole).collect(),
            strongest: detections.strongest.map(|strength| strength.placed(origin)),
            saturated: grey.saturated(),
        })
    }
}

/// Given numbers without those of a centre that the document leaves to the picture.
fn found_places(model: &Model, given: &[Option<f64>]) -> Vec<Option<f64>> {
    let mut found = given.to_vec();
    for centre in model.roles().iter().flat_map(|roles| &roles.centre) {
        if let Start::Estimator(_) = model.parameters()[centre.index()].start {
            found[centre.index()] = None;
        }
    }
    found
}

/// For each parameter what a picture is asked for, where no number is given.
fn estimators(model: &Model, given: &[Option<f64>]) -> Vec<Option<Estimator>> {
    let estimator = |(parameter, given): (&isophote_symbolic::Parameter, &Option<f64>)| match (given, parameter.start) {
        (None, Start::Estimator(estimator)) => Some(estimator),
        _ => None,
    };
    model.parameters().iter().zip(given).map(estimator).collect()
}

/// The starting values for the targets seen, one for each of the model's roles.
fn starts(
    model: &Model,
    given: &[Option<f64>],
    targets: &[Sight],
    estimators: &[Option<Estimator>],
    origin: [f64; 4],
) -> Starts {
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
    Starts { starts, others: tighter, energy }
}

/// The start itself, and one for each other combination of the numbers that the document lists; a number that is given
/// takes the place of a list. The document's limits bound how many there are.
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

/// Starts for every pose that suits the spots, and again brighter where spots are clipped; `None` when no pose does.
fn pose_starts(
    model: &Model,
    geometry: &pose::Geometry,
    sights: &[Sight],
    given: &[Option<f64>],
    view: &View,
) -> Option<Vec<Vec<f64>>> {
    let origin = view.window.first().map(|at| at as f64);
    let spend = |units| view.budget.map_or(Ok(()), |budget| budget.spend(units));
    let spots = &geometry.target.spots;
    let clipped = sights.iter().any(|sight| sight.saturated > CLIPPED_PIXELS);
    let mut starts = Vec::new();
    let outlines: Vec<pose::Five> = sights.iter().map(|sight| outline(sight, origin)).collect();
    for pose_start in pose::starts(geometry, &outlines, &spend) {
        let sight_of = |parameter: usize| {
            let is_own = |roles: &&Roles| roles.brightness.is_some_and(|id| id.index() == parameter);
            let name = model.roles().iter().find(is_own).and_then(|roles| roles.name.as_ref());
            let spot = spots.iter().position(|spot| Some(&spot.name) == name);
            let own = spot.and_then(|spot| pose_start.outlines[spot]);
            own.or_else(|| pose_start.outlines.iter().flatten().next().copied()).map(|index| &sights[index])
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

/// In frame coordinates.
fn outline(sight: &Sight, origin: [f64; 4]) -> pose::Five {
    let a = &sight.extent;
    pose::Five::new(sight.centre[0] + origin[0], sight.centre[1] + origin[1], a[0][0], a[0][1], a[1][1])
}

/// The target whose roles name the parameter, else the first.
fn target_of<'a>(model: &Model, targets: &'a [Sight], parameter: usize) -> &'a Sight {
    let is = |id: &ParameterId| id.index() == parameter;
    let names = |roles: &Roles| {
        roles.centre.iter().chain(&roles.shape).chain(&roles.background).chain(&roles.brightness).any(is)
    };
    let index = model.roles().iter().position(names).unwrap_or(0);
    &targets[index.min(targets.len() - 1)]
}

/// What the model and the given numbers say about the targets beforehand.
fn wanted(model: &Model, given: &[Option<f64>], origin: [f64; 4]) -> Wanted {
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
    Wanted { sign, near, ..Wanted::default() }
}
