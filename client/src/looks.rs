//! Calls that look into a map: queries, sessions, frames, explanations.

use waypost_proto::v1;

use crate::client::{Client, PAGE_SIZE, map_name};
use crate::error::Error;
use crate::session::FrameContent;

impl Client {
    /// Where one image, or one bag of words, was taken. `words_hash` is that of [`v1::OpenSession`];
    /// `explained_words` above 0 asks why.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for a bad image, FAILED_PRECONDITION for words of
    /// another vocabulary.
    pub async fn query(
        &self,
        map: &str,
        content: FrameContent,
        words_hash: &str,
        explained_words: u32,
    ) -> Result<v1::QueryResponse, Error> {
        let content = match content {
            FrameContent::Image(image) => v1::query_request::Content::Image(image),
            FrameContent::Histogram(histogram) => v1::query_request::Content::Histogram(histogram),
            FrameContent::Words(words) => v1::query_request::Content::Words(words),
        };
        let request = v1::QueryRequest {
            map: map_name(map),
            content: Some(content),
            words_hash: words_hash.to_owned(),
            explained_words,
        };
        self.taken(self.sessions_client().query(request).await)
    }

    /// Tells the map what a robot measured by itself; where the robot of the frame's session is on the map then.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for numbers that measure nothing, FAILED_PRECONDITION if nothing
    /// would follow from it.
    pub async fn measure_closure(
        &self,
        request: v1::MeasureClosureRequest,
    ) -> Result<Option<v1::MapPose>, Error> {
        let response = self.taken(self.sessions_client().measure_closure(request).await)?;
        Ok(response.map_pose)
    }

    /// The sessions of a map that let it grow, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn sessions(&self, map: &str) -> Result<Vec<v1::Session>, Error> {
        self.all_pages(|page_token| {
            let mut service = self.sessions_client();
            let request = v1::ListSessionsRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_sessions(request).await?.into_inner();
                Ok((page.sessions, page.next_page_token))
            }
        })
        .await
    }

    /// A session by `maps/{map}/sessions/{session}`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn session(&self, name: &str) -> Result<v1::Session, Error> {
        let request = v1::GetSessionRequest { name: name.to_owned() };
        self.taken(self.sessions_client().get_session(request).await)
    }

    /// The frames of a session by sequence number, without their words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn frames(&self, session: &str) -> Result<Vec<v1::FrameRecord>, Error> {
        self.all_pages(|page_token| {
            let mut service = self.sessions_client();
            let session = session.to_owned();
            let request = v1::ListFramesRequest { session, page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_frames(request).await?.into_inner();
                Ok((page.frames, page.next_page_token))
            }
        })
        .await
    }

    /// A frame by `maps/{map}/sessions/{session}/frames/{sequence}`, with its words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn frame(&self, name: &str) -> Result<v1::FrameRecord, Error> {
        let request = v1::GetFrameRequest { name: name.to_owned() };
        self.taken(self.sessions_client().get_frame(request).await)
    }

    /// What a frame looked like, as far as the map keeps it.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn frame_image(
        &self,
        name: &str,
        size: v1::get_frame_image_request::Size,
    ) -> Result<v1::GetFrameImageResponse, Error> {
        let request = v1::GetFrameImageRequest { name: name.to_owned(), size: size.into() };
        self.taken(self.sessions_client().get_frame_image(request).await)
    }

    /// Why a frame was decided as it was.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND: no such frame, or no such place when it came in.
    pub async fn explain_frame(
        &self,
        name: &str,
        place: Option<u32>,
        words: u32,
    ) -> Result<v1::FrameExplanation, Error> {
        let request = v1::ExplainFrameRequest { name: name.to_owned(), place, words };
        self.taken(self.sessions_client().explain_frame(request).await)
    }

    /// A frame, by its full name, beside an earlier one of `place`, as SVG: what they have in common is green. Left
    /// out, the place is the one that was, or could have been, matched.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn frame_picture(&self, name: &str, place: Option<u32>) -> Result<Vec<u8>, Error> {
        let request = v1::GetFramePictureRequest { name: name.to_owned(), place };
        let v1::GetFramePictureResponse { content_type: _, picture } =
            self.taken(self.sessions_client().get_frame_picture(request).await)?;
        Ok(picture)
    }

    /// A place by `maps/{map}/places/{number}`, with its words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn place(&self, name: &str) -> Result<v1::Place, Error> {
        self.taken(self.maps_client().get_place(v1::GetPlaceRequest { name: name.to_owned() }).await)
    }

    /// The places of a map that have shown a word, by number.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for a word that the vocabulary does not have.
    pub async fn word_places(&self, map: &str, word: u32) -> Result<Vec<v1::WordPlace>, Error> {
        self.all_pages(|page_token| {
            let mut service = self.maps_client();
            let map = map_name(map);
            let request = v1::ListWordPlacesRequest { map, word, page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_word_places(request).await?.into_inner();
                Ok((page.places, page.next_page_token))
            }
        })
        .await
    }

    /// Goes on with another model over the same words.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the words differ.
    pub async fn rebind_map(&self, map: &str, model: &str) -> Result<v1::Map, Error> {
        let request = v1::RebindMapRequest { name: map_name(map), model: model.to_owned() };
        self.taken(self.maps_client().rebind_map(request).await)
    }
}
