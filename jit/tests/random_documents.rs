//! Native code equals the interpreter, and both equal the formulas, on every program of random documents, from a grammar that is
//! independent of the compiler. Messages of failures contain the seed; `examples/soak.rs` runs ten thousand.

mod common;

use common::documents::{Tally, try_document, try_faults};

#[test]
fn programs_of_random_documents_equal_their_formulas() {
    let mut tally = Tally::default();
    (0..60).for_each(|seed| try_document(seed, &mut tally));
    let Tally { documents, joint, programs, undefined, empty_rows, runs, compared, undecided, ref faults, .. } = tally;
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults[..faults.len().min(4)].join("\n\n"));
    assert!(joint > 2, "{tally:?}");
    assert!(documents > 40 && programs > 30 * documents && empty_rows > documents, "{tally:?}");
    assert!(compared * 10 > runs * 9 && undecided * 100 < runs && undefined * 100 < programs, "{tally:?}");
}

#[test]
fn formulas_detect_wrong_instructions() {
    let counts = (0..25).map(try_faults);
    let [noticed, all] = counts.fold([0, 0], |sum, count| [sum[0] + count[0], sum[1] + count[1]]);
    assert!(all > 100 && noticed == all, "{noticed} of {all}");
}
