//! Two steps of a narrow window as one.
//!
//! What comes in: what [`super::group`] writes of one step. What goes out: a block in which the operations of both take turns, and each
//! sum is fetched and left once for both; the second step may lie behind the last column, where no lane takes part. Where the sums of
//! a program are more than registers, its operations are more than a processor looks ahead, and most of those of one step wait for
//! each other. It must never know: what the operations compute.

use isophote_symbolic::Value;

use super::block::{Act, MaskNumber, Resident};
use super::group::{GroupLanes, GroupWriter, PixelLoop};
use super::narrow::NarrowPlaces;
use super::operation::Operation;
use super::places::Homes;

/// Acts, each with the value that asked for it.
type Acts = Vec<(Act, Option<Value>)>;

/// Operations of a step before it is the other one's turn: with 4 to 32 of them the fastest, with one the registers run out, with 64
/// the other step is too far ahead to be seen.
const TURN: usize = 16;

impl PixelLoop<'_> {
    /// Whether steps of a narrow window are written in twos.
    pub fn are_two_together(&self, places: &Homes) -> bool {
        let is_in_memory = |place: &Resident| place.register.is_none();
        !self.has_full_groups() && self.set_values() > 0 && places.accumulators.iter().any(is_in_memory)
    }
}

impl GroupWriter<'_, '_, '_> {
    /// Pixel sets, then every value of both steps.
    pub fn run_two(&mut self, narrow: &NarrowPlaces) {
        let along = self.block.variable(narrow.along);
        let lanes = self.block.number(self.element, narrow.lanes as f64);
        let next = self.block.compute(Operation::Add, self.element, [along, lanes]);
        let both = [(None, MaskNumber::First), (Some(next), MaskNumber::Second)];
        let mut steps = both.map(|(along, mask)| {
            let live = narrow.live(&mut self.block, along);
            GroupLanes::new(self.pixels.program, along, Some(live), mask)
        });

        let set = self.pixels.set_values();
        let sets = self.each(&mut steps, |writer, _| writer.set(set));
        self.block.acts.extend(in_turns(sets));
        let mut used = [None; 2];
        let decisions = self.each(&mut steps, |writer, number| used[number] = writer.decide());
        self.block.acts.extend(decisions.into_iter().flatten());
        if let [Some(one), Some(other)] = used {
            let any = self.block.compute(Operation::Or, self.element, [one, other]);
            self.skip_unless(any);
        }
        let masks = self.each(&mut steps, |writer, number| writer.mask(used[number]));
        self.block.acts.extend(masks.into_iter().flatten());
        let rests = self.each(&mut steps, |writer, number| writer.rest(set, used[number]));
        self.block.acts.extend(in_turns(rests));
        self.block.speak_for(None);
    }

    /// What `write` writes of each step.
    fn each(&mut self, steps: &mut [GroupLanes; 2], mut write: impl FnMut(&mut Self, usize)) -> [Acts; 2] {
        [0, 1].map(|number| {
            std::mem::swap(&mut self.step, &mut steps[number]);
            let before = std::mem::take(&mut self.block.acts);
            write(self, number);
            std::mem::swap(&mut self.step, &mut steps[number]);
            std::mem::replace(&mut self.block.acts, before)
        })
    }
}

/// The acts of two steps, which are the same but for what they read and make, so many of each in turn; their sums as one.
fn in_turns([one, other]: [Acts; 2]) -> Acts {
    let mut all = Vec::with_capacity(one.len() + other.len());
    let mut both = one.into_iter().zip(other).peekable();
    while both.peek().is_some() {
        let (mut later, mut sums) = (Vec::new(), Vec::new());
        for (one, other) in both.by_ref().take(TURN) {
            match (one, other) {
                ((Act::Sum { variable, element, mut addends }, value), (Act::Sum { addends: more, .. }, _)) => {
                    addends.extend(more);
                    sums.push((Act::Sum { variable, element, addends }, value));
                }
                (one, other) => {
                    all.push(one);
                    later.push(other);
                }
            }
        }
        all.append(&mut later);
        all.append(&mut sums);
    }
    all
}
