//! Pages of lists: `?limit=100&after=NAME`. Without parameters a list is whole.

use axum::extract::Query;
use axum::extract::rejection::QueryRejection;
use isophote_wire::Items;
use serde::{Deserialize, Serialize};
use utoipa::IntoParams;

use crate::limits::LIMITS;
use crate::problem::Problem;

/// A page of a list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageQuery {
    /// Maximum number of items, 1 to 1000; all items when absent.
    limit: Option<usize>,
    /// Name after which the page begins: `next` of the previous page.
    after: Option<String>,
}

/// The query as it was sent.
pub type RawPage = Result<Query<PageQuery>, QueryRejection>;

/// A page of `all`, which is sorted by name; only the page's items are viewed.
///
/// # Errors
/// 400 for a wrong query.
pub fn page<T, V: Serialize>(
    query: RawPage,
    all: Vec<T>,
    name: impl Fn(&T) -> &str,
    view: impl Fn(&T) -> V,
) -> Result<Items<V>, Problem> {
    let Query(PageQuery { limit, after }) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    if limit.is_some_and(|limit| !(1..=LIMITS.page_items).contains(&limit)) {
        return Err(Problem::bad_request(format!("limit is from 1 to {}", LIMITS.page_items)));
    }
    let is_later = |one: &&T| after.as_deref().is_none_or(|after| name(one) > after);
    let mut rest = all.iter().filter(is_later);
    let piece: Vec<&T> = rest.by_ref().take(limit.unwrap_or(usize::MAX)).collect();
    let next = rest.next().and(piece.last()).map(|last| name(last).to_string());
    Ok(Items { items: piece.into_iter().map(view).collect(), next })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn piece(limit: Option<usize>, after: Option<&str>) -> Result<Items<String>, Problem> {
        let query = PageQuery { limit, after: after.map(String::from) };
        page(Ok(Query(query)), vec!["a", "b", "c"], |one| one, |one| one.to_string())
    }

    #[test]
    fn pages_are_contiguous() {
        let of = |limit, after| {
            let Items { items, next } = piece(limit, after).unwrap();
            (items.concat(), next)
        };
        assert_eq!(of(None, None), ("abc".into(), None));
        assert_eq!(of(Some(2), None), ("ab".into(), Some("b".into())));
        assert_eq!(of(Some(2), Some("b")), ("c".into(), None));
        assert_eq!(of(Some(3), None), ("abc".into(), None));
        assert_eq!(of(Some(1), Some("aa")), ("b".into(), Some("b".into())));
        assert_eq!(of(None, Some("c")), (String::new(), None));
        assert_eq!(piece(Some(0), None).unwrap_err().code, "bad-request");
        assert_eq!(piece(Some(LIMITS.page_items + 1), None).unwrap_err().code, "bad-request");
        assert_eq!(of(Some(LIMITS.page_items), None).0, "abc");
    }
}
