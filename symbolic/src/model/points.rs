//! Made-up, reproducible points for the check of a program: numbers for all leaves of a model's formulas, with a target
//! in the middle, and a small picture of it.

use isophote_elementary::Modular;

use crate::graph::Node;
use crate::graph::random::Random;
use crate::model::estimator::Estimator;
use crate::model::{Model, Parameter, Start};
use crate::program::Input;
use crate::program::arithmetic::Number;

/// Width of a picture, px.
pub(crate) const WIDTH: usize = 36;
/// Size of the target, px.
pub(crate) const SIZE: f64 = 12.0;
/// Centres of the made-up target, px: in the middle of a camera's picture for f32, and where terms are as small as
/// their sum for f64.
pub(crate) const FAR: [f64; 4] = [300.3, 200.7, 20.3, 10.7];
pub(crate) const NEAR: [f64; 4] = [0.3, -0.3, 0.3, -0.3];
/// Another centre, with other signs.
pub(crate) const BESIDE: [f64; 4] = [-3.7, 3.3, -3.7, 3.3];

/// The limit of a channel, a pixel value of the targets; differs by channel.
pub(crate) fn limit(channel: usize) -> f64 {
    120.0 + 1.5 * channel as f64
}

/// Numbers for all leaves of formulas.
#[derive(Clone, Debug)]
pub(crate) struct Point<N> {
    pub parameters: Vec<N>,
    /// Parameters at the entry of the pass: near the others, and never the same.
    pub entry: Vec<N>,
    pub constants: Vec<N>,
    /// One a channel.
    pub limits: Vec<N>,
    /// One a coordinate.
    pub shift: Vec<N>,
    /// Values of the inner coordinate.
    pub columns: Vec<N>,
    /// Values of the outer coordinates, one list a row.
    pub rows: Vec<Vec<N>>,
    /// Channel by channel, row by row.
    pub pixels: Vec<N>,
}

impl<N: Number> Point<N> {
    pub fn input(&self, input: Input) -> N {
        match input {
            Input::Parameter(p) => self.parameters[p.index()],
            Input::Entry(p) => self.entry[p.index()],
            Input::Constant(c) => self.constants[c.index()],
            Input::Saturation(c) => self.limits[c.index()],
            Input::Shift(c) => self.shift[c.index()],
        }
    }

    /// The value of a leaf other than coordinates and pixels.
    pub fn given(&self, node: &Node) -> N {
        match node {
            Node::Input(input) => self.input(*input),
            _ => N::from(f64::NAN),
        }
    }

    /// The value of a leaf at a position.
    pub fn read(&self, node: &Node, x: N, outer: &[N], pixel: &dyn Fn(usize) -> N) -> N {
        match node {
            Node::Coordinate(c) if c.0 == 0 => x,
            Node::Coordinate(c) => outer[c.index() - 1],
            Node::Channel(c) => pixel(c.index()),
            node => self.given(node),
        }
    }

    pub fn pixel(&self, channel: usize, column: usize, row: usize) -> N {
        self.pixels[(channel * self.rows.len() + row) * self.columns.len() + column]
    }

    pub fn map<M>(&self, to: impl Fn(N) -> M) -> Point<M> {
        let all = |list: &[N]| list.iter().map(|x| to(*x)).collect::<Vec<M>>();
        Point {
            parameters: all(&self.parameters),
            entry: all(&self.entry),
            constants: all(&self.constants),
            limits: all(&self.limits),
            shift: all(&self.shift),
            columns: all(&self.columns),
            rows: self.rows.iter().map(|row| all(row)).collect(),
            pixels: all(&self.pixels),
        }
    }
}

impl Point<f64> {
    /// Scales all parameters by nearly the same factor: shapes that are far from round cancel more digits than there
    /// are.
    pub fn move_far(&mut self, random: &mut Random) {
        let far = 3.0 * random.signed();
        for (parameter, entry) in self.parameters.iter_mut().zip(&mut self.entry) {
            let factor = 10.0_f64.powf(far + 0.3 * random.signed());
            *parameter *= factor;
            *entry *= factor;
        }
    }
}

/// Random residues for all leaves of a model, on two columns of up to two rows.
pub(crate) fn residues(model: &Model, random: &mut Random) -> Point<Modular> {
    let coordinates = model.coordinates.len();
    let mut some = |count: usize| (0..count).map(|_| Modular::of_bits(random.bits())).collect::<Vec<_>>();
    let (columns, rows) = (2, if coordinates == 1 { 1 } else { 2 });
    Point {
        parameters: some(model.parameters.len()),
        constants: some(model.constants.len()),
        columns: some(columns),
        rows: (0..rows).map(|_| some(coordinates - 1)).collect(),
        pixels: some(model.channels.len() * columns * rows),
        entry: some(model.parameters.len()),
        limits: (0..model.channels.len()).map(|c| limit(c).into()).collect(),
        shift: some(coordinates),
    }
}

/// The centre of the first target: the document's start numbers, else `otherwise` for estimated coordinates.
pub(crate) fn centre(model: &Model, otherwise: [f64; 4]) -> [f64; 4] {
    if let Some([x, y]) = projected(model) {
        return [x, y, otherwise[2], otherwise[3]];
    }
    let role = |i: usize| model.roles.first()?.centre.get(i).copied();
    std::array::from_fn(|i| match role(i).map(|p| model.parameters[p.index()].start) {
        // Within the range of a picture's column numbers.
        Some(Start::Number(number)) => number.clamp(-1e6, 1e6),
        Some(Start::Estimator(_)) => otherwise[i],
        None => 0.5 * WIDTH as f64,
    })
}

