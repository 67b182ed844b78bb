//! `Secret`: a token of 256 random bits, whose text is shown once and of which only a digest is stored.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sha2::{Digest as _, Sha256};
use subtle::{Choice, ConstantTimeEq};

/// Makes tokens recognisable where they should not be: in files, addresses and logs.
const PREFIX: &str = "isophote_";
/// Prefix of a token among a WebSocket's subprotocols: browsers let pages set no other header.
pub const WEBSOCKET_PREFIX: &str = "isophote.token.";

/// A token. Without `Debug`, so that no message includes it by accident.
pub struct Secret([u8; 32]);

impl Secret {
    /// A new token.
    ///
    /// # Errors
    /// The system has no random bits.
    pub fn random() -> Result<Secret, getrandom::Error> {
        let mut bits = [0; 32];
        getrandom::fill(&mut bits)?;
        Ok(Secret(bits))
    }

    /// Parses `isophote_` and 64 digits, nothing else.
    pub fn parse(text: &str) -> Option<Secret> {
        text.strip_prefix(PREFIX).and_then(bits).map(Secret)
    }

    /// The text, to be shown once.
    pub fn text(&self) -> String {
        format!("{PREFIX}{}", digits(&self.0))
    }

    /// sha256 of the text: `printf %s "$token" | sha256sum`.
    pub fn digest(&self) -> Digest {
        Digest(Sha256::digest(self.text()).into())
    }

    /// Whether a text contains a token's prefix, percent-encoded or not.
    pub fn is_in(text: &str) -> bool {
        let mut plain = Vec::new();
        let mut rest = text.as_bytes();
        while let Some((first, behind)) = rest.split_first() {
            let encoded = behind.get(..2).filter(|_| *first == b'%').and_then(|pair| std::str::from_utf8(pair).ok());
            let encoded = encoded.and_then(|pair| u8::from_str_radix(pair, 16).ok());
            plain.push(encoded.unwrap_or(*first).to_ascii_lowercase());
            rest = if encoded.is_some() { &behind[2..] } else { behind };
        }
        plain.windows(PREFIX.len()).any(|part| part == PREFIX.as_bytes())
    }
}

/// The stored digest of a token: verifies it without revealing it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Digest([u8; 32]);

impl ConstantTimeEq for Digest {
    fn ct_eq(&self, other: &Digest) -> Choice {
        self.0.ct_eq(&other.0)
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&digits(&self.0))
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Digest, D::Error> {
        let text = String::deserialize(deserializer)?;
        bits(&text).map(Digest).ok_or_else(|| serde::de::Error::custom("a sha256 has 64 digits of 0-9 and a-f"))
    }
}

fn digits(bits: &[u8; 32]) -> String {
    bits.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bits(digits: &str) -> Option<[u8; 32]> {
    let is_plain = digits.bytes().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
    let mut bits = [0; 32];
    if digits.len() != 64 || !is_plain {
        return None;
    }
    for (place, pair) in bits.iter_mut().zip(digits.as_bytes().chunks(2)) {
        *place = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(bits)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_token_round_trips_and_its_digest_is_sha256() {
        let secret = Secret::random().unwrap();
        let text = secret.text();
        assert_eq!(text.len(), PREFIX.len() + 64);
        assert_eq!(Secret::parse(&text).unwrap().digest(), secret.digest());
        assert_ne!(Secret::random().unwrap().digest(), secret.digest());
        // printf %s isophote_0…0 | sha256sum
        let zeros = Secret::parse(&format!("{PREFIX}{}", "0".repeat(64))).unwrap();
        let expected = "\"ea7a32d86a3fa26db32d21fd6167f4b87e620b8d11496b13e3f5146586e174e6\"";
        assert_eq!(serde_json::to_string(&zeros.digest()).unwrap(), expected);
        let (digit, big) = (format!("{PREFIX}{}", "0".repeat(63)), format!("{PREFIX}{}", "A".repeat(64)));
        for wrong in ["", "isophote_", &text[1..], &digit, &big, &format!("{text} "), &format!("{text}0")] {
            assert!(Secret::parse(wrong).is_none(), "{wrong}");
        }
    }

    #[test]
    fn percent_encoded_tokens_are_found() {
        for with in ["?token=isophote_ab", "/v1/models/isophote_", "?x=Isophote%5Fab", "%69sophote_1", "a%isophote_"] {
            assert!(Secret::is_in(with), "{with}");
        }
        for without in ["", "/", "/v1/isophote", "?mode=all&credit=8", "%69sophote%", "isophote%255F", "isophote-1"] {
            assert!(!Secret::is_in(without), "{without}");
        }
    }
}
