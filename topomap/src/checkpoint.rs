//! A map's state in pieces: a checkpoint writes those that changed, and a map is put together from
//! all of them.
//!
//! A place is a piece of its own while it changes ([`crate::map::encode_place`]). Many that have
//! come to rest are one sealed [`Block`]. Links are pieces of [`LINKS_PER_PIECE`], sessions one
//! each, and the [`Head`] says what there is.

use std::collections::{BTreeMap, BTreeSet};

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::codec::{Container, DecodeError, Reader, Writer};
use fabmap::model::Model;

use crate::ids::SessionId;
use crate::log::{Link, MapEvent};
use crate::map::{Corrections, Map, Place, SESSION_VERSION, Session, encode_place};
use crate::mapper::{Mapper, RestoreError};
use crate::settings::MapperSettings;

/// Links of one piece; only the last has fewer.
pub const LINKS_PER_PIECE: usize = 512;

const HEAD: Container = Container { magic: *b"WPHEAD\r\n", name: "Waypost checkpoint", version: 2 };

/// The head of a map without corrections is still written so.
const HEAD_BEFORE_CORRECTIONS: u32 = 1;
const SESSION: Container =
    Container { magic: *b"WPSESS\r\n", name: "Waypost checkpoint's session", version: SESSION_VERSION };
const LINKS: Container = Container { magic: *b"WPLINK\r\n", name: "Waypost checkpoint's links", version: 1 };
const BLOCK: Container = Container { magic: *b"WPPLCS\r\n", name: "Waypost checkpoint's places", version: 1 };

/// What a checkpoint consists of: pieces that do not add up to it are not a map.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// Events that are folded in.
    pub events: u64,
    /// Number of places.
    pub places: u64,
    /// Number of links.
    pub links: u64,
    /// Number of sessions.
    pub sessions: u64,
    /// What people corrected.
    pub corrections: Corrections,
}

/// What of a map has changed since its last checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    places: BTreeSet<PlaceId>,
    sessions: BTreeSet<SessionId>,
    /// Links that the checkpoint has.
    links: usize,
}

/// The bytes that a checkpoint writes: the pieces that changed, whole.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pieces {
    /// Events that are folded in.
    pub events: u64,
    /// [`Head::to_bytes`].
    pub head: Vec<u8>,
    /// Sessions by number.
    pub sessions: Vec<(SessionId, Vec<u8>)>,
    /// Links by the number of the first in the piece, a multiple of [`LINKS_PER_PIECE`].
    pub links: Vec<(u64, Vec<u8>)>,
    /// Places by number.
    pub places: Vec<(PlaceId, Vec<u8>)>,
}

impl Changes {
    /// No change since `map`.
    #[must_use]
    pub fn since(map: &Map) -> Self {
        Self { links: map.links().len(), ..Self::default() }
    }

    /// All of `map` but its places, where those are written as blocks.
    #[must_use]
    pub fn all_but_places(map: &Map) -> Self {
        Self { sessions: map.sessions().map(|(id, _)| id).collect(), ..Self::default() }
    }

    /// These and what changed before them, where that was not written.
    #[must_use]
    pub fn with_earlier(mut self, earlier: Changes) -> Self {
        let Changes { places, sessions, links } = earlier;
        self.places.extend(places);
        self.sessions.extend(sessions);
        self.links = self.links.min(links);
        self
    }

    /// Whether nothing has changed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        // Every event is of a session.
        self.sessions.is_empty()
    }

    /// Notes what `event` changes.
    pub fn follow(&mut self, event: &MapEvent) {
        self.sessions.insert(event.session());
        match event {
            MapEvent::Frame(frame) => self.places.extend(frame.decision.place.filter(|_| frame.learnt)),
            MapEvent::Corrected(event) => self.places.extend(event.place()),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) => {}
        }
    }
}

impl Mapper {
    /// The pieces of this map that changed.
    #[must_use]
    pub fn pieces(&self, changes: &Changes) -> Pieces {
        let Changes { places, sessions, links } = changes;
        let map = self.map();
        let session = |&id: &SessionId| Some((id, encode_session(map.session(id)?)));
        let index = self.recognizer().index();
        let place = |&place: &PlaceId| {
            Some((place, encode_place(map.places().get(place.index())?, &index.appearance(place)?)))
        };
        let first_piece = links / LINKS_PER_PIECE;
        let changed_links =
            if map.links().len() > *links { &map.links()[first_piece * LINKS_PER_PIECE..] } else { &[] };
        let link_pieces = (first_piece..).zip(changed_links.chunks(LINKS_PER_PIECE));
        Pieces {
            events: map.events(),
            head: Head::of(map).to_bytes(),
            sessions: sessions.iter().filter_map(session).collect(),
            links: link_pieces
                .map(|(piece, links)| ((piece * LINKS_PER_PIECE) as u64, encode_links(links)))
                .collect(),
            places: places.iter().filter_map(place).collect(),
        }
    }

