//! The short form of `examples/soak.rs`: memory is freed, and swapping kernels is safe. Alone in its file: it measures the
//! memory of the process.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod common;

use common::soak::{cycles, executable_maps, resident_kib, subjects, swapping};

#[test]
fn kernels_are_freed_and_swapped_safely() {
    let subjects = subjects();
    assert_eq!(cycles(&subjects, 100), 0, "wrong answers");
    let before = resident_kib();
    assert_eq!(cycles(&subjects, 300), 0, "wrong answers");
    let growth = resident_kib().saturating_sub(before);
    // A leaked page of code in each cycle would be 1,200 KiB.
    assert!(growth < 600, "300 cycles grew by {growth} KiB");

    // Planted fault: kernels that are not dropped are detected.
    let before = resident_kib();
    let kept: Vec<_> = (0..300).map(|i| subjects[i % subjects.len()].compile()).collect();
    assert!(resident_kib() - before > 600, "{} kernels that nobody dropped are not seen", kept.len());
    drop(kept);

    let (mut expected, maps) =
        (subjects.iter().map(|subject| subject.run(&subject.compile())).collect::<Vec<_>>(), executable_maps());
    let seen = swapping(&subjects, &expected, 2000);
    assert!(seen.wrong == 0 && seen.fewest > 0, "{seen:?}");
    assert!(seen.live == 1 && (2..=5).contains(&seen.most_live), "{seen:?}");
    assert_eq!(executable_maps(), maps, "code that outlives its kernel");
    expected[1] = expected[0].clone();
    let seen = swapping(&subjects, &expected, 20);
    assert!(seen.wrong > 0, "a planted wrong expectation is not seen: {seen:?}");
}
