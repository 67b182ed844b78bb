//! `Colour`: which of a picture's colours are wanted.

/// What becomes of a colour mosaic or colour picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// The planes r, g, b of a colour picture and of a mosaic, whose gaps are filled in; luma where the format has it.
    #[default]
    All,
    /// Red alone.
    Red,
    /// Green alone; of a mosaic the greens in red's rows, half of them.
    Green,
    /// Blue alone.
    Blue,
}

impl Colour {
    /// Its place among r, g, b; `None` for all of them.
    pub(super) fn channel(self) -> Option<usize> {
        match self {
            Colour::All => None,
            Colour::Red => Some(0),
            Colour::Green => Some(1),
            Colour::Blue => Some(2),
        }
    }
}
