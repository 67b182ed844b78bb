//! `isophote replay`: fits the frames of a recorded session again.
//!
//! `--verify` compares the fits bit for bit, `--model` compares another model; otherwise the estimates are printed.

mod arguments;
mod log;
mod other;
mod refit;
mod session;
mod verify;

use std::io::Write;

pub use self::arguments::ReplayArgs;
use self::log::RecordedLog;
use self::session::{RecordedSession, Repeated};
use crate::failure::Failure;
use crate::{fit, output};

/// `isophote replay`.
pub fn run(args: &ReplayArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let log = RecordedLog::open(&args.file)?;
    if args.verify {
        return verify::run(args, log, out);
    }
    if let Some(model) = &args.model {
        return other::run(args, model, log, out);
    }
    let mut session = RecordedSession::new(log);
    while let Some(repeated) = session.next()? {
        let Repeated::Fit(fit, again) = repeated else { continue };
        // Frames without pixels are printed as recorded.
        let lines = match again {
            Some(again) => again.into_iter().map(|(view, estimate)| (view, Some(estimate))).collect(),
            None => fit.estimates.into_iter().map(|view| (view, None)).collect::<Vec<_>>(),
        };
        for (view, estimate) in lines {
            match (args.json, estimate, &session.refit) {
                (false, Some(estimate), Some(refit)) => {
                    let columns = fit::columns(&refit.model, &view, &estimate);
                    writeln!(out, "{columns}").map_err(Failure::output)?;
                }
                _ => output::json(out, &view)?,
            }
        }
    }
    Ok(())
}
