//! The commands against a running `isophote serve --demo`.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use isophote_tests::rig::until;
use isophote_tests::{Finished, Service, finish, program, repository};
use serde_json::Value;

use crate::client::Folder;

const LIMIT: Duration = Duration::from_secs(60);

struct Demo {
    program: std::path::PathBuf,
    service: Service,
}

impl Demo {
    fn start(folder: &Path) -> Demo {
        Demo::with(&[], folder)
    }
    fn with(options: &[&str], folder: &Path) -> Demo {
        let program = program().unwrap();
        let service = Service::start(&program, &[&["--demo"], options].concat(), folder).unwrap();
        Demo { program, service }
    }
    fn run(&self, arguments: &[&str]) -> Finished {
        let mut command = Command::new(&self.program);
        command.args(arguments).env("ISOPHOTE_SERVER", self.service.url()).current_dir(repository());
        finish(&mut command, LIMIT).unwrap()
    }
    fn ok(&self, arguments: &[&str]) -> String {
        let finished = self.run(arguments);
        assert_eq!(finished.status, Some(0), "{arguments:?}: {}", finished.stderr);
        finished.stdout
    }
    fn json(&self, arguments: &[&str]) -> Value {
        serde_json::from_str(&self.ok(arguments)).unwrap()
    }
    fn fails(&self, arguments: &[&str], status: i32, says: &str) {
        let finished = self.run(arguments);
        assert_eq!(finished.status, Some(status), "{arguments:?}: {}", finished.stderr);
        assert!(finished.stderr.contains(says), "{arguments:?}: {}", finished.stderr);
        assert_eq!(finished.stdout, "", "{arguments:?}");
    }
}

#[test]
fn a_source_is_played_and_shows_another_scene() {
    let folder = Folder::new("commands-source");
    let demo = Demo::start(&folder.0);
    let play = |rest: &[&str]| demo.json(&[&["source", "play", "demo", "--json"], rest].concat());
    let before = play(&["pause"])["next_frame"].as_u64().unwrap();
    assert_eq!(play(&["step", "2"])["paused"], true);
    assert_eq!(play(&["speed", "0.5"])["speed"], 0.5);
    while play(&[])["next_frame"].as_u64().unwrap() < before + 2 {}
    let output = demo.ok(&["source", "play", "demo"]);
    assert_eq!(
        output,
        format!("paused at frame {}, 0.5 times its rate; the next frame is number {}\n", before + 1, before + 2)
    );
    assert!(demo.ok(&["source", "play", "demo", "resume"]).starts_with("playing at frame "));

    let scene = |rest: &[&str]| demo.json(&[&["source", "scene", "demo", "--json"], rest].concat());
    let first = scene(&[]);
    let moving = first["motion"]["bx"].as_str().unwrap();
    let changed = scene(&["--set", "bx=300,v1=99", "--exposure", "0.5", "--read-noise-e", "3"]);
    assert_eq!((&changed["set"]["bx"], &changed["set"]["v1"]), (&Value::from(300.0), &Value::from(99.0)));
    assert_eq!((&changed["exposure"], &changed["read_noise_e"]), (&Value::from(0.5), &Value::from(3.0)));
    assert!(changed["motion"].get("bx").is_none() && changed["motion"]["by"] == first["motion"]["by"], "{changed}");
    assert!(changed["since_frame"].as_u64() > Some(before), "{changed}");
    let output = demo.ok(&["source", "scene", "demo", "--motion", &format!("bx={moving}")]);
    assert!(output.contains(moving) && output.contains("exposure") && output.starts_with("since frame "), "{output}");
    assert_eq!(scene(&[])["motion"], first["motion"]);

    demo.fails(&["source", "play", "demo", "seek", "3"], 6, "synthetic");
    demo.fails(&["source", "play", "demo", "speed"], 2, "is missing");
    demo.fails(&["source", "play", "demo", "step", "half"], 2, "`half` is not a whole number");
    demo.fails(&["source", "play", "demo", "pause", "1"], 2, "take no value");
    demo.fails(&["source", "play", "demo", "rewind"], 2, "rewind");
    demo.fails(&["source", "scene", "absent"], 5, "absent");
    demo.fails(&["source", "scene", "demo", "--set", "nothing=1"], 6, "nothing");
}

