//! Checks `Host` and `Origin` of a request.
//!
//! Any page that a user has open can make the browser send requests. So the `Host` must be a name of this service (against DNS
//! rebinding, 421), and an `Origin` must be its own (else a foreign page, 403).

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::str::FromStr;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};

use crate::problem::Problem;

/// The local end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LocalAddress {
    /// The address of this machine that was connected to.
    pub local: IpAddr,
}

/// Scheme of the service's pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// No encryption: loopback.
    Http,
    /// The service encrypts.
    Https,
    /// A proxy may encrypt.
    Either,
}

/// A host name of the service, optionally for one port only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostName {
    name: String,
    port: Option<u16>,
}

impl FromStr for HostName {
    type Err = String;
    fn from_str(text: &str) -> Result<HostName, String> {
        let wrong =
            || format!("`{text}` is no host: NAME or NAME:PORT, as browsers write it (international names as xn--…)");
        let (name, port) = split(text).ok_or_else(wrong)?;
        let is_plain = |c: char| c.is_ascii_alphanumeric() || ".-_[]:".contains(c);
        if name.is_empty() || !name.chars().all(is_plain) {
            return Err(wrong());
        }
        Ok(HostName { name: name.to_string(), port })
    }
}

/// Host names of the service.
#[derive(Clone, Debug)]
pub struct Hosts {
    /// Names besides the local address of the connection.
    pub names: Vec<HostName>,
    /// Scheme of the service's own pages.
    pub scheme: Scheme,
}

impl Hosts {
    /// Refuses a foreign `Host` or `Origin`.
    pub fn check(&self, arrival: LocalAddress, authority: Option<&str>, headers: &HeaderMap) -> Result<(), Problem> {
        let text = |name| headers.get(name).map(|value: &HeaderValue| value.to_str().unwrap_or_default());
        let host = authority.or(text(header::HOST)).unwrap_or_default();
        let is_one = |name| headers.get_all(name).iter().count() <= 1;
        if !is_one(header::HOST) || !self.is_ours(host, arrival.local.to_canonical()) {
            return Err(foreign_host(arrival));
        }
        match text(header::ORIGIN) {
            Some(origin) if !is_one(header::ORIGIN) || !self.is_own_page(origin, host) => {
                let detail = "the request comes from a page of another origin";
                Err(Problem::new(StatusCode::FORBIDDEN, "foreign-origin", detail))
            }
            _ => Ok(()),
        }
    }

    fn is_ours(&self, host: &str, local: IpAddr) -> bool {
        let Some((name, port)) = split(host) else { return false };
        let address = match name.strip_prefix('[') {
            Some(inner) => inner.trim_end_matches(']').parse::<Ipv6Addr>().ok().map(IpAddr::V6),
            None => name.parse::<Ipv4Addr>().ok().map(IpAddr::V4),
        };
        let is_loopback = || address.map_or(name.eq_ignore_ascii_case("localhost"), |address| address.is_loopback());
        let is_named = |known: &HostName| {
            known.name.eq_ignore_ascii_case(name) && known.port.is_none_or(|known| port == Some(known))
        };
        address == Some(local) || local.is_loopback() && is_loopback() || self.names.iter().any(is_named)
    }

    fn is_own_page(&self, origin: &str, host: &str) -> bool {
        let schemes: &[&str] = match self.scheme {
            Scheme::Http => &["http://"],
            Scheme::Https => &["https://"],
            Scheme::Either => &["http://", "https://"],
        };
        let authority = schemes.iter().find_map(|scheme| origin.strip_prefix(scheme));
        authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
    }
}

fn foreign_host(arrival: LocalAddress) -> Problem {
    let detail = match arrival.local.to_canonical().is_loopback() {
        true => {
            "the Host of a request must be localhost, an address of 127.0.0.0/8, or [::1]; `--host NAME` adds a name"
        }
        false => {
            "the Host of a request must be the address that it is sent to; `--host NAME` of the service adds a name"
        }
    };
    Problem::new(StatusCode::MISDIRECTED_REQUEST, "foreign-host", detail)
}

