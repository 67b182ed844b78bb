//! What a fit leaves unexplained in and around its target, in the frame in which the outline is a circle.
//!
//! What comes in: a fit of one target in two dimensions. What goes out: residuals of a window that is larger than the domain, and
//! where they are. It never knows what is made of them.

use isophote_jit::Window;
use nalgebra::{Cholesky, Matrix2, Vector2};

use super::solver::{Look, Solver};
use super::window::Margin;
use crate::outline::shape;
use crate::solve::fit::Fit;
use crate::solve::residuals::{Over, Residual};

/// The window is larger than the domain by so much.
const MARGIN: Margin = Margin { share: 0.6, px: [4.0; 4] };

/// Residuals in and around a target.
pub(super) struct Around {
    /// Those of the domain.
    pub inside: Vec<Residual>,
    /// All.
    pub everything: Vec<Residual>,
    pub window: Window,
    turned: Matrix2<f64>,
    centre: [f64; 2],
}

impl Around {
    /// `None` where the model has not one target with a centre and an outline, or no prediction.
    pub fn of(solver: &Solver, look: &Look, fit: &Fit) -> Option<Around> {
        let [roles] = solver.model().roles() else { return None };
        if solver.model().coordinates().len() != 2 || solver.fits_pose() || roles.centre.len() != 2 {
            return None;
        }
        let outline = shape(roles, 2, &fit.parameters)?;
        let turned = Cholesky::new(Matrix2::from_fn(|i, j| outline[(i, j)]))?.l().transpose();
        let centre = [0, 1].map(|axis| fit.parameters[roles.centre[axis].index()]);
        let view = solver.view(look, solver.window(look, &fit.parameters, MARGIN));
        let predictions = solver.compiled.predictions()?;
        let seen = |over| {
            let seen = predictions.residuals(&view, &fit.parameters, &solver.constants, over)?;
            <[_; 1]>::try_from(seen).ok().map(|[seen]| seen.residuals)
        };
        let (inside, everything) = (seen(Over::Domain)?, seen(Over::Everything)?);
        Some(Around { inside, everything, window: view.window, turned, centre })
    }

    /// Where a pixel of the window is: the outline is the unit circle.
    pub fn place(&self, pixel: usize) -> Vector2<f64> {
        let at = [self.window.x + pixel % self.window.width, self.window.y + pixel / self.window.width];
        self.turned * Vector2::new(at[0] as f64 - self.centre[0], at[1] as f64 - self.centre[1])
    }

    /// Pixels of the domain that are below the limit, by their numbers in the window.
    pub fn clear(&self) -> impl Iterator<Item = usize> {
        self.inside.iter().filter(|residual| !residual.saturated).map(|residual| residual.pixel)
    }

    /// Pixels beside the domain.
    pub fn beside(&self) -> impl Iterator<Item = usize> {
        let mut is_inside = vec![false; self.window.pixels()];
        self.inside.iter().for_each(|residual| is_inside[residual.pixel] = true);
        (0..is_inside.len()).filter(move |pixel| !is_inside[*pixel])
    }
}
