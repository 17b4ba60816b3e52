//! Where robots were, as text that other tools read.

use std::sync::Arc;

use axum::extract::State;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, MapPath, Nothing, Parameters, SessionPath};
use crate::names::{map_name, session_name};
use crate::service::Service;
use crate::service::trajectories::{TrajectoryBody, TrajectoryFormat, TrajectoryFrame, TrajectoryWanted};

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TrajectoryChoice {
    /// `tum`: a line of stamp in seconds, position and quaternion per frame. `kitti`: the upper three rows of its
    /// matrix.
    #[param(inline)]
    format: Format,
    /// `map`: corrected by loop closures. `odom`: the session's odometry as it was sent.
    #[param(inline)]
    frame: Frame,
    /// `base`: `base_link`. `camera`: the camera, where the session declared how it is mounted.
    #[param(inline)]
    body: Body,
    /// Thins long drives: of so many frames of the session only the first. 0 and 1 leave none out.
    #[param(example = 1)]
    every: u32,
}

/// `tum`: a line of stamp in seconds, position and quaternion per frame. `kitti`: the upper three rows of its matrix.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Format {
    #[default]
    Tum,
    Kitti,
}

/// `map`: corrected by loop closures. `odom`: the session's odometry as it was sent.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Frame {
    #[default]
    Map,
    Odom,
}

/// `base`: `base_link`. `camera`: the camera, where the session declared how it is mounted.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Body {
    #[default]
    Base,
    Camera,
}

impl Parameters for TrajectoryChoice {
    const TAKES: &str = "format=tum or kitti, frame=map or odom, body=base or camera, every=NUMBER";
}

/// Where a session's robot was at each of its frames; those that the map does not know where to put are left out.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/trajectory", tag = "exports",
    params(SessionPath, TrajectoryChoice),
    responses((status = 200, description = "A line per frame.", body = String, content_type = "text/plain"), Refusals))]
pub(super) async fn export_trajectory(
    State(service): State<Arc<Service>>,
    InPath(SessionPath { map, session }): InPath<SessionPath>,
    InQuery(TrajectoryChoice { format, frame, body, every }): InQuery<TrajectoryChoice>,
) -> Result<Response, HttpError> {
    let (format, ending) = match format {
        Format::Tum => (TrajectoryFormat::Tum, "tum"),
        Format::Kitti => (TrajectoryFormat::Kitti, "kitti"),
    };
    let frame = match frame {
        Frame::Map => TrajectoryFrame::Map,
        Frame::Odom => TrajectoryFrame::Odom,
    };
    let body = match body {
        Body::Base => TrajectoryBody::Base,
        Body::Camera => TrajectoryBody::Camera,
    };
    let wanted = TrajectoryWanted { format, frame, body, every };
    let text = service.trajectories.session(&session_name(&map, &session), wanted).await?;
    Ok(text_file(&format!("{map}-{session}.{ending}"), text))
}

/// The map's pose graph: a vertex per place, an edge with its information per way that was measured.
#[utoipa::path(get, path = "/v1/maps/{map}/graph.g2o", tag = "exports", params(MapPath),
    responses((status = 200, description = "Lines of g2o.", body = String, content_type = "text/plain"), Refusals))]
pub(super) async fn export_graph(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    Ok(text_file(&format!("{map}.g2o"), service.trajectories.pose_graph(&map_name(&map)).await?))
}

fn text_file(name: &str, text: Vec<u8>) -> Response {
    let headers = [
        (CONTENT_TYPE, "text/plain; charset=utf-8".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    (headers, text).into_response()
}
