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
    /// The service cannot be reached: status 4.
    #[error("error: {0}")]
    Unreachable(String),
    /// Nothing has the name that was given: status 5.
    #[error("error: {0}")]
    NotFound(String),
    /// The service refuses the request (409, 412, 422 or 429): status 6.
    #[error("error: {0}")]
    Refused(String),
    /// Anything else: status 1.
    #[error("error: {0}")]
    Other(String),
}

/// The exit statuses, printed below the program's help.
pub const EXIT_STATUS: &str = "\
Exit status:
  0  success; a fit that fails is a result, and its line says so
  1  any other failure, such as a model or frames that cannot be read
  2  bad usage: the command line, or a file that one of its options names
  3  a wrong model document, whether this program or the service finds it wrong
  4  the service cannot be reached, or the connection breaks off
  5  the service has nothing of that name (404), or there is no such token
  6  the service refuses the request (409, 412, 422, 429)";

impl Failure {
    /// The exit status of the process.
    pub fn status(&self) -> u8 {
        match self {
            Failure::Usage(_) => 2,
            Failure::Model(_) => 3,
            Failure::Unreachable(_) => 4,
            Failure::NotFound(_) => 5,
            Failure::Refused(_) => 6,
            Failure::Other(_) => 1,
        }
    }

    /// The service answered with a status that is no success.
    pub fn answered(status: u16, message: String) -> Failure {
        match status {
            404 => Failure::NotFound(message),
            409 | 412 | 422 | 429 => Failure::Refused(message),
            _ => Failure::Other(message),
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
