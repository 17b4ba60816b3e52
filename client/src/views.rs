//! What `--json` prints of the server's messages. Names are stable.

use serde::Serialize;
use waypost_client::{Code, v1};

#[derive(Serialize)]
pub(crate) struct ModelView {
    pub(crate) name: String,
    pub(crate) display_name: String,
    pub(crate) extractor: String,
    pub(crate) words: u32,
    pub(crate) samples: u32,
    pub(crate) words_hash: String,
    pub(crate) size_bytes: u64,
    pub(crate) create_time_ns: i64,
}

impl From<v1::Model> for ModelView {
    fn from(model: v1::Model) -> Self {
        let v1::Model {
            name,
            display_name,
            extractor,
            words,
            samples,
            words_hash,
            size_bytes,
            create_time_ns,
        } = model;
        Self { name, display_name, extractor, words, samples, words_hash, size_bytes, create_time_ns }
    }
}

#[derive(Serialize)]
pub(crate) struct JobView {
    pub(crate) name: String,
    pub(crate) kind: &'static str,
    pub(crate) state: &'static str,
    pub(crate) stage: String,
    pub(crate) fraction: f64,
    pub(crate) error: String,
    pub(crate) model: Option<ModelView>,
    /// What it made; null unless it succeeded.
    pub(crate) result: Option<String>,
    pub(crate) create_time_ns: i64,
    /// Null while it runs.
    pub(crate) end_time_ns: Option<i64>,
}

impl From<v1::Job> for JobView {
    fn from(job: v1::Job) -> Self {
        let state = match job.state() {
            v1::job::State::Unspecified => "unspecified",
            v1::job::State::Running => "running",
            v1::job::State::Succeeded => "succeeded",
            v1::job::State::Failed => "failed",
            v1::job::State::Cancelled => "cancelled",
        };
        let kind = match job.kind() {
            v1::job::Kind::Unspecified => "unspecified",
            v1::job::Kind::TrainModel => "train_model",
            v1::job::Kind::ImportMap => "import_map",
            v1::job::Kind::MergeMaps => "merge_maps",
            v1::job::Kind::RemoveSessions => "remove_sessions",
            v1::job::Kind::RebuildMap => "rebuild_map",
            v1::job::Kind::CompactMap => "compact_map",
        };
        let v1::Job {
            name,
            state: _,
            stage,
            fraction,
            error,
            model,
            kind: _,
            result,
            create_time_ns,
            end_time_ns,
        } = job;
        Self {
            name,
            kind,
            state,
            stage,
            fraction,
            error,
            model: model.map(ModelView::from),
            result: Some(result).filter(|result| !result.is_empty()),
            create_time_ns,
            end_time_ns: Some(end_time_ns).filter(|&end| end != 0),
        }
    }
}

#[derive(Serialize)]
pub(crate) struct MapSummary {
    pub(crate) name: String,
    pub(crate) model: String,
    pub(crate) settings: SettingsView,
    pub(crate) create_time_ns: i64,
    pub(crate) places: u64,
    pub(crate) links: u64,
    pub(crate) sessions: u64,
    pub(crate) frames: u64,
    pub(crate) loop_closures: u64,
    /// Null unless the full view was asked for.
    pub(crate) state_hash: Option<String>,
    /// Null unless the full view was asked for.
    pub(crate) storage: Option<StorageView>,
}

/// What a map takes on the server's disk.
#[derive(Serialize)]
pub(crate) struct StorageView {
    pub(crate) log_bytes: u64,
    pub(crate) checkpoint_bytes: u64,
    pub(crate) features_bytes: u64,
    pub(crate) thumbnail_bytes: u64,
    pub(crate) image_bytes: u64,
    pub(crate) bytes_per_frame: f64,
}

impl From<v1::MapStorage> for StorageView {
    fn from(storage: v1::MapStorage) -> Self {
        let v1::MapStorage {
            log_bytes,
            checkpoint_bytes,
            features_bytes,
            thumbnail_bytes,
            image_bytes,
            bytes_per_frame,
        } = storage;
        Self { log_bytes, checkpoint_bytes, features_bytes, thumbnail_bytes, image_bytes, bytes_per_frame }
    }
}

/// One run of one robot.
#[derive(Serialize)]
pub(crate) struct SessionView {
    pub(crate) name: String,
    pub(crate) create_time_ns: i64,
    pub(crate) frames: u64,
    pub(crate) loop_closures: u64,
    pub(crate) first_sequence: Option<u64>,
    pub(crate) last_sequence: Option<u64>,
    pub(crate) first_stamp_ns: Option<i64>,
    pub(crate) last_stamp_ns: Option<i64>,
}

