//! A disk that does what was recorded, and what it may hold when its power goes.
//!
//! Of a file, what was written before a sync began that has ended is there. Of what was written since, any part may be
//! there, in any order, whole or torn between sectors: a sector is as it was, or as it was written. Names are on the disk
//! once their directory was synced; of later ones, the first few.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::Path;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::record::{Call, Handle, Record};

/// Bytes that a disk writes whole or not at all.
const SECTOR_BYTES: usize = 512;
const PAGE_BYTES: usize = 4096;

/// Files by their paths.
pub(super) type Image = Vec<(String, Vec<u8>)>;

/// Syncs that the disk says it has done, and has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lie {
    Nothing,
    /// Those of the write-ahead log.
    Log,
    /// Those of the database's file.
    Database,
    /// Those of folders.
    Folders,
}

/// What is left of what a file was not synced since.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Loss {
    /// All of it is there, as after the end of the process alone.
    Nothing,
    Everything,
    /// What came first is there, and the last of it is torn.
    Later,
    /// Some writes are there, and others are not.
    Some,
    Sectors,
    Pages,
}

pub(super) const LOSSES: [Loss; 6] =
    [Loss::Nothing, Loss::Everything, Loss::Later, Loss::Some, Loss::Sectors, Loss::Pages];

#[derive(Clone, Debug)]
enum Change {
    Written { at: usize, bytes: Range<usize> },
    Sized(usize),
}

#[derive(Clone, Debug, Default)]
struct Node {
    durable: Vec<u8>,
    /// With the number of the call.
    pending: Vec<(usize, Change)>,
    syncs: HashMap<(u32, u64), usize>,
}

#[derive(Clone, Debug)]
enum NameChange {
    Put(String, usize),
    Gone(String),
    Moved(String, String),
}

impl NameChange {
    fn folder(&self) -> &str {
        match self {
            Self::Put(path, _) | Self::Gone(path) | Self::Moved(path, _) => folder_of(path),
        }
    }

    fn apply(&self, names: &mut BTreeMap<String, usize>) {
        match self {
            Self::Put(path, node) => drop(names.insert(path.clone(), *node)),
            Self::Gone(path) => drop(names.remove(path)),
            Self::Moved(from, to) => {
                if let Some(node) = names.remove(from) {
                    names.insert(to.clone(), node);
                }
            }
        }
    }
}

fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

pub(super) struct SimulatedDisk<'a> {
    record: &'a Record,
    lie: Lie,
    nodes: Vec<Node>,
    names: BTreeMap<String, usize>,
    durable_names: BTreeMap<String, usize>,
    pending_names: Vec<(usize, NameChange)>,
    opened: HashMap<Handle, (String, usize)>,
    /// Calls that were made.
    done: usize,
}

impl<'a> SimulatedDisk<'a> {
    /// A disk on which `before` has been for long.
    pub(super) fn new(record: &'a Record, before: &Image, lie: Lie) -> Self {
        let mut disk = Self {
            record,
            lie,
            nodes: vec![Node::default()],
            names: BTreeMap::from([(String::new(), 0)]),
            durable_names: BTreeMap::new(),
            pending_names: Vec::new(),
            opened: HashMap::new(),
            done: 0,
        };
        for (path, bytes) in before {
            let mut folder = path.as_str();
            while let Some((above, _)) = folder.rsplit_once('/') {
                disk.names.insert(above.to_owned(), 0);
                folder = above;
            }
            disk.nodes.push(Node { durable: bytes.clone(), ..Node::default() });
            disk.names.insert(path.clone(), disk.nodes.len() - 1);
        }
        disk.durable_names = disk.names.clone();
        disk
    }

    /// Makes the calls before number `until`.
    pub(super) fn run_to(&mut self, until: usize) {
        while self.done < until {
            let record = self.record;
            self.make(&record.calls[self.done].call);
            self.done += 1;
        }
    }

    fn make(&mut self, call: &Call) {
        let number = self.done;
        match call {
            Call::Began | Call::SyncFailed => {}
            Call::Opened { handle, path, emptied } => {
                let node = match self.names.get(path) {
                    Some(node) => *node,
                    None => {
                        self.nodes.push(Node::default());
                        self.rename(number, NameChange::Put(path.clone(), self.nodes.len() - 1));
                        self.nodes.len() - 1
                    }
                };
                if *emptied {
                    self.nodes[node].pending.push((number, Change::Sized(0)));
                }
                self.opened.insert(*handle, (path.clone(), node));
            }
            Call::Wrote { handle, at, bytes } => {
                let change = Change::Written { at: *at, bytes: bytes.clone() };
                self.node(handle).pending.push((number, change));
            }
            Call::Sized { handle, bytes } => self.node(handle).pending.push((number, Change::Sized(*bytes))),
            Call::SyncBegan { handle, number: sync } => {
                self.node(handle).syncs.insert((handle.0, *sync), number);
            }
            Call::SyncEnded { handle, number: sync } => self.synced(handle, *sync),
            Call::Renamed { from, to } => self.rename(number, NameChange::Moved(from.clone(), to.clone())),
            Call::Unlinked { path } => self.rename(number, NameChange::Gone(path.clone())),
            Call::MadeDirectory { path } => self.rename(number, NameChange::Put(path.clone(), 0)),
        }
    }

    fn node(&mut self, handle: &Handle) -> &mut Node {
        let (_, node) = &self.opened[handle];
        &mut self.nodes[*node]
    }

