//! Downloads of recordings: whole, by range, and with their CSV file.

use std::path::Path;

use isophote_server::Options;
use serde_json::{Value, json};

use crate::client::{DEADLINE, Folder, Running, session};
use crate::recorder::fits;

struct Download {
    status: u16,
    headers: ureq::http::HeaderMap,
    bytes: Vec<u8>,
}

impl Download {
    fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }
}

fn download(service: &Running, method: &str, file: &str, headers: &[(&str, &str)]) -> Download {
    let config = ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(DEADLINE));
    let agent: ureq::Agent = config.build().into();
    let mut request =
        ureq::http::Request::builder().method(method).uri(format!("{}/v1/recordings/{file}", service.url));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let mut answer = agent.run(request.body(()).unwrap()).unwrap();
    let bytes = answer.body_mut().read_to_vec().unwrap();
    Download { status: answer.status().as_u16(), headers: answer.headers().clone(), bytes }
}

/// Starts recording a session with a CSV file, and waits for some fits.
fn begin(service: &Running, name: &str) {
    service.put("/v1/sessions/one", &session("fit", 50.0)).expect(201);
    service.put("/v1/sessions/one/recording", &json!({"name": name, "csv": true})).expect(201);
    service.recording("one", |view| fits(view) > 5);
}

fn end(service: &Running) {
    service.delete("/v1/sessions/one/recording").expect(204);
    service.delete("/v1/sessions/one").expect(204);
}

#[test]
fn a_recording_is_downloaded_in_parts() {
    let folder = Folder::new("downloads-parts");
    let service = Running::start_with(Some(&folder.0), false);
    begin(&service, "night");
    for file in ["night-0001.mcap", "night-0001.csv"] {
        let problem = service.get(&format!("/v1/recordings/{file}")).expect(404);
        assert!(problem["detail"].as_str().unwrap().contains("being written"), "{file}: {problem}");
        service.delete(&format!("/v1/recordings/{file}")).expect(409);
    }
    end(&service);
    let file = "night-0001.mcap";
    let whole = download(&service, "GET", file, &[]);
    let length = whole.bytes.len();
    assert_eq!((whole.status, whole.header("accept-ranges")), (200, "bytes"));
    assert_eq!(whole.bytes, std::fs::read(folder.0.join("recordings").join(file)).unwrap());
    let tag = whole.header("etag");
    assert!(tag.starts_with('"'), "{tag}");
    let part = |range: &str, more: &[(&str, &str)]| {
        let headers = [&[("range", range)], more].concat();
        let part = download(&service, "GET", file, &headers);
        (part.status, part.header("content-range").to_string(), part.bytes)
    };
    let of =
        |first: usize, last: usize| (206, format!("bytes {first}-{last}/{length}"), whole.bytes[first..=last].to_vec());
    assert_eq!(part("bytes=0-0", &[]), of(0, 0));
    assert_eq!(part("bytes=100-299", &[]), of(100, 299));
    assert_eq!(part("bytes=7-", &[]), of(7, length - 1));
    assert_eq!(part("bytes=-9", &[]), of(length - 9, length - 1));
    assert_eq!(part(&format!("bytes=3-{}", 10 * length), &[]), of(3, length - 1));
    assert_eq!(part(&format!("bytes=-{}", 10 * length), &[]), of(0, length - 1));
    // Resumed only if the file is unchanged.
    assert_eq!(part("bytes=7-", &[("if-range", tag)]), of(7, length - 1));
    assert_eq!(part("bytes=7-", &[("if-range", "\"other\"")]).0, 200);
    assert_eq!(part("bytes=0-3", &[("if-match", "\"other\"")]).0, 412);
    assert_eq!(part("bytes=0-3", &[("if-none-match", tag)]).0, 304);
    assert_eq!(part("bytes=0-3,7-9", &[]).2.len(), length, "several parts are the whole");
    for outside in [format!("bytes={length}-"), "bytes=5-2".into(), "bytes=-0".into(), "bytes=x".into()] {
        let (status, range, bytes) = part(&outside, &[]);
        assert_eq!((status, range), (416, format!("bytes */{length}")), "{outside}");
        let problem: Value = serde_json::from_slice(&bytes).unwrap();
        assert_eq!(problem["code"], "no-such-range", "{problem}");
    }
    let head = download(&service, "HEAD", file, &[("range", "bytes=0-3")]);
    let head_fields = (head.status, head.header("content-length").to_string(), head.header("etag"));
    assert_eq!(head_fields, (200, length.to_string(), tag), "{:?}", head.headers);
    service.stop();
}

