//! External packages: one registry, checksums, allowed licences, and a limited number.

use std::collections::BTreeSet;
use std::process::Command;

use toml::de::{DeTable, DeValue};

use crate::expect_none;

/// Prefix of packages that must have a single version.
const ONE_VERSION: &str = "cranelift-";

fn text(path: &str) -> String {
    std::fs::read_to_string(isophote_tests::repository().join(path)).unwrap()
}

fn string<'a>(table: &'a DeTable<'_>, key: &str) -> Option<&'a str> {
    table.get(key)?.get_ref().as_str()
}

/// Violations in a lock file.
fn faults(lock: &str) -> Vec<String> {
    let lock = DeTable::parse(lock).unwrap().into_inner();
    let Some(DeValue::Array(packages)) = lock.get("package").map(|packages| packages.get_ref()) else {
        return vec!["no packages".into()];
    };
    let (mut found, mut sources, mut versions) = (Vec::new(), BTreeSet::new(), BTreeSet::new());
    for package in packages.iter().filter_map(|package| package.get_ref().as_table()) {
        let (name, version) = (string(package, "name").unwrap(), string(package, "version").unwrap());
        let is_ours = name == "isophote" || name.starts_with("isophote-");
        match string(package, "source") {
            None if !is_ours => found.push(format!("{name} {version} is a folder, and not ours")),
            None => continue,
            Some(source) if !source.starts_with("registry+") => {
                found.push(format!("{name} {version} comes from {source}"));
            }
            Some(source) => drop(sources.insert(source)),
        }
        if string(package, "checksum").is_none() {
            found.push(format!("{name} {version} has no checksum"));
        }
        if name.starts_with(ONE_VERSION) {
            versions.insert(version);
        }
    }
    if sources.len() > 1 {
        found.push(format!("packages of {} registries", sources.len()));
    }
    if versions.len() != 1 {
        found.push(format!("{ONE_VERSION}* in {} versions: {versions:?}", versions.len()));
    }
    found
}

/// The number before those words in ARCHITECTURE.md.
fn packages_max() -> usize {
    let architecture = text("ARCHITECTURE.md");
    let (before, _) = architecture.split_once(" packages come from outside").unwrap();
    before.rsplit(' ').next().unwrap().parse().unwrap()
}

/// The licences allowed by deny.toml.
fn allowed() -> BTreeSet<String> {
    let deny = text("deny.toml");
    let deny = DeTable::parse(&deny).unwrap().into_inner();
    let licenses = deny["licenses"].get_ref().as_table().unwrap();
    let DeValue::Array(allow) = licenses["allow"].get_ref() else { panic!("deny.toml lists no licences") };
    allow.iter().map(|one| one.get_ref().as_str().unwrap().to_string()).collect()
}

/// Whether the allowed licences satisfy an SPDX expression, with the `/` that older packages write for `OR`.
fn may_use(expression: &str, allowed: &BTreeSet<String>) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let (mut at, known) = (0, |licence: &str| allowed.contains(licence));
    either(&words, &mut at, &known) && at == words.len()
}

/// Parses alternatives.
fn either(words: &[&str], at: &mut usize, known: &dyn Fn(&str) -> bool) -> bool {
    let mut is_well = all(words, at, known);
    while words.get(*at) == Some(&"OR") {
        *at += 1;
        is_well |= all(words, at, known);
    }
    is_well
}

fn all(words: &[&str], at: &mut usize, known: &dyn Fn(&str) -> bool) -> bool {
    let mut is_well = one(words, at, known);
    while words.get(*at) == Some(&"AND") {
        *at += 1;
        is_well &= one(words, at, known);
    }
    is_well
}

/// Parses a licence with its exception, or an expression in parentheses.
fn one(words: &[&str], at: &mut usize, known: &dyn Fn(&str) -> bool) -> bool {
    let Some(first) = words.get(*at) else { return false };
    *at += 1;
    if *first == "(" {
        let is_well = either(words, at, known);
        *at += 1;
        return is_well && words.get(*at - 1) == Some(&")");
    }
    if words.get(*at) == Some(&"WITH") {
        *at += 2;
        return words.get(*at - 1).is_some_and(|exception| known(&format!("{first} WITH {exception}")));
    }
    known(first)
}

