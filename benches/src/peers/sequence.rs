//! The frames for all methods, and the file that passes them to other programs.

use std::io::Write;
use std::path::Path;

use isophote_tracker::Frame;

use crate::accuracy::bound::variances;
use crate::accuracy::condition::{Condition, condition};
use crate::accuracy::light::PROFILE;
use crate::accuracy::scene::Beside;
use crate::accuracy::sensor::{FULL, GAIN, READ_E, Random};
use crate::tracked::line::offset;
use crate::tracked::subject::{REACH, Spot, Subject};

/// Error of predictions, px.
pub const JUMP_PX: f64 = 0.1;
/// Frames with a computed bound.
const BOUNDS: usize = 12;

/// A condition by its name and the size of its spot.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Condition of the accuracy page.
    pub condition: &'static str,
    /// px
    pub semi_axes_px: [f64; 2],
}

/// The measured cases.
pub const CASES: [Case; 3] = [
    Case { condition: "S0", semi_axes_px: [60.0, 42.0] },
    Case { condition: "S30", semi_axes_px: [60.0, 42.0] },
    Case { condition: "S0", semi_axes_px: [18.0, 14.0] },
];

impl Case {
    /// Title in the tables.
    pub fn title(&self) -> String {
        let [long, short] = self.semi_axes_px;
        let saturated = 100.0 * condition(self.condition).saturated;
        let light = if saturated > 0.0 { format!("{saturated} % saturated") } else { "nothing saturated".into() };
        format!("{long} × {short} px, {light}")
    }
}

/// One frame.
pub struct SequenceFrame {
    /// The image.
    pub image: Frame,
    /// True centre, px.
    pub centre: [f64; 2],
    /// Predicted centre, px.
    predicted: [f64; 2],
}

/// All frames of a case.
pub struct FrameSequence {
    /// In order.
    pub frames: Vec<SequenceFrame>,
    /// √ of the mean variance of a coordinate of the centre by the Cramér–Rao bound, px.
    pub bound_px: f64,
    /// Approximate bx, by, a1, a2, a3, v0, v1.
    start: [f64; 7],
    /// Half width and half height of the window.
    half_px: [f64; 2],
}

impl FrameSequence {
    /// The same frames in every run.
    pub fn new(case: Case, count: usize) -> FrameSequence {
        let what = Condition { semi_axes_px: case.semi_axes_px, ..condition(case.condition) };
        let mut subject = Spot::new("spot", what, 0.02 * count as f64);
        let place = subject.scene.centre;
        let mut random = Random::of("jumps", 0);
        let mut squares = Vec::new();
        let frames = (0..count).map(|number| {
            let steady = offset(subject.velocity(), number, count, 0.0, &mut Random::of("steady", 0));
            let jumped = offset(subject.velocity(), number, count, JUMP_PX, &mut random);
            let image = subject.shot(jumped);
            if number % count.div_ceil(BOUNDS) == 0 {
                let variances = variances(&subject.scene, Beside::Even);
                squares.push((variances[0] + variances[1]) / 2.0);
            }
            SequenceFrame {
                image,
                centre: subject.scene.centre,
                predicted: [0, 1].map(|axis| place[axis] + steady[axis]),
            }
        });
        let frames: Vec<SequenceFrame> = frames.collect();
        let [a1, a2, a3] = subject.scene.shape;
        let determinant = (a1 * a3 - a2 * a2) / REACH;
        let half_px = [a3, a1].map(|entry| (entry / determinant).sqrt());
        let [x, y] = frames[0].predicted;
        let start = [x, y, 1.02 * a1, a2, 0.98 * a3, what.background + 1.0, 0.95 * subject.scene.brightness];
        let bound_px = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        FrameSequence { frames, bound_px, start, half_px }
    }

    /// The window of a frame: left, top, width, height, px.
    fn window(&self, frame: &SequenceFrame) -> [f64; 4] {
        let side = frame.image.width() as f64 - 1.0;
        let first = [0, 1].map(|axis| (frame.predicted[axis] - self.half_px[axis]).floor().max(0.0));
        let last = [0, 1].map(|axis| (frame.predicted[axis] + self.half_px[axis]).ceil().min(side));
        [first[0], first[1], last[0] - first[0] + 1.0, last[1] - first[1] + 1.0]
    }

    /// Sixteen f64, little-endian: frames, width, height, DN per electron, read noise in DN, the largest pixel, k1,
    /// k2, the domain's s, and seven starting values; then for each frame six f64, its predicted centre and its
    /// window, and its pixels.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
        let (width, height) = (self.frames[0].image.width(), self.frames[0].image.rows());
        let sizes = [self.frames.len(), width, height].map(|n| n as f64);
        let camera = [GAIN, READ_E * GAIN, FULL, PROFILE[0], PROFILE[1], REACH];
        let mut numbers = |all: &[f64], pixels: &[u8]| {
            all.iter().try_for_each(|number| file.write_all(&number.to_le_bytes()))?;
            file.write_all(pixels)
        };
        numbers(&[&sizes[..], &camera, &self.start].concat(), &[])?;
        for frame in &self.frames {
            let place = [&frame.predicted[..], &self.window(frame)].concat();
            numbers(&place, frame.image.planes()[0].buffer.bytes())?;
        }
        file.flush()
    }
}
