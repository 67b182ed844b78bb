//! The tokens that are good right now, and who came with which. A revoked token is noticed here by everyone who came with it.

use std::sync::Arc;

use subtle::ConstantTimeEq;
use tokio::sync::watch;

use super::budget::CompileBudget;
use super::file::{DEFAULT_TENANT, TokenError, TokenFile, TokenRecord};
use super::roles::Role;
use super::stamp::{FileStamp, follow, stamp};
use super::token::Secret;

/// The tokens of a file, read again when it changes.
pub struct Keyring {
    file: TokenFile,
    tokens: watch::Sender<Arc<[TokenRecord]>>,
    /// Of everyone who comes with a token.
    pub compiles: CompileBudget,
}

impl Keyring {
    /// As the file has them now.
    pub fn open(file: TokenFile) -> Result<Keyring, TokenError> {
        let tokens = file.read()?.into();
        Ok(Keyring { file, tokens: watch::Sender::new(tokens), compiles: CompileBudget::default() })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.tokens.borrow().len()
    }

    /// Whose they are; some more than once.
    pub fn tenants(&self) -> Vec<String> {
        self.tokens.borrow().iter().map(|token| token.tenant.clone()).collect()
    }

    /// Whose token that is. All are compared, in full, whichever it is.
    pub fn identify(&self, secret: &Secret) -> Option<TokenOwner> {
        let digest = secret.digest();
        let tokens = self.tokens.borrow().clone();
        let mut found = None;
        for token in tokens.iter() {
            if bool::from(token.sha256.ct_eq(&digest)) {
                found = Some(TokenOwner(token.clone()));
            }
        }
        found
    }

    /// Reads the file again whenever it changes, for as long as this is polled. While it cannot be read no token is good: one of
    /// them may have been revoked.
    pub async fn follow(self: Arc<Keyring>) {
        follow(self, None, Keyring::look).await;
    }

    fn look(&self, seen: Option<FileStamp>) -> Option<FileStamp> {
        let stamp = stamp(self.file.path());
        if seen == Some(stamp) {
            return seen;
        }
        // A read that failed is tried again at the next look.
        let (tokens, seen) = match self.file.read() {
            Ok(tokens) => (tokens, Some(stamp)),
            Err(error) => {
                tracing::error!(%error, "no token is accepted until its file can be read");
                (Vec::new(), None)
            }
        };
        self.tokens.send_if_modified(|known| {
            let is_other = **known != *tokens;
            if is_other {
                tracing::info!(tokens = tokens.len(), "the tokens have changed");
                *known = tokens.into();
            }
            is_other
        });
        seen
    }
}

/// Whose token it was.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenOwner(TokenRecord);

impl TokenOwner {
    /// What it may do.
    pub fn role(&self) -> Role {
        self.0.role
    }

    /// Whose the token is.
    pub fn tenant(&self) -> &str {
        &self.0.tenant
    }

    /// What the token is called.
    pub fn name(&self) -> &str {
        &self.0.name
    }
}

/// Who sent a request.
#[derive(Clone)]
pub enum Visitor {
    /// Someone on this machine, or who reads what anyone may.
    Anyone,
    /// Someone with a token.
    Known(TokenOwner, Arc<Keyring>),
}

impl Visitor {
    /// When the token is no more what it was; for those who came without, never.
    pub async fn revoked(&self) {
        let Visitor::Known(TokenOwner(token), keyring) = self else { return std::future::pending().await };
        let mut tokens = keyring.tokens.subscribe();
        // An error would say that the keyring has gone, which is held here.
        tokens.wait_for(|tokens| !tokens.contains(token)).await.ok();
    }

    /// Whether it runs the machine: it came with a token of the first tenant, or where nobody needs one.
    pub fn is_operator(&self) -> bool {
        match self {
            Visitor::Anyone => true,
            Visitor::Known(owner, _) => owner.tenant() == DEFAULT_TENANT,
        }
    }

    /// Whether it came with a token.
    pub fn is_known(&self) -> bool {
        matches!(self, Visitor::Known(..))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn changes_of_the_file_are_seen_and_a_broken_file_lets_nobody_in() {
        let data = std::env::temp_dir().join(format!("isophote-keyring-{}", std::process::id()));
        let file = TokenFile::of(None, Some(&data)).unwrap();
        let (record, secret) = file.add(Role::Operate, None).unwrap();
        let keyring = Keyring::open(file.clone()).unwrap();
        let name = || keyring.identify(&secret).map(|identity| identity.name().to_string());
        assert_eq!(name(), Some(record.name.clone()));
        assert!(keyring.identify(&Secret::random().unwrap()).is_none());
        let seen = keyring.look(None);
        std::fs::write(file.path(), "{").unwrap();
        assert_eq!(name(), Some(record.name.clone()), "not looked yet");
        let seen = keyring.look(seen);
        assert_eq!(name(), None);
        std::fs::remove_file(file.path()).unwrap();
        let (_, other) = file.add(Role::View, None).unwrap();
        let seen = keyring.look(seen);
        assert_eq!(keyring.identify(&other).unwrap().role(), Role::View);
        file.revoke("view-1").unwrap();
        keyring.look(seen);
        assert_eq!(keyring.len(), 0);
        std::fs::remove_dir_all(&data).unwrap();
    }
}