#[test]
fn commands_work_end_to_end() {
    let folder = Folder::new("commands");
    let demo = Demo::start(&folder.0);
    let lines = demo.ok(&["watch", "demo", "--count", "5", "--json"]);
    let estimates: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(estimates.len(), 5);
    assert_eq!(estimates[4]["session"], "demo");
    assert_eq!(demo.ok(&["watch", "demo", "--count", "2"]).lines().count(), 2);

    assert!(demo.ok(&["model", "list"]).contains("thesis-spot"));
    let pushed = demo.json(&["model", "push", "models/gaussian.toml", "--name", "mine", "--json"]);
    assert_eq!((&pushed["name"], &pushed["version"]), (&Value::from("mine"), &Value::from(1)));
    assert_eq!(demo.json(&["model", "show", "mine", "--json"])["name"], "gaussian");
    let text = std::fs::read_to_string(repository().join("models/gaussian.toml")).unwrap();
    assert_eq!(demo.ok(&["model", "show", "mine"]).trim_end(), text.trim_end());

    let started = demo.json(&["session", "start", "two", "--model", "mine", "--source", "demo", "--json"]);
    assert_eq!(started["active_model"], "mine");
    let swapped = demo.json(&["session", "swap", "two", "spot", "--json"]);
    assert_eq!(swapped["active_model"], "spot");
    demo.ok(&["model", "remove", "mine"]);
    assert!(demo.ok(&["session", "list"]).contains("two"));
    assert_eq!(demo.json(&["session", "show", "two", "--json"])["source"], "demo");
    demo.ok(&["session", "stop", "two"]);
    let source = "synthetic:spot?width=64&height=48&samples=1&pace=fit";
    demo.ok(&["session", "start", "three", "--model", "spot", "--source", source, "--start", "a1=0.01"]);
    assert_eq!(demo.ok(&["watch", "three", "--all", "--count", "3"]).lines().count(), 3);

    let [camera, target] = ["camera.yaml", "target.json"].map(|name| folder.0.join(name).display().to_string());
    let calibrated = "image_width: 640\nimage_height: 480\ncamera_matrix: {rows: 3, cols: 3, data: [600, 0, 320, 0, 600, 240, 0, 0, 1]}\n\
                      distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n";
    std::fs::write(&camera, calibrated).unwrap();
    std::fs::write(&target, r#"{"spots": [{"name": "spot", "position_mm": [0, 0, 0], "radius_mm": 30}]}"#).unwrap();
    let posed = ["session", "start", "posed", "--model", "spot", "--source", "pushed:640x480"];
    demo.ok(&[&posed[..], &["--camera", &camera, "--target", &target]].concat());
    let shown = demo.json(&["session", "show", "posed", "--json"]);
    assert_eq!(
        (&shown["camera"]["intrinsics"]["fx"], &shown["target"]["spots"][0]["radius_mm"]),
        (&600.0.into(), &30.0.into())
    );

    demo.fails(&["watch", "nobody"], 5, "nobody");
    demo.fails(&["session", "swap", "demo", "nobody"], 5, "nobody");
    demo.fails(&["session", "start", "x", "--model", "spot", "--source", "synthetic:spot?colour=red"], 6, "colour");
    demo.fails(&["session", "start", "x"], 2, "--model");
    demo.fails(&["model", "list", "--server", "ftp://example.org"], 2, "address");
    demo.fails(&["model", "list", "--server", "http://127.0.0.1:1"], 4, "isophote serve");
    std::fs::write(folder.0.join("wrong.toml"), "name = \"wrong\"\ncolour = 1\n").unwrap();
    let wrong = folder.0.join("wrong.toml");
    demo.fails(&["model", "push", "--name", "wrong", wrong.to_str().unwrap()], 3, "colour");
    demo.fails(&["serve", "--listen", "0.0.0.0:0"], 2, "loopback");
    demo.fails(&["serve", "--listen", demo.service.address()], 1, "cannot listen");
}

#[test]
fn versions_and_plain_files() {
    let folder = Folder::new("plain-files");
    let demo = Demo::start(&folder.0);
    demo.ok(&["model", "push", "models/gaussian.toml", "--name", "mine"]);
    demo.ok(&["model", "push", "models/ring.toml", "--name", "mine"]);
    let history = demo.json(&["model", "history", "mine", "--json"]);
    let versions = |list: &Value| -> Vec<(u64, bool)> {
        let one = |item: &Value| (item["version"].as_u64().unwrap(), item["active"].as_bool().unwrap());
        list["items"].as_array().unwrap().iter().map(one).collect()
    };
    assert_eq!(versions(&history), [(2, true), (1, false)]);
    assert!(demo.ok(&["model", "rollback", "mine", "1"]).starts_with("mine version 1 sha256:"));
    assert_eq!(versions(&demo.json(&["model", "history", "mine", "--json"])), [(2, false), (1, true)]);
    assert_eq!(demo.ok(&["model", "history", "mine"]).matches("active").count(), 1);
    assert_eq!(demo.json(&["model", "rollback", "mine", "2", "--json"])["version"], 2);
    demo.fails(&["model", "rollback", "mine", "7"], 5, "version");
    demo.fails(&["model", "rollback", "mine"], 2, "VERSION");
    demo.fails(&["model", "history", "nobody"], 5, "nobody");

    let (out, shown) = (folder.0.join("out"), folder.0.join("out").display().to_string());
    let level = folder.0.join("level.json");
    std::fs::write(
        &level,
        r#"{"name": "level", "coordinates": ["x", "y"], "channels": ["phi"], "parameters": {"v0": {"start": 1}}, "model": {"intensity": "v0"}}"#,
    )
    .unwrap();
    let pushed = demo.json(&["model", "push", level.to_str().unwrap(), "--json"]);
    let counted = demo.json(&["data", "export", &shown, "--json"]);
    assert_eq!((&counted["models"], &counted["sessions"]), (&Value::from(28), &Value::from(1)), "{counted}");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    assert_eq!(read("models/mine.toml"), std::fs::read_to_string(repository().join("models/ring.toml")).unwrap());
    let session: Value = serde_json::from_str(&read("sessions/demo.json")).unwrap();
    let source: Value = serde_json::from_str(&read("sources/demo.json")).unwrap();
    assert_eq!((&session["source"], &source["kind"]), (&Value::from("demo"), &Value::from("synthetic")));
    assert!(session.get("state").is_none() && source.get("frames").is_none(), "{session} {source}");
    demo.fails(&["data", "export", &shown], 1, "nothing is overwritten");

    let models = out.join("models").display().to_string();
    let again = Service::start(&demo.program, &["--models", &models], &folder.0).unwrap();
    let again = Demo { program: demo.program.clone(), service: again };
    assert_eq!(again.json(&["model", "show", "level", "--json"])["digest"], pushed["digest"]);
    assert_eq!(again.ok(&["model", "show", "mine"]).trim_end(), read("models/mine.toml").trim_end());
    assert_eq!(again.json(&["model", "show", "spot", "--json"])["version"], 1, "as it is there already");
}

#[test]
fn a_shadow_is_begun_compared_promoted_and_dropped() {
    let folder = Folder::new("commands-shadow");
    let demo = Demo::start(&folder.0);
    fn shadow<'a>(rest: &[&'a str]) -> Vec<&'a str> {
        [&["session", "shadow", "demo"], rest].concat()
    }
    demo.fails(&shadow(&[]), 5, "isophote session shadow demo MODEL");
    demo.fails(&shadow(&["--drop"]), 5, "shadow");
    demo.fails(&shadow(&["nobody"]), 5, "nobody");
    demo.fails(&shadow(&["gaussian", "--drop"]), 2, "--drop");
    demo.fails(&shadow(&["--constant", "gain=1"]), 2, "MODEL");
    let begun = demo.json(&shadow(&["gaussian", "--json"]));
    assert_eq!(begun["model"], "gaussian", "{begun}");
    assert!(begun["carried"].as_array().unwrap().contains(&"bx".into()), "{begun}");
    let has_seen = |view: &Value| view["last"]["parameters"]["bx"]["difference"].is_number();
    until("a frame that both have fitted", LIMIT, || Some(demo.json(&shadow(&["--json"]))).filter(has_seen)).unwrap();
    let output = demo.ok(&shadow(&[]));
    for word in ["gaussian", "spot", "tracking", "px apart in frame", "PARAMETER", "bx"] {
        assert!(output.contains(word), "{word}: {output}");
    }
    assert_eq!(demo.json(&shadow(&["--drop", "--json"]))["dropped"], "demo");
    assert_eq!(
        demo.ok(&shadow(&["gaussian"])),
        "gaussian beside demo; carried bx, by, a1, a2, a3, v0, v1; reset nothing\n"
    );
    let taken = demo.json(&shadow(&["--promote", "--json"]));
    assert_eq!((&taken["active_model"], &taken["reset"]), (&"gaussian".into(), &serde_json::json!([])), "{taken}");
    assert_eq!(demo.json(&["session", "show", "demo", "--json"])["active_model"], "gaussian");
    demo.fails(&shadow(&["--promote"]), 5, "shadow");
}

