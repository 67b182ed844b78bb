//! Identifies the running program: results of another build may differ in their last bits.

use std::fs::File;
use std::io::Read;
use std::sync::OnceLock;

/// Bytes that are read at a time.
const PIECE_BYTES: usize = 1 << 20;

/// CRC-32 and length of the program's file, read once; `None` if it cannot be read.
pub fn program_checksum() -> Option<String> {
    static CHECKSUM: OnceLock<Option<String>> = OnceLock::new();
    CHECKSUM.get_or_init(read).clone()
}

fn read() -> Option<String> {
    let mut file = File::open(std::env::current_exe().ok()?).ok()?;
    let (mut checksum, mut length, mut piece) = (crc32fast::Hasher::new(), 0u64, vec![0; PIECE_BYTES]);
    loop {
        match file.read(&mut piece).ok()? {
            0 => return Some(format!("crc32:{:08x}-{length}", checksum.finalize())),
            bytes => {
                checksum.update(&piece[..bytes]);
                length += bytes as u64;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_has_one_checksum() {
        let found = program_checksum();
        assert!(found.as_ref().is_some_and(|text| text.len() > 20 && !text.ends_with("-0")), "{found:?}");
        assert_eq!(found, read());
    }
}
