use fabmap::detector::DetectorModel;
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::RecognizerSettings;
use futures::stream::{self, BoxStream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use topomap::budget::{self, Dispensable};
use topomap::mapper::MapperSettings;
use topomap::odometry_prior::PlaceSpacing;
use topomap::verification::VerificationMethod;
use waypost_proto::v1;
use waypost_proto::v1::export_poses_request::{Body, Format, Frame};
use waypost_proto::v1::map_service_server::MapService;
use waypost_proto::v1::map_settings;

use super::Adapter;
use super::convert::{known, planar_pose};
use super::jobs::job;
use crate::error::ServiceError;
use crate::service::maps::{
    Detail, FrameReference, Keep, LoopClosureView, MapSettings, MapSettingsRequest, MapView,
    NavigationStrategy, PlacePose, PlaceView, WordPlace,
};
use crate::service::merges::{Trimmed, Trimming};
use crate::service::models::Page;
use crate::service::names::{map_in, map_name, model_name, place_in, place_name};
use crate::service::trajectories::{TrajectoryBody, TrajectoryFormat, TrajectoryFrame};
use crate::storage::{MapBytes, MapCounts};

/// Largest piece that a text is handed out in.
const CHUNK_BYTES: usize = 1 << 20;

#[tonic::async_trait]
impl MapService for Adapter {
    async fn create_map(&self, request: Request<v1::CreateMapRequest>) -> Result<Response<v1::Map>, Status> {
        let v1::CreateMapRequest { map_id, model, settings } = request.into_inner();
        let settings = settings_request(settings.unwrap_or_default())?;
        Ok(Response::new(map(self.service.create_map(&map_id, &model, settings).await?)))
    }

    async fn list_maps(
        &self,
        request: Request<v1::ListMapsRequest>,
    ) -> Result<Response<v1::ListMapsResponse>, Status> {
        let v1::ListMapsRequest { page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_maps(page_size, &page_token).await?;
        let maps = items.into_iter().map(map).collect();
        Ok(Response::new(v1::ListMapsResponse { maps, next_page_token: next }))
    }

    async fn get_map(&self, request: Request<v1::GetMapRequest>) -> Result<Response<v1::Map>, Status> {
        let v1::GetMapRequest { name, view } = request.into_inner();
        let detail = match known("view", view)? {
            v1::MapView::Unspecified => Detail::Basic,
            v1::MapView::Full => Detail::Full,
        };
        Ok(Response::new(map(self.service.map(&name, detail).await?)))
    }

    async fn delete_map(
        &self,
        request: Request<v1::DeleteMapRequest>,
    ) -> Result<Response<v1::DeleteMapResponse>, Status> {
        let v1::DeleteMapRequest { name } = request.into_inner();
        self.service.delete_map(&name).await?;
        Ok(Response::new(v1::DeleteMapResponse {}))
    }

    async fn list_places(
        &self,
        request: Request<v1::ListPlacesRequest>,
    ) -> Result<Response<v1::ListPlacesResponse>, Status> {
        let v1::ListPlacesRequest { map, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_places(&map, page_size, &page_token).await?;
        let map = map_in(&map)?;
        let places = items.into_iter().map(|view| place(map, view)).collect();
        Ok(Response::new(v1::ListPlacesResponse { places, next_page_token: next }))
    }

    async fn list_matches(
        &self,
        request: Request<v1::ListMatchesRequest>,
    ) -> Result<Response<v1::ListMatchesResponse>, Status> {
        let v1::ListMatchesRequest { map, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_matches(&map, page_size, &page_token).await?;
        let matches = items.into_iter().map(loop_closure).collect();
        Ok(Response::new(v1::ListMatchesResponse { matches, next_page_token: next }))
    }

    async fn get_place(&self, request: Request<v1::GetPlaceRequest>) -> Result<Response<v1::Place>, Status> {
        let v1::GetPlaceRequest { name } = request.into_inner();
        let view = self.service.place(&name).await?;
        let hits = view.word_hits.iter().map(|&(word, hits)| v1::PlaceWord { word, hits: hits.into() });
        let word_hits = hits.collect();
        let (map, _) = place_in(&name)?;
        Ok(Response::new(v1::Place { word_hits, ..place(map, view) }))
    }

    async fn list_word_places(
        &self,
        request: Request<v1::ListWordPlacesRequest>,
    ) -> Result<Response<v1::ListWordPlacesResponse>, Status> {
        let v1::ListWordPlacesRequest { map, word, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_word_places(&map, word, page_size, &page_token).await?;
        let places = items.into_iter().map(|WordPlace { place, hits, looks }| v1::WordPlace {
            place,
            hits: hits.into(),
            looks: looks.into(),
        });
        Ok(Response::new(v1::ListWordPlacesResponse { places: places.collect(), next_page_token: next }))
    }

    async fn rebind_map(&self, request: Request<v1::RebindMapRequest>) -> Result<Response<v1::Map>, Status> {
        let v1::RebindMapRequest { name, model } = request.into_inner();
        Ok(Response::new(map(self.service.rebind_map(&name, &model).await?)))
    }

    type ExportPosesStream = BoxStream<'static, Result<v1::ExportPosesResponse, Status>>;

    async fn export_poses(
        &self,
        request: Request<v1::ExportPosesRequest>,
    ) -> Result<Response<Self::ExportPosesStream>, Status> {
        let v1::ExportPosesRequest { name, format, frame, body } = request.into_inner();
        let frame = match known("frame", frame)? {
            Frame::Unspecified | Frame::Map => TrajectoryFrame::Map,
            Frame::Odom => TrajectoryFrame::Odom,
        };
        let body = match known("body", body)? {
            Body::Unspecified | Body::Base => TrajectoryBody::Base,
            Body::Camera => TrajectoryBody::Camera,
        };
        let text = match known("format", format)? {
            Format::Unspecified => {
                return Err(ServiceError::invalid(
                    "name a format: TUM or KITTI for a session, G2O for a map",
                )
                .into());
            }
            Format::Tum => self.service.trajectory(&name, TrajectoryFormat::Tum, frame, body).await?,
            Format::Kitti => self.service.trajectory(&name, TrajectoryFormat::Kitti, frame, body).await?,
            Format::G2o => self.service.pose_graph(&name).await?,
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
        let v1::ExportMapRequest { name } = request.into_inner();
        let chunks = self.service.export_map(&name).await?;
        let message = |chunk: Result<Vec<u8>, ServiceError>| Ok(v1::ExportMapResponse { chunk: chunk? });
        Ok(Response::new(chunks.map(message).boxed()))
    }

    async fn import_map(
        &self,
        request: Request<Streaming<v1::ImportMapRequest>>,
    ) -> Result<Response<v1::Job>, Status> {
        let mut requests = request.into_inner();
        let first = self.next(&mut requests).await?.unwrap_or_default();
        let v1::ImportMapRequest { map_id, chunk } = first;
        let mut upload = self.service.begin_map_import(&map_id).await?;
        self.service.add_snapshot_bytes(&mut upload, chunk).await?;
        while let Some(v1::ImportMapRequest { map_id: _, chunk }) = self.next(&mut requests).await? {
            self.service.add_snapshot_bytes(&mut upload, chunk).await?;
        }
        Ok(Response::new(job(self.service.start_map_import(upload).await?)))
    }

    async fn trim_map(
        &self,
        request: Request<v1::TrimMapRequest>,
    ) -> Result<Response<v1::TrimMapResponse>, Status> {
        use v1::trim_map_request::Mode;
        let v1::TrimMapRequest { name, max_places, mode } = request.into_inner();
        let trimming = match known::<Mode>("mode", mode)? {
            Mode::Unspecified | Mode::Preview => Trimming::Preview,
            Mode::Apply => Trimming::Apply,
        };
        let Trimmed { dropped, places_left, over } =
            self.service.trim_map(&name, max_places, trimming).await?;
        let dropped = dropped.into_iter().map(dropped_place).collect();
        Ok(Response::new(v1::TrimMapResponse { dropped, places_left, over }))
    }

    async fn compact_map(
        &self,
        request: Request<v1::CompactMapRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        let v1::CompactMapRequest { name } = request.into_inner();
        Ok(Response::new(job(self.service.compact_map(&name).await?)))
    }

    async fn rebuild_map(
        &self,
        request: Request<v1::RebuildMapRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        let v1::RebuildMapRequest { name, model, map_id } = request.into_inner();
        Ok(Response::new(job(self.service.rebuild_map(&name, &model, &map_id).await?)))
    }

    async fn remove_session(
        &self,
        request: Request<v1::RemoveSessionRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        let v1::RemoveSessionRequest { name } = request.into_inner();
        Ok(Response::new(job(self.service.remove_session(&name).await?)))
    }
}

fn dropped_place(dropped: Dispensable) -> v1::DroppedPlace {
    use v1::dropped_place::Why;
    let Dispensable { place, why } = dropped;
    let why = match why {
        budget::Why::Redundant { of, alike } => Why::Redundant(v1::RedundantPlace { of_place: of, alike }),
        budget::Why::LeastSeen { looks, apart } => {
            Why::LeastSeen(v1::LeastSeenPlace { looks: looks.into(), apart })
        }
    };
    v1::DroppedPlace { place, why: Some(why) }
}

fn settings_request(settings: v1::MapSettings) -> Result<MapSettingsRequest, ServiceError> {
    let v1::MapSettings {
        dependence,
        new_place,
        closure_threshold,
        guard_frames,
        new_place_prior,
        true_positive_rate,
        false_positive_rate,
        keep,
        verification,
        place_spacing_m,
        place_spacing_rad,
        navigation_strategy,
    } = settings;
    Ok(MapSettingsRequest {
        dependence: match known("dependence", dependence)? {
            map_settings::Dependence::Unspecified => None,
            map_settings::Dependence::ChowLiu => Some(Dependence::ChowLiu),
            map_settings::Dependence::NaiveBayes => Some(Dependence::NaiveBayes),
        },
        new_place: match known("new_place", new_place)? {
            map_settings::NewPlace::Unspecified => None,
            map_settings::NewPlace::MeanField => Some(NewPlaceMethod::MeanField),
            map_settings::NewPlace::Sampled => Some(NewPlaceMethod::Sampled),
            map_settings::NewPlace::Tail => Some(NewPlaceMethod::Tail),
            map_settings::NewPlace::TemperedTail => Some(NewPlaceMethod::TemperedTail),
        },
        closure_threshold,
        guard_frames,
        new_place_prior,
        true_positive_rate,
        false_positive_rate,
        keep: match known("keep", keep)? {
            map_settings::Keep::Unspecified => None,
            map_settings::Keep::Words => Some(Keep::Words),
            map_settings::Keep::Features => Some(Keep::Features),
            map_settings::Keep::Images => Some(Keep::Images),
        },
        verification: match known("verification", verification)? {
            map_settings::Verification::Unspecified => None,
            map_settings::Verification::None => Some(VerificationMethod::None),
            map_settings::Verification::Similarity => Some(VerificationMethod::Similarity),
            map_settings::Verification::Epipolar => Some(VerificationMethod::Epipolar),
        },
        place_spacing_m,
        place_spacing_rad,
        strategy: match known("navigation_strategy", navigation_strategy)? {
            map_settings::NavigationStrategy::Unspecified => None,
            map_settings::NavigationStrategy::TopoMetric => Some(NavigationStrategy::TopoMetric),
            map_settings::NavigationStrategy::Appearance => Some(NavigationStrategy::Appearance),
        },
    })
}

fn map(view: MapView) -> v1::Map {
    let MapView { map, model, settings, created_ns, counts, state_hash, bytes } = view;
    let MapCounts { sessions, frames, loop_closures, places, links } = counts;
    v1::Map {
        name: map_name(&map),
        model: model_name(&model),
        settings: Some(settings_message(&settings)),
        create_time_ns: created_ns,
        places,
        links,
        sessions,
        frames,
        loop_closures,
        state_hash: state_hash.unwrap_or_default(),
        storage: bytes.map(|bytes| storage(bytes, frames)),
    }
}

fn storage(bytes: MapBytes, frames: u64) -> v1::MapStorage {
    let per_frame = bytes.per_frame(frames);
    let MapBytes { log, checkpoint, features, thumbnails, images } = bytes;
    v1::MapStorage {
        log_bytes: log,
        checkpoint_bytes: checkpoint,
        features_bytes: features,
        thumbnail_bytes: thumbnails,
        image_bytes: images,
        bytes_per_frame: per_frame,
    }
}

fn settings_message(settings: &MapSettings) -> v1::MapSettings {
    let MapSettings { mapper, keep, strategy } = *settings;
    let MapperSettings {
        recognizer,
        closure_threshold,
        verification,
        guard_frames,
        looks_per_stay: _,
        min_words: _,
        max_speed_m_per_s: _,
        place_spacing: PlaceSpacing { distance_m, angle_rad },
        place_rule: _,
        odometry_noise: _,
        prior_frames: _,
    } = mapper;
    let RecognizerSettings { dependence, new_place, scorer: _, detector, filter } = recognizer;
    let FilterSettings { new_place_prior, even_share: _, likelihood_smoothing: _ } = filter;
    let rate = |exists| move |detector: DetectorModel| detector.probability(true, exists);
    v1::MapSettings {
        dependence: match dependence {
            Dependence::ChowLiu => map_settings::Dependence::ChowLiu,
            Dependence::NaiveBayes => map_settings::Dependence::NaiveBayes,
        }
        .into(),
        new_place: match new_place {
            NewPlaceMethod::MeanField => map_settings::NewPlace::MeanField,
            NewPlaceMethod::Sampled => map_settings::NewPlace::Sampled,
            NewPlaceMethod::Tail => map_settings::NewPlace::Tail,
            NewPlaceMethod::TemperedTail => map_settings::NewPlace::TemperedTail,
        }
        .into(),
        closure_threshold: Some(closure_threshold),
        guard_frames: Some(u32::try_from(guard_frames).unwrap_or(u32::MAX)),
        new_place_prior: Some(new_place_prior),
        true_positive_rate: detector.map(rate(true)),
        false_positive_rate: detector.map(rate(false)),
        keep: match keep {
            Keep::Words => map_settings::Keep::Words,
            Keep::Features => map_settings::Keep::Features,
            Keep::Images => map_settings::Keep::Images,
        }
        .into(),
        verification: match verification.method {
            VerificationMethod::None => map_settings::Verification::None,
            VerificationMethod::Similarity => map_settings::Verification::Similarity,
            VerificationMethod::Epipolar => map_settings::Verification::Epipolar,
        }
        .into(),
        place_spacing_m: Some(distance_m),
        place_spacing_rad: Some(angle_rad),
        navigation_strategy: match strategy {
            NavigationStrategy::TopoMetric => map_settings::NavigationStrategy::TopoMetric,
            NavigationStrategy::Appearance => map_settings::NavigationStrategy::Appearance,
        }
        .into(),
    }
}

fn place(map: &str, view: PlaceView) -> v1::Place {
    let PlaceView { place, looks, word_hits, frames, linked, pose } = view;
    v1::Place {
        name: place_name(map, place),
        looks: u32::from(looks),
        words: u32::try_from(word_hits.len()).unwrap_or(u32::MAX),
        frames: frames.into_iter().map(frame_reference).collect(),
        linked,
        word_hits: Vec::new(),
        pose: pose.map(|PlacePose { part, pose }| v1::PlacePose { part, pose: Some(planar_pose(&pose)) }),
    }
}

fn loop_closure(view: LoopClosureView) -> v1::LoopClosure {
    let LoopClosureView { frame, matched, place, posterior, probability } = view;
    v1::LoopClosure {
        frame: Some(frame_reference(frame)),
        matched_frame: Some(frame_reference(matched)),
        place,
        posterior,
        probability,
    }
}

pub(super) fn frame_reference(reference: FrameReference) -> v1::FrameReference {
    let FrameReference { session, sequence, stamp_ns } = reference;
    v1::FrameReference { session, sequence, stamp_ns }
}
