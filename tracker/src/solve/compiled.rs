//! `Compiled`: a model ready to be fitted, and what is tried in its place.
//!
//! What comes in: a checked model. What goes out: its kernels, and its other backgrounds as soon as somebody has prepared them. It
//! never knows a frame.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use isophote_jit::KernelCache;
use isophote_symbolic::{Model, Precision, Quadrature};

use crate::sight::detect::Bank;
use crate::solve::backgrounds::Backgrounds;
use crate::solve::sampling::Sampling;
use crate::solve::shelf::Shelf;
use crate::solve::stage_kernels::{Begins, CompileFailure, StageKernels};
use crate::solve::workers::{InTurn, Workers};

/// A model's kernels for all stages. Cheap to share; threads may use it at the same time. The kernels that it handed out
/// stay for as long as it lives; the cache behind it may keep them for longer.
pub struct Compiled {
    kernels: StageKernels,
    backgrounds: Arc<Shelf<Backgrounds>>,
    sampling: Arc<Shelf<Sampling>>,
    /// Kernels for rows that are off, which are among the model's own.
    rows: Arc<Shelf<Option<()>>>,
    /// What targets look like, for the constants of so many sessions, the latest last.
    banks: Arc<Mutex<Banks>>,
}

/// Constants, and what targets look like with them.
type Banks = Vec<(Vec<f64>, Arc<Bank>)>;

/// Sessions' constants that templates are kept for.
const BANKS_MAX: usize = 8;

impl Compiled {
    /// Derives all programs of the model's stages, with a cache of its own. Kernels follow when a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn new(model: Arc<Model>, precision: Precision) -> Result<Compiled, CompileFailure> {
        Compiled::with_cache(model, precision, Arc::default(), &InTurn)
    }

    /// The same with a cache that other models share, so that a kernel that one of them has is not compiled again, and with
    /// the stages derived by `workers`.
    ///
    /// # Errors
    /// When the document asks for what this build cannot do.
    pub fn with_cache(
        model: Arc<Model>,
        precision: Precision,
        cache: Arc<KernelCache>,
        workers: &dyn Workers,
    ) -> Result<Compiled, CompileFailure> {
        // Where quadrature is left open, fits from nearby take the kernels of `sampling`.
        let is_sampled = model.quadrature() == Quadrature::Auto;
        let begins = if is_sampled { Begins::Anywhere } else { Begins::Nearby };
        Ok(Compiled::of_kernels(StageKernels::new(model, precision, cache, workers, begins)?))
    }

    /// The same programs, cache and backgrounds, holding no kernel yet: for one who gives his kernels back when he is done.
    pub fn share(&self) -> Compiled {
        Compiled {
            kernels: self.kernels.share(),
            backgrounds: self.backgrounds.clone(),
            sampling: self.sampling.clone(),
            rows: self.rows.clone(),
            banks: self.banks.clone(),
        }
    }

    /// With nothing derived beside these.
    pub(crate) fn of_kernels(kernels: StageKernels) -> Compiled {
        Compiled {
            kernels,
            backgrounds: Arc::default(),
            sampling: Arc::default(),
            rows: Arc::default(),
            banks: Arc::default(),
        }
    }

    /// The model on other backgrounds, derived as long as `keeps_going` says so; those that are there need not be.
    pub(crate) fn backgrounds(&self, keeps_going: &dyn Fn() -> bool) -> Option<Arc<Backgrounds>> {
        let derive = || Backgrounds::new(&self.kernels, keeps_going);
        self.backgrounds.get_or_derive(derive)
    }

    /// Where they are kept.
    pub(crate) fn backgrounds_shelf(&self) -> &Shelf<Backgrounds> {
        &self.backgrounds
    }

    /// What searches look for with these constants; `None` where a document cannot say what its target looks like.
    pub(crate) fn bank(&self, constants: &[f64]) -> Option<Arc<Bank>> {
        let mut banks = self.banks.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, bank)) = banks.iter().find(|(known, _)| known == constants) {
            return Some(bank.clone());
        }
        let bank = Arc::new(Bank::of(self.model())?);
        if banks.len() == BANKS_MAX {
            banks.remove(0);
        }
        banks.push((constants.to_vec(), bank.clone()));
        Some(bank)
    }

    /// The kernels of a model that leaves its quadrature open.
    pub(crate) fn sampling(&self) -> Arc<Sampling> {
        self.sampling.get_or_derive(|| Some(Sampling::new(&self.kernels))).unwrap_or_default()
    }

    /// Where they are kept.
    pub(crate) fn sampling_shelf(&self) -> &Shelf<Sampling> {
        &self.sampling
    }

    /// Which pixels there are kernels for whose rows are off.
    pub(crate) fn rows_shelf(&self) -> &Shelf<Option<()>> {
        &self.rows
    }
}

impl Deref for Compiled {
    type Target = StageKernels;

    fn deref(&self) -> &StageKernels {
        &self.kernels
    }
}
