//! The compared methods of pose estimation.

use isophote_symbolic::Model;
use isophote_tracker::Target;
use isophote_tracker::geometry::{Rigid, circles_of_ellipse, fitted_ellipse, kabsch, normalised_ellipse, p3p};
use nalgebra::Vector3;

use super::scene::{LIMIT, lens};

/// Ellipses (x, y, a1, a2, a3) of the three spots, from a fit of `model`.
pub struct Ellipses<'a> {
    pub model: &'a Model,
    pub parameters: &'a [f64],
    pub constants: &'a [f64],
    pub target: &'a Target,
}

impl Ellipses<'_> {
    /// All three ellipses.
    pub fn all(&self) -> [[f64; 5]; 3] {
        std::array::from_fn(|spot| {
            let roles = &self.model.roles()[spot];
            let ids: Vec<_> = roles.centre.iter().chain(&roles.shape).collect();
            std::array::from_fn(|i| self.parameters[ids[i].index()])
        })
    }

    /// A circle pose per spot from its conic, the branch chosen by consistency; then Kabsch on the three centres.
    pub fn conics(&self) -> Option<Rigid> {
        let all = self.all();
        let mut branches = Vec::new();
        for (ellipse, spot) in all.iter().zip(&self.target.spots) {
            branches.push(circles_of_ellipse(&normalised_ellipse(&lens(), *ellipse)?, spot.radius_mm)?);
        }
        let points = self.points();
        // Of the eight combinations, the one whose centres and normals fit the triangle best.
        let ways = (0..8).filter_map(|way| {
            let chosen: Vec<_> = branches.iter().enumerate().map(|(i, both)| both[way >> i & 1]).collect();
            let centres: Vec<Vector3<f64>> = chosen.iter().map(|circle| circle.centre).collect();
            let pose = kabsch(&points, &centres)?;
            let misfit: f64 = points.iter().zip(&centres).map(|(p, c)| (pose.apply(*p) - c).norm_squared()).sum();
            let tilt: f64 = chosen.iter().map(|c| (c.normal - pose.rotation.column(2)).norm_squared()).sum();
            Some((misfit + tilt * 30.0_f64.powi(2), pose))
        });
        ways.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, pose)| pose)
    }

    /// P3P on the centres, the branch chosen by size; `corrected` removes the bias of the fitted centres first.
    pub fn p3p(&self, corrected: bool) -> Option<Rigid> {
        let mut centres = self.all().map(|e| [e[0], e[1]]);
        let mut pose = self.by_size(&centres)?;
        for _ in 0..if corrected { 3 } else { 0 } {
            for (index, spot) in self.target.spots.iter().enumerate() {
                let fit = (self.model, self.parameters, self.constants);
                let seen = fitted_ellipse(fit, LIMIT, &lens(), &pose, spot)?;
                let exact = lens().project(pose.apply(Vector3::from(spot.position_mm)).into())?;
                let measured = self.all()[index];
                centres[index] = [0, 1].map(|k| measured[k] - (seen[k] - exact[k]));
            }
            pose = self.by_size(&centres)?;
        }
        Some(pose)
    }

    fn points(&self) -> [Vector3<f64>; 3] {
        std::array::from_fn(|i| Vector3::from(self.target.spots[i].position_mm))
    }

    fn by_size(&self, centres: &[[f64; 2]; 3]) -> Option<Rigid> {
        let mut rays = [Vector3::zeros(); 3];
        for (ray, centre) in rays.iter_mut().zip(centres) {
            *ray = Vector3::from(lens().ray(*centre)?);
        }
        let misfit = |pose: &Rigid| -> f64 {
            let fit = (self.model, self.parameters, self.constants);
            let one = |(spot, measured): (_, [f64; 5])| {
                let seen = fitted_ellipse(fit, LIMIT, &lens(), pose, spot).unwrap_or([f64::INFINITY; 5]);
                (2..5).map(|k| ((seen[k] - measured[k]) / measured[2]).powi(2)).sum::<f64>()
            };
            self.target.spots.iter().zip(self.all()).map(one).sum()
        };
        p3p(&self.points(), &rays).into_iter().min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }
}
