//! `Compiled`: a model's kernels, with its alternative backgrounds, finer sampling and search templates once prepared.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use isophote_jit::KernelCache;
use isophote_symbolic::{Model, Precision, Quadrature};

use crate::sight::detect::Bank;
use crate::solve::backgrounds::Backgrounds;
use crate::solve::prepared::Prepared;
use crate::solve::sampling::Sampling;
use crate::solve::stage_kernels::{CompileFailure, FitStarts, StageKernels};
use crate::solve::workers::{InTurn, Workers};

/// A model's kernels for all stages. Cheap to share between threads. Kernels live as long as this does; the cache behind it
/// may keep them longer.
pub struct Compiled {
    kernels: StageKernels,
    backgrounds: Arc<Prepared<Backgrounds>>,
    sampling: Arc<Prepared<Sampling>>,
    /// Which pixel layouts have kernels for rows with offsets; the kernels are among the model's own.
    rows: Arc<Prepared<Option<()>>>,
    /// Templates for recently used constants, the latest last.
    banks: Arc<Mutex<Banks>>,
}

/// Constants and the templates for them.
type Banks = Vec<(Vec<f64>, Arc<Bank>)>;

/// Most sets of constants for which templates are kept.
const BANKS_MAX: usize = 8;

impl Compiled {
    /// Derives the programs of all stages, with a new cache. Kernels are compiled once a pixel layout is known.
    ///
    /// # Errors
    /// When the document asks for something that this build cannot do.
    pub fn new(model: Arc<Model>, precision: Precision) -> Result<Compiled, CompileFailure> {
        Compiled::with_cache(model, precision, Arc::default(), &InTurn)
    }

    /// Like [`Compiled::new`], with a cache shared between models, so that equal kernels are compiled once, and stages
    /// derived by `workers`.
    ///
    /// # Errors
    /// When the document asks for something that this build cannot do.
    pub fn with_cache(
        model: Arc<Model>,
        precision: Precision,
        cache: Arc<KernelCache>,
        workers: &dyn Workers,
    ) -> Result<Compiled, CompileFailure> {
        // With automatic quadrature, fits from nearby use the kernels of `sampling`.
        let is_sampled = model.quadrature() == Quadrature::Auto;
        let begins = if is_sampled { FitStarts::Anywhere } else { FitStarts::Nearby };
        Ok(Compiled::of_kernels(StageKernels::new(model, precision, cache, workers, begins)?))
    }

    /// Shares the programs, cache and backgrounds, without kernels yet: for users who release their kernels when done.
    pub fn share(&self) -> Compiled {
        Compiled {
            kernels: self.kernels.share(),
            backgrounds: self.backgrounds.clone(),
            sampling: self.sampling.clone(),
            rows: self.rows.clone(),
            banks: self.banks.clone(),
        }
    }

    /// Without derived parts yet.
    pub(crate) fn of_kernels(kernels: StageKernels) -> Compiled {
        Compiled {
            kernels,
            backgrounds: Arc::default(),
            sampling: Arc::default(),
            rows: Arc::default(),
            banks: Arc::default(),
        }
    }

    /// The alternative backgrounds, derived now if need be; `None` when `should_continue` stops the derivation.
    pub(crate) fn backgrounds(&self, should_continue: &dyn Fn() -> bool) -> Option<Arc<Backgrounds>> {
        let derive = || Backgrounds::new(&self.kernels, should_continue);
        self.backgrounds.get_or_derive(derive)
    }

    /// The backgrounds, where they are prepared.
    pub(crate) fn prepared_backgrounds(&self) -> &Prepared<Backgrounds> {
        &self.backgrounds
    }

    /// The templates for these constants; `None` where the document does not determine the target's appearance.
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

    /// The kernels for automatic quadrature.
    pub(crate) fn sampling(&self) -> Arc<Sampling> {
        self.sampling.get_or_derive(|| Some(Sampling::new(&self.kernels))).unwrap_or_default()
    }

    /// The finer sampling, where it is prepared.
    pub(crate) fn prepared_sampling(&self) -> &Prepared<Sampling> {
        &self.sampling
    }

    /// The layouts that have kernels for rows with offsets.
    pub(crate) fn prepared_rows(&self) -> &Prepared<Option<()>> {
        &self.rows
    }
}

impl Deref for Compiled {
    type Target = StageKernels;

    fn deref(&self) -> &StageKernels {
        &self.kernels
    }
}
