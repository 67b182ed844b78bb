//! `serve --demo`: a synthetic source and a running session, both named `demo`.

use isophote_wire::{SessionDocument, SourceDocument};

use crate::command::Command;
use crate::compiler::Owner;
use crate::declared::Keeping;
use crate::name::Name;
use crate::problem::Problem;
use crate::service::Service;

/// A spot that moves on an ellipse, as an ordinary camera sees it.
const SOURCE: &str = r#"{"kind": "synthetic", "model": "spot", "width": 640, "height": 480, "rate_hz": 30,
    "motion": {"bx": "320 + 110*sin(2*pi*0.20*t)", "by": "240 + 70*cos(2*pi*0.13*t)"},
    "samples": 2, "full_well_e": 5000, "read_noise_e": 15, "seed": 1}"#;
const SESSION: &str =
    r#"{"source": "demo", "model": "spot", "camera": {"electrons_per_dn": 19.6, "read_noise_e": 15}}"#;

/// Starts what nothing is declared in the place of: users' own `demo` runs again like any other. A session that was stopped runs
/// again, on the source `demo` that is declared, if there is one.
pub fn start(service: &Service, owner: &mut Owner) -> Result<(), Problem> {
    let read = |error: serde_json::Error| Problem::bug(error.to_string());
    let source: SourceDocument = serde_json::from_str(SOURCE).map_err(read)?;
    let session: SessionDocument = serde_json::from_str(SESSION).map_err(read)?;
    let name = Name::parse("demo").ok_or_else(|| Problem::bug("demo is a name"))?;
    if service.has_source(&name) {
        service.restore_source_at_once(owner, &name);
    } else {
        let name = name.clone();
        service.apply(owner, Command::PutSource { name, document: source.into(), keeping: Keeping::Passing })?;
    }
    if !service.has_session(&name) {
        service.apply(owner, Command::PutSession { name, document: session.into(), keeping: Keeping::Passing })?;
    }
    Ok(())
}
