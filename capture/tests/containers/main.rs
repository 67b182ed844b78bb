//! Multi-picture files: their frames, and the errors for damaged ones.
#![allow(clippy::unwrap_used)]

mod fits;
mod mcap;
mod tiff;
mod y4m;

use std::path::Path;

use isophote_capture::{FrameSource, Recording};

/// Names, sizes and first-plane pixels of all frames.
fn frames(recording: &mut Recording) -> Vec<(String, Vec<usize>, Vec<f64>)> {
    let all = std::iter::from_fn(|| recording.next().unwrap());
    all.map(|captured| {
        let frame = captured.frame;
        let plane = frame.plane_view(0);
        let pixels = (0..frame.rows()).flat_map(|y| (0..frame.width()).map(move |x| plane.pixel(x, y))).collect();
        (captured.file.unwrap(), frame.size().to_vec(), pixels)
    })
    .collect()
}

/// The first error of a file.
fn refusal(path: &Path) -> String {
    let mut recording = match Recording::open(path) {
        Ok(recording) => recording,
        Err(error) => return error.to_string(),
    };
    std::iter::from_fn(|| recording.next().transpose()).find_map(Result::err).unwrap().to_string()
}

/// Mutates and truncates a good file `rounds` times: it must be read or rejected. Counts both.
fn mutated(path: &Path, whole: &[u8], rounds: usize) -> [usize; 2] {
    let mut state: u64 = 5;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut outcomes = [0; 2];
    for round in 0..rounds {
        let mut bytes = whole.to_vec();
        for _ in 0..1 + random(3) {
            let at = random(bytes.len());
            bytes[at] = [0, 1, b'9', 127, 255, 128, bytes[at] ^ 1 << random(8), random(256) as u8][random(8)];
        }
        if random(4) == 0 {
            bytes.truncate(random(bytes.len()));
        }
        std::fs::write(path, &bytes).unwrap();
        let outcome = Recording::of_dimensions(path, 2 + round % 2).and_then(|mut recording| {
            recording.size();
            for _ in 0..recording.len().min(6) {
                recording.next()?;
            }
            Ok(())
        });
        outcomes[usize::from(outcome.is_err())] += 1;
    }
    outcomes
}
