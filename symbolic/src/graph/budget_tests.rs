//! Sharing of a document's budget.

use super::*;

#[test]
fn clones_share_one_budget() {
    let mut one = Budget::after(LIMITS.work - 10);
    let mut other = one.clone();
    assert!(one.charge(10) && !one.is_spent(), "at the limit");
    drop(one);
    assert!(other.charge(1) && other.is_spent(), "past the limit, but not yet told");
    assert!(!other.charge(UNTOLD));
    assert!(!Budget::default().is_spent(), "another document");
    let kept = Budget::default();
    assert!(kept.keep(LIMITS.kept) && !kept.clone().keep(1));
}
