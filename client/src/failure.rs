//! Failures of commands: a message and an exit status.

use isophote_symbolic::Diagnostics;
use isophote_wire::explain::ExplainError;

/// Why a command failed. `main` writes the message to standard error and exits with the status.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Wrong usage: status 2.
    #[error("error: {0}")]
    Usage(String),
    /// The model document is wrong: status 3. The message is its rendered diagnostics.
    #[error("{0}")]
    Model(String),
    /// The service cannot be reached: status 4.
    #[error("error: {0}")]
    Unreachable(String),
    /// Unknown name: status 5.
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
  0  success; a failed fit is a result, reported in its line
  1  any other failure, such as an unreadable model or frame
  2  wrong usage: the command line, or a file named by an option
  3  an invalid model document, found by this program or by the service
  4  the service cannot be reached, or the connection is lost
  5  unknown name at the service (404), or unknown token
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

    /// The service answered with an error status.
    pub fn answered(status: u16, message: String) -> Failure {
        match status {
            404 => Failure::NotFound(message),
            409 | 412 | 422 | 429 => Failure::Refused(message),
            _ => Failure::Other(message),
        }
    }

    /// The diagnostics of the document `name`, rendered in the style of rustc.
    pub fn model(name: &str, diagnostics: &Diagnostics) -> Failure {
        let rendered: Vec<String> = diagnostics.iter().map(|d| d.render(name)).collect();
        Failure::Model(rendered.join("\n").trim_end().to_string())
    }

    /// Maps an explain error to wrong usage, a wrong document `name`, or an internal failure.
    pub fn unexplained(name: &str, error: ExplainError) -> Failure {
        match error {
            ExplainError::Question(message) => Failure::Usage(message),
            ExplainError::Model(diagnostics) => Failure::model(name, &diagnostics),
            ExplainError::Kernel(_) => Failure::other(error),
        }
    }

    /// An error of a lower crate, verbatim.
    pub fn other(error: impl std::fmt::Display) -> Failure {
        Failure::Other(error.to_string())
    }

    /// Results could not be written, for example because the reader has gone away (`isophote fit … | head`).
    pub fn output(error: std::io::Error) -> Failure {
        Failure::Other(format!("cannot write results: {error}"))
    }
}
