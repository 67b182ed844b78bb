//! Wrong documents over HTTP: each is answered with a diagnostic at its place, and the service stays.

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
        let bytes = std::fs::read(file).unwrap();
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
        let text = String::from_utf8_lossy(&bytes);
        if let Some(expected) = expected(&text) {
            let found: Vec<(&str, &str)> =
                diagnostics.iter().map(|d| (d["code"].as_str().unwrap(), d["key"].as_str().unwrap())).collect();
            assert!(found.contains(&expected), "{}: expected {expected:?}, found {found:?}", file.display());
        }
    }
    assert!(documents >= 100, "{documents} documents");
    service.get("/livez").expect(200);
    assert_eq!(service.get("/v1/models").expect(200), before, "nothing was kept");
}

/// `# code: arguments key: model.intensity` at the top of a document.
fn expected(text: &str) -> Option<(&str, &str)> {
    let line = text.lines().next()?.strip_prefix("# code: ")?;
    let (code, key) = line.split_once(" key:")?;
    Some((code.trim(), key.trim()))
}
