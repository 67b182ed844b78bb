//! Model documents in files: reading, `model check`, `model explain`. None of it needs a service.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_capture::read_regular;
use isophote_machine::monotonic_ns;
use isophote_symbolic::{Form, LIMITS, Model, Precision, Proof};
use isophote_wire::explain;
use isophote_wire::{ModelReport, StageReport};

use crate::failure::Failure;
use crate::samples::DocumentSyntax;
use crate::{offline, samples};

/// Check a model: parse, differentiate and compile it, and print a report
#[derive(Clone, Debug, clap::Args)]
pub struct CheckArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Show the derivatives, program or machine code of a model for a subset of its parameters
#[derive(Clone, Debug, clap::Args)]
pub struct ExplainArgs {
    /// Model document (TOML; JSON if named *.json)
    #[arg(value_name = "FILE")]
    pub model: PathBuf,
    /// Free parameters [default: those of the last stage]
    #[arg(long, value_name = "bx,by", value_delimiter = ',')]
    pub parameters: Vec<String>,
    /// Text to show: the derivative (also as latex or mathml), the sums, the program, Cranelift's IR (clif), the machine code (asm), or the document's own formulas in MathML (formulas)
    #[arg(long, value_name = "WHAT", default_value = "derivative",
          value_parser = ["derivative", "sums", "program", "clif", "asm", "latex", "mathml", "formulas"])]
    pub show: String,
    /// Show the cost per pixel, as differentiated and as compiled, of the gradient, the Hessian, and both jointly
    #[arg(long, conflicts_with = "show")]
    pub table: bool,
    /// Method whose derivatives are taken
    #[arg(long, value_name = "METHOD", default_value = "newton",
          value_parser = ["newton", "gauss-newton", "levenberg-marquardt"])]
    pub method: String,
    /// Print one JSON object: figures and text
    #[arg(long)]
    pub json: bool,
}

/// `isophote model check`.
pub fn check(args: &CheckArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = read(&args.model)?;
    let report = offline::compile(&args.model, model, Precision::F32)?.report(&monotonic_ns);
    let report = report.map_err(|failure| offline::refused(&args.model, &failure))?;
    warn(&args.model, &report);
    let text = if args.json { json(&report)? } else { table(&report) };
    writeln!(out, "{text}").map_err(Failure::output)
}

/// Prints warnings to standard error: the document is accepted.
pub fn warn(path: &Path, report: &ModelReport) {
    report.warnings.iter().for_each(|warning| eprintln!("{}", warning.render(&path.display().to_string()).trim_end()));
}

/// `isophote model explain`.
pub fn explain(args: &ExplainArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let model = read(&args.model)?;
    let names: Vec<&str> = args.parameters.iter().map(|name| name.trim()).filter(|name| !name.is_empty()).collect();
    let show = if args.table { "table" } else { &args.show };
    let explained = explain::explain(&model, Some(&names), Some(&args.method), show, &monotonic_ns);
    let explained = explained.map_err(|error| Failure::unexplained(&args.model.display().to_string(), error))?;
    let text = match args.json {
        true => json(&explained)?,
        false => format!("{}\n\n{}", figures(&explained.stage), explained.text.trim_end()),
    };
    writeln!(out, "{text}").map_err(Failure::output)
}

fn json(value: &impl serde::Serialize) -> Result<String, Failure> {
    serde_json::to_string(value).map_err(|error| Failure::Other(error.to_string()))
}

fn table(report: &ModelReport) -> String {
    let mut text = format!("{}  {}\n", report.model, report.digest);
    for (number, stage) in report.stages.iter().enumerate() {
        text += &format!("stage {number}: {}\n", figures(stage));
        if let Some(clear) = stage.condition {
            let saturated =
                stage.condition_saturated.map(|with| format!(", {with:.1e} with 30 % of the target saturated"));
            text += &format!("  condition {clear:.1e}{}\n", saturated.unwrap_or_default());
        }
    }
    text += &promised(report);
    match report.self_check_error {
        Some(error) => text + &format!("self check: {error:.1e}"),
        None => text.trim_end().to_string(),
    }
}

