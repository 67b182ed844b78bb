//! Export options, errors, and the shared input of the writers.

use isophote_symbolic::{Model, Precision, Program};
use thiserror::Error;

/// Target language.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Language {
    /// C99.
    C,
    /// Rust, edition 2021 or later.
    Rust,
}

impl Language {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Language::C => "c",
            Language::Rust => "rust",
        }
    }
}

/// Storage type of a plane's pixels.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum PixelType {
    /// 0 … 255
    U8,
    /// 0 … 65535
    U16,
    /// IEEE 754 single
    F32,
}

impl PixelType {
    /// The name in Rust and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            PixelType::U8 => "u8",
            PixelType::U16 => "u16",
            PixelType::F32 => "f32",
        }
    }
}

/// Options of an export.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ExportOptions {
    /// Target language.
    pub language: Language,
    /// The arithmetic of the pixel loop.
    pub precision: Precision,
    /// One per channel.
    pub pixels: Vec<PixelType>,
    /// The pixels of a row are contiguous: the loop has no stride.
    pub packed: bool,
    /// Pixels at a time: 1; in Rust with f32 also 4, 8 and 16, with x86-64 vectors.
    pub lanes: usize,
    /// The function's name; by default `isophote_` and the model's.
    pub name: Option<String>,
}

impl ExportOptions {
    /// One pixel at a time in f32 of u8 planes, with strides.
    pub fn new(language: Language, channels: usize) -> ExportOptions {
        let pixels = vec![PixelType::U8; channels];
        ExportOptions { language, precision: Precision::F32, pixels, packed: false, lanes: 1, name: None }
    }
}

/// Reasons to refuse an export.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum ExportError {
    /// The number of pixel types differs from the model's channels.
    #[error("{given} pixel types for {channels} channels")]
    Channels {
        /// Channels of the model.
        channels: usize,
        /// Pixel types of the options.
        given: usize,
    },
    /// Not a function name in both languages.
    #[error("`{0}` cannot be a function's name: small letters, digits and at least one `_`, a letter first")]
    Name(String),
    /// A program of another model.
    #[error("the program is not one of the model `{0}`")]
    Foreign(String),
    /// Unsupported vectors.
    #[error("{lanes} lanes of {precision} are not written in {language:?}; Rust has 1, 4, 8 and 16 of f32, C and f64 have 1", precision = if *.precision == Precision::F32 { "f32" } else { "f64" })]
    Lanes {
        /// As requested.
        lanes: usize,
        /// As requested.
        precision: Precision,
        /// As requested.
        language: Language,
    },
    /// The model needs an operation that has no vector form.
    #[error("with more than one lane there are no {0}; leave out `--lanes`")]
    NotInLanes(&'static str),
}

/// Input of the writers.
pub(crate) struct ExportSubject<'a> {
    pub model: &'a Model,
    pub program: &'a Program,
    pub options: &'a ExportOptions,
    /// Name of the function.
    pub name: String,
}

impl ExportSubject<'_> {
    /// Number of coordinates of planes and windows, at least two.
    pub fn dimensions(&self) -> usize {
        self.program.coordinates().max(2)
    }
}
