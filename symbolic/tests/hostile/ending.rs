//! What becomes of a document: read, and derived and lowered for each of its stages.

use isophote_symbolic::{Diagnostics, Lowering, Method, Model, ValueKind};

/// Derives and lowers all that a fit asks for, and holds it as one who fits does.
pub fn derive(model: &Model) -> Result<(), Diagnostics> {
    let lowerings = [false, true].map(|drop_saturated| Lowering { fma: true, drop_saturated });
    let mut held = Vec::new();
    for summand in model.summands() {
        let mut known = Vec::new();
        for stage in model.stages() {
            // Stages alike are derived once.
            let key = (&stage.parameters, stage.method);
            if known.contains(&key) {
                continue;
            }
            known.push(key);
            held.push(summand.objective(&stage.parameters, stage.method)?);
        }
        if let Some(last) = model.stages().last().filter(|last| last.method == Method::Newton) {
            held.push(summand.objective(&last.parameters, Method::GaussNewton)?);
        }
        held.push(summand.value_objective(ValueKind::Entry)?);
        held.push(summand.value_objective(ValueKind::Full)?);
    }
    let programs: Result<Vec<_>, _> =
        held.iter().flat_map(|of| lowerings.map(|lowering| of.program(lowering))).collect();
    programs.map(drop)
}
