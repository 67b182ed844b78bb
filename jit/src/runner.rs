//! Loads, calls and frees machine code.
#![allow(unsafe_code)] // calling machine code requires it; every block names the type that carries the proof

use std::mem::ManuallyDrop;
use std::sync::Arc;
use std::{io, ptr};

use cranelift_codegen::ir::{AbiParam, types};
use cranelift_jit::{BranchProtection, JITBuilder, JITMemoryKind, JITMemoryProvider, JITModule, SystemMemoryProvider};
use cranelift_module::{Module, ModuleError, ModuleResult, default_libcall_names};
use isophote_symbolic::Tables;
use smallvec::SmallVec;

use crate::abi::{Args, FUNCTIONS, PlaneArgs};
use crate::compile::Native;
use crate::host::{self, Allocator, Processor};
use crate::memory::{CodeMemory, CodeStep};
use crate::plane::{Padded, PixelFormat, Region, Window};

/// The arguments that the code expects.
#[derive(Debug)]
pub(crate) struct CallShape {
    pub inputs: usize,
    pub outputs: usize,
    pub tables: Tables,
    pub formats: Vec<PixelFormat>,
    pub packed: bool,
    pub renders: bool,
    /// Pixels that a group reads at once: no row passed to the code may be shorter.
    pub lanes: usize,
}

/// Pixel counts of a pass.
pub(crate) struct Counts {
    pub pixels: u64,
    pub saturated: u64,
}

type EntryPoint = unsafe extern "C" fn(*mut Args);

/// Machine code in executable memory, which it owns.
pub(crate) struct Code {
    module: ManuallyDrop<JITModule>,
    entry: EntryPoint,
    bytes: usize,
    shape: CallShape,
}

// SAFETY: `Code` is read-only after `load`: `entry` points to memory that is executable and not writable, and the module is
// touched again by `drop` alone, which has the only reference. (`JITModule` is Send; it lacks Sync for a symbol cache.)
unsafe impl Sync for Code {}

impl std::fmt::Debug for Code {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Code").field("bytes", &self.bytes).field("shape", &self.shape).finish_non_exhaustive()
    }
}

impl Drop for Code {
    fn drop(&mut self) {
        // SAFETY: `module` is taken once, here. Nothing runs the code any more: `sums` and `render` borrow `Code`, and
        // `entry` never leaves it.
        unsafe { ManuallyDrop::take(&mut self.module).free_memory() }
    }
}

impl Code {
    /// Loads code into memory of its own, first writable and then executable, never both, if `say` permits it.
    pub fn load(native: &Native, shape: CallShape, say: Option<Arc<dyn CodeMemory>>) -> Result<Code, String> {
        let isa = host::isa(Processor::Host, Allocator::Backtracking).map_err(|e| e.to_string())?;
        let mut builder = JITBuilder::with_isa(isa, default_libcall_names());
        builder.memory_provider(Box::new(Pages { system: SystemMemoryProvider::new(), say }));
        let mut module = ManuallyDrop::new(JITModule::new(builder));
        match define(&mut module, native) {
            Ok(entry) => Ok(Code { module, entry, bytes: native.bytes.len(), shape }),
            Err(error) => {
                // SAFETY: `module` is taken once, and no pointer into it has been given out.
                unsafe { ManuallyDrop::take(&mut module).free_memory() };
                Err(error)
            }
        }
    }

