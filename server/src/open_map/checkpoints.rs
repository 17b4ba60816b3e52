//! A map's checkpoint: what changed is written beside the map's own work, and brought into sealed blocks there.

mod restoring;

use std::collections::BTreeMap;
use std::ops::Range;

use fabmap::appearance::{Appearance, PlaceId};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;
use topomap::checkpoint::{Block, BlockWriter, Changes, Pieces, decode_block};
use topomap::map::{Place, decode_place};
use topomap::mapper::Mapper;

pub(super) use self::restoring::{Unusable, restore};
use super::MapWriter;
use crate::storage::{MapId, Storage, StorageError, StoredBlock};

/// A checkpoint is begun after so many events, so that a crash replays few, and no frame waits long for one.
const CHECKPOINT_EVENTS: u64 = 256;

/// A block is sealed when its places have come to so many bytes.
const BLOCK_BYTES: usize = 512 << 10;

/// A block that has grown to more is divided.
const MOST_BLOCK_BYTES: usize = 1 << 20;

/// A block is sealed again when its places' changes have come to so many bytes: an eighth of it is then written for
/// each byte that changed.
const CHANGED_BYTES: usize = BLOCK_BYTES / 8;

/// The checkpoint of an open map.
#[derive(Debug)]
pub(super) struct Checkpoints {
    /// Since the last checkpoint that was begun.
    changes: Changes,
    /// Events folded in then.
    events: u64,
    state: State,
}

#[derive(Debug)]
enum State {
    /// Nothing is being written.
    Idle(Layout),
    Writing {
        writing: JoinHandle<Written>,
        /// What is written: it is still to be written if that fails.
        changes: Changes,
    },
    /// What the disk has is not known; the log has it all.
    Lost,
}

/// How writing went.
#[derive(Debug)]
struct Written {
    layout: Layout,
    result: Result<(), StorageError>,
}

/// Where the pieces are on the disk.
#[derive(Debug, Default)]
pub(super) struct Layout {
    /// First places of the sealed blocks, ascending.
    blocks: Vec<PlaceId>,
    /// Places that are in blocks.
    sealed: PlaceId,
    /// Places with a row of their own, and its bytes.
    rows: BTreeMap<PlaceId, usize>,
}

/// Which places are to be sealed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    /// The block that begins with this place, anew.
    Again(PlaceId),
    /// Those from this one on, for the first time.
    Next(PlaceId),
}

impl Checkpoints {
    pub(super) fn new(changes: Changes, events: u64, layout: Layout) -> Self {
        Self { changes, events, state: State::Idle(layout) }
    }

    /// None, until the map is opened again.
    pub(super) fn none() -> Self {
        Self { changes: Changes::default(), events: 0, state: State::Lost }
    }

    /// Notes what an event that was applied has changed.
    pub(super) fn changes(&mut self) -> &mut Changes {
        &mut self.changes
    }
}

impl MapWriter {
    /// Begins a checkpoint, unless too little has changed or the one before is still being written.
    pub(super) fn checkpoint_if_due(&mut self) {
        let due = self.mapper.map().events() >= self.checkpoints.events + CHECKPOINT_EVENTS;
        let ready = match &self.checkpoints.state {
            State::Idle(_) => true,
            State::Writing { writing, .. } => writing.is_finished(),
            State::Lost => false,
        };
        if due && ready {
            self.begin_checkpoint();
        }
    }

    /// Writes all that has changed, and waits for it. A failure costs a slower opening, nothing else.
    pub(super) fn checkpoint_now(&mut self) {
        self.finish_checkpoint();
        // Also what could not be written before: the disk may have room again.
        if !self.checkpoints.changes.is_empty() {
            self.begin_checkpoint();
            self.finish_checkpoint();
        }
    }

    fn begin_checkpoint(&mut self) {
        self.finish_checkpoint();
        let layout = match std::mem::replace(&mut self.checkpoints.state, State::Lost) {
            State::Idle(layout) => layout,
            State::Writing { .. } | State::Lost => return,
        };
        self.usage.set_memory_bytes(self.mapper.memory_bytes());
        let map = self.mapper.map();
        let changes = std::mem::replace(&mut self.checkpoints.changes, Changes::since(map));
        self.checkpoints.events = map.events();
        let pieces = self.mapper.pieces(&changes);
        let runtime = self.runtime.clone();
        let storage = self.storage.clone();
        let id = self.map.id;
        let words = self.model.model.vocabulary().len();
        let write = move || write(&runtime, &storage, id, words, &pieces, layout);
        self.checkpoints.state = State::Writing { writing: self.runtime.spawn_blocking(write), changes };
    }

