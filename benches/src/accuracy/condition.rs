//! Conditions: the contents of a frame, and the shipped document fitted to it.

use super::light::{PROFILE, SAMPLES};
use super::scene::Scene;

/// Light beside the spot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Glare {
    /// Nothing.
    None,
    /// A plane 40 DN above the background, with this slope in DN/px.
    Plane([f64; 2]),
    /// A round Gaussian: height in DN, centre in px of the frame, standard deviation in px.
    Lobe {
        /// DN
        height: f64,
        /// px
        centre: [f64; 2],
        /// px
        width: f64,
    },
    /// The same with the wide wings of a Lorentzian, h/(1 + d²/w²).
    Lorentz {
        /// DN
        height: f64,
        /// px
        centre: [f64; 2],
        /// px
        width: f64,
    },
}

/// A second spot of the same shape and profile, absent from the document.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Companion {
    /// Relative to the target's brightness.
    pub share: f64,
    /// Distance of the centres, px; in a random direction.
    pub distance_px: f64,
    /// Relative to the target's size.
    pub size: f64,
}

/// Contents of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Name in the tables.
    pub name: &'static str,
    /// Side of the frame, px.
    pub side_px: usize,
    /// Semi-axes of the spot, the longer first, px.
    pub semi_axes_px: [f64; 2],
    /// Background, DN.
    pub background: f64,
    /// Share of the spot's area that reaches 255 DN.
    pub saturated: f64,
    /// Unsaturated peak value, DN.
    pub peak: f64,
    /// k₁ and k₂ of the profile.
    pub profile: [f64; 2],
    /// Samples along a side of a pixel for rendering; the bound uses fewer.
    pub samples: usize,
    /// Light beside the spot.
    pub glare: Glare,
    /// Share of the spot's area hidden by a dark half plane.
    pub occluded: f64,
    /// Share of the spot's area hidden by a dark disc.
    pub behind_disc: f64,
    /// Share of the spot's area washed out by a white half plane with a soft edge.
    pub blinded: f64,
    /// A second spot.
    pub companion: Option<Companion>,
    /// Motion of the spot during an exposure, px; in a random direction.
    pub motion_px: f64,
    /// Standard deviation of the blur, px.
    pub blur_px: f64,
    /// Share of pixels that read 255 DN whatever the light.
    pub hot: f64,
    /// Share of pixels that read 40 to 200 DN more than the light.
    pub warm: f64,
    /// Whether the camera document describes such pixels.
    pub defects: Defects,
    /// Standard deviation of the offset of a row, DN.
    pub row_noise: f64,
    /// Whether the camera document states the row noise.
    pub rows: RowNoise,
}

/// The camera document's statement of row noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowNoise {
    /// None.
    Unknown,
    /// States its standard deviation.
    Stated,
}

/// The camera document's statement of defects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defects {
    /// None.
    Unknown,
    /// Has a defect map.
    Mapped,
}

/// 96 × 96 px, a spot of 20 × 14 px, without saturation.
const PLAIN: Condition = Condition {
    name: "S0",
    side_px: 96,
    semi_axes_px: [20.0, 14.0],
    background: 20.0,
    saturated: 0.0,
    peak: 200.0,
    profile: PROFILE,
    samples: SAMPLES,
    glare: Glare::None,
    occluded: 0.0,
    behind_disc: 0.0,
    blinded: 0.0,
    companion: None,
    motion_px: 0.0,
    blur_px: 0.0,
    hot: 0.0,
    warm: 0.0,
    defects: Defects::Unknown,
    row_noise: 0.0,
    rows: RowNoise::Unknown,
};
const ROWS_2: Condition = Condition { row_noise: 2.0, rows: RowNoise::Stated, ..PLAIN };
const WARM: Condition = Condition { warm: 5e-3, ..PLAIN };
const MAPPED: Condition = Condition { defects: Defects::Mapped, ..PLAIN };
const SMALL: Condition = Condition { side_px: 25, semi_axes_px: [4.5, 3.3], ..PLAIN };
const LOBE: Glare = Glare::Lobe { height: 140.0, centre: [8.0, 12.0], width: 35.0 };

/// All conditions, in the order of the tables. Those that test occlusion have 10 or 30 % saturated.
pub const CONDITIONS: [Condition; 29] = [
    PLAIN,
    Condition { name: "S10", saturated: 0.1, ..PLAIN },
    Condition { name: "S30", saturated: 0.3, ..PLAIN },
    Condition { name: "S60", saturated: 0.6, ..PLAIN },
    Condition { name: "dark", background: 8.0, peak: 30.0, ..PLAIN },
    Condition { name: "glareLin", saturated: 0.3, glare: Glare::Plane([0.8, 0.5]), ..PLAIN },
    Condition { name: "glareLobe", saturated: 0.3, glare: LOBE, ..PLAIN },
    Condition { name: "occl25", saturated: 0.1, occluded: 0.25, ..PLAIN },
    Condition { name: "blind40", saturated: 0.1, blinded: 0.4, ..PLAIN },
    Condition { name: "motion6", saturated: 0.1, motion_px: 6.0, ..PLAIN },
    Condition { name: "defocus2", saturated: 0.3, blur_px: 2.0, ..PLAIN },
    Condition { name: "small_S0", ..SMALL },
    Condition { name: "small_S30", saturated: 0.3, ..SMALL },
    Condition { name: "big_S30", side_px: 220, semi_axes_px: [60.0, 42.0], saturated: 0.3, ..PLAIN },
    Condition { name: "hot05_S0", hot: 5e-4, ..PLAIN },
    Condition { name: "hot5_S0", hot: 5e-3, ..PLAIN },
    Condition { name: "hot05_S30", saturated: 0.3, hot: 5e-4, ..PLAIN },
    Condition { name: "hot5_S30", saturated: 0.3, hot: 5e-3, ..PLAIN },
    Condition { name: "warm05_S0", warm: 5e-4, ..WARM },
    Condition { name: "warm5_S0", ..WARM },
    Condition { name: "warm05_map", warm: 5e-4, ..MAPPED },
    Condition { name: "warm5_map", warm: 5e-3, ..MAPPED },
    Condition { name: "warm5_S30_map", saturated: 0.3, warm: 5e-3, ..MAPPED },
    Condition { name: "hot05_map", hot: 5e-4, ..MAPPED },
    Condition { name: "hot5_map", hot: 5e-3, ..MAPPED },
    Condition { name: "rows2_S0", ..ROWS_2 },
    Condition { name: "rows2_S30", saturated: 0.3, ..ROWS_2 },
    Condition { name: "rows2_dark", background: 8.0, peak: 30.0, ..ROWS_2 },
    Condition { name: "rows2_untold", rows: RowNoise::Unknown, ..ROWS_2 },
];

