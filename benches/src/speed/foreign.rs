//! Loops that other compilers made, ready to be called.
//!
//! What comes in: source texts that `isophote-symbolic` exported, with a function of [`CALL`]'s shape for each, and the command
//! that compiles them. What goes out: functions and the size of their code. They read pixels only inside of the window, which the
//! exported text checks against the plane's size; the plane's size is checked here.
#![allow(unsafe_code)]

use std::path::{Path, PathBuf};
use std::process::Command;

use libloading::Library;

/// Plane: first pixel, width, height, then strides in pixels; window: x, y, width, height; inputs; outputs; pixels and saturated.
type Call = unsafe extern "C" fn(*const u8, *const usize, *const usize, *const f64, *mut f64, *mut u64) -> i32;

/// A file of compiled functions.
pub struct Compiled {
    code: Library,
    path: PathBuf,
    /// What the compiler said.
    said: String,
}

/// One of its functions.
pub struct Foreign<'a> {
    call: libloading::Symbol<'a, Call>,
    outputs: usize,
    inputs: usize,
    bytes_per_pixel: usize,
}

/// A picture whose rows and pixels follow each other without gaps.
#[derive(Clone, Copy)]
pub struct Picture<'a> {
    /// Native byte order.
    pub bytes: &'a [u8],
    /// px
    pub width: usize,
    /// px
    pub height: usize,
}

impl Compiled {
    /// Runs a compiler: `command` and its arguments, then `-o path source`.
    pub fn new(folder: &Path, file: &str, source: &str, command: &[&str]) -> Result<Compiled, String> {
        std::fs::create_dir_all(folder).map_err(|error| error.to_string())?;
        let (source_path, path) = (folder.join(file), folder.join(format!("{file}.so")));
        std::fs::write(&source_path, source).map_err(|error| error.to_string())?;
        let (program, arguments) = command.split_first().ok_or("no compiler")?;
        let mut compiler = Command::new(program);
        compiler.args(arguments).arg("-o").arg(&path).arg(&source_path);
        if program.ends_with("cc") {
            compiler.arg("-lm");
        }
        let made = compiler.output().map_err(|error| format!("{program}: {error}"))?;
        if !made.status.success() {
            return Err(format!("{command:?}: {}", String::from_utf8_lossy(&made.stderr)));
        }
        // SAFETY: the file was made just now of exported text, which has no code that runs when it is loaded.
        let code = unsafe { Library::new(path.as_path()) }.map_err(|error| error.to_string())?;
        Ok(Compiled { code, path, said: String::from_utf8_lossy(&made.stderr).into_owned() })
    }

    /// How many loops the compiler says that it made with vectors of so many bits.
    pub fn loops_with_vectors(&self, bits: usize) -> usize {
        self.said.matches(&format!("loop vectorized using {} byte vectors", bits / 8)).count()
    }

    /// A function of [`Call`]'s shape.
    pub fn function(
        &self,
        name: &str,
        inputs: usize,
        outputs: usize,
        bytes_per_pixel: usize,
    ) -> Result<Foreign<'_>, String> {
        // SAFETY: every function that is looked up is written by `contenders.rs` with this signature.
        let call = unsafe { self.code.get::<Call>(name.as_bytes()) }.map_err(|error| error.to_string())?;
        Ok(Foreign { call, outputs, inputs, bytes_per_pixel })
    }

    /// Bytes of machine code of a symbol, by `nm`; absent where there is no `nm` or no such symbol.
    pub fn code_bytes(&self, name: &str) -> Option<usize> {
        let listed = Command::new("nm").arg("-S").arg(&self.path).output().ok()?;
        let text = String::from_utf8(listed.stdout).ok()?;
        let line = text.lines().find(|line| line.split_whitespace().last() == Some(name))?;
        usize::from_str_radix(line.split_whitespace().nth(1)?, 16).ok()
    }
}

impl Foreign<'_> {
    /// One pass: outputs, and how many pixels it used.
    pub fn sums(&self, picture: Picture<'_>, window: [usize; 4], inputs: &[f64]) -> Result<(Vec<f64>, u64), String> {
        let Picture { bytes, width, height } = picture;
        if bytes.len() < width * height * self.bytes_per_pixel || inputs.len() != self.inputs {
            return Err(format!("{} bytes, {} inputs", bytes.len(), inputs.len()));
        }
        if bytes.as_ptr().align_offset(self.bytes_per_pixel) != 0 {
            return Err("pixels are not aligned".into());
        }
        let plane = [width, height, 1, width];
        let (mut outputs, mut counts) = (vec![0.0; self.outputs], [0_u64; 2]);
        // SAFETY: the plane lies in `bytes` and is aligned, the numbers of inputs and outputs are the function's own, and the
        // function checks the window against the plane's size.
        let done = unsafe {
            (self.call)(
                bytes.as_ptr(),
                plane.as_ptr(),
                window.as_ptr(),
                inputs.as_ptr(),
                outputs.as_mut_ptr(),
                counts.as_mut_ptr(),
            )
        };
        if done == 1 { Ok((outputs, counts[0])) } else { Err(format!("window {window:?} of {width} x {height} px")) }
    }
}
