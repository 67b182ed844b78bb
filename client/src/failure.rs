//! How a command fails: the sentence to read and the exit status to branch on.

use isophote_symbolic::Diagnostics;
use isophote_wire::explain::ExplainError;

/// Why a command did not do what was asked for. `main` writes the message to standard error and exits with the status.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The command was called wrongly: status 2.
    #[error("error: {0}")]
    Usage(String),
    /// The model document is wrong: status 3. The message is its diagnostics, rendered.
    #[error("{0}")]
    Model(String),
    /// Anything else: status 1.
    #[error("error: {0}")]
    Other(String),
}

impl Failure {
    /// The exit status of the process.
    pub fn status(&self) -> u8 {
        match self {
            Failure::Usage(_) => 2,
            Failure::Model(_) => 3,
            Failure::Other(_) => 1,
        }
    }

    /// The diagnostics of the document `name`, shown as rustc would.
    pub fn model(name: &str, diagnostics: &Diagnostics) -> Failure {
        let rendered: Vec<String> = diagnostics.iter().map(|d| d.render(name)).collect();
        Failure::Model(rendered.join("\n").trim_end().to_string())
    }

    /// What is wrong with the question, the document `name`, or us.
    pub fn unexplained(name: &str, error: ExplainError) -> Failure {
        match error {
            ExplainError::Question(message) => Failure::Usage(message),
            ExplainError::Model(diagnostics) => Failure::model(name, &diagnostics),
            ExplainError::Kernel(_) => Failure::other(error),
        }
    }

    /// An error of a crate below, in its own words.
    pub fn other(error: impl std::fmt::Display) -> Failure {
        Failure::Other(error.to_string())
    }

    /// A failure of writing results; a reader that has gone away (`isophote fit … | head`) is one as well.
    pub fn output(error: std::io::Error) -> Failure {
        Failure::Other(format!("cannot write results: {error}"))
    }
}
