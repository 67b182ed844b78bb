//! `isophote serve --check`: checks whether the service could start, without starting it. Each requirement of a start yields
//! one finding.

use std::io;
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;

use isophote_capture::{FrameSource, Synthetic, SyntheticSpec};
use isophote_jit::KernelCache;
use isophote_symbolic::Diagnostic;
use isophote_tracker::TrackState;
use isophote_wire::SessionDocument;

use crate::net::listener::{Options, StartError};
use crate::registry::{Registry, models_in};
use crate::service::store_of;
use crate::session::fit_once;
use crate::store::is_read_only;

/// The result for one requirement of a start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StartFinding {
    /// The requirement.
    pub what: &'static str,
    /// The finding, or why the service would not start.
    pub result: Result<String, String>,
}

/// Checks everything; creates a missing data folder, as a start does.
pub fn check(options: &Options) -> Vec<StartFinding> {
    let said = |error: &dyn std::fmt::Display| error.to_string();
    let opened = |data| {
        let store = store_of(data).map_err(|error| said(&error))?;
        Registry::open(store, Arc::new(KernelCache::of_width(options.width))).map_err(|error| said(&error))
    };
    let (data, kernel) = match opened(options.data.as_deref()) {
        Ok(registry) => (writable(options.data.as_deref()), kernel(&registry)),
        Err(error) => {
            let fresh = opened(None);
            (Err(error), fresh.and_then(|registry| kernel(&registry)))
        }
    };
    let models = options.models.as_deref().map(|folder| StartFinding { what: "models", result: models(folder) });
    let address = StartFinding { what: "address", result: address(options) };
    let data = StartFinding { what: "data folder", result: data };
    let kernel = StartFinding { what: "kernel", result: kernel };
    [address, data].into_iter().chain(models).chain([kernel]).collect()
}

/// A start would skip a wrong document; this check refuses it.
fn models(folder: &Path) -> Result<String, String> {
    let files = models_in(folder).map_err(|error| format!("{}: cannot be read: {error}", folder.display()))?;
    for file in &files {
        let parsed = file.read().and_then(|(_, text)| {
            let wrong = |fault: &Diagnostic| format!("{} ({}:{})", fault.message, fault.line, fault.column);
            file.media.model(&text).map_err(|faults| faults.first().map(wrong).unwrap_or_default())
        });
        parsed.map_err(|why| format!("{}: {why}", file.path.display()))?;
    }
    Ok(format!("{}: {} document(s)", folder.display(), files.len()))
}

fn address(options: &Options) -> Result<String, String> {
    let address = options.listen;
    let access = options.access.open(address, options.data.as_deref());
    drop(access.map_err(|error| error.to_string())?);
    let bound = TcpListener::bind(address).map_err(|reason| StartError::Listen { address, reason }.to_string())?;
    drop(bound);
    Ok(format!("{address} is free"))
}

fn writable(data: Option<&Path>) -> Result<String, String> {
    let Some(data) = data else { return Ok("none: models are kept in memory only".into()) };
    let probe = data.join("writable.check");
    checked(data, std::fs::write(&probe, b"").and_then(|()| std::fs::remove_file(&probe)))
}

/// The finding for a folder, from the result of writing a file in it.
fn checked(data: &Path, written: io::Result<()>) -> Result<String, String> {
    let path = data.display();
    match written {
        Ok(()) => Ok(format!("{path} is there and nobody else's")),
        // A start accepts this as well.
        Err(error) if is_read_only(&error) => {
            Ok(format!("{path} cannot be written to ({error}): what is in it is read, and every change refused"))
        }
        Err(error) => Err(format!("{path}: cannot be written to: {error}")),
    }
}

/// Derives, compiles and runs a kernel, since an operating system may forbid code generation at run time.
fn kernel(registry: &Registry) -> Result<String, String> {
    let entry = registry.get("spot").map_err(|problem| problem.detail)?;
    let camera = SyntheticSpec { width: 64, height: 48, samples: 2, ..SyntheticSpec::new(entry.model.clone()) };
    let frame = Synthetic::new(camera).map_err(|error| error.to_string())?.next();
    let captured = frame.map_err(|error| error.to_string())?.ok_or("the synthetic camera has no frame")?;
    let document = r#"{"source": "check", "model": "spot"}"#;
    let document: SessionDocument = serde_json::from_str(document).map_err(|error| error.to_string())?;
    let estimates = fit_once(&entry, &document, &captured.frame, &|| None).map_err(|problem| problem.detail)?;
    let is_found = estimates.first().is_some_and(|estimate| estimate.state == TrackState::Tracking);
    let bits = 8 * entry.width().bytes();
    if !is_found {
        return Err(format!("compiled with vectors of {bits} bits, but a spot in a picture of it was not found"));
    }
    Ok(format!("compiled and run, with vectors of {bits} bits"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A start reads such a folder and logs that changes are refused.
    #[test]
    fn a_read_only_data_folder_does_not_prevent_a_start() {
        let told = |kind: io::ErrorKind| checked(Path::new("data"), Err(kind.into()));
        for kind in [io::ErrorKind::ReadOnlyFilesystem, io::ErrorKind::PermissionDenied] {
            assert!(told(kind).is_ok_and(|found| found.contains("every change refused")), "{kind}");
        }
        assert!(told(io::ErrorKind::StorageFull).is_err_and(|why| why.starts_with("data: cannot be written to")));
    }
}
