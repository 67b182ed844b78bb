//! `[roles]`: the parameters' meaning to the tracker, one table per target.

use crate::language::document::{Entry, Item, Key};
use crate::language::reader::faults::{Faults, get, parameter_named, parameters_named};
use crate::model::estimator::Estimator;
use crate::model::{Parameter, Roles, Start};
use crate::program::ParameterId;

const ROLES: [&str; 6] = ["centre", "shape", "background", "brightness", "position", "orientation"];

/// One per target; derived from the estimators if the table is missing.
pub(crate) fn read_roles(
    faults: &mut Faults,
    top: &[(Key, Entry)],
    parameters: &[Parameter],
    coordinates: usize,
) -> Vec<Roles> {
    let Some(table) = get(top, "roles").and_then(|e| faults.table("roles", e)) else {
        return vec![default_roles(parameters, coordinates)];
    };
    let is_target =
        |(key, entry): &&(Key, Entry)| matches!(entry.item, Item::Table(_)) && !ROLES.contains(&key.name.as_str());
    let targets: Vec<_> = table.iter().filter(is_target).collect();
    let plain: Vec<_> = table.iter().filter(|pair| !is_target(pair)).cloned().collect();
    let mut roles = Vec::new();
    if !plain.is_empty() || targets.is_empty() {
        roles.push(read_role(faults, "roles", None, &plain, parameters, coordinates));
    }
    for (key, entry) in targets {
        let path = format!("roles.{}", key.name);
        if let Some(fields) = faults.table(&path, entry) {
            roles.push(read_role(faults, &path, Some(key.name.clone()), fields, parameters, coordinates));
        }
    }
    roles
}

fn read_role(
    faults: &mut Faults,
    path: &str,
    name: Option<String>,
    fields: &[(Key, Entry)],
    parameters: &[Parameter],
    coordinates: usize,
) -> Roles {
    faults.known(path, fields, &ROLES);
    let mut roles = Roles { name, ..Roles::default() };
    for (field, wanted, slot) in
        [("centre", coordinates, &mut roles.centre), ("shape", coordinates * (coordinates + 1) / 2, &mut roles.shape)]
    {
        let Some(entry) = get(fields, field) else { continue };
        let key = format!("{path}.{field}");
        let before = faults.count();
        *slot = parameters_named(faults, &key, entry, parameters);
        if slot.len() != wanted && coordinates > 0 && !faults.is_partial() && faults.count() == before {
            let message = format!("`{key}` names {wanted} parameters here, not {}", slot.len());
            faults.tell(
                "shape",
                &key,
                entry.span,
                message,
                "a centre has one a coordinate, a shape one an entry of A's upper triangle, row by row (xx, xy, …, yy, …)",
            );
        }
    }
    let axes = |faults: &mut Faults, field: &str, fits: &[usize], help: &str| {
        let Some(entry) = get(fields, field) else { return Vec::new() };
        let key = format!("{path}.{field}");
        let before = faults.count();
        let named = parameters_named(faults, &key, entry, parameters);
        if !fits.contains(&named.len()) && !faults.is_partial() && faults.count() == before {
            let message = format!("`{key}` names {} parameters here, not {}", fits[0], named.len());
            faults.tell("shape", &key, entry.span, message, help);
        }
        named
    };
    roles.position = axes(faults, "position", &[3], "a position is x, y and z of the target's origin, in mm");
    roles.orientation = axes(
        faults,
        "orientation",
        &[3, 2],
        "an orientation is three modified Rodrigues parameters, or two where the third is 0",
    );
    let mut one = |field: &str| {
        get(fields, field).and_then(|e| parameter_named(faults, &format!("{path}.{field}"), e, parameters))
    };
    roles.background = one("background");
    roles.brightness = one("brightness");
    roles
}

/// Roles that follow from the estimators that parameters start with.
fn default_roles(parameters: &[Parameter], coordinates: usize) -> Roles {
    let with = |wanted: Estimator| {
        let found = parameters.iter().position(|p| p.start == Start::Estimator(wanted));
        found.map(|i| ParameterId(i as u32))
    };
    let all = |wanted: &[Estimator]| wanted.iter().map(|e| with(*e)).collect::<Option<Vec<_>>>().unwrap_or_default();
    let centre: Vec<Estimator> = (0..coordinates).map(Estimator::Centroid).collect();
    let shape: Vec<Estimator> =
        (0..coordinates).flat_map(|row| (row..coordinates).map(move |column| Estimator::Extent(row, column))).collect();
    Roles {
        name: None,
        centre: all(&centre),
        shape: all(&shape),
        background: with(Estimator::Background),
        brightness: with(Estimator::Amplitude),
        position: all(&[0, 1, 2].map(Estimator::Position)),
        orientation: Some(all(&[0, 1, 2].map(Estimator::Orientation)))
            .filter(|found| !found.is_empty())
            .unwrap_or_else(|| all(&[0, 1].map(Estimator::Orientation))),
    }
}
