use futures::stream::{self, BoxStream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::export_poses_request::{Body, Format, Frame};
use waypost_proto::v1::map_service_server::MapService;

use super::Adapter;
use super::reach::{with_caller, within};
use crate::error::ServiceError;
use crate::names::{map_in, place_in};
use crate::pages::Page;
use crate::service::maps::Detail;
use crate::service::match_matrix::TileAt;
use crate::service::rewriting::{Trimmed, Trimming};
use crate::service::trajectories::{TrajectoryBody, TrajectoryFormat, TrajectoryFrame, TrajectoryWanted};
use crate::wire::jobs::job;
use crate::wire::known;
use crate::wire::maps::{dropped_place, loop_closure, map};
use crate::wire::match_matrix::{match_matrix, tile};
use crate::wire::places::{listed_place, place, places_wanted, word_place};
use crate::wire::settings::requested_settings;

/// Largest piece that a text is handed out in.
const CHUNK_BYTES: usize = 1 << 20;

#[tonic::async_trait]
impl MapService for Adapter {
    async fn create_map(&self, request: Request<v1::CreateMapRequest>) -> Result<Response<v1::Map>, Status> {
        let (caller, v1::CreateMapRequest { map_id, model, settings }) = with_caller(request)?;
        let settings = requested_settings(settings.unwrap_or_default())?;
        Ok(Response::new(map(self.service.maps.create(&caller, &map_id, &model, settings).await?)))
    }

    async fn list_maps(
        &self,
        request: Request<v1::ListMapsRequest>,
    ) -> Result<Response<v1::ListMapsResponse>, Status> {
        let (caller, v1::ListMapsRequest { page_size, page_token }) = with_caller(request)?;
        let Page { items, next } = self.service.maps.list(&caller, page_size, &page_token).await?;
        let maps = items.into_iter().map(map).collect();
        Ok(Response::new(v1::ListMapsResponse { maps, next_page_token: next }))
    }

    async fn get_map(&self, request: Request<v1::GetMapRequest>) -> Result<Response<v1::Map>, Status> {
        let v1::GetMapRequest { name, view } = within(request)?;
        let detail = match known("view", view)? {
            v1::MapView::Unspecified | v1::MapView::Basic => Detail::Basic,
            v1::MapView::Full => Detail::Full,
        };
        Ok(Response::new(map(self.service.maps.get(&name, detail).await?)))
    }

    async fn delete_map(
        &self,
        request: Request<v1::DeleteMapRequest>,
    ) -> Result<Response<v1::DeleteMapResponse>, Status> {
        let v1::DeleteMapRequest { name } = within(request)?;
        self.service.rewriting.delete_map(&name).await?;
        Ok(Response::new(v1::DeleteMapResponse {}))
    }

    async fn list_places(
        &self,
        request: Request<v1::ListPlacesRequest>,
    ) -> Result<Response<v1::ListPlacesResponse>, Status> {
        let v1::ListPlacesRequest {
            map,
            page_size,
            page_token,
            every,
            from_place_number,
            to_place_number,
            within: bounds,
        } = within(request)?;
        let wanted = places_wanted(every, from_place_number, to_place_number, bounds)?;
        let Page { items, next } = self.service.maps.places(&map, wanted, page_size, &page_token).await?;
        let map = map_in(&map)?;
        let places = items.into_iter().map(|view| listed_place(map, view)).collect();
        Ok(Response::new(v1::ListPlacesResponse { places, next_page_token: next }))
    }

    async fn list_loop_closures(
        &self,
        request: Request<v1::ListLoopClosuresRequest>,
    ) -> Result<Response<v1::ListLoopClosuresResponse>, Status> {
        let v1::ListLoopClosuresRequest { map, page_size, page_token } = within(request)?;
        let Page { items, next } = self.service.maps.loop_closures(&map, page_size, &page_token).await?;
        let loop_closures = items.into_iter().map(loop_closure).collect();
        Ok(Response::new(v1::ListLoopClosuresResponse { loop_closures, next_page_token: next }))
    }

    async fn get_place(&self, request: Request<v1::GetPlaceRequest>) -> Result<Response<v1::Place>, Status> {
        let v1::GetPlaceRequest { name } = within(request)?;
        let view = self.service.maps.place(&name).await?;
        let (map, _) = place_in(&name)?;
        Ok(Response::new(place(map, view)))
    }

    async fn list_word_places(
        &self,
        request: Request<v1::ListWordPlacesRequest>,
    ) -> Result<Response<v1::ListWordPlacesResponse>, Status> {
        let v1::ListWordPlacesRequest { map, word, page_size, page_token } = within(request)?;
        let Page { items, next } =
            self.service.maps.word_places(&map, word.into(), page_size, &page_token).await?;
        let places = items.into_iter().map(word_place).collect();
        Ok(Response::new(v1::ListWordPlacesResponse { places, next_page_token: next }))
    }

    async fn get_match_matrix(
        &self,
        request: Request<v1::GetMatchMatrixRequest>,
    ) -> Result<Response<v1::MatchMatrix>, Status> {
        let v1::GetMatchMatrixRequest { map, against } = within(request)?;
        Ok(Response::new(match_matrix(self.service.match_matrices.describe(&map, &against).await?)))
    }

    async fn get_match_matrix_tile(
        &self,
        request: Request<v1::GetMatchMatrixTileRequest>,
    ) -> Result<Response<v1::GetMatchMatrixTileResponse>, Status> {
        let v1::GetMatchMatrixTileRequest { map, against, level, row, column } = within(request)?;
        let at = TileAt { level, row, column };
        Ok(Response::new(tile(self.service.match_matrices.tile(&map, &against, at).await?)))
    }

    async fn rebind_map(&self, request: Request<v1::RebindMapRequest>) -> Result<Response<v1::Map>, Status> {
        let v1::RebindMapRequest { name, model } = within(request)?;
        Ok(Response::new(map(self.service.maps.rebind(&name, &model).await?)))
    }

    type ExportPosesStream = BoxStream<'static, Result<v1::ExportPosesResponse, Status>>;

    async fn export_poses(
        &self,
        request: Request<v1::ExportPosesRequest>,
    ) -> Result<Response<Self::ExportPosesStream>, Status> {
        let v1::ExportPosesRequest { name, format, frame, body, every } = within(request)?;
        let frame = match known("frame", frame)? {
            Frame::Unspecified | Frame::Map => TrajectoryFrame::Map,
            Frame::Odom => TrajectoryFrame::Odom,
        };
        let body = match known("body", body)? {
            Body::Unspecified | Body::Base => TrajectoryBody::Base,
            Body::Camera => TrajectoryBody::Camera,
        };
        let session = async |format| {
            let wanted = TrajectoryWanted { format, frame, body, every };
            self.service.trajectories.session(&name, wanted).await
        };
        let text = match known("format", format)? {
            Format::Unspecified => {
                return Err(ServiceError::invalid(
                    "name a format: TUM or KITTI for a session, G2O for a map",
                )
                .into());
            }
            Format::Tum => session(TrajectoryFormat::Tum).await?,
            Format::Kitti => session(TrajectoryFormat::Kitti).await?,
            Format::G2o if every > 1 => {
                return Err(ServiceError::invalid(
                    "a map's graph cannot be thinned, for its links join its places; leave `every` out, or name a session and \
                     TUM or KITTI",
                )
                .into());
            }
            Format::G2o => self.service.trajectories.pose_graph(&name).await?,
        };
        let chunks: Vec<_> = text
            .chunks(CHUNK_BYTES)
            .map(|chunk| Ok(v1::ExportPosesResponse { chunk: chunk.to_vec() }))
            .collect();
        Ok(Response::new(stream::iter(chunks).boxed()))
    }

    type ExportMapStream = BoxStream<'static, Result<v1::ExportMapResponse, Status>>;

    async fn export_map(
        &self,
        request: Request<v1::ExportMapRequest>,
    ) -> Result<Response<Self::ExportMapStream>, Status> {
        let v1::ExportMapRequest { name } = within(request)?;
        let chunks = self.service.snapshots.export(&name).await?;
        let message = |chunk: Result<Vec<u8>, ServiceError>| Ok(v1::ExportMapResponse { chunk: chunk? });
        Ok(Response::new(chunks.map(message).boxed()))
    }

    async fn import_map(
        &self,
        request: Request<Streaming<v1::ImportMapRequest>>,
    ) -> Result<Response<v1::Job>, Status> {
        let (caller, mut requests) = with_caller(request)?;
        let first = self.next(&mut requests).await?.unwrap_or_default();
        let v1::ImportMapRequest { map_id, chunk } = first;
        let map = map_id.unwrap_or_default();
        let mut upload = self.service.snapshots.begin_import(&caller, &map).await?;
        self.service.snapshots.add_bytes(&mut upload, chunk).await?;
        while let Some(v1::ImportMapRequest { map_id: _, chunk }) = self.next(&mut requests).await? {
            self.service.snapshots.add_bytes(&mut upload, chunk).await?;
        }
        Ok(Response::new(job(self.service.snapshots.start_import(upload).await?)))
    }

    async fn trim_map(
        &self,
        request: Request<v1::TrimMapRequest>,
    ) -> Result<Response<v1::TrimMapResponse>, Status> {
        use v1::trim_map_request::Mode;
        let v1::TrimMapRequest { name, max_places, mode } = within(request)?;
        let trimming = match known::<Mode>("mode", mode)? {
            Mode::Unspecified | Mode::Preview => Trimming::Preview,
            Mode::Apply => Trimming::Apply,
        };
        let Trimmed { dropped, remaining_places, excess_places } =
            self.service.rewriting.trim(&name, max_places, trimming).await?;
        let dropped = dropped.into_iter().map(dropped_place).collect();
        Ok(Response::new(v1::TrimMapResponse { dropped, remaining_places, excess_places }))
    }

    async fn compact_map(
        &self,
        request: Request<v1::CompactMapRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        let (caller, v1::CompactMapRequest { name }) = with_caller(request)?;
        Ok(Response::new(job(self.service.rewriting.compact(&caller, &name).await?)))
    }

    async fn repair_map(&self, request: Request<v1::RepairMapRequest>) -> Result<Response<v1::Job>, Status> {
        let (caller, v1::RepairMapRequest { name, map_id, copy }) = with_caller(request)?;
        Ok(Response::new(job(self.service.rebuilding.start_repair(&caller, &name, &map_id, &copy).await?)))
    }

    async fn rebuild_map(
        &self,
        request: Request<v1::RebuildMapRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        let (caller, v1::RebuildMapRequest { name, model, map_id }) = with_caller(request)?;
        Ok(Response::new(job(self.service.rebuilding.start(&caller, &name, &model, &map_id).await?)))
    }
}
