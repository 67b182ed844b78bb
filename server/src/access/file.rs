//! The token file: names, roles and digests, readable by its owner only, and replaced atomically. A spare file of the same
//! length takes the next list, so that a token can be revoked on a full disk.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use isophote_capture::read_regular;
use isophote_machine::{rfc3339, unix_ms};
use rustix::fs::{CWD, RenameFlags, renameat_with};
use serde::{Deserialize, Serialize};

use super::roles::Role;
use super::token::{Digest, Secret};
use crate::limits::LIMITS;
use crate::name::Name;

/// The default tenant.
pub const DEFAULT_TENANT: &str = "default";
/// The file's name in a data folder.
const FILE: &str = "tokens.json";
/// Extension of the spare file that the next list is written to.
const SPARE: &str = "spare";

/// A stored token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenRecord {
    /// Its name, to revoke it.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// Its tenant.
    pub tenant: String,
    /// Time of creation, RFC 3339, UTC.
    pub created: String,
    /// Digest of the token's text.
    pub sha256: Digest,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    tokens: Vec<TokenRecord>,
}

/// Why tokens cannot be read or changed.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// Neither a file nor a folder was named, and there is no home to have one.
    #[error("there is no place for tokens: give --tokens FILE or --data DIR")]
    NoPlace,
    /// An I/O error.
    #[error("{}: {reason}", path.display())]
    Disk {
        /// The file.
        path: PathBuf,
        /// The system's error.
        reason: io::Error,
    },
    /// Its content or its permissions are wrong.
    #[error("{}: {reason}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong, and the remedy.
        reason: String,
    },
    /// The name is taken.
    #[error("there is a token named `{0}` already; revoke it, or give --name another one")]
    Taken(String),
    /// There is no such token.
    #[error("there is no token named `{0}`; `isophote token list` shows all")]
    Unknown(String),
    /// Not a name.
    #[error("`{0}` is no name: 1 to 64 of a-z, 0-9 and -, not beginning with -")]
    WrongName(String),
    /// Too many tokens.
    #[error("there are {0} tokens, and can be no more; revoke one")]
    TooMany(usize),
    /// No random bits.
    #[error("no random bits for a token: {0}")]
    Random(#[from] getrandom::Error),
}

/// The file that tokens are kept in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenFile {
    path: PathBuf,
}

impl TokenFile {
    /// The file that was named; else `tokens.json` in the data folder; else in the user's configuration,
    /// `~/.config/isophote`.
    pub fn of(file: Option<&Path>, data: Option<&Path>) -> Result<TokenFile, TokenError> {
        if let Some(path) = file.map(Path::to_path_buf).or_else(|| data.map(|data| data.join(FILE))) {
            return Ok(TokenFile { path });
        }
        let folder = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let config = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")));
        let path = config.ok_or(TokenError::NoPlace)?.join("isophote").join(FILE);
        Ok(TokenFile { path })
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All tokens in order of creation; none if there is no file.
    pub fn read(&self) -> Result<Vec<TokenRecord>, TokenError> {
        let bytes = match read_regular(&self.path, LIMITS.token_file_bytes) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            read => read.map_err(|reason| self.disk(reason))?,
        };
        let mode = fs::metadata(&self.path).map_err(|reason| self.disk(reason))?.permissions().mode();
        if mode & 0o022 != 0 {
            return Err(self.wrong("others may write to it, and so make tokens; `chmod 600` it"));
        }
        let document: Document = serde_json::from_slice(&bytes).map_err(|error| {
            self.wrong(&format!("not a file of tokens (wrong at line {}, column {})", error.line(), error.column()))
        })?;
        match document.tokens.iter().find(|token| ![&token.name, &token.tenant].iter().all(|name| is_name(name))) {
            Some(token) => Err(self.wrong(&format!("`{:.80}` or its tenant is no name", token.name))),
            None => Ok(document.tokens),
        }
    }

    /// Creates a token of the default tenant. Without a name it is named by its role and a number.
    pub fn add(&self, role: Role, name: Option<&str>) -> Result<(TokenRecord, Secret), TokenError> {
        self.add_for(DEFAULT_TENANT, role, name)
    }

    /// The same for another tenant.
    pub fn add_for(&self, tenant: &str, role: Role, name: Option<&str>) -> Result<(TokenRecord, Secret), TokenError> {
        if let Some(name) = name.into_iter().chain([tenant]).find(|name| !is_name(name)) {
            return Err(TokenError::WrongName(name.into()));
        }
        self.change(|tokens| {
            if tokens.len() >= LIMITS.tokens {
                return Err(TokenError::TooMany(LIMITS.tokens));
            }
            let is_taken = |name: &str| tokens.iter().any(|token| token.name == name);
            let name = match name {
                Some(name) if is_taken(name) => return Err(TokenError::Taken(name.into())),
                Some(name) => name.to_string(),
                None => (1..).map(|n| format!("{role}-{n}")).find(|name| !is_taken(name)).unwrap_or_default(),
            };
            let secret = Secret::random()?;
            let record =
                TokenRecord { name, role, tenant: tenant.into(), created: rfc3339(unix_ms()), sha256: secret.digest() };
            tokens.push(record.clone());
            Ok((record, secret))
        })
    }

