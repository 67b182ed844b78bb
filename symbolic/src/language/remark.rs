//! Remarks on a checked document: what can only be told when its derivatives have numbers.
//!
//! What comes in: a model, a parameter and what is to be said about it. What goes out: a [`Diagnostic`] at the parameter's
//! place in the document. It never knows what led to the remark.

use crate::language::diagnostic::{Diagnostic, Severity};
use crate::language::graph::{Node, NodeId};
use crate::language::model::Model;
use crate::program::{Input, ParameterId};

impl Model {
    /// What is to be said about a parameter: where the stage of that index frees it, or where it is declared.
    pub fn remark(
        &self,
        severity: Severity,
        code: &str,
        (stage, parameter): (Option<usize>, ParameterId),
        message: impl Into<String>,
    ) -> Diagnostic {
        let declared = &self.parameters[parameter.index()];
        let freed = stage.and_then(|stage| {
            let position = self.stages.get(stage)?.parameters.iter().position(|p| *p == parameter)?;
            let key = format!("stages[{stage}].parameters[{position}]");
            let (span, _) = self.places.iter().find(|(_, place)| *place == key)?;
            Some((format!("stages[{stage}].parameters"), *span))
        });
        let (key, span) = freed.unwrap_or_else(|| (format!("parameters.{}", declared.name), declared.span));
        let diagnostic = Diagnostic::error(&self.text, code, &key, span, message);
        Diagnostic { severity, ..diagnostic }
    }

    /// True when a formula reads the parameter: intensity, observed, domain, noise or a constraint.
    pub fn reads(&self, parameter: ParameterId) -> bool {
        let entries = self.formulas.entries.iter();
        let of_entries = entries.flat_map(|entry| [Some(entry.observed), Some(entry.intensity), entry.noise]).flatten();
        let roots = of_entries.chain(self.formulas.domain).chain(self.formulas.constraints.iter().copied());
        self.reach(
            &roots.collect::<Vec<_>>(),
            |node| matches!(node, Node::Input(Input::Parameter(p) | Input::Entry(p)) if *p == parameter),
        )
    }

    /// True when the intensity or the domain reads a channel: then nothing is predicted without a frame.
    pub fn needs_a_frame(&self) -> bool {
        let entries = self.formulas.entries.iter().map(|entry| entry.intensity);
        let roots: Vec<NodeId> = entries.chain(self.formulas.domain).collect();
        self.reach(&roots, |node| matches!(node, Node::Channel(_)))
    }

    fn reach(&self, roots: &[NodeId], is_meant: impl Fn(&Node) -> bool) -> bool {
        let graph = &self.formulas.graph;
        graph.reachable(roots).into_iter().any(|id| is_meant(graph.node(id)))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const TOML: &str = "name = \"line\"\ncoordinates = [\"i\"]\nchannels = [\"y\", \"x\"]\n[parameters]\n\
                        a = { start = 1.0 }\nb = { start = 1.0 }\nc = { start = 1.0 }\n[model]\nobserved = \"y\"\n\
                        intensity = \"a * x\"\nconstraint = [\"b > 0\"]\n[[stages]]\nparameters = [\"a\", \"b\"]\n";

    #[test]
    fn a_remark_stands_where_the_stage_frees_the_parameter() {
        let model = Model::from_toml(TOML).unwrap();
        let [a, b, c] = ["a", "b", "c"].map(|name| model.parameter(name).unwrap());
        let freed = model.remark(Severity::Warning, "some-code", (Some(0), b), "a sentence");
        assert_eq!((freed.key.as_str(), freed.severity), ("stages[0].parameters", Severity::Warning));
        assert!(TOML[freed.span.start as usize..freed.span.end as usize].contains('b'), "{freed:?}");
        assert_eq!((freed.line, freed.source.as_str()), (13, "parameters = [\"a\", \"b\"]"));
        let declared = model.remark(Severity::Error, "some-code", (Some(0), c), "a sentence");
        assert_eq!((declared.key.as_str(), declared.line), ("parameters.c", 7));
        assert_eq!([a, b, c].map(|p| model.reads(p)), [true, true, false]);
        assert!(model.needs_a_frame());
        assert!(!Model::from_toml(&TOML.replace("a * x", "a * i")).unwrap().needs_a_frame());
    }
}
