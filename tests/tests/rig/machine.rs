//! The rig: bodies run on another machine, and their failures fail the test.

use isophote_tests::rig::{Outcome, Rig, WEBCAM, in_rig, try_in_rig};

#[test]
#[ignore = "long proof"]
fn a_body_runs_where_there_is_a_camera() {
    let rig = Rig { vivid: Some(WEBCAM), pre: "echo before > /run/before", ..Rig::default() };
    in_rig(rig, || {
        assert!(std::path::Path::new("/dev/video0").exists());
        assert_eq!(std::fs::read_to_string("/run/before").unwrap(), "before\n");
        let kernel = std::fs::read_to_string("/proc/modules").unwrap();
        assert!(kernel.contains("vivid"), "{kernel}");
    });
}

/// A failure in the rig fails the test, with the status of a failed test rather than of a failed rig.
#[test]
#[ignore = "long proof"]
fn a_planted_failure_is_the_tests_failure() {
    match try_in_rig(Rig::default(), || panic!("planted: this is what the rig's failure looks like")) {
        Ok(Outcome::Skipped) => {}
        Ok(Outcome::Passed) => panic!("a body that panics has passed"),
        Err(failure) => {
            assert!(failure.contains("machine::a_planted_failure_is_the_tests_failure failed in the rig"), "{failure}");
            assert!(failure.contains("status Some(101)"), "{failure}");
        }
    }
}
