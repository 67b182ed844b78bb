//! Imports between the files of each crate, from `use` declarations and paths in the code, without tests.
//!
//! Rule: no cycle of more than two files. A file and its module's file may import each other; beyond that one of them
//! holds something that belongs to a third.

use std::collections::{BTreeMap, BTreeSet};

use crate::sources::{code_only, without_tests};
use crate::{File, expect_none, files};

/// A module as its path in the crate; empty for `lib.rs` and `main.rs`.
type Module = Vec<String>;

/// The files of one crate, by module.
#[derive(Default)]
pub struct Crate {
    paths: BTreeMap<Module, String>,
    code: BTreeMap<Module, String>,
    /// Names re-exported by a module, with their origin: an import of such a name depends on the origin.
    taken: BTreeMap<(Module, String), Module>,
}

impl Crate {
    /// From files whose paths start with `folder`, which ends in `/`.
    pub fn of(folder: &str, files: &[File]) -> Crate {
        let mut found = Crate::default();
        for file in files {
            let Some(inside) = file.path.strip_prefix(folder).and_then(|rest| rest.strip_suffix(".rs")) else {
                continue;
            };
            let mut module: Module = inside.split('/').map(String::from).collect();
            if module[0] == "bin" || module.last().is_some_and(|last| last.ends_with("tests")) {
                continue;
            }
            if module.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
                module.pop();
            }
            found.code.insert(module.clone(), without_tests(&code_only(&file.text)));
            found.paths.insert(module, file.path.clone());
        }
        for (module, code) in &found.code {
            for path in declarations(code).iter().flat_map(|tree| expanded(tree)) {
                let (Some(name), Some(meant)) = (path.last().cloned(), found.absolute(module, &path)) else { continue };
                found.taken.insert((module.clone(), name), meant);
            }
        }
        found
    }

    /// Resolves a path from the crate root; `None` for other crates.
    fn absolute(&self, module: &Module, path: &[String]) -> Option<Module> {
        let first = path.first()?.as_str();
        let ups = path.iter().take_while(|part| *part == "super").count();
        Some(match first {
            "crate" => path[1..].to_vec(),
            "self" => [module, &path[1..]].concat(),
            "super" => [module.get(..module.len().checked_sub(ups)?)?, &path[ups..]].concat(),
            _ => {
                let inside = [module, path].concat();
                self.code.contains_key(&inside[..module.len() + 1]).then_some(inside)?
            }
        })
    }

    /// The module that defines a path from the root; re-exports resolve to their origin.
    fn holder(&self, path: &[String]) -> Option<Module> {
        let mut path = path.to_vec();
        for _ in 0..8 {
            let length = (0..=path.len()).rev().find(|n| self.code.contains_key(&path[..*n]))?;
            let (module, rest) = path.split_at(length);
            let next = rest.first().and_then(|name| self.taken.get(&(module.to_vec(), name.clone())));
            match next {
                Some(next) if next[..] != path[..=length] => path = [next, &rest[1..]].concat(),
                _ => return Some(module.to_vec()),
            }
        }
        None
    }

    /// The imports of each module.
    pub fn imports(&self) -> BTreeMap<Module, BTreeSet<Module>> {
        let of = |(module, code): (&Module, &String)| {
            let mut paths: Vec<Module> = declarations(code).iter().flat_map(|tree| expanded(tree)).collect();
            paths.extend(paths_in_code(code));
            let held = paths.iter().filter_map(|path| self.holder(&self.absolute(module, path)?));
            (module.clone(), held.filter(|other| other != module).collect())
        };
        self.code.iter().map(of).collect()
    }

    /// Cycles of more than two files, as their paths.
    fn circles(&self) -> Vec<Vec<&str>> {
        let imports = self.imports();
        let below = |start: &Module| {
            let (mut seen, mut waiting) = (BTreeSet::new(), vec![start]);
            while let Some(module) = waiting.pop() {
                waiting.extend(imports[module].iter().filter(|next| seen.insert((*next).clone())));
            }
            seen
        };
        let reach: BTreeMap<&Module, BTreeSet<Module>> = imports.keys().map(|module| (module, below(module))).collect();
        let group = |module: &Module| -> Vec<&Module> {
            reach
                .keys()
                .filter(|other| reach[module].contains(**other) && reach[*other].contains(module))
                .copied()
                .collect()
        };
        let groups: BTreeSet<Vec<&Module>> = imports.keys().map(group).filter(|group| group.len() > 2).collect();
        groups.into_iter().map(|group| group.into_iter().map(|module| self.paths[module].as_str()).collect()).collect()
    }
}

