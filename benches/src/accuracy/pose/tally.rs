//! Statistics of a condition: estimates with the state `tracking`, the wrong ones among them, and the errors of the
//! others.

use isophote_tracker::geometry::Rigid;
use isophote_tracker::{Alternative, Estimate, Pose, TrackState};
use nalgebra::Matrix6;

use super::cell::rigid;

/// A pose is wrong beyond this angle, or beyond `WRONG_MM`.
const WRONG_DEGREES: f64 = 5.0;
/// A pose is wrong beyond this distance, mm.
pub const WRONG_MM: f64 = 20.0;

/// Statistics of the frames of a condition.
#[derive(Clone, Debug, Default)]
pub struct PoseTally {
    pub frames: usize,
    pub tracking: usize,
    /// Wrong poses with the state `tracking`.
    pub wrong: usize,
    /// Those of them with the right pose among `alternatives`.
    pub admitted: usize,
    /// Estimates with the state `tracking` but without a covariance.
    pub silent: usize,
    /// Sums of the squared errors of position and rotation, each relative to the bound of its own frame.
    squares: [f64; 2],
    bounded: usize,
    nees: f64,
    nees_of: usize,
    /// Longest run of frames that are wrong or not tracking after the disturbance.
    pub late: usize,
}

impl PoseTally {
    /// Adds an estimate; true if it is tracking and right.
    pub fn add(
        &mut self,
        truth: &Rigid,
        estimate: &Estimate,
        bound: Option<Matrix6<f64>>,
        single: bool,
        wrong_mm: f64,
    ) -> bool {
        self.frames += 1;
        let pose = estimate.pose.as_ref().filter(|_| estimate.state == TrackState::Tracking);
        let Some((found, covariance)) = pose.map(rigid) else { return false };
        self.tracking += 1;
        let off = truth.to(&found);
        let normal = |pose: &Rigid| pose.rotation.column(2).into_owned();
        let angle_to = |pose: &Rigid| if single { normal(truth).angle(&normal(pose)) } else { truth.angle_to(pose) };
        let angle = angle_to(&found);
        if angle.to_degrees() > WRONG_DEGREES || off.fixed_rows::<3>(0).norm() > wrong_mm {
            self.wrong += 1;
            let is_right = |other: &Alternative, pose: &Pose| {
                let Alternative { position_mm, orientation_xyzw, .. } = *other;
                angle_to(&rigid(&Pose { position_mm, orientation_xyzw, ..pose.clone() }).0).to_degrees()
                    <= WRONG_DEGREES
            };
            let is_said = estimate.pose.iter().any(|pose| pose.alternatives.iter().any(|other| is_right(other, pose)));
            self.admitted += usize::from(is_said);
            return false;
        }
        let Some(covariance) = covariance else {
            self.silent += 1;
            return true;
        };
        if let Some(inverse) = covariance.try_inverse().filter(|_| !single) {
            self.nees += off.dot(&(inverse * off));
            self.nees_of += 1;
        }
        if let Some(bound) = bound.filter(|_| !single) {
            for k in 0..2 {
                let least = bound.fixed_view::<3, 3>(3 * k, 3 * k).trace();
                self.squares[k] += off.fixed_rows::<3>(3 * k).norm_squared() / least;
            }
            self.bounded += 1;
        }
        true
    }

    /// rms errors of position and rotation over the bound.
    pub fn ratios(&self) -> [String; 2] {
        self.squares.map(|squares| match self.bounded {
            0 => "–".into(),
            frames => format!("{:.2}", (squares / frames as f64).sqrt()),
        })
    }

    /// Mean NEES.
    pub fn nees(&self) -> String {
        if self.nees_of > 0 { format!("{:.1}", self.nees / self.nees_of as f64) } else { "–".into() }
    }

    /// Number of wrong poses with the state `tracking`.
    pub fn wrong(&self) -> String {
        match self.admitted {
            0 => self.wrong.to_string(),
            admitted => format!("{} ({admitted} say so)", self.wrong),
        }
    }

    /// A row of the table.
    pub fn text(&self, name: &str) -> String {
        let [position, rotation] = self.ratios();
        format!(
            "| {name} | {} | {} | {} | {} | {position} / {rotation} | {} | {} |",
            self.frames,
            self.tracking,
            self.wrong(),
            self.silent,
            self.nees(),
            self.late
        )
    }
}

/// The head of the table.
pub const HEAD: &str = "| condition | frames | `tracking` | of them wrong | without covariance | position / rotation, rms over bound | NEES | frames until right |\n|---|---|---|---|---|---|---|---|";
