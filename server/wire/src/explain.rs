//! Reports and explanations of a model, shared by the service and the commands; figures and texts come from
//! `symbolic`, `jit` and `tracker`.

use std::sync::Arc;

use isophote_jit::{CompileError, Kernel, KernelOptions, Line, PixelFormat, VectorWidth, has_fma};
use isophote_notation::Show;
use isophote_symbolic::{
    Diagnostic, Diagnostics, Lowering, Method, Model, ParameterId, Precision, Program, Span, Value,
};
use isophote_tracker::CompileFailure;

use crate::{BodyCost, Explanation, LinePlace, LoopCost, LoopSums, StageReport};

/// Accepted values of `show`.
pub const SHOWN: [&str; 9] = ["derivative", "sums", "program", "clif", "asm", "latex", "mathml", "formulas", "table"];

/// Why an explanation failed.
#[derive(Debug, thiserror::Error)]
pub enum ExplainError {
    /// An invalid argument of the request.
    #[error("{0}")]
    Question(String),
    /// The document exceeds this build's limits.
    #[error("the model cannot be explained")]
    Model(Diagnostics),
    /// A kernel could not be compiled, through no fault of the document.
    #[error("a kernel could not be compiled: {0}")]
    Kernel(CompileError),
}

impl From<CompileError> for ExplainError {
    fn from(error: CompileError) -> ExplainError {
        match too_large(&error) {
            Some(diagnostic) => ExplainError::Model(vec![diagnostic]),
            None => ExplainError::Kernel(error),
        }
    }
}

impl From<Diagnostics> for ExplainError {
    fn from(diagnostics: Diagnostics) -> ExplainError {
        ExplainError::Model(diagnostics)
    }
}

/// Splits `bx,by` into names.
pub fn split(names: &str) -> Vec<&str> {
    names.split(',').map(str::trim).filter(|name| !name.is_empty()).collect()
}

/// Explains one subset of the parameters (default: those of the last stage): figures, and a text of the kind `show`,
/// see [`SHOWN`]. `method` is a name as in a document, default `newton`. `clock_ns` times the compilation.
pub fn explain(
    model: &Arc<Model>,
    subset: Option<&[&str]>,
    method: Option<&str>,
    show: &str,
    clock_ns: &dyn Fn() -> u64,
) -> Result<Explanation, ExplainError> {
    if !SHOWN.contains(&show) {
        return Err(ExplainError::Question(format!("`{show}` cannot be shown; there are {}", SHOWN.join(", "))));
    }
    let subset = self::subset(model, subset)?;
    let method = named_method(method.unwrap_or("newton"))?;
    let start_ns = clock_ns();
    let objective = model.objective(&subset, method)?;
    let lowering = Lowering { fma: has_fma(), drop_saturated: false };
    let program = objective.program(lowering)?;
    let formats = vec![PixelFormat::U8; model.channels().len()];
    let options =
        KernelOptions { width: VectorWidth::Bits128, precision: Precision::F32, packed: formats.len() == 1, formats };
    drop(Kernel::compile(&program, &options)?); // timed only
    let compile_ms = clock_ns().saturating_sub(start_ns) as f64 / 1e6;
    let (mut lines, mut loops) = (Vec::new(), Vec::new());
    let text = match show {
        "table" => {
            loops = isophote_tracker::loop_costs(model, &subset, method, clock_ns);
            table(&loops)
        }
        "sums" => isophote_notation::explain(&objective, Show::Sums),
        "program" => {
            let text = program.to_string();
            lines = text.lines().map(|line| LinePlace::of_operation(&program, line)).collect();
            text
        }
        "clif" | "asm" => {
            let explained = isophote_jit::explain(&program, &options)?;
            let code = if show == "clif" { explained.clif } else { explained.machine };
            let (text, places) = annotated(model, &program, &code);
            lines = places;
            text
        }
        "formulas" => formulas(model),
        "latex" => isophote_notation::explain(&objective, Show::Latex),
        "mathml" => isophote_notation::explain(&objective, Show::MathMl),
        _ => isophote_notation::explain(&objective, Show::Derivative),
    };
    let stage = StageReport::of(model, &objective, method, lowering, compile_ms)?;
    let (name, digest) = (model.name().to_string(), model.digest().to_string());
    Ok(Explanation { model: name, digest, show: show.to_string(), stage, text, lines, loops })
}

/// The document's own formulas as MathML, each node with its bytes of the document.
pub fn formulas(model: &Model) -> String {
    isophote_notation::written(model)
}

