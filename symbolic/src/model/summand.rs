//! `Summand`: a part of a document's F, from which programs are derived.

use std::sync::Arc;

use crate::graph::Node;
use crate::graph::budget::Budget;
use crate::model::{Model, Observation, Saturated};
use crate::program::{ChannelId, Level};

/// Entries are summed in one loop if their predictions take at least this many times the operations of a joint one.
const SHARED: f64 = 1.5;

/// A part of a model's F; see [`Model::summands`].
#[derive(Clone, Debug)]
pub struct Summand {
    model: Arc<Model>,
    /// Never empty; several in a joint loop.
    entries: Vec<Observation>,
    /// Sums only pixels at this channel's limit.
    clipped: Option<ChannelId>,
    budget: Budget,
}

impl Model {
    /// The parts that add up to the model's F: one for each entry of `observed`, each followed by one of the pixels at
    /// their limit where those are censored.
    ///
    /// They share one budget, [`crate::LIMITS`]`.work`, for all their derivations in all stages. A caller that derives
    /// a whole schedule takes the summands once.
    pub fn summands(&self) -> Vec<Summand> {
        let (model, budget) = (Arc::new(self.clone()), Budget::after(self.reading));
        let mut summands = Vec::new();
        for entry in &self.formulas.entries {
            let of = |clipped| Summand { model: model.clone(), entries: vec![*entry], clipped, budget: budget.clone() };
            summands.push(of(None));
            if let (Saturated::Censored, Node::Channel(channel)) =
                (self.formulas.saturated, self.formulas.graph.node(entry.observed))
            {
                summands.push(of(Some(*channel)));
            }
        }
        summands
    }

    /// The first summand alone, on a budget of its own.
    pub(crate) fn first_summand(&self) -> Summand {
        let entries = vec![self.formulas.entries[0]];
        Summand { model: Arc::new(self.clone()), entries, clipped: None, budget: Budget::after(self.reading) }
    }

    /// Number of summands.
    pub(crate) fn summand_count(&self) -> usize {
        let each = if self.formulas.saturated == Saturated::Censored { 2 } else { 1 };
        each * self.formulas.entries.len()
    }
}

impl Summand {
    /// Joins the summands of pixels below their limit if the document mixes several channels and their predictions
    /// share work, which is then done once. Two more outputs follow its sums: the number of pixel values summed, and
    /// the number at their limit. It leaves those out itself, per channel, whatever the lowering, and NaN values as
    /// well.
    pub fn joint(summands: &[Summand]) -> Option<Summand> {
        let seen: Vec<&Summand> = summands.iter().filter(|summand| !summand.is_clipped()).collect();
        let [first, _, ..] = seen[..] else { return None };
        let entries = seen.iter().flat_map(|summand| summand.entries.iter().copied()).collect();
        Some(Summand { entries, ..first.clone() }).filter(Summand::shares_work)
    }

    /// The model whose F it is a part of.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// True when it sums only pixels at their limit.
    pub fn is_clipped(&self) -> bool {
        self.clipped.is_some()
    }

    /// Number of values summed per pixel.
    pub fn entries(&self) -> usize {
        self.entries.len()
    }

    /// The channel of its first entry; `None` for a formula over channels.
    pub fn observed_channel(&self) -> Option<ChannelId> {
        match self.model.formulas.graph.node(self.first().observed) {
            Node::Channel(channel) => Some(*channel),
            _ => None,
        }
    }

    /// `observed` of one pixel from its channel values; the sum of its entries.
    pub fn observed(&self, channels: &[f64], constants: &[f64]) -> f64 {
        self.model.observed_of(&self.entries, channels, constants)
    }

    /// The intensity of its first entry at a position (one number a coordinate), in pixel values.
    pub fn predicted(&self, place: &[f64], parameters: &[f64], constants: &[f64]) -> f64 {
        self.model.at_place(self.first().shown, place, parameters, constants)
    }

    /// Its first entry.
    pub(crate) fn first(&self) -> &Observation {
        &self.entries[0]
    }

    /// The entries whose F is summed.
    pub(crate) fn summed(&self) -> &[Observation] {
        &self.entries
    }

    /// The channel at whose limit the pixels are that it sums, if it sums only those.
    pub(crate) fn clipped(&self) -> Option<ChannelId> {
        self.clipped
    }

    /// True when several values of a pixel are summed in one loop.
    pub(crate) fn is_joint(&self) -> bool {
        self.entries.len() > 1
    }

    /// Budget of a derivation.
    pub(crate) fn budget(&self) -> Budget {
        self.budget.clone()
    }

    /// True when each entry is a channel that no other part of a pixel's F reads, and the predictions share most of
    /// their operations.
    fn shares_work(&self) -> bool {
        let graph = &self.model.formulas.graph;
        let is_apart = |entry: &Observation| {
            let reads = |node| graph.channels(&[node]);
            let corrected = reads(entry.intensity);
            let is_own = |channel: &ChannelId| reads(entry.observed) == [*channel] || corrected.contains(channel);
            matches!(graph.node(entry.observed), Node::Channel(_))
                && reads(entry.shown).is_empty()
                && entry.noise.is_none_or(|noise| reads(noise).iter().all(is_own))
        };
        let pixels =
            |roots: &[_]| graph.reachable(roots).into_iter().filter(|node| graph.level(*node) == Level::Pixel).count();
        let intensities: Vec<_> = self.entries.iter().map(|entry| entry.intensity).collect();
        let apart: usize = intensities.iter().map(|intensity| pixels(&[*intensity])).sum();
        self.model.formulas.saturated != Saturated::Predicted
            && self.entries.iter().all(is_apart)
            && SHARED * pixels(&intensities) as f64 <= apart as f64
    }
}