#[test]
fn a_source_is_put_listed_shown_and_removed() {
    let folder = Folder::new("commands-put");
    let demo = Demo::start(&folder.0);
    let file = folder.0.join("eye.json");
    std::fs::write(&file, r#"{"kind": "pushed", "width": 64, "height": 48, "format": "u16le"}"#).unwrap();
    let file = file.to_str().unwrap();
    let put = demo.json(&["source", "put", "eye", file, "--json"]);
    assert_eq!(
        (&put["name"], &put["kind"], &put["format"]),
        (&"eye".into(), &"pushed".into(), &"u16le".into()),
        "{put}"
    );
    assert_eq!(demo.ok(&["source", "put", "eye", &format!("@{file}")]), "eye idle\n");
    assert_eq!(demo.ok(&["source", "put", "two", "synthetic:spot?width=64&height=48&samples=1"]), "two idle\n");
    let listed = demo.json(&["source", "list", "--json"]);
    let names: Vec<&Value> = listed["items"].as_array().unwrap().iter().map(|item| &item["name"]).collect();
    assert_eq!(names, ["demo", "eye", "two"]);
    let table = demo.ok(&["source", "list"]);
    assert!(
        table.starts_with("NAME") && table.lines().any(|line| line.starts_with("two   synthetic  idle")),
        "{table}"
    );
    assert_eq!(demo.json(&["source", "show", "two"])["width"], 64);
    assert_eq!(demo.ok(&["source", "show", "two", "--json"]).lines().count(), 1);
    assert_eq!(demo.json(&["source", "remove", "two", "--json"])["removed"], "two");
    assert_eq!(demo.ok(&["source", "remove", "eye"]), "");
    demo.fails(&["source", "show", "two"], 5, "two");
    demo.fails(&["source", "remove", "two"], 5, "two");
    demo.fails(&["source", "remove", "demo"], 6, "demo");
    demo.fails(&["source", "put", "three", "spot"], 2, "`spot` is no source");
    demo.fails(&["source", "put", "three", "absent.json"], 2, "cannot be read");
    demo.fails(&["source", "put", "three", "synthetic:nobody"], 5, "nobody");
    demo.fails(&["source", "put", "three", "pushed:64x48?format=u7"], 6, "u7");
}

#[test]
fn a_recording_is_listed_downloaded_and_removed() {
    let folder = Folder::new("commands-recording");
    let data = folder.0.join("data");
    let demo = Demo::with(&["--data", data.to_str().unwrap()], &folder.0);
    let (whole, got) = (folder.0.join("whole.mcap"), folder.0.join("got.mcap"));
    let [whole, got] = [&whole, &got].map(|path| path.to_str().unwrap());
    assert_eq!(demo.json(&["recording", "list", "--json"])["items"], serde_json::json!([]));
    demo.ok(&["record", "demo", "--out", whole, "--count", "3", "--keep"]);
    let listed = demo.json(&["recording", "list", "--json"]);
    let (name, bytes) = (listed["items"][0]["file"].as_str().unwrap(), &listed["items"][0]["bytes"]);
    assert!(demo.ok(&["recording", "list"]).contains(&format!("\n{name}  {bytes}\n")));
    std::fs::write(got, "an older file").unwrap();
    demo.fails(&["recording", "get", "absent.mcap", "--out", got], 5, "recording");
    assert_eq!(std::fs::read_to_string(got).unwrap(), "an older file");
    let downloaded = demo.json(&["recording", "get", name, "--out", got, "--json"]);
    assert_eq!((&downloaded["bytes"], &downloaded["file"]), (bytes, &got.into()), "{downloaded}");
    assert_eq!(std::fs::read(got).unwrap(), std::fs::read(whole).unwrap());
    let here = folder.0.join("here");
    std::fs::create_dir(&here).unwrap();
    let mut command = Command::new(&demo.program);
    command.args(["recording", "get", name]).env("ISOPHOTE_SERVER", demo.service.url()).current_dir(&here);
    assert_eq!(finish(&mut command, LIMIT).unwrap().stdout, format!("{name}: {bytes} bytes\n"));
    assert_eq!(std::fs::read(here.join(name)).unwrap(), std::fs::read(whole).unwrap());
    demo.fails(&["recording", "get", name, "--out", folder.0.to_str().unwrap()], 2, "cannot be written");
    assert_eq!(demo.json(&["recording", "remove", name, "--json"])["removed"], name);
    demo.fails(&["recording", "remove", name], 5, "recording");
    let others = std::fs::read_dir(&folder.0)
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().contains(".part"));
    assert_eq!(others.count(), 0, "what did not arrive is not left behind");
}

