#![allow(clippy::unwrap_used)]
use super::*;
use isophote_symbolic::Method;

const HEAD: &str = "name = \"flat\"   # a [[stages]] in a comment\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n\
                    description = \"\"\"of text\n[[stages]]\n[[not] a header\"\"\"\n";
const TAIL: &str =
    "[parameters]\nv0 = { start = 1.0 }   # light\nv1 = { start = 2.0 }\n\n[model]\nintensity = \"v0 + v1\"\n";
const STAGES: &str = "# mine, before\n[[stages]]   # first\nparameters = [\n  \"v0\",   # [\n]\n# mine, inside\n[[stages]]\n\
                      parameters = [\"v0\", \"v1\"]\nmethod = \"newton\"\n\n# of what follows\n";

fn rewritten(text: &str, change: bool, comment: &[String]) -> Option<String> {
    let model = Model::from_toml(text).unwrap_or_else(|d| panic!("{}", d[0].render("test")));
    let stage = Stage {
        parameters: model.parameter("v1").into_iter().collect(),
        method: Method::GaussNewton,
        iterations: 7,
        tolerance: 1e-5,
    };
    let stages = [stage];
    Document { model: &model, text, is_json: false }.rewritten(change.then_some(&stages[..]), comment)
}

const NEW: &str = "# isophote tune: why\n[[stages]]\nparameters = [\"v1\"]\nmethod     = \"gauss-newton\"\niterations = 7\n\
                   tolerance  = 1e-5\n";

/// Stages are replaced wherever they stand and however they are written, and nothing else is.
#[test]
fn only_the_stages_are_replaced() {
    let why = ["why".to_string()];
    let (tail, inline) = (TAIL, "stages = [\n  { parameters = [\"v0\"] },\n]\n");
    let cases = [
        (format!("{HEAD}{tail}"), format!("{HEAD}{tail}\n{NEW}")),
        (format!("{HEAD}{tail}{STAGES}"), format!("{HEAD}{tail}# mine, before\n{NEW}\n# of what follows\n")),
        (format!("{HEAD}{STAGES}{tail}"), format!("{HEAD}# mine, before\n{NEW}\n# of what follows\n{tail}")),
        (format!("{HEAD}{inline}{tail}"), format!("{HEAD}{tail}\n{NEW}")),
    ];
    for (text, expected) in cases {
        let once = rewritten(&text, true, &why).unwrap_or_else(|| panic!("not understood: {text}"));
        assert_eq!(once.replace("# mine, inside\n", ""), expected);
        assert_eq!(rewritten(&once, true, &why).unwrap(), once, "an older comment is replaced");
    }
}

#[test]
fn stages_that_stay_keep_their_text() {
    let text = format!("{HEAD}{TAIL}{STAGES}");
    let kept = rewritten(&text, false, &["stays".to_string()]).unwrap();
    assert_eq!(kept, text.replacen("[[stages]]   # first", "# isophote tune: stays\n[[stages]]   # first", 1));
}

#[test]
fn unsupported_spellings_are_rejected() {
    let text = format!("{HEAD}{TAIL}[[\"stages\"]]\nparameters = [\"v0\"]\n");
    assert_eq!(rewritten(&text, true, &[]), None);
}

/// Parameters of a JSON document keep document order, which differs from alphabetical order.
#[test]
fn json_keeps_its_text_and_order() {
    let head = "{\"name\": \"flat\", \"coordinates\": [\"x\"], \"channels\": [\"phi\"],\n \"description\": \"\\\"stages\\\": {\",\n \
                \"parameters\": {\"v1\": {\"start\": 1}, \"v0\": {\"start\": 2}}, \"model\": {\"intensity\": \"v0 + v1\"}";
    let stages = |name: &str| format!("[{{\"parameters\": [\"{name}\"]}}]");
    for text in [format!("{head}}}\n"), format!("{head}, \"stages\" : {}\n}}\n", stages("v0"))] {
        let model = Model::from_json(&text).unwrap();
        let new = [Stage { method: Method::Newton, iterations: 3, ..model.stages()[0].clone() }];
        let document = Document { model: &model, text: &text, is_json: true };
        let written = document.rewritten(Some(&new), &[]).unwrap();
        assert!(written.starts_with(head) && written.ends_with("\n}\n"), "{written}");
        let read = document.with_stages(&new).unwrap();
        assert_eq!((read.stages(), read.parameters()[0].name.as_str()), (&new[..], "v1"));
    }
}
