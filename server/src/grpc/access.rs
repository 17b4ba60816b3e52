//! Who may call what, checked before a call reaches its service.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use bytes::Bytes;
use futures::FutureExt;
use futures::future::BoxFuture;
use http::{HeaderMap, Request, Response, header};
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio_util::sync::WaitForCancellationFutureOwned;
use tonic::Status;
use tonic::body::Body;
use tower::{Layer, Service as TowerService};

use crate::error::ServiceError;
use crate::net::calls::{CallKind, UntilRead};
use crate::net::messages::Metered;
use crate::net::standing::Standing;
use crate::service::Service;
use crate::service::tokens::{Access, Admitted, Ending};

/// Every method, and what it asks of who calls it.
const METHODS: [(&str, Access); 76] = [
    ("/waypost.v1.SessionService/Stream", Access::OPEN_SESSION),
    ("/waypost.v1.RecognitionService/Query", Access::LOCALIZE),
    ("/waypost.v1.SessionService/ListSessions", Access::READ),
    ("/waypost.v1.SessionService/GetSession", Access::READ),
    ("/waypost.v1.SessionService/ListOpenStreams", Access::READ),
    ("/waypost.v1.SessionService/ListFrames", Access::READ),
    ("/waypost.v1.SessionService/GetFrame", Access::READ),
    ("/waypost.v1.SessionService/GetFrameImage", Access::READ),
    ("/waypost.v1.SessionService/ExplainFrame", Access::READ),
    ("/waypost.v1.SessionService/GetFramePicture", Access::READ),
    ("/waypost.v1.SessionService/AddRelativePose", Access::STREAM),
    ("/waypost.v1.NavigationService/Navigate", Access::NAVIGATE),
    ("/waypost.v1.NavigationService/SetGoal", Access::NAVIGATE),
    ("/waypost.v1.NavigationService/CancelGoal", Access::NAVIGATE),
    ("/waypost.v1.NavigationService/GetNavigation", Access::READ),
    ("/waypost.v1.NavigationService/ListNavigations", Access::READ),
    ("/waypost.v1.NavigationService/PlanRoute", Access::READ),
    ("/waypost.v1.LabelService/ListLabels", Access::READ),
    // As goals: a token that may send a robot somewhere may name that place.
    ("/waypost.v1.LabelService/SetLabel", Access::NAVIGATE),
    ("/waypost.v1.LabelService/DeleteLabel", Access::NAVIGATE),
    ("/waypost.v1.AppearanceService/GetAppearanceGraph", Access::READ),
    ("/waypost.v1.EventService/Watch", Access::READ),
    ("/waypost.v1.EventService/GetMetricsHistory", Access::READ),
    // Messages name maps and what is in them, of whichever token.
    ("/waypost.v1.EventService/ListRefusals", Access::Server),
    // Names machines and addresses.
    ("/waypost.v1.ClusterService/GetCluster", Access::Server),
    ("/waypost.v1.MapService/ListMaps", Access::READ),
    ("/waypost.v1.MapService/GetMap", Access::READ),
    ("/waypost.v1.MapService/ListPlaces", Access::READ),
    ("/waypost.v1.MapService/GetPlace", Access::READ),
    ("/waypost.v1.MapService/ListWordPlaces", Access::READ),
    ("/waypost.v1.MapService/GetMatchMatrix", Access::READ),
    ("/waypost.v1.MapService/GetMatchMatrixTile", Access::READ),
    ("/waypost.v1.MapService/ListLoopClosures", Access::READ),
    ("/waypost.v1.MapService/ExportPoses", Access::READ),
    ("/waypost.v1.CorrectionService/ListCorrections", Access::READ),
    ("/waypost.v1.CorrectionService/WithdrawLoopClosure", Access::ADMIN),
    ("/waypost.v1.CorrectionService/ConfirmLoopClosure", Access::ADMIN),
    ("/waypost.v1.CorrectionService/UndoCorrection", Access::ADMIN),
    ("/waypost.v1.MapService/CreateMap", Access::ADMIN),
    ("/waypost.v1.MapService/DeleteMap", Access::ADMIN),
    ("/waypost.v1.MapService/RebindMap", Access::ADMIN),
    ("/waypost.v1.MapService/ExportMap", Access::ADMIN),
    ("/waypost.v1.MapService/ImportMap", Access::ADMIN),
    ("/waypost.v1.SessionService/DeleteSession", Access::ADMIN),
    ("/waypost.v1.MapService/RebuildMap", Access::ADMIN),
    ("/waypost.v1.MapService/RepairMap", Access::ADMIN),
    ("/waypost.v1.MapService/TrimMap", Access::ADMIN),
    ("/waypost.v1.MapService/CompactMap", Access::ADMIN),
    ("/waypost.v1.MergeService/GetMerge", Access::READ),
    ("/waypost.v1.MergeService/ListMerges", Access::READ),
    ("/waypost.v1.MergeService/GetMergePicture", Access::READ),
    ("/waypost.v1.MergeService/MergeMaps", Access::ADMIN),
    ("/waypost.v1.MergeService/CommitMerge", Access::ADMIN),
    ("/waypost.v1.MergeService/DiscardMerge", Access::ADMIN),
    ("/waypost.v1.MergeService/UndoMerge", Access::ADMIN),
    ("/waypost.v1.ModelService/ListModels", Access::READ),
    ("/waypost.v1.ModelService/GetModel", Access::READ),
    ("/waypost.v1.ModelService/ExportModel", Access::READ),
    ("/waypost.v1.ModelService/TrainModel", Access::Server),
    ("/waypost.v1.ModelService/ImportModel", Access::Server),
    ("/waypost.v1.ModelService/RenameModel", Access::Server),
    ("/waypost.v1.ModelService/DeleteModel", Access::Server),
    ("/waypost.v1.JobService/ListJobs", Access::READ),
    ("/waypost.v1.JobService/GetJob", Access::READ),
    ("/waypost.v1.JobService/WatchJob", Access::READ),
    ("/waypost.v1.JobService/CancelJob", Access::ADMIN),
    ("/waypost.v1.TokenService/CreateToken", Access::Server),
    ("/waypost.v1.TokenService/RotateToken", Access::Server),
    ("/waypost.v1.TokenService/UpdateToken", Access::Server),
    ("/waypost.v1.TokenService/ListTokens", Access::Server),
    ("/waypost.v1.TokenService/DeleteToken", Access::Server),
    ("/waypost.v1.TokenService/GetCaller", Access::Token),
    // Whatever watches over servers holds no token.
    ("/grpc.health.v1.Health/Check", Access::Open),
    ("/grpc.health.v1.Health/Watch", Access::Open),
    ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", Access::Token),
    ("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", Access::Token),
];