impl From<v1::Session> for SessionView {
    fn from(session: v1::Session) -> Self {
        let v1::Session {
            name,
            create_time_ns,
            camera: _,
            frames,
            loop_closures,
            first_sequence,
            last_sequence,
            first_stamp_ns,
            last_stamp_ns,
        } = session;
        Self {
            name,
            create_time_ns,
            frames,
            loop_closures,
            first_sequence,
            last_sequence,
            first_stamp_ns,
            last_stamp_ns,
        }
    }
}

/// A frame that was matched.
#[derive(Serialize)]
pub(crate) struct MatchView {
    pub(crate) place: u32,
    pub(crate) posterior: f64,
    pub(crate) log_odds: f64,
    pub(crate) frame: Option<FrameView>,
    /// Null where geometry was not asked.
    pub(crate) geometry: Option<GeometryView>,
}

/// What geometry found between two frames.
#[derive(Serialize)]
pub(crate) struct GeometryView {
    pub(crate) matches: u32,
    pub(crate) inliers: u32,
    pub(crate) evidence: f64,
    pub(crate) probability: f64,
    pub(crate) similarity: Option<SimilarityView>,
}

#[derive(Serialize)]
pub(crate) struct SimilarityView {
    pub(crate) rotation_rad: f64,
    pub(crate) ln_scale: f64,
    pub(crate) x_widths: f64,
    pub(crate) y_widths: f64,
}

impl From<v1::Geometry> for GeometryView {
    fn from(geometry: v1::Geometry) -> Self {
        let v1::Geometry { matches, inliers, evidence, similarity, probability } = geometry;
        let similarity = similarity.map(|similarity| {
            let v1::Similarity { rotation_rad, ln_scale, x_widths, y_widths } = similarity;
            SimilarityView { rotation_rad, ln_scale, x_widths, y_widths }
        });
        Self { matches, inliers, evidence, probability, similarity }
    }
}

impl From<v1::Match> for MatchView {
    fn from(found: v1::Match) -> Self {
        let v1::Match { place, posterior, frame, log_odds, geometry } = found;
        let (frame, geometry) = (frame.map(FrameView::from), geometry.map(GeometryView::from));
        Self { place, posterior, log_odds, frame, geometry }
    }
}

impl From<v1::Map> for MapSummary {
    fn from(map: v1::Map) -> Self {
        let v1::Map {
            name,
            model,
            settings,
            create_time_ns,
            places,
            links,
            sessions,
            frames,
            loop_closures,
            state_hash,
            storage,
        } = map;
        Self {
            name,
            model,
            settings: settings.unwrap_or_default().into(),
            create_time_ns,
            places,
            links,
            sessions,
            frames,
            loop_closures,
            state_hash: Some(state_hash).filter(|hash| !hash.is_empty()),
            storage: storage.map(StorageView::from),
        }
    }
}

#[derive(Serialize)]
pub(crate) struct SettingsView {
    pub(crate) dependence: &'static str,
    pub(crate) new_place: &'static str,
    pub(crate) closure_threshold: Option<f64>,
    pub(crate) guard_frames: Option<u32>,
    pub(crate) new_place_prior: Option<f64>,
    pub(crate) true_positive_rate: Option<f64>,
    pub(crate) false_positive_rate: Option<f64>,
    pub(crate) keep: &'static str,
    pub(crate) verification: &'static str,
    pub(crate) place_spacing_m: Option<f64>,
    pub(crate) place_spacing_rad: Option<f64>,
    pub(crate) navigation_strategy: &'static str,
}

