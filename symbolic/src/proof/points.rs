//! Made-up points for the check of a program: numbers for everything that a model's formulas read, with a target in the
//! middle of them, and a small picture of it. The same every time.

use isophote_elementary::Modular;

use crate::language::estimator::Estimator;
use crate::language::graph::{Node, NodeId};
use crate::language::model::{Model, Parameter, Start};
use crate::program::Input;
use crate::program::interpreter::{Pixels, Slices, Window};
use crate::proof::evaluate::Number;
use crate::proof::hyper::{Bare, Values};

/// Columns of a picture.
const WIDTH: usize = 36;
/// How far single pixels are from there at most, px: about as wide as pictures are. Each is twice as far as the one before, so
/// that an exponential which leaves a part of f32's range is seen before it leaves all of it.
const FAR_PX: usize = 4096;
const FIRST_STEP: usize = 64;
/// No camera has larger values.
const BRIGHT: f64 = 1e6;
/// How large the target is, px.
pub(crate) const SIZE: f64 = 12.0;
/// Where the made-up target is, px: in the middle of a camera's picture for f32, and where terms are as small as their sum
/// for f64.
pub(crate) const FAR: [f64; 4] = [300.3, 200.7, 20.3, 10.7];
pub(crate) const NEAR: [f64; 4] = [0.3, -0.3, 0.3, -0.3];
/// Beside that, so that a centre has the other sign.
pub(crate) const BESIDE: [f64; 4] = [-3.7, 3.3, -3.7, 3.3];

/// The limit of a channel, a pixel value of the targets; each has its own.
pub(crate) fn limit(channel: usize) -> f64 {
    120.0 + 1.5 * channel as f64
}

/// Random numbers that are the same every time.
pub(crate) struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    /// In −1 … 1.
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Numbers for everything that formulas read.
#[derive(Clone, Debug)]
pub(crate) struct Point<N> {
    pub parameters: Vec<N>,
    /// Those that the pass was entered with: near the others, and never the same.
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

    /// What a formula reads besides coordinates and pixels.
    pub fn given(&self, node: &Node) -> N {
        match node {
            Node::Input(input) => self.input(*input),
            _ => N::from(f64::NAN),
        }
    }

    /// What it reads at a place.
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
    /// All parameters by nearly the same factor: shapes that are far from round cancel more digits than there are.
    pub fn move_far(&mut self, random: &mut Random) {
        let far = 3.0 * random.signed();
        for (parameter, entry) in self.parameters.iter_mut().zip(&mut self.entry) {
            let factor = 10.0_f64.powf(far + 0.3 * random.signed());
            *parameter *= factor;
            *entry *= factor;
        }
    }
}

/// Random residues for all that a model reads, on two columns of up to two rows.
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

/// Where the first target is: numbers of the document count, everything else is put where the caller wants it.
pub(crate) fn centre(model: &Model, otherwise: [f64; 4]) -> [f64; 4] {
    if let Some([x, y]) = projected(model) {
        return [x, y, otherwise[2], otherwise[3]];
    }
    let role = |i: usize| model.roles.first()?.centre.get(i).copied();
    std::array::from_fn(|i| match role(i).map(|p| model.parameters[p.index()].start) {
        // Within what a picture's columns can number.
        Some(Start::Number(number)) => number.clamp(-1e6, 1e6),
        Some(Start::Estimator(_)) => otherwise[i],
        None => 0.5 * WIDTH as f64,
    })
}

/// Where the first spot of a pose is seen from [`DISTANCE_MM`] away, when the constants say.
fn projected(model: &Model) -> Option<[f64; 2]> {
    model.roles.iter().find(|roles| !roles.position.is_empty())?;
    let name = model.roles.iter().find_map(|roles| roles.name.as_ref())?;
    let value = |name: &str| Some(model.constants[model.constant(name)?.index()].value);
    let at =
        |f: &str, c: &str, spot: &str| Some(value(c)? + value(f)? * value(&format!("{name}_{spot}"))? / DISTANCE_MM);
    Some([at("fx", "cx", "x")?, at("fy", "cy", "y")?])
}

/// How far away the target of a pose is put.
const DISTANCE_MM: f64 = 1000.0;

/// The coordinate that a parameter is the first target's centre along.
fn axis(model: &Model, parameter: usize) -> Option<usize> {
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
    // Without any defects their logarithm has no value, and nothing would be compared.
    model
        .formulas
        .defects
        .iter()
        .for_each(|share| constants[share.index()] = constants[share.index()].clamp(1e-3, 0.5));
    let limits = (0..model.channels.len()).map(limit).collect();
    Point { parameters, entry, constants, limits, shift, columns, rows, pixels }
}

