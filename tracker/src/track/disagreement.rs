//! `Disagreement`: the difference between two models' estimates of one target in one frame: the distance of their centres, px, and
//! of each shared parameter, in its unit and in standard deviations.

use std::collections::BTreeMap;

use isophote_symbolic::{Model, ParameterId};
use serde::{Deserialize, Serialize};

use crate::estimate::{Estimate, TrackState};

/// Difference between two estimates.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Disagreement {
    /// Distance between the centres, px; for several spots, the root mean square. Absent unless both models have the same
    /// number of centres.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub centre_px: Option<f64>,
    /// Differences of the parameters that both models have, by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, ParameterShift>,
}

/// Difference between two estimates of one parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ParameterShift {
    /// The second value minus the first.
    pub difference: f64,
    /// The difference over √(σ₁² + σ₂²), as for independent errors. Absent if either σ is unknown.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub deviations: Option<f64>,
}

impl Disagreement {
    /// The second less the first; empty where one of them does not see the target.
    pub fn between(first: (&Model, &Estimate), second: (&Model, &Estimate)) -> Disagreement {
        if [first, second].iter().any(|(_, estimate)| estimate.state != TrackState::Tracking) {
            return Disagreement::default();
        }
        let shift = |id: usize, name: &str| {
            let other = second.0.parameter(name)?;
            let difference = second.1.parameters.get(other.index())? - first.1.parameters.get(id)?;
            let deviation = variance(first.1, id).zip(variance(second.1, other.index()));
            let deviation = deviation.map(|(one, other)| (one + other).sqrt()).filter(|deviation| *deviation > 0.0);
            let deviations = deviation.map(|deviation| difference / deviation).filter(|ratio| ratio.is_finite());
            difference.is_finite().then(|| (name.to_string(), ParameterShift { difference, deviations }))
        };
        let parameters = first.0.parameters().iter().enumerate();
        Disagreement {
            centre_px: centre_px(first, second),
            parameters: parameters.filter_map(|(id, parameter)| shift(id, &parameter.name)).collect(),
        }
    }
}

fn variance(estimate: &Estimate, parameter: usize) -> Option<f64> {
    let row = estimate.order.iter().position(|id| id.index() == parameter)?;
    estimate.covariance.as_ref()?.get(row)?.get(row).copied()
}

fn centre_px(first: (&Model, &Estimate), second: (&Model, &Estimate)) -> Option<f64> {
    let centres = |model: &Model| -> Vec<Vec<ParameterId>> {
        let centres = model.roles().iter().map(|roles| roles.centre.clone());
        centres.filter(|centre| !centre.is_empty()).collect()
    };
    let (one, other) = (centres(first.0), centres(second.0));
    let is_alike = one.len() == other.len() && one.iter().zip(&other).all(|(a, b)| a.len() == b.len());
    if one.is_empty() || !is_alike {
        return None;
    }
    let pairs = one.iter().flatten().zip(other.iter().flatten());
    let square = |(a, b): (&ParameterId, &ParameterId)| {
        Some((first.1.parameters.get(a.index())? - second.1.parameters.get(b.index())?).powi(2))
    };
    let sum: f64 = pairs.map(square).sum::<Option<f64>>()?;
    Some((sum / one.len() as f64).sqrt()).filter(|distance| distance.is_finite())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use isophote_symbolic::Precision;

    use super::*;
    use crate::picture::{Spot, TestPicture};
    use crate::{Compiled, Tracker, TrackerOptions};

    const PLAIN: &str = include_str!("../../../tests/documents/plain-spot.toml");
    const GAUSSIAN: &str = include_str!("../../../models/gaussian.toml");

    fn estimate(document: &str, at: [f64; 2]) -> (Arc<Model>, Estimate) {
        let model = Arc::new(Model::from_toml(document).unwrap());
        let compiled = Arc::new(Compiled::new(model.clone(), Precision::F32).unwrap());
        let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
        let spots = vec![Spot::at(at[0], at[1], 12.0, 120.0)];
        let frame = TestPicture { noise: 1.5, seed: 3, ..TestPicture::new(120, 90, spots) }.frame();
        (model, tracker.track(&frame))
    }

    #[test]
    fn centres_and_parameters_of_one_name_are_compared() {
        let (one, other) = (estimate(PLAIN, [50.0, 40.0]), estimate(GAUSSIAN, [53.0, 44.0]));
        let apart = Disagreement::between((&one.0, &one.1), (&other.0, &other.1));
        assert!((apart.centre_px.unwrap() - 5.0).abs() < 0.2, "{apart:?}");
        let bx = apart.parameters["bx"];
        assert!((bx.difference - 3.0).abs() < 0.2, "{apart:?}");
        let deviation = |(model, estimate): &(Arc<Model>, Estimate)| {
            variance(estimate, model.parameter("bx").unwrap().index()).unwrap()
        };
        let expected = bx.difference / (deviation(&one) + deviation(&other)).sqrt();
        assert!((bx.deviations.unwrap() / expected - 1.0).abs() < 1e-12, "{apart:?}");
        assert!(!apart.parameters.contains_key("k1"), "only one of them has it");
        let same = Disagreement::between((&one.0, &one.1), (&one.0, &one.1));
        assert_eq!((same.centre_px, same.parameters["by"].deviations), (Some(0.0), Some(0.0)));
    }

    #[test]
    fn an_unseen_target_is_not_compared() {
        let (seen, mut lost) = (estimate(PLAIN, [50.0, 40.0]), estimate(PLAIN, [50.0, 40.0]));
        lost.1.state = TrackState::Lost;
        let apart = Disagreement::between((&seen.0, &seen.1), (&lost.0, &lost.1));
        assert_eq!(apart, Disagreement::default());
    }
}
