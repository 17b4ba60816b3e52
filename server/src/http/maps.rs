use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use fabmap::detector::DetectorModel;
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::RecognizerSettings;
use serde::{Deserialize, Serialize};
use topomap::mapper::MapperSettings;
use topomap::odometry_prior::PlaceSpacing;
use topomap::verification::VerificationMethod;
use utoipa::{IntoParams, ToSchema};

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Paging, Parameters};
use crate::service::Service;
use crate::service::maps::{self, Detail, LoopClosureView, MapView};
use crate::service::models::Page;
use crate::service::names::{map_name, model_name};
use crate::storage::{MapBytes, MapCounts};

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Viewing {
    /// `full` adds the state hash and what the map takes on the disk, which takes time.
    #[param(inline)]
    view: View,
}

#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum View {
    #[default]
    Basic,
    Full,
}

impl Parameters for Viewing {
    const TAKES: &str = "view=basic or view=full";
}

/// All maps, by name.
#[utoipa::path(get, path = "/v1/maps", tag = "maps", params(Paging),
    responses((status = 200, description = "A page of maps.", body = MapList), Refusals))]
pub(super) async fn list_maps(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<MapList>, HttpError> {
    let Page { items, next } = service.list_maps(page_size, &page_token).await?;
    Ok(Json(MapList { maps: items.into_iter().map(Map::from).collect(), next_page_token: next }))
}

/// A map with all its settings.
#[utoipa::path(get, path = "/v1/maps/{map}", tag = "maps", params(MapPath, Viewing),
    responses((status = 200, description = "The map.", body = Map), Refusals))]
pub(super) async fn get_map(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Viewing { view }): InQuery<Viewing>,
) -> Result<Json<Map>, HttpError> {
    let detail = match view {
        View::Basic => Detail::Basic,
        View::Full => Detail::Full,
    };
    Ok(Json(service.map(&map_name(&map), detail).await?.into()))
}

/// The loop closures of a map, oldest first.
#[utoipa::path(get, path = "/v1/maps/{map}/matches", tag = "maps", params(MapPath, Paging),
    responses((status = 200, description = "A page of loop closures.", body = MatchList), Refusals))]
pub(super) async fn list_matches(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<MatchList>, HttpError> {
    let Page { items, next } = service.list_matches(&map_name(&map), page_size, &page_token).await?;
    Ok(Json(MatchList { matches: items.into_iter().map(LoopClosure::from).collect(), next_page_token: next }))
}

/// A page of maps.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct MapList {
    maps: Vec<Map>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// A map: places joined by links, grown by the sessions of robots.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Map {
    /// `maps/{map}`
    #[schema(example = "maps/demo")]
    name: String,
    /// `models/{hash}`
    #[schema(pattern = "^models/[0-9a-f]{64}$")]
    model: String,
    settings: MapSettings,
    /// When it was made, in nanoseconds since 1970.
    create_time_ns: i64,
    places: u64,
    links: u64,
    sessions: u64,
    frames: u64,
    loop_closures: u64,
    /// SHA-256 over all that the map's log decided. Only with `view=full`.
    #[schema(required, pattern = "^[0-9a-f]{64}$")]
    state_hash: Option<String>,
    /// What it takes on the disk. Only with `view=full`.
    #[schema(required)]
    storage: Option<MapStorage>,
}

/// What a map takes on the disk, in bytes.
#[derive(Debug, Serialize, ToSchema)]
struct MapStorage {
    /// Words, odometry and decisions: what the map is made from.
    log_bytes: u64,
    /// The fold of the log, so that the map opens fast.
    checkpoint_bytes: u64,
    features_bytes: u64,
    thumbnail_bytes: u64,
    image_bytes: u64,
    /// All of these, divided by the number of frames.
    bytes_per_frame: f64,
}

/// How a map decides.
#[derive(Debug, Serialize, ToSchema)]
struct MapSettings {
    dependence: WordDependence,
    new_place: NewPlaceTerm,
    /// Posterior from which a loop closure is accepted.
    #[schema(exclusive_minimum = 0, maximum = 1)]
    closure_threshold: f64,
    /// A place that the session left fewer frames ago is not a loop closure.
    guard_frames: u64,
    /// Prior probability of being somewhere new.
    #[schema(minimum = 0, maximum = 1)]
    new_place_prior: f64,
    /// p(z = 1 | e = 1), if it is not the model's.
    #[schema(required, minimum = 0, maximum = 1)]
    true_positive_rate: Option<f64>,
    /// p(z = 1 | e = 0), if it is not the model's.
    #[schema(required, minimum = 0, maximum = 1)]
    false_positive_rate: Option<f64>,
    keep: Keep,
    verification: Verification,
    /// Where frames carry odometry: how far a robot goes before it is at another place.
    #[schema(exclusive_minimum = 0)]
    place_spacing_m: f64,
    /// The same for how far it turns.
    #[schema(exclusive_minimum = 0)]
    place_spacing_rad: f64,
    navigation_strategy: NavigationStrategy,
}