#[test]
fn packages_come_from_one_registry() {
    expect_none("Cargo.lock", &faults(&text("Cargo.lock")));
}

/// Packages of the program built without options.
#[test]
fn packages_are_limited() {
    let mut command = Command::new(env!("CARGO"));
    command.args([
        "tree",
        "--locked",
        "--offline",
        "--edges",
        "normal,build",
        "--package",
        "isophote",
        "--prefix",
        "none",
    ]);
    let output = command.args(["--format", "{p}"]).current_dir(isophote_tests::repository()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let output = String::from_utf8(output.stdout).unwrap();
    let packages: BTreeSet<&str> = output.lines().map(|line| line.trim_end_matches(" (*)")).collect();
    // Local packages are listed with their folder.
    let count = packages.iter().filter(|package| !package.is_empty() && !package.contains("(/")).count();
    assert!(count > 100, "{output}");
    let most = packages_max();
    assert!(count <= most, "{count} packages from outside, ARCHITECTURE.md says at most {most}");
}

/// Packages for this platform only: others need not be downloaded.
#[test]
fn licences_are_allowed() {
    let output = Command::new(env!("CARGO")).arg("-vV").output().unwrap();
    let output = String::from_utf8(output.stdout).unwrap();
    let host = output.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
    let metadata = |network: &[&str]| {
        let mut command = Command::new(env!("CARGO"));
        command.args(["metadata", "--locked", "--format-version", "1", "--filter-platform", host]).args(network);
        command.current_dir(isophote_tests::repository()).output().unwrap()
    };
    // After a partial build not everything has been downloaded.
    let known = metadata(&["--offline"]);
    let metadata = if known.status.success() { known } else { metadata(&[]) };
    assert!(metadata.status.success(), "{}", String::from_utf8_lossy(&metadata.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&metadata.stdout).unwrap();
    let (packages, allowed) = (metadata["packages"].as_array().unwrap(), allowed());
    assert!(packages.len() > 200, "{} packages", packages.len());
    let refused = packages.iter().filter_map(|package| {
        let licence = package["license"].as_str().unwrap_or_default();
        (!may_use(licence, &allowed)).then(|| format!("{} {}: `{licence}`", package["name"], package["version"]))
    });
    expect_none("licences that deny.toml does not list", &refused.collect::<Vec<_>>());
}

#[test]
fn planted_faults_are_caught() {
    let package = |name: &str, rest: &str| format!("[[package]]\nname = \"{name}\"\nversion = \"1\"\n{rest}\n");
    let registry = "source = \"registry+one\"\nchecksum = \"0\"";
    let fine = package("cranelift-a", registry) + &package("isophote-b", "");
    let caught = |more: &str| faults(&format!("{fine}{more}")).join("\n");
    assert_eq!(caught(&package("b", registry)), "");
    assert!(caught(&package("b", "source = \"git+one\"\nchecksum = \"0\"")).contains("comes from git+one"));
    assert!(caught(&package("b", "source = \"registry+one\"")).contains("no checksum"));
    assert!(caught(&package("b", "source = \"registry+two\"\nchecksum = \"0\"")).contains("2 registries"));
    assert!(caught(&package("b", "")).contains("is a folder"));
    assert!(caught(&package("cranelift-c", registry).replace("\"1\"", "\"2\"")).contains("in 2 versions"));
    let allowed = ["MIT", "ISC", "Apache-2.0 WITH LLVM-exception"].map(String::from).into();
    for fine in ["MIT", "GPL-3.0 OR MIT", "GPL-3.0/MIT", "(GPL-3.0 OR MIT) AND ISC", "Apache-2.0 WITH LLVM-exception"] {
        assert!(may_use(fine, &allowed), "{fine}");
    }
    for refused in
        ["", "GPL-3.0", "MIT AND GPL-3.0", "(MIT OR ISC) AND GPL-3.0", "Apache-2.0", "(MIT", "MIT)", "MIT ISC"]
    {
        assert!(!may_use(refused, &allowed), "{refused}");
    }
}
