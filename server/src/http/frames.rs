use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use fabmap::observation::Observation;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use topomap::{event, verification};
use utoipa::openapi::schema::{KnownFormat, SchemaFormat, Type};
use utoipa::openapi::{ObjectBuilder, RefOr, Schema};
use utoipa::{IntoParams, PartialSchema, ToSchema};

use super::HttpError;
use super::description::Refusals;
use super::geometry::Odometry;
use super::maps::FrameReference;
use super::parameters::{FramePath, InPath, InQuery, Nothing, Parameters};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::frames::{FrameBytes, FrameImage, FrameView, ImageSize};
use crate::service::sessions::{self, GeometryView, MatchView};

impl FramePath {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`.
    pub(super) fn name(&self) -> String {
        let Self { map, session, sequence } = self;
        format!("maps/{map}/sessions/{session}/frames/{sequence}")
    }
}

/// A frame: what was decided about it, where the wheels put the robot, and its words.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}", tag = "sessions",
    params(FramePath),
    responses((status = 200, description = "The frame.", body = FrameRecord), Refusals))]
pub(super) async fn get_frame(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<FrameRecord>, HttpError> {
    Ok(Json(service.frame(&path.name()).await?.into()))
}

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ImageChoice {
    /// Left out, the image comes if it is kept, else the thumbnail.
    #[param(inline)]
    size: Option<Size>,
}

#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Size {
    Original,
    Thumbnail,
}

impl Parameters for ImageChoice {
    const TAKES: &str = "size=original or size=thumbnail";
}

/// What a frame looked like, as far as the map keeps it.
///
/// With `If-None-Match` and the `ETag` of an earlier answer, an image that is still the same is not sent again.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}/image", tag = "sessions",
    operation_id = "get_frame_image", params(FramePath, ImageChoice,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the image that is there already.")),
    responses(
        (status = 200, description = "The image.", headers(("ETag" = String, description = "Hash of the image.")),
            content((ImageFile = "image/jpeg"), (ImageFile = "image/png"))),
        (status = 304, description = "The image is still the one that the caller has."),
        Refusals))]
pub(super) async fn get_frame_image(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(ImageChoice { size }): InQuery<ImageChoice>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let size = match size {
        None => ImageSize::Best,
        Some(Size::Original) => ImageSize::Original,
        Some(Size::Thumbnail) => ImageSize::Thumbnail,
    };
    let FrameImage { content_type, image } = service.frame_image(&path.name(), size).await?;
    unless_known(&headers, content_type, image).await
}

/// The image, unless the caller says that it is there already.
pub(super) async fn unless_known(
    headers: &HeaderMap,
    content_type: &'static str,
    image: Vec<u8>,
) -> Result<Response, HttpError> {
    let hashed = tokio::task::spawn_blocking(move || (entity_tag(&image), image)).await;
    let (tag, image) = hashed.map_err(ServiceError::internal)?;
    let is_there = headers.get_all(IF_NONE_MATCH).iter().any(|known| names(known.as_bytes(), &tag));
    // A map that is deleted and made again can have another image under this name: ask, and be told that
    // it is the same.
    let caching = [(CACHE_CONTROL, "private, no-cache".to_owned()), (ETAG, tag)];
    if is_there {
        return Ok((StatusCode::NOT_MODIFIED, caching).into_response());
    }
    Ok((caching, [(CONTENT_TYPE, content_type)], image).into_response())
}

/// The bytes of an image, for the description alone.
pub(super) enum ImageFile {}

impl PartialSchema for ImageFile {
    fn schema() -> RefOr<Schema> {
        let binary = SchemaFormat::KnownFormat(KnownFormat::Binary);
        ObjectBuilder::new().schema_type(Type::String).format(Some(binary)).into()
    }
}

impl ToSchema for ImageFile {}

fn entity_tag(image: &[u8]) -> String {
    use std::fmt::Write;
    let mut tag = String::from("\"");
    for byte in Sha256::digest(image) {
        // Writing to a string cannot fail.
        let _ = write!(tag, "{byte:02x}");
    }
    tag + "\""
}

/// Whether a list of entity tags, as `If-None-Match` has it, names `tag` or all. No tag of ours has a comma.
fn names(list: &[u8], tag: &str) -> bool {
    let mut known = list.split(|&byte| byte == b',').map(<[u8]>::trim_ascii);
    known.any(|known| known == b"*" || known.strip_prefix(b"W/").unwrap_or(known) == tag.as_bytes())
}

/// A frame as the log keeps it.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FrameRecord {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`
    #[schema(example = "maps/demo/sessions/monday/frames/7")]
    name: String,
    /// When the image was taken, by the robot's clock.
    stamp_ns: i64,
    answer: FrameAnswer,
    /// Where the wheels put the robot.
    #[schema(required)]
    odometry: Option<Odometry>,
    /// Whether the place learnt its look from this frame.
    learnt: bool,
    storage: FrameStorage,
    /// Its words. Not in lists.
    #[schema(required)]
    histogram: Option<WordHistogram>,
}