/// Methods whose calls last for as long as their callers like, or send much and are answered in little: their answers take no
/// memory. Queries that are too many are refused by who looks at images.
const LASTING: [&str; 11] = [
    "/waypost.v1.SessionService/Stream",
    "/waypost.v1.RecognitionService/Query",
    "/waypost.v1.NavigationService/Navigate",
    "/waypost.v1.EventService/Watch",
    "/waypost.v1.JobService/WatchJob",
    "/waypost.v1.MapService/ImportMap",
    "/waypost.v1.ModelService/ImportModel",
    "/waypost.v1.ModelService/TrainModel",
    "/grpc.health.v1.Health/Watch",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

fn call_kind(path: &str) -> CallKind {
    if LASTING.contains(&path) { CallKind::Lasting } else { CallKind::Answered }
}

/// Its calls change who may call, and are not ended by what they change themselves.
const TOKEN_SERVICE: &str = "/waypost.v1.TokenService/";

/// The method of a path, as the table has it.
pub(super) fn known_method(path: &str) -> Option<(&'static str, Access)> {
    METHODS.into_iter().find(|(known, _)| *known == path)
}

/// Lets in who may come in, and ends what they do when their token is deleted or expires.
#[derive(Clone, Debug)]
pub(super) struct AccessLayer {
    pub(super) service: Arc<Service>,
}

impl<S> Layer<S> for AccessLayer {
    type Service = Guarded<S>;

    fn layer(&self, inner: S) -> Guarded<S> {
        Guarded { inner, service: self.service.clone() }
    }
}

/// A service behind an [`AccessLayer`].
#[derive(Clone, Debug)]
pub(super) struct Guarded<S> {
    inner: S,
    service: Arc<Service>,
}

impl<S> TowerService<Request<Body>> for Guarded<S>
where
    S: TowerService<Request<Body>, Response = Response<Body>> + Clone + Send + 'static,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = BoxFuture<'static, Result<Response<Body>, S::Error>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        // What is in no table may be added to a service one day; until then it is for admins.
        let access = known_method(request.uri().path()).map_or(Access::Server, |(_, access)| access);
        let Admitted { caller, ending, room } = match self.admit(&request, access) {
            Ok(admitted) => admitted,
            Err(error) => {
                let mut refused = Status::from(error).into_http();
                // Whoever watches over the call hears who it was.
                if let Some(holder) = self.service.tokens.holder(bearer(request.headers())) {
                    refused.extensions_mut().insert(holder);
                }
                return std::future::ready(Ok(refused)).boxed();
            }
        };
        // It must hear that it made the first token, or deleted its own.
        let of_tokens = request.uri().path().starts_with(TOKEN_SERVICE);
        let ending = if of_tokens { Ending::default() } else { ending };
        request.extensions_mut().insert(caller.clone());
        // The routes take calls at any time.
        let mut inner = self.inner.clone();
        let kind = call_kind(request.uri().path());
        async move {
            let call = match access {
                Access::Open => None,
                Access::Token | Access::May(_) | Access::Server => match room.calls().open(kind).await {
                    Ok(call) => Some(call),
                    Err(error) => return Ok(Status::from(error).into_http()),
                },
            };
            let answering = inner.call(request.map(|body| Body::new(Metered::new(body, room))));
            tokio::select! {
                biased;
                response = answering => {
                    let body = |body| Body::new(UntilRead::new(UntilOver::new(body, ending), call));
                    let mut response = response?.map(body);
                    // Whoever watches over the call hears who it was.
                    response.extensions_mut().insert(caller);
                    Ok(response)
                }
                () = ending.over().cancelled() => Ok(Status::from(ending.why()).into_http()),
            }
        }
        .boxed()
    }
}

