//! `DefectMap`: the defective pixels of a camera as plain data, and its validation.

use serde::{Deserialize, Serialize};

/// Largest number of pixels listed one by one.
const PIXELS_MAX: usize = 65_536;
/// Largest number of pixels covered, columns and rows included.
const COVERED_MAX: usize = 262_144;

/// Sensor pixels that fits and searches ignore, in coordinates of the raw image: hot, dead and noisy pixels, whole columns and
/// rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct DefectMap {
    /// Width of the image, px.
    pub width: u32,
    /// Height of the image, px.
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

/// Why a map is invalid, or does not match the frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DefectMapError {
    /// An entry outside the image.
    #[error("the defect map has a {what} at {at}, outside of its image of {width} × {height} px")]
    Outside {
        /// The kind: pixel, column or row.
        what: &'static str,
        /// Its coordinates.
        at: String,
        /// Of the map.
        width: u32,
        /// Of the map.
        height: u32,
    },
    /// Too many listed pixels.
    #[error("the defect map lists {0} pixels, {PIXELS_MAX} at most; list whole columns and rows as such")]
    Listed(usize),
    /// Too many covered pixels.
    #[error("the defect map leaves out {0} pixels, {COVERED_MAX} at most")]
    Covered(usize),
    /// The map is for another image size.
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
    /// Checks that all entries are inside the image, and few enough.
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

    /// Checks that the map is for frames of this size, px, inner dimension first.
    pub(crate) fn check_size(&self, size: &[usize]) -> Result<(), DefectMapError> {
        let format_size = |size: &[usize]| {
            let sides: Vec<String> = size.iter().map(usize::to_string).collect();
            format!("{} px", sides.join(" × "))
        };
        let own = [self.width as usize, self.height as usize];
        let [width, height] = [0, 1].map(|axis| size.get(axis).copied().unwrap_or(1));
        match [width, height] == own {
            true => Ok(()),
            false => Err(DefectMapError::Size { for_size: format_size(&own), size: format_size(size) }),
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
    fn entries_outside_the_image_are_rejected() {
        assert_eq!(map(&[[39, 29], [0, 0]], &[39], &[29]).check(), Ok(()));
        let checked = |map: DefectMap| map.check().map_err(|error| error.to_string());
        for (map, place) in [
            (map(&[[40, 0]], &[], &[]), "a pixel at [40, 0]"),
            (map(&[[0, 30]], &[], &[]), "a pixel at [0, 30]"),
            (map(&[], &[40], &[]), "a column at x = 40"),
            (map(&[], &[], &[30]), "a row at y = 30"),
        ] {
            assert!(checked(map).is_err_and(|checked| checked.contains(place) && checked.contains("40 × 30 px")));
        }
    }

    #[test]
    fn too_many_pixels_are_rejected() {
        let listed = |count: usize| map(&vec![[1, 1]; count], &[], &[]).check();
        assert_eq!(listed(PIXELS_MAX), Ok(()));
        assert_eq!(listed(PIXELS_MAX + 1), Err(DefectMapError::Listed(PIXELS_MAX + 1)));
        let tall = |columns: usize| DefectMap { height: 65_536, ..map(&[], &vec![1; columns], &[]) }.check();
        assert_eq!((tall(4), tall(5)), (Ok(()), Err(DefectMapError::Covered(5 * 65_536))));
        assert!(map(&[], &vec![1; usize::pow(2, 20)], &[]).check().is_err());
    }

    #[test]
    fn map_for_another_size_is_rejected() {
        let map = map(&[], &[], &[]);
        assert_eq!((map.check_size(&[40, 30]), map.check_size(&[40, 30, 7])), (Ok(()), Ok(())));
        for size in [&[30, 40][..], &[40], &[80, 60]] {
            assert!(matches!(map.check_size(size), Err(DefectMapError::Size { .. })), "{size:?}");
        }
    }
}
