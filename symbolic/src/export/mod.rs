//! A [`Program`] as source text, for machines where no compiler may run beside the program, and to compare with.
//!
//! What comes in: a program, the model that it was made of (for names and formulas), and [`ExportOptions`]. What goes out: one
//! file of C99 or Rust 2021 that needs nothing but the language's mathematics, with the program's loops in sight: pass, row,
//! pixel, row end, pass end. With one lane it computes what [`crate::program::interpreter::run_in_lanes`] computes with one, bit for
//! bit, elementary functions apart: they are the platform's.
//! It must never know: how a frame lies in memory; an exported function is told by strides, counted in pixels.
//!
//! `names` finds words for values, `body` writes the statements of each level, `c` and `rust` what stands around them, `spelling`
//! is the table of how each language spells an operation; `lanes` writes the pixel loop with vectors, whose table is `vectors`.

mod body;
mod c;
mod header;
mod lanes;
mod lines;
mod names;
mod rust;
mod spelling;
mod vectors;

use thiserror::Error;

use crate::language::model::Model;
use crate::program::{Precision, Program};

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

impl Model {
    /// A program of this model as source text; see the module's text.
    pub fn export(&self, program: &Program, options: &ExportOptions) -> Result<String, ExportError> {
        if options.pixels.len() != program.channels() {
            return Err(ExportError::Channels { channels: program.channels(), given: options.pixels.len() });
        }
        if *program.names() != self.names(program.names().outputs.clone()) {
            return Err(ExportError::Foreign(self.name().to_string()));
        }
        let name = options.name.clone().unwrap_or_else(|| format!("isophote_{}", self.name().replace('-', "_")));
        if !names::is_function_name(&name) {
            return Err(ExportError::Name(name));
        }
        let source = Source { model: self, program, options, name };
        match (options.language, options.precision, options.lanes) {
            (Language::C, _, 1) => Ok(c::file(&source)),
            (Language::Rust, _, 1) => Ok(rust::file(&source)),
            (Language::Rust, Precision::F32, 4 | 8 | 16) => lanes::file(&source),
            (language, precision, lanes) => Err(ExportError::Lanes { lanes, precision, language }),
        }
    }
}

/// All that is known when a file is written.
struct Source<'a> {
    model: &'a Model,
    program: &'a Program,
    options: &'a ExportOptions,
    /// Of the function.
    name: String,
}

impl Source<'_> {
    /// How many coordinates planes and windows have: at least those of a picture.
    fn dimensions(&self) -> usize {
        self.program.coordinates().max(2)
    }
}