/// One pixel anywhere: at a target, at the origin, where a parameter says; parameters of any size, bright or dark.
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

/// What the model shows about its target with its parameters a little off, and some noise; then single pixels, ever further
/// from there.
pub(crate) fn pictures(model: &Model, point: &Point<f64>, height: usize, random: &mut Random) -> Vec<Picture> {
    let centre = centre(model, FAR);
    let x = columns_around(centre[0])[0].max(0.0) as usize;
    let y = (centre[1] - 0.5 * height as f64).round().max(0.0) as usize;
    let is_curve = model.coordinates.len() == 1;
    let mut places = vec![[x, if is_curve { 0 } else { y }, WIDTH, if is_curve { 1 } else { height }]];
    let steps = (0..).map(|i| FIRST_STEP << i).take_while(|step| *step <= FAR_PX);
    for step in steps {
        places.push([x + step, places[0][1], 1, 1]);
        places.extend((!is_curve).then_some([x, y + step, 1, 1]));
    }
    places.push([0, 0, 1, 1]);
    places.into_iter().filter_map(|place| picture(model, point, place, random)).collect()
}

/// One picture; nothing where a part of the formulas is outside of f32, or where no camera has such values.
fn picture(
    model: &Model,
    point: &Point<f64>,
    [x, y, width, height]: [usize; 4],
    random: &mut Random,
) -> Option<Picture> {
    let centre = centre(model, FAR);
    let coordinates = model.coordinates.len();
    let slices = Slices {
        first: [2, 3].map(|i| if i < coordinates { centre[i].floor().max(0.0) as usize } else { 0 }),
        count: [2, 3].map(|i| if i < coordinates { 2 } else { 1 }),
    };
    let window = Window { x, y, width, height, slices };
    let away = |i: usize, value: f64| match model.parameters[i].start {
        Start::Estimator(Estimator::Centroid(_)) => value + 0.3,
        Start::Number(_) if axis(model, i).is_some() => value + 0.3,
        _ => 1.03 * value,
    };
    let parameters: Vec<f64> = point.parameters.iter().enumerate().map(|(i, value)| away(i, *value)).collect();
    let channels = model.channels.len();
    let [depth, length] = slices.count;
    let mut pixels = Vec::with_capacity(channels * width * height * depth * length);
    let inputs = |node: &Node| match node {
        Node::Input(Input::Parameter(p) | Input::Entry(p)) => parameters[p.index()],
        Node::Input(Input::Constant(c)) => point.constants[c.index()],
        _ => 0.0,
    };
    let formulas = &model.formulas;
    let is_near = width > 1;
    let mut roots = vec![formulas.shown];
    let is_number = |n: &NodeId| !formulas.graph.is_truth(*n);
    roots.extend(formulas.graph.reachable(&roots).into_iter().filter(|n| !is_near && is_number(n)));
    let mut evaluator = Values::of(&formulas.graph, &roots, &inputs);
    for _ in 0..channels {
        for row in 0..height * depth * length {
            let (slice, y) = (row / height, window.y + row % height);
            let [z, w] = [slices.first[0] + slice % depth, slices.first[1] + slice / depth];
            for column in 0..width {
                let shown = evaluator.at(&|node| match node {
                    Node::Coordinate(c) => [window.x + column, y, z, w][c.index()] as f64,
                    node => inputs(node),
                });
                let is_single = |x: &&Bare<f64>| x.value.abs() < f64::from(f32::MAX);
                let is_ordinary = shown[0].value.abs() < BRIGHT && shown.iter().all(is_single);
                if !is_near && !is_ordinary {
                    return None;
                }
                pixels.push(f64::from((shown[0].value + 1.5 * random.signed()) as f32));
            }
        }
    }
    Some(Picture { window, pixels })
}

fn columns_around(centre: f64) -> Vec<f64> {
    let first = (centre - 0.5 * WIDTH as f64).round();
    (0..WIDTH).map(|i| first + i as f64).collect()
}

/// What a camera might see; of a third and fourth coordinate it has two slices.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub window: Window,
    pixels: Vec<f64>,
}

impl Pixels for Picture {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        let [z, w] = self.window.slices.first;
        self.at_place(channel, [x, y, z, w])
    }
    fn at_place(&self, channel: usize, [x, y, z, w]: [usize; 4]) -> f64 {
        let Window { width, height, slices: Slices { first, count }, .. } = self.window;
        let volume = channel * count[1] + w - first[1];
        let slice = volume * count[0] + z - first[0];
        self.pixels[(slice * height + y - self.window.y) * width + x - self.window.x]
    }
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
