//! `RecordedSession`: replays a recording event by event, and repeats its fits as long as a snapshot was restored and
//! no pixels have been missing since.

use isophote_wire::{EstimateView, LoggedSnapshot, LoggedSwap};

use super::log::{Recorded, RecordedFit, RecordedLog};
use super::refit::Refit;
use crate::failure::Failure;

/// A recording whose fits are repeated from snapshot to snapshot.
pub struct RecordedSession {
    log: RecordedLog,
    /// The tracker that repeats fits.
    pub refit: Option<Refit>,
    /// The active model, from which a tracker is rebuilt at the next snapshot.
    swap: Option<Box<LoggedSwap>>,
    /// Whether the tracker's state equals the recorded one.
    is_in_step: bool,
    /// Number of the next fit.
    fits: Option<u64>,
}

/// A replayed event.
pub enum Repeated {
    /// Another model took over.
    Swap,
    /// The recorded state, and the present one where they should be equal.
    Snapshot(Box<LoggedSnapshot>, Option<serde_json::Value>),
    /// A frame, and its repeated estimates if it could be repeated.
    Fit(Box<RecordedFit>, Option<Vec<(EstimateView, isophote_tracker::Estimate)>>),
}

impl RecordedSession {
    /// Starts at the beginning of the file.
    pub fn new(log: RecordedLog) -> RecordedSession {
        RecordedSession { log, refit: None, swap: None, is_in_step: false, fits: None }
    }

    /// Replays the next event; `None` at the end.
    pub fn next(&mut self) -> Result<Option<Repeated>, Failure> {
        let Some(happened) = self.log.next()? else { return Ok(None) };
        Ok(Some(match happened {
            Recorded::Swap(swap) => {
                match (&mut self.refit, self.is_in_step) {
                    (Some(refit), true) if !swap.is_warm => refit.swap(&swap, &self.log.session)?,
                    // A warm model starts from the snapshot that follows.
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
