//! `Preconditions`: evaluates `If-Match` and `If-None-Match` (RFC 9110, section 13). No other module reads these headers.
//!
//! The code that makes a change checks them under the same lock or on the same thread, so that of two writers with one tag one
//! wins.

use std::fmt::{self, Display, Formatter};
use std::sync::atomic::{AtomicU64, Ordering};

use axum::extract::{FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use isophote_machine::unix_ms;
use sha2::{Digest, Sha256};

use crate::problem::Problem;

/// Bytes of a digest in a tag, or in the key of a model's text: 64 bits, which no two representations of one name share by
/// chance.
const DIGEST_BYTES: usize = 8;

/// A strong entity tag, without its quotes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EntityTag(String);

impl EntityTag {
    /// A tag of visible ASCII characters without `"`.
    pub fn new(opaque: impl Display) -> EntityTag {
        EntityTag(opaque.to_string())
    }

    /// The digest of a representation's bytes as its tag.
    pub fn of_bytes(bytes: &[u8]) -> EntityTag {
        EntityTag(digest(bytes))
    }

    /// A tag that is used once.
    pub fn unique() -> EntityTag {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        // The time distinguishes starts of the service, the number the tags of one start.
        EntityTag(format!("{:x}-{:x}", unix_ms(), NEXT.fetch_add(1, Ordering::Relaxed)))
    }

    /// The value of the `ETag` header.
    pub fn header(&self) -> Result<HeaderValue, Problem> {
        HeaderValue::from_str(&format!("\"{}\"", self.0)).map_err(|error| Problem::bug(error.to_string()))
    }
}

impl Display for EntityTag {
    fn fmt(&self, formatter: &mut Formatter) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

/// The beginning of the SHA-256 of these bytes, in hexadecimal digits.
pub fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().take(DIGEST_BYTES).map(|byte| format!("{byte:02x}")).collect()
}

/// A tag as a client sends it.
#[derive(Clone, Debug, PartialEq, Eq)]
struct SentTag {
    is_weak: bool,
    opaque: Vec<u8>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum TagList {
    /// `*`
    Any,
    Tags(Vec<SentTag>),
}

impl TagList {
    /// Parses all header lines of that name. Refuses a malformed list: ignoring it would make a conditional change
    /// unconditional.
    fn of(headers: &HeaderMap, name: &HeaderName) -> Result<Option<TagList>, Problem> {
        let lines: Vec<&[u8]> = headers.get_all(name).iter().map(HeaderValue::as_bytes).collect();
        if lines.is_empty() {
            return Ok(None);
        }
        let list = TagList::parse(&lines.join(&b','));
        let wrong = || {
            let detail = format!(
                "{name} is `*` or entity tags in quotes, separated by commas, such as \"1f-3a\", as ETag has them"
            );
            Problem::bad_request(detail)
        };
        list.map(Some).ok_or_else(wrong)
    }

    fn parse(text: &[u8]) -> Option<TagList> {
        if text.trim_ascii() == b"*" {
            return Some(TagList::Any);
        }
        let (mut rest, mut tags) = (text, Vec::new());
        loop {
            rest = rest.trim_ascii_start();
            while let Some(after) = rest.strip_prefix(b",") {
                rest = after.trim_ascii_start();
            }
            if rest.is_empty() {
                return (!tags.is_empty()).then_some(TagList::Tags(tags));
            }
            let is_weak = rest.starts_with(b"W/");
            let quoted = rest.strip_prefix(b"W/").unwrap_or(rest).strip_prefix(b"\"")?;
            let length = quoted.iter().position(|byte| *byte == b'"')?;
            let (opaque, after) = (&quoted[..length], quoted[length + 1..].trim_ascii_start());
            let is_tag = opaque.iter().all(|byte| *byte > b' ' && *byte != 0x7f);
            if !is_tag || !(after.is_empty() || after.starts_with(b",")) {
                return None;
            }
            tags.push(SentTag { is_weak, opaque: opaque.to_vec() });
            rest = after;
        }
    }

    fn has(&self, now: &[EntityTag], comparison: Comparison) -> bool {
        let is_comparable = |sent: &SentTag| comparison == Comparison::Weak || !sent.is_weak;
        let is_one = |sent: &SentTag| is_comparable(sent) && now.iter().any(|tag| tag.0.as_bytes() == sent.opaque);
        match self {
            TagList::Any => !now.is_empty(),
            TagList::Tags(tags) => tags.iter().any(is_one),
        }
    }
}

/// How tags are compared with the server's, which are strong.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Comparison {
    /// Weak tags match nothing.
    Strong,
    /// Weak tags match by their text.
    Weak,
}

/// The part of a representation to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// All of it.
    Whole,
    /// 304: the client has it.
    NotModified,
}

