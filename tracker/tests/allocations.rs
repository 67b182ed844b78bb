//! A target without an outline that jitters by less than its size: no frame is searched, and the allocations of a frame
//! are few and do not depend on the number of steps.
#![allow(clippy::unwrap_used, missing_docs)]
#![allow(unsafe_code)] // an allocator, to count what others ask for

use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use isophote_jit::PixelFormat;
use isophote_symbolic::{Model, Precision};
use isophote_tracker::{Compiled, Frame, Plane, Stop, TrackState, Tracker, TrackerOptions, Watch};

/// The system allocator with a counter.
struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are the system's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: `at` came from `alloc` above, and so from the system.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static MEMORY: Counting = Counting;

/// Refuses searches.
struct NoSearch;

impl Watch for NoSearch {
    fn stop(&self) -> Option<Stop> {
        None
    }

    fn search(&self) -> Option<Stop> {
        Some(Stop::Postponed)
    }
}

const SIDE: usize = 25;
/// Largest number of allocations per frame.
const ALLOCATIONS_MAX: usize = 90;
/// Frames until the tracker has learned the jitter.
const SETTLING: u64 = 24;

/// A Gaussian with noise that differs between frames.
fn frame(centre: [f64; 2], number: u64) -> Frame {
    let mut seed = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(number + 1) | 1;
    let mut noise = || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        (seed >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
    };
    let pixel = |i: usize| {
        let [dx, dy] = [(i % SIDE) as f64 - centre[0], (i / SIDE) as f64 - centre[1]];
        let light = 20.0 + 180.0 * (-0.5 * (dx * dx + dy * dy) / 2.0_f64.powi(2)).exp();
        (light + 4.0 * noise()).round() as u8
    };
    let pixels = (0..SIDE * SIDE).map(pixel).collect();
    Frame::new(&[SIDE, SIDE], vec![Plane::owned(PixelFormat::U8, pixels, SIDE)]).unwrap().with_sequence(number)
}

/// A single test, so that no other is counted.
#[test]
fn a_shaken_target_is_not_searched_and_steps_allocate_nothing() {
    let model = Model::from_toml(include_str!("../../models/gaussian-pixel.toml")).unwrap();
    let compiled = Arc::new(Compiled::new(Arc::new(model), Precision::F32).unwrap());
    let mut tracker = Tracker::new(compiled, TrackerOptions::default()).unwrap();
    // Least allocations by number of passes: some frames get extra examination.
    let mut least: BTreeMap<u32, usize> = BTreeMap::new();
    for number in 0..240_u64 {
        let jump = [0.02, 0.3, 1.0][number as usize / 4 % 3] * if number % 2 == 0 { 1.0 } else { -1.0 };
        let frame = frame([12.2 + jump, 11.9 - 0.5 * jump], number);
        let before = COUNT.load(Ordering::Relaxed);
        let estimate = match number < SETTLING {
            true => tracker.track(&frame),
            false => tracker.track_all_while(&frame, &NoSearch).swap_remove(0),
        };
        let count = COUNT.load(Ordering::Relaxed) - before;
        assert_eq!(estimate.state, TrackState::Tracking, "{number}");
        if number >= SETTLING {
            let known = least.entry(estimate.stages[0].passes).or_insert(count);
            *known = count.min(*known);
        }
    }
    assert!(least.len() > 1, "{least:?}");
    let counts: Vec<usize> = least.values().copied().collect();
    assert!(counts.iter().all(|count| *count == counts[0]), "by passes: {least:?}");
    assert!(counts[0] <= ALLOCATIONS_MAX, "{least:?}");
}
