//! The shortcut of documents with several stages, and frames without a target.

#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use isophote_symbolic::{Model, Precision};

use crate::picture::{Falloff, Spot, TestPicture};
use crate::{Compiled, Estimate, Frame, TrackState, Tracker, TrackerOptions};

const SPOT: &str = include_str!("../../../models/spot.toml");
const FIRST: &str = "[[stages]]\nparameters = [\"bx\", \"by\"]\nmethod = \"gauss-newton\"\n\n[[stages]]";

fn tracker(document: &str) -> Tracker {
    let model = Model::from_toml(document).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    Tracker::new(Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap()), TrackerOptions::default()).unwrap()
}

/// A target of this amplitude that moves by 2 px a frame, in noise of 0.75 DN.
fn frame(number: u64, amplitude: f64) -> Frame {
    let centre = [60.3 + 2.0 * number as f64, 80.8];
    let spot = Spot { centre, half: [20.0, 14.0], angle: 0.4, amplitude, profile: Falloff::Cubic(-0.5, -0.3) };
    TestPicture { noise: 0.75, seed: number, ..TestPicture::new(240, 160, vec![spot]) }.frame().with_sequence(number)
}

#[test]
fn a_followed_target_skips_stages_that_the_last_one_includes() {
    let (mut one, mut two) = (tracker(SPOT), tracker(&SPOT.replacen("[[stages]]", FIRST, 1)));
    for number in 0..6 {
        let [of_one, of_two] = [&mut one, &mut two].map(|tracker| tracker.track(&frame(number, 150.0)));
        assert_eq!([of_one.state, of_two.state], [TrackState::Tracking; 2], "{number}: {of_two:?}");
        assert_eq!(of_two.iterations.len(), 2);
        assert_eq!(of_two.iterations[0] == 0, number > 0, "{number}: {:?}", of_two.iterations);
        let covariance = of_one.covariance.as_ref().unwrap();
        for (position, parameter) in [0, 1].into_iter().enumerate() {
            let off = (of_two.parameters[parameter] - of_one.parameters[parameter]).abs();
            assert!(off < 0.15 * covariance[position][position].sqrt(), "{number}: {off} px");
        }
    }
    // A stage that the last one does not include always runs.
    let apart = SPOT.replacen("[[stages]]", "[[stages]]\nparameters = [\"k1\"]\n\n[[stages]]", 1);
    let mut apart = tracker(&apart);
    let all: Vec<Estimate> = (0..3).map(|number| apart.track(&frame(number, 150.0))).collect();
    assert!(all[2].state == TrackState::Tracking && all[2].stages[0].passes > 0, "{:?}", all[2].stages);
}

#[test]
fn a_target_that_is_gone_coasts_and_one_that_fades_or_moves_is_tracked() {
    let mut tracker = tracker(SPOT);
    (0..6).for_each(|number| assert_eq!(tracker.track(&frame(number, 150.0)).state, TrackState::Tracking));
    let dark = tracker.fork().track(&frame(6, 0.0));
    assert_eq!(dark.state, TrackState::Coasting, "{dark:?}");
    let [faded, moved] = [frame(6, 15.0), frame(11, 150.0).with_sequence(6)].map(|frame| tracker.fork().track(&frame));
    assert_eq!([faded.state, moved.state], [TrackState::Tracking; 2], "{faded:?} {moved:?}");
    assert!((moved.parameters[0] - 82.3).abs() < 0.2, "{moved:?}");
}

#[test]
fn a_formula_valid_only_in_its_domain_converges_after_a_jump() {
    let mut tracker = tracker(include_str!("../../../models/thesis-spot.toml"));
    let at = |number: u64, jump: f64| {
        let centre = [60.3 + 2.0 * number as f64 + jump, 80.8];
        let profile = Falloff::Cubic(-0.5, -0.3);
        let spot = Spot { centre, half: [20.0, 14.0], angle: 0.4, amplitude: 150.0, profile };
        TestPicture { noise: 0.75, seed: number, ..TestPicture::new(240, 160, vec![spot]) }
            .frame()
            .with_sequence(number)
    };
    (0..6).for_each(|number| assert_eq!(tracker.track(&at(number, 0.0)).state, TrackState::Tracking));
    let calm = tracker.fork().track(&at(6, 0.0));
    let deviation = calm.covariance.as_ref().unwrap()[0][0].sqrt();
    for jump in [0.3, 0.5, 0.7, 1.0] {
        let surprised = tracker.fork().track(&at(6, jump));
        // The bias of sampling at pixel centres is nearly the same in both.
        let off = surprised.parameters[0] - jump - calm.parameters[0];
        assert!(off.abs() < 2.0 * deviation, "{jump}: {off} of {deviation}");
    }
}
