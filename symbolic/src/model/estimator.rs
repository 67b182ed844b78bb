//! `Estimator`: a starting value estimated from an image.

/// Named starting values, found from the image's histogram and moments. Axes are positions of coordinates: 0 is the first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Estimator {
    /// Centre, px.
    Centroid(usize),
    /// Entry of A, px⁻²; the row is not after the column.
    Extent(usize, usize),
    /// Half extent, px.
    Size(usize),
    /// Level of the surroundings, pixel value.
    Background,
    /// Signed height over the background, pixel value.
    Amplitude,
    /// Angle of the long axis, from the first coordinate towards the second, −π/2 to π/2, rad.
    Angle,
    /// Frequency of the strongest wave, cycles a pixel.
    Frequency,
    /// Direction of the strongest wave, from the first coordinate towards the second, −π/2 to π/2, rad.
    Direction,
    /// Phase of the strongest wave where all coordinates are 0, −π to π, rad.
    Phase,
    /// The target's origin in the camera's frame, by axis, mm.
    Position(usize),
    /// Modified Rodrigues parameter of the rotation from target axes to camera axes, by axis.
    Orientation(usize),
}

impl Estimator {
    /// Every estimator.
    pub const ALL: [Estimator; 30] = {
        use Estimator::*;
        [
            Centroid(0),
            Centroid(1),
            Centroid(2),
            Centroid(3),
            Extent(0, 0),
            Extent(0, 1),
            Extent(0, 2),
            Extent(0, 3),
            Extent(1, 1),
            Extent(1, 2),
            Extent(1, 3),
            Extent(2, 2),
            Extent(2, 3),
            Extent(3, 3),
            Size(0),
            Size(1),
            Size(2),
            Size(3),
            Background,
            Amplitude,
            Angle,
            Frequency,
            Direction,
            Phase,
            Position(0),
            Position(1),
            Position(2),
            Orientation(0),
            Orientation(1),
            Orientation(2),
        ]
    };

    /// The name in a document. The letters x, y, z, w stand for the first to the fourth coordinate, whatever its name.
    pub fn name(self) -> &'static str {
        const CENTROID: [&str; 4] = ["centroid.x", "centroid.y", "centroid.z", "centroid.w"];
        const SIZE: [&str; 4] = ["size.x", "size.y", "size.z", "size.w"];
        const EXTENT: [[&str; 4]; 4] = [
            ["extent.xx", "extent.xy", "extent.xz", "extent.xw"],
            ["extent.xy", "extent.yy", "extent.yz", "extent.yw"],
            ["extent.xz", "extent.yz", "extent.zz", "extent.zw"],
            ["extent.xw", "extent.yw", "extent.zw", "extent.ww"],
        ];
        match self {
            Estimator::Centroid(axis) => CENTROID[axis],
            Estimator::Extent(row, column) => EXTENT[row][column],
            Estimator::Size(axis) => SIZE[axis],
            Estimator::Background => "background",
            Estimator::Amplitude => "amplitude",
            Estimator::Angle => "angle",
            Estimator::Frequency => "spectrum.frequency",
            Estimator::Direction => "spectrum.angle",
            Estimator::Phase => "spectrum.phase",
            Estimator::Position(axis) => ["pose.x", "pose.y", "pose.z"][axis],
            Estimator::Orientation(axis) => ["pose.rx", "pose.ry", "pose.rz"][axis],
        }
    }

    /// Number of coordinates that a document needs for it.
    pub fn coordinates(self) -> usize {
        match self {
            Estimator::Centroid(axis) | Estimator::Size(axis) => axis + 1,
            Estimator::Extent(row, column) => row.max(column) + 1,
            Estimator::Background | Estimator::Amplitude | Estimator::Frequency | Estimator::Phase => 1,
            Estimator::Angle | Estimator::Direction => 2,
            Estimator::Position(_) | Estimator::Orientation(_) => 2,
        }
    }
}