impl From<v1::MapSettings> for SettingsView {
    fn from(settings: v1::MapSettings) -> Self {
        let dependence = match settings.dependence() {
            v1::map_settings::Dependence::Unspecified => "unspecified",
            v1::map_settings::Dependence::ChowLiu => "chow-liu",
            v1::map_settings::Dependence::NaiveBayes => "naive-bayes",
        };
        let new_place = match settings.new_place() {
            v1::map_settings::NewPlace::Unspecified => "unspecified",
            v1::map_settings::NewPlace::MeanField => "mean-field",
            v1::map_settings::NewPlace::Sampled => "sampled",
            v1::map_settings::NewPlace::Tail => "tail",
            v1::map_settings::NewPlace::TemperedTail => "tempered-tail",
        };
        let keep = match settings.keep() {
            v1::map_settings::Keep::Unspecified => "unspecified",
            v1::map_settings::Keep::Words => "words",
            v1::map_settings::Keep::Features => "features",
            v1::map_settings::Keep::Images => "images",
        };
        let verification = match settings.verification() {
            v1::map_settings::Verification::Unspecified => "unspecified",
            v1::map_settings::Verification::None => "none",
            v1::map_settings::Verification::Similarity => "similarity",
            v1::map_settings::Verification::Epipolar => "epipolar",
        };
        let navigation_strategy = match settings.navigation_strategy() {
            v1::map_settings::NavigationStrategy::Unspecified => "unspecified",
            v1::map_settings::NavigationStrategy::TopoMetric => "topo-metric",
            v1::map_settings::NavigationStrategy::Appearance => "appearance",
        };
        let v1::MapSettings {
            dependence: _,
            new_place: _,
            closure_threshold,
            guard_frames,
            new_place_prior,
            true_positive_rate,
            false_positive_rate,
            keep: _,
            verification: _,
            place_spacing_m,
            place_spacing_rad,
            navigation_strategy: _,
        } = settings;
        Self {
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
        }
    }
}

#[derive(Serialize)]
pub(crate) struct FrameView {
    pub(crate) session: String,
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
}

impl From<v1::FrameReference> for FrameView {
    fn from(frame: v1::FrameReference) -> Self {
        let v1::FrameReference { session, sequence, stamp_ns } = frame;
        Self { session, sequence, stamp_ns }
    }
}

#[derive(Serialize)]
pub(crate) struct PlaceView {
    pub(crate) name: String,
    pub(crate) looks: u32,
    pub(crate) words: u32,
    pub(crate) frames: Vec<FrameView>,
    pub(crate) linked: Vec<u32>,
    /// Null where nothing measured the way to any other place.
    pub(crate) pose: Option<PlacePoseView>,
}

/// Where a place is, seen from above.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct PlacePoseView {
    /// The lowest place of its part of the map, in whose frame this is.
    pub(crate) part: u32,
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    pub(crate) heading_rad: f64,
}

impl PlacePoseView {
    fn of(place: v1::PlacePose) -> Option<Self> {
        let v1::PlacePose { part, pose } = place;
        let v1::Pose { position_m, orientation } = pose?;
        let (v1::Vector3 { x, y, z: _ }, v1::Quaternion { z, w, .. }) = (position_m?, orientation?);
        Some(Self { part, x_m: x, y_m: y, heading_rad: 2.0 * z.atan2(w) })
    }
}

impl From<v1::Place> for PlaceView {
    fn from(place: v1::Place) -> Self {
        let v1::Place { name, looks, words, frames, linked, word_hits: _, pose } = place;
        let frames = frames.into_iter().map(FrameView::from).collect();
        Self { name, looks, words, frames, linked, pose: pose.and_then(PlacePoseView::of) }
    }
}

#[derive(Serialize)]
pub(crate) struct ClosureView {
    pub(crate) frame: Option<FrameView>,
    pub(crate) matched_frame: Option<FrameView>,
    pub(crate) place: u32,
    pub(crate) posterior: f64,
    /// By words and geometry together; null where nothing was verified.
    pub(crate) probability: Option<f64>,
}

impl From<v1::LoopClosure> for ClosureView {
    fn from(closure: v1::LoopClosure) -> Self {
        let v1::LoopClosure { frame, matched_frame, place, posterior, probability } = closure;
        Self {
            frame: frame.map(FrameView::from),
            matched_frame: matched_frame.map(FrameView::from),
            place,
            posterior,
            probability,
        }
    }
}

