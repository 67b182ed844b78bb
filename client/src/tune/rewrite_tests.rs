#![allow(clippy::unwrap_used)]
use super::*;
use isophote_symbolic::Method;

const HEAD: &str = "name = \"flat\"   # a [[stages]] in a comment\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n\
                    description = \"\"\"of text\n[[stages]]\n[[not] a header\"\"\"\n";
const TAIL: &str = "[parameters]\nv0 = { start = 1.0 }   # light\nv1 = { start = 2.0 }\n\n[model]\nintensity = \"v0 + v1\"\n";
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
    Rewrite { model: &model, text, is_json: false, stages: change.then_some(&stages), comment }.text()
}

const NEW: &str = "# isophote tune: why\n[[stages]]\nparameters = [\"v1\"]\nmethod     = \"gauss-newton\"\niterations = 7\n\
                   tolerance  = 1e-5\n";

/// Wherever the stages stand and however they are written, they are replaced and nothing else is.
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
fn what_is_not_understood_is_refused() {
    let text = format!("{HEAD}{TAIL}[[\"stages\"]]\nparameters = [\"v0\"]\n");
    assert_eq!(rewritten(&text, true, &[]), None);
}

#[test]
fn json_is_written_anew() {
    let toml = Model::from_toml(&format!("{HEAD}{TAIL}")).unwrap();
    let text = toml.document().to_string();
    let model = Model::from_json(&text).unwrap();
    let stages = [Stage { method: Method::Newton, iterations: 3, ..model.stages()[0].clone() }];
    let new = Rewrite { model: &model, text: &text, is_json: true, stages: Some(&stages), comment: &[] }.text().unwrap();
    let read = Model::from_json(&new).unwrap();
    assert_eq!((read.stages(), read.document()["model"].clone()), (&stages[..], model.document()["model"].clone()));
}
