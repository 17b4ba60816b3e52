//! Maps, their places and their loop closures.

use waypost_proto::v1;

use crate::client::{Call, Client, PAGE_SIZE, map_name};
#[cfg(doc)]
use crate::error::Error;

impl Client {
    /// Creates a map; of the server's only model, if the request names none.
    ///
    /// # Errors
    /// [`Error::Status`] with ALREADY_EXISTS, NOT_FOUND (the model) or INVALID_ARGUMENT.
    pub fn create_map(&self, request: v1::CreateMapRequest) -> Call<'_, v1::Map> {
        Box::pin(async move { self.taken(self.maps_client().create_map(request).await) })
    }

    /// All maps, by name.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn maps(&self) -> Call<'_, Vec<v1::Map>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListMapsRequest { page_size: PAGE_SIZE, page_token };
                let page = self.maps_client().list_maps(request).await?.into_inner();
                Ok((page.maps, page.next_page_token))
            })
            .await
        })
    }

    /// A map, by `name` or `maps/name`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn map<'a>(&'a self, name: &'a str, view: v1::MapView) -> Call<'a, v1::Map> {
        Box::pin(async move {
            let request = v1::GetMapRequest { name: map_name(name), view: view.into() };
            self.taken(self.maps_client().get_map(request).await)
        })
    }

    /// Deletes a map with all its sessions.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn delete_map<'a>(&'a self, name: &'a str) -> Call<'a, ()> {
        Box::pin(async move {
            let request = v1::DeleteMapRequest { name: map_name(name) };
            let v1::DeleteMapResponse {} = self.taken(self.maps_client().delete_map(request).await)?;
            Ok(())
        })
    }

    /// All places of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn places<'a>(&'a self, map: &'a str) -> Call<'a, Vec<v1::Place>> {
        Box::pin(async move {
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
        })
    }

    /// All loop closures of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn loop_closures<'a>(&'a self, map: &'a str) -> Call<'a, Vec<v1::LoopClosure>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request =
                    v1::ListLoopClosuresRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
                let page = self.maps_client().list_loop_closures(request).await?.into_inner();
                Ok((page.loop_closures, page.next_page_token))
            })
            .await
        })
    }

    /// A place by `maps/{map}/places/{number}`, with its words.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn place<'a>(&'a self, name: &'a str) -> Call<'a, v1::Place> {
        Box::pin(async move {
            self.taken(self.maps_client().get_place(v1::GetPlaceRequest { name: name.to_owned() }).await)
        })
    }

    /// The places of a map where a word was seen, by number.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for a word that the vocabulary does not have.
    pub fn word_places<'a>(&'a self, map: &'a str, word: u32) -> Call<'a, Vec<v1::WordPlace>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let map = map_name(map);
                let request = v1::ListWordPlacesRequest { map, word, page_size: PAGE_SIZE, page_token };
                let page = self.maps_client().list_word_places(request).await?.into_inner();
                Ok((page.places, page.next_page_token))
            })
            .await
        })
    }

    /// How the match matrix of a map is laid out, against itself or another map of the same model.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the models differ.
    pub fn match_matrix<'a>(&'a self, map: &'a str, against: Option<&'a str>) -> Call<'a, v1::MatchMatrix> {
        Box::pin(async move {
            let against = against.map(map_name).unwrap_or_default();
            let request = v1::GetMatchMatrixRequest { map: map_name(map), against };
            self.taken(self.maps_client().get_match_matrix(request).await)
        })
    }

    /// A tile of a match matrix as PNG: `tile_cells` x `tile_cells` pixels of 8 bits of grey.
    ///
    /// # Errors
    /// See [`Client::match_matrix`]; also INVALID_ARGUMENT or NOT_FOUND for a tile that it does not
    /// have.
    pub fn match_matrix_tile(&self, request: v1::GetMatchMatrixTileRequest) -> Call<'_, Vec<u8>> {
        Box::pin(async move {
            let v1::GetMatchMatrixTileResponse { content_type: _, picture } =
                self.taken(self.maps_client().get_match_matrix_tile(request).await)?;
            Ok(picture)
        })
    }

    /// Continues a map with another model of the same words.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the words differ.
    pub fn rebind_map<'a>(&'a self, map: &'a str, model: &'a str) -> Call<'a, v1::Map> {
        Box::pin(async move {
            let request = v1::RebindMapRequest { name: map_name(map), model: model.to_owned() };
            self.taken(self.maps_client().rebind_map(request).await)
        })
    }

    /// Forgets how a map came to be what it is, and wipes deleted data from the disk. Returns the
    /// job that does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn compact_map<'a>(&'a self, map: &'a str) -> Call<'a, v1::Job> {
        Box::pin(async move {
            self.taken(self.maps_client().compact_map(v1::CompactMapRequest { name: map_name(map) }).await)
        })
    }

    /// Finds the places to drop so that at most `max_places` remain; drops them only if the mode
    /// says so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION while a robot navigates in the map.
    pub fn trim_map(&self, request: v1::TrimMapRequest) -> Call<'_, v1::TrimMapResponse> {
        Box::pin(async move { self.taken(self.maps_client().trim_map(request).await) })
    }

    /// Makes a new map from what a map keeps of its frames, with a model of other words. Returns
    /// the job that does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, ALREADY_EXISTS, or FAILED_PRECONDITION if the map does not
    /// keep images or descriptors.
    pub fn rebuild_map<'a>(&'a self, map: &'a str, model: &'a str, into: &'a str) -> Call<'a, v1::Job> {
        Box::pin(async move {
            let map_id = into.strip_prefix("maps/").unwrap_or(into).to_owned();
            let request = v1::RebuildMapRequest { name: map_name(map), model: model.to_owned(), map_id };
            self.taken(self.maps_client().rebuild_map(request).await)
        })
    }

    /// Makes a new map from what is left of a damaged one, and of an earlier copy of it. Returns the job that does so;
    /// its last stage says what is lost.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, ALREADY_EXISTS, or FAILED_PRECONDITION if no damage was found in the map, or
    /// the copy is of another model.
    pub fn repair_map<'a>(&'a self, map: &'a str, into: &'a str, copy: Option<&'a str>) -> Call<'a, v1::Job> {
        Box::pin(async move {
            let map_id = into.strip_prefix("maps/").unwrap_or(into).to_owned();
            let copy = copy.map(map_name).unwrap_or_default();
            let request = v1::RepairMapRequest { name: map_name(map), map_id, copy };
            self.taken(self.maps_client().repair_map(request).await)
        })
    }
}
