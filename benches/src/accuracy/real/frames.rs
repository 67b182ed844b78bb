//! Location and decoding of the photographs.

use std::path::PathBuf;

use isophote_capture::decode;
use isophote_jit::PixelFormat;
use isophote_tracker::{Frame, Plane};

/// Environment variable of the folder, if not beside the repository.
const VARIABLE: &str = "ISOPHOTE_REAL";

/// A folder of photographs; `None` if absent.
pub fn folder(name: &str) -> Option<PathBuf> {
    let root = match std::env::var_os(VARIABLE) {
        Some(path) => PathBuf::from(path),
        None => [env!("CARGO_MANIFEST_DIR"), "..", "..", "shared", "data", "real"].iter().collect(),
    };
    let path = root.join(name);
    path.is_dir().then_some(path)
}

/// All pictures of a folder by name, in order.
pub fn pictures(name: &str) -> Vec<(String, Frame)> {
    let Some(folder) = folder(name) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "png"));
    paths.sort();
    let named = |path: &PathBuf| path.file_stem().unwrap().to_string_lossy().into_owned();
    paths.iter().map(|path| (named(path), grey(&decode(&std::fs::read(path).unwrap()).unwrap()))).collect()
}

fn grey(frame: &Frame) -> Frame {
    if frame.planes().len() == 1 { frame.clone() } else { frame.luma() }
}

/// The frame with `gain` times the exposure, clipped at 255 again.
pub fn exposed(frame: &Frame, gain: f64) -> Frame {
    let (view, width) = (frame.plane_view(0), frame.width());
    let pixel = |i: usize| (gain * view.pixel(i % width, i / width)).round().min(255.0) as u8;
    let pixels = (0..width * frame.rows()).map(pixel).collect();
    Frame::new(frame.size(), vec![Plane::owned(PixelFormat::U8, pixels, width)]).unwrap()
}
