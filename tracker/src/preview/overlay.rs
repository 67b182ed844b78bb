//! `PreviewOverlay`: the drawing over a frame.

use isophote_jit::{PlaneView, Window};
use nalgebra::Vector3;

use super::contour::Polyline;
use super::level;
use super::section::CrossSection;
use super::viewer::FrameScene;
use crate::camera::Intrinsics;
use crate::pose::Target;
use crate::pose::rigid::Rigid;
use crate::sight::contour::{Contour, contours_in_slice};

/// Largest number of runs of saturated pixels.
const RUNS_MAX: usize = 2000;
/// Points of an ellipse.
const OUTLINE_POINTS: usize = 60;
/// Length of the axes of a target of unknown size, as a share of its distance.
const AXIS_SHARE: f64 = 0.1;

/// The drawing over a frame, in its pixels. Unknown parts are absent or empty.
#[derive(Clone, Debug, Default)]
pub struct PreviewOverlay {
    /// z, w of the slice shown, as many as the model has coordinates for.
    pub slice: Vec<usize>,
    /// Window of the fit: of all targets, in the slice shown.
    pub window: Option<Window>,
    /// The edges of the targets' domains, else their half maximum over the background; x, y, px.
    pub contours: Vec<Vec<[f64; 2]>>,
    /// The targets' outlines dᵀAd = 1 in that slice, where the model has the roles for it; closed lines.
    pub outlines: Vec<Vec<[f64; 2]>>,
    /// Section along x through the first target's centre.
    pub section: Option<CrossSection>,
    /// Pixels at or above their limit, row by row.
    pub saturated: Vec<PixelRun>,
    /// True when more runs were cut off.
    pub saturated_cut: bool,
    /// The targets' axes, for known poses.
    pub axes: Vec<PoseAxis>,
}

/// A run of pixels in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRun {
    /// The row.
    pub y: usize,
    /// The first of them.
    pub first: usize,
    /// The last of them.
    pub last: usize,
}

/// One projected axis of a target.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseAxis {
    /// `x`, `y` or `z` of the target's frame.
    pub axis: &'static str,
    /// The target's origin, px.
    pub from: [f64; 2],
    /// The end of the axis, px.
    pub to: [f64; 2],
}

impl FrameScene<'_> {
    /// The drawing over the frame.
    pub fn overlay(&self) -> PreviewOverlay {
        let (saturated, saturated_cut) = self.saturated();
        PreviewOverlay {
            slice: self.slice.into_iter().take(self.viewer.model().coordinates().len().saturating_sub(2)).collect(),
            window: self.window,
            contours: self.contours(),
            outlines: self.outlines(),
            section: self.section(),
            saturated,
            saturated_cut,
            axes: self.targets.iter().filter_map(|target| self.axes(target.pose.as_ref()?)).flatten().collect(),
        }
    }

    fn contours(&self) -> Vec<Polyline> {
        let (model, constants) = (self.viewer.model(), &self.viewer.solver().constants);
        if model.coordinates().len() < 2 {
            return Vec::new();
        }
        let of_target = |target: &super::viewer::SeenTarget| {
            let intensity = self.viewer.predicted().first(&target.parameters, target.window)?;
            Some(level::contours(model, &target.parameters, constants, target.window, &intensity))
        };
        self.targets.iter().filter_map(of_target).flatten().collect()
    }

    fn outlines(&self) -> Vec<Polyline> {
        let (model, slice) = (self.viewer.model(), self.slice.map(|index| index as f64));
        let all = self.targets.iter().flat_map(|target| contours_in_slice(model, &target.parameters, slice));
        let closed = |contour: Contour| {
            let mut line = contour.outline(OUTLINE_POINTS);
            line.extend(line.first().copied());
            Some(line).filter(|line| !line.is_empty())
        };
        all.filter_map(closed).collect()
    }

    /// Pixels of the slice that are clipped in any channel, and whether the list was cut off.
    fn saturated(&self) -> (Vec<PixelRun>, bool) {
        let Some(planes) = self.planes().filter(|planes| planes.len() == self.limits.len()) else {
            return (Vec::new(), false);
        };
        let [width, height, ..] = self.fitted.sides();
        let mut runs: Vec<PixelRun> = Vec::new();
        let mut is_clipped = vec![false; width];
        for y in 0..height {
            let place = [0, y, self.slice[0], self.slice[1]];
            is_clipped.fill(false);
            let mut is_any = false;
            for (plane, limit) in planes.iter().zip(&self.limits) {
                is_any |= clipped(plane, place, *limit, &mut is_clipped);
            }
            if !is_any {
                continue;
            }
            let mut x = 0;
            while let Some(first) = is_clipped[x..].iter().position(|is| *is).map(|more| x + more) {
                let end = is_clipped[first..].iter().position(|is| !*is).map_or(width, |more| first + more);
                if runs.len() == RUNS_MAX {
                    return (runs, true);
                }
                runs.push(PixelRun { y, first, last: end - 1 });
                x = end;
            }
        }
        (runs, false)
    }

    fn axes(&self, pose: &crate::pose::Pose) -> Option<Vec<PoseAxis>> {
        let solver = self.viewer.solver();
        let lens: &Intrinsics = match &solver.geometry {
            Some(geometry) => &geometry.lens,
            None => solver.options.camera.intrinsics.as_ref()?,
        };
        let target = solver.geometry.as_ref().map(|geometry| &geometry.target).or(solver.options.target.as_ref());
        let rigid = Rigid::of_quaternion(pose.position_mm, pose.orientation_xyzw);
        let length = target.map_or(AXIS_SHARE * rigid.translation.norm(), extent);
        let from = lens.project(pose.position_mm)?;
        let axis = |(axis, direction): (&'static str, Vector3<f64>)| {
            let to = lens.project(rigid.apply(direction * length).into())?;
            Some(PoseAxis { axis, from, to })
        };
        let all = [("x", Vector3::x()), ("y", Vector3::y()), ("z", Vector3::z())];
        Some(all.into_iter().filter_map(axis).collect())
    }
}

/// Extent of a target's spots from its origin, mm.
fn extent(target: &Target) -> f64 {
    let reach = |spot: &crate::pose::TargetSpot| Vector3::from(spot.position_mm).norm() + spot.radius_mm;
    target.spots.iter().map(reach).fold(0.0, f64::max)
}

/// Marks the pixels of a row at or above a limit; true when there are any.
fn clipped(plane: &PlaneView, place: [usize; 4], limit: f64, marks: &mut [bool]) -> bool {
    if limit == f64::INFINITY {
        return false;
    }
    if let Some(bytes) = plane.bytes_of_row(place, marks.len()) {
        // The least integer value at the limit.
        let least = limit.ceil().max(0.0);
        if least > f64::from(u8::MAX) || !bytes.iter().any(|byte| *byte >= least as u8) {
            return false;
        }
    }
    let mut is_any = false;
    for (x, mark) in marks.iter_mut().enumerate() {
        let is = plane.pixel_at([x, place[1], place[2], place[3]]) >= limit;
        *mark |= is;
        is_any |= is;
    }
    is_any
}