/// The condition of that name.
pub fn condition(name: &str) -> Condition {
    *CONDITIONS.iter().find(|condition| condition.name == name).unwrap_or_else(|| panic!("no condition {name}"))
}

/// Starting values by name.
pub type Known = Vec<(&'static str, f64)>;

/// A condition and the document fitted to it.
#[derive(Clone, Copy)]
pub struct Task {
    /// Contents of the frames.
    pub condition: Condition,
    /// A shipped document.
    pub document: &'static str,
    /// Starting values given in both starts, beside the profile.
    pub known: fn(&Scene) -> Known,
}

/// A row of the table of conditions.
#[derive(Clone, Copy)]
pub struct Row {
    /// The condition's name.
    pub condition: &'static str,
    /// A shipped document.
    pub document: &'static str,
    /// See [`Task`].
    pub known: fn(&Scene) -> Known,
    /// Goals of RMSE/CRLB: cold, tracking.
    pub goal: [Option<f64>; 2],
}

impl Row {
    /// The task to measure.
    pub fn task(&self) -> Task {
        Task { condition: condition(self.condition), document: self.document, known: self.known }
    }
}

/// No starting values.
pub fn nothing(_: &Scene) -> Known {
    Vec::new()
}

/// Position of the lamp to 8 px, and its glow to 20 %.
pub fn lamp(scene: &Scene) -> Known {
    let (Glare::Lobe { height, centre, width } | Glare::Lorentz { height, centre, width }) = scene.condition.glare
    else {
        return Vec::new();
    };
    vec![("lx", centre[0] - 8.0), ("ly", centre[1] + 8.0), ("lw", 1.2 * width), ("lh", 0.8 * height)]
}

/// The velocity, as predicted by a tracker.
fn velocity(scene: &Scene) -> Known {
    vec![("ux", scene.motion[0]), ("uy", scene.motion[1])]
}

const fn row(condition: &'static str, document: &'static str, goal: [Option<f64>; 2]) -> Row {
    Row { condition, document, known: nothing, goal }
}

/// Relative to a bound with known row noise.
const OFFSET: [Option<f64>; 2] = [Some(1.3), Some(1.3)];
const CLEAR: [Option<f64>; 2] = [Some(1.06), Some(1.06)];

/// The table: documents fitted in each condition, and goals.
pub const ROWS: [Row; 33] = [
    row("S0", "spot-plane", CLEAR),
    row("S10", "spot-plane", CLEAR),
    row("S30", "spot-plane", CLEAR),
    row("S60", "spot-plane", CLEAR),
    row("dark", "spot-plane", [Some(1.08), Some(1.08)]),
    row("glareLin", "spot-plane", CLEAR),
    row("glareLobe", "spot-plane", [Some(6.4), Some(6.4)]),
    row("glareLobe", "spot-quadratic", [Some(6.4), Some(6.4)]),
    Row { known: lamp, ..row("glareLobe", "spot-lobe", [Some(1.18), Some(1.18)]) },
    row("occl25", "spot-plane", [Some(6.0), Some(1.1)]),
    row("blind40", "spot-plane", [None, Some(4.2)]),
    row("motion6", "spot-plane", CLEAR),
    Row { known: velocity, ..row("motion6", "spot-motion", CLEAR) },
    row("defocus2", "spot-plane", CLEAR),
    row("defocus2", "spot-psf", CLEAR),
    row("small_S0", "spot-plane", CLEAR),
    row("small_S30", "spot-plane", CLEAR),
    row("big_S30", "spot-plane", CLEAR),
    row("hot05_S0", "spot-plane", CLEAR),
    row("hot5_S0", "spot-plane", CLEAR),
    row("hot05_S30", "spot-plane", CLEAR),
    row("hot5_S30", "spot-plane", CLEAR),
    row("warm05_S0", "spot-plane", [None, None]),
    row("warm5_S0", "spot-plane", [None, None]),
    row("warm05_map", "spot-plane", CLEAR),
    row("warm5_map", "spot-plane", CLEAR),
    row("warm5_S30_map", "spot-plane", CLEAR),
    row("hot05_map", "spot-plane", CLEAR),
    row("hot5_map", "spot-plane", CLEAR),
    row("rows2_S0", "spot-plane", OFFSET),
    row("rows2_S30", "spot-plane", OFFSET),
    row("rows2_dark", "spot-plane", OFFSET),
    row("rows2_untold", "spot-plane", OFFSET),
];
