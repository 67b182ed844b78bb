//! Spans of remarks.
#![allow(clippy::unwrap_used)]
use super::*;

const TOML: &str = "name = \"line\"\ncoordinates = [\"i\"]\nchannels = [\"y\", \"x\"]\n[parameters]\n\
                    a = { start = 1.0 }\nb = { start = 1.0 }\nc = { start = 1.0 }\n[model]\nobserved = \"y\"\n\
                    intensity = \"a * x\"\nconstraint = [\"b > 0\"]\n[[stages]]\nparameters = [\"a\", \"b\"]\n";

#[test]
fn remark_points_at_the_stage_that_frees_the_parameter() {
    let model = Model::from_toml(TOML).unwrap();
    let [a, b, c] = ["a", "b", "c"].map(|name| model.parameter(name).unwrap());
    let freed = model.remark(Severity::Warning, "some-code", (Some(0), b), "a sentence");
    assert_eq!((freed.key.as_str(), freed.severity), ("stages[0].parameters", Severity::Warning));
    assert!(TOML[freed.span.start as usize..freed.span.end as usize].contains('b'), "{freed:?}");
    assert_eq!((freed.line, freed.source.as_str()), (13, "parameters = [\"a\", \"b\"]"));
    let declared = model.remark(Severity::Error, "some-code", (Some(0), c), "a sentence");
    assert_eq!((declared.key.as_str(), declared.line), ("parameters.c", 7));
    assert_eq!([a, b, c].map(|p| model.reads(p)), [true, true, false]);
    assert!(model.needs_a_frame());
    assert!(!Model::from_toml(&TOML.replace("a * x", "a * i")).unwrap().needs_a_frame());
}