#[test]
fn the_csv_file_beside_a_recording_is_listed_sent_and_deleted() {
    let folder = Folder::new("downloads-csv");
    let service = Running::start_with(Some(&folder.0), false);
    begin(&service, "night");
    end(&service);
    let list = || service.get("/v1/recordings").expect(200)["items"].clone();
    let items = list();
    assert_eq!(items.as_array().unwrap().len(), 1, "{items}");
    assert_eq!(items[0]["file"], "night-0001.mcap");
    let file = items[0]["csv"]["file"].as_str().unwrap();
    assert_eq!(file, "night-0001.csv");
    let whole = download(&service, "GET", file, &[]);
    assert_eq!((whole.status, whole.header("content-type")), (200, "text/csv; charset=utf-8"));
    assert_eq!(items[0]["csv"]["bytes"], whole.bytes.len());
    let text = String::from_utf8(whole.bytes).unwrap();
    assert!(text.starts_with("unix_ns,frame,target,state,") && text.lines().count() > 5, "{text}");
    let part = download(&service, "GET", file, &[("range", "bytes=8-12")]);
    assert_eq!((part.status, part.bytes.as_slice()), (206, &b"frame"[..]));
    for wrong in ["night-0002.csv", "..csv", "night-0001.csv.csv", "NIGHT.csv", "night-0001.txt", ".csv"] {
        service.get(&format!("/v1/recordings/{wrong}")).expect(404);
        service.delete(&format!("/v1/recordings/{wrong}")).expect(404);
    }
    let stale = service.request("DELETE", "/v1/recordings/night-0001.mcap", &[("if-match", "\"other\"")], b"");
    stale.expect(412);
    service.delete("/v1/recordings/night-0001.mcap").expect(204);
    assert_eq!(list(), json!([]));
    service.get("/v1/recordings/night-0001.csv").expect(404);
    assert!(!folder.0.join("recordings/night-0001.csv").exists());
    // The CSV file can be deleted alone.
    begin(&service, "day");
    end(&service);
    service.delete("/v1/recordings/day-0001.csv").expect(204);
    service.delete("/v1/recordings/day-0001.csv").expect(404);
    let items = list();
    assert_eq!((&items[0]["file"], &items[0]["csv"]), (&json!("day-0001.mcap"), &Value::Null), "{items}");
    service.stop();
}

/// A symbolic link in place of a file is not followed.
#[test]
fn links_in_the_place_of_recordings_are_not_followed() {
    let folder = Folder::new("downloads-links");
    let service = Running::start_with(Some(&folder.0), false);
    let recordings = folder.0.join("recordings");
    std::fs::create_dir_all(&recordings).unwrap();
    std::fs::write(recordings.join("a.mcap"), "bytes").unwrap();
    std::os::unix::fs::symlink("/etc/hostname", recordings.join("a.csv")).unwrap();
    std::fs::create_dir_all(recordings.join("b.csv")).unwrap();
    assert_eq!(service.get("/v1/recordings").expect(200)["items"], json!([{"file": "a.mcap", "bytes": 5}]));
    for file in ["a.csv", "b.csv"] {
        service.get(&format!("/v1/recordings/{file}")).expect(404);
    }
    service.stop();
}

#[test]
fn repeated_puts_return_the_running_recording() {
    let folder = Folder::new("downloads-repeated");
    let service = Running::start_with(Some(&folder.0), false);
    service.put("/v1/sessions/one", &session("fit", 50.0)).expect(201);
    let at = "/v1/sessions/one/recording";
    for document in [json!({"name": "night", "frames": "none"}), json!({})] {
        let first = service.put(at, &document).expect(201);
        service.recording("one", |view| fits(view) > 3);
        let again = service.put(at, &document).expect(200);
        assert_eq!((&again["files"], &again["started_at"]), (&first["files"], &first["started_at"]));
        assert!(fits(&again) > 3, "{again}");
        // Spelled-out defaults are the same document.
        let mut spelled = document.clone();
        spelled["disk_budget_mb"] = json!(4000);
        service.put(at, &spelled).expect(200);
        for (key, value) in [("name", json!("other")), ("csv", json!(true)), ("frames", json!("jpeg"))] {
            let mut other = document.clone();
            other[key] = value;
            assert_eq!(service.put(at, &other).expect(409)["code"], "in-use", "{other}");
        }
        assert_eq!(service.put(at, &json!({"rotate_s": 0})).status, 422);
        service.delete(at).expect(204);
    }
    // Concurrent requests start a single recording.
    let statuses = std::thread::scope(|scope| {
        let one = |_| scope.spawn(|| service.put(at, &json!({"name": "crowd"})).status);
        let threads: Vec<_> = (0..4).map(one).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<u16>>()
    });
    let count = |status| statuses.iter().filter(|one| **one == status).count();
    assert_eq!((count(201), count(200)), (1, 3), "{statuses:?}");
    service.stop();
}

fn replayed(service: &Running, file: &str, kept: &str) {
    let source = json!({"kind": "recording", "path": file, "rate_hz": 100, "pace": "fit"});
    let view = service.put("/v1/sessions/replay", &json!({"source": source, "model": "spot"}));
    assert!([200, 201].contains(&view.status), "{file}: {}", view.text);
    let view = service.wait_for("replay", |view| view["frames"].as_u64() > Some(3));
    assert_eq!(view["source"]["path"], kept, "{view}");
}

fn with_recordings(data: &Path, recordings: &Path) -> Options {
    let mut options = Running::options();
    options.data = Some(data.into());
    options.access.recordings = Some(recordings.into());
    options
}

/// A recording is replayed by its listed name, wherever the folder of recordings is.
#[test]
fn a_recording_is_replayed_by_its_listed_name() {
    let folder = Folder::new("downloads-replay");
    let service = Running::start_with(Some(&folder.0.join("data")), false);
    begin(&service, "night");
    end(&service);
    let file = service.get("/v1/recordings").expect(200)["items"][0]["file"].as_str().unwrap().to_string();
    replayed(&service, &file, &file);
    // And again after a restart.
    service.stop();
    let service = Running::start_with(Some(&folder.0.join("data")), false);
    let view = service.wait_for("replay", |view| view["frames"].as_u64() > Some(3));
    assert_eq!(view["source"]["path"], file.as_str());
    service.stop();

    let root = folder.0.join("root");
    std::fs::create_dir_all(&root).unwrap();
    let service = Running::with(&with_recordings(&folder.0.join("other"), &root));
    begin(&service, "day");
    end(&service);
    replayed(&service, "day-0001.mcap", "day-0001.mcap");
    replayed(&service, "recorded/day-0001.mcap", "recorded/day-0001.mcap");
    service.stop();
}
