//! `Exposition`: writes metrics in Prometheus' text format 0.0.4.
//!
//! Each family has its help and type, and its samples are contiguous.

use std::fmt::Write;

use crate::counters::{Distribution, Histogram};

/// The media type of the text.
pub const MEDIA: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The text so far.
#[derive(Default)]
pub struct Exposition {
    text: String,
}

/// A metric family, to which samples are added.
pub struct Family<'a> {
    text: &'a mut String,
    name: &'static str,
}

/// A label's name and value.
pub type LabelPair<'a> = (&'static str, &'a str);

impl Exposition {
    /// Begins a counter; its name ends in `_total`.
    pub fn counter(&mut self, name: &'static str, help: &str) -> Family<'_> {
        self.family(name, "counter", help)
    }

    /// Begins a gauge.
    pub fn gauge(&mut self, name: &'static str, help: &str) -> Family<'_> {
        self.family(name, "gauge", help)
    }

    /// Begins a histogram.
    pub fn histogram(&mut self, name: &'static str, help: &str) -> Family<'_> {
        self.family(name, "histogram", help)
    }

    /// The whole text.
    pub fn text(self) -> String {
        self.text
    }

    fn family(&mut self, name: &'static str, kind: &str, help: &str) -> Family<'_> {
        let help = help.replace('\\', "\\\\").replace('\n', "\\n");
        self.text += &format!("# HELP {name} {help}\n# TYPE {name} {kind}\n");
        Family { text: &mut self.text, name }
    }
}

impl Family<'_> {
    /// Adds one sample.
    pub fn sample(&mut self, labels: &[LabelPair], value: f64) {
        self.line("", labels, value);
    }

    /// Adds the buckets, sum and count of a histogram.
    pub fn distribution(&mut self, labels: &[LabelPair], histogram: &Histogram) {
        let Distribution { up_to, count, sum } = histogram.distribution();
        for (bound, below) in up_to {
            self.bucket(labels, &bound.to_string(), below);
        }
        self.bucket(labels, "+Inf", count);
        self.line("_sum", labels, sum);
        self.line("_count", labels, count as f64);
    }

    fn bucket(&mut self, labels: &[LabelPair], bound: &str, count: u64) {
        let labels: Vec<LabelPair> = labels.iter().copied().chain([("le", bound)]).collect();
        self.line("_bucket", &labels, count as f64);
    }

    fn line(&mut self, suffix: &str, labels: &[LabelPair], value: f64) {
        let labels: Vec<String> = labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escaped(value))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        // Writing to a string cannot fail.
        writeln!(self.text, "{}{suffix}{labels} {value}", self.name).ok();
    }
}

fn escaped(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::counters::ServiceCounters;

    #[test]
    fn labels_and_help_are_escaped() {
        let mut all = Exposition::default();
        let mut family = all.gauge("a_bytes", "one\\two\nthree");
        family.sample(&[("name", "a\"b\\c\nd"), ("more", "ü")], 1.5);
        family.sample(&[], 3.0);
        let expected = "# HELP a_bytes one\\\\two\\nthree\n# TYPE a_bytes gauge\n\
                        a_bytes{name=\"a\\\"b\\\\c\\nd\",more=\"ü\"} 1.5\na_bytes 3\n";
        assert_eq!(all.text(), expected);
    }

    #[test]
    fn a_histogram_ends_with_the_inf_bucket_sum_and_count() {
        let counters = ServiceCounters::default();
        counters.compile_s.observe(0.003);
        counters.compile_s.observe(100.0);
        let mut all = Exposition::default();
        all.histogram("a_seconds", "h").distribution(&[("s", "x")], &counters.compile_s);
        let text = all.text();
        assert!(text.contains("a_seconds_bucket{s=\"x\",le=\"0.002\"} 0\na_seconds_bucket{s=\"x\",le=\"0.005\"} 1\n"));
        assert!(text.ends_with(
            "a_seconds_bucket{s=\"x\",le=\"+Inf\"} 2\na_seconds_sum{s=\"x\"} 100.003\na_seconds_count{s=\"x\"} 2\n"
        ));
    }
}
