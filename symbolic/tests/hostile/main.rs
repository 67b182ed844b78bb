//! Documents that try to cost more than they should: each ends in a diagnostic, or is honest and derives, and takes little
//! memory. Times are printed by the example `hostile`, in release.
#![allow(clippy::unwrap_used, missing_docs)]

mod documents;
mod ending;

use documents::Ending;
use peak_alloc::PeakAlloc;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Bytes that a document may take, its text left out.
const BYTES_MAX: usize = 64 << 20;

/// One test, so that nothing else runs beside it and is counted.
#[test]
fn hostile_documents_end_well() {
    let mut wrong = Vec::new();
    for hostile in documents::all() {
        let before = MEMORY.current_usage();
        MEMORY.reset_peak_usage();
        let model = hostile.read();
        let refused = model.as_ref().err().cloned();
        let derived = model.map_or(Ok(()), |model| ending::derive(&model));
        let bytes = MEMORY.peak_usage().saturating_sub(before);
        let name = hostile.name;
        if bytes > BYTES_MAX {
            wrong.push(format!("{name}: {} KiB", bytes >> 10));
        }
        let faults = refused.clone().or(derived.err()).unwrap_or_default();
        let is_bounded = faults.iter().all(|d| d.message.chars().count() <= 400 && d.render("d").len() <= 2048);
        if faults.len() > isophote_symbolic::LIMITS.diagnostics + 1 || !is_bounded {
            wrong.push(format!("{name}: {} diagnostics, or long ones", faults.len()));
        }
        let codes: Vec<&str> = faults.iter().map(|d| d.code.as_str()).collect();
        let ends_well = match hostile.ending {
            Ending::Refused("none") => faults.is_empty(),
            Ending::Refused(code) => refused.is_some() && codes.contains(&code),
            Ending::Honest => codes.iter().all(|code| *code == "limit"),
        };
        if !ends_well {
            let first = faults.first().map(|f| &f.message);
            wrong.push(format!("{name}: {:?} expected, {:?} found, {first:?}", hostile.ending, codes.first()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
