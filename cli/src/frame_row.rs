//! A frame as a row of a table.

use serde::Serialize;
use waypost_client::{status_code_name, v1};

/// One frame of a stream: a row of `--csv`, an entry of `frames` in `--json`.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct FrameRow {
    pub(crate) sequence: u64,
    pub(crate) image: String,
    pub(crate) stamp_ns: i64,
    /// Null for a frame that was refused, as everything up to `total_ms`.
    pub(crate) reason: Option<&'static str>,
    pub(crate) place_number: Option<u32>,
    pub(crate) posterior: Option<f64>,
    pub(crate) new_place_posterior: Option<f64>,
    pub(crate) words: Option<u32>,
    pub(crate) resent: Option<bool>,
    pub(crate) match_place_number: Option<u32>,
    pub(crate) match_posterior: Option<f64>,
    pub(crate) match_log_odds: Option<f64>,
    pub(crate) match_inliers: Option<u32>,
    /// That both show the same place, by words and geometry; null where there was none.
    pub(crate) match_probability: Option<f64>,
    pub(crate) match_session: Option<String>,
    pub(crate) match_sequence: Option<u64>,
    /// What its robot calls the frame that matched; null where there was none.
    pub(crate) match_note: Option<String>,
    pub(crate) best_candidate_place_number: Option<u32>,
    pub(crate) best_candidate_posterior: Option<f64>,
    pub(crate) best_candidate_log_odds: Option<f64>,
    pub(crate) best_candidate_session: Option<String>,
    pub(crate) best_candidate_sequence: Option<u64>,
    /// The part of the map whose frame the robot's pose is in; null, as the pose, where that is not known.
    pub(crate) map_part: Option<u32>,
    pub(crate) map_x_m: Option<f64>,
    pub(crate) map_y_m: Option<f64>,
    pub(crate) map_heading_rad: Option<f64>,
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
        let reason = answer.reason().json_name();
        let v1::FrameAnswer {
            sequence,
            last_committed_sequence: _,
            reason: _,
            place_number,
            posterior,
            new_place_posterior,
            places: _,
            r#match: matched,
            best_candidate,
            words,
            timings,
            resent,
            map_pose,
        } = answer;
        let robot = map_pose.as_ref().and_then(|pose| planar(pose.robot.as_ref()?));
        let match_frame = matched.as_ref().and_then(|matched| matched.frame.as_ref());
        let best_candidate_frame = best_candidate.as_ref().and_then(|candidate| candidate.frame.as_ref());
        Self {
            sequence,
            image: image.to_owned(),
            stamp_ns,
            reason: Some(reason),
            place_number,
            posterior: Some(posterior),
            new_place_posterior: Some(new_place_posterior),
            words: Some(words),
            resent: Some(resent),
            match_place_number: matched.as_ref().map(|matched| matched.place_number),
            match_posterior: matched.as_ref().map(|matched| matched.posterior),
            match_log_odds: matched.as_ref().map(|matched| matched.log_odds),
            match_inliers: matched.as_ref().and_then(|matched| Some(matched.geometry.as_ref()?.inliers)),
            match_probability: matched
                .as_ref()
                .and_then(|matched| Some(matched.geometry.as_ref()?.probability)),
            match_session: match_frame.map(|frame| frame.session.clone()),
            match_sequence: match_frame.map(|frame| frame.sequence),
            match_note: match_frame.map(|frame| frame.note.clone()),
            best_candidate_place_number: best_candidate.as_ref().map(|candidate| candidate.place_number),
            best_candidate_posterior: best_candidate.as_ref().map(|candidate| candidate.posterior),
            best_candidate_log_odds: best_candidate.as_ref().map(|candidate| candidate.log_odds),
            best_candidate_session: best_candidate_frame.map(|frame| frame.session.clone()),
            best_candidate_sequence: best_candidate_frame.map(|frame| frame.sequence),
            map_part: map_pose.as_ref().map(|pose| pose.part),
            map_x_m: robot.map(|[x_m, _, _]| x_m),
            map_y_m: robot.map(|[_, y_m, _]| y_m),
            map_heading_rad: robot.map(|[_, _, heading_rad]| heading_rad),
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
            refusal_code: Some(status_code_name(status.code)),
            refusal_message: Some(status.message),
            ..Self::default()
        }
    }
}

/// A pose seen from above: x, y and heading.
fn planar(pose: &v1::Pose) -> Option<[f64; 3]> {
    let (position, turned) = (pose.position_m?, pose.orientation?);
    Some([position.x, position.y, 2.0 * turned.z.atan2(turned.w)])
}