#[test]
fn exit_statuses_distinguish_failures() {
    let folder = Folder::new("commands-status");
    let demo = Demo::start(&folder.0);
    let wrong = folder.0.join("wrong.toml");
    let text = std::fs::read_to_string(repository().join("models/gaussian.toml")).unwrap();
    std::fs::write(&wrong, text.replace("v0 + v1", "v0 + v2")).unwrap();
    let wrong = wrong.to_str().unwrap();
    // A wrong model, detected by the client and by the service; the name is validated apart.
    demo.fails(&["model", "push", wrong], 3, "v2");
    demo.fails(&["model", "push", wrong, "--name", "mine"], 3, "wrong.toml:");
    demo.fails(&["model", "push", "models/gaussian.toml", "--name", "Mine"], 6, "a name is made of");
    for server in ["http://127.0.0.1:1", "http://nobody.invalid"] {
        demo.fails(&["model", "list", "--server", server], 4, "is `isophote serve` running there");
        demo.fails(&["watch", "demo", "--server", server], 4, "is `isophote serve` running there");
    }
    demo.fails(&["session", "show", "nobody"], 5, "(404)\nsee ");
    demo.fails(&["session", "stop", "nobody"], 5, "nobody");
    demo.fails(&["model", "remove", "nobody"], 5, "nobody");
    demo.fails(&["session", "start", "x", "--model", "nobody", "--source", "demo"], 5, "nobody");
    demo.fails(&["model", "remove", "spot"], 6, "(409)");
    demo.fails(&["model", "push", "models/gaussian.toml", "--if-match", "none"], 6, "(412)");
    demo.fails(&["session", "start", "x", "--model", "spot", "--source", "demo", "--start", "nothing=1"], 6, "nothing");
    demo.fails(&["recording", "get", "a.mcap", "--out", "/dev/null"], 6, "--recordings DIR");
    // Up to the limit of sources.
    let put = |number: usize| demo.run(&["source", "put", &format!("s{number}"), "pushed:8x8"]);
    let refused = (0..=64).map(put).find(|finished| finished.status != Some(0)).unwrap();
    assert_eq!(refused.status, Some(6), "{}", refused.stderr);
    assert!(refused.stderr.contains("(429)"), "{}", refused.stderr);
    demo.fails(&["model", "check", "absent.toml"], 1, "cannot be read");
}