/// Name (an IPv6 address in its brackets) and port.
fn split(host: &str) -> Option<(&str, Option<u16>)> {
    let end = match host.strip_prefix('[') {
        Some(rest) => rest.find(']')? + 2,
        None => host.find(':').unwrap_or(host.len()),
    };
    let (name, port) = host.split_at(end);
    match port.strip_prefix(':') {
        None => port.is_empty().then_some((name, None)),
        Some(digits) if digits.starts_with('+') => None,
        Some(digits) => Some((name, Some(digits.parse().ok()?))),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    type Case<'a> = (&'a str, Option<&'a str>, u16);

    fn check(hosts: &Hosts, local: &str, cases: &[Case]) {
        let arrival = LocalAddress { local: local.parse().unwrap() };
        for (host, origin, status) in cases {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_bytes(host.as_bytes()).unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, HeaderValue::from_bytes(origin.as_bytes()).unwrap());
            }
            let found = hosts.check(arrival, None, &headers).map_or_else(|problem| problem.status.as_u16(), |()| 200);
            assert_eq!(found, *status, "{host} {origin:?} at {local}");
        }
        let none = hosts.check(arrival, None, &HeaderMap::new()).unwrap_err();
        assert_eq!(none.status, StatusCode::MISDIRECTED_REQUEST);
    }

    #[test]
    fn hosts_and_origins_on_loopback() {
        let cases: &[Case] = &[
            ("localhost", None, 200),
            ("LocalHost:7240", None, 200),
            ("127.0.0.1:1", None, 200),
            ("[::1]:7240", None, 200),
            ("127.0.0.2:7240", Some("http://127.0.0.2:7240"), 200),
            ("127.255.1.2", None, 200),
            ("[::1]", Some("http://[::1]"), 200),
            ("localhost:7240", Some("http://localhost:7240"), 200),
            ("localhost:7240", Some("http://localhost:3000"), 403),
            ("localhost:7240", Some("https://localhost:7240"), 403),
            ("localhost:7240", Some("http://evil.example"), 403),
            ("localhost:7240", Some("http://localhost:7240.evil.example"), 403),
            ("localhost:7240", Some("null"), 403),
            ("localhost:7240", Some(""), 403),
            ("evil.example", None, 421),
            ("evil.example", Some("http://evil.example"), 421),
            ("localhost.evil.example", None, 421),
            ("127.0.0.1.evil.example", None, 421),
            ("localhost:7240@evil.example", None, 421),
            ("localhost:x", None, 421),
            ("localhost:+1", None, 421),
            ("localhost:", None, 421),
            ("::1", None, 421),
            ("128.0.0.1", None, 421),
            ("127.1", None, 421),
            ("0127.0.0.1", None, 421),
            ("127.0.0.1.", None, 421),
            ("[::2]", None, 421),
            ("[::1", None, 421),
            ("[localhost]", None, 421),
            ("0.0.0.0", None, 421),
            ("", None, 421),
        ];
        check(&Hosts { names: Vec::new(), scheme: Scheme::Http }, "127.0.0.1", cases);
    }

    #[test]
    fn hosts_and_origins_off_loopback() {
        let names = ["fits.example", "Lab.example:8443", "xn--lnse-4qa.example", "[2001:db8::7]", "10.9.9.9"];
        let names = names.iter().map(|name| name.parse().unwrap()).collect();
        let hosts = Hosts { names, scheme: Scheme::Https };
        let cases: &[Case] = &[
            ("192.0.2.5:7240", None, 200),
            ("192.0.2.5", Some("https://192.0.2.5"), 200),
            ("192.0.2.5:7240", Some("https://192.0.2.5:7240"), 200),
            ("192.0.2.5:7240", Some("http://192.0.2.5:7240"), 403),
            ("192.0.2.5:7240", Some("https://192.0.2.5"), 403),
            ("192.0.2.5:7240", Some("https://192.0.2.6:7240"), 403),
            ("192.0.2.5:7240", Some("null"), 403),
            ("192.0.2.5:7240", Some(""), 403),
            ("192.0.2.5:7240", Some("https://evil.example"), 403),
            ("192.0.2.5:7240", Some("https://192.0.2.5:7240.evil.example"), 403),
            ("192.0.2.5:7240", Some("https://user@192.0.2.5:7240"), 403),
            ("192.0.2.5:7240", Some("https://192.0.2.5:7240/"), 403),
            ("192.0.2.5:7240", Some("file://"), 403),
            ("192.0.2.5:7240", Some("moz-extension://192.0.2.5:7240"), 403),
            ("fits.example", None, 200),
            ("FITS.Example:443", None, 200),
            ("fits.example:7240", Some("https://FITS.example:7240"), 200),
            ("fits.example", Some("https://fits.example."), 403),
            ("fits.example", Some("https://lab.example"), 403),
            ("lab.example:8443", None, 200),
            ("lab.example:8444", None, 421),
            ("lab.example", None, 421),
            ("xn--lnse-4qa.example", None, 200),
            ("länse.example", None, 421),
            ("xn--lnse-4qa.example", Some("https://länse.example"), 403),
            ("[2001:db8::7]", None, 200),
            ("[2001:db8::8]", None, 421),
            ("10.9.9.9", None, 200),
            ("localhost", None, 421),
            ("127.0.0.1:7240", None, 421),
            ("[::1]", None, 421),
            ("192.0.2.6", None, 421),
            ("0.0.0.0:7240", None, 421),
            ("192.0.2.5.evil.example", None, 421),
            ("fits.example.evil.example", None, 421),
            ("evil-fits.example", None, 421),
            ("fits.example.", None, 421),
            ("user@fits.example", None, 421),
            ("fits.example:", None, 421),
            ("fits.example:99999", None, 421),
            ("fits.example, fits.example", None, 421),
            ("3221225989", None, 421),
            ("0xc0.0.2.5", None, 421),
            ("", None, 421),
        ];
        check(&hosts, "192.0.2.5", cases);
        check(&hosts, "::ffff:192.0.2.5", cases);
        let either = Hosts { scheme: Scheme::Either, ..hosts };
        let behind_a_proxy: &[Case] = &[
            ("fits.example", Some("https://fits.example"), 200),
            ("fits.example", Some("http://fits.example"), 200),
            ("fits.example", Some("ftp://fits.example"), 403),
        ];
        check(&either, "192.0.2.5", behind_a_proxy);
    }

    #[test]
    fn duplicate_headers_are_rejected() {
        let hosts = Hosts { names: Vec::new(), scheme: Scheme::Http };
        let arrival = LocalAddress { local: "127.0.0.1".parse().unwrap() };
        for (name, status) in [(header::HOST, 421), (header::ORIGIN, 403)] {
            let mut headers = HeaderMap::new();
            headers.append(header::HOST, "localhost".parse().unwrap());
            headers.append(header::ORIGIN, "http://localhost".parse().unwrap());
            hosts.check(arrival, None, &headers).unwrap();
            headers.append(&name, headers[&name].clone());
            assert_eq!(hosts.check(arrival, None, &headers).unwrap_err().status, status, "{name}");
        }
    }

    #[test]
    fn host_names_are_parsed() {
        for good in ["a.example", "a.example:1", "localhost", "10.0.0.1", "[::1]:7240", "xn--lnse-4qa.example"] {
            assert!(good.parse::<HostName>().is_ok(), "{good}");
        }
        for bad in ["", ":1", "a:b", "a/b", "https://a.example", "*", "länse.example", "a b", "a@b", "::1"] {
            assert!(bad.parse::<HostName>().is_err(), "{bad}");
        }
    }
}
