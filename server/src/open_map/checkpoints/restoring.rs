//! A map as of its checkpoint.

use fabmap::appearance::PlaceId;
use rayon::prelude::*;
use tokio::runtime::Handle;
use topomap::checkpoint::Restoration;
use topomap::map::decode_place;
use topomap::mapper::{Mapper, RestoreError};
use topomap::settings::MapperSettings;

use super::{Layout, decode};
use crate::ingest::model::LoadedModel;
use crate::storage::{CheckpointView, StorageError};

/// Blocks that are read and decoded at a time.
const BLOCKS_AT_A_TIME: u32 = 16;

/// Why there is no map to be had from a checkpoint.
#[derive(Debug, thiserror::Error)]
pub(in crate::open_map) enum Unusable {
    /// It is damaged: the log is to be replayed.
    #[error("{0}")]
    Damaged(String),
    /// It cannot be read now.
    #[error(transparent)]
    Unread(StorageError),
}

impl From<StorageError> for Unusable {
    fn from(error: StorageError) -> Self {
        match error {
            StorageError::Damaged(why) | StorageError::Rot(why) => Self::Damaged(why),
            other => Self::Unread(other),
        }
    }
}

impl From<RestoreError> for Unusable {
    fn from(error: RestoreError) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// The map as of its checkpoint, and where that is. Blocks.
pub(in crate::open_map) fn restore(
    runtime: &Handle,
    mut view: CheckpointView,
    model: &LoadedModel,
    settings: MapperSettings,
) -> Result<(Mapper, Layout), Unusable> {
    let words = model.model.vocabulary().len();
    let mut restoration = Restoration::new(&model.model, settings, &view.head)?;
    for (id, bytes) in runtime.block_on(view.sessions())? {
        restoration.session(id, &bytes)?;
    }
    for (first, bytes) in runtime.block_on(view.links())? {
        restoration.links(first, &bytes)?;
    }
    let mut layout = Layout::default();
    let rows = runtime.block_on(view.places(PlaceId::new(0)..PlaceId::MAX))?;
    layout.rows = rows.iter().map(|(place, bytes)| (*place, bytes.len())).collect();
    let mut rows = rows.into_iter().peekable();
    loop {
        let some = runtime.block_on(view.blocks(layout.sealed, BLOCKS_AT_A_TIME))?;
        let decoded: Vec<_> = some
            .par_iter()
            .map(|block| Ok((block, decode(block, words)?)))
            .collect::<Result<_, _>>()
            .map_err(Unusable::Damaged)?;
        for (block, places) in decoded {
            for (id, place) in block.first.onwards().zip(places) {
                let place = match rows.next_if(|&(changed, _)| changed == id) {
                    Some((_, bytes)) => decode_place(&bytes, words).map_err(RestoreError::from)?,
                    None => place,
                };
                restoration.place(id, place)?;
            }
            layout.blocks.push(block.first);
            layout.sealed = block.range().end;
        }
        if some.len() < BLOCKS_AT_A_TIME as usize {
            break;
        }
    }
    for (id, bytes) in rows {
        restoration.place(id, decode_place(&bytes, words).map_err(RestoreError::from)?)?;
    }
    Ok((restoration.finish()?, layout))
}
