//! What the log keeps of sessions and their frames.

use std::collections::HashMap;

use fabmap::observation::Observation;
use topomap::evidence::{Candidate, Match};
use topomap::ids::{FrameId, SessionId};
use topomap::log::FrameEvent;
use topomap::metric::Odometry;

use super::corrections::{CorrectionKind, CorrectionView, Corrections};
use crate::error::ServiceError;
use crate::ingest::model::LoadedModels;
use crate::names::{frame_in, frame_name, map_in, session_in, session_name};
use crate::open_map::answers::{FrameAnswer, GeometryView, MatchView, reference};
use crate::open_map::{OpenMaps, no_such_map};
use crate::pages::{Page, numbered_page, page_from, page_size};
pub(crate) use crate::storage::{FrameBytes, SessionSummary};
use crate::storage::{FrameRow, MapRow, MediumKind, SessionRow, Storage, StoredFrame};

/// A session as people see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SessionView {
    /// `maps/{map}/sessions/{session}`.
    pub(crate) name: String,
    pub(crate) summary: SessionSummary,
}

/// A frame as the log keeps it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameView {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`.
    pub(crate) name: String,
    pub(crate) stamp_ns: i64,
    /// What its robot calls it; empty if nothing.
    pub(crate) note: String,
    /// What was decided, as the robot was told.
    pub(crate) answer: FrameAnswer,
    pub(crate) odometry: Option<Odometry>,
    pub(crate) learnt: bool,
    pub(crate) observation: Observation,
    pub(crate) bytes: FrameBytes,
    /// What people say of its place, as far as it stands.
    pub(crate) corrections: Vec<CorrectionView>,
}

impl FrameView {
    /// Whether it is at no place, whatever was decided.
    pub(super) fn is_withdrawn(&self) -> bool {
        self.corrections.iter().any(|correction| correction.kind == CorrectionKind::Withdrawn)
    }
}

/// Which frames of a session are listed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct FramesWanted<'a> {
    /// Those that their robot calls so; all if empty.
    pub(crate) note: &'a str,
    pub(crate) from_sequence: u64,
}

/// Which picture of a frame is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ImageSize {
    /// The image if it is kept, else the thumbnail.
    #[default]
    Best,
    Original,
    Thumbnail,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FrameImage {
    pub(crate) content_type: &'static str,
    pub(crate) image: Vec<u8>,
}

/// A frame on the disk: its map, and where it is in the log.
pub(super) struct LocatedFrame {
    pub(super) map: MapRow,
    pub(super) position: FrameId,
}

/// What the log keeps of sessions and frames. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Frames {
    pub(super) storage: Storage,
    pub(super) models: LoadedModels,
    pub(super) open_maps: OpenMaps,
}