    fn rename(&mut self, number: usize, change: NameChange) {
        change.apply(&mut self.names);
        self.pending_names.push((number, change));
    }

    fn synced(&mut self, handle: &Handle, sync: u64) {
        let (path, node) = self.opened[handle].clone();
        let began = self.nodes[node].syncs.remove(&(handle.0, sync)).unwrap();
        let lie = match self.lie {
            Lie::Nothing => false,
            Lie::Log => path.ends_with("-wal"),
            Lie::Database => path.ends_with(".sqlite"),
            Lie::Folders => node == 0,
        };
        if lie {
            return;
        }
        if node == 0 {
            let (names, durable) = (std::mem::take(&mut self.pending_names), &mut self.durable_names);
            let reached = |(number, change): &(usize, NameChange)| *number < began && change.folder() == path;
            let (reached, left): (Vec<_>, Vec<_>) = names.into_iter().partition(reached);
            reached.iter().for_each(|(_, change)| change.apply(durable));
            self.pending_names = left;
            return;
        }
        let Node { durable, pending, .. } = &mut self.nodes[node];
        let reached = pending.partition_point(|(number, _)| *number < began);
        for (_, change) in pending.drain(..reached) {
            apply(durable, &change, &self.record.bytes);
        }
    }

    /// What is there if nothing is lost.
    pub(super) fn kept(&self) -> Image {
        self.files(&self.names, |node| {
            let mut content = node.durable.clone();
            node.pending.iter().for_each(|(_, change)| apply(&mut content, change, &self.record.bytes));
            content
        })
    }

    /// What may be there after the power went; with what was lost of the database and of its write-ahead log.
    pub(super) fn after_a_power_cut(&self, random: &mut ChaCha8Rng) -> (Image, String) {
        let mut names = self.durable_names.clone();
        let pending = self.pending_names.len();
        let there = match random.random_range(0..3) {
            0 => 0,
            1 => pending,
            _ => random.random_range(0..=pending),
        };
        self.pending_names[..there].iter().for_each(|(_, change)| change.apply(&mut names));
        let mut lost = format!("{there} of {pending} names");
        let image = self.files(&names, |node| {
            let loss = LOSSES[random.random_range(0..LOSSES.len())];
            lost += &format!(", {loss:?} of {}", node.pending.len());
            self.left_of(node, loss, random)
        });
        (image, lost)
    }

    fn files(&self, names: &BTreeMap<String, usize>, mut content: impl FnMut(&Node) -> Vec<u8>) -> Image {
        let there = |path: &str| {
            let mut above = path;
            while !above.is_empty() {
                above = folder_of(above);
                if !names.contains_key(above) {
                    return false;
                }
            }
            true
        };
        let files = names.iter().filter(|&(path, &node)| node != 0 && there(path) && !path.ends_with("-shm"));
        files.map(|(path, &node)| (path.clone(), content(&self.nodes[node]))).collect()
    }

    fn left_of(&self, node: &Node, loss: Loss, random: &mut ChaCha8Rng) -> Vec<u8> {
        let mut content = node.durable.clone();
        let bytes = &self.record.bytes;
        let first =
            if loss == Loss::Later { random.random_range(0..=node.pending.len()) } else { usize::MAX };
        for (position, (_, change)) in node.pending.iter().enumerate() {
            match (loss, change) {
                (Loss::Everything, _) => {}
                (Loss::Later, _) if position > first => {}
                (Loss::Later, Change::Written { at, bytes: written }) if position == first => {
                    let end =
                        written.start + random.random_range(0..=written.len() / SECTOR_BYTES) * SECTOR_BYTES;
                    apply(&mut content, &Change::Written { at: *at, bytes: written.start..end }, bytes);
                }
                (Loss::Nothing | Loss::Later, _) => apply(&mut content, change, bytes),
                (Loss::Sectors | Loss::Pages, Change::Written { at, bytes: written }) => {
                    torn(&mut content, *at, &bytes[written.clone()], loss, random);
                }
                (Loss::Some | Loss::Sectors | Loss::Pages, _) => {
                    if random.random() {
                        apply(&mut content, change, bytes);
                    }
                }
            }
        }
        content
    }
}

/// Does a change to what a file holds.
fn apply(content: &mut Vec<u8>, change: &Change, record: &[u8]) {
    match change {
        Change::Written { at, bytes } => put(content, *at, &record[bytes.clone()]),
        Change::Sized(bytes) => content.resize(*bytes, 0),
    }
}

fn put(content: &mut Vec<u8>, at: usize, bytes: &[u8]) {
    let end = at + bytes.len();
    if content.len() < end {
        content.resize(end, 0);
    }
    content[at..end].copy_from_slice(bytes);
}

/// Does half of the pieces of a write.
fn torn(content: &mut Vec<u8>, at: usize, bytes: &[u8], loss: Loss, random: &mut ChaCha8Rng) {
    let unit = if loss == Loss::Pages { PAGE_BYTES } else { SECTOR_BYTES };
    let mut from = 0;
    while from < bytes.len() {
        // Pieces are those of the disk, wherever the write begins.
        let to = bytes.len().min((at + from) / unit * unit + unit - at);
        let piece = &bytes[from..to];
        if random.random() {
            put(content, at + from, piece);
        }
        from = to;
    }
}

/// Writes an image into an empty folder.
pub(super) fn write_image(folder: &Path, image: &Image) {
    for (path, bytes) in image {
        let file = folder.join(path);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, bytes).unwrap();
    }
}
