//! Configuration by flag, environment, file and default; and `serve --check`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use isophote_tests::{Finished, Service, finish, program};
use serde_json::Value;

use crate::client::{Folder, Running};

const LIMIT: Duration = Duration::from_secs(120);

fn run(arguments: &[&str], variables: &[(&str, &str)]) -> Finished {
    let mut command = Command::new(program().unwrap());
    command.args(arguments).envs(variables.iter().copied());
    finish(&mut command, LIMIT).unwrap()
}

fn file(folder: &Folder, text: &str) -> PathBuf {
    let path = folder.0.join("isophote.toml");
    std::fs::write(&path, text).unwrap();
    path
}

fn name(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn settings_have_an_origin() {
    let folder = Folder::new("configuration");
    let path =
        file(&folder, "# mine\nlisten = \"127.0.0.1:7999\"\n  vector_width = 128\ndemo = true\nlog = \"text\"\n");
    let variables = [("ISOPHOTE_VECTOR_WIDTH", "256"), ("ISOPHOTE_LOG", "text"), ("ISOPHOTE_CONFIG", name(&path))];
    let shown = run(&["config", "show", "--json", "--log", "json"], &variables);
    assert_eq!(shown.status, Some(0), "{}", shown.stderr);
    let shown: Value = serde_json::from_str(&shown.stdout).unwrap();
    let of = |key: &str| {
        let items = shown["items"].as_array().unwrap();
        let item = items.iter().find(|item| item["key"] == key).unwrap_or_else(|| panic!("{key}: {shown}"));
        let text = |field: &str| item[field].as_str().unwrap_or("-").to_string();
        (text("value"), text("origin"), text("place"))
    };
    let place = |line: &str| format!("{}:{line}", path.display());
    assert_eq!(of("listen"), ("127.0.0.1:7999".into(), "file".into(), place("2:1")));
    assert_eq!(of("demo"), ("true".into(), "file".into(), place("4:1")));
    assert_eq!(of("vector_width"), ("256".into(), "environment".into(), "ISOPHOTE_VECTOR_WIDTH".into()));
    assert_eq!(of("log"), ("json".into(), "flag".into(), "-".into()));
    assert_eq!(of("log_level"), ("info".into(), "default".into(), "-".into()));
    assert_eq!(of("data"), ("-".into(), "default".into(), "-".into()));
    let table = run(&["config", "show", "--config", name(&path)], &[]).stdout;
    assert!(table.lines().any(|line| line.starts_with("vector_width") && line.contains("3:3")), "{table}");
}

#[test]
fn wrong_files_are_refused_with_line_and_column() {
    let folder = Folder::new("configuration-wrong");
    let cases = [
        ("listen = \"127.0.0.1:0\"\ncolour = 3\n", "2:1: there is no key `colour`; there are listen"),
        ("\nlisten = \"nowhere\"\n", "2:1: invalid value 'nowhere'"),
        ("demo = \"yes\"\n", "1:1: `demo` is true or false"),
        ("data = [\"a\"]\n", "1:1: `data` is a text or a number"),
        ("listen = \n", "1:"),
    ];
    for (text, says) in cases {
        let path = file(&folder, text);
        for command in [&["serve", "--check"][..], &["config", "show"]] {
            let refused = run(&[command, &["--config", name(&path)]].concat(), &[]);
            assert_eq!(refused.status, Some(1), "{text}: {}", refused.stderr);
            assert!(refused.stderr.contains(&format!("{}:{says}", path.display())), "{text}: {}", refused.stderr);
        }
    }
    let missing = run(&["serve", "--config", "no/such/file.toml"], &[]);
    assert_eq!(missing.status, Some(1));
    assert!(missing.stderr.contains("no/such/file.toml: cannot be read"), "{}", missing.stderr);
    assert_eq!(run(&["serve"], &[("ISOPHOTE_LISTEN", "nowhere")]).status, Some(2));
}

#[test]
fn checks_predict_starts() {
    let folder = Folder::new("configuration-check");
    let data = folder.0.join("data");
    let path = file(&folder, &format!("demo = true\ndata = {:?}\n", name(&data)));
    let with_file = ["serve", "--check", "--config", name(&path)];
    let well = run(&[&with_file[..], &["--listen", "127.0.0.1:0"]].concat(), &[]);
    assert_eq!(well.status, Some(0), "{}{}", well.stdout, well.stderr);
    assert_eq!(well.stdout.lines().filter(|line| line.contains(" ok ")).count(), 3, "{}", well.stdout);

    let report = run(&[&with_file[..], &["--listen", "127.0.0.1:0", "--json"]].concat(), &[]);
    let report: Value = serde_json::from_str(&report.stdout).unwrap();
    let names: Vec<&str> =
        report["items"].as_array().unwrap().iter().map(|item| item["what"].as_str().unwrap()).collect();
    assert_eq!(
        (&report["would_start"], &names[..]),
        (&Value::Bool(true), &["address", "data folder", "kernel"][..]),
        "{report}"
    );
    let alone = run(&["serve", "--json", "--listen", "127.0.0.1:0"], &[]);
    assert_eq!(alone.status, Some(2), "{}", alone.stderr);

    let models = folder.0.join("models");
    fs::create_dir(&models).unwrap();
    fs::write(models.join("level.toml"), "name = \"level\"\n").unwrap();
    let wrong = run(&["serve", "--check", "--listen", "127.0.0.1:0", "--models", name(&models)], &[]);
    assert_eq!(wrong.status, Some(1), "{}", wrong.stdout);
    assert!(wrong.stderr.contains("level.toml") || wrong.stdout.contains("level.toml"), "{}", wrong.stderr);

    let service = Service::start(&program().unwrap(), &["--config", name(&path)], &folder.0).unwrap();
    Running::at(service.address()).get("/v1/sessions/demo").expect(200);
    let taken = run(&[&with_file[..], &["--listen", service.address()]].concat(), &[]);
    assert_eq!(taken.status, Some(1), "{}", taken.stdout);
    assert!(taken.stderr.contains("cannot listen on") && taken.stderr.contains("another service"), "{}", taken.stderr);
    let far = run(&["serve", "--check", "--json", "--listen", "192.0.2.1:7240"], &[]);
    assert_eq!(far.status, Some(1));
    assert!(far.stderr.contains("192.0.2.1:7240"), "{}", far.stderr);
    let report: Value = serde_json::from_str(&far.stdout).unwrap();
    assert_eq!(
        (&report["would_start"], &report["items"][0]["ok"]),
        (&Value::Bool(false), &Value::Bool(false)),
        "{report}"
    );
    assert!(report["items"][0]["reason"].as_str().unwrap().contains("192.0.2.1:7240"), "{report}");
}

#[test]
fn environment_switches_have_many_spellings_and_empty_variables_are_unset() {
    let shown = |variables: &[(&str, &str)]| run(&["config", "show", "--json"], variables);
    let of = |shown: &Finished, key: &str| {
        assert_eq!(shown.status, Some(0), "{}", shown.stderr);
        let shown: Value = serde_json::from_str(&shown.stdout).unwrap();
        let item = shown["items"].as_array().unwrap().iter().find(|item| item["key"] == key).unwrap().clone();
        (item["value"].as_str().unwrap_or("-").to_string(), item["origin"].as_str().unwrap().to_string())
    };
    for on in ["1", "true", "yes"] {
        assert_eq!(of(&shown(&[("ISOPHOTE_DEMO", on)]), "demo"), ("true".into(), "environment".into()), "{on}");
    }
    for off in ["0", "false", "no"] {
        assert_eq!(of(&shown(&[("ISOPHOTE_DEMO", off)]), "demo"), ("false".into(), "environment".into()), "{off}");
    }
    assert_eq!(shown(&[("ISOPHOTE_DEMO", "perhaps")]).status, Some(2));
    let empty =
        shown(&[("ISOPHOTE_DEMO", ""), ("ISOPHOTE_LISTEN", ""), ("ISOPHOTE_CONFIG", ""), ("ISOPHOTE_DATA", "")]);
    assert_eq!(of(&empty, "demo").1, "default");
    assert_eq!(of(&empty, "listen"), ("127.0.0.1:7240".into(), "default".into()));
    assert_eq!(of(&empty, "data").1, "default");
}

/// A pipe is read to its end; an endless one times out.
#[test]
fn a_configuration_may_be_a_pipe_that_ends() {
    let folder = Folder::new("configuration-pipe");
    let program = program().unwrap();
    let script = format!("'{}' config show --json --config <(echo 'demo = true')", program.display());
    let read = finish(Command::new("bash").args(["-c", &script]), LIMIT).unwrap();
    assert_eq!(read.status, Some(0), "{}", read.stderr);
    assert!(read.stdout.contains("\"file\""), "{}", read.stdout);
    let pipe = folder.0.join("pipe.toml");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let begin = std::time::Instant::now();
    let refused = run(&["serve", "--check", "--config", name(&pipe)], &[]);
    assert_eq!(refused.status, Some(1), "{}", refused.stdout);
    assert!(refused.stderr.contains("pipe.toml: cannot be read: it has no end after"), "{}", refused.stderr);
    assert!(begin.elapsed() < LIMIT / 4, "{:?}", begin.elapsed());
    for endless in [PathBuf::from("/dev/zero"), file(&folder, &"# long\n".repeat(200_000))] {
        let refused = run(&["config", "show", "--config", name(&endless)], &[]);
        assert_eq!(refused.status, Some(1), "{}", refused.stdout);
        assert!(refused.stderr.contains("more than 1048576 bytes"), "{}", refused.stderr);
    }
}
