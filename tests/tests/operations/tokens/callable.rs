//! What can be called: every method of the contract and every route, and who may.

use futures::stream;
use prost::Message;
use prost::bytes::BufMut;
use prost_types::FileDescriptorSet;
use reqwest::Method;
use tonic::codec::{BufferSettings, Codec, EncodeBuf, Encoder};
use tonic::metadata::AsciiMetadataValue;
use tonic::transport::Channel;
use tonic::{Request, Status};
use tonic_prost::ProstDecoder;

use crate::harness::{in_time, workspace};

/// Methods that a robot may not call.
pub(super) const FOR_ADMINS: [&str; 29] = [
    "/waypost.v1.MapService/CreateMap",
    "/waypost.v1.MapService/DeleteMap",
    "/waypost.v1.MapService/RebindMap",
    "/waypost.v1.MapService/ExportMap",
    "/waypost.v1.MapService/ImportMap",
    "/waypost.v1.SessionService/DeleteSession",
    "/waypost.v1.MapService/RebuildMap",
    "/waypost.v1.MapService/RepairMap",
    "/waypost.v1.MapService/TrimMap",
    "/waypost.v1.MapService/CompactMap",
    "/waypost.v1.CorrectionService/WithdrawLoopClosure",
    "/waypost.v1.CorrectionService/ConfirmLoopClosure",
    "/waypost.v1.CorrectionService/UndoCorrection",
    "/waypost.v1.MergeService/MergeMaps",
    "/waypost.v1.MergeService/CommitMerge",
    "/waypost.v1.MergeService/DiscardMerge",
    "/waypost.v1.MergeService/UndoMerge",
    "/waypost.v1.ModelService/TrainModel",
    "/waypost.v1.ModelService/ImportModel",
    "/waypost.v1.ModelService/RenameModel",
    "/waypost.v1.ModelService/DeleteModel",
    "/waypost.v1.JobService/CancelJob",
    "/waypost.v1.EventService/ListRefusals",
    "/waypost.v1.ClusterService/GetCluster",
    "/waypost.v1.TokenService/CreateToken",
    "/waypost.v1.TokenService/RotateToken",
    "/waypost.v1.TokenService/UpdateToken",
    "/waypost.v1.TokenService/ListTokens",
    "/waypost.v1.TokenService/DeleteToken",
];

/// Routes over HTTP that a robot may not ask for.
pub(super) const ROUTES_FOR_ADMINS: [(Method, &str); 20] = [
    (Method::POST, "/v1/maps"),
    (Method::DELETE, "/v1/maps/{map}"),
    (Method::GET, "/v1/maps/{map}/export"),
    (Method::POST, "/v1/maps/{map}/import"),
    (Method::DELETE, "/v1/maps/{map}/sessions/{session}"),
    (Method::POST, "/v1/maps/{map}/corrections"),
    (Method::POST, "/v1/maps/{map}/corrections/{correction}/undo"),
    (Method::POST, "/v1/merges"),
    (Method::PUT, "/v1/merges/{merge}/decision"),
    (Method::POST, "/v1/models"),
    (Method::DELETE, "/v1/models/{model}"),
    (Method::PUT, "/v1/models/{model}/display-name"),
    (Method::POST, "/v1/jobs/{job}/cancel"),
    (Method::GET, "/v1/refusals"),
    (Method::GET, "/v1/cluster"),
    (Method::GET, "/v1/tokens"),
    (Method::POST, "/v1/tokens"),
    (Method::DELETE, "/v1/tokens/{token}"),
    (Method::PATCH, "/v1/tokens/{token}"),
    (Method::POST, "/v1/tokens/{token}/rotate"),
];

/// Routes over HTTP that are open to all.
pub(super) const OPEN_ROUTES: [&str; 7] = [
    "/healthz",
    "/readyz",
    "/",
    "/inspector/inspector.js",
    "/inspector/inspector.css",
    "/inspector/icon.svg",
    "/inspector/licences.txt",
];

/// Routes that are not in the API's description, and one that is none.
const OTHER_ROUTES: [&str; 5] =
    ["/docs", "/inspector/other.js", "/metrics", "/v1/openapi.json", "/v1/nowhere"];

/// Method and path of every route that asks for a token, and whether it is for administrators.
pub(super) fn guarded_routes() -> Vec<(Method, String, bool)> {
    let description = std::fs::read_to_string(workspace().join("server/openapi.json")).unwrap();
    let description: serde_json::Value = serde_json::from_str(&description).unwrap();
    let mut routes: Vec<(Method, String, bool)> =
        OTHER_ROUTES.iter().map(|&path| (Method::GET, path.to_owned(), false)).collect();
    let mut for_admins = 0;
    for (route, methods) in description["paths"].as_object().unwrap() {
        for method in methods.as_object().unwrap().keys() {
            let method: Method = method.to_uppercase().parse().unwrap();
            // Whether there is such a thing is told only to those who may know. The map is still asked for later.
            let map = if method == Method::DELETE { "nowhere" } else { "drive" };
            let named =
                |part: &str| if part == "{map}" { map } else { part.trim_matches(['{', '}']) }.to_owned();
            let path: Vec<String> = route.split('/').map(named).collect();
            let is_for_admins = ROUTES_FOR_ADMINS.contains(&(method.clone(), route.as_str()));
            for_admins += usize::from(is_for_admins);
            routes.push((method, path.join("/"), is_for_admins));
        }
    }
    assert_eq!(for_admins, ROUTES_FOR_ADMINS.len(), "a route of the table is none");
    assert!(routes.len() > 20, "{routes:?}");
    routes
}

/// Every method of the contract, from its descriptors.
pub(super) fn methods() -> Vec<String> {
    let set = FileDescriptorSet::decode(waypost_proto::FILE_DESCRIPTOR_SET).unwrap();
    let mut paths = Vec::new();
    for file in &set.file {
        for service in &file.service {
            let path = |method: &str| format!("/{}.{}/{method}", file.package(), service.name());
            paths.extend(service.method.iter().map(|method| path(method.name())));
        }
    }
    assert!(paths.len() >= 32, "this test sees few methods: {paths:?}");
    paths
}

/// Calls a method by its path, with one empty message.
pub(super) async fn call(channel: &Channel, path: &str, authorization: Option<&str>) -> Result<(), Status> {
    call_with(channel, path, authorization, Vec::new()).await
}

/// The same with a message as it is encoded.
pub(super) async fn call_with(
    channel: &Channel,
    path: &str,
    authorization: Option<&str>,
    message: Vec<u8>,
) -> Result<(), Status> {
    let mut grpc = tonic::client::Grpc::new(channel.clone());
    grpc.ready().await.unwrap();
    let mut request = Request::new(stream::iter([message]));
    if let Some(authorization) = authorization {
        let value: AsciiMetadataValue = authorization.parse().unwrap();
        request.metadata_mut().insert("authorization", value);
    }
    let mut answers = in_time(grpc.streaming(request, path.parse().unwrap(), Encoded)).await?.into_inner();
    in_time(answers.message()).await.map(drop)
}

/// Sends messages that are encoded already, and reads nothing of the answers.
struct Encoded;

impl Codec for Encoded {
    type Encode = Vec<u8>;
    type Decode = ();
    type Encoder = Self;
    type Decoder = ProstDecoder<()>;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self::Decoder {
        ProstDecoder::new(BufferSettings::default())
    }
}

impl Encoder for Encoded {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, message: Vec<u8>, into: &mut EncodeBuf<'_>) -> Result<(), Status> {
        into.put_slice(&message);
        Ok(())
    }
}
