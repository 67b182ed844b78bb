//! Allowed dependencies between crates (DESIGN's table, in ARCHITECTURE.md), checked in the manifests.

use toml::de::{DeTable, DeValue};

use crate::{expect_none, files};

/// A workspace crate and the workspace crates that it may use.
const MAY_USE: [(&str, &[&str]); 15] = [
    ("isophote-elementary", &[]),
    ("isophote-syntax", &["isophote-elementary"]),
    ("isophote-symbolic", &["isophote-elementary", "isophote-syntax"]),
    ("isophote-export", &["isophote-symbolic"]),
    ("isophote-notation", &["isophote-syntax", "isophote-symbolic"]),
    ("isophote-jit", &["isophote-elementary", "isophote-symbolic"]),
    ("isophote-frame", &["isophote-jit"]),
    ("isophote-tracker", &["isophote-symbolic", "isophote-jit", "isophote-frame"]),
    ("isophote-capture", &["isophote-symbolic", "isophote-jit", "isophote-frame"]),
    ("isophote-machine", &["isophote-tracker"]),
    (
        "isophote-wire",
        &["isophote-symbolic", "isophote-notation", "isophote-jit", "isophote-tracker", "isophote-capture"],
    ),
    (
        "isophote-server",
        &[
            "isophote-symbolic",
            "isophote-jit",
            "isophote-tracker",
            "isophote-capture",
            "isophote-machine",
            "isophote-wire",
        ],
    ),
    (
        "isophote",
        &[
            "isophote-symbolic",
            "isophote-export",
            "isophote-jit",
            "isophote-tracker",
            "isophote-capture",
            "isophote-machine",
            "isophote-wire",
            "isophote-server",
        ],
    ),
    ("isophote-tests", &["*"]),
    ("isophote-benches", &["*"]),
];

/// Prefixes of external crates, the workspace crates that may use them, and the reason.
const ONLY_IN: [(&str, &[&str], &str); 16] = [
    ("tokio", &["isophote-server", "isophote", "isophote-tests"], "nothing below server is async"),
    ("axum", &["isophote-server", "isophote", "isophote-tests"], "sockets end at the server"),
    ("hyper", &["isophote-server", "isophote", "isophote-tests"], "sockets end at the server"),
    ("tower", &["isophote-server", "isophote", "isophote-tests"], "sockets end at the server"),
    ("futures", &["isophote-server", "isophote", "isophote-tests"], "nothing below server is async"),
    ("async-", &["isophote-server", "isophote", "isophote-tests"], "nothing below server is async"),
    ("tungstenite", &["isophote-server", "isophote", "isophote-tests"], "sockets end at the server"),
    ("ureq", &["isophote", "isophote-tests"], "only clients ask"),
    ("reqwest", &["isophote", "isophote-tests"], "only clients ask"),
    ("cranelift", &["isophote-jit", "isophote-benches"], "one crate makes machine code"),
    ("nalgebra", &["isophote-tracker", "isophote-tests", "isophote-benches"], "the server contains no mathematics"),
    (
        "image",
        &["isophote-capture", "isophote", "isophote-tests", "isophote-server"],
        "the core sees planes, not file formats",
    ),
    ("rand", &["isophote-capture", "isophote-tests", "isophote-benches"], "the core is deterministic"),
    ("zune", &["isophote-capture"], "the core sees planes, not file formats"),
    ("v4l", &["isophote-capture", "isophote-tests"], "one crate talks to cameras, and tests play one"),
    ("clap", &["isophote", "isophote-benches"], "one crate reads a command line"),
];

/// Violations in a manifest.
fn faults(path: &str, text: &str) -> Vec<String> {
    let manifest = DeTable::parse(text).unwrap().into_inner();
    let Some(package) = table(&manifest, "package") else { return Vec::new() };
    let name = package.get("name").and_then(|name| name.get_ref().as_str()).unwrap_or_default().to_string();
    let Some((_, may_use)) = MAY_USE.iter().find(|(known, _)| *known == name) else {
        return vec![format!("{path}: {name} has no row in the table of crates")];
    };
    let mut found = Vec::new();
    for dependency in dependencies(&manifest) {
        if MAY_USE.iter().any(|(known, _)| *known == dependency)
            && !may_use.iter().any(|one| *one == "*" || *one == dependency)
        {
            found.push(format!("{path}: {name} may not use {dependency}"));
        }
        for (head, users, why) in ONLY_IN {
            let meant = dependency == head
                || dependency.starts_with(head)
                    && (head.ends_with('-') || dependency[head.len()..].starts_with(['-', '_']));
            if meant && !users.contains(&name.as_str()) {
                found.push(format!("{path}: {name} may not use {dependency}: {why}"));
            }
        }
    }
    found.extend(unexplained(path, text));
    found
}

