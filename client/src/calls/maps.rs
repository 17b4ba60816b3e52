//! Maps, their places and their loop closures.

use waypost_proto::v1;

use crate::client::{Client, PAGE_SIZE, map_name};
use crate::error::Error;

impl Client {
    /// Creates a map; of the server's only model, if the request names none.
    ///
    /// # Errors
    /// [`Error::Status`] with ALREADY_EXISTS, NOT_FOUND (the model) or INVALID_ARGUMENT.
    pub async fn create_map(&self, request: v1::CreateMapRequest) -> Result<v1::Map, Error> {
        self.taken(self.maps_client().create_map(request).await)
    }

    /// All maps, by name.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn maps(&self) -> Result<Vec<v1::Map>, Error> {
        self.all_pages(|page_token| async move {
            let request = v1::ListMapsRequest { page_size: PAGE_SIZE, page_token };
            let page = self.maps_client().list_maps(request).await?.into_inner();
            Ok((page.maps, page.next_page_token))
        })
        .await
    }

    /// A map, by `name` or `maps/name`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn map(&self, name: &str, view: v1::MapView) -> Result<v1::Map, Error> {
        let request = v1::GetMapRequest { name: map_name(name), view: view.into() };
        self.taken(self.maps_client().get_map(request).await)
    }

    /// Deletes a map with all its sessions.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn delete_map(&self, name: &str) -> Result<(), Error> {
        let request = v1::DeleteMapRequest { name: map_name(name) };
        let v1::DeleteMapResponse {} = self.taken(self.maps_client().delete_map(request).await)?;
        Ok(())
    }

    /// All places of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn places(&self, map: &str) -> Result<Vec<v1::Place>, Error> {
        self.all_pages(|page_token| async move {
            let request = v1::ListPlacesRequest {
                map: map_name(map),
                page_size: PAGE_SIZE,
                page_token,
                ..v1::ListPlacesRequest::default()
            };
            let page = self.maps_client().list_places(request).await?.into_inner();
            Ok((page.places, page.next_page_token))
        })
        .await
    }

    /// All loop closures of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn loop_closures(&self, map: &str) -> Result<Vec<v1::LoopClosure>, Error> {
        self.all_pages(|page_token| async move {
            let request =
                v1::ListLoopClosuresRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
            let page = self.maps_client().list_loop_closures(request).await?.into_inner();
            Ok((page.loop_closures, page.next_page_token))
        })
        .await
    }

    /// A place by `maps/{map}/places/{number}`, with its words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn place(&self, name: &str) -> Result<v1::Place, Error> {
        self.taken(self.maps_client().get_place(v1::GetPlaceRequest { name: name.to_owned() }).await)
    }

    /// The places of a map where a word was seen, by number.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for a word that the vocabulary does not have.
    pub async fn word_places(&self, map: &str, word: u32) -> Result<Vec<v1::WordPlace>, Error> {
        self.all_pages(|page_token| async move {
            let map = map_name(map);
            let request = v1::ListWordPlacesRequest { map, word, page_size: PAGE_SIZE, page_token };
            let page = self.maps_client().list_word_places(request).await?.into_inner();
            Ok((page.places, page.next_page_token))
        })
        .await
    }

    /// How the match matrix of a map is laid out, against itself or another map of the same model.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the models differ.
    pub async fn match_matrix(&self, map: &str, against: Option<&str>) -> Result<v1::MatchMatrix, Error> {
        let against = against.map(map_name).unwrap_or_default();
        let request = v1::GetMatchMatrixRequest { map: map_name(map), against };
        self.taken(self.maps_client().get_match_matrix(request).await)
    }

    /// A tile of a match matrix as PNG: `tile_cells` x `tile_cells` pixels of 8 bits of grey.
    ///
    /// # Errors
    /// See [`Client::match_matrix`]; also INVALID_ARGUMENT or NOT_FOUND for a tile that it does not
    /// have.
    pub async fn match_matrix_tile(&self, request: v1::GetMatchMatrixTileRequest) -> Result<Vec<u8>, Error> {
        let v1::GetMatchMatrixTileResponse { content_type: _, picture } =
            self.taken(self.maps_client().get_match_matrix_tile(request).await)?;
        Ok(picture)
    }

    /// Continues a map with another model of the same words.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the words differ.
    pub async fn rebind_map(&self, map: &str, model: &str) -> Result<v1::Map, Error> {
        let request = v1::RebindMapRequest { name: map_name(map), model: model.to_owned() };
        self.taken(self.maps_client().rebind_map(request).await)
    }

    /// Forgets how a map came to be what it is, and wipes deleted data from the disk. Returns the
    /// job that does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn compact_map(&self, map: &str) -> Result<v1::Job, Error> {
        self.taken(self.maps_client().compact_map(v1::CompactMapRequest { name: map_name(map) }).await)
    }

    /// Finds the places to drop so that at most `max_places` remain; drops them only if the mode
    /// says so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION while a robot navigates in the map.
    pub async fn trim_map(&self, request: v1::TrimMapRequest) -> Result<v1::TrimMapResponse, Error> {
        self.taken(self.maps_client().trim_map(request).await)
    }

    /// Makes a new map from what a map keeps of its frames, with a model of other words. Returns
    /// the job that does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, ALREADY_EXISTS, or FAILED_PRECONDITION if the map does not
    /// keep images or descriptors.
    pub async fn rebuild_map(&self, map: &str, model: &str, into: &str) -> Result<v1::Job, Error> {
        let map_id = into.strip_prefix("maps/").unwrap_or(into).to_owned();
        let request = v1::RebuildMapRequest { name: map_name(map), model: model.to_owned(), map_id };
        self.taken(self.maps_client().rebuild_map(request).await)
    }

    /// Makes a new map from what is left of a damaged one, and of an earlier copy of it. Returns the job that does so;
    /// its last stage says what is lost.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, ALREADY_EXISTS, or FAILED_PRECONDITION if no damage was found in the map, or
    /// the copy is of another model.
    pub async fn repair_map(&self, map: &str, into: &str, copy: Option<&str>) -> Result<v1::Job, Error> {
        let map_id = into.strip_prefix("maps/").unwrap_or(into).to_owned();
        let copy = copy.map(map_name).unwrap_or_default();
        let request = v1::RepairMapRequest { name: map_name(map), map_id, copy };
        self.taken(self.maps_client().repair_map(request).await)
    }
}
