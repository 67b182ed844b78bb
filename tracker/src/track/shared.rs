//! `SharedParameters`: maps the parameters of one model to those of another, so that a swap carries values, covariances
//! and positions over.
//!
//! A parameter with a role corresponds to the one of the same role (of the table of the same name, or of the only
//! table); any other to the one of the same name.

use isophote_symbolic::{Model, ParameterId, Roles, Start};
use nalgebra::DMatrix;

use crate::options::TrackerOptions;
use crate::solve::compiled::Compiled;

/// The effect of a swap on the new model's parameters, those of the first target.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Carried {
    /// Names of those that keep their values.
    pub carried: Vec<String>,
    /// Names of those that start anew.
    pub reset: Vec<String>,
    /// Ids of the targets whose motion is carried over: velocity, the learned motion, and coasting. Targets that were
    /// never found have none; a model that has neither centre nor position takes none over.
    pub moving: Vec<String>,
}

/// The map from one model to another.
pub(crate) struct SharedParameters<'a> {
    new: &'a Model,
    old_order: &'a [ParameterId],
    new_order: &'a [ParameterId],
    /// The session's start numbers for the new model, which override the document's.
    starts: Vec<Option<f64>>,
    /// The old parameter that each new one corresponds to.
    sources: Vec<Option<usize>>,
    /// The number of the old position for each position of the new model; `None` when one has no counterpart, or there is none.
    pub positions: Option<Vec<usize>>,
    /// Both models have the same document.
    pub is_same: bool,
}

/// The role of a parameter.
#[derive(PartialEq)]
enum Meaning {
    Centre(usize),
    Shape(usize),
    Background,
    Brightness,
    Position(usize),
    Orientation(usize),
}

/// The parameters of a table of roles, with their roles.
fn meanings(roles: &Roles) -> Vec<(Meaning, ParameterId)> {
    let numbered = |ids: &[ParameterId], meaning: fn(usize) -> Meaning| {
        ids.iter().enumerate().map(|(number, id)| (meaning(number), *id)).collect::<Vec<_>>()
    };
    let mut all = numbered(&roles.centre, Meaning::Centre);
    all.extend(numbered(&roles.shape, Meaning::Shape));
    all.extend(numbered(&roles.position, Meaning::Position));
    all.extend(numbered(&roles.orientation, Meaning::Orientation));
    all.extend(roles.background.map(|id| (Meaning::Background, id)));
    all.extend(roles.brightness.map(|id| (Meaning::Brightness, id)));
    all
}

/// The old model's counterpart of a table of the new one.
fn counterpart<'m>(old: &'m Model, new: &Model, roles: &Roles) -> Option<&'m Roles> {
    match (old.roles(), new.roles()) {
        ([only], [_]) => Some(only),
        (tables, _) => tables.iter().find(|table| table.name == roles.name),
    }
}

/// The old parameter of the same role.
fn of_role(old: &Model, new: &Model, parameter: ParameterId) -> Option<ParameterId> {
    new.roles().iter().find_map(|roles| {
        let (meaning, _) = meanings(roles).into_iter().find(|(_, id)| *id == parameter)?;
        // Entries of A and of a position correspond only between tables of the same sizes.
        let old = counterpart(old, new, roles)?;
        let sizes =
            |roles: &Roles| [roles.centre.len(), roles.shape.len(), roles.position.len(), roles.orientation.len()];
        let (theirs, ours) = (sizes(old), sizes(roles));
        let is_alike = match meaning {
            Meaning::Centre(_) => theirs[0] == ours[0],
            Meaning::Shape(_) => theirs[1] == ours[1],
            Meaning::Position(_) => theirs[2] == ours[2],
            Meaning::Orientation(_) => theirs[3] == ours[3],
            Meaning::Background | Meaning::Brightness => true,
        };
        let found = meanings(old).into_iter().find(|(theirs, _)| *theirs == meaning)?;
        is_alike.then_some(found.1)
    })
}

