//! Events on their way into logs.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use sqlx::{Any, Transaction};
use topomap::log::MapEvent;

use super::batches::{MOST_ROWS, Statements};
use super::columns::EventColumns;
use super::row_sums::{ChainStep, checksum};
use super::values::{MaybeReal, to_sql};
use super::{MapId, StorageError};

/// An event, and where it is to stand.
#[derive(Clone, Copy, Debug)]
pub(super) struct NewEvent<'a> {
    pub(super) map: MapId,
    pub(super) position: u64,
    pub(super) event: &'a MapEvent,
}

/// The chain goes on as in [`super::row_sums::chained`], from the event before those that follow each other.
static INSERT: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(17, |rows| {
        format!(
            "INSERT INTO log (map_id, position, checksum, chain, session, sequence, stamp_ns, reason, place, posterior, \
             matched_frame, probability, link_from, link_to, event) SELECT new.column1, new.column2, new.column3, \
             (coalesce((SELECT chain FROM log WHERE map_id = new.column1 AND position = new.column4), 0) \
             * new.column5 + new.column6) % 2147483647, \
             new.column7, new.column8, new.column9, new.column10, new.column11, new.column12, new.column13, new.column14, \
             new.column15, new.column16, new.column17 FROM {rows} AS new"
        )
    })
});

/// Stores events, those of each map in the order of their positions; how many bytes each takes.
pub(super) async fn insert_events(
    transaction: &mut Transaction<'_, Any>,
    events: &[NewEvent<'_>],
) -> Result<Vec<u64>, StorageError> {
    let mut lengths = Vec::with_capacity(events.len());
    let mut rest = events;
    while !rest.is_empty() {
        let (statement, rows) = INSERT.for_first(insertable_at_once(rest));
        let (now, later) = rest.split_at(rows);
        lengths.extend(insert_at_once(transaction, statement, now).await?);
        rest = later;
    }
    Ok(lengths)
}

/// How many of the first may share a statement. It sees of the log what was there before it, so that all of a map have to
/// follow one such event.
fn insertable_at_once(events: &[NewEvent<'_>]) -> usize {
    let mut maps = BTreeSet::new();
    let mut last = None;
    let fit = events.iter().take(MOST_ROWS).take_while(|NewEvent { map, position, .. }| {
        let is_next = last.replace((*map, position + 1)) == Some((*map, *position));
        is_next || maps.insert(*map)
    });
    fit.count()
}

async fn insert_at_once(
    transaction: &mut Transaction<'_, Any>,
    statement: &'static str,
    events: &[NewEvent<'_>],
) -> Result<Vec<u64>, StorageError> {
    let mut lengths = Vec::with_capacity(events.len());
    let mut query = sqlx::query(statement);
    let (mut first, mut chain) = (None, ChainStep::NONE);
    for NewEvent { map, position, event } in events {
        if first.is_none_or(|(of, _)| of != *map) {
            (first, chain) = (Some((*map, *position)), ChainStep::NONE);
        }
        let (position, first) = (to_sql(*position), first.map_or(0, |(_, first)| to_sql(first)));
        let bytes = event.to_bytes();
        let checksum = checksum(position, &bytes);
        chain = chain.then(checksum);
        lengths.push(bytes.len() as u64);
        let EventColumns {
            session,
            sequence,
            stamp_ns,
            reason,
            place,
            posterior,
            matched_frame,
            probability,
            link_from,
            link_to,
        } = EventColumns::of(event);
        query = query
            .bind(*map)
            .bind(position)
            .bind(checksum)
            .bind(first - 1)
            .bind(chain.factor)
            .bind(chain.sum)
            .bind(i64::from(session))
            .bind(sequence)
            .bind(stamp_ns)
            .bind(reason)
            .bind(place.map(i64::from))
            .bind(MaybeReal(posterior))
            .bind(matched_frame)
            .bind(MaybeReal(probability))
            .bind(link_from.map(i64::from))
            .bind(link_to.map(i64::from))
            .bind(bytes);
    }
    query.execute(&mut **transaction).await?;
    Ok(lengths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_that_begins_again_waits_for_the_next_statement() {
        let event = MapEvent::SessionOpened { session: 0 };
        let fit = |at: &[(MapId, u64)]| {
            let new = |&(map, position)| NewEvent { map, position, event: &event };
            insertable_at_once(&at.iter().map(new).collect::<Vec<_>>())
        };
        assert_eq!(fit(&[(1, 7)]), 1);
        assert_eq!(fit(&[(1, 7), (1, 8), (1, 9)]), 3);
        assert_eq!(fit(&[(1, 7), (1, 8), (2, 0), (2, 1), (3, 9)]), 5);
        assert_eq!(fit(&[(1, 7), (2, 0), (1, 8)]), 2);
        assert_eq!(fit(&[(1, 7), (1, 9)]), 1);
    }
}