/// The preconditions of a request; none by default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Preconditions {
    if_match: Option<TagList>,
    if_none_match: Option<TagList>,
}

impl Preconditions {
    /// Parses the headers of a request.
    ///
    /// # Errors
    /// 400 if a header is no list of tags.
    pub fn of(headers: &HeaderMap) -> Result<Preconditions, Problem> {
        let if_match = TagList::of(headers, &header::IF_MATCH)?;
        Ok(Preconditions { if_match, if_none_match: TagList::of(headers, &header::IF_NONE_MATCH)? })
    }

    /// The 400 of routes without entity tags.
    pub fn refusal() -> Problem {
        Problem::bad_request("this route has no ETag, so If-Match and If-None-Match cannot be checked: leave them out")
    }

    /// Checks before a change. `now` has the current tags, none if the resource does not exist.
    ///
    /// # Errors
    /// 412.
    pub fn check(&self, what: &str, now: &[EntityTag]) -> Result<(), Problem> {
        self.check_match(what, now)?;
        match &self.if_none_match {
            Some(list) if list.has(now, Comparison::Weak) => {
                let detail =
                    format!("{what} is there already, and If-None-Match asks for a change only where it is not");
                Err(Problem::stale(detail))
            }
            _ => Ok(()),
        }
    }

    /// Checks before an answer with the whole representation of the tag `now`.
    ///
    /// # Errors
    /// 412 if `If-Match` names other tags.
    pub fn read(&self, what: &str, now: &EntityTag) -> Result<Reading, Problem> {
        let now = std::slice::from_ref(now);
        self.check_match(what, now)?;
        let has_it = self.if_none_match.as_ref().is_some_and(|list| list.has(now, Comparison::Weak));
        Ok(if has_it { Reading::NotModified } else { Reading::Whole })
    }

    /// Checks before an answer with state, which changes while the tag `now` does not: a matching tag is no 304.
    /// `If-None-Match: *` still is.
    ///
    /// # Errors
    /// 412 if `If-Match` names other tags.
    pub fn read_state(&self, what: &str, now: Option<&EntityTag>) -> Result<Reading, Problem> {
        self.check_match(what, now.map_or(&[], std::slice::from_ref))?;
        Ok(if self.if_none_match == Some(TagList::Any) { Reading::NotModified } else { Reading::Whole })
    }

    fn check_match(&self, what: &str, now: &[EntityTag]) -> Result<(), Problem> {
        match &self.if_match {
            Some(list) if !list.has(now, Comparison::Strong) => Err(Problem::stale(match now.first() {
                Some(tag) => {
                    format!("{what} was changed: its ETag is \"{}\" now; read it again, and decide anew", tag.0)
                }
                None => format!("{what} is not there any more, or was never there"),
            })),
            _ => Ok(()),
        }
    }
}

impl<S: Sync> FromRequestParts<S> for Preconditions {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Preconditions, Problem> {
        Preconditions::of(&parts.headers)
    }
}

