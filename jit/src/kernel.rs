//! `Kernel`: a program compiled to native code.

use std::sync::Arc;

use isophote_symbolic::{Bindings, Program, Sink};
use smallvec::SmallVec;

use crate::compile;
use crate::error::{CompileError, RunError};
use crate::host::Processor;
use crate::memory::CodeMemory;
use crate::options::KernelOptions;
use crate::plane::{PlaneView, Region, Window};
use crate::runner::{CallShape, Code};

/// The result of a pass.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Sums {
    /// The program's outputs.
    pub outputs: Vec<f64>,
    /// Pixels used.
    pub pixels: u64,
    /// Saturated pixels of the domain, which were left out.
    pub saturated: u64,
}

/// Native code of a program. Several threads may run it at once; dropping it frees its memory.
#[derive(Debug)]
pub struct Kernel {
    program: Program,
    options: KernelOptions,
    frame_bytes: usize,
    code: Code,
}

impl Kernel {
    /// Compiles a program.
    pub fn compile(program: &Program, options: &KernelOptions) -> Result<Kernel, CompileError> {
        Kernel::compile_for(Processor::Host, program, options)
    }

    /// Compiles a program for `processor`; [`Processor::Baseline`] gives the code of machines without this one's extensions.
    pub fn compile_for(
        processor: Processor,
        program: &Program,
        options: &KernelOptions,
    ) -> Result<Kernel, CompileError> {
        Kernel::compile_into(None, processor, program, options)
    }

    /// Like [`Kernel::compile_for`]; `say` may refuse the code memory.
    pub(crate) fn compile_into(
        say: Option<Arc<dyn CodeMemory>>,
        processor: Processor,
        program: &Program,
        options: &KernelOptions,
    ) -> Result<Kernel, CompileError> {
        let compiled = compile::native(program, options, processor)?;
        let shape = CallShape {
            inputs: program.inputs().len(),
            outputs: program.sink().outputs().len(),
            tables: program.tables().clone(),
            formats: options.formats.clone(),
            packed: options.packed,
            renders: matches!(program.sink(), Sink::Plane(_)),
            lanes: options.lanes().count(),
        };
        let code = Code::load(&compiled, shape, say).map_err(CompileError::NoCodeMemory)?;
        Ok(Kernel { program: program.clone(), options: options.clone(), frame_bytes: compiled.frame_bytes, code })
    }

    /// The compiled program.
    pub fn program(&self) -> &Program {
        &self.program
    }
    /// The options it was compiled for.
    pub fn options(&self) -> &KernelOptions {
        &self.options
    }
    /// Bytes of stack per call.
    pub fn frame_bytes(&self) -> usize {
        self.frame_bytes
    }
    /// The size of its machine code, constants included.
    pub fn code_bytes(&self) -> usize {
        self.code.bytes()
    }

    /// One pass over the pixels of `window`, which must lie inside every plane.
    pub fn sums(&self, bindings: &Bindings<'_>, planes: &[PlaneView<'_>], window: Window) -> Result<Sums, RunError> {
        let mut sums = Sums::default();
        self.sums_into(bindings, planes, window, &mut sums)?;
        Ok(sums)
    }

    /// Like [`Kernel::sums`]; overwrites `sums` and reuses its memory.
    pub fn sums_into(
        &self,
        bindings: &Bindings<'_>,
        planes: &[PlaneView<'_>],
        window: Window,
        sums: &mut Sums,
    ) -> Result<(), RunError> {
        let Sink::Sums { outputs, .. } = self.program.sink() else { return Err(RunError::Sink { renders: true }) };
        // The lists are filled in place: moving them takes as long as a small window.
        let mut regions = SmallVec::new();
        self.regions(planes, window, &mut regions)?;
        // The code writes every output.
        sums.outputs.clear();
        sums.outputs.resize(outputs.len(), f64::NAN);
        let mut inputs = SmallVec::new();
        self.inputs(bindings, &mut inputs);
        let counts = self.code.sums(&inputs, &mut sums.outputs, &regions, window);
        (sums.pixels, sums.saturated) = (counts.pixels, counts.saturated);
        Ok(())
    }

    /// Adds the program's value to every pixel of `plane`, which holds the pixels of `window` row by row.
    pub fn render(&self, bindings: &Bindings<'_>, window: Window, plane: &mut [f32]) -> Result<(), RunError> {
        let Sink::Plane(_) = self.program.sink() else { return Err(RunError::Sink { renders: false }) };
        self.check_slices(window)?;
        check_unbound(window)?;
        if window.pixels() != plane.len() {
            return Err(RunError::Target { expected: window.pixels(), given: plane.len() });
        }
        let mut inputs = SmallVec::new();
        self.inputs(bindings, &mut inputs);
        self.code.render(&inputs, window, plane);
        Ok(())
    }

    fn inputs(&self, bindings: &Bindings<'_>, inputs: &mut SmallVec<[f64; 32]>) {
        inputs.resize(self.program.inputs().len(), 0.0);
        inputs.iter_mut().zip(self.program.gather(bindings)).for_each(|(to, number)| *to = number);
    }

    /// A 2-D loop nest would skip all slices but the first.
    fn check_slices(&self, window: Window) -> Result<(), RunError> {
        let coordinates = self.program.coordinates();
        match window.size().iter().skip(coordinates.max(2)).all(|count| *count == 1) {
            true => Ok(()),
            false => Err(RunError::Slices { coordinates, window }),
        }
    }

    fn regions<'a>(
        &self,
        planes: &'a [PlaneView<'a>],
        window: Window,
        regions: &mut SmallVec<[Region<'a>; 2]>,
    ) -> Result<(), RunError> {
        let formats = &self.options.formats;
        if planes.len() != formats.len() {
            return Err(RunError::Planes { channels: formats.len(), planes: planes.len() });
        }
        self.check_slices(window)?;
        if planes.is_empty() {
            check_unbound(window)?;
        }
        for (channel, (plane, expected)) in planes.iter().zip(formats).enumerate() {
            if plane.format() != *expected {
                return Err(RunError::Format { channel, expected: *expected, given: plane.format() });
            }
            if self.options.packed && !plane.is_packed() {
                return Err(RunError::Packing { channel, stride: plane.pixel_stride() });
            }
            regions.push(plane.region(window).ok_or(RunError::Window { window, size: plane.size() })?);
        }
        Ok(())
    }
}

/// Checks a window that no plane bounds.
fn check_unbound(window: Window) -> Result<(), RunError> {
    let size = [PlaneView::SIDE_MAX; 4];
    let rows = window.size()[1..].iter().fold(1usize, |rows, n| rows.saturating_mul(*n));
    match window.clipped_to(size) == Some(window) && rows <= PlaneView::SIDE_MAX {
        true => Ok(()),
        false => Err(RunError::Window { window, size }),
    }
}