    /// The size of the code.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Runs a pass of a program that sums.
    pub fn sums(&self, inputs: &[f64], outputs: &mut [f64], regions: &[Region<'_>], window: Window) -> Counts {
        assert!(!self.shape.renders && outputs.len() == self.shape.outputs, "another program's outputs");
        self.run(inputs, outputs, regions, window, &mut [])
    }

    /// Runs a pass of a program that renders.
    pub fn render(&self, inputs: &[f64], window: Window, target: &mut [f32]) {
        assert!(self.shape.renders && target.len() == window.pixels(), "a plane of another size");
        let lanes = self.shape.lanes;
        if window.width >= lanes {
            self.run(inputs, &mut [], &[], window, target);
            return;
        }
        let mut wide = vec![0.0; target.len() / window.width * lanes];
        let copy = |wide: &mut [f32], narrow: &mut [f32], into_wide: bool| {
            for (wide, narrow) in wide.chunks_mut(lanes).zip(narrow.chunks_mut(window.width)) {
                match into_wide {
                    true => wide[..narrow.len()].copy_from_slice(narrow),
                    false => narrow.copy_from_slice(&wide[..narrow.len()]),
                }
            }
        };
        copy(&mut wide, target, true);
        self.run(inputs, &mut [], &[], window, &mut wide);
        copy(&mut wide, target, false);
    }

    fn run(
        &self,
        inputs: &[f64],
        outputs: &mut [f64],
        regions: &[Region<'_>],
        window: Window,
        target: &mut [f32],
    ) -> Counts {
        assert!(inputs.len() == self.shape.inputs, "another program's inputs");
        assert!(self.shape.renders || regions.len() == self.shape.formats.len(), "another program's planes");
        for (region, format) in regions.iter().zip(&self.shape.formats) {
            let plane = region.plane();
            assert!(region.window() == window && plane.format() == *format, "another window's or program's plane");
            assert!(plane.is_packed() || !self.shape.packed, "pixels with gaps");
        }
        let narrow = window.width < self.shape.lanes;
        let padded: Vec<Padded> = regions.iter().filter(|_| narrow).map(|r| r.padded(self.shape.lanes)).collect();
        let mut planes: SmallVec<[PlaneArgs; 2]> = SmallVec::new();
        for (channel, region) in regions.iter().enumerate() {
            planes.push(match padded.get(channel) {
                Some(padded) => plane_args(padded.bytes(), padded.strides()),
                None => plane_args(region.first(), region.plane().strides()),
            });
        }
        let mut args = Args {
            inputs: inputs.as_ptr(),
            outputs: outputs.as_mut_ptr(),
            functions: ptr::from_ref(&FUNCTIONS),
            planes: planes.as_ptr(),
            tables: self.shape.tables.numbers().as_ptr(),
            target: target.as_mut_ptr(),
            x: window.x as i64,
            y: window.y as i64,
            width: window.width as i64,
            height: window.height as i64,
            z: window.slices.first[0] as i64,
            w: window.slices.first[1] as i64,
            depth: window.slices.count[0] as i64,
            length: window.slices.count[1] as i64,
            furthest: window.width.saturating_sub(self.shape.lanes) as i64,
            last: [window.height, window.slices.count[0], window.slices.count[1]].map(|count| count as i64 - 1),
            last_row: window.size()[1..].iter().product::<usize>() as i64 - 1,
            target_stride: (size_of::<f32>() * window.width.max(self.shape.lanes)) as i64,
            pixels: 0,
            saturated: 0,
        };
        // SAFETY: the code was made from a checked program of this `CallShape`, and audited or, where possible, verified byte
        // by byte: it reads `inputs` and `tables`, writes `outputs`, and reads or writes pixels of `window` only. No group
        // accesses more, because no row is shorter than a group: narrow ones are padded copies. The assertions above check the
        // lengths of the slices; each `Region` proves that its window lies inside its plane, and its `PlaneView` that the plane
        // lies inside its bytes. All borrows outlive the call.
        unsafe { (self.entry)(&raw mut args) };
        Counts { pixels: args.pixels as u64, saturated: args.saturated as u64 }
    }
}

fn plane_args(first: &[u8], strides: [usize; 4]) -> PlaneArgs {
    let [pixel_stride, row_stride, slice_stride, volume_stride] = strides.map(|stride| stride as i64);
    PlaneArgs { first: first.as_ptr(), row_stride, pixel_stride, slice_stride, volume_stride }
}

fn define(module: &mut JITModule, native: &Native) -> Result<EntryPoint, String> {
    let mut signature = module.make_signature();
    signature.params.push(AbiParam::new(types::I64));
    let id = module.declare_anonymous_function(&signature).map_err(|e| e.to_string())?;
    module.define_function_bytes(id, native.alignment, &native.bytes, &[]).map_err(|e| e.to_string())?;
    module.finalize_definitions().map_err(|e| e.to_string())?;
    let address = module.get_finalized_function(id);
    // SAFETY: `address` is the first byte of `native`, whose only function has `EntryPoint`'s signature (see `clif`), in
    // memory that is executable now; `Code` keeps the memory for as long as the pointer.
    Ok(unsafe { std::mem::transmute::<*const u8, EntryPoint>(address) })
}

/// The system's memory behind a [`CodeMemory`] hook.
struct Pages {
    system: SystemMemoryProvider,
    say: Option<Arc<dyn CodeMemory>>,
}

impl Pages {
    fn permit(&self, step: CodeStep) -> io::Result<()> {
        self.say.as_ref().map_or(Ok(()), |say| say.permit(step).map_err(io::Error::other))
    }
}

impl JITMemoryProvider for Pages {
    fn allocate(&mut self, size: usize, align: u64, kind: JITMemoryKind) -> io::Result<*mut u8> {
        self.permit(CodeStep::Map)?;
        self.system.allocate(size, align, kind)
    }

    unsafe fn free_memory(&mut self) {
        // SAFETY: the caller upholds the contract of the system provider's function, which is the same.
        unsafe { self.system.free_memory() }
    }

    fn finalize(&mut self, branch_protection: BranchProtection) -> ModuleResult<()> {
        self.permit(CodeStep::Protect).map_err(|err| ModuleError::Allocation { err })?;
        self.system.finalize(branch_protection)
    }
}