/// The image of the first spot of a pose at [`DISTANCE_MM`], if the constants define it.
fn projected(model: &Model) -> Option<[f64; 2]> {
    model.roles.iter().find(|roles| !roles.position.is_empty())?;
    let name = model.roles.iter().find_map(|roles| roles.name.as_ref())?;
    let value = |name: &str| Some(model.constants[model.constant(name)?.index()].value);
    let at =
        |f: &str, c: &str, spot: &str| Some(value(c)? + value(f)? * value(&format!("{name}_{spot}"))? / DISTANCE_MM);
    Some([at("fx", "cx", "x")?, at("fy", "cy", "y")?])
}

/// Distance of a pose's target.
const DISTANCE_MM: f64 = 1000.0;

/// The coordinate of the first target's centre that a parameter is.
pub(crate) fn axis(model: &Model, parameter: usize) -> Option<usize> {
    model.roles.first()?.centre.iter().position(|p| p.index() == parameter)
}

/// Parameters near their starts, with the target in the middle of some columns and rows.
pub(crate) fn plausible(model: &Model, centre: [f64; 4], random: &mut Random) -> Point<f64> {
    let made_up = |(i, parameter): (usize, &Parameter)| match (axis(model, i), parameter.start) {
        // A centre stays where the columns are.
        (Some(_), Start::Number(number)) => number,
        _ => made_up(parameter, centre, random),
    };
    let parameters: Vec<f64> = model.parameters.iter().enumerate().map(made_up).collect();
    let coordinates = model.coordinates.len();
    let near = |centre: f64, random: &mut Random| (centre + 0.8 * SIZE * random.signed()).round();
    let columns: Vec<f64> = (0..3).map(|_| near(centre[0], random)).collect();
    let outer = |random: &mut Random| (1..coordinates).map(|i| near(centre[i], random)).collect::<Vec<_>>();
    let rows: Vec<Vec<f64>> = (0..if coordinates == 1 { 1 } else { 2 }).map(|_| outer(random)).collect();
    let count = model.channels.len() * columns.len() * rows.len();
    let pixels = (0..count).map(|_| 110.0 + 90.0 * random.signed()).collect();
    let beside = |p: &f64| if *p == 0.0 { 1e-3 } else { p * (1.0 + 0.01 * random.signed()) };
    let entry = parameters.iter().map(beside).collect();
    let shift = (0..coordinates).map(|_| 0.4 * random.signed()).collect();
    let mut constants: Vec<f64> = model.constants.iter().map(|c| c.value).collect();
    // The logarithm of a zero share has no value, which would prevent any comparison.
    model
        .formulas
        .defects
        .iter()
        .for_each(|share| constants[share.index()] = constants[share.index()].clamp(1e-3, 0.5));
    let limits = (0..model.channels.len()).map(limit).collect();
    Point { parameters, entry, constants, limits, shift, columns, rows, pixels }
}

/// One pixel anywhere: at a target, the origin or a parameter's value; parameters of any size, bright or dark.
pub(crate) fn anywhere(model: &Model, random: &mut Random) -> Point<f64> {
    let mut point = plausible(model, centre(model, NEAR), random);
    if random.signed() > 0.0 {
        point.move_far(random);
    }
    let mut place = |near: f64| {
        let parameter = point.parameters.get((random.bits() % (1 + point.parameters.len() as u64)) as usize);
        let middle = [near, 0.0, parameter.copied().unwrap_or(near)][(random.bits() % 3) as usize];
        middle + [0.7, 3.0, SIZE][(random.bits() % 3) as usize] * random.signed()
    };
    point.columns = vec![place(point.columns[0])];
    point.rows = vec![point.rows[0].iter().map(|y| place(*y)).collect()];
    point.pixels.truncate(model.channels.len());
    let scale = [1.0, 0.01][(random.bits() % 2) as usize];
    point.pixels.iter_mut().for_each(|pixel| *pixel *= scale);
    point
}

/// A plausible value within the bounds.
fn made_up(parameter: &Parameter, centre: [f64; 4], random: &mut Random) -> f64 {
    let jitter = random.signed();
    let value = match parameter.start {
        Start::Number(value) => value + 0.05 * jitter * if value == 0.0 { 1.0 } else { value },
        Start::Estimator(estimator) => match estimator {
            Estimator::Centroid(axis) => centre[axis] + jitter,
            Estimator::Extent(row, column) if row == column => (1.0 + 0.2 * jitter) / (SIZE * SIZE),
            Estimator::Extent(..) => 0.3 * jitter / (SIZE * SIZE),
            Estimator::Size(_) => SIZE * (1.0 + 0.2 * jitter),
            Estimator::Background => 20.0 + 5.0 * jitter,
            Estimator::Amplitude => {
                (150.0 + 30.0 * jitter) * if parameter.max.is_some_and(|m| m <= 0.0) { -1.0 } else { 1.0 }
            }
            Estimator::Angle | Estimator::Direction | Estimator::Phase => 0.3 + 0.1 * jitter,
            Estimator::Frequency => 0.1 + 0.01 * jitter,
            Estimator::Position(2) => DISTANCE_MM * (1.0 + 0.03 * jitter),
            Estimator::Position(_) => 2.0 * jitter,
            Estimator::Orientation(_) => 0.02 * jitter,
        },
    };
    let inside = parameter.min.is_none_or(|min| value > min) && parameter.max.is_none_or(|max| value < max);
    match (inside, parameter.start, parameter.min, parameter.max) {
        (true, ..) => value,
        (_, Start::Number(start), ..) => start,
        (_, _, Some(min), Some(max)) => 0.5 * (min + max),
        (_, _, Some(min), None) => min + 1.0,
        (_, _, None, Some(max)) => max - 1.0,
        (_, _, None, None) => value,
    }
}
