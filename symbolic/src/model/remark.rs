//! Remarks on a checked document, some of which need the values of its derivatives: [`Diagnostic`]s at the span of a
//! parameter or constant.

use crate::graph::{Node, NodeId};
use crate::model::Model;
use crate::program::{ConstantId, Input, ParameterId};
use isophote_syntax::diagnostic::{Diagnostic, Severity, Span};

impl Model {
    /// A diagnostic about a parameter, where that stage frees it, or where it is declared.
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
        self.read_by_formulas(&[Input::Parameter(parameter), Input::Entry(parameter)])
    }

    /// A warning for each parameter and each constant that no formula reads.
    pub fn unused(&self) -> Vec<Diagnostic> {
        let ids = (0..self.parameters.len() as u32).map(ParameterId);
        let parameters = ids.filter(|id| !self.reads(*id)).map(|id| &self.parameters[id.index()]);
        let parameters = parameters.map(|parameter| ("parameters", &parameter.name, parameter.span));
        let is_read = |i: usize| {
            let constant = ConstantId(i as u32);
            self.formulas.defects == Some(constant) || self.read_by_formulas(&[Input::Constant(constant)])
        };
        let constants = self.constants.iter().enumerate().filter(|(i, _)| !is_read(*i)).map(|(_, constant)| constant);
        let constants = constants.map(|constant| ("constants", &constant.name, constant.span));
        let remark = |(table, name, span): (&str, &String, Span)| {
            let (key, message) = (format!("{table}.{name}"), format!("no formula reads `{name}`"));
            let remark = Diagnostic::error(&self.text, "unused", &key, span, message);
            Diagnostic { severity: Severity::Warning, ..remark.help("remove it, or use it in a formula") }
        };
        parameters.chain(constants).map(remark).collect()
    }

    fn read_by_formulas(&self, inputs: &[Input]) -> bool {
        let entries = self.formulas.entries.iter();
        let of_entries = entries.flat_map(|entry| [Some(entry.observed), Some(entry.intensity), entry.noise]).flatten();
        let roots = of_entries.chain(self.formulas.domain).chain(self.formulas.constraints.iter().copied());
        let is_one = |node: &Node| matches!(node, Node::Input(input) if inputs.contains(input));
        self.reach(&roots.collect::<Vec<_>>(), is_one)
    }

    /// True when the intensity or the domain reads a channel: predictions then need a frame.
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
#[path = "remark_tests.rs"]
mod tests;
