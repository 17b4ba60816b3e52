//! Queries, sessions, and frames with the decisions about them.

use waypost_proto::v1;

use crate::client::{Call, Client, PAGE_SIZE, map_name};
#[cfg(doc)]
use crate::error::Error;
use crate::frame::FrameContent;

impl Client {
    /// Finds where one image, or one bag of words, was taken. `words_hash` is as in
    /// [`v1::OpenSession`]; `explained_words` asks for the reasons.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for a bad image, FAILED_PRECONDITION for
    /// words of another vocabulary.
    pub fn query<'a>(
        &'a self,
        map: &'a str,
        content: FrameContent,
        words_hash: &'a str,
        explained_words: Option<u32>,
    ) -> Call<'a, v1::QueryResponse> {
        Box::pin(async move {
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
            self.taken(self.recognition_client().query(request).await)
        })
    }

    /// The streams of robots that are open now, by when they were opened: into one map, or into all that the token
    /// reaches. Robots that are led are in [`Client::navigations`].
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn open_streams<'a>(&'a self, map: Option<&'a str>) -> Call<'a, Vec<v1::OpenStream>> {
        Box::pin(async move {
            let request = v1::ListOpenStreamsRequest { map: map.map(map_name).unwrap_or_default() };
            Ok(self.taken(self.sessions_client().list_open_streams(request).await)?.streams)
        })
    }

    /// Adds a relative pose that a robot measured; returns the pose on the map of the robot of the
    /// frame's session afterwards.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for an invalid measurement,
    /// FAILED_PRECONDITION if it would change nothing.
    pub fn add_relative_pose(&self, request: v1::AddRelativePoseRequest) -> Call<'_, Option<v1::MapPose>> {
        Box::pin(async move {
            let response = self.taken(self.sessions_client().add_relative_pose(request).await)?;
            Ok(response.map_pose)
        })
    }

    /// The sessions that added to a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn sessions<'a>(&'a self, map: &'a str) -> Call<'a, Vec<v1::Session>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request =
                    v1::ListSessionsRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
                let page = self.sessions_client().list_sessions(request).await?.into_inner();
                Ok((page.sessions, page.next_page_token))
            })
            .await
        })
    }

    /// Deletes a session (`maps/{map}/sessions/{session}`) from its map; returns the job that does
    /// so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION while a robot navigates in the map.
    pub fn delete_session<'a>(&'a self, name: &'a str) -> Call<'a, v1::Job> {
        Box::pin(async move {
            let request = v1::DeleteSessionRequest { name: name.to_owned() };
            self.taken(self.sessions_client().delete_session(request).await)
        })
    }

    /// A session by `maps/{map}/sessions/{session}`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn session<'a>(&'a self, name: &'a str) -> Call<'a, v1::Session> {
        Box::pin(async move {
            let request = v1::GetSessionRequest { name: name.to_owned() };
            self.taken(self.sessions_client().get_session(request).await)
        })
    }

    /// The frames of a session by sequence number, without their words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn frames<'a>(&'a self, session: &'a str) -> Call<'a, Vec<v1::FrameRecord>> {
        Box::pin(async move { self.frames_called(session, "").await })
    }

    /// The frames of a session whose robot calls them `note`, by sequence number; all if it is empty.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn frames_called<'a>(&'a self, session: &'a str, note: &'a str) -> Call<'a, Vec<v1::FrameRecord>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let session = session.to_owned();
                let request = v1::ListFramesRequest {
                    session,
                    page_size: PAGE_SIZE,
                    page_token,
                    note: note.to_owned(),
                    from_sequence: 0,
                };
                let page = self.sessions_client().list_frames(request).await?.into_inner();
                Ok((page.frames, page.next_page_token))
            })
            .await
        })
    }

    /// A frame by `maps/{map}/sessions/{session}/frames/{sequence}`, with its words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn frame<'a>(&'a self, name: &'a str) -> Call<'a, v1::FrameRecord> {
        Box::pin(async move {
            let request = v1::GetFrameRequest { name: name.to_owned() };
            self.taken(self.sessions_client().get_frame(request).await)
        })
    }

    /// The image or the thumbnail of a frame, if the map keeps it.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn frame_image<'a>(
        &'a self,
        name: &'a str,
        size: v1::get_frame_image_request::Size,
    ) -> Call<'a, v1::GetFrameImageResponse> {
        Box::pin(async move {
            let request = v1::GetFrameImageRequest { name: name.to_owned(), size: size.into() };
            self.taken(self.sessions_client().get_frame_image(request).await)
        })
    }

    /// Explains the decision about a frame.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if there is no such frame, or was no such place at that
    /// time.
    pub fn explain_frame<'a>(
        &'a self,
        name: &'a str,
        place_number: Option<u32>,
        max_words: Option<u32>,
    ) -> Call<'a, v1::FrameExplanation> {
        Box::pin(async move {
            let request = v1::ExplainFrameRequest { name: name.to_owned(), place_number, max_words };
            self.taken(self.sessions_client().explain_frame(request).await)
        })
    }

    /// A picture of a frame beside an earlier one of a place, as SVG, with common features in
    /// green. If left out, the place is the one that was matched, or the best candidate.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn frame_picture<'a>(&'a self, name: &'a str, place_number: Option<u32>) -> Call<'a, Vec<u8>> {
        Box::pin(async move {
            let name = name.to_owned();
            self.frame_pair_picture(v1::GetFramePictureRequest { name, place_number, ..Default::default() })
                .await
        })
    }

    /// A picture of a frame beside any other, also of another map with the same model; or beside
    /// one of a place, with words marked that were expected there and not seen.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, INVALID_ARGUMENT, or FAILED_PRECONDITION for frames of
    /// two models.
    pub fn frame_pair_picture(&self, request: v1::GetFramePictureRequest) -> Call<'_, Vec<u8>> {
        Box::pin(async move {
            let v1::GetFramePictureResponse { content_type: _, picture } =
                self.taken(self.sessions_client().get_frame_picture(request).await)?;
            Ok(picture)
        })
    }
}
