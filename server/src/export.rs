//! A model's loops as source text, for the commands: what is asked for comes in as words, `isophote-export` writes the text.

use isophote_export::ExportOptions;
use isophote_symbolic::{Lowering, Method, Model};

use crate::explain::{ExplainError, named_method, parameters};
use crate::wire::Exported;

/// Which loops.
#[derive(Clone, Copy, Debug, Default)]
pub struct Question<'a> {
    /// The free parameters; absent, those of the last stage.
    pub subset: Option<&'a [&'a str]>,
    /// As in a document; absent, `newton`.
    pub method: Option<&'a str>,
    /// How the loops are lowered.
    pub lowering: Lowering,
}

/// Gradient and Hessian for a subset of the parameters as source text.
pub fn export(model: &Model, question: Question<'_>, options: &ExportOptions) -> Result<Exported, ExplainError> {
    let subset = match question.subset {
        Some(names) if !names.is_empty() => parameters(model, names)?,
        _ => model.stages().last().map(|stage| stage.parameters.clone()).unwrap_or_default(),
    };
    let method = named_method(question.method.unwrap_or(Method::Newton.name()))?;
    let program = model.objective(&subset, method)?.program(question.lowering)?;
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