/// Expected accuracy and exposure for a synthetic target, as a table.
fn promised(report: &ModelReport) -> String {
    let mut text = String::new();
    if let (Some(bound), Some(last)) = (&report.bound, report.stages.last()) {
        let noise = bound.noise.map_or("the model's noise".to_string(), |noise| format!("a noise of {noise} DN"));
        text += &format!("bound: at best, without saturation, with {noise}\n");
        let width = last.parameters.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        for name in &last.parameters {
            if let (Some(value), Some(deviation)) = (bound.parameters.get(name), bound.deviation.get(name)) {
                text += &format!("  {name:<width$}  {value:>10.4}  ± {deviation:.2e}\n");
            }
        }
    }
    for advice in &report.exposure {
        text += &format!(
            "exposure: {:.2} times as much light for the {}: {}\n",
            advice.factor,
            advice.goal.name(),
            advice.why
        );
    }
    text
}

/// One line: parameters, method and cost per pixel.
fn figures(stage: &StageReport) -> String {
    let calls: Vec<String> = stage.calls.iter().map(|(name, count)| format!("{count} {name}")).collect();
    let calls = if calls.is_empty() { String::new() } else { format!(" and {}", calls.join(", ")) };
    format!(
        "{} by {}: {} flops{calls} a pixel, {} accumulators, {} flops a row, {} a pass; compiled in {:.1} ms{}",
        stage.parameters.join(", "),
        stage.method.name(),
        stage.flops_per_pixel,
        stage.accumulators,
        stage.flops_per_row,
        stage.flops_per_pass,
        stage.compile_ms,
        stage.proof.as_ref().map(proof).unwrap_or_default(),
    )
}

/// A second line: how the sums were verified against the derivatives.
fn proof(proof: &Proof) -> String {
    let form = match proof.form {
        Form::Factored => String::new(),
        form => format!("; {form:?} form, because shorter ones round worse in f32").to_lowercase(),
    };
    let exact =
        if proof.exact { "equal to the derivatives modulo 2^61 - 1" } else { "equal to the derivatives by samples" };
    let error = |name: &str, error: Option<f64>| error.map_or(String::new(), |e| format!(", {name} error {e:.1e}"));
    format!("\n  {exact}{}{}{form}", error("f64", proof.error), error("f32 gradient", proof.f32_error))
}

/// The text of a document with the samples of the files that it names, and whether it is JSON (by the extension
/// `.json`; all else is TOML).
pub fn text(path: &Path) -> Result<(String, bool), Failure> {
    let unreadable =
        |reason: &dyn std::fmt::Display| Failure::Other(format!("{}: cannot be read: {reason}", path.display()));
    let bytes = std::fs::metadata(path).map_err(|error| unreadable(&error))?.len();
    if bytes > LIMITS.document_bytes as u64 {
        return Err(Failure::Model(format!(
            "error: {}: {bytes} bytes; a model document has at most {}",
            path.display(),
            LIMITS.document_bytes
        )));
    }
    let text = read_regular(path, LIMITS.document_bytes as u64).map_err(|error| unreadable(&error))?;
    let text = String::from_utf8(text).map_err(|_| {
        Failure::Model(format!("error: {}: not UTF-8 text; save the document as UTF-8", path.display()))
    })?;
    let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    let folder = path.parent().unwrap_or(Path::new(""));
    let syntax = if is_json { DocumentSyntax::Json } else { DocumentSyntax::Toml };
    Ok((samples::put_in(&text, syntax, folder)?, is_json))
}

/// Reads and checks a document.
pub fn read(path: &Path) -> Result<Arc<Model>, Failure> {
    let (text, is_json) = text(path)?;
    let checked = if is_json { Model::from_json(&text) } else { Model::from_toml(&text) };
    checked.map(Arc::new).map_err(|diagnostics| Failure::model(&path.display().to_string(), &diagnostics))
}
