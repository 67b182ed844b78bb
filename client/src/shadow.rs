//! `isophote session shadow`: runs another model on the frames of a session, beside its own, until it is dropped or
//! promoted.

use std::io::Write;

use isophote_wire::{EstimateView, SessionView, ShadowDocument, ShadowState, ShadowView, SwapAnswer};
use serde_json::json;

use crate::arguments::NumberArgs;
use crate::failure::Failure;
use crate::http::{RemoteService, ServiceArgs, segment};
use crate::{output, sessions};

/// Run another model as a shadow on the frames of a session; without MODEL, compare the two
#[derive(Clone, Debug, clap::Args)]
pub struct ShadowArgs {
    /// Name of the session
    pub name: String,
    /// Name of a model of the service; it replaces any current shadow
    #[arg(conflicts_with_all = ["promote", "drop"])]
    pub model: Option<String>,
    /// Values of the model's constants, replacing the session's
    #[arg(long, value_name = "k=v,…", allow_hyphen_values = true, requires = "model")]
    pub constant: Vec<NumberArgs>,
    /// Switch the session to the shadow's model, between two frames
    #[arg(long, conflicts_with = "drop")]
    pub promote: bool,
    /// Remove the shadow; the session continues unchanged
    #[arg(long)]
    pub drop: bool,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Starts, shows, promotes or drops the shadow of a session.
pub fn run(args: &ShadowArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let (service, session) = (RemoteService::new(&args.service)?, format!("/v1/sessions/{}", segment(&args.name)));
    let shadow = format!("{session}/shadow");
    if args.drop {
        service.delete(&shadow)?;
        return if args.service.json { output::json(out, &json!({"dropped": args.name})) } else { Ok(()) };
    }
    if args.promote {
        let answer: SwapAnswer = service.post_empty(&format!("{shadow}:promote"))?;
        return sessions::swapped(&answer, &args.service, out);
    }
    if let Some(model) = &args.model {
        let constants = NumberArgs::merged(&args.constant).map_err(Failure::Usage)?;
        let begun: ShadowView = service.put(&shadow, &ShadowDocument { model: model.clone(), constants })?;
        if args.service.json {
            return output::json(out, &begun);
        }
        let [carried, reset] = [&begun.carried, &begun.reset].map(|names| sessions::listed(names));
        return writeln!(out, "{model} beside {}; carried {carried}; reset {reset}", args.name)
            .map_err(Failure::output);
    }
    let view: SessionView = service.get(&session)?;
    let begin = || {
        let name = &args.name;
        Failure::NotFound(format!(
            "the session `{name}` has no shadow; `isophote session shadow {name} MODEL` begins one"
        ))
    };
    let shadow = view.shadow.as_ref().ok_or_else(begin)?;
    if args.service.json { output::json(out, shadow) } else { compared(&view, shadow, out) }
}

/// Prints both models with their last estimates, and the differences of their common parameters.
fn compared(session: &SessionView, shadow: &ShadowView, out: &mut dyn Write) -> Result<(), Failure> {
    let row = |model: &str, frames: u64, dropped: u64, last: Option<&EstimateView>| {
        let shown = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        vec![
            model.to_string(),
            sessions::word(last.and_then(|last| serde_json::to_value(last.state).ok())),
            shown(last.map(|last| last.frame.to_string())),
            shown(last.and_then(|last| last.reduced_chi_square).map(|value| format!("{value:.3}"))),
            shown(last.and_then(|last| last.timing_us).map(|timing| timing.fit.to_string())),
            frames.to_string(),
            dropped.to_string(),
        ]
    };
    let other = shadow.last.as_ref().map(|last| &*last.estimate);
    let rows = [
        row(&session.active_model, session.frames, session.dropped, session.last.as_ref()),
        row(&shadow.model, shadow.frames, shadow.dropped, other),
    ];
    output::table(out, &["MODEL", "TRACK", "FRAME", "χ²/ν", "µs", "FRAMES", "DROPPED"], &rows)?;
    if shadow.state != ShadowState::Running {
        let reason = shadow.reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
        let state = sessions::word(serde_json::to_value(shadow.state).ok());
        writeln!(out, "\n{} is {state}{reason}", shadow.model).map_err(Failure::output)?;
    }
    let Some(last) = &shadow.last else { return Ok(()) };
    if let Some(centre_px) = last.disagreement.centre_px {
        writeln!(out, "\ncentres {centre_px:.4} px apart in frame {}", last.estimate.frame).map_err(Failure::output)?;
    }
    let rows = last.disagreement.parameters.iter().map(|(name, shift)| {
        let deviations = shift.deviations.map_or_else(|| "-".into(), |deviations| format!("{deviations:.2}"));
        vec![name.clone(), format!("{:.5}", shift.difference), deviations]
    });
    let rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() { Ok(()) } else { output::table(out, &["PARAMETER", "DIFFERENCE", "/σ"], &rows) }
}
