//! Cold starts with similar, partly hidden spots: the names are right or left open, never wrong.

use super::*;

fn is_near(pose: &Pose, truth: &Rigid) -> bool {
    let angle = |orientation: [f64; 4]| Rigid::of_quaternion(pose.position_mm, orientation).angle_to(truth);
    angle(pose.orientation_xyzw) < 0.05 || pose.alternatives.iter().any(|other| angle(other.orientation_xyzw) < 0.05)
}

/// Turned about the camera's axes, with the first spot's middle at the left rim of the picture.
fn cut_off(turn: [f64; 3], lens: &Intrinsics) -> Rigid {
    let mut truth = pose(turn, [-450.0, 20.0, 1050.0]);
    for _ in 0..3 {
        let at = truth.apply(Vector3::from(FLAT[0]));
        truth.translation.x -= lens.project(at.into()).unwrap()[0] * at.z / lens.fx;
    }
    truth
}

/// Half of the first spot is outside the image, so its outline is wrong.
#[test]
fn a_spot_cut_off_by_the_frame_keeps_its_name() {
    let lens = lens(Distortion::None, &[]);
    let compiled = model("three-spots-pose");
    for (seed, turn) in [(0, [0.35, 0.05, 0.9]), (1, [-0.2, 0.4, 0.75]), (2, [0.1, -0.35, 1.2])] {
        let truth = cut_off(turn, &lens);
        let estimate =
            Tracker::new(compiled.clone(), options(&lens)).unwrap().track(&frame(&truth, &FLAT, &lens, seed));
        assert_eq!(estimate.state, TrackState::Tracking, "{turn:?}: {:?}", estimate.rejection);
        let found = estimate.pose.unwrap();
        assert!(is_near(&found, &truth) && found.alternatives.is_empty(), "{turn:?}: {found:?}");
        assert_close(&found, &truth);
    }
}

/// Two spots with exchanged names have the same image: both poses are published, or none.
#[test]
fn two_spots_of_three_give_no_wrong_pose() {
    let lens = lens(Distortion::None, &[]);
    let compiled = model("three-spots-pose");
    for (seed, turn) in [(0, [0.4, -0.3, 0.5]), (1, [-0.1, 0.5, -2.6]), (2, [0.25, 0.15, 1.4])] {
        let truth = pose(turn, [20.0, -30.0, 950.0]);
        let first = lens.project(truth.apply(Vector3::from(FLAT[0])).into()).unwrap();
        let covered = |[x, y]: [f64; 2], value: f64| match (x - first[0]).hypot(y - first[1]) < 30.0 {
            true => 20.0,
            false => value,
        };
        // Most of it is hidden, and what is left is not of the target.
        let lit = |[x, y]: [f64; 2], value: f64| match (x - first[0]).hypot(y - first[1]) < 30.0 && x > first[0] - 8.0 {
            true => 75.0,
            false => value,
        };
        let veils: [(&str, Veil); 2] = [("covered", &covered), ("lit", &lit)];
        for (name, veil) in veils {
            let mut tracker = Tracker::new(compiled.clone(), options(&lens)).unwrap();
            let estimate = tracker.track(&veiled(&truth, &FLAT, &lens, 70 + seed, veil));
            let pose = estimate.pose.filter(|_| estimate.state == TrackState::Tracking);
            assert!(pose.iter().all(|pose| is_near(pose, &truth)), "{name} {turn:?}: {pose:?}");
            assert!(pose.is_some() || name != "covered", "{turn:?}: {:?}", estimate.rejection);
        }
    }
}

/// The predicted pixel is a mean over its area, also for a spot with a kink at its rim and mostly clipped.
#[test]
fn the_predicted_pixel_is_a_mean_over_its_area() {
    for name in ["three-spots-pose", "raised-spot-pose", "spot-pose"] {
        let compiled = model(name);
        let document = compiled.model();
        let constants: Vec<f64> = document.constants().iter().map(|constant| constant.value).collect();
        let mut parameters = vec![0.0; document.parameters().len()];
        let mut set = |name: &str, value: f64| {
            document.parameter(name).into_iter().for_each(|id| parameters[id.index()] = value);
        };
        let values = [("tz", 2000.0), ("m1", 0.08), ("m2", -0.1), ("blur", (1.0_f64 / 12.0).sqrt())];
        values.into_iter().chain(["vr", "vg", "vb", "v1"].map(|light| (light, 700.0))).for_each(|(n, v)| set(n, v));
        let exact: Vec<f64> = {
            let mut points = parameters.clone();
            points[document.parameter("blur").unwrap().index()] = 0.0;
            points
        };
        let (mut square, mut count) = (0.0, 0.0);
        for pixel in 0..80 * 80 {
            let at = [280.0 + f64::from(pixel % 80), 200.0 + f64::from(pixel / 80)];
            let predicted = document.predicted(&at, &parameters, &constants);
            if (1.0..235.0).contains(&predicted) {
                let place = |k: i32, i: usize| at[i] + (f64::from([k % 8, k / 8][i]) + 0.5) / 8.0 - 0.5;
                let of_place = |k: i32| document.predicted(&[place(k, 0), place(k, 1)], &exact, &constants);
                let mean = (0..64).map(of_place).sum::<f64>() / 64.0;
                (square, count) = (square + (predicted - mean).powi(2), count + 1.0);
            }
        }
        let rms = f64::sqrt(square / count);
        assert!(count > 30.0 && rms < 1.5, "{name}: {rms} DN over {count} pixels");
    }
}
