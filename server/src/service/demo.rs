//! `serve --demo`: a synthetic source and a running session, both named `demo`.

use isophote_wire::{SessionDocument, SourceDocument};

use crate::name::Name;
use crate::problem::Problem;
use crate::service::Service;
use crate::service::command::Command;
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;

/// A spot that moves on an ellipse, as an ordinary camera sees it.
const SOURCE: &str = r#"{"kind": "synthetic", "model": "spot", "width": 640, "height": 480, "rate_hz": 30,
    "motion": {"bx": "320 + 110*sin(2*pi*0.20*t)", "by": "240 + 70*cos(2*pi*0.13*t)"},
    "samples": 2, "full_well_e": 5000, "read_noise_e": 15, "seed": 1}"#;
const SESSION: &str =
    r#"{"source": "demo", "model": "spot", "camera": {"electrons_per_dn": 19.6, "read_noise_e": 15}}"#;

/// Restores a declared source `demo`, or puts the synthetic one; puts the session unless a session `demo` exists. So a demo
/// session that was stopped starts again, on the declared source `demo` if there is one.
pub fn start(service: &Service, owner: &mut Owner) -> Result<(), Problem> {
    let read = |error: serde_json::Error| Problem::bug(error.to_string());
    let source: SourceDocument = serde_json::from_str(SOURCE).map_err(read)?;
    let session: SessionDocument = serde_json::from_str(SESSION).map_err(read)?;
    let name = Name::parse("demo").ok_or_else(|| Problem::bug("demo is a name"))?;
    if service.sources.get("demo").is_some() {
        service.restore_source_at_once(owner, &name);
    } else {
        let name = name.clone();
        service.apply(owner, Command::PutSource { name, document: source.into(), keeping: Keeping::Passing })?;
    }
    if service.sessions.get("demo").is_none() {
        service.apply(owner, Command::PutSession { name, document: session.into(), keeping: Keeping::Passing })?;
    }
    Ok(())
}
