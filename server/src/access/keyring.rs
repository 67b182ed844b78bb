//! `Keyring`: the valid tokens, reloaded when their file changes. Open streams learn here that their token is revoked.

use std::sync::Arc;

use subtle::ConstantTimeEq;
use tokio::sync::watch;

use super::budget::CompileBudget;
use super::file::{DEFAULT_TENANT, TokenError, TokenFile, TokenRecord};
use super::roles::Role;
use super::stamp::{FileStamp, follow, stamp};
use super::token::Secret;

/// The tokens of a file, reloaded on change.
pub struct Keyring {
    file: TokenFile,
    tokens: watch::Sender<Arc<[TokenRecord]>>,
    /// Compile budget of every tenant.
    pub compiles: CompileBudget,
}

impl Keyring {
    /// Reads the file.
    pub fn open(file: TokenFile) -> Result<Keyring, TokenError> {
        let tokens = file.read()?.into();
        Ok(Keyring { file, tokens: watch::Sender::new(tokens), compiles: CompileBudget::default() })
    }

    /// Number of tokens.
    pub fn len(&self) -> usize {
        self.tokens.borrow().len()
    }

    /// Tenants of all tokens, with duplicates.
    pub fn tenants(&self) -> Vec<String> {
        self.tokens.borrow().iter().map(|token| token.tenant.clone()).collect()
    }

    /// The owner of a token. Compares with all tokens in constant time.
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

    /// Reloads the file on change, for as long as this is polled. While it cannot be read no token is valid: one of them may
    /// have been revoked.
    pub async fn follow(self: Arc<Keyring>) {
        follow(self, None, Keyring::look).await;
    }

    fn look(&self, seen: Option<FileStamp>) -> Option<FileStamp> {
        let stamp = stamp(self.file.path());
        if seen == Some(stamp) {
            return seen;
        }
        // A failed read is retried at the next check.
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

/// The owner of a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenOwner(TokenRecord);

impl TokenOwner {
    /// Its role.
    pub fn role(&self) -> Role {
        self.0.role
    }

    /// Its tenant.
    pub fn tenant(&self) -> &str {
        &self.0.tenant
    }

    /// The token's name.
    pub fn name(&self) -> &str {
        &self.0.name
    }
}

/// The sender of a request.
#[derive(Clone)]
pub enum Visitor {
    /// A sender without a token: on loopback, or of a public route.
    Anyone,
    /// The owner of a token.
    Known(TokenOwner, Arc<Keyring>),
}

impl Visitor {
    /// Resolves when the token is revoked or changed; never without a token.
    pub async fn revoked(&self) {
        let Visitor::Known(TokenOwner(token), keyring) = self else { return std::future::pending().await };
        let mut tokens = keyring.tokens.subscribe();
        // No error: the keyring is held here.
        tokens.wait_for(|tokens| !tokens.contains(token)).await.ok();
    }

    /// Whether it operates the machine: with a token of the default tenant, or without one.
    pub fn is_operator(&self) -> bool {
        match self {
            Visitor::Anyone => true,
            Visitor::Known(owner, _) => owner.tenant() == DEFAULT_TENANT,
        }
    }

    /// Whether it has a token.
    pub fn is_known(&self) -> bool {
        matches!(self, Visitor::Known(..))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_reloaded_and_a_malformed_file_admits_nobody() {
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