/// What was decided about a frame, as the robot was told.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FrameAnswer {
    pub(super) sequence: u64,
    pub(super) reason: Reason,
    /// The place the frame belongs to, as a number; null if too little was seen to say.
    #[schema(required)]
    pub(super) place: Option<u32>,
    /// Posterior probability of what was decided: of the place, or of a new one.
    pub(super) posterior: f64,
    /// Probability of being somewhere new.
    pub(super) new_place_posterior: f64,
    /// The most probable places, most probable first.
    #[schema(max_items = 10)]
    pub(super) places: Vec<PlaceProbability>,
    /// For `loop_closure`, `below_threshold` and `geometry_refused`: place and frame that matched.
    #[schema(required)]
    pub(super) closure: Option<Match>,
    /// Whatever was decided: of the most probable place known from before the guard, the frame that matches
    /// best; with geometry, of the place that it has most evidence for.
    #[schema(required)]
    pub(super) proposal: Option<Match>,
    /// Different words seen.
    pub(super) words: u64,
}

/// Why a frame was decided as it was: somewhere new was the most probable (`new_place`); the place that the
/// session is at, or has just left (`same_place`); another place, at or above the map's threshold
/// (`loop_closure`) or below it, so that a place was created (`below_threshold`); too few words to say
/// anything (`too_few_words`); a known place above the threshold that geometry refused, so that a place was
/// created (`geometry_refused`).
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Reason {
    NewPlace,
    SamePlace,
    LoopClosure,
    BelowThreshold,
    TooFewWords,
    GeometryRefused,
}

#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(super) struct PlaceProbability {
    pub(super) place: u32,
    pub(super) posterior: f64,
}

/// An earlier frame of a place.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Match {
    place: u32,
    posterior: f64,
    frame: FrameReference,
    /// ln [posterior / (1 - posterior)], nats: tells apart what rounds to 1.
    log_odds: f64,
    /// What geometry found between the two frames; null where it was not asked.
    #[schema(required)]
    geometry: Option<Geometry>,
}

/// Two views compared by where their features are.
#[derive(Debug, Serialize, ToSchema)]
struct Geometry {
    /// Features that look alike.
    matches: u32,
    /// Those that one motion explains.
    inliers: u32,
    /// What this and the session's last frames say for the place, in inliers.
    evidence: f64,
    /// That both frames show the same place, by words and geometry together.
    probability: f64,
    /// The motion, if it was looked for in the image plane and one was found.
    #[schema(required)]
    similarity: Option<Similarity>,
}

/// x_current = s R x_earlier + t about the centres of the images.
#[derive(Debug, Serialize, ToSchema)]
struct Similarity {
    /// Angle of R, from x to the right towards y down.
    rotation_rad: f64,
    /// ln s: above 0 if the current view is nearer.
    ln_scale: f64,
    /// t to the right, in widths of the image.
    x_widths: f64,
    /// t down, in widths of the image.
    y_widths: f64,
}