    /// All places in sealed blocks of about `block_bytes` each, in order.
    pub fn blocks(&self, block_bytes: usize) -> impl Iterator<Item = Block> + '_ {
        let mut places = (0..).zip(self.map().places()).peekable();
        let index = self.recognizer().index();
        std::iter::from_fn(move || {
            let mut block = BlockWriter::new(PlaceId::new(places.peek()?.0));
            while block.len_bytes() < block_bytes
                && let Some((id, place)) = places.next()
            {
                block.push(place, &index.appearance(PlaceId::new(id))?);
            }
            Some(block.seal())
        })
    }
}

impl Head {
    /// Of a map as it is.
    #[must_use]
    pub fn of(map: &Map) -> Self {
        Self {
            events: map.events(),
            places: map.places().len() as u64,
            links: map.links().len() as u64,
            sessions: map.sessions().count() as u64,
            corrections: map.corrections_state().clone(),
        }
    }

    /// The byte form.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { events, places, links, sessions, corrections } = self;
        let mut writer = Writer::default();
        [events, places, links, sessions].into_iter().for_each(|count| writer.u64(*count));
        if corrections.is_empty() {
            return Container { version: HEAD_BEFORE_CORRECTIONS, ..HEAD }.seal(&writer.into_bytes());
        }
        corrections.encode(&mut writer);
        HEAD.seal(&writer.into_bytes())
    }

    /// Reads what [`Head::to_bytes`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are no head.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        let (version, payload) = HEAD.open(bytes)?;
        let mut reader = Reader::new(payload);
        let head = Self {
            events: reader.u64()?,
            places: reader.u64()?,
            links: reader.u64()?,
            sessions: reader.u64()?,
            corrections: if version > HEAD_BEFORE_CORRECTIONS {
                Corrections::decode(&mut reader)?
            } else {
                Corrections::default()
            },
        };
        reader.end()?;
        Ok(head)
    }
}

/// Places that follow each other, sealed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// The first place.
    pub first: PlaceId,
    /// Number of places.
    pub places: u32,
    /// The byte form.
    pub bytes: Vec<u8>,
}

/// Puts a [`Block`] together.
#[derive(Debug)]
pub struct BlockWriter {
    first: PlaceId,
    places: u32,
    writer: Writer,
    len_bytes: usize,
}

impl BlockWriter {
    /// A block that begins with the place `first`.
    #[must_use]
    pub fn new(first: PlaceId) -> Self {
        Self { first, places: 0, writer: Writer::default(), len_bytes: 0 }
    }

    /// Adds the next place.
    pub fn push(&mut self, place: &Place, appearance: &Appearance) {
        let mut writer = Writer::default();
        appearance.encode_packed(&mut writer);
        place.encode(&mut writer);
        let bytes = writer.into_bytes();
        self.writer.raw(&bytes);
        self.len_bytes += bytes.len();
        self.places += 1;
    }

    /// Bytes so far, without a few of the seal.
    #[must_use]
    pub fn len_bytes(&self) -> usize {
        self.len_bytes
    }

    /// The block.
    #[must_use]
    pub fn seal(self) -> Block {
        let Self { first, places, writer, len_bytes: _ } = self;
        let mut head = Writer::default();
        head.u32(first.number());
        head.u32(places);
        head.raw(&writer.into_bytes());
        Block { first, places, bytes: BLOCK.seal(&head.into_bytes()) }
    }
}

/// The first place of a sealed block, and all of them in order, over a vocabulary of
/// `vocabulary_len` words.
///
/// # Errors
/// [`DecodeError`] if the bytes are no block.
pub fn decode_block(
    bytes: &[u8],
    vocabulary_len: usize,
) -> Result<(PlaceId, Vec<(Place, Appearance)>), DecodeError> {
    let mut reader = Reader::new(BLOCK.open(bytes)?.1);
    let first = reader.u32()?;
    let places = reader.u32()?;
    let mut decoded = Vec::new();
    for _ in 0..places {
        let appearance = Appearance::decode_packed(&mut reader, vocabulary_len)?;
        decoded.push((Place::decode(&mut reader)?, appearance));
    }
    reader.end()?;
    Ok((PlaceId::new(first), decoded))
}