/// Position parameters: the centres of all targets of the model, px, then the position of a pose, mm.
pub(crate) fn position_parameters(model: &Model) -> impl Iterator<Item = &ParameterId> {
    let roles = model.roles();
    roles.iter().flat_map(|roles| &roles.centre).chain(roles.iter().flat_map(|roles| &roles.position))
}

impl<'a> SharedParameters<'a> {
    /// Unknown values become NaN; empty where a position is unknown.
    pub fn with_places(&self, known: Vec<Option<f64>>) -> Vec<f64> {
        match position_parameters(self.new).all(|position| known[position.index()].is_some()) {
            true => known.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect(),
            false => Vec::new(),
        }
    }

    /// Maps the parameters of `old` to those of `new`.
    pub fn of(old: &'a Compiled, new: &'a Compiled, options: &TrackerOptions) -> SharedParameters<'a> {
        let (before, after) = (old.model(), new.model());
        let ids = |model: &Model| model.parameters().iter().map(|one| model.parameter(&one.name)).collect::<Vec<_>>();
        let source = |id: &Option<ParameterId>| {
            let id = (*id)?;
            let name = &after.parameters()[id.index()].name;
            let source = of_role(before, after, id).or_else(|| before.parameter(name))?;
            Some(source.index())
        };
        let sources: Vec<Option<usize>> = ids(after).iter().map(source).collect();
        let number = |position: &ParameterId| {
            let source = sources[position.index()]?;
            position_parameters(before).position(|old| old.index() == source)
        };
        let numbers: Option<Vec<usize>> = position_parameters(after).map(number).collect();
        SharedParameters {
            new: after,
            starts: options.start_of(after),
            old_order: old.last_parameters(),
            new_order: new.last_parameters(),
            positions: numbers.filter(|numbers| !numbers.is_empty()),
            is_same: before.digest() == after.digest(),
            sources,
        }
    }

    /// The value, if the new model's bounds allow it.
    fn allowed(&self, number: usize, value: f64) -> Option<f64> {
        let parameter = &self.new.parameters()[number];
        let inside = parameter.min.is_none_or(|min| value > min) && parameter.max.is_none_or(|max| value < max);
        inside.then_some(value)
    }

    /// The values of the new model's parameters that are carried over; `None` when none is.
    pub fn values(&self, old: Option<&[Option<f64>]>) -> Option<Vec<Option<f64>>> {
        let value = |(number, source): (usize, &Option<usize>)| self.allowed(number, (*old?.get((*source)?)?)?);
        let values: Vec<Option<f64>> = self.sources.iter().enumerate().map(value).collect();
        values.iter().any(Option::is_some).then_some(values)
    }

    /// The values of all of the new model's parameters that are known: carried over, else the session's or the document's
    /// number; `None` when none is carried over.
    pub fn known(&self, old: Option<&[Option<f64>]>) -> Option<Vec<Option<f64>>> {
        let carried = self.values(old)?;
        let own = |start: &Start| match start {
            Start::Number(number) => Some(*number),
            Start::Estimator(_) => None,
        };
        let parameters = self.new.parameters().iter().zip(carried.into_iter().zip(&self.starts));
        Some(parameters.map(|(parameter, (value, start))| value.or(*start).or_else(|| own(&parameter.start))).collect())
    }

    /// The covariance of the new model's free parameters; `None` when one of them was not free, or is not carried over.
    pub fn covariance(&self, old: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let row = |id: &ParameterId| {
            let source = self.sources[id.index()]?;
            self.old_order.iter().position(|old| old.index() == source)
        };
        let rows: Vec<usize> = self.new_order.iter().map(row).collect::<Option<_>>()?;
        Some(DMatrix::from_fn(rows.len(), rows.len(), |i, j| old[(rows[i], rows[j])]))
    }

    /// The report of the swap.
    pub fn report(&self, old: Option<&[Option<f64>]>) -> Carried {
        let values = self.values(old).unwrap_or_else(|| vec![None; self.sources.len()]);
        let mut carried = Carried::default();
        for (parameter, value) in self.new.parameters().iter().zip(values) {
            let names = if value.is_some() { &mut carried.carried } else { &mut carried.reset };
            names.push(parameter.name.clone());
        }
        carried
    }
}
