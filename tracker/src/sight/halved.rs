//! A coarse search: finds targets in a picture with half the pixels along x and y, four times as fast. Inputs and results
//! are in whole pixels.

use crate::budget::{Spend, Stop};
use crate::sight::grey::Grey;
use crate::sight::start::{FindOptions, FoundDetections, find};

/// Fewest cells of a target; a hot pixel is in one of them.
const CELLS_MIN: usize = 2;

/// Finds targets in a picture at half resolution (see [`Grey::read_halved`]); results are in whole pixels.
///
/// # Errors
/// When `spend` ends the search.
pub(crate) fn find_halved(grey: &Grey, options: &FindOptions, spend: Spend) -> Result<FoundDetections, Stop> {
    // Cell i holds pixels 2i and 2i + 1.
    let cell = |place: [f64; 4]| [0.5 * (place[0] - 0.5), 0.5 * (place[1] - 0.5), place[2], place[3]];
    let unit = [2.0, 2.0, 1.0, 1.0];
    let mut coarse = options.clone();
    coarse.pixels_min = Some(CELLS_MIN);
    coarse.near = options.near.map(cell);
    for mask in &mut coarse.masks {
        mask.first = [mask.first[0] / 2, mask.first[1] / 2, mask.first[2], mask.first[3]];
        for axis in 0..2 {
            mask.size[axis] = (mask.size[axis] / 2 + 1).min(grey.size[axis].saturating_sub(mask.first[axis]));
        }
        mask.centre = cell(mask.centre);
        for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
            mask.extent[i][j] *= unit[i] * unit[j];
        }
    }
    let mut found = find(grey, &coarse, spend)?;
    for detection in &mut found.detections {
        let [x, y, z, w] = detection.centre;
        detection.centre = [2.0 * x + 0.5, 2.0 * y + 0.5, z, w];
        detection.saturated *= 4;
        for i in 0..4 {
            detection.size[i] *= unit[i];
            for j in 0..4 {
                detection.extent[i][j] /= unit[i] * unit[j];
            }
        }
    }
    found.noise *= 2.0;
    Ok(found)
}
