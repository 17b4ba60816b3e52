//! Which places look alike, as pictures.

use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::IntoParams;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::frames::{ImageFile, unless_known};
use super::parameters::{InPath, InQuery, MapPath, Parameters, TilePath};
use crate::error::ServiceError;
use crate::names::map_name;
use crate::service::Service;
use crate::service::match_matrix::{MatrixTile, TileAt};
use crate::service::tokens::Caller;
use crate::wire::match_matrix::match_matrix;

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Against {
    /// Name of the map on the columns, of the same model. Left out, the map is compared with itself.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$")]
    against: String,
}

impl Parameters for Against {
    const TAKES: &str = "against=MAP";
}

impl Against {
    /// Its full name, if the caller reaches it; empty if there is none.
    fn name(self, caller: &Caller) -> Result<String, ServiceError> {
        if self.against.is_empty() {
            return Ok(self.against);
        }
        caller.check_map(&self.against)?;
        Ok(map_name(&self.against))
    }
}

/// How a map's match matrix is laid out: which of its places look like which, or like those of another map.
#[utoipa::path(get, path = "/v1/maps/{map}/matrix", tag = "maps", params(MapPath, Against),
    responses((status = 200, description = "Sides, scale and what the map has joined.", body = v1::MatchMatrix), Refusals))]
pub(super) async fn get_match_matrix(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(against): InQuery<Against>,
) -> Result<Json<v1::MatchMatrix>, HttpError> {
    let against = against.name(&caller)?;
    Ok(Json(match_matrix(service.match_matrices.describe(&map_name(&map), &against).await?)))
}

/// A square piece of a match matrix: 256 x 256 cells of 8 bits of grey.
///
/// The shade is 0 at 0 nats of evidence and below, and 255 at `full_shade_nats` and above. A cell of level z is the largest
/// of 2^z x 2^z pairs of places, so that what looks alike never vanishes.
#[utoipa::path(get, path = "/v1/maps/{map}/matrix/tiles/{level}/{row}/{column}", tag = "maps", params(TilePath, Against,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the picture that is there already.")),
    responses(
        (status = 200, description = "The piece.", headers(("ETag" = String, description = "Hash of the picture.")),
            content((ImageFile = "image/png"))),
        (status = 304, description = "The picture is still the one that the caller has."),
        Refusals))]
pub(super) async fn get_match_matrix_tile(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(TilePath { map, level, row, column }): InPath<TilePath>,
    InQuery(against): InQuery<Against>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let against = against.name(&caller)?;
    let at = TileAt { level, row, column };
    let MatrixTile { content_type, picture } =
        service.match_matrices.tile(&map_name(&map), &against, at).await?;
    unless_known(&headers, content_type, picture).await
}