/// One frame of a stream: a row of `--csv`, an entry of `frames` in `--json`.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct FrameRow {
    pub(crate) sequence: u64,
    pub(crate) image: String,
    pub(crate) stamp_ns: i64,
    /// Null for a frame that was refused, as everything up to `total_ms`.
    pub(crate) reason: Option<&'static str>,
    pub(crate) place: Option<u32>,
    pub(crate) posterior: Option<f64>,
    pub(crate) new_place_posterior: Option<f64>,
    pub(crate) words: Option<u32>,
    pub(crate) resent: Option<bool>,
    pub(crate) closure_place: Option<u32>,
    pub(crate) closure_posterior: Option<f64>,
    pub(crate) closure_log_odds: Option<f64>,
    pub(crate) closure_inliers: Option<u32>,
    /// That both show the same place, by words and geometry; null where there was none.
    pub(crate) closure_probability: Option<f64>,
    pub(crate) closure_session: Option<String>,
    pub(crate) closure_sequence: Option<u64>,
    pub(crate) proposal_place: Option<u32>,
    pub(crate) proposal_posterior: Option<f64>,
    pub(crate) proposal_log_odds: Option<f64>,
    pub(crate) proposal_session: Option<String>,
    pub(crate) proposal_sequence: Option<u64>,
    pub(crate) extract_ms: Option<f64>,
    pub(crate) quantize_ms: Option<f64>,
    pub(crate) likelihood_ms: Option<f64>,
    pub(crate) new_place_ms: Option<f64>,
    pub(crate) filter_ms: Option<f64>,
    pub(crate) verification_ms: Option<f64>,
    pub(crate) commit_ms: Option<f64>,
    pub(crate) total_ms: Option<f64>,
    pub(crate) refusal_code: Option<&'static str>,
    pub(crate) refusal_message: Option<String>,
}

impl FrameRow {
    pub(crate) fn answered(image: &str, stamp_ns: i64, answer: v1::FrameAnswer) -> Self {
        let reason = reason_name(answer.reason());
        let v1::FrameAnswer {
            sequence,
            last_committed_sequence: _,
            reason: _,
            place,
            posterior,
            new_place_posterior,
            places: _,
            closure,
            proposal,
            words,
            timings,
            resent,
            map_pose: _,
        } = answer;
        let closure_frame = closure.as_ref().and_then(|closure| closure.frame.as_ref());
        let proposal_frame = proposal.as_ref().and_then(|proposal| proposal.frame.as_ref());
        Self {
            sequence,
            image: image.to_owned(),
            stamp_ns,
            reason: Some(reason),
            place,
            posterior: Some(posterior),
            new_place_posterior: Some(new_place_posterior),
            words: Some(words),
            resent: Some(resent),
            closure_place: closure.as_ref().map(|closure| closure.place),
            closure_posterior: closure.as_ref().map(|closure| closure.posterior),
            closure_log_odds: closure.as_ref().map(|closure| closure.log_odds),
            closure_inliers: closure.as_ref().and_then(|closure| Some(closure.geometry.as_ref()?.inliers)),
            closure_probability: closure
                .as_ref()
                .and_then(|closure| Some(closure.geometry.as_ref()?.probability)),
            closure_session: closure_frame.map(|frame| frame.session.clone()),
            closure_sequence: closure_frame.map(|frame| frame.sequence),
            proposal_place: proposal.as_ref().map(|proposal| proposal.place),
            proposal_posterior: proposal.as_ref().map(|proposal| proposal.posterior),
            proposal_log_odds: proposal.as_ref().map(|proposal| proposal.log_odds),
            proposal_session: proposal_frame.map(|frame| frame.session.clone()),
            proposal_sequence: proposal_frame.map(|frame| frame.sequence),
            extract_ms: timings.map(|timings| timings.extract_ms),
            quantize_ms: timings.map(|timings| timings.quantize_ms),
            likelihood_ms: timings.map(|timings| timings.likelihood_ms),
            new_place_ms: timings.map(|timings| timings.new_place_ms),
            filter_ms: timings.map(|timings| timings.filter_ms),
            verification_ms: timings.map(|timings| timings.verification_ms),
            commit_ms: timings.map(|timings| timings.commit_ms),
            total_ms: timings.map(|timings| timings.total_ms),
            refusal_code: None,
            refusal_message: None,
        }
    }

    pub(crate) fn refused(image: &str, stamp_ns: i64, refusal: v1::FrameRefusal) -> Self {
        let v1::FrameRefusal { sequence, last_committed_sequence: _, status } = refusal;
        let status = status.unwrap_or_default();
        Self {
            sequence,
            image: image.to_owned(),
            stamp_ns,
            refusal_code: Some(code_name(Code::from(status.code))),
            refusal_message: Some(status.message),
            ..Self::default()
        }
    }
}

pub(crate) fn reason_name(reason: v1::Reason) -> &'static str {
    match reason {
        v1::Reason::Unspecified => "unspecified",
        v1::Reason::NewPlace => "new_place",
        v1::Reason::SamePlace => "same_place",
        v1::Reason::LoopClosure => "loop_closure",
        v1::Reason::BelowThreshold => "below_threshold",
        v1::Reason::TooFewWords => "too_few_words",
        v1::Reason::GeometryRefused => "geometry_refused",
    }
}

/// The canonical name of a status code.
fn code_name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}