/// The tree of each `use`; an indented one that begins with `super` belongs to an inline module.
fn declarations(code: &str) -> Vec<String> {
    let is_word = |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
    let starts = code.match_indices("use ").filter(|(at, _)| is_word(*at));
    let trees = starts.filter_map(|(at, word)| {
        let tree = code[at + word.len()..].split(';').next()?.split_whitespace().collect::<Vec<_>>().join(" ");
        let is_inner = code[..at].ends_with(' ') && !code[..at].ends_with("pub ") && tree.starts_with("super");
        (!is_inner).then_some(tree)
    });
    trees.collect()
}

/// Expands `a::{b, c::d}` to `a::b` and `a::c::d`; renames are ignored.
fn expanded(tree: &str) -> Vec<Module> {
    let Some((head, inner)) = tree.split_once('{') else {
        let path = tree.split(" as ").next().unwrap_or_default().trim();
        let mut path: Module =
            path.split("::").map(|part| part.trim().to_string()).filter(|part| !part.is_empty()).collect();
        if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
            path.pop();
        }
        return vec![path];
    };
    let inner = inner.rsplit_once('}').map_or(inner, |(inner, _)| inner);
    let (mut depth, mut start, mut parts) = (0, 0, Vec::new());
    for (at, c) in inner.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&inner[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&inner[start..]);
    let parts = parts.into_iter().filter(|part| !part.trim().is_empty());
    parts.flat_map(|part| expanded(&format!("{head}{}", part.trim()))).collect()
}

/// Paths in the code itself: `crate::a::f()`, `child::g()`.
fn paths_in_code(code: &str) -> Vec<Module> {
    let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let words = code.split(|c: char| !is_part(c)).filter(|word| word.contains("::") && !word.ends_with("::"));
    words.map(|word| word.split("::").filter(|part| !part.is_empty()).map(String::from).collect()).collect()
}

/// The crates: folders with a `src/lib.rs` or a `src/main.rs`.
pub fn crates(files: &[File]) -> BTreeMap<String, Crate> {
    let folder = |file: &File| {
        let path = ["src/lib.rs", "src/main.rs"].iter().find_map(|end| file.path.strip_suffix(end))?;
        Some(path.trim_end_matches('/').to_string())
    };
    let names: BTreeSet<String> = files.iter().filter_map(folder).collect();
    names.into_iter().map(|name| (name.clone(), Crate::of(&format!("{name}/src/"), files))).collect()
}

#[test]
fn import_cycles_have_at_most_two_files() {
    let crates = crates(&files(&[".rs"]));
    let circles = crates.values().flat_map(Crate::circles);
    let found: Vec<String> = circles.map(|circle| circle.join(", ")).collect();
    expect_none("circles", &found);
}

#[test]
fn planted_faults_are_caught() {
    let file = |path: &str, text: &str| File { path: format!("a/src/{path}"), text: text.into() };
    let circles = |files: &[File]| Crate::of("a/src/", files).circles().len();
    let chain = [
        file("lib.rs", "mod b;\nmod c;\nmod d;"),
        file("b.rs", "use crate::{c::{self, C}, e::E};"),
        file("c.rs", "fn f() { super::d::g() }"),
        file("d/mod.rs", "mod inner;\npub use inner::D;"),
        file("d/inner.rs", "use std::fs;\n// use crate::b::B;\nmod more {\n    use super::*;\n}"),
    ];
    assert_eq!(circles(&chain), 0, "inner needs nobody");
    let mut through = chain;
    through[4] = file("d/inner.rs", "use crate::b::B;");
    assert_eq!(circles(&through), 1, "d has inner, which needs b, which needs c");
    through[2] = file("c.rs", "use super::d::D;");
    assert_eq!(circles(&through), 1, "what c takes from d is inner's");
    through[4] = file("d/inner.rs", "#[cfg(test)]\nmod tests {\n use crate::b::B;\n}\n");
    assert_eq!(circles(&through), 0, "a test may need what it tests");
    let children =
        [file("lib.rs", "mod b;\nmod c;\nfn f() { b::g(); c::h() }\nstruct A;"), file("b.rs", "use super::A;")];
    assert_eq!(circles(&children), 0, "two files");
    let [top, child] = children;
    assert_eq!(circles(&[top, child, file("c.rs", "use crate::A;")]), 1, "three files, through the module's own");
}