    /// Waits for the checkpoint that is being written, if one is.
    pub(super) fn finish_checkpoint(&mut self) {
        let (writing, changes) = match std::mem::replace(&mut self.checkpoints.state, State::Lost) {
            State::Writing { writing, changes } => (writing, changes),
            other @ (State::Idle(_) | State::Lost) => {
                self.checkpoints.state = other;
                return;
            }
        };
        let map = &self.map.name;
        match self.runtime.block_on(writing) {
            Ok(Written { layout, result }) => {
                self.checkpoints.state = State::Idle(layout);
                if let Err(error) = result {
                    tracing::warn!(map, %error, "no checkpoint was written; the log has it all");
                    let since = std::mem::take(&mut self.checkpoints.changes);
                    self.checkpoints.changes = since.with_earlier(changes);
                }
            }
            Err(error) => tracing::error!(map, %error, "writing a checkpoint failed; the log has it all"),
        }
    }
}

/// Writes what changed, then seals what is due. Blocks.
fn write(
    runtime: &Handle,
    storage: &Storage,
    map: MapId,
    words: usize,
    pieces: &Pieces,
    mut layout: Layout,
) -> Written {
    let result = runtime.block_on(storage.put_checkpoint(map, pieces));
    if result.is_ok() {
        let changed = pieces.places.iter().map(|(place, bytes)| (*place, bytes.len()));
        let due = layout.changed(changed);
        for due in due {
            if let Err(why) = seal(runtime, storage, map, words, due, &mut layout) {
                tracing::warn!(
                    map,
                    ?due,
                    why,
                    "places of a checkpoint were not sealed; it is as good without"
                );
            }
        }
    }
    Written { layout, result }
}

impl Layout {
    /// Notes places that were written; which blocks are to be sealed for it.
    fn changed(&mut self, places: impl Iterator<Item = (PlaceId, usize)>) -> Vec<Due> {
        let mut due = Vec::new();
        for (place, bytes) in places {
            self.rows.insert(place, bytes);
            due.extend(self.block_of(place));
        }
        due.dedup();
        due.retain(|&due| {
            let enough = match due {
                Due::Again(_) => CHANGED_BYTES,
                Due::Next(_) => BLOCK_BYTES,
            };
            self.rows.range(self.range(due)).map(|(_, bytes)| bytes).sum::<usize>() >= enough
        });
        due
    }

    fn block_of(&self, place: PlaceId) -> Option<Due> {
        if place >= self.sealed {
            return Some(Due::Next(self.sealed));
        }
        let block = self.blocks.partition_point(|&first| first <= place).checked_sub(1)?;
        Some(Due::Again(self.blocks[block]))
    }

    fn range(&self, due: Due) -> Range<PlaceId> {
        match due {
            Due::Next(first) => first..PlaceId::MAX,
            Due::Again(first) => {
                let next = self.blocks.partition_point(|&block| block <= first);
                first..self.blocks.get(next).copied().unwrap_or(self.sealed)
            }
        }
    }

    /// Notes blocks that were sealed.
    fn sealed(&mut self, blocks: &[Block]) {
        for &Block { first, places, .. } in blocks {
            let next = first + places;
            if let Err(position) = self.blocks.binary_search(&first) {
                self.blocks.insert(position, first);
            }
            self.sealed = self.sealed.max(next);
            self.rows.retain(|place, _| !(first..next).contains(place));
        }
    }
}