impl<S> Guarded<S> {
    /// Lets a call in, and its connection stay.
    fn admit(&self, request: &Request<Body>, access: Access) -> Result<Admitted, ServiceError> {
        let standing = request.extensions().get::<Standing>();
        let secret = bearer(request.headers());
        let admitted = self.service.tokens.admit(standing.map(Standing::peer), secret, access)?;
        match (access, standing) {
            (Access::Token | Access::May(_) | Access::Server, Some(standing)) => {
                standing.admit(admitted.admission())?;
            }
            (Access::Open, _) | (_, None) => {}
        }
        Ok(admitted)
    }
}

/// The secret in `authorization: Bearer SECRET`.
pub(super) fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, secret) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| secret.trim())
}

/// An answer that breaks off with UNAUTHENTICATED when its token is deleted or expires.
struct UntilOver {
    body: Body,
    ending: Ending,
    over: Pin<Box<WaitForCancellationFutureOwned>>,
    broken_off: bool,
}

impl UntilOver {
    fn new(body: Body, ending: Ending) -> Self {
        let over = Box::pin(ending.over().clone().cancelled_owned());
        Self { body, ending, over, broken_off: false }
    }
}

impl HttpBody for UntilOver {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.broken_off {
            return Poll::Ready(None);
        }
        if self.over.poll_unpin(context).is_pending() {
            return Pin::new(&mut self.body).poll_frame(context);
        }
        self.broken_off = true;
        let mut trailers = HeaderMap::new();
        let ended = Status::from(self.ending.why()).add_header(&mut trailers);
        Poll::Ready(Some(ended.map(|()| Frame::trailers(trailers))))
    }

    fn is_end_stream(&self) -> bool {
        self.broken_off || self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use http::HeaderValue;
    use prost::Message;
    use prost_types::FileDescriptorSet;

    use super::*;

    /// All methods that are served, from the descriptors that reflection hands out.
    fn served() -> BTreeSet<String> {
        let sets = [
            waypost_proto::FILE_DESCRIPTOR_SET,
            tonic_health::pb::FILE_DESCRIPTOR_SET,
            tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET,
            tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET,
        ];
        let mut paths = BTreeSet::new();
        for set in sets {
            for file in FileDescriptorSet::decode(set).unwrap().file {
                for service in &file.service {
                    paths.extend(
                        service.method.iter().map(|method| {
                            format!("/{}.{}/{}", file.package(), service.name(), method.name())
                        }),
                    );
                }
            }
        }
        paths
    }

    #[test]
    fn every_method_says_who_may_call_it() {
        let listed: BTreeSet<String> = METHODS.iter().map(|(path, _)| (*path).to_owned()).collect();
        assert_eq!(listed.len(), METHODS.len(), "a method is listed twice");
        assert_eq!(listed, served());
    }

    #[test]
    fn methods_that_last_are_streams_that_are_served() {
        for path in LASTING {
            assert!(served().contains(path), "{path}");
        }
    }

    #[test]
    fn only_health_is_open() {
        for (path, access) in METHODS {
            assert_eq!(access == Access::Open, path.starts_with("/grpc.health.v1."), "{path}");
        }
    }

    #[test]
    fn a_secret_is_read_from_its_header() {
        let of = |value: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::AUTHORIZATION, HeaderValue::from_static(value));
            bearer(&headers).map(str::to_owned)
        };
        assert_eq!(of("Bearer waypost_1").as_deref(), Some("waypost_1"));
        assert_eq!(of("bearer  waypost_1 ").as_deref(), Some("waypost_1"));
        for other in ["", "Bearer", "waypost_1", "Basic eDp5"] {
            assert_eq!(of(other), None, "{other:?}");
        }
        assert_eq!(bearer(&HeaderMap::new()), None);
    }
}
