//! People say that loop closures are none, or were missed.

use topomap::log::{Correction, Undoing};
use topomap::mapper::Said;

use super::corrections::{CorrectionView, Corrections};
use super::frames::{Frames, LocatedFrame};
use super::tokens::Caller;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::names::{correction_in, map_in};
use crate::open_map::{CorrectionRequest, Verdict};
use crate::pages::{Page, numbered_page, page_size};
use crate::storage::MapRow;

/// Takes in what people say. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Correcting {
    pub(super) frames: Frames,
}

impl Correcting {
    /// All corrections of a map, oldest first.
    pub(crate) async fn list(
        &self,
        map: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<CorrectionView>, ServiceError> {
        let storage = &self.frames.storage;
        let row = self.frames.open_maps.row(map_in(map)?).await?;
        let size = page_size(size)? as usize;
        let after: Option<u64> = numbered_page(token)?;
        Ok(Corrections::read(storage, row.id).await?.page(storage, &row, after, size).await?)
    }

    /// Withdraws the loop closure of a frame.
    pub(crate) async fn withdraw(
        &self,
        caller: &Caller,
        frame: &str,
    ) -> Result<CorrectionView, ServiceError> {
        let LocatedFrame { map, position } = self.frames.locate(frame).await?;
        self.correct(caller, map, Verdict::Withdrawn { frame: position }).await
    }

    /// Says that two frames are of one place.
    pub(crate) async fn confirm(
        &self,
        caller: &Caller,
        frame: &str,
        matched: &str,
    ) -> Result<CorrectionView, ServiceError> {
        let LocatedFrame { map, position } = self.frames.locate(frame).await?;
        let LocatedFrame { map: other, position: earlier } = self.frames.locate(matched).await?;
        if map.id != other.id {
            return Err(ServiceError::invalid(format_args!(
                "{frame} is of the map {}, {matched} of {}; places of one map are linked, and maps are merged",
                map.name, other.name
            )));
        }
        self.correct(caller, map, Verdict::Confirmed { frame: position, matched: earlier }).await
    }

    /// Undoes a correction.
    pub(crate) async fn undo(&self, caller: &Caller, name: &str) -> Result<CorrectionView, ServiceError> {
        let (map, correction) = correction_in(name)?;
        let row = self.frames.open_maps.row(map).await?;
        self.correct(caller, row, Verdict::Undone { correction }).await
    }

    async fn correct(
        &self,
        caller: &Caller,
        map: MapRow,
        verdict: Verdict,
    ) -> Result<CorrectionView, ServiceError> {
        let open = self.frames.open_maps.open_of(&map).await?;
        // What was located is of the map as it was then.
        if open.edition() != map.edition() {
            return Err(ServiceError::Aborted {
                message: format!(
                    "the map {} was rewritten just now; look at the frames and say it again",
                    map.name
                ),
            });
        }
        let said = Said { by: caller.token.clone().unwrap_or_default(), said_ns: now_ns() };
        let event = open.correct(CorrectionRequest { verdict, said }).await?;
        let position = match event.correction {
            Correction::Withdrawn(_) | Correction::Confirmed(_) => event.position,
            Correction::Undone(Undoing { correction, .. }) => correction,
        };
        let storage = &self.frames.storage;
        let view = Corrections::read(storage, map.id).await?.view(storage, &map, position).await?;
        view.ok_or_else(|| ServiceError::internal("a correction is not in the log"))
    }
}