/// How robots are led along the map: along places that wheels measured, by a camera that looks ahead; or by looks alone,
/// with panoramas.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum NavigationStrategy {
    TopoMetric,
    Appearance,
}

/// How loop closures are verified by where features are: not at all, by a motion in the image plane, by epipolar
/// geometry.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Verification {
    None,
    Similarity,
    Epipolar,
}

/// What is kept of each frame: words and decisions alone; also keypoints, descriptors and a thumbnail; also the
/// image as it came.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Keep {
    Words,
    Features,
    Images,
}

/// Whether each word depends on its parent in the Chow-Liu tree, or on none.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum WordDependence {
    ChowLiu,
    NaiveBayes,
}

/// How the likelihood of a new place is found: from the average place, by the mean over the model's sampling set,
/// or from its tail, with likelihood ratios as they are or tempered to it.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum NewPlaceTerm {
    MeanField,
    Sampled,
    Tail,
    TemperedTail,
}

/// A page of loop closures.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct MatchList {
    matches: Vec<LoopClosure>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// A loop closure: a frame that was found to be at a place seen before.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct LoopClosure {
    pub(super) frame: FrameReference,
    /// The frame of the place that matched best.
    pub(super) matched_frame: FrameReference,
    /// Number of the place.
    pub(super) place: u32,
    /// Posterior probability of the place, by words.
    #[schema(minimum = 0, maximum = 1)]
    pub(super) posterior: f64,
    /// That both frames show the same place, by words and geometry together; null where nothing was verified.
    #[schema(required, minimum = 0, maximum = 1)]
    pub(super) probability: Option<f64>,
}

/// A frame by its session and sequence number.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FrameReference {
    /// `maps/{map}/sessions/{session}`
    #[schema(example = "maps/demo/sessions/monday")]
    pub(super) session: String,
    pub(super) sequence: u64,
    /// When the image was taken, by the robot's clock.
    pub(super) stamp_ns: i64,
}

impl From<MapView> for Map {
    fn from(view: MapView) -> Self {
        let MapView { map, model, settings, created_ns, counts, state_hash, bytes } = view;
        let MapCounts { sessions, frames, loop_closures, places, links } = counts;
        Self {
            name: map_name(&map),
            model: model_name(&model),
            settings: settings.into(),
            create_time_ns: created_ns,
            places,
            links,
            sessions,
            frames,
            loop_closures,
            state_hash,
            storage: bytes.map(|bytes| MapStorage::new(bytes, frames)),
        }
    }
}

impl MapStorage {
    fn new(bytes: MapBytes, frames: u64) -> Self {
        let bytes_per_frame = bytes.per_frame(frames);
        let MapBytes { log, checkpoint, features, thumbnails, images } = bytes;
        Self {
            log_bytes: log,
            checkpoint_bytes: checkpoint,
            features_bytes: features,
            thumbnail_bytes: thumbnails,
            image_bytes: images,
            bytes_per_frame,
        }
    }
}

impl From<maps::MapSettings> for MapSettings {
    fn from(settings: maps::MapSettings) -> Self {
        let maps::MapSettings { mapper, keep, strategy } = settings;
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
        Self {
            dependence: match dependence {
                Dependence::ChowLiu => WordDependence::ChowLiu,
                Dependence::NaiveBayes => WordDependence::NaiveBayes,
            },
            new_place: match new_place {
                NewPlaceMethod::MeanField => NewPlaceTerm::MeanField,
                NewPlaceMethod::Sampled => NewPlaceTerm::Sampled,
                NewPlaceMethod::Tail => NewPlaceTerm::Tail,
                NewPlaceMethod::TemperedTail => NewPlaceTerm::TemperedTail,
            },
            closure_threshold,
            guard_frames,
            new_place_prior,
            true_positive_rate: detector.map(rate(true)),
            false_positive_rate: detector.map(rate(false)),
            keep: match keep {
                maps::Keep::Words => Keep::Words,
                maps::Keep::Features => Keep::Features,
                maps::Keep::Images => Keep::Images,
            },
            verification: match verification.method {
                VerificationMethod::None => Verification::None,
                VerificationMethod::Similarity => Verification::Similarity,
                VerificationMethod::Epipolar => Verification::Epipolar,
            },
            place_spacing_m: distance_m,
            place_spacing_rad: angle_rad,
            navigation_strategy: match strategy {
                maps::NavigationStrategy::TopoMetric => NavigationStrategy::TopoMetric,
                maps::NavigationStrategy::Appearance => NavigationStrategy::Appearance,
            },
        }
    }
}

impl From<LoopClosureView> for LoopClosure {
    fn from(view: LoopClosureView) -> Self {
        let LoopClosureView { frame, matched, place, posterior, probability } = view;
        Self { frame: frame.into(), matched_frame: matched.into(), place, posterior, probability }
    }
}

impl From<maps::FrameReference> for FrameReference {
    fn from(reference: maps::FrameReference) -> Self {
        let maps::FrameReference { session, sequence, stamp_ns } = reference;
        Self { session, sequence, stamp_ns }
    }
}
