//! The systemd unit and the container file match the program's options.

use std::process::Command;
use std::time::Duration;

use isophote_tests::{finish, program, repository};
use serde_json::Value;

use crate::client::Folder;

const LIMIT: Duration = Duration::from_secs(120);
/// Maximum exposure by `systemd-analyze security`, in tenths: 0 is best, 100 worst.
const EXPOSURE_MAX: &str = "20";

fn text(name: &str) -> String {
    std::fs::read_to_string(repository().join("server/deploy").join(name)).unwrap()
}

/// The values of a unit's key.
fn values<'a>(unit: &'a str, key: &str) -> Vec<&'a str> {
    unit.lines().filter_map(|line| line.strip_prefix(key)?.strip_prefix('=')).collect()
}

/// `config show` with the flags of that command and those variables.
fn shown(arguments: &[&str], variables: &[(String, String)]) -> Value {
    let mut command = Command::new(program().unwrap());
    command.args(["config", "show", "--json"]).args(arguments).envs(variables.iter().cloned());
    let finished = finish(&mut command, LIMIT).unwrap();
    assert_eq!(finished.status, Some(0), "{arguments:?}: {}", finished.stderr);
    serde_json::from_str(&finished.stdout).unwrap()
}

fn origin<'a>(shown: &'a Value, key: &str) -> &'a Value {
    &shown["items"].as_array().unwrap().iter().find(|item| item["key"] == key).unwrap()["origin"]
}

#[test]
fn unit_commands_are_valid() {
    let folder = Folder::new("unit");
    let configuration = folder.0.join("isophote.toml");
    std::fs::write(&configuration, "").unwrap();
    let unit = text("isophote.service");
    let commands = [values(&unit, "ExecStartPre"), values(&unit, "ExecStart")].concat();
    assert_eq!(commands.len(), 2, "{unit}");
    for command in commands {
        let flags = command.strip_prefix("/usr/local/bin/isophote serve ").unwrap();
        let flags = flags.replace("/etc/isophote.toml", configuration.to_str().unwrap());
        let shown = shown(&flags.split(' ').collect::<Vec<_>>(), &[]);
        assert_eq!(origin(&shown, "data"), "flag", "{command}");
    }
    // It would forbid the JIT.
    assert!(values(&unit, "MemoryDenyWriteExecute").is_empty());
}

#[test]
fn systemd_accepts_the_unit() {
    let is_here = Command::new("systemd-analyze").arg("--version").output().is_ok_and(|output| output.status.success());
    if !is_here {
        eprintln!("skipped: systemd-analyze is not installed");
        return;
    }
    let folder = Folder::new("unit-verified");
    let path = folder.0.join("isophote.service");
    let program = program().unwrap();
    std::fs::write(&path, text("isophote.service").replace("/usr/local/bin/isophote", program.to_str().unwrap()))
        .unwrap();
    for arguments in
        [&["verify", "--man=no"][..], &["security", "--offline=true", "--no-pager", "--threshold", EXPOSURE_MAX]]
    {
        let mut command = Command::new("systemd-analyze");
        let finished = finish(command.args(arguments).arg(&path), LIMIT).unwrap();
        assert_eq!(finished.status, Some(0), "{arguments:?}: {}{}", finished.stderr, finished.stdout);
        let complaints: Vec<&str> = finished.stderr.lines().filter(|line| line.contains("isophote.service")).collect();
        assert!(complaints.is_empty(), "{complaints:?}");
    }
}

#[test]
fn container_settings_are_known_to_the_program() {
    let file = text("Containerfile");
    let line = file.lines().find_map(|line| line.strip_prefix("ENV ")).unwrap();
    let pairs = line.split(' ').map(|pair| pair.split_once('=').unwrap());
    let variables: Vec<(String, String)> = pairs.map(|(name, value)| (name.into(), value.into())).collect();
    let shown = shown(&[], &variables);
    for (name, _) in &variables {
        let key = name.strip_prefix("ISOPHOTE_").unwrap().to_lowercase();
        assert_eq!(origin(&shown, &key), "environment", "{name}");
    }
    // Its user owns only the data folder, which is a volume.
    let of = |word: &str| file.lines().filter_map(|line| line.strip_prefix(word)).next_back().unwrap().trim();
    assert_eq!(
        shown["items"].as_array().unwrap().iter().find(|item| item["key"] == "data").unwrap()["value"],
        of("VOLUME")
    );
    assert!(file.contains(&format!("RUN useradd --system --uid 990 --groups video --home-dir {} ", of("VOLUME"))));
    assert_eq!(of("USER"), "isophote");
    assert!(of("COPY --from=program /isophote ") == "/usr/local/bin/isophote");
    assert!(file.contains("\nENTRYPOINT [\"/usr/local/bin/isophote\"]\n") && file.ends_with("CMD [\"serve\"]\n"));
}
