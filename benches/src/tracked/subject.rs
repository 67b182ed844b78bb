//! Tracked subjects: targets of several documents that can be placed anywhere.

use std::f64::consts::PI;
use std::sync::Arc;

use isophote_jit::{KernelCache, PixelFormat, VectorWidth};
use isophote_symbolic::{Model, Precision};
use isophote_tracker::geometry::Rigid;
use isophote_tracker::{Camera, Compiled, Estimate, Frame, InTurn, Plane, Tracker, TrackerOptions};
use nalgebra::{Rotation3, Vector3};

use super::pass::CoveredArea;
use crate::accuracy::condition::{Condition, condition};
use crate::accuracy::document::frame;
use crate::accuracy::light::PROFILE;
use crate::accuracy::pose::scene as pose;
use crate::accuracy::scene::{Beside, Scene};
use crate::accuracy::sensor::{FULL, GAIN, READ_E, Random};
use crate::text;

/// The domain of `spot`.
pub const REACH: f64 = 2.2;

/// A target that a document is fitted to.
pub trait Subject {
    /// Its size, for tables.
    fn size(&self) -> String;
    /// px a frame.
    fn velocity(&self) -> [f64; 2];
    /// A frame with the target offset from its place, px.
    fn shot(&mut self, offset_px: [f64; 2]) -> Frame;
    /// Error of an answer in the last shot, px.
    fn error_px(&self, estimate: &Estimate) -> [f64; 2];
    /// An ellipse of as many pixels as the document's fit uses.
    fn covered(&self, estimate: &Estimate) -> CoveredArea;
    /// A fresh tracker.
    fn tracker(&self, width: VectorWidth) -> Tracker;
}

/// The camera of [`crate::accuracy::sensor`].
pub fn camera() -> Camera {
    Camera {
        saturation: Some(FULL),
        electrons_per_dn: Some(1.0 / GAIN),
        read_noise_e: Some(READ_E),
        ..Camera::default()
    }
}

/// A tracker with compiled kernels.
pub fn tracker(document: &str, width: VectorWidth, options: TrackerOptions) -> Tracker {
    let cache = Arc::new(KernelCache::of_width(width));
    let model = Arc::new(Model::from_toml(&text(document)).unwrap());
    let compiled = Compiled::with_cache(model, Precision::F32, cache, &InTurn).unwrap();
    compiled.warm(PixelFormat::U8, &InTurn).unwrap();
    Tracker::new(Arc::new(compiled), options).unwrap()
}

/// The profile of the scenes' spots, as starting values.
pub fn profile() -> impl Iterator<Item = (String, f64)> {
    ["k1", "k2"].into_iter().zip(PROFILE).map(|(name, value)| (name.to_string(), value))
}

/// A spot, by a document with its profile.
pub struct Spot {
    document: &'static str,
    /// As in the last shot.
    pub scene: Scene,
    place: [f64; 2],
    random: Random,
}

impl Spot {
    /// In the middle of a frame large enough for that distance, px.
    pub fn new(document: &'static str, what: Condition, way_px: f64) -> Spot {
        let side_px = (2.0 * (1.6 * what.semi_axes_px[0] + 16.0 + way_px)) as usize;
        let mut random = Random::of("tracked", 0);
        let scene = Scene::draw(Condition { side_px, ..what }, &mut random);
        Spot { document, place: scene.centre, scene, random }
    }

    /// Of the condition without saturation, but of that size.
    pub fn of_size(document: &'static str, semi_axes_px: [f64; 2], way_px: f64) -> Spot {
        Spot::new(document, Condition { semi_axes_px, ..condition("S0") }, way_px)
    }
}

impl Subject for Spot {
    fn size(&self) -> String {
        let [long, short] = self.scene.condition.semi_axes_px;
        format!("{long} × {short}")
    }

    fn velocity(&self) -> [f64; 2] {
        [0.02, 0.013]
    }

    fn shot(&mut self, offset_px: [f64; 2]) -> Frame {
        self.scene.centre = [0, 1].map(|axis| self.place[axis] + offset_px[axis]);
        let light = self.scene.light(&self.scene.unknowns(Beside::Even));
        frame(self.random.exposed(&light), self.scene.condition.side_px)
    }

    fn error_px(&self, estimate: &Estimate) -> [f64; 2] {
        [0, 1].map(|axis| estimate.parameters[axis] - self.scene.centre[axis])
    }

    fn covered(&self, _: &Estimate) -> CoveredArea {
        CoveredArea { centre: self.scene.centre, shape: self.scene.shape.map(|entry| entry / REACH) }
    }

    fn tracker(&self, width: VectorWidth) -> Tracker {
        let options = TrackerOptions { start: profile().collect(), camera: camera(), ..TrackerOptions::default() };
        tracker(self.document, width, options)
    }
}

/// A Gaussian of 1.3 px in a frame hardly larger, by `gaussian-pixel`.
pub struct Small {
    centre: [f64; 2],
    random: Random,
}

impl Small {
    const SIDE: usize = 11;
    const DEVIATION_PX: f64 = 1.3;
    const PLACE: [f64; 2] = [5.2, 4.9];

    /// Slightly off the centre.
    pub fn new() -> Small {
        Small { centre: Small::PLACE, random: Random::of("tracked small", 0) }
    }

