//! What was declared and does not run: names, and why.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

use crate::name::Name;
use crate::problem::Problem;

/// Why something does not run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Why {
    /// It will, as soon as its turn comes after a start of the service.
    Starting,
    /// It was stopped on purpose.
    Stopped(String),
    /// It could not be started.
    Failed(String),
}

/// By name.
#[derive(Default)]
pub struct Standing(RwLock<BTreeMap<Name, Why>>);

impl Standing {
    /// All of them, each for its reason.
    pub fn of(all: impl Iterator<Item = (Name, Why)>) -> Standing {
        Standing(RwLock::new(all.collect()))
    }

    /// Whether that one does not run.
    pub fn has(&self, name: &Name) -> bool {
        self.why(name).is_some()
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.0.read().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// Why one does not run; nothing of one that runs, or is not declared.
    pub fn why(&self, name: &Name) -> Option<Why> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).get(name).cloned()
    }

    /// All, by name.
    pub fn all(&self) -> Vec<(Name, Why)> {
        let all = self.0.read().unwrap_or_else(PoisonError::into_inner);
        all.iter().map(|(name, why)| (name.clone(), why.clone())).collect()
    }

    /// Another reason.
    pub fn set(&self, name: &Name, why: Why) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).insert(name.clone(), why);
    }

    /// It runs, or is declared no more.
    pub fn remove(&self, name: &Name) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).remove(name);
    }

    /// What whoever needs it running is told; `unknown` where it is not even declared.
    pub fn problem(&self, what: &str, name: &str, unknown: Problem) -> Problem {
        let why = match Name::parse(name).and_then(|name| self.why(&name)) {
            None => return unknown,
            Some(Why::Starting) => "it is being started; try again".to_string(),
            Some(Why::Stopped(reason)) => reason,
            Some(Why::Failed(reason)) => format!("{reason}; put it again to start it"),
        };
        Problem::conflict("not-applicable", format!("the {what} `{name}` does not run: {why}"))
    }
}
