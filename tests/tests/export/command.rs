//! `isophote model export` on the command line.

use std::process::Command;
use std::time::Duration;

use isophote_tests::{Finished, finish, program, repository};

fn export(arguments: &[&str]) -> Finished {
    let mut command = Command::new(program().unwrap());
    command.args(["model", "export"]).args(arguments).current_dir(repository());
    finish(&mut command, Duration::from_secs(60)).unwrap()
}

fn text(arguments: &[&str]) -> String {
    let finished = export(arguments);
    assert_eq!(finished.status, Some(0), "{arguments:?}: {}", finished.stderr);
    finished.stdout
}

#[test]
fn the_command_writes_c_and_rust() {
    let spot = "models/thesis-spot.toml";
    let c = text(&[spot, "--parameters", "bx,by", "--lang", "c"]);
    assert!(
        c.contains("int isophote_thesis_spot(isophote_thesis_spot_plane_u8 phi_plane")
            && c.contains("#include <math.h>")
    );
    assert!(!c.contains("fma"), "no fused multiply-add that was not asked for");
    assert!(text(&[spot, "--lang", "c", "--fma"]).contains("fmaf("));
    let rust = text(&[
        spot,
        "--lang",
        "rust",
        "--pixels",
        "f32",
        "--precision",
        "f64",
        "--saturation",
        "drop",
        "--name",
        "my_spot",
    ]);
    assert!(rust.contains("pub fn my_spot(") && rust.contains("Plane<'_, f32>") && rust.contains("saturated += 1"));
    assert!(text(&[spot, "--lang", "rust", "--lanes", "8"]).contains("_mm256_fmadd_ps"));
    let gauss = text(&[spot, "--parameters", "bx,by", "--lang", "c", "--method", "gauss-newton"]);
    assert_ne!(gauss, c);
}

#[test]
fn json_and_files_hold_the_same_text() {
    let arguments = ["models/spot.toml", "--parameters", "bx,by", "--lang", "c"];
    let plain = text(&arguments);
    let json: serde_json::Value = serde_json::from_str(&text(&[&arguments[..], &["--json"]].concat())).unwrap();
    assert_eq!((json["text"].as_str(), json["language"].as_str()), (Some(plain.as_str()), Some("c")));
    assert_eq!((json["model"].as_str(), &json["parameters"]), (Some("spot"), &serde_json::json!(["bx", "by"])));
    assert!(json["digest"].as_str().unwrap().starts_with("sha256:"));
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("spot.c");
    assert_eq!(text(&[&arguments[..], &["--out", path.to_str().unwrap()]].concat()), "");
    assert_eq!(std::fs::read_to_string(path).unwrap(), plain);
}

#[test]
fn wrong_options_and_wrong_models_have_different_statuses() {
    let fails = |arguments: &[&str], status: i32, says: &str| {
        let finished = export(arguments);
        assert_eq!(finished.status, Some(status), "{arguments:?}: {}", finished.stderr);
        assert!(finished.stderr.contains(says), "{arguments:?}: {}", finished.stderr);
        assert_eq!(finished.stdout, "", "{arguments:?}");
    };
    let spot = "models/spot.toml";
    fails(&[spot], 2, "--lang");
    fails(&[spot, "--lang", "pascal"], 2, "pascal");
    fails(&[spot, "--lang", "c", "--parameters", "nobody"], 2, "has no parameter `nobody`");
    fails(&[spot, "--lang", "c", "--lanes", "4"], 2, "4 lanes of f32 are not written in C");
    fails(&[spot, "--lang", "rust", "--lanes", "4", "--precision", "f64"], 2, "4 lanes of f64 are not written in Rust");
    fails(&["models/gaussian.toml", "--lang", "rust", "--lanes", "4"], 2, "no elementary functions");
    fails(&[spot, "--lang", "c", "--name", "double"], 2, "`double` cannot be a function's name");
    fails(&[spot, "--lang", "c", "--pixels", "u8,u8"], 2, "2 pixel types for 1 channels");
    fails(&["tests/malformed/name-missing.toml", "--lang", "c"], 3, "name");
    fails(&["models/absent.toml", "--lang", "c"], 1, "cannot be read");
    fails(&[spot, "--lang", "c", "--out", "absent/folder/spot.c"], 1, "cannot be written");
}