    /// The mean over a pixel along one coordinate.
    fn mean(at: f64) -> f64 {
        let edge = |d: f64| libm::erf(d / (Small::DEVIATION_PX * std::f64::consts::SQRT_2));
        Small::DEVIATION_PX * (PI / 2.0).sqrt() * (edge(at + 0.5) - edge(at - 0.5))
    }
}

impl Default for Small {
    fn default() -> Small {
        Small::new()
    }
}

impl Subject for Small {
    fn size(&self) -> String {
        format!("σ {} in {} × {}", Small::DEVIATION_PX, Small::SIDE, Small::SIDE)
    }

    fn velocity(&self) -> [f64; 2] {
        [0.0; 2]
    }

    fn shot(&mut self, offset_px: [f64; 2]) -> Frame {
        self.centre = [0, 1].map(|axis| Small::PLACE[axis] + offset_px[axis]);
        let along = |centre: f64| std::array::from_fn::<f64, { Small::SIDE }, _>(|i| Small::mean(i as f64 - centre));
        let [x, y] = self.centre.map(along);
        let light: Vec<f64> = y.iter().flat_map(|y| x.map(|x| 20.0 + 180.0 * x * y)).collect();
        frame(self.random.exposed(&light), Small::SIDE)
    }

    fn error_px(&self, estimate: &Estimate) -> [f64; 2] {
        [0, 1].map(|axis| estimate.parameters[axis] - self.centre[axis])
    }

    fn covered(&self, _: &Estimate) -> CoveredArea {
        // The whole frame.
        let entry = (Small::SIDE as f64).powi(-2);
        CoveredArea { centre: self.centre, shape: [entry, 0.0, entry] }
    }

    fn tracker(&self, width: VectorWidth) -> Tracker {
        tracker("gaussian-pixel", width, TrackerOptions { camera: camera(), ..TrackerOptions::default() })
    }
}

/// Response of each channel to each light, as in `three-spots-pose-raw`.
const MIXING: [[f64; 3]; 3] = [[1.0, 0.12, 0.03], [0.10, 1.0, 0.12], [0.02, 0.08, 1.0]];

/// Three spots on a plate, 1 m away and tilted by 30°, by a document that fits their pose to the pixels: in one plane,
/// or in three planes of a camera with cross-talk.
pub struct Plate {
    document: &'static str,
    place: Rigid,
    pose: Rigid,
    random: pose::Random,
}

impl Plate {
    const DISTANCE_MM: f64 = 1000.0;

    /// In the middle of 640 × 480 px.
    pub fn new(document: &'static str) -> Plate {
        let rotation = Rotation3::from_euler_angles(0.4, 0.34, 0.5).into_inner();
        let place = Rigid { rotation, translation: Vector3::new(0.0, 0.0, Plate::DISTANCE_MM) };
        Plate { document, pose: place, place, random: pose::Random::of(1) }
    }

    fn mm_per_px() -> f64 {
        Plate::DISTANCE_MM / pose::lens().fx
    }
}

impl Subject for Plate {
    fn size(&self) -> String {
        format!("three of {:.0}", pose::RADIUS_MM / Plate::mm_per_px())
    }

    fn velocity(&self) -> [f64; 2] {
        [0.02, 0.013]
    }

    fn shot(&mut self, offset_px: [f64; 2]) -> Frame {
        self.pose = self.place;
        self.pose.translation += Vector3::new(offset_px[0], offset_px[1], 0.0) * Plate::mm_per_px();
        let (spots, brightness) = (pose::target(0.0).spots, pose::brightness(0.0));
        if self.document != "three-spots-pose-raw" {
            return pose::frame(&self.pose, &spots, brightness, &mut self.random).unwrap();
        }
        let lights = spots.chunks(1).map(|spot| pose::means(&self.pose, spot, brightness).unwrap());
        let lights: Vec<Vec<f64>> = lights.collect();
        let read = |mixture: [f64; 3], random: &mut pose::Random| {
            let light =
                |i: usize| lights.iter().zip(mixture).map(|(light, m)| m * (light[i] - pose::BACKGROUND)).sum::<f64>();
            let pixel = |i: usize| random.read_out(pose::BACKGROUND + light(i));
            Plane::owned(PixelFormat::U8, (0..lights[0].len()).map(pixel).collect(), pose::WIDTH)
        };
        let planes = MIXING.map(|mixture| read(mixture, &mut self.random)).to_vec();
        Frame::new(&[pose::WIDTH, pose::HEIGHT], planes).unwrap()
    }

    fn error_px(&self, estimate: &Estimate) -> [f64; 2] {
        [0, 1].map(|axis| (estimate.parameters[axis] - self.pose.translation[axis]) / Plate::mm_per_px())
    }

    fn covered(&self, estimate: &Estimate) -> CoveredArea {
        let entry = PI / estimate.pixels as f64;
        CoveredArea { centre: [pose::WIDTH, pose::HEIGHT].map(|side| side as f64 / 2.0), shape: [entry, 0.0, entry] }
    }

    fn tracker(&self, width: VectorWidth) -> Tracker {
        let options = TrackerOptions {
            camera: pose::camera(),
            target: Some(pose::target(0.0)),
            constants: profile().collect(),
            ..TrackerOptions::default()
        };
        tracker(self.document, width, options)
    }
}
