//! What people say of loop closures.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use topomap::ids::FrameId;
use topomap::log::{Confirmation, Correction, CorrectionEvent, Undoing, Withdrawal};
use topomap::mapper::Said;

use crate::clock::in_words;
use crate::names::correction_name;
use crate::open_map::answers::{FrameReference, reference};
use crate::pages::{Page, page_from};
use crate::storage::{MapId, MapRow, Storage, StorageError};

/// A correction as people see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CorrectionView {
    /// `maps/{map}/corrections/{correction}`.
    pub(crate) name: String,
    pub(crate) kind: CorrectionKind,
    pub(crate) frame: FrameReference,
    pub(crate) matched: FrameReference,
    /// The place that a frame was not at.
    pub(crate) place: Option<PlaceId>,
    /// How many frames are at no place by it.
    pub(crate) frames: usize,
    pub(crate) said: Said,
    /// Who undid it, if it was undone.
    pub(crate) undone: Option<Said>,
}

/// What was said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CorrectionKind {
    Withdrawn,
    Confirmed,
}

/// The corrections of a map, by their positions in its log.
#[derive(Clone, Debug, Default)]
pub(super) struct Corrections {
    said: BTreeMap<u64, CorrectionEvent>,
    undone: BTreeMap<u64, Said>,
}

/// How many of them stand, and what they change of what the log's columns count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct CorrectionCounts {
    pub(crate) withdrawn: u64,
    pub(crate) confirmed: u64,
    pub(crate) links_added: u64,
    pub(crate) links_taken_out: u64,
}

impl Corrections {
    pub(super) async fn read(storage: &Storage, map: MapId) -> Result<Self, StorageError> {
        let mut corrections = Self::default();
        for event in storage.corrections(map).await? {
            if let Correction::Undone(Undoing { correction, .. }) = event.correction {
                corrections.undone.insert(correction, Said { by: event.by, said_ns: event.said_ns });
            } else {
                corrections.said.insert(event.position, event);
            }
        }
        Ok(corrections)
    }

    fn standing(&self) -> impl Iterator<Item = &CorrectionEvent> {
        self.said.values().filter(|event| !self.undone.contains_key(&event.position))
    }

    /// Those that stand of a frame: that it is at no place, or at that of another frame.
    fn of_frame(&self, frame: FrameId) -> impl Iterator<Item = &CorrectionEvent> {
        self.standing().filter(move |event| match &event.correction {
            Correction::Withdrawn(withdrawal) => withdrawal.has(frame),
            Correction::Confirmed(Confirmation { frame: later, earlier, .. }) => {
                [later, earlier].contains(&&frame)
            }
            Correction::Undone(_) => false,
        })
    }

    /// Whether a frame is at no place.
    pub(super) fn is_withdrawn(&self, frame: FrameId) -> bool {
        self.withdrawal_of(frame).is_some()
    }

    /// The correction by which a frame is at no place.
    fn withdrawal_of(&self, frame: FrameId) -> Option<&CorrectionEvent> {
        self.of_frame(frame).find(|event| matches!(event.correction, Correction::Withdrawn(_)))
    }

    pub(super) fn counts(&self) -> CorrectionCounts {
        let mut counts = CorrectionCounts::default();
        for event in self.standing() {
            match &event.correction {
                Correction::Withdrawn(withdrawal) => {
                    let relinked = &withdrawal.relinked;
                    counts.withdrawn += 1;
                    counts.links_added +=
                        relinked.iter().filter(|relinked| relinked.now.is_some()).count() as u64;
                    counts.links_taken_out +=
                        relinked.iter().filter(|relinked| relinked.was.is_some()).count() as u64;
                }
                Correction::Confirmed(Confirmation { link, .. }) => {
                    counts.confirmed += 1;
                    counts.links_added += u64::from(link.is_some());
                }
                Correction::Undone(_) => {}
            }
        }
        counts
    }

    /// What people say of some frames, by frame.
    pub(super) async fn of_frames(
        &self,
        storage: &Storage,
        map: &MapRow,
        frames: Vec<FrameId>,
    ) -> Result<BTreeMap<FrameId, Vec<CorrectionView>>, StorageError> {
        let mut views: BTreeMap<FrameId, Vec<CorrectionView>> = BTreeMap::new();
        for frame in frames {
            let of_frame: Vec<&CorrectionEvent> = self.of_frame(frame).collect();
            if !of_frame.is_empty() {
                views.insert(frame, self.views(storage, map, of_frame).await?);
            }
        }
        Ok(views)
    }

