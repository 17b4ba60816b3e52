use tonic::{Request, Response, Status};
use topomap::relaxation::PlanarPose;
use waypost_proto::v1;
use waypost_proto::v1::merge_maps_request;
use waypost_proto::v1::merge_service_server::MergeService;
use waypost_proto::v1::merge_source::Outcome;

use super::Adapter;
use super::convert::{known, planar_pose};
use crate::service::merges::{
    MapOverlap, MatchedPlaces, MergeReport, MergeRequest, MergeView, MergedSource, OnceFound, SourceOutcome,
};
use crate::service::models::Page;
use crate::service::names::map_name;
use crate::storage::MergeState;

#[tonic::async_trait]
impl MergeService for Adapter {
    async fn merge_maps(
        &self,
        request: Request<v1::MergeMapsRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let v1::MergeMapsRequest { sources, target, once_found, min_support } = request.into_inner();
        let once_found = match known::<merge_maps_request::OnceFound>("once_found", once_found)? {
            merge_maps_request::OnceFound::Unspecified | merge_maps_request::OnceFound::Propose => {
                OnceFound::Propose
            }
            merge_maps_request::OnceFound::Commit => OnceFound::Commit,
        };
        let request = MergeRequest { sources, target, once_found, min_support };
        Ok(Response::new(merge(self.service.merge_maps(request).await?)))
    }

    async fn get_merge(&self, request: Request<v1::GetMergeRequest>) -> Result<Response<v1::Merge>, Status> {
        let v1::GetMergeRequest { name } = request.into_inner();
        Ok(Response::new(merge(self.service.merge(&name).await?)))
    }

    async fn list_merges(
        &self,
        request: Request<v1::ListMergesRequest>,
    ) -> Result<Response<v1::ListMergesResponse>, Status> {
        let v1::ListMergesRequest { page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_merges(page_size, &page_token).await?;
        let merges = items.into_iter().map(merge).collect();
        Ok(Response::new(v1::ListMergesResponse { merges, next_page_token: next }))
    }

    async fn get_merge_picture(
        &self,
        request: Request<v1::GetMergePictureRequest>,
    ) -> Result<Response<v1::GetMergePictureResponse>, Status> {
        let v1::GetMergePictureRequest { name } = request.into_inner();
        let svg = self.service.merge_picture(&name).await?.into_bytes();
        Ok(Response::new(v1::GetMergePictureResponse { svg }))
    }

    async fn commit_merge(
        &self,
        request: Request<v1::CommitMergeRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let v1::CommitMergeRequest { name } = request.into_inner();
        Ok(Response::new(merge(self.service.commit_merge(&name).await?)))
    }

    async fn discard_merge(
        &self,
        request: Request<v1::DiscardMergeRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let v1::DiscardMergeRequest { name } = request.into_inner();
        Ok(Response::new(merge(self.service.discard_merge(&name).await?)))
    }

    async fn undo_merge(
        &self,
        request: Request<v1::UndoMergeRequest>,
    ) -> Result<Response<v1::Merge>, Status> {
        let v1::UndoMergeRequest { name } = request.into_inner();
        Ok(Response::new(merge(self.service.undo_merge(&name).await?)))
    }
}

fn merge(view: MergeView) -> v1::Merge {
    use v1::merge::State;
    let MergeView { number, target, job, state, report, error, created_ns } = view;
    // How a map was made is for its undoing.
    let MergeReport { sources, made_events: _ } = report;
    let state = match state {
        MergeState::Searching => State::Searching,
        MergeState::Proposed => State::Proposed,
        MergeState::Apart => State::Apart,
        MergeState::Committed => State::Committed,
        MergeState::Discarded => State::Discarded,
        MergeState::Undone => State::Undone,
        MergeState::Failed => State::Failed,
    };
    v1::Merge {
        name: format!("merges/{number}"),
        state: state.into(),
        target: map_name(&target),
        sources: sources.into_iter().map(source).collect(),
        job: format!("jobs/{job}"),
        error: error.unwrap_or_default(),
        create_time_ns: created_ns,
    }
}

fn source(source: MergedSource) -> v1::MergeSource {
    let MergedSource { map, events, places, outcome, sessions } = source;
    let outcome = match outcome {
        SourceOutcome::Open => None,
        SourceOutcome::Overlaps(found) => Some(Outcome::Overlap(overlap(*found))),
        SourceOutcome::Apart(why) => Some(Outcome::Apart(why)),
    };
    v1::MergeSource { map: map_name(&map), events, places, outcome, sessions }
}

fn overlap(overlap: MapOverlap) -> v1::MapOverlap {
    let MapOverlap {
        transformation,
        source_part,
        target_part,
        agreeing,
        rejected,
        rival_support,
        fused_places,
        overlapping_places,
        confirmed_places,
        cost_before,
        cost_after,
        strongest,
    } = overlap;
    let matched = |matched: MatchedPlaces| {
        let MatchedPlaces { source_place, target_place, source_frame, target_frame, posterior, evidence } =
            matched;
        let evidence_nats = evidence;
        v1::PlaceMatch { source_place, target_place, source_frame, target_frame, posterior, evidence_nats }
    };
    v1::MapOverlap {
        transformation: transformation
            .map(|[x_m, y_m, heading_rad]| planar_pose(&PlanarPose::new(x_m, y_m, heading_rad))),
        source_part,
        target_part,
        agreeing_matches: agreeing,
        rejected_matches: rejected,
        rival_matches: rival_support,
        fused_places,
        overlapping_places,
        confirmed_places,
        cost_before,
        cost_after,
        strongest_matches: strongest.into_iter().map(matched).collect(),
    }
}