    /// Revokes a token.
    pub fn revoke(&self, name: &str) -> Result<TokenRecord, TokenError> {
        self.change(|tokens| {
            let at = tokens.iter().position(|token| token.name == name);
            at.map(|at| tokens.remove(at)).ok_or_else(|| TokenError::Unknown(name.into()))
        })
    }

    /// Changes the list under a lock, also across processes.
    fn change<T>(&self, change: impl FnOnce(&mut Vec<TokenRecord>) -> Result<T, TokenError>) -> Result<T, TokenError> {
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut private = fs::DirBuilder::new();
        private.recursive(true).mode(0o700).create(folder).map_err(|reason| self.disk(reason))?;
        let lock = self.lock_file().and_then(|lock| lock.lock().map(|()| lock));
        let _lock = lock.map_err(|reason| self.disk(reason))?;
        let mut tokens = self.read()?;
        let changed = change(&mut tokens)?;
        let bytes = serde_json::to_vec_pretty(&Document { tokens }).map_err(|error| self.disk(error.into()))?;
        self.replace(&bytes).and_then(|()| File::open(folder)?.sync_all()).map_err(|reason| self.disk(reason))?;
        // The change is made. Without a spare of that length a later revocation needs free space, which there mostly is.
        self.lengthen_spare(bytes.len() as u64).ok();
        Ok(changed)
    }

    /// Creates the lock and the spare if missing, so that a revocation needs no free space. Does not wait for a holder of the
    /// lock, which creates the spare itself.
    pub fn reserve(&self) -> io::Result<()> {
        let lock = self.lock_file()?;
        lock.try_lock()?;
        self.lengthen_spare(fs::metadata(&self.path)?.len())
    }

    fn lock_file(&self) -> io::Result<File> {
        owned(&self.beside("lock"), OpenOptions::new().create(true))
    }

    /// Writes the spare, whose blocks are allocated, and exchanges the two files: a shorter list needs no free space, and one
    /// of the two lists is complete at every moment.
    fn replace(&self, bytes: &[u8]) -> io::Result<()> {
        let spare = self.beside(SPARE);
        let mut file = self.spare()?;
        file.write_all(bytes)?;
        file.set_len(bytes.len() as u64)?;
        file.sync_all()?;
        match renameat_with(CWD, &spare, CWD, &self.path, RenameFlags::EXCHANGE) {
            Ok(()) => Ok(()),
            // There is no list yet, or the file system (NFS) does not support the exchange.
            Err(_) => fs::rename(&spare, &self.path),
        }
    }

    /// Opens the spare. Replaces a file that others own, may access, or have linked.
    fn spare(&self) -> io::Result<File> {
        let path = self.beside(SPARE);
        let file = owned(&path, OpenOptions::new().create(true));
        let is_ours = |file: &File| {
            let about = file.metadata()?;
            let is_private = about.mode() & 0o077 == 0 && about.uid() == rustix::process::geteuid().as_raw();
            Ok::<_, io::Error>(about.is_file() && is_private && about.nlink() == 1)
        };
        match file {
            Ok(file) if is_ours(&file)? => Ok(file),
            Err(error) if fs::symlink_metadata(&path).is_err() => Err(error), // it cannot be made
            _ => {
                fs::remove_file(&path)?;
                owned(&path, OpenOptions::new().create_new(true))
            }
        }
    }

    fn lengthen_spare(&self, bytes: u64) -> io::Result<()> {
        let mut file = self.spare()?;
        let length = file.seek(SeekFrom::End(0))?;
        // Written, not just extended: a hole has no blocks.
        io::copy(&mut io::repeat(b' ').take(bytes.saturating_sub(length)), &mut file)?;
        file.sync_all()
    }

    fn beside(&self, extension: &str) -> PathBuf {
        let mut name = self.path.clone().into_os_string();
        name.push(".");
        name.push(extension);
        name.into()
    }

    fn disk(&self, reason: io::Error) -> TokenError {
        TokenError::Disk { path: self.path.clone(), reason }
    }

    fn wrong(&self, reason: &str) -> TokenError {
        TokenError::Wrong { path: self.path.clone(), reason: reason.into() }
    }
}

fn is_name(text: &str) -> bool {
    Name::parse(text).is_some()
}

