//! `CompileBudget`: a token bucket that limits the compilations of each tenant.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use axum::http::Method;

use crate::limits::LIMITS;

/// Buckets by tenant; unknown tenants have full ones.
#[derive(Default)]
pub struct CompileBudget(Mutex<BTreeMap<String, Bucket>>);

struct Bucket {
    left: f64,
    seen: Instant,
}

impl CompileBudget {
    /// Takes one token, if there is one.
    pub fn take(&self, tenant: &str, now: Instant) -> bool {
        let most = f64::from(LIMITS.compiles_a_minute);
        let mut buckets = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let bucket = buckets.entry(tenant.to_string()).or_insert(Bucket { left: most, seen: now });
        let filled = bucket.left + most / 60.0 * now.saturating_duration_since(bucket.seen).as_secs_f64();
        bucket.seen = now;
        let is_one_left = filled >= 1.0;
        bucket.left = filled.min(most) - if is_one_left { 1.0 } else { 0.0 };
        is_one_left
    }
}

/// Whether a route derives and compiles a new model. Sessions and swaps use kernels of models in the registry.
pub fn is_compiling(method: &Method, route: &str) -> bool {
    matches!(
        (method.as_str(), route),
        ("PUT", "/v1/models/{name}") | ("POST", "/v1/models:check") | ("GET" | "HEAD", "/v1/models/{name}/explain")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn the_bucket_refills_over_time() {
        let (budget, start) = (CompileBudget::default(), Instant::now());
        let taken = |tenant: &str, s: u64, tries: u32| {
            (0..tries).filter(|_| budget.take(tenant, start + Duration::from_secs(s))).count() as u32
        };
        let most = LIMITS.compiles_a_minute;
        assert_eq!(taken("a", 0, most - 1), most - 1);
        assert_eq!(taken("a", 0, 3), 1);
        assert_eq!(taken("b", 0, 1), 1, "another's is another's");
        assert_eq!(taken("a", 1, 1), 0);
        assert_eq!(taken("a", 2, 2), 1);
        assert_eq!(taken("a", 1, 1), 0, "a clock that is read late gives nothing");
        assert_eq!(taken("a", 3600, 2 * most), most);
    }
}