fn encode_session(session: &Session) -> Vec<u8> {
    let mut writer = Writer::default();
    session.encode(SESSION_VERSION, &mut writer);
    SESSION.seal(&writer.into_bytes())
}

fn encode_links(links: &[Link]) -> Vec<u8> {
    let mut writer = Writer::default();
    links.iter().for_each(|link| link.encode(&mut writer));
    LINKS.seal(&writer.into_bytes())
}

/// A map that is being put together from a checkpoint's pieces.
#[derive(Debug)]
pub struct Restoration {
    mapper: Mapper,
    head: Head,
    places: Vec<Place>,
    /// Those of places that are not indexed yet.
    appearances: Vec<Appearance>,
    links: Vec<Link>,
    sessions: BTreeMap<SessionId, Session>,
}

/// Places that are indexed at a time: the more, the less each costs.
const INDEXED_AT_A_TIME: usize = 65_536;

impl Restoration {
    /// Begins with the head.
    ///
    /// # Errors
    /// [`RestoreError`] if the bytes are no head, or the settings none of this model.
    pub fn new(model: &Model, settings: MapperSettings, head: &[u8]) -> Result<Self, RestoreError> {
        Ok(Self {
            mapper: Mapper::new(model, settings)?,
            head: Head::from_bytes(head)?,
            places: Vec::new(),
            appearances: Vec::new(),
            links: Vec::new(),
            sessions: BTreeMap::new(),
        })
    }

    /// Adds a session.
    ///
    /// # Errors
    /// [`RestoreError`] if the bytes are no session.
    pub fn session(&mut self, id: SessionId, bytes: &[u8]) -> Result<(), RestoreError> {
        let (version, payload) = SESSION.open(bytes)?;
        let mut reader = Reader::new(payload);
        let session = Session::decode(version, &mut reader)?;
        reader.end()?;
        self.sessions.insert(id, session);
        Ok(())
    }

    /// Adds the next links: those from number `first` on.
    ///
    /// # Errors
    /// [`RestoreError`] if the bytes are no links, or others are next.
    pub fn links(&mut self, first: u64, bytes: &[u8]) -> Result<(), RestoreError> {
        if first != self.links.len() as u64 {
            return Err(RestoreError::Missing { what: "links", from: self.links.len() as u64 });
        }
        let mut reader = Reader::new(LINKS.open(bytes)?.1);
        while reader.remaining() > 0 {
            self.links.push(Link::decode(&mut reader)?);
        }
        Ok(())
    }

    /// Adds the next place.
    ///
    /// # Errors
    /// [`RestoreError`] if another is next.
    pub fn place(
        &mut self,
        id: PlaceId,
        (place, appearance): (Place, Appearance),
    ) -> Result<(), RestoreError> {
        if id.index() != self.places.len() {
            return Err(RestoreError::Missing { what: "places", from: self.places.len() as u64 });
        }
        self.places.push(place);
        self.appearances.push(appearance);
        if self.appearances.len() == INDEXED_AT_A_TIME {
            self.mapper.index_places(self.appearances.drain(..));
        }
        Ok(())
    }

    /// The map, if this is all of it.
    ///
    /// # Errors
    /// [`RestoreError`] if something is missing, too many, or does not belong together.
    pub fn finish(self) -> Result<Mapper, RestoreError> {
        let Self { mut mapper, head, places, appearances, links, sessions } = self;
        mapper.index_places(appearances);
        let came = [
            ("places", places.len() as u64, head.places),
            ("links", links.len() as u64, head.links),
            ("sessions", sessions.len() as u64, head.sessions),
        ];
        if let Some(&(what, came, _)) = came.iter().find(|(_, came, expected)| came < expected) {
            return Err(RestoreError::Missing { what, from: came });
        }
        if let Some(&(what, _, expected)) = came.iter().find(|(_, came, expected)| came > expected) {
            return Err(RestoreError::TooMany { what, expected });
        }
        mapper.take_map(Map::from_parts(places, links, sessions, head.corrections, head.events)?);
        Ok(mapper)
    }
}
