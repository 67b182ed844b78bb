//! Checks that model, target, lens and frame size match; otherwise poses would be wrong by the difference.

use isophote_symbolic::Model;

use super::target::Target;
use crate::camera::Intrinsics;

/// Why no pose can be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PoseMismatch {
    /// A spot of the model that the target lacks.
    #[error(
        "the model looks for a spot `{spot}`, which the target does not have; its spots are {names}. Name the target's spots \
         like the model's tables of roles"
    )]
    Missing {
        /// In the model.
        spot: String,
        /// In the target.
        names: String,
    },
    /// A spot of the target that the model lacks.
    #[error(
        "the target has a spot `{spot}`, which the model does not look for; it looks for {names}. Take a model of all the \
         target's spots, or a target of those that it looks for"
    )]
    Unseen {
        /// In the target.
        spot: String,
        /// In the model.
        names: String,
    },
    /// A raised spot in a model of a flat target.
    #[error(
        "the spot `{spot}` of the target stands at z = {z_mm} mm, but the model's target is flat: it has no constant `{spot}_z`. \
         Take a model that has one"
    )]
    Raised {
        /// In both.
        spot: String,
        /// Its z.
        z_mm: f64,
    },
    /// Intrinsics for another image size.
    #[error(
        "the camera's intrinsics are for images of {for_size}, the frames are {size}: calibrate at this size, or scale fx, fy, cx \
         and cy to it and say so in width and height"
    )]
    Size {
        /// Of the intrinsics, px.
        for_size: String,
        /// Of a frame, px.
        size: String,
    },
}

impl PoseMismatch {
    /// Checks a target against a model.
    ///
    /// # Errors
    /// For the first mismatch.
    pub(crate) fn check_target(model: &Model, target: &Target) -> Result<(), PoseMismatch> {
        let known: Vec<&String> = model.roles().iter().filter_map(|roles| roles.name.as_ref()).collect();
        let is_pose = model.roles().iter().any(|roles| !roles.position.is_empty());
        // A single spot needs no name.
        if known.is_empty() && model.roles().len() == 1 && target.spots.len() == 1 && !is_pose {
            return Ok(());
        }
        let of_target = || names(target.spots.iter().map(|spot| &spot.name));
        let missing = known.iter().find(|name| !target.spots.iter().any(|spot| spot.name == ***name));
        if let Some(spot) = missing {
            return Err(PoseMismatch::Missing { spot: spot.to_string(), names: of_target() });
        }
        for spot in &target.spots {
            if !known.contains(&&spot.name) {
                let names = names(known.iter().copied());
                return Err(PoseMismatch::Unseen { spot: spot.name.clone(), names });
            }
            let [.., z_mm] = spot.position_mm;
            if is_pose && z_mm != 0.0 && model.constant(&format!("{}_z", spot.name)).is_none() {
                return Err(PoseMismatch::Raised { spot: spot.name.clone(), z_mm });
            }
        }
        Ok(())
    }

    /// Checks a lens against a frame's width and height.
    ///
    /// # Errors
    /// When the lens is for another image size.
    pub(crate) fn check_size(lens: &Intrinsics, size: &[usize]) -> Result<(), PoseMismatch> {
        let for_size = [lens.width as usize, lens.height as usize];
        if size == for_size {
            return Ok(());
        }
        let format_size = |size: &[usize]| {
            let sides: Vec<String> = size.iter().map(usize::to_string).collect();
            format!("{} px", sides.join(" × "))
        };
        Err(PoseMismatch::Size { for_size: format_size(&for_size), size: format_size(size) })
    }
}

/// Quoted names, joined for a message.
fn names<'a>(all: impl Iterator<Item = &'a String>) -> String {
    let quoted: Vec<String> = all.map(|name| format!("`{name}`")).collect();
    match quoted.is_empty() {
        true => "spots without names".to_string(),
        false => quoted.join(", "),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::pose::TargetSpot;

    fn target(spots: &[(&str, f64)]) -> Target {
        let spot =
            |&(name, z): &(&str, f64)| TargetSpot { name: name.into(), position_mm: [0.0, 80.0, z], radius_mm: 30.0 };
        Target { spots: spots.iter().map(spot).collect(), ..Target::default() }
    }

    fn verdict(document: &str, spots: &[(&str, f64)]) -> Option<String> {
        let path = format!("{}/../models/{document}.toml", env!("CARGO_MANIFEST_DIR"));
        let model = Model::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap();
        PoseMismatch::check_target(&model, &target(spots)).err().map(|error| error.to_string())
    }

    #[test]
    fn a_target_has_the_models_spots_and_no_others() {
        let three = [("red", 0.0), ("green", 0.0), ("blue", 0.0)];
        for document in ["three-spots", "three-spots-raw", "three-spots-pose", "three-spots-pose-raw"] {
            assert_eq!(verdict(document, &three), None, "{document}");
            let message = verdict(document, &three[..2]).unwrap();
            assert!(
                message.contains("`blue`, which the target does not have") && message.contains("`red`, `green`"),
                "{message}"
            );
            let more = [&three[..], &[("white", 0.0)]].concat();
            assert!(verdict(document, &more).unwrap().contains("`white`, which the model does not look for"));
        }
        assert_eq!(verdict("spot", &[("lamp", 0.0)]), None);
        assert!(verdict("spot", &three).unwrap().contains("spots without names"));
    }

    #[test]
    fn only_formulas_of_flat_targets_refuse_raised_spots() {
        let raised = [("red", 0.0), ("green", 0.0), ("blue", -110.0)];
        assert!(verdict("three-spots-pose", &raised).unwrap().contains("z = -110 mm"));
        assert_eq!(verdict("three-spots", &raised), None);
    }
}
