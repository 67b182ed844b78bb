//! `Target`: the spots of a rigid target in its own frame.

use isophote_frame::NUMBER_MAX;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// A rigid target: round spots whose planes are parallel to its x and y axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Display name.
    #[serde(default)]
    pub name: String,
    /// One or more spots, named as the model's tables of roles.
    pub spots: Vec<TargetSpot>,
    /// Reading of each channel (row) for each light (column), in the order red, green, blue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mixing: Option<[[f64; 3]; 3]>,
}

/// A round spot of a target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct TargetSpot {
    /// Name of its roles in the model.
    pub name: String,
    /// Its centre in the target's right-handed frame, mm.
    pub position_mm: [f64; 3],
    /// Radius of the contour s = 1, mm.
    pub radius_mm: f64,
}

/// Why a target is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TargetError {
    /// Wrong number of spots.
    #[error("a target has 1 to {SPOTS_MAX} spots, this one {0}")]
    Count(usize),
    /// Two spots share a name.
    #[error("two spots of the target have the name `{0}`")]
    Twice(String),
    /// Invalid position.
    #[error("`position_mm` of the spot `{0}` must be three numbers from -1e9 to 1e9")]
    Position(String),
    /// Invalid radius.
    #[error("`radius_mm` of the spot `{0}` must be a positive number, 1e9 at most")]
    Radius(String),
    /// Mixing entries out of range.
    #[error("`mixing` has numbers that are not from -1e30 to 1e30")]
    Numbers,
    /// Singular mixing matrix.
    #[error("`mixing` has no inverse: the lights cannot be told apart")]
    Mixing,
}

/// Largest coordinate or radius: a thousand kilometres.
const LENGTH_MM_MAX: f64 = 1e9;
/// Largest number of spots.
const SPOTS_MAX: usize = 16;
/// Least determinant of a mixing matrix, as a share of its largest entry's cube.
const DETERMINANT_MIN: f64 = 1e-6;

impl TargetSpot {
    /// Its centre.
    pub(crate) fn centre(&self) -> Vector3<f64> {
        Vector3::from(self.position_mm)
    }
}

impl Target {
    /// Checks counts, names and numbers.
    ///
    /// # Errors
    /// For the first invalid figure.
    pub fn check(&self) -> Result<(), TargetError> {
        if self.spots.is_empty() || self.spots.len() > SPOTS_MAX {
            return Err(TargetError::Count(self.spots.len()));
        }
        for (index, spot) in self.spots.iter().enumerate() {
            if self.spots[..index].iter().any(|other| other.name == spot.name) {
                return Err(TargetError::Twice(spot.name.clone()));
            }
            if !spot.position_mm.iter().all(|c| c.abs() <= LENGTH_MM_MAX) {
                return Err(TargetError::Position(spot.name.clone()));
            }
            if !(spot.radius_mm > 0.0 && spot.radius_mm <= LENGTH_MM_MAX) {
                return Err(TargetError::Radius(spot.name.clone()));
            }
        }
        let Some(mixing) = self.mixing else { return Ok(()) };
        if !mixing.iter().flatten().all(|entry| entry.abs() <= NUMBER_MAX) {
            return Err(TargetError::Numbers);
        }
        let matrix = Matrix3::from_fn(|row, column| mixing[row][column]);
        let regular = matrix.determinant().abs() > DETERMINANT_MIN * matrix.amax().powi(3);
        if regular { Ok(()) } else { Err(TargetError::Mixing) }
    }

    /// The value of a model's constant of that name, as far as the target gives it: `red_x`, `red_y`, `red_z` and
    /// `red_radius` of a spot `red`, mm; `m_rg` what the red channel reads of a green light that the green one reads as 1.
    pub fn constant(&self, name: &str) -> Option<f64> {
        if let Some(&[channel, light]) = name.strip_prefix("m_").map(str::as_bytes)
            && let (Some(row), Some(column)) = (letter(channel), letter(light))
        {
            let mixing = self.mixing?;
            return Some(mixing[row][column] / mixing[column][column]);
        }
        let (spot, what) = name.rsplit_once('_')?;
        let spot = self.spots.iter().find(|known| known.name == spot)?;
        match what {
            "x" => Some(spot.position_mm[0]),
            "y" => Some(spot.position_mm[1]),
            "z" => Some(spot.position_mm[2]),
            "radius" => Some(spot.radius_mm),
            _ => None,
        }
    }
}

fn letter(name: u8) -> Option<usize> {
    b"rgb".iter().position(|known| *known == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target() -> Target {
        let spot = |name: &str, x: f64| TargetSpot { name: name.into(), position_mm: [x, 2.0, 3.0], radius_mm: 30.0 };
        let mixing = Some([[2.0, 0.1, 0.0], [0.2, 1.0, 0.1], [0.0, 0.1, 4.0]]);
        Target { name: "t".into(), spots: vec![spot("red", 1.0), spot("far_left", 5.0)], mixing }
    }

    #[test]
    fn constants_are_named_after_spots_and_channels() {
        let given = |name: &str| target().constant(name);
        assert_eq!((given("red_x"), given("red_z"), given("far_left_x")), (Some(1.0), Some(3.0), Some(5.0)));
        assert_eq!(
            (given("far_left_radius"), given("red_w"), given("blue_x"), given("gain")),
            (Some(30.0), None, None, None)
        );
        assert_eq!(
            (given("m_rg"), given("m_gr"), given("m_gb"), given("m_rw")),
            (Some(0.1), Some(0.1), Some(0.025), None)
        );
    }

    #[test]
    fn invalid_targets_are_rejected() {
        assert_eq!(target().check(), Ok(()));
        let with = |change: &dyn Fn(&mut Target)| {
            let mut target = target();
            change(&mut target);
            target.check()
        };
        assert_eq!(with(&|t| t.spots.clear()), Err(TargetError::Count(0)));
        assert_eq!(with(&|t| t.spots[1].name = "red".into()), Err(TargetError::Twice("red".into())));
        assert_eq!(with(&|t| t.spots[0].radius_mm = 0.0), Err(TargetError::Radius("red".into())));
        assert_eq!(with(&|t| t.spots[0].position_mm[1] = f64::NAN), Err(TargetError::Position("red".into())));
        assert_eq!(with(&|t| t.spots[0].position_mm[2] = -1e300), Err(TargetError::Position("red".into())));
        assert_eq!(with(&|t| t.spots[0].radius_mm = 1e300), Err(TargetError::Radius("red".into())));
        assert_eq!(with(&|t| t.mixing = Some([[1.0; 3]; 3])), Err(TargetError::Mixing));
        assert_eq!(with(&|t| t.mixing = Some([[1e300; 3]; 3])), Err(TargetError::Numbers));
    }
}