/// The cost per pixel of each loop, as text.
fn table(loops: &[LoopCost]) -> String {
    let cell = |body: Option<BodyCost>| match body {
        None => "–".to_string(),
        Some(BodyCost { flops_per_pixel, ns_per_pixel: None }) => format!("{flops_per_pixel} flops"),
        Some(BodyCost { flops_per_pixel, ns_per_pixel: Some(ns) }) => format!("{flops_per_pixel} flops {ns:>7.2} ns"),
    };
    let mut text = format!("{:<10}{:>24}{:>24}\n", "a pixel", "as differentiated", "as compiled");
    for LoopCost { sums, differentiated, compiled } in loops {
        let name = match sums {
            LoopSums::Gradient => "gradient",
            LoopSums::Hessian => "Hessian",
            LoopSums::Joint => "jointly",
        };
        text += &format!("{name:<10}{:>24}{:>24}\n", cell(*differentiated), cell(*compiled));
    }
    text
}

/// Maximum length of a formula beside an instruction, in characters.
const EXCERPT_CHARACTERS: usize = 60;
/// Maximum length of an instruction before its comment moves to the right, in characters.
const COLUMN_MAX: usize = 64;

impl LinePlace {
    /// Parses a line of a program's text, `  v12 = …`.
    fn of_operation(program: &Program, line: &str) -> LinePlace {
        let number = line.strip_prefix("  v").and_then(|rest| rest.split(' ').next()).and_then(|n| n.parse().ok());
        let value = number.filter(|number: &u32| (*number as usize) < program.instructions().len()).map(Value);
        LinePlace::new(value, value.and_then(|value| program.instruction(value).span))
    }

    fn new(value: Option<Value>, span: Option<Span>) -> LinePlace {
        LinePlace { value: value.map(|value| value.0), span: span.map(|span| [span.start, span.end]) }
    }
}

/// Lines of code, each with the value that it computes and the formula behind it; and the place of each line.
fn annotated(model: &Model, program: &Program, lines: &[Line]) -> (String, Vec<LinePlace>) {
    let mut places = vec![LinePlace::default()];
    let width = lines.iter().map(|line| line.text.chars().count()).filter(|width| *width <= COLUMN_MAX).max();
    let mut text =
        String::from("; beside an instruction: what it computes (see `program`), and the formula behind it\n");
    for line in lines {
        let comment = line.value.map(|value| {
            let formula = line.span.and_then(|span| model.quote(span));
            let formula = formula.map(|(key, words)| format!("  {key}: {}", excerpt(words))).unwrap_or_default();
            format!("; v{} = {}{formula}", value.0, program.operation_text(value))
        });
        let (code, comment) = (&line.text, comment.unwrap_or_default());
        text += format!("{code:<width$}  {comment}", width = width.unwrap_or(0)).trim_end();
        text.push('\n');
        places.extend(code.split('\n').map(|_| LinePlace::new(line.value, line.span)));
    }
    (text, places)
}

/// A formula on one line, truncated.
fn excerpt(words: &str) -> String {
    let line = words.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(EXCERPT_CHARACTERS) {
        Some(_) => line.chars().take(EXCERPT_CHARACTERS - 1).chain(['…']).collect(),
        None => line,
    }
}

/// The parameters of these names; without names, those of the last stage.
pub fn subset(model: &Model, names: Option<&[&str]>) -> Result<Vec<ParameterId>, ExplainError> {
    let Some(names) = names.filter(|names| !names.is_empty()) else {
        return Ok(model.stages().last().map(|stage| stage.parameters.clone()).unwrap_or_default());
    };
    let unknown = |name: &str| {
        let all: Vec<&str> = model.parameters().iter().map(|p| p.name.as_str()).collect();
        ExplainError::Question(format!(
            "the model `{}` has no parameter `{name}`; it has {}",
            model.name(),
            all.join(", ")
        ))
    };
    let mut subset = Vec::new();
    for name in names {
        let id = model.parameter(name).ok_or_else(|| unknown(name))?;
        if subset.contains(&id) {
            return Err(ExplainError::Question(format!("the parameter `{name}` is given twice")));
        }
        subset.push(id);
    }
    Ok(subset)
}

/// The method of that name in documents.
pub fn named_method(name: &str) -> Result<Method, ExplainError> {
    let all = [Method::Newton, Method::GaussNewton, Method::LevenbergMarquardt];
    let found = all.into_iter().find(|method| method.name() == name);
    let names = || all.map(Method::name).join(", ");
    found.ok_or_else(|| ExplainError::Question(format!("`{name}` is no method; there are {}", names())))
}

/// The diagnostics of a model that does not compile: the document's own, or one for the model as a whole.
pub fn diagnostics(failure: &CompileFailure) -> Diagnostics {
    match failure {
        CompileFailure::Model(diagnostics) => diagnostics.clone(),
        CompileFailure::Kernel(error) => {
            let ours = || Diagnostic::error("", "no-kernel", "model", Span::default(), failure.to_string());
            vec![too_large(error).unwrap_or_else(ours)]
        }
    }
}