/// What is kept of a frame, in bytes; 0 where nothing is.
#[derive(Debug, Serialize, ToSchema)]
struct FrameStorage {
    /// Words and decision: always kept.
    log_bytes: u64,
    features_bytes: u64,
    thumbnail_bytes: u64,
    image_bytes: u64,
}

/// How often words were seen in an image; position i of each list is about the same word.
#[derive(Debug, Serialize, ToSchema)]
struct WordHistogram {
    words: Vec<u32>,
    counts: Vec<u32>,
}

impl FrameRecord {
    /// As it is in a list.
    pub(super) fn listed(view: FrameView) -> Self {
        Self { histogram: None, ..view.into() }
    }
}

impl From<FrameView> for FrameRecord {
    fn from(view: FrameView) -> Self {
        let FrameView { name, stamp_ns, answer, odometry, learnt, observation, bytes } = view;
        let FrameBytes { log, features, thumbnail, image } = bytes;
        Self {
            name,
            stamp_ns,
            answer: answer.into(),
            odometry: odometry.map(Odometry::from),
            learnt,
            storage: FrameStorage {
                log_bytes: log,
                features_bytes: features,
                thumbnail_bytes: thumbnail,
                image_bytes: image,
            },
            histogram: Some(WordHistogram::from(&observation)),
        }
    }
}

impl From<&Observation> for WordHistogram {
    fn from(observation: &Observation) -> Self {
        let (words, counts) = observation.word_counts().unzip();
        Self { words, counts }
    }
}

impl From<sessions::FrameAnswer> for FrameAnswer {
    fn from(answer: sessions::FrameAnswer) -> Self {
        let sessions::FrameAnswer {
            sequence,
            reason,
            place,
            posterior,
            new_place_posterior,
            places,
            closure,
            proposal,
            words,
            // These are of the stream that the answer went to.
            last_committed: _,
            timings: _,
            map_pose: _,
        } = answer;
        Self {
            sequence,
            reason: reason.into(),
            place,
            posterior,
            new_place_posterior,
            places: places.into_iter().map(PlaceProbability::from).collect(),
            closure: closure.map(Match::from),
            proposal: proposal.map(Match::from),
            words,
        }
    }
}

impl From<event::Reason> for Reason {
    fn from(reason: event::Reason) -> Self {
        match reason {
            event::Reason::NewPlace => Self::NewPlace,
            event::Reason::SamePlace => Self::SamePlace,
            event::Reason::LoopClosure => Self::LoopClosure,
            event::Reason::BelowThreshold => Self::BelowThreshold,
            event::Reason::TooFewWords => Self::TooFewWords,
            event::Reason::GeometryRefused => Self::GeometryRefused,
        }
    }
}

impl From<(u32, f64)> for PlaceProbability {
    fn from((place, posterior): (u32, f64)) -> Self {
        Self { place, posterior }
    }
}

impl From<MatchView> for Match {
    fn from(view: MatchView) -> Self {
        let MatchView { place, posterior, log_odds, frame, geometry } = view;
        Self { place, posterior, frame: frame.into(), log_odds, geometry: geometry.map(Geometry::from) }
    }
}

impl From<GeometryView> for Geometry {
    fn from(view: GeometryView) -> Self {
        let GeometryView { matches, inliers, evidence, probability, similarity } = view;
        let similarity = similarity.map(|similarity| {
            let verification::Similarity { rotation_rad, ln_scale, translation_widths } = similarity;
            let [x_widths, y_widths] = translation_widths;
            Similarity { rotation_rad, ln_scale, x_widths, y_widths }
        });
        Self { matches, inliers, evidence, probability, similarity }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entity_tags_are_found_in_lists() {
        let tag = entity_tag(b"an image");
        assert_eq!(tag.len(), 66);
        for list in [tag.clone(), format!("W/{tag}"), format!("\"a\" , {tag}"), "*".to_owned()] {
            assert!(names(list.as_bytes(), &tag), "{list}");
        }
        for list in ["", "\"a\"", tag.trim_matches('"'), entity_tag(b"another").as_str()] {
            assert!(!names(list.as_bytes(), &tag), "{list}");
        }
    }
}