fn table<'a>(parent: &'a DeTable<'_>, key: &str) -> Option<&'a DeTable<'a>> {
    match parent.get(key)?.get_ref() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}

/// Dependencies of the crate itself; its tests may use more.
fn dependencies(manifest: &DeTable<'_>) -> Vec<String> {
    let mut places = vec![manifest];
    if let Some(targets) = table(manifest, "target") {
        places.extend(targets.values().filter_map(|target| match target.get_ref() {
            DeValue::Table(table) => Some(table),
            _ => None,
        }));
    }
    let tables = places
        .iter()
        .flat_map(|place| ["dependencies", "build-dependencies"].into_iter().filter_map(|key| table(place, key)));
    tables.flat_map(|table| table.keys().map(|key| key.get_ref().to_string())).collect()
}

/// External dependencies with a version must have a comment beside or above them.
fn unexplained(path: &str, text: &str) -> Vec<String> {
    let (mut above, mut inside, mut found) = ("", false, Vec::new());
    for line in text.lines() {
        if line.starts_with('[') {
            inside = line.contains("dependencies");
        }
        let versioned = inside
            && !line.starts_with('[')
            && line.contains("= ")
            && line.contains('"')
            && !line.contains("workspace = true")
            && !line.contains("path =");
        if versioned && !line.starts_with('#') && !line.contains('#') && !above.starts_with('#') {
            found.push(format!("{path}: `{line}` does not say why"));
        }
        above = line;
    }
    found
}

#[test]
fn crates_use_only_lower_crates() {
    let found: Vec<String> = files(&["Cargo.toml"]).iter().flat_map(|file| faults(&file.path, &file.text)).collect();
    expect_none("dependencies", &found);
}

#[test]
fn every_row_has_a_crate() {
    let manifests = files(&["/Cargo.toml"]);
    let named = |name: &str| manifests.iter().any(|file| file.text.contains(&format!("name = \"{name}\"")));
    let stale: Vec<String> =
        MAY_USE.iter().filter(|(name, _)| !named(name)).map(|(name, _)| name.to_string()).collect();
    expect_none("rows without a crate", &stale);
}

#[test]
fn planted_faults_are_caught() {
    let manifest = |name: &str, rest: &str| format!("[package]\nname = \"{name}\"\n{rest}");
    let caught = |name: &str, rest: &str| faults("planted", &manifest(name, rest)).join("\n");
    assert!(
        caught("isophote-symbolic", "[dependencies]\nisophote-jit.workspace = true\n")
            .contains("may not use isophote-jit")
    );
    let tracker = "[dependencies]\nisophote-tracker.workspace = true\n";
    assert!(caught("isophote-capture", tracker).contains("may not use isophote-tracker"));
    assert!(caught("isophote-tracker", "[dependencies]\ntokio = \"1\" # why\n").contains("async"));
    assert!(caught("isophote-capture", "[target.'cfg(unix)'.dependencies]\naxum = \"1\" # why\n").contains("sockets"));
    assert!(caught("isophote-server", "[build-dependencies]\nnalgebra = \"1\" # why\n").contains("mathematics"));
    assert!(caught("isophote-jit", "[dependencies]\nregion = \"3\"\n").contains("does not say why"));
    let of_a_processor = "[target.'cfg(target_arch = \"x86_64\")'.dependencies]\nregion = \"3\"";
    assert!(caught("isophote-jit", of_a_processor).contains("does not say why"));
    assert_eq!(caught("isophote-jit", &format!("{of_a_processor} # why\n")), "");
    assert!(caught("isophote-new", "").contains("no row"));
    assert_eq!(
        caught(
            "isophote-jit",
            "[dependencies]\ncranelift-jit = \"1\"  # why\n[dev-dependencies]\nrand = \"1\" # why\n"
        ),
        ""
    );
}
