//! Lists, a page at a time.

use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;

use crate::error::ServiceError;
use crate::names::number;

/// A page of a list; `next` is the token of the next page, empty on the last.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Page<T> {
    pub(crate) items: Vec<T>,
    pub(crate) next: String,
}

/// Page sizes: 0 asks for the default.
pub(crate) fn page_size(asked: u32) -> Result<u32, ServiceError> {
    const DEFAULT: u32 = 100;
    const MAX: u32 = 1000;
    match asked {
        0 => Ok(DEFAULT),
        1..=MAX => Ok(asked),
        _ => Err(ServiceError::invalid(format_args!("a page has at most {MAX} entries, not {asked}"))),
    }
}

/// The number that a page token stands for; none for the first page.
pub(crate) fn numbered_page<T: TryFrom<u64>>(token: &str) -> Result<Option<T>, ServiceError> {
    if token.is_empty() {
        return Ok(None);
    }
    let wanted = opened(token, FROM).ok_or_else(bad_page_token)?;
    let page = number(&wanted).and_then(|number| T::try_from(number).ok());
    page.map(Some).ok_or_else(bad_page_token)
}

/// The token of a page that a number stands for.
pub(crate) fn page_from(number: impl std::fmt::Display) -> String {
    sealed(FROM, number)
}

/// The token of a page that begins after a name.
pub(crate) fn page_after(name: &str) -> String {
    sealed(AFTER, name)
}

/// The name that a page begins after; empty for the first page.
pub(crate) fn named_page(token: &str) -> Result<String, ServiceError> {
    if token.is_empty() {
        return Ok(String::new());
    }
    opened(token, AFTER).filter(|name| !name.is_empty()).ok_or_else(bad_page_token)
}

/// Begins what the token of a page that a number stands for holds.
const FROM: &str = "from ";
/// Begins what the token of a page after a name holds.
const AFTER: &str = "after ";

/// A token that nobody reads or makes up, so that what it holds may change.
fn sealed(kind: &str, what: impl std::fmt::Display) -> String {
    BASE64_URL_SAFE_NO_PAD.encode(format!("{kind}{what}"))
}

fn opened(token: &str, kind: &str) -> Option<String> {
    let held = String::from_utf8(BASE64_URL_SAFE_NO_PAD.decode(token).ok()?).ok()?;
    held.strip_prefix(kind).map(str::to_owned)
}

/// As many rows as a page of `size` has and one more, if there are so many that are wanted: `read` gives so many rows after
/// a key, wanted or not.
pub(crate) async fn rows_of_page<Row, Key, E, Reading>(
    size: u32,
    mut after: Key,
    read: impl Fn(Key) -> Reading,
    key: impl Fn(&Row) -> Key,
    is_wanted: impl Fn(&Row) -> bool,
) -> Result<Vec<Row>, E>
where
    Reading: Future<Output = Result<Vec<Row>, E>>,
{
    let mut wanted = Vec::new();
    loop {
        let rows = read(after).await?;
        let is_last = rows.len() <= size as usize;
        match rows.last() {
            Some(last) => after = key(last),
            None => return Ok(wanted),
        }
        wanted.extend(rows.into_iter().filter(&is_wanted));
        if is_last || wanted.len() > size as usize {
            return Ok(wanted);
        }
    }
}

pub(crate) fn bad_page_token() -> ServiceError {
    ServiceError::invalid("the page token is not one that this server gave; begin again without one")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_tokens_are_written_in_one_way() {
        assert_eq!((numbered_page::<u32>(""), numbered_page(&page_from(7))), (Ok(None), Ok(Some(7_u32))));
        for held in ["", "+7", "07", "-1", " 7", "4294967296", "maps/a"] {
            assert!(numbered_page::<u32>(&sealed(FROM, held)).is_err(), "{held}");
        }
        for bad in ["7", "from 7", "from-7", &page_after("7"), &format!("{}=", page_from(7))] {
            assert!(numbered_page::<u32>(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_name_is_no_page_token() {
        for name in ["a", "drive-7", "maps/hall/navigations/robot", "Flur süd"] {
            let token = page_after(name);
            assert!(!token.contains(name), "{token} can be read");
            assert_eq!(named_page(&token), Ok(name.to_owned()));
            assert_eq!(named_page(name), Err(bad_page_token()));
        }
        assert_eq!(named_page(""), Ok(String::new()));
        for bad in ["junk", "after a", &sealed(AFTER, ""), &page_from(7)] {
            assert!(named_page(bad).is_err(), "{bad}");
        }
    }

    #[tokio::test]
    async fn a_page_is_full_though_few_rows_are_wanted() {
        let read =
            |after: u32| async move { Ok::<_, ServiceError>((after + 1..=20).take(4).collect::<Vec<u32>>()) };
        let page =
            async |every: u32| rows_of_page(3, 0, read, |row| *row, |row| row % every == 0).await.unwrap();
        assert_eq!(page(1).await, [1, 2, 3, 4]);
        assert_eq!(page(4).await, [4, 8, 12, 16]);
        assert_eq!(page(7).await, [7, 14]);
        assert_eq!(page(21).await, [0; 0]);
    }

    #[test]
    fn page_sizes_have_a_default_and_a_limit() {
        assert_eq!((page_size(0), page_size(7), page_size(1000)), (Ok(100), Ok(7), Ok(1000)));
        assert!(page_size(1001).is_err());
    }
}