    /// The corrections by which loop closures were withdrawn, by the frames of these.
    pub(super) async fn withdrawals(
        &self,
        storage: &Storage,
        map: &MapRow,
        frames: Vec<FrameId>,
    ) -> Result<BTreeMap<FrameId, CorrectionView>, StorageError> {
        let mut views = BTreeMap::new();
        for frame in frames {
            let withdrawal =
                self.views(storage, map, self.withdrawal_of(frame).into_iter().collect()).await?.pop();
            views.extend(withdrawal.map(|withdrawal| (frame, withdrawal)));
        }
        Ok(views)
    }

    /// With frames as users name them, all looked up together. What is gone since it was read is left out.
    async fn views(
        &self,
        storage: &Storage,
        map: &MapRow,
        events: Vec<&CorrectionEvent>,
    ) -> Result<Vec<CorrectionView>, StorageError> {
        let events: Vec<(&CorrectionEvent, Of)> = events.into_iter().filter_map(said_of).collect();
        if events.is_empty() {
            return Ok(Vec::new());
        }
        let positions = events.iter().flat_map(|(_, of)| [of.frame, of.earlier]);
        let frames = storage.frames_by_position(map.id, positions.collect::<Vec<_>>()).await?;
        let sessions = storage.sessions(map.id).await?;
        let named = |frame: FrameId| Some(reference(&map.name, &sessions, frames.get(&frame)?));
        let view = |(event, of): (&CorrectionEvent, Of)| {
            Some(CorrectionView {
                name: correction_name(&map.name, event.position),
                kind: of.kind,
                frame: named(of.frame)?,
                matched: named(of.earlier)?,
                place: of.place,
                frames: of.frames,
                said: Said { by: event.by.clone(), said_ns: event.said_ns },
                undone: self.undone.get(&event.position).cloned(),
            })
        };
        Ok(events.into_iter().filter_map(view).collect())
    }

    /// What stands, a line each, as comments of g2o.
    pub(super) async fn told(&self, storage: &Storage, map: &MapRow) -> Result<String, StorageError> {
        let views = self.views(storage, map, self.standing().collect()).await?;
        let line = |view: CorrectionView| {
            let FrameReference { session, sequence, .. } = &view.frame;
            let FrameReference { session: at, sequence: number, .. } = &view.matched;
            format!("# {session}/frames/{sequence} and {at}/frames/{number}: {}\n", view.told())
        };
        Ok(views.into_iter().map(line).collect())
    }

    /// Those of a map from one on, undone or not, and whether there are more.
    pub(super) async fn page(
        &self,
        storage: &Storage,
        map: &MapRow,
        after: Option<u64>,
        size: usize,
    ) -> Result<Page<CorrectionView>, StorageError> {
        let later = |position: &u64| after.is_none_or(|after| *position > after);
        let listed = self.said.iter().filter(|(position, _)| later(position)).map(|(_, event)| event);
        let listed: Vec<&CorrectionEvent> = listed.take(size + 1).collect();
        let (listed, more) = listed.split_at(listed.len().min(size));
        let next = listed.last().filter(|_| !more.is_empty());
        let next = next.map_or_else(String::new, |last| page_from(last.position));
        Ok(Page { items: self.views(storage, map, listed.to_vec()).await?, next })
    }

    /// The one at a position; `None` if there is none.
    pub(super) async fn view(
        &self,
        storage: &Storage,
        map: &MapRow,
        position: u64,
    ) -> Result<Option<CorrectionView>, StorageError> {
        let said = self.said.get(&position).into_iter().collect();
        Ok(self.views(storage, map, said).await?.pop())
    }
}

impl CorrectionView {
    /// For people: who said it, and when.
    pub(super) fn told(&self) -> String {
        let Self { kind, said: Said { by, said_ns }, .. } = self;
        let said = match kind {
            CorrectionKind::Withdrawn => "withdrawn",
            CorrectionKind::Confirmed => "said to be of one place with another frame",
        };
        let by = if by.is_empty() { "somebody without a token" } else { by };
        format!("{said} by {by}, {}", in_words(*said_ns))
    }
}

/// What a correction is of.
struct Of {
    kind: CorrectionKind,
    frame: FrameId,
    earlier: FrameId,
    place: Option<PlaceId>,
    frames: usize,
}

/// `None` of one that undoes another.
fn said_of(event: &CorrectionEvent) -> Option<(&CorrectionEvent, Of)> {
    match &event.correction {
        Correction::Withdrawn(withdrawal) => {
            let Withdrawal { frame, earlier, place, frames, .. } = withdrawal.as_ref();
            let kind = CorrectionKind::Withdrawn;
            let frames = frames.len();
            Some((event, Of { kind, frame: *frame, earlier: *earlier, place: Some(*place), frames }))
        }
        Correction::Confirmed(Confirmation { frame, earlier, .. }) => {
            let kind = CorrectionKind::Confirmed;
            Some((event, Of { kind, frame: *frame, earlier: *earlier, place: None, frames: 0 }))
        }
        Correction::Undone(_) => None,
    }
}
