//! Packs the page (`web/dist`, built from `web/app`) and the book (`web/docs`, built by `book/build`) for the program: each file
//! compressed, a table each.

use std::collections::BTreeMap;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

/// Media types by the endings of their files, and whether such a file becomes smaller.
const MEDIA: [(&str, &str, bool); 7] = [
    ("html", "text/html; charset=utf-8", true),
    ("css", "text/css; charset=utf-8", true),
    ("js", "text/javascript; charset=utf-8", true),
    ("svg", "image/svg+xml", true),
    ("png", "image/png", false),
    ("json", "application/json", true),
    ("txt", "text/plain; charset=utf-8", true),
];

fn main() -> io::Result<()> {
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or(io::ErrorKind::NotFound)?);
    pack(Path::new("web/dist"), &out, "page")?;
    pack(Path::new("web/docs"), &out, "book")
}

/// Writes `NAME.rs`, the table of a folder's files, and what is in them.
fn pack(folder: &Path, out: &Path, name: &str) -> io::Result<()> {
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut table = String::from("&[\n");
    for (number, (path_inside, path)) in files(folder)?.iter().enumerate() {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        let Some((_, media, is_text)) = MEDIA.iter().find(|(known, ..)| *known == ending) else {
            return Err(io::Error::other(format!("{}: which media type has such a file?", path.display())));
        };
        let bytes = fs::read(path)?;
        let mut hasher = DefaultHasher::new();
        bytes.hash(&mut hasher);
        let packed = if *is_text { compressed(&bytes)? } else { bytes };
        let file = out.join(format!("{name}-{number}"));
        fs::write(&file, packed)?;
        let etag = format!("\"{:016x}\"", hasher.finish());
        table += &format!(
            "    PackedFile {{ path: {path_inside:?}, media: {media:?}, etag: {etag:?}, is_compressed: {is_text}, bytes: include_bytes!({file:?}) }},\n"
        );
    }
    fs::write(out.join(format!("{name}.rs")), table + "]\n")
}

/// All files below `top`, by what they are called from there, in the order of these names.
fn files(top: &Path) -> io::Result<BTreeMap<String, PathBuf>> {
    let (mut folders, mut found) = (vec![top.to_path_buf()], BTreeMap::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(top).map_err(io::Error::other)?.display().to_string();
                found.insert(name, path);
            }
        }
    }
    Ok(found)
}

fn compressed(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes)?;
    encoder.finish()
}
