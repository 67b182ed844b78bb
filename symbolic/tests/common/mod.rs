//! Texts that stand in files beside the tests.

use std::path::Path;

/// Holds a text against its file, or writes the file where `UPDATE_EXPECT` is set.
pub fn expect(expected: &Path, text: &str) {
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::create_dir_all(expected.parent().unwrap()).unwrap();
        std::fs::write(expected, text).unwrap();
    }
    let old = std::fs::read_to_string(expected).unwrap_or_default();
    assert!(old == text, "{} differs; UPDATE_EXPECT=1 writes it anew\n{text}", expected.display());
}
