//! The gallery of docs/models.md: each shipped model with its picture, its formula and its purpose.

use std::fs;
use std::path::Path;

use isophote_symbolic::Model;
use isophote_tests::repository;
use serde_json::Value;

use crate::{expect, printed};

const PAGE: &str = "docs/models.md";
const BEGIN: &str = "<!-- gallery: written by a test -->\n";
const END: &str = "<!-- end of gallery -->\n";
/// Formulas of more lines are not shown.
const LINES_MAX: usize = 12;
/// Keys that change how a fit weighs pixels, but not the image.
const LEFT_OUT: [&str; 5] = ["quadrature", "noise", "saturated", "loss", "constraint"];

/// Parameters that keep the pictures of similar models apart.
const SET: [(&str, &str); 8] = [
    ("gaussian-pixel", "a1=0.2,a3=0.2"),
    ("spot-lobe", "v0=20"),
    ("spot-motion", "ux=20,uy=8"),
    ("spot-plane", "gx=0.8,gy=0.5,v0=60"),
    ("spot-psf", "psf=5"),
    ("spot-quadratic", "gx=0.3,p=0.02,r=0.02,v0=30"),
    ("laser-beam", "v1=400"),
    ("three-spots-raw", "xr=25,yr=25,xg=70,yg=25,xb=48,yb=52,m_rg=0.25,m_gb=0.25"),
];

/// The purpose stated by the comment at the top of a document, or else its first sentence.
fn purpose(text: &str) -> String {
    let comment: Vec<&str> = text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim).collect();
    let comment = comment.join(" ");
    let (label, sentence) = match comment.split_once("Use it for:") {
        Some((_, rest)) => ("**Use it for:** ", rest),
        None => ("", comment.as_str()),
    };
    let end = sentence.find(". ").map_or(sentence.len(), |at| at + 1);
    format!("{label}{}.", sentence[..end].trim().trim_end_matches('.'))
}

/// The document without the keys that do not affect its picture.
fn bare(text: &str) -> String {
    let is_key = |line: &str| LEFT_OUT.iter().any(|key| line.split(['=', ' ']).next() == Some(key));
    text.lines().filter(|line| !is_key(line)).map(|line| format!("{line}\n")).collect()
}

/// The residual as `model explain` writes it before the derivatives, in LaTeX and MathML. `None` if it is too long to
/// show.
fn formula(name: &str, text: &str) -> Option<(String, String)> {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("gallery-{name}.toml"));
    fs::write(&file, bare(text)).unwrap();
    let model = Model::from_toml(&bare(text)).unwrap();
    let background = model.roles().first().and_then(|roles| roles.background);
    let parameter = background.map_or(&model.parameters()[0], |id| &model.parameters()[id.index()]).name.clone();
    let explain = |show| {
        let file = file.display().to_string();
        printed(&["model", "explain", &file, "--parameters", &parameter, "--show", show, "--json"]).unwrap()
    };
    let text = |json: String| serde_json::from_str::<Value>(&json).unwrap()["text"].as_str().unwrap().to_string();
    let (latex, mathml) = (text(explain("latex")), text(explain("mathml")));
    let is_derivative = |line: &&str| !line.trim_start().starts_with("L") && !line.contains("<mi>L</mi><mo>=");
    let lines: Vec<&str> = latex.lines().skip(1).take_while(is_derivative).collect();
    if lines.len() > LINES_MAX {
        return None;
    }
    let without_place = |line: &&str| line.split(" % ").next().unwrap_or_default().to_string();
    let lines: Vec<String> = lines.iter().map(without_place).collect();
    let body = lines.join("\n").trim_end_matches(['\\', ' ']).to_string();
    let latex = format!("\\begin{{aligned}}\n{body}\n\\end{{aligned}}");
    let maths: Vec<String> = mathml.lines().take_while(is_derivative).map(without_spans).collect();
    Some((latex, maths.join("\n") + "\n"))
}

/// MathML without the attributes that point into the document.
fn without_spans(line: &str) -> String {
    let mut parts = line.split(" data-span=\"");
    let first = parts.next().unwrap_or_default().to_string();
    first + &parts.filter_map(|part| part.split_once('"').map(|(_, rest)| rest)).collect::<String>()
}

/// A picture of a model with two coordinates and unmixed channels.
fn picture(name: &str, file: &str, model: &Model) -> Option<Vec<u8>> {
    if model.coordinates().len() != 2 {
        return None;
    }
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("gallery-{name}"));
    let size = if name.contains("pose") { "640x480" } else { "96x72" };
    let set = SET.iter().find(|(model, _)| *model == name).map(|(_, set)| ["--set", set]);
    let out_text = out.display().to_string();
    let arguments = ["render", file, "--size", size, "--out", &out_text];
    printed(&[&arguments[..], set.as_ref().map_or(&[], |set| &set[..])].concat()).ok()?;
    Some(fs::read(out.join("000000.png")).unwrap())
}

#[test]
fn the_gallery_shows_every_shipped_model() {
    let mut names: Vec<String> = Vec::new();
    for entry in fs::read_dir(repository().join("models")).unwrap() {
        names.extend(entry.unwrap().file_name().to_str().unwrap().strip_suffix(".toml").map(String::from));
    }
    names.sort();
    let mut gallery = String::new();
    for name in &names {
        let file = format!("models/{name}.toml");
        let text = fs::read_to_string(repository().join(&file)).unwrap();
        let model = Model::from_toml(&text).unwrap();
        gallery += &format!("\n### {name}\n\n{}. [The document](../{file}).\n\n", model.description());
        gallery += &format!("{}\n\n", purpose(&text));
        if let Some(bytes) = picture(name, &file, &model) {
            let path = format!("figures/models/{name}.png");
            expect(&format!("docs/{path}"), &bytes);
            gallery += &format!("![A rendered {name}]({path})\n\n");
        }
        match formula(name, &text) {
            Some((latex, mathml)) => {
                expect(&format!("book/formulas/{name}.mathml"), mathml.as_bytes());
                gallery += &format!("```math {name}\n{latex}\n```\n");
            }
            None => gallery += &format!("Its formula is long: `isophote model explain {file}` shows it.\n"),
        }
    }
    let page = fs::read_to_string(repository().join(PAGE)).unwrap();
    let (head, rest) = page.split_once(BEGIN).unwrap();
    let (_, tail) = rest.split_once(END).unwrap();
    expect(PAGE, format!("{head}{BEGIN}{gallery}\n{END}{tail}").as_bytes());
}

#[test]
fn purposes_and_documents_are_parsed() {
    assert_eq!(
        purpose("# A spot. Use it for: lamps,\n# and LEDs. More.\nname = \"a\""),
        "**Use it for:** lamps, and LEDs."
    );
    assert_eq!(purpose("# A spot\n# of light. More."), "A spot of light.");
    assert_eq!(bare("noise = \"1\"\nnoisy = 2\nquadrature = 2\n"), "noisy = 2\n");
    assert_eq!(
        without_spans("<mi data-span=\"1-2\">x</mi><mo data-span=\"3-4\" form=\"a\">"),
        "<mi>x</mi><mo form=\"a\">"
    );
}