/// The diagnostic for a loop that is too large, if that is the error.
fn too_large(error: &CompileError) -> Option<Diagnostic> {
    let is_too_large = matches!(error, CompileError::CodeTooLarge { .. } | CompileError::FrameTooLarge { .. });
    let fault = || Diagnostic::error("", "limit", "model", Span::default(), format!("the model is too large: {error}"));
    is_too_large.then(|| fault().help("free fewer parameters in a stage, or write shorter formulas"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn explained(show: &str) -> Explanation {
        let model = Model::from_toml(include_str!("../../../models/thesis-spot.toml")).unwrap();
        explain(&Arc::new(model), Some(&["bx", "by"]), None, show, &|| 0).unwrap()
    }

    fn shown(show: &str) -> String {
        explained(show).text
    }

    #[test]
    fn each_line_of_code_has_a_place() {
        for show in ["clif", "asm"] {
            let Explanation { text, lines, .. } = explained(show);
            assert_eq!(text.lines().count(), lines.len(), "{show}");
            let mut found = 0;
            for (line, place) in text.lines().zip(&lines) {
                if let Some(value) = place.value {
                    assert!(line.contains(&format!("; v{value} ")), "v{value}: {line}");
                    found += 1;
                }
            }
            assert!(found > 20, "{show}: {found}");
        }
    }

    #[test]
    fn the_table_has_a_line_for_each_loop() {
        let Explanation { text, loops, stage, .. } = explained("table");
        assert_eq!(loops.len(), 3);
        assert_eq!(text.lines().count(), 4, "{text}");
        let joint = text.lines().last().unwrap();
        assert!(joint.starts_with("jointly") && joint.contains(&format!(" {} flops", stage.flops_per_pixel)), "{text}");
        assert!(explained("sums").loops.is_empty());
    }

    /// Counts the lines with an instruction that `is_meant` selects, and those of them that name a formula.
    fn named(text: &str, is_meant: impl Fn(&str) -> bool) -> (usize, usize) {
        let lines: Vec<(&str, &str)> = text
            .lines()
            .map(|line| line.split_once(';').unwrap_or((line, "")))
            .filter(|(code, _)| is_meant(code))
            .collect();
        (lines.len(), lines.iter().filter(|(_, comment)| comment.contains(": ")).count())
    }

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn machine_code_names_the_formulas_behind_it() {
        let text = shown("asm");
        let arithmetic = ["add", "sub", "mul", "div", "sqrt", "fmadd", "fmsub", "fnmadd"];
        let (all, with_formula) = named(&text, |code| {
            let word = code.split_whitespace().nth(1).unwrap_or_default();
            word.contains("ps") && arithmetic.iter().any(|stem| word.trim_start_matches('v').starts_with(stem))
        });
        assert!(all > 20 && with_formula * 10 >= all * 9, "{with_formula} of {all} name a formula:\n{text}");
        for formula in ["definitions.s: X' * A * X", "model.intensity: v0 + v1 * f"] {
            assert!(text.contains(formula), "{formula} is missing:\n{text}");
        }
        let (code, constants) = text.split_once("  data ").unwrap();
        assert!(constants.lines().skip(1).all(|line| line.contains("  data ")), "code behind the constants:\n{text}");
        assert!(!code.contains("(bad)"), "a constant shown as an instruction:\n{text}");
    }

    #[test]
    fn the_compilers_form_names_the_formulas_behind_it() {
        let text = shown("clif");
        let (all, with_formula) =
            named(&text, |code| [" = fadd", " = fmul", " = fsub", " = fma"].iter().any(|op| code.contains(op)));
        assert!(all > 50 && with_formula * 10 >= all * 9, "{with_formula} of {all} name a formula:\n{text}");
    }

    #[test]
    fn too_large_loops_are_faults_of_the_document() {
        let too_large = CompileError::FrameTooLarge { bytes: 1 << 20 };
        let reported = diagnostics(&CompileFailure::Kernel(Arc::new(too_large.clone())));
        assert!(
            reported[0].code == "limit"
                && reported[0].message.contains("1048576 bytes of stack")
                && reported[0].help.is_some()
        );
        assert!(matches!(ExplainError::from(too_large), ExplainError::Model(same) if same == reported));
        let ours = CompileError::Audit("a trap".into());
        assert_eq!(diagnostics(&CompileFailure::Kernel(Arc::new(ours.clone())))[0].code, "no-kernel");
        assert!(matches!(ExplainError::from(ours), ExplainError::Kernel(_)));
    }

    #[test]
    fn long_formulas_are_truncated() {
        assert_eq!(excerpt("a\n  +  b"), "a + b");
        assert_eq!(excerpt(&"é".repeat(61)).chars().count(), EXCERPT_CHARACTERS);
        assert_eq!(excerpt(&"é".repeat(60)), "é".repeat(60));
    }
}