/// Middleware of routes without entity tags: refuses preconditions, since nothing would check them.
pub async fn refused(request: Request, next: Next) -> Response {
    match [header::IF_MATCH, header::IF_NONE_MATCH].iter().any(|name| request.headers().contains_key(name)) {
        true => Preconditions::refusal().into_response(),
        false => next.run(request).await,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn of(name: HeaderName, lines: &[&str]) -> Result<Preconditions, u16> {
        let mut headers = HeaderMap::new();
        for line in lines {
            headers.append(name.clone(), HeaderValue::from_bytes(line.as_bytes()).unwrap());
        }
        Preconditions::of(&headers).map_err(|problem| problem.status.as_u16())
    }

    #[test]
    fn tags_are_compared_per_rfc_9110() {
        let now = [EntityTag::new("a1"), EntityTag::new("7")];
        // The lines of a header, whether If-Match lets a change pass, and whether If-None-Match does.
        let cases: [(&[&str], bool, bool); 11] = [
            (&["*"], true, false),
            (&[" * "], true, false),
            (&["\"a1\""], true, false),
            (&["\"7\""], true, false),
            (&["W/\"a1\""], false, false),
            (&["\"b\", \"a1\""], true, false),
            (&["\"b\"", "\"a1\""], true, false),
            (&[" , \"b\" ,,\t\"c,d\", "], false, true),
            (&["\"b,\", \"a1\""], true, false),
            (&["\"\""], false, true),
            (&["\"ä\""], false, true),
        ];
        for (lines, if_match, if_none_match) in cases {
            let passes = |name| of(name, lines).unwrap().check("it", &now).is_ok();
            assert_eq!(
                (passes(header::IF_MATCH), passes(header::IF_NONE_MATCH)),
                (if_match, if_none_match),
                "{lines:?}"
            );
            // For a missing resource every If-Match fails and every If-None-Match passes.
            let passes = |name| of(name, lines).unwrap().check("it", &[]).is_ok();
            assert_eq!((passes(header::IF_MATCH), passes(header::IF_NONE_MATCH)), (false, true), "{lines:?}");
        }
    }

    #[test]
    fn malformed_tag_lists_are_refused() {
        let wrong: [&[&str]; 12] = [
            &[""],
            &[","],
            &["a1"],
            &["\"a1"],
            &["a1\""],
            &["w/\"a1\""],
            &["W/ \"a1\""],
            &["\"a1\" \"b\""],
            &["\"a 1\""],
            &["*, \"a1\""],
            &["*", "*"],
            &["\"a1\"x"],
        ];
        for lines in wrong {
            for name in [header::IF_MATCH, header::IF_NONE_MATCH] {
                assert_eq!(of(name, lines), Err(400), "{lines:?}");
            }
        }
    }

    #[test]
    fn a_matching_tag_is_no_304_for_stateful_answers() {
        let tag = EntityTag::unique();
        let quoted = tag.header().unwrap().to_str().unwrap().to_string();
        for list in [quoted.clone(), format!("W/{quoted}"), format!("\"b\", {quoted}")] {
            let asked = of(header::IF_NONE_MATCH, &[&list]).unwrap();
            assert_eq!(asked.read("it", &tag).unwrap(), Reading::NotModified, "{list}");
            assert_eq!(asked.read("it", &EntityTag::unique()).unwrap(), Reading::Whole, "{list}");
            assert_eq!(asked.read_state("it", Some(&tag)).unwrap(), Reading::Whole, "{list}");
        }
        let any = of(header::IF_NONE_MATCH, &["*"]).unwrap();
        assert_eq!(any.read_state("it", Some(&tag)).unwrap(), Reading::NotModified);
        let asked = of(header::IF_MATCH, &[&quoted]).unwrap();
        assert_eq!(asked.read("it", &tag).unwrap(), Reading::Whole);
        assert_eq!(asked.read("it", &EntityTag::unique()).unwrap_err().status.as_u16(), 412);
        assert_eq!(asked.read_state("it", None).unwrap_err().status.as_u16(), 412);
    }
}