#[test]
fn sigterm_ends_the_service() {
    let folder = Folder::new("ends-when-asked");
    let mut demo = Demo::start(&folder.0);
    demo.ok(&["watch", "demo", "--count", "1"]);
    let process = demo.service.child().id().to_string();
    let kill = finish(Command::new("kill").args(["-TERM", &process]), LIMIT).unwrap();
    assert_eq!(kill.status, Some(0));
    assert_eq!(demo.service.child().wait().unwrap().code(), Some(0));
}

#[test]
fn sessions_leave_no_threads_behind() {
    let folder = Folder::new("threads");
    let mut demo = Demo::start(&folder.0);
    let tasks = format!("/proc/{}/task", demo.service.child().id());
    let threads = || -> Vec<String> {
        let name =
            |task: std::io::Result<std::fs::DirEntry>| std::fs::read_to_string(task.unwrap().path().join("comm"));
        // A thread that ends meanwhile has no name.
        std::fs::read_dir(&tasks).unwrap().filter_map(|task| name(task).ok()).collect()
    };
    let source = "synthetic:spot?width=64&height=48&samples=1&pace=fit";
    let round = || {
        for name in ["a", "b", "a"] {
            demo.ok(&["session", "start", name, "--model", "spot", "--source", source]);
        }
        demo.ok(&["session", "stop", "a"]);
        demo.ok(&["session", "stop", "b"]);
    };
    round();
    // Compilations for a session end after it, with the current kernel; so does the thread that watched its end.
    let settled = || {
        let is_ending = |name: &String| name.starts_with("prepare") || name.starts_with("end ");
        let only_lasting = || Some(threads()).filter(|names| !names.iter().any(is_ending));
        until("threads that end", LIMIT, only_lasting).unwrap_or_else(|_| threads())
    };
    let before = settled().len();
    (0..5).for_each(|_| round());
    let after = settled();
    assert!(after.len() <= before, "{before} threads became {}: {after:?}", after.len());
}
