//! `/metrics` is valid Prometheus text, and counts events.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::json;

use crate::client::{Running, session};

/// A metric family.
struct Family {
    kind: String,
    /// Name suffix, labels and value of each sample, in order.
    samples: Vec<(String, BTreeMap<String, String>, f64)>,
}

/// Parses text format 0.0.4 strictly: help, type, samples, each family contiguous.
fn parse(text: &str) -> BTreeMap<String, Family> {
    let mut families: BTreeMap<String, Family> = BTreeMap::new();
    let (mut lines, mut seen) = (text.lines().peekable(), BTreeSet::new());
    assert!(text.ends_with('\n'));
    while let Some(line) = lines.next() {
        let help = line.strip_prefix("# HELP ").unwrap_or_else(|| panic!("no help: {line}"));
        let (name, help) = help.split_once(' ').unwrap();
        assert!(help.len() > 5 && is_name(name), "{line}");
        let kind = lines.next().unwrap().strip_prefix(&format!("# TYPE {name} ")).unwrap().to_string();
        assert!(["counter", "gauge", "histogram"].contains(&kind.as_str()), "{kind}");
        let mut samples = Vec::new();
        while let Some(line) = lines.next_if(|line| !line.starts_with('#')) {
            let (head, value) = line.rsplit_once(' ').unwrap();
            let (sample, labels) =
                head.split_once('{').map_or((head, ""), |(sample, rest)| (sample, rest.strip_suffix('}').unwrap()));
            assert!(seen.insert(head.to_string()), "twice: {head}");
            let suffix = sample.strip_prefix(name).unwrap_or_else(|| panic!("{line} under {name}"));
            let suffixes: &[&str] = if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
            assert!(suffixes.contains(&suffix), "{line}");
            samples.push((suffix.to_string(), read_labels(labels), value.parse().unwrap()));
        }
        assert!(families.insert(name.to_string(), Family { kind, samples }).is_none(), "{name} is in two pieces");
    }
    families
}

fn is_name(name: &str) -> bool {
    name.starts_with("isophote_") && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_')
}

/// Parses labels; no value here needs escapes.
fn read_labels(text: &str) -> BTreeMap<String, String> {
    let pairs = text.split(',').filter(|pair| !pair.is_empty());
    pairs
        .map(|pair| {
            let (name, value) = pair.split_once('=').unwrap();
            (name.to_string(), value.strip_prefix('"').unwrap().strip_suffix('"').unwrap().to_string())
        })
        .collect()
}

/// Buckets of a histogram grow up to its count, for each set of labels.
fn check_histogram(name: &str, family: &Family) {
    let mut series: BTreeMap<BTreeMap<String, String>, Vec<(f64, f64)>> = BTreeMap::new();
    for (suffix, labels, value) in &family.samples {
        let mut labels = labels.clone();
        match suffix.as_str() {
            "_bucket" => {
                let bound: f64 = labels.remove("le").unwrap().replace("+Inf", "inf").parse().unwrap();
                series.entry(labels).or_default().push((bound, *value));
            }
            "_count" => assert_eq!(series[&labels].last(), Some(&(f64::INFINITY, *value)), "{name}"),
            _ => assert!(value.is_finite(), "{name}"),
        }
    }
    for parts in series.values() {
        assert!(parts.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 <= pair[1].1), "{name}: {parts:?}");
    }
}

struct Metrics(BTreeMap<String, Family>);

impl Metrics {
    fn of(service: &Running) -> Metrics {
        let answer = service.get("/metrics");
        assert_eq!((answer.status, answer.media.as_str()), (200, "text/plain; version=0.0.4; charset=utf-8"));
        let families = parse(&answer.text);
        for (name, family) in &families {
            match family.kind.as_str() {
                "histogram" => check_histogram(name, family),
                "counter" => assert!(name.ends_with("_total"), "{name}"),
                _ => assert!(!name.ends_with("_total"), "{name}"),
            }
        }
        Metrics(families)
    }

    fn value(&self, name: &str, suffix: &str, label: Option<(&str, &str)>) -> f64 {
        let is_it = |labels: &BTreeMap<String, String>| {
            label.is_none_or(|(name, value)| labels.get(name).is_some_and(|v| v == value))
        };
        let found = self.0[name].samples.iter().find(|(s, labels, _)| s == suffix && is_it(labels));
        found.unwrap_or_else(|| panic!("{name}{suffix} {label:?}")).2
    }

    fn sessions(&self) -> BTreeSet<String> {
        let samples = self.0.values().flat_map(|family| &family.samples);
        samples.filter_map(|(_, labels, _)| labels.get("session").cloned()).collect()
    }
}

#[test]
fn events_are_counted() {
    let service = Running::start();
    let empty = Metrics::of(&service);
    assert!(empty.sessions().is_empty());
    assert_eq!(empty.value("isophote_ready", "", None), 1.0);
    assert!(empty.value("isophote_sockets", "", None) >= 1.0);

    service.put("/v1/sessions/one", &session("fit", 0.0)).expect(201);
    service.put("/v1/sessions/two", &session("realtime", 60.0)).expect(201);
    service.wait_for("one", |view| view["frames"].as_u64() >= Some(30));
    let mut all = service.socket("one", "mode=all");
    all.next().unwrap();
    let swap = service.put("/v1/sessions/one/model", &json!({"model": "gaussian"})).expect(200);
    assert_eq!(swap["active_model"], "gaussian");
    service.put("/v1/sessions/two/model", &json!({"model": "no-such"})).expect(404);

    let frames = service.get("/v1/sessions/one").expect(200)["frames"].as_f64().unwrap();
    let now = Metrics::of(&service);
    assert_eq!(now.sessions(), ["one", "two"].map(String::from).into());
    let one = Some(("session", "one"));
    let counted = now.value("isophote_frames_total", "", one);
    assert!(counted >= frames, "{counted} of {frames}");
    assert_eq!(now.value("isophote_swaps_total", "", one), 1.0);
    assert_eq!(now.value("isophote_swaps_total", "", Some(("session", "two"))), 0.0);
    for name in ["isophote_fit_seconds", "isophote_frame_age_seconds", "isophote_reduced_chi_square"] {
        assert!(now.value(name, "_count", one) > 0.0, "{name}");
    }
    for name in ["isophote_fit_iterations", "isophote_saturated_ratio", "isophote_search_seconds"] {
        assert!(now.value(name, "_count", one) > 0.0, "{name}");
    }
    assert!(now.value("isophote_fit_seconds", "_sum", one) > 0.0);
    // Two sessions and a swap.
    assert_eq!(now.value("isophote_compile_seconds", "_count", None), 3.0);
    assert_eq!(now.value("isophote_subscribers", "", one), 1.0);
    assert!(now.value("isophote_ring_bytes", "", one) > 0.0);
    let sum: f64 = now.0["isophote_sessions"].samples.iter().map(|(_, _, value)| value).sum();
    assert_eq!(sum, 2.0);
    assert!(now.value("isophote_kernels", "", None) > 0.0);

    // Series of ended sessions disappear.
    service.delete("/v1/sessions/one").expect(204);
    assert_eq!(Metrics::of(&service).sessions(), ["two".to_string()].into());
}
