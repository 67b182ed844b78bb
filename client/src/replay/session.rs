//! `RecordedSession`: what happened in a recording happens again.
//!
//! In: a recording, fit by fit. Out: the same with what its fits give now, wherever a snapshot was gone on from and no pixels are
//! missing since. It never knows what is compared.

use isophote_wire::{EstimateView, LoggedSnapshot, LoggedSwap};

use super::log::{Recorded, RecordedFit, RecordedLog};
use super::refit::Refit;
use crate::failure::Failure;

/// A recording whose fits are repeated, from snapshot to snapshot.
pub struct RecordedSession {
    log: RecordedLog,
    /// What fits.
    pub refit: Option<Refit>,
    /// What fits where nothing can be repeated at the moment.
    swap: Option<Box<LoggedSwap>>,
    /// What it remembers is what was remembered then.
    is_in_step: bool,
    /// The number of the fit that is next.
    fits: Option<u64>,
}

/// What happened, and happens again.
pub enum Repeated {
    /// Another model took over.
    Swap,
    /// What was remembered; what is remembered now, where that should be the same.
    Snapshot(Box<LoggedSnapshot>, Option<serde_json::Value>),
    /// A frame; its estimates, where it could be repeated.
    Fit(Box<RecordedFit>, Option<Vec<(EstimateView, isophote_tracker::Estimate)>>),
}

impl RecordedSession {
    /// From the begin of the file on.
    pub fn new(log: RecordedLog) -> RecordedSession {
        RecordedSession { log, refit: None, swap: None, is_in_step: false, fits: None }
    }

    /// What happened next, and what happens now; `None` at the end.
    pub fn next(&mut self) -> Result<Option<Repeated>, Failure> {
        let Some(happened) = self.log.next()? else { return Ok(None) };
        Ok(Some(match happened {
            Recorded::Swap(swap) => {
                match (&mut self.refit, self.is_in_step) {
                    (Some(refit), true) if !swap.is_warm => refit.swap(&swap, &self.log.session)?,
                    // It begins with the snapshot that follows.
                    _ => (self.refit, self.is_in_step) = (None, false),
                }
                self.swap = Some(swap);
                Repeated::Swap
            }
            Recorded::Snapshot(logged) => {
                self.is_in_step &= self.fits.is_none_or(|fits| fits == logged.fits);
                self.fits = Some(logged.fits);
                let now = match &self.refit {
                    Some(refit) if self.is_in_step => Some(refit.snapshot()?),
                    _ => None,
                };
                if now.is_none() {
                    self.restore(&logged)?;
                }
                Repeated::Snapshot(logged, now)
            }
            Recorded::Fit(fit) => {
                self.is_in_step &= self.fits.is_none_or(|fits| fits == fit.fit.fit);
                self.fits = Some(fit.fit.fit + 1);
                let again = match &mut self.refit {
                    Some(refit) if self.is_in_step => refit.fit(&fit)?,
                    _ => None,
                };
                self.is_in_step &= again.is_some();
                Repeated::Fit(fit, again)
            }
        }))
    }

    fn restore(&mut self, logged: &LoggedSnapshot) -> Result<(), Failure> {
        let Some(swap) = &self.swap else { return Ok(()) };
        if self.refit.is_none() {
            self.refit = Some(Refit::new(swap, &self.log.session)?);
        }
        if let Some(refit) = &mut self.refit {
            refit.restore(logged)?;
            self.is_in_step = true;
        }
        Ok(())
    }
}
