//! Which maps a call names, checked before it is served.

use std::sync::Arc;

use http::Extensions;
use tonic::Request;
use waypost_proto::v1;

use crate::error::ServiceError;
use crate::service::tokens::Caller;

/// A request that names maps, or what is in them.
pub(super) trait NamesMaps {
    /// Names of resources, as in `maps/{map}/sessions/{session}`.
    fn resources(&self) -> Vec<&str>;
}

macro_rules! names_maps {
    ($($request:ident: $($field:ident),+;)+) => {$(
        impl NamesMaps for v1::$request {
            fn resources(&self) -> Vec<&str> {
                vec![$(&self.$field),+]
            }
        }
    )+};
}

names_maps! {
    AddRelativePoseRequest: frame, earlier_frame;
    CancelGoalRequest: name;
    CompactMapRequest: name;
    ConfirmLoopClosureRequest: frame, matched_frame;
    DeleteLabelRequest: place;
    DeleteMapRequest: name;
    DeleteSessionRequest: name;
    ExplainFrameRequest: name;
    ExportMapRequest: name;
    ExportPosesRequest: name;
    GetAppearanceGraphRequest: map;
    GetFrameImageRequest: name;
    GetFramePictureRequest: name, beside_frame;
    GetFrameRequest: name;
    GetMapRequest: name;
    GetMatchMatrixRequest: map, against;
    GetMatchMatrixTileRequest: map, against;
    GetNavigationRequest: name;
    GetPlaceRequest: name;
    GetSessionRequest: name;
    ListCorrectionsRequest: map;
    ListFramesRequest: session;
    ListLabelsRequest: map;
    ListLoopClosuresRequest: map;
    ListNavigationsRequest: map;
    ListPlacesRequest: map;
    ListSessionsRequest: map;
    ListWordPlacesRequest: map;
    PlanRouteRequest: map;
    RebindMapRequest: name;
    SetGoalRequest: name;
    SetLabelRequest: place;
    TrimMapRequest: name;
    UndoCorrectionRequest: name;
    WatchRequest: map;
    WithdrawLoopClosureRequest: frame;
}

/// What a request says, if who sends it reaches all maps that it names.
pub(super) fn within<T: NamesMaps>(request: Request<T>) -> Result<T, ServiceError> {
    Ok(within_by(request)?.1)
}

/// The same, and who sends it.
pub(super) fn within_by<T: NamesMaps>(request: Request<T>) -> Result<(Arc<Caller>, T), ServiceError> {
    let (caller, message) = with_caller(request)?;
    for name in message.resources() {
        caller.check_resource(name)?;
    }
    Ok((caller, message))
}

/// What a request says, and who sends it, of whom the service asks which maps they reach.
pub(super) fn with_caller<T>(request: Request<T>) -> Result<(Arc<Caller>, T), ServiceError> {
    let (_, extensions, message) = request.into_parts();
    Ok((caller(&extensions)?, message))
}

/// Who was let in with a request.
fn caller(extensions: &Extensions) -> Result<Arc<Caller>, ServiceError> {
    let caller = extensions.get::<Arc<Caller>>().cloned();
    caller.ok_or_else(|| ServiceError::internal("a call came past the guard"))
}