/// Merges what changed into a block, or makes the next one. Says why not. Blocks.
fn seal(
    runtime: &Handle,
    storage: &Storage,
    map: MapId,
    words: usize,
    due: Due,
    layout: &mut Layout,
) -> Result<(), String> {
    let view = runtime.block_on(storage.view_checkpoint(map)).map_err(|error| error.to_string())?;
    let mut view = view.ok_or("there is no checkpoint")?;
    let (before, places) = match due {
        Due::Next(first) => {
            let rows = runtime.block_on(view.places(layout.range(due)));
            let places = overlaid(first, Vec::new(), rows.map_err(|error| error.to_string())?, words)?;
            (None, places)
        }
        Due::Again(first) => {
            let block = runtime.block_on(view.blocks(first, 1)).map_err(|error| error.to_string())?.pop();
            let block = block.filter(|block| block.first == first).ok_or("the block is missing")?;
            let rows = runtime.block_on(view.places(block.range())).map_err(|error| error.to_string())?;
            let places = overlaid(first, decode(&block, words)?, rows, words)?;
            (Some(block), places)
        }
    };
    let (Due::Again(first) | Due::Next(first)) = due;
    let events = view.events;
    drop(view);
    let blocks = match due {
        Due::Again(_) => divided(first, &places),
        Due::Next(_) => {
            let mut blocks = blocks(first, &places, BLOCK_BYTES);
            // What is left over waits for the next block.
            if blocks.len() > 1 {
                blocks.pop();
            }
            blocks
        }
    };
    let sealed = storage.seal(map, events, before.as_ref(), &blocks);
    runtime.block_on(sealed).map_err(|error| error.to_string())?;
    layout.sealed(&blocks);
    Ok(())
}

/// The places of a block, in as many of like size as it takes for none to be above [`MOST_BLOCK_BYTES`].
fn divided(first: PlaceId, places: &[(Place, Appearance)]) -> Vec<Block> {
    let whole = blocks(first, places, usize::MAX);
    let bytes: usize = whole.iter().map(|block| block.bytes.len()).sum();
    match bytes.div_ceil(MOST_BLOCK_BYTES) {
        0 | 1 => whole,
        parts => blocks(first, places, bytes.div_ceil(parts)),
    }
}

/// The places of a block, and of what follows it, as the rows of single places have them.
fn overlaid(
    first: PlaceId,
    mut places: Vec<(Place, Appearance)>,
    rows: Vec<(PlaceId, Vec<u8>)>,
    words: usize,
) -> Result<Vec<(Place, Appearance)>, String> {
    for (place, bytes) in rows {
        let decoded = decode_place(&bytes, words).map_err(|error| error.to_string())?;
        match (place - first) as usize {
            known if known < places.len() => places[known] = decoded,
            next if next == places.len() => places.push(decoded),
            _ => return Err(format!("places are missing before {place}")),
        }
    }
    Ok(places)
}

fn decode(block: &StoredBlock, words: usize) -> Result<Vec<(Place, Appearance)>, String> {
    let (first, places) = decode_block(&block.content, words).map_err(|error| error.to_string())?;
    if (first, places.len()) != (block.first, block.places as usize) {
        return Err(format!("the block of place {} is another's", block.first));
    }
    Ok(places)
}

/// Places in blocks, each of `block_bytes` and a part of a place; the last of less.
fn blocks(first: PlaceId, places: &[(Place, Appearance)], block_bytes: usize) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut block = BlockWriter::new(first);
    for (id, (place, appearance)) in (first..).zip(places) {
        if block.len_bytes() >= block_bytes {
            blocks.push(std::mem::replace(&mut block, BlockWriter::new(id)).seal());
        }
        block.push(place, appearance);
    }
    blocks.push(block.seal());
    blocks
}

/// Writes the checkpoint of a map that has none, block by block, and says where all is. Blocks.
pub(super) fn write_first(
    runtime: &Handle,
    storage: &Storage,
    map: MapId,
    mapper: &Mapper,
) -> Result<Layout, StorageError> {
    let mut layout = Layout::default();
    runtime.block_on(storage.delete_checkpoint(map))?;
    let events = mapper.map().events();
    for block in mapper.blocks(BLOCK_BYTES) {
        runtime.block_on(storage.put_block(map, events, &block))?;
        layout.sealed(&[block]);
    }
    // The head last: until then there is no checkpoint.
    runtime.block_on(storage.put_checkpoint(map, &mapper.pieces(&Changes::all_but_places(mapper.map()))))?;
    Ok(layout)
}
