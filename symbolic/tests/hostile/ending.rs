//! What becomes of a document: read, and derived and lowered for each of its stages.

use isophote_symbolic::{Diagnostics, Lowering, Method, Model, Summand, ValueKind};

/// Derives and lowers all that a fit asks for, and holds it as one who fits does.
pub fn derive(model: &Model) -> Result<(), Diagnostics> {
    let lowerings = [false, true].map(|drop_saturated| Lowering { fma: true, drop_saturated });
    let mut held = Vec::new();
    for Summand { model, .. } in model.summands() {
        let own = (0..model.stages().len()).filter(|stage| model.first_alike(*stage) == *stage);
        for stage in own.map(|stage| &model.stages()[stage]) {
            held.push(model.objective(&stage.parameters, stage.method)?);
        }
        if let Some(last) = model.stages().last().filter(|last| last.method == Method::Newton) {
            held.push(model.objective(&last.parameters, Method::GaussNewton)?);
        }
        held.push(model.value_objective(ValueKind::Entry)?);
        held.push(model.value_objective(ValueKind::Full)?);
    }
    let programs: Result<Vec<_>, _> =
        held.iter().flat_map(|of| lowerings.map(|lowering| of.program(lowering))).collect();
    programs.map(drop)
}
