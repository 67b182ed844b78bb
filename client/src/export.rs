//! `isophote model export`: the pixel loop of a model as source, for machines without JIT. Needs no service.

use std::io::Write;
use std::path::PathBuf;

use isophote_export::{ExportOptions, Language, PixelType};
use isophote_symbolic::{Lowering, Model};
use isophote_wire::Exported;
use isophote_wire::explain::{self, ExplainError};

use crate::arguments::PrecisionArgument;
use crate::failure::Failure;
use crate::{model_files, output};

/// Export the pixel loop of a model as C or Rust source
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Free parameters [default: those of the last stage]
    #[arg(long, value_name = "bx,by", value_delimiter = ',')]
    pub parameters: Vec<String>,
    /// Language of the source
    #[arg(long, value_name = "LANGUAGE")]
    pub lang: LanguageArgument,
    /// Method whose derivatives are summed
    #[arg(long, value_name = "METHOD", default_value = "newton",
          value_parser = ["newton", "gauss-newton", "levenberg-marquardt"])]
    pub method: String,
    /// drop: exclude and count pixels at or above their channel's limit
    #[arg(long, value_name = "WHAT", value_parser = ["drop"])]
    pub saturation: Option<String>,
    /// Pixel type: one for all channels, or one per channel
    #[arg(long, value_name = "TYPE,…", value_delimiter = ',', default_value = "u8")]
    pub pixels: Vec<PixelArgument>,
    /// Assume that the pixels of a row are contiguous (no stride)
    #[arg(long)]
    pub packed: bool,
    /// Arithmetic of the pixel loop
    #[arg(long, default_value = "f32")]
    pub precision: PrecisionArgument,
    /// Contract a * b + c into fused multiply-adds; fast only on processors that have them
    #[arg(long)]
    pub fma: bool,
    /// Pixels per vector; more than 1 requires --lang rust and x86-64 (4 and 8: AVX2 and FMA; 16: AVX-512)
    #[arg(long, value_name = "1|4|8|16", default_value = "1", value_parser = ["1", "4", "8", "16"])]
    pub lanes: String,
    /// Name of the function [default: isophote_ and the model's name]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Write the source to this file [default: standard output]
    #[arg(long, value_name = "PATH")]
    pub out: Option<PathBuf>,
    /// Print one JSON object that contains the source
    #[arg(long)]
    pub json: bool,
}

/// Language of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LanguageArgument {
    /// C99
    C,
    /// Rust, edition 2021
    Rust,
}

/// Type of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PixelArgument {
    /// 0 … 255
    U8,
    /// 0 … 65535
    U16,
    /// IEEE 754 single
    F32,
}

impl From<PixelArgument> for PixelType {
    fn from(argument: PixelArgument) -> PixelType {
        match argument {
            PixelArgument::U8 => PixelType::U8,
            PixelArgument::U16 => PixelType::U16,
            PixelArgument::F32 => PixelType::F32,
        }
    }
}

/// `isophote model export`.
pub fn run(args: &ExportArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = model_files::read(&args.model)?;
    let names: Vec<&str> = args.parameters.iter().map(|name| name.trim()).filter(|name| !name.is_empty()).collect();
    let mut pixels: Vec<PixelType> = args.pixels.iter().map(|pixel| PixelType::from(*pixel)).collect();
    if pixels.len() == 1 {
        pixels.resize(model.channels().len(), pixels[0]);
    }
    let language = match args.lang {
        LanguageArgument::C => Language::C,
        LanguageArgument::Rust => Language::Rust,
    };
    let lanes: usize = args.lanes.parse().map_err(|_| Failure::Usage("--lanes is a number".into()))?;
    let options = ExportOptions {
        language,
        precision: args.precision.into(),
        pixels,
        packed: args.packed,
        lanes,
        name: args.name.clone(),
    };
    let exported = exported(&model, args, &names, &options)
        .map_err(|error| Failure::unexplained(&args.model.display().to_string(), error))?;
    if let Some(path) = &args.out {
        output::file(path, exported.text.as_bytes())?;
    }
    match (args.json, &args.out) {
        (true, _) => output::json(out, &exported),
        (false, None) => out.write_all(exported.text.as_bytes()).map_err(Failure::output),
        (false, Some(_)) => Ok(()),
    }
}

/// Gradient and Hessian for a subset of the parameters as source text.
fn exported(
    model: &Model,
    args: &ExportArgs,
    names: &[&str],
    options: &ExportOptions,
) -> Result<Exported, ExplainError> {
    // Vector code requires fused multiply-adds.
    let lowering = Lowering { fma: args.fma || options.lanes > 1, drop_saturated: args.saturation.is_some() };
    let subset = explain::subset(model, Some(names))?;
    let method = explain::named_method(&args.method)?;
    let program = model.objective(&subset, method)?.program(lowering)?;
    let text =
        isophote_export::export(model, &program, options).map_err(|error| ExplainError::Question(error.to_string()))?;
    Ok(Exported {
        model: model.name().to_string(),
        digest: model.digest().to_string(),
        parameters: subset.iter().map(|id| model.parameters()[id.index()].name.clone()).collect(),
        method,
        language: options.language.name().to_string(),
        text,
    })
}
