//! Exports a [`Program`] of a model as source text, for machines where no compiler may run beside the program, and for
//! comparison.
//!
//! The result is one file of C99 or Rust 2021 that needs nothing but the language's mathematics and shows the program's
//! loops: pass, row, pixel, row end, pass end. With one lane it computes what [`isophote_symbolic::interpreter::run`]
//! computes with one, bit for bit, except for the platform's elementary functions. An exported function reads frames by
//! strides, counted in pixels; the model supplies names and formulas.
//!
//! `names` chooses identifiers for values, `body` writes the statements of each level, `c` and `rust` the file around
//! them, `spelling` is the table of each language's operations, `special` has the functions that it lacks; `lanes`
//! writes the pixel loop with vectors, whose table is `vectors`.

mod body;
mod c;
mod header;
mod lanes;
mod lines;
mod names;
mod options;
mod rust;
mod special;
mod spelling;
mod vectors;

use isophote_symbolic::{Model, Precision, Program};

pub use options::{ExportError, ExportOptions, Language, PixelType};

use options::ExportSubject;

/// Exports a program of a model as source text; see the crate's text.
///
/// # Errors
/// [`ExportError`]: options that do not fit the program or each other, or a program of another model.
pub fn export(model: &Model, program: &Program, options: &ExportOptions) -> Result<String, ExportError> {
    if options.pixels.len() != program.channels() {
        return Err(ExportError::Channels { channels: program.channels(), given: options.pixels.len() });
    }
    if !is_of(program, model) {
        return Err(ExportError::Foreign(model.name().to_string()));
    }
    let name = options.name.clone().unwrap_or_else(|| format!("isophote_{}", model.name().replace('-', "_")));
    if !names::is_function_name(&name) {
        return Err(ExportError::Name(name));
    }
    let source = ExportSubject { model, program, options, name };
    match (options.language, options.precision, options.lanes) {
        (Language::C, _, 1) => Ok(c::file(&source)),
        (Language::Rust, _, 1) => Ok(rust::file(&source)),
        (Language::Rust, Precision::F32, 4 | 8 | 16) => lanes::file(&source),
        (language, precision, lanes) => Err(ExportError::Lanes { lanes, precision, language }),
    }
}

/// True when the program has the model's coordinates, channels, parameters and constants.
fn is_of(program: &Program, model: &Model) -> bool {
    let names = program.names();
    names.coordinates == model.coordinates()
        && names.channels == model.channels()
        && names.parameters.iter().eq(model.parameters().iter().map(|parameter| &parameter.name))
        && names.constants.iter().eq(model.constants().iter().map(|constant| &constant.name))
}
