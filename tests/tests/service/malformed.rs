//! Each malformed document over HTTP yields a diagnostic at its key, and the service stays up.

use crate::client::Running;

#[test]
fn each_malformed_document_is_a_diagnostic() {
    let service = Running::start();
    let before = service.get("/v1/models").expect(200);
    let mut files = Vec::new();
    isophote_tests::files_below(&isophote_tests::repository().join("tests/malformed"), &mut files).unwrap();
    let mut documents = 0;
    for file in &files {
        let media = match file.extension().and_then(|extension| extension.to_str()) {
            Some("toml") => "application/toml",
            Some("json") => "application/json",
            _ => continue,
        };
        documents += 1;
        let text = std::fs::read_to_string(file).unwrap();
        let (code, key) = expected(&text).unwrap_or_else(|| panic!("{}: what is expected?", file.display()));
        let head = text.lines().next().map_or(0, str::len);
        // JSON has no comments: the line of expectations is blanked
        let bytes =
            if media == "application/json" { " ".repeat(head) + &text[head..] } else { text.clone() }.into_bytes();
        let answer = service.request("PUT", "/v1/models/wrong", &[("content-type", media)], &bytes);
        assert_eq!(answer.status, 422, "{}: {}", file.display(), answer.text);
        let problem = answer.expect(422);
        let diagnostics = problem["diagnostics"].as_array().unwrap();
        assert!(!diagnostics.is_empty(), "{}", file.display());
        for diagnostic in diagnostics {
            let place = (diagnostic["line"].as_u64().unwrap(), diagnostic["column"].as_u64().unwrap());
            assert!(place.0 >= 1 && place.1 >= 1, "{}: {diagnostic}", file.display());
            assert!(diagnostic["key"].is_string() && diagnostic["span"].is_array(), "{}: {diagnostic}", file.display());
            for text in ["code", "message", "severity"] {
                assert!(!diagnostic[text].as_str().unwrap().is_empty(), "{}: {diagnostic}", file.display());
            }
        }
        let found: Vec<(&str, &str)> =
            diagnostics.iter().map(|d| (d["code"].as_str().unwrap(), d["key"].as_str().unwrap())).collect();
        let is_expected = |(found_code, found_key): &(&str, &str)| {
            let is_key = key.strip_suffix('*').map_or(*found_key == key, |head| found_key.starts_with(head));
            is_key && (code == "*" || *found_code == code)
        };
        assert!(found.iter().any(is_expected), "{}: expected {code} at {key}, found {found:?}", file.display());
    }
    assert!(documents >= 100, "{documents} documents");
    service.get("/livez").expect(200);
    assert_eq!(service.get("/v1/models").expect(200), before, "nothing was kept");
}

/// Parses `# code: arguments key: model.intensity` at the top of a document (`//` in JSON); `*` matches any rest of a
/// key.
fn expected(text: &str) -> Option<(&str, &str)> {
    let line = text.lines().next()?.trim_start_matches(['#', '/', ' ', '\u{feff}']).strip_prefix("code: ")?;
    let (code, key) = line.split_once(" key:")?;
    Some((code.trim(), key.trim()))
}
