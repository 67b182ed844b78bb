//! The book at `/docs`: every page and asset is served with its type, ETag and policy.

use std::collections::BTreeSet;
use std::io::Read;

use crate::client::Running;

/// Targets within the book of a page's links, pictures, scripts and styles, without fragments.
fn targets(page: &str, text: &str) -> BTreeSet<String> {
    let folder = page.rsplit_once('/').map_or("", |(folder, _)| folder);
    let values = ["href=\"", "src=\""].into_iter().flat_map(|head| text.split(head).skip(1));
    let inside = values.filter_map(|rest| rest.split(['"', '#']).next());
    let inside = inside.filter(|target| !target.is_empty() && !target.contains("://") && !target.starts_with('/'));
    inside.map(|target| resolved(folder, target)).collect()
}

/// Resolves `../api.html` in `concepts` to `api.html`.
fn resolved(folder: &str, target: &str) -> String {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in target.split('/') {
        match part {
            "." | "" => {}
            ".." => assert!(parts.pop().is_some(), "{target} leads out of the book"),
            name => parts.push(name),
        }
    }
    parts.join("/")
}

#[test]
fn all_links_of_the_book_resolve() {
    let service = Running::start();
    let (mut known, mut next) = (BTreeSet::from(["index.html".to_string()]), vec!["index.html".to_string()]);
    // A script builds the sidebar.
    next.push("toc.html".into());
    while let Some(page) = next.pop() {
        let answer = service.get(&format!("/docs/{page}"));
        assert_eq!(answer.status, 200, "{page}");
        assert!(!answer.etag.is_empty(), "{page} has no tag");
        if answer.media.starts_with("text/html") {
            let found = targets(&page, &answer.text);
            next.extend(found.into_iter().filter(|target| known.insert(target.clone())));
        }
    }
    for page in
        ["tour.html", "concepts/judging.html", "api.html", "cli.html", "models.html", "architecture.html", "book.css"]
    {
        assert!(known.contains(page), "nothing leads to {page}");
    }
}

#[test]
fn pages_have_etags_and_compression() {
    let service = Running::start();
    let agent = ureq::Agent::config_builder().http_status_as_error(false).max_redirects(0).build().new_agent();
    let ask = |path: &str, name: &str, value: &str| {
        agent.get(format!("{}{path}", service.url)).header(name, value).call().unwrap()
    };
    let mut plain = ask("/docs/tour.html", "accept-encoding", "gzip;q=0, br");
    let header = |answer: &ureq::http::Response<ureq::Body>, name: &str| {
        answer.headers().get(name).map(|value| value.to_str().unwrap().to_string())
    };
    assert_eq!(header(&plain, "content-type").as_deref(), Some("text/html; charset=utf-8"));
    assert_eq!(header(&plain, "content-encoding"), None);
    assert!(header(&plain, "content-security-policy").unwrap().contains("default-src 'self'"));
    let text = plain.body_mut().read_to_string().unwrap();
    assert!(text.contains("A five-minute tour") && !text.contains("<script>"), "no script stands in a page");
    let mut packed = ask("/docs/tour.html", "accept-encoding", "br, gzip");
    assert_eq!(header(&packed, "content-encoding").as_deref(), Some("gzip"));
    let mut bytes = Vec::new();
    packed.body_mut().as_reader().read_to_end(&mut bytes).unwrap();
    assert!(bytes.starts_with(&[0x1f, 0x8b]) && 2 * bytes.len() < text.len());
    let tag = header(&plain, "etag").unwrap();
    assert_eq!(ask("/docs/tour.html", "if-none-match", &format!("\"other\", {tag}")).status(), 304);
    assert_eq!(ask("/docs/tour.html", "if-none-match", "\"other\"").status(), 200);
    let start = ask("/docs", "accept", "*/*");
    assert_eq!((start.status().as_u16(), header(&start, "location").as_deref()), (308, Some("/docs/")));
    for path in ["/docs/none.html", "/docs/../Cargo.toml", "/docs/concepts/", "/docs/%2e%2e/page.js"] {
        let mut missing = ask(path, "accept", "text/html");
        assert_eq!(missing.status(), 404, "{path}");
        assert!(!missing.body_mut().read_to_string().unwrap().is_empty());
    }
}

#[test]
fn problem_types_link_to_their_row() {
    let service = Running::start();
    let problem = service.get("/v1/models/nothing").expect(404);
    let (page, row) = problem["type"].as_str().unwrap().split_once('#').unwrap();
    let answer = service.get(page);
    assert_eq!((answer.status, row), (200, "unknown-name"));
    assert!(answer.text.contains("id=\"unknown-name\""), "{page} has no such row");
}
