//! How many synthetic frames a second one core makes: `cargo run --release -p isophote-capture --example frame_rate`.
//!
//! 640 × 480 pixels of 8 bit, 8 × 8 samples, full well 5000 e⁻, read noise 15 e⁻, a spot of 60 × 42 px that moves.

#![allow(clippy::print_stdout)]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use isophote_capture::{FrameSource, Synthetic, SyntheticSpec};
use isophote_symbolic::Model;

const FRAMES: usize = 60;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/../models");
    for name in ["spot", "rational-spot", "gaussian", "dark-disc"] {
        let document = std::fs::read_to_string(format!("{models}/{name}.toml"))?;
        let model = Model::from_toml(&document).map_err(|diagnostics| diagnostics[0].render(name))?;
        let mut spec = SyntheticSpec { full_well_e: 5000.0, read_noise_e: 15.0, ..SyntheticSpec::new(Arc::new(model)) };
        spec.motion = BTreeMap::from([("bx".to_string(), "320 + 80*sin(2*pi*0.2*t)".to_string())]);
        let mut camera = Synthetic::new(spec)?;
        let mut times_ms: Vec<f64> = Vec::with_capacity(FRAMES);
        for _ in 0..FRAMES {
            let start = Instant::now();
            camera.next()?;
            times_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times_ms.sort_by(f64::total_cmp);
        let (median, least, most) = (times_ms[FRAMES / 2], times_ms[0], times_ms[FRAMES - 1]);
        println!(
            "{name:14} {median:6.2} ms a frame (median of {FRAMES}; {least:.2} to {most:.2}): {:.0} Hz",
            1e3 / median
        );
    }
    Ok(())
}
