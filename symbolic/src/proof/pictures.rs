//! Made-up pictures of a model's target: for the error in f32.

use crate::graph::hyper::{Bare, Values};
use crate::graph::random::Random;
use crate::graph::{Node, NodeId};
use crate::model::estimator::Estimator;
use crate::model::points::{FAR, Point, WIDTH, axis, centre};
use crate::model::{Start, Summand};
use crate::program::Input;
use crate::program::interpreter::{Pixels, Slices, Window};

/// Maximum distance of single pixels from the picture, px, about the width of pictures, and the first distance.
/// Distances double, so that an exponential that leaves f32's range in part is seen before it leaves all of it.
const FAR_PX: usize = 4096;
const FIRST_STEP: usize = 64;
/// Largest pixel value of a camera.
const BRIGHT: f64 = 1e6;

/// The model's picture about its target at slightly different parameters, with noise; then single pixels at growing
/// distances.
pub(crate) fn pictures(summand: &Summand, point: &Point<f64>, height: usize, random: &mut Random) -> Vec<Picture> {
    let model = summand.model();
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
    places.into_iter().filter_map(|place| picture(summand, point, place, random)).collect()
}

/// One picture; `None` where a part of the formulas leaves the range of f32, or of a camera.
fn picture(
    summand: &Summand,
    point: &Point<f64>,
    [x, y, width, height]: [usize; 4],
    random: &mut Random,
) -> Option<Picture> {
    let model = summand.model();
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
    let graph = &model.formulas.graph;
    let is_near = width > 1;
    let mut roots = vec![summand.first().shown];
    let is_number = |n: &NodeId| !graph.is_truth(*n);
    roots.extend(graph.reachable(&roots).into_iter().filter(|n| !is_near && is_number(n)));
    let mut evaluator = Values::of(graph, &roots, &inputs);
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

/// A camera picture, with two slices of a third and fourth coordinate.
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
