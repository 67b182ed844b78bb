//! What is asked for, why it is not given, and what the writers of a file share.

use isophote_symbolic::{Model, Precision, Program};
use thiserror::Error;

/// In which language.
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

/// How a pixel of a plane is stored.
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

/// What the text is to be.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ExportOptions {
    /// In which language.
    pub language: Language,
    /// The arithmetic of the pixel loop.
    pub precision: Precision,
    /// One a channel.
    pub pixels: Vec<PixelType>,
    /// The pixels of a row follow each other without gaps: the loop has no stride.
    pub packed: bool,
    /// Pixels at a time: 1; in Rust with f32 also 4, 8 and 16, by the vectors of x86-64.
    pub lanes: usize,
    /// The function's name; absent, `isophote_` and the model's.
    pub name: Option<String>,
}

impl ExportOptions {
    /// One pixel at a time in f32 of u8 planes, with strides.
    pub fn new(language: Language, channels: usize) -> ExportOptions {
        let pixels = vec![PixelType::U8; channels];
        ExportOptions { language, precision: Precision::F32, pixels, packed: false, lanes: 1, name: None }
    }
}

/// Why there is no text.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum ExportError {
    /// Another number of planes than the model has.
    #[error("{given} pixel types for {channels} channels")]
    Channels {
        /// Of the model.
        channels: usize,
        /// Of the options.
        given: usize,
    },
    /// Not a name in both languages.
    #[error("`{0}` cannot be a function's name: small letters, digits and at least one `_`, a letter first")]
    Name(String),
    /// A program that another model made, or none.
    #[error("the program is not one of the model `{0}`")]
    Foreign(String),
    /// Vectors that are not written.
    #[error("{lanes} lanes of {precision} are not written in {language:?}; Rust has 1, 4, 8 and 16 of f32, C and f64 have 1", precision = if *.precision == Precision::F32 { "f32" } else { "f64" })]
    Lanes {
        /// As asked for.
        lanes: usize,
        /// As asked for.
        precision: Precision,
        /// As asked for.
        language: Language,
    },
    /// A vector loop of this model would need what is not written with vectors.
    #[error("with more than one lane there are no {0}; leave out `--lanes`")]
    NotInLanes(&'static str),
}

/// All that is known when a file is written.
pub(crate) struct ExportSubject<'a> {
    pub model: &'a Model,
    pub program: &'a Program,
    pub options: &'a ExportOptions,
    /// Of the function.
    pub name: String,
}

impl ExportSubject<'_> {
    /// How many coordinates planes and windows have: at least those of a picture.
    pub fn dimensions(&self) -> usize {
        self.program.coordinates().max(2)
    }
}
