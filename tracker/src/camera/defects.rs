//! `DefectMap`: the pixels of a camera that say nothing about light, as plain data.
//!
//! What comes in: places. What goes out: whether they can be. It never knows a frame.

use serde::{Deserialize, Serialize};

/// Pixels that may be listed one by one.
const PIXELS_MAX: usize = 65_536;
/// Pixels that a map may cover, columns and rows included.
const COVERED_MAX: usize = 262_144;

/// Pixels of the sensor that fits and searches leave out, in the order of the raw image: hot, dead and noisy ones, whole columns
/// and rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct DefectMap {
    /// Width of the image that the places are for, px.
    pub width: u32,
    /// Height of that image, px.
    pub height: u32,
    /// Single pixels, `[x, y]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pixels: Vec<[u32; 2]>,
    /// Whole columns, by x.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<u32>,
    /// Whole rows, by y.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<u32>,
}

/// Why a map cannot be one, or not that of some frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DefectMapError {
    /// See the text.
    #[error("the defect map has a {what} at {at}, outside of its image of {width} × {height} px")]
    Outside {
        /// A pixel, a column or a row.
        what: &'static str,
        /// Where.
        at: String,
        /// Of the map.
        width: u32,
        /// Of the map.
        height: u32,
    },
    /// See the text.
    #[error("the defect map lists {0} pixels, {PIXELS_MAX} at most; list whole columns and rows as such")]
    Listed(usize),
    /// See the text.
    #[error("the defect map leaves out {0} pixels, {COVERED_MAX} at most")]
    Covered(usize),
    /// See the text.
    #[error(
        "the camera's defect map is for images of {for_size}, the frames are {size}: pixels can only be left out where they are, \
         so make the map from frames of this size (`isophote calibrate pixels`)"
    )]
    Size {
        /// Of the map, px.
        for_size: String,
        /// Of a frame, px.
        size: String,
    },
}

impl DefectMap {
    /// Whether all places are inside, and few enough.
    pub(crate) fn check(&self) -> Result<(), DefectMapError> {
        let DefectMap { width, height, .. } = *self;
        let outside = |what, at| Err(DefectMapError::Outside { what, at, width, height });
        if self.pixels.len() > PIXELS_MAX {
            return Err(DefectMapError::Listed(self.pixels.len()));
        }
        if let Some([x, y]) = self.pixels.iter().find(|[x, y]| *x >= width || *y >= height) {
            return outside("pixel", format!("[{x}, {y}]"));
        }
        if let Some(x) = self.columns.iter().find(|x| **x >= width) {
            return outside("column", format!("x = {x}"));
        }
        if let Some(y) = self.rows.iter().find(|y| **y >= height) {
            return outside("row", format!("y = {y}"));
        }
        let columns = self.columns.len().saturating_mul(height as usize);
        let rows = self.rows.len().saturating_mul(width as usize);
        let covered = self.pixels.len().saturating_add(columns).saturating_add(rows);
        if covered > COVERED_MAX { Err(DefectMapError::Covered(covered)) } else { Ok(()) }
    }

    /// Whether it is that of frames of such a size, px, inner first.
    pub(crate) fn check_size(&self, size: &[usize]) -> Result<(), DefectMapError> {
        let told = |size: &[usize]| {
            let sides: Vec<String> = size.iter().map(usize::to_string).collect();
            format!("{} px", sides.join(" × "))
        };
        let own = [self.width as usize, self.height as usize];
        let [width, height] = [0, 1].map(|axis| size.get(axis).copied().unwrap_or(1));
        match [width, height] == own {
            true => Ok(()),
            false => Err(DefectMapError::Size { for_size: told(&own), size: told(size) }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(pixels: &[[u32; 2]], columns: &[u32], rows: &[u32]) -> DefectMap {
        DefectMap { width: 40, height: 30, pixels: pixels.into(), columns: columns.into(), rows: rows.into() }
    }

    #[test]
    fn places_lie_inside_of_the_image() {
        assert_eq!(map(&[[39, 29], [0, 0]], &[39], &[29]).check(), Ok(()));
        let told = |map: DefectMap| map.check().map_err(|error| error.to_string());
        for (map, place) in [
            (map(&[[40, 0]], &[], &[]), "a pixel at [40, 0]"),
            (map(&[[0, 30]], &[], &[]), "a pixel at [0, 30]"),
            (map(&[], &[40], &[]), "a column at x = 40"),
            (map(&[], &[], &[30]), "a row at y = 30"),
        ] {
            assert!(told(map).is_err_and(|told| told.contains(place) && told.contains("40 × 30 px")));
        }
    }

    #[test]
    fn a_map_is_bounded() {
        let listed = |count: usize| map(&vec![[1, 1]; count], &[], &[]).check();
        assert_eq!(listed(PIXELS_MAX), Ok(()));
        assert_eq!(listed(PIXELS_MAX + 1), Err(DefectMapError::Listed(PIXELS_MAX + 1)));
        let tall = |columns: usize| DefectMap { height: 65_536, ..map(&[], &vec![1; columns], &[]) }.check();
        assert_eq!((tall(4), tall(5)), (Ok(()), Err(DefectMapError::Covered(5 * 65_536))));
        assert!(map(&[], &vec![1; usize::pow(2, 20)], &[]).check().is_err());
    }

    #[test]
    fn a_map_belongs_to_one_size() {
        let map = map(&[], &[], &[]);
        assert_eq!((map.check_size(&[40, 30]), map.check_size(&[40, 30, 7])), (Ok(()), Ok(())));
        for size in [&[30, 40][..], &[40], &[80, 60]] {
            assert!(matches!(map.check_size(size), Err(DefectMapError::Size { .. })), "{size:?}");
        }
    }
}