/// Opens a file of mode 600; does not block on a pipe, nor follow a link.
fn owned(path: &Path, how: &mut OpenOptions) -> io::Result<File> {
    let flags = rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOFOLLOW;
    how.write(true).mode(0o600).custom_flags(flags.bits() as i32).open(path)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("isophote-tokens-{name}-{}", std::process::id()));
        fs::remove_dir_all(&folder).ok();
        folder
    }

    #[test]
    fn tokens_are_added_listed_and_revoked_by_digest() {
        let data = folder("life");
        let file = TokenFile::of(None, Some(&data)).unwrap();
        assert_eq!(file.read().unwrap(), []);
        let (first, secret) = file.add(Role::View, None).unwrap();
        let (second, _) = file.add(Role::View, None).unwrap();
        let (third, _) = file.add(Role::Admin, Some("mine")).unwrap();
        assert_eq!([&first.name, &second.name, &third.name], ["view-1", "view-2", "mine"]);
        assert_eq!(file.read().unwrap(), [first.clone(), second, third]);
        assert_eq!(first.sha256, secret.digest());
        let text = fs::read_to_string(file.path()).unwrap();
        assert!(!text.contains("isophote_") && !text.contains(&secret.text()[9..]), "{text}");
        assert_eq!(fs::metadata(file.path()).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(matches!(file.add(Role::View, Some("mine")), Err(TokenError::Taken(_))));
        assert!(matches!(file.add(Role::View, Some("No")), Err(TokenError::WrongName(_))));
        assert_eq!(file.revoke("view-1").unwrap(), first);
        assert!(matches!(file.revoke("view-1"), Err(TokenError::Unknown(_))));
        assert_eq!(file.add(Role::View, None).unwrap().0.name, "view-1");
        fs::remove_dir_all(&data).unwrap();
    }

    /// On a full disk only blocks already allocated to the two files can be written.
    #[test]
    fn a_revocation_writes_to_a_spare_as_long_as_the_list() {
        let data = folder("spare");
        let file = TokenFile::of(None, Some(&data)).unwrap();
        let spare = file.beside(SPARE);
        for name in ["short", "one-of-a-long-name", "another-of-a-long-name"] {
            file.add(Role::View, Some(name)).unwrap();
        }
        for name in ["short", "another-of-a-long-name", "one-of-a-long-name"] {
            let [list, before] = [file.path(), &spare].map(|path| fs::metadata(path).unwrap());
            assert!(before.len() >= list.len(), "{} of {}", before.len(), list.len());
            file.revoke(name).unwrap();
            let [list_now, spare_now] = [file.path(), &spare].map(|path| fs::metadata(path).unwrap());
            assert_eq!((list_now.ino(), spare_now.ino()), (before.ino(), list.ino()));
        }
        assert_eq!(file.read().unwrap(), []);

        // A list of an earlier version has no spare.
        file.add(Role::View, None).unwrap();
        fs::remove_file(&spare).unwrap();
        file.reserve().unwrap();
        assert_eq!(fs::metadata(&spare).unwrap().len(), fs::metadata(file.path()).unwrap().len());

        // A spare that others can write to never becomes the list.
        let planted = data.join("planted");
        for prepare in [
            &|| fs::hard_link(&spare, &planted).unwrap(),
            &|| fs::set_permissions(&spare, fs::Permissions::from_mode(0o620)).unwrap(),
            &|| fs::rename(&spare, &planted).and_then(|()| std::os::unix::fs::symlink(&planted, &spare)).unwrap(),
        ] as [&dyn Fn(); 3]
        {
            prepare();
            let before = fs::metadata(&spare).unwrap().ino();
            file.add(Role::View, None).unwrap();
            assert_ne!(fs::metadata(file.path()).unwrap().ino(), before);
            assert_eq!(fs::symlink_metadata(file.path()).unwrap().permissions().mode() & 0o777, 0o600);
            drop(fs::remove_file(&planted));
        }
        fs::remove_dir_all(&data).unwrap();
    }

    #[test]
    fn a_malformed_or_writable_file_gives_no_tokens() {
        let data = folder("wrong");
        let file = TokenFile::of(None, Some(&data)).unwrap();
        file.add(Role::View, None).unwrap();
        let whole = fs::read(file.path()).unwrap();
        let set = |mode| fs::set_permissions(file.path(), fs::Permissions::from_mode(mode)).unwrap();
        for (mode, is_read) in [(0o620, false), (0o602, false), (0o644, true), (0o600, true)] {
            set(mode);
            assert_eq!(file.read().is_ok(), is_read, "{mode:o}");
        }
        let strange = String::from_utf8(whole.clone()).unwrap().replace("view-1", "No");
        for text in [&whole[..whole.len() / 2], b"", b"{}", strange.as_bytes()] {
            fs::write(file.path(), text).unwrap();
            assert!(matches!(file.read(), Err(TokenError::Wrong { .. })), "{}", String::from_utf8_lossy(text));
            assert!(file.add(Role::View, None).is_err());
        }
        fs::remove_file(file.path()).unwrap();
        rustix::fs::mkfifoat(rustix::fs::CWD, file.path(), rustix::fs::Mode::RUSR).unwrap();
        assert!(matches!(file.read(), Err(TokenError::Disk { .. })));
        fs::remove_dir_all(&data).unwrap();
    }

    #[test]
    fn concurrent_additions_lose_no_token() {
        let data = folder("many");
        let file = TokenFile::of(None, Some(&data)).unwrap();
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| file.add(Role::View, None).unwrap());
            }
        });
        let names: std::collections::BTreeSet<String> = file.read().unwrap().into_iter().map(|t| t.name).collect();
        assert_eq!(names.len(), 8);
        fs::remove_dir_all(&data).unwrap();
    }
}
