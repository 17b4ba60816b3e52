//! What people say of loop closures.

use waypost_proto::v1;

use crate::client::{Call, Client, PAGE_SIZE, map_name};
#[cfg(doc)]
use crate::error::Error;

impl Client {
    /// Withdraws the loop closure of a frame (`maps/{map}/sessions/{session}/frames/{sequence}`):
    /// links that rested on it are taken out, and its frames are at no place.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if the frame closed no loop, or it
    /// was withdrawn.
    pub fn withdraw_loop_closure<'a>(&'a self, frame: &'a str) -> Call<'a, v1::Correction> {
        Box::pin(async move {
            let request = v1::WithdrawLoopClosureRequest { frame: frame.to_owned() };
            self.taken(self.corrections_client().withdraw_loop_closure(request).await)
        })
    }

    /// Says that a frame and an earlier one were taken at the same place: their places are linked.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, INVALID_ARGUMENT (frames the wrong way round), or
    /// FAILED_PRECONDITION if the map has them at one place, or has metres and nothing to measure
    /// the link by.
    pub fn confirm_loop_closure<'a>(
        &'a self,
        frame: &'a str,
        matched_frame: &'a str,
    ) -> Call<'a, v1::Correction> {
        Box::pin(async move {
            let frame = frame.to_owned();
            let request = v1::ConfirmLoopClosureRequest { frame, matched_frame: matched_frame.to_owned() };
            self.taken(self.corrections_client().confirm_loop_closure(request).await)
        })
    }

    /// Undoes a correction (`maps/{map}/corrections/{correction}`).
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if there is none that stands, or FAILED_PRECONDITION if a
    /// later one is about the same session.
    pub fn undo_correction<'a>(&'a self, name: &'a str) -> Call<'a, v1::Correction> {
        Box::pin(async move {
            let request = v1::UndoCorrectionRequest { name: name.to_owned() };
            self.taken(self.corrections_client().undo_correction(request).await)
        })
    }

    /// What people said of the loop closures of a map, oldest first, undone or not.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn corrections<'a>(&'a self, map: &'a str) -> Call<'a, Vec<v1::Correction>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request =
                    v1::ListCorrectionsRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
                let page = self.corrections_client().list_corrections(request).await?.into_inner();
                Ok((page.corrections, page.next_page_token))
            })
            .await
        })
    }
}
