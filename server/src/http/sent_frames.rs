//! Frames that come one by one, of robots that hold no stream open.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::State;
use axum::extract::rejection::BytesRejection;
use axum::http::HeaderMap;
use axum::{Extension, Json};
use serde::Deserialize;
use topomap::metric::Odometry;
use utoipa::IntoParams;
use waypost_proto::v1;

use super::description::{QueryRefusals, Refusals};
use super::frames::ImageFile;
use super::parameters::{FramePath, InPath, InQuery, Parameters};
use super::queries::{QueryError, WordQuery, shown};
use crate::error::ServiceError;
use crate::names::{frame_in, map_name};
use crate::open_map::Opener;
use crate::service::Service;
use crate::service::sessions::{Frame, Robot};
use crate::service::tokens::Caller;
use crate::wire::sessions::answer;

/// What a robot tells of a frame beside what it shows.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Told {
    /// When the image was taken by the robot's clock, in nanoseconds above 0.
    #[param(minimum = 1, example = 1_000_000_000)]
    stamp_ns: i64,
    /// Where the wheels put the robot then, in metres in its odom frame: x and y go with the heading.
    x_m: Option<f64>,
    /// See `x_m`.
    y_m: Option<f64>,
    /// Which way it looked there, in radians, counter-clockwise from x.
    heading_rad: Option<f64>,
    /// What the robot calls the frame, as by the name of a file.
    #[serde(default)]
    #[param(example = "000147.jpg")]
    note: String,
}

impl Parameters for Told {
    const TAKES: &str = "stamp_ns=NUMBER, x_m=METRES with y_m=METRES and heading_rad=RADIANS, and note=TEXT";
}

impl Told {
    fn odometry(&self) -> Result<Option<Odometry>, ServiceError> {
        match (self.x_m, self.y_m, self.heading_rad) {
            (None, None, None) => Ok(None),
            (Some(x_m), Some(y_m), Some(heading_rad)) => {
                let (sine, cosine) = (0.5 * heading_rad).sin_cos();
                let odometry = Odometry::new([x_m, y_m, 0.0], [0.0, 0.0, sine, cosine], None);
                odometry.map(Some).map_err(ServiceError::invalid)
            }
            (_, _, _) => Err(ServiceError::invalid(
                "odometry is x_m, y_m and heading_rad together; give all three, or none of them",
            )),
        }
    }
}

/// Sends a frame, as a robot does on its stream; the first one begins the session.
///
/// Numbers rise from frame to frame. A frame that is sent again gets the answer that it got. A stream that the session
/// has open ends, and frames of one session that come at once take turns: send one after the other. No camera is declared
/// so: a robot whose images are to measure metres streams over gRPC.
#[utoipa::path(put, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}", tag = "sessions",
    params(FramePath, Told),
    request_body(description = "An image of at most 4 MiB and 16 megapixels, or words.",
        content((ImageFile = "image/jpeg"), (ImageFile = "image/png"), (WordQuery = "application/json"))),
    responses((status = 200, description = "What was decided about it.", body = v1::FrameAnswer),
        Refusals, QueryRefusals))]
pub(super) async fn put_frame(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(told): InQuery<Told>,
    Extension(caller): Extension<Arc<Caller>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Json<v1::FrameAnswer>, QueryError> {
    let name = path.name();
    let (map, session, sequence) = frame_in(&name)?;
    let odometry = told.odometry()?;
    let (content, words_hash) = shown(&headers, body).await?;
    let Told { stamp_ns, x_m: _, y_m: _, heading_rad: _, note } = told;
    let frame = Frame { sequence, stamp_ns, content, odometry, note };
    let opener = Opener { token: caller.token.clone(), role: caller.role };
    let robot = Robot { words_hash: &words_hash, run: "", opener: Some(opener) };
    let answered = service.sessions.put_frame(&map_name(map), session, frame, robot).await?;
    Ok(Json(answer(answered)))
}