impl Frames {
    /// The sessions of a map, oldest first.
    pub(crate) async fn sessions(
        &self,
        name: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<SessionView>, ServiceError> {
        let map = map_in(name)?;
        let size = page_size(size)?;
        let row = self.open_maps.row(map).await?;
        let from = numbered_page(token)?.unwrap_or(0);
        let mut sessions = self.storage.session_summaries(row.id, from, size + 1).await?;
        let next = sessions.get(size as usize).map_or_else(String::new, |next| page_from(next.number));
        sessions.truncate(size as usize);
        let view = |summary: SessionSummary| SessionView { name: session_name(map, &summary.name), summary };
        Ok(Page { items: sessions.into_iter().map(view).collect(), next })
    }

    pub(crate) async fn session(&self, name: &str) -> Result<SessionView, ServiceError> {
        let (map, session) = session_in(name)?;
        let row = self.open_maps.row(map).await?;
        match self.storage.session_summary(row.id, session).await? {
            Some(summary) => Ok(SessionView { name: name.to_owned(), summary }),
            None => Err(no_such_session(map, session)),
        }
    }

    /// The frames of a session, by sequence number; only those with that note, unless it is empty.
    pub(crate) async fn list(
        &self,
        name: &str,
        FramesWanted { note, from_sequence }: FramesWanted<'_>,
        size: u32,
        token: &str,
    ) -> Result<Page<FrameView>, ServiceError> {
        let (map, session) = session_in(name)?;
        let size = page_size(size)?;
        let row = self.open_maps.row(map).await?;
        let number = self.storage.session_number(row.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(map, session))?;
        let after = numbered_page(token)?.or(from_sequence.checked_sub(1));
        let words = self.vocabulary_len(&row).await?;
        let mut frames = self.storage.frames_of_session(row.id, number, after, note, size + 1, words).await?;
        let more = frames.len() > size as usize;
        frames.truncate(size as usize);
        let next =
            frames.last().filter(|_| more).map_or_else(String::new, |frame| page_from(frame.event.sequence));
        Ok(Page { items: self.frame_views(&row, frames).await?, next })
    }

    pub(crate) async fn get(&self, name: &str) -> Result<FrameView, ServiceError> {
        let (map, session, sequence) = frame_in(name)?;
        let row = self.open_maps.row(map).await?;
        let number = self.storage.session_number(row.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(map, session))?;
        let words = self.vocabulary_len(&row).await?;
        let frame = self.storage.frame_of_sequence(row.id, number, sequence, words).await?;
        let frame = frame.ok_or_else(|| no_such_frame(map, session, sequence))?;
        let mut views = self.frame_views(&row, vec![frame]).await?;
        views.pop().ok_or_else(|| ServiceError::internal("a frame without a view"))
    }

    /// What a frame looked like, as far as the map keeps it.
    pub(crate) async fn image(&self, name: &str, size: ImageSize) -> Result<FrameImage, ServiceError> {
        let LocatedFrame { map, position } = self.locate(name).await?;
        let kinds: &[MediumKind] = match size {
            ImageSize::Best => &[MediumKind::Image, MediumKind::Thumbnail],
            ImageSize::Original => &[MediumKind::Image],
            ImageSize::Thumbnail => &[MediumKind::Thumbnail],
        };
        for &kind in kinds {
            if let Some(image) = self.storage.medium(map.id, position, kind).await? {
                return Ok(FrameImage { content_type: content_type(&image), image });
            }
        }
        Err(ServiceError::not_found(format_args!(
            "this image of {name} is not kept: the robot sent words, or the map keeps less; a map that keeps \
             features has thumbnails, one that keeps images has both"
        )))
    }

    pub(super) async fn locate(&self, name: &str) -> Result<LocatedFrame, ServiceError> {
        let (map, session, sequence) = frame_in(name)?;
        let row = self.open_maps.row(map).await?;
        let number = self.storage.session_number(row.id, session).await?;
        let number = number.ok_or_else(|| no_such_session(map, session))?;
        let position = self.storage.position_of_sequence(row.id, number, sequence).await?;
        let position = position.ok_or_else(|| no_such_frame(map, session, sequence))?;
        Ok(LocatedFrame { map: row, position })
    }

    pub(super) async fn vocabulary_len(&self, map: &MapRow) -> Result<usize, ServiceError> {
        Ok(self.models.get(&map.model).await?.model.vocabulary().len())
    }

    /// Views of frames; the frames that they matched are looked up together.
    pub(super) async fn frame_views(
        &self,
        map: &MapRow,
        frames: Vec<FrameRow>,
    ) -> Result<Vec<FrameView>, ServiceError> {
        let matches = |event: &FrameEvent| [event.decision.closure, event.proposal].into_iter().flatten();
        let positions = frames.iter().flat_map(|row| matches(&row.event)).map(|found| found.frame);
        let positions: Vec<FrameId> = positions.collect();
        let matched = self.storage.frames_by_position(map.id, positions).await?;
        let sessions = self.storage.sessions(map.id).await?;
        let known = Known { map: &map.name, sessions: &sessions, matched: &matched };
        let of_frames = frames.iter().map(|row| row.event.frame).collect();
        let corrections = Corrections::read(&self.storage, map.id).await?;
        let mut corrected = corrections.of_frames(&self.storage, map, of_frames).await?;
        let view = |row: FrameRow| {
            let corrections = corrected.remove(&row.event.frame).unwrap_or_default();
            frame_view(row, corrections, &known)
        };
        let views: Result<Vec<_>, ServiceError> = frames.into_iter().map(view).collect();
        if views.is_err() {
            // Since the frames were read, it may be gone, or another.
            let now = self.open_maps.row(&map.name).await?;
            if now.id != map.id {
                return Err(no_such_map(&map.name));
            }
            if now.edition != map.edition {
                return Err(ServiceError::Aborted {
                    message: format!(
                        "the map {} was rewritten while its frames were read; ask again",
                        map.name
                    ),
                });
            }
        }
        views
    }
}

/// What the frames of one answer refer to.
struct Known<'a> {
    map: &'a str,
    sessions: &'a [SessionRow],
    matched: &'a HashMap<FrameId, StoredFrame>,
}

impl Known<'_> {
    /// `maps/{map}/sessions/{session}`.
    fn session(&self, number: SessionId) -> Result<String, ServiceError> {
        let session = self.sessions.iter().find(|session| session.number == number);
        let session =
            session.ok_or_else(|| ServiceError::internal("a frame's session is not in the table"))?;
        Ok(session_name(self.map, &session.name))
    }

    fn matched(&self, found: Match, candidates: &[Candidate]) -> Result<MatchView, ServiceError> {
        let geometry = GeometryView::of(found, candidates);
        let Match { place, posterior, log_odds, frame: _ } = found;
        let frame = self.matched.get(&found.frame);
        let frame = frame.ok_or_else(|| {
            let gone = format!(
                "map {}: event {} of the log, with which a frame was matched, is gone",
                self.map, found.frame
            );
            ServiceError::damaged(&gone)
        })?;
        let frame = reference(self.map, self.sessions, frame);
        Ok(MatchView { place, posterior, log_odds, frame, geometry })
    }
}

fn frame_view(
    row: FrameRow,
    corrections: Vec<CorrectionView>,
    known: &Known<'_>,
) -> Result<FrameView, ServiceError> {
    let FrameRow { event, note, bytes } = row;
    let session = known.session(event.session)?;
    let matched = |found| known.matched(found, &event.candidates);
    let answer = FrameAnswer::new(
        &event,
        event.sequence,
        event.decision.closure.map(matched).transpose()?,
        event.proposal.map(matched).transpose()?,
        None,
    );
    Ok(FrameView {
        name: frame_name(&session, event.sequence),
        stamp_ns: event.stamp_ns,
        note,
        answer,
        odometry: event.odometry,
        learnt: event.learnt,
        observation: event.observation,
        bytes,
        corrections,
    })
}

/// JPEG or PNG: nothing else is ever kept.
pub(super) fn content_type(image: &[u8]) -> &'static str {
    if image.starts_with(b"\x89PNG") { "image/png" } else { "image/jpeg" }
}

pub(super) fn no_such_session(map: &str, session: &str) -> ServiceError {
    ServiceError::not_found(format_args!(
        "the map {map} has no session {session}; list its sessions to see what there is (those that localize \
         are not kept)"
    ))
}

pub(super) fn no_such_frame(map: &str, session: &str, sequence: u64) -> ServiceError {
    ServiceError::not_found(format_args!(
        "the session {session} of the map {map} has no frame {sequence}; list its frames to see what there is"
    ))
}
