//! `Colour`: selects the colours of a picture.

/// Colours to read from a mosaic or colour picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// The planes r, g, b of a colour picture or an interpolated mosaic; luma if the format has it.
    #[default]
    All,
    /// Red only.
    Red,
    /// Green only; of a mosaic, the green pixels in the red rows (half of all green pixels).
    Green,
    /// Blue only.
    Blue,
}

impl Colour {
    /// Index among r, g, b; `None` for all.
    pub(super) fn channel(self) -> Option<usize> {
        match self {
            Colour::All => None,
            Colour::Red => Some(0),
            Colour::Green => Some(1),
            Colour::Blue => Some(2),
        }
    }
}
