//! Maps and their places.

use bytes::{Buf, BufMut};
use tonic::client::Grpc;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::codegen::http::uri::PathAndQuery;
use tonic::{Code, Request, Status};
use waypost_client::v1;
use waypost_proto::v1::map_service_client::MapServiceClient;

use super::{Cases, Ground};
use crate::harness::{map_request, reference};

/// Names of maps that are none, and what is said to them; the last one could be a map's.
pub(super) fn bad_map_names() -> Vec<(&'static str, String, Code, &'static str)> {
    let invalid = Code::InvalidArgument;
    let overlong = format!("maps/{}", "x".repeat(64));
    let endless = format!("maps/{}", "x".repeat(100_000));
    vec![
        ("no name", String::new(), invalid, "write maps/"),
        ("no collection", "drive".to_owned(), invalid, "write maps/"),
        ("another collection", "models/drive".to_owned(), invalid, "write maps/"),
        ("no map in it", "maps/".to_owned(), invalid, "write maps/"),
        ("a slash at the end", "maps/drive/".to_owned(), invalid, "write maps/"),
        ("a slash at the beginning", "/maps/drive".to_owned(), invalid, "write maps/"),
        ("capitals", "maps/Drive".to_owned(), invalid, "use 1 to 63 of a-z"),
        ("unicode", "maps/straße".to_owned(), invalid, "use 1 to 63 of a-z"),
        ("a space", "maps/drive ".to_owned(), invalid, "use 1 to 63 of a-z"),
        ("a null", "maps/drive\0".to_owned(), invalid, "use 1 to 63 of a-z"),
        ("a wildcard", "maps/-".to_owned(), invalid, "beginning with a letter or digit"),
        ("a path", "maps/../drive".to_owned(), invalid, "write maps/"),
        ("a parent", "maps/..".to_owned(), invalid, "use 1 to 63 of a-z"),
        ("SQL", "maps/drive'--".to_owned(), invalid, "use 1 to 63 of a-z"),
        ("overlong", overlong, invalid, "use 1 to 63 of a-z"),
        ("100,000 characters", endless, invalid, "use 1 to 63 of a-z"),
        ("unknown", "maps/nowhere".to_owned(), Code::NotFound, "list the maps to see what there is"),
    ]
}

/// Page sizes and tokens that no list takes.
pub(super) fn bad_pages() -> Vec<(&'static str, u32, &'static str, &'static str)> {
    let foreign = "begin again without one";
    vec![
        ("a page too large", 1001, "", "at most 1000 entries, not 1001"),
        ("the largest page", u32::MAX, "", "at most 1000 entries"),
        ("a token of words", 0, "Next Page!", foreign),
        ("a negative token", 0, "-1", foreign),
        ("a token of 2^64", 0, "18446744073709551616", foreign),
        ("a fraction as token", 0, "1.5", foreign),
        ("a token in unicode", 0, "\u{665}", foreign),
    ]
}

/// Foreign to the lists that count.
pub(super) const SIGNED_TOKEN: (&str, u32, &str, &str) =
    ("a signed token", 0, "+1", "begin again without one");

pub(super) async fn creating(ground: &Ground) -> Cases {
    let mut service = MapServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("create map");
    let (invalid, missing) = (Code::InvalidArgument, Code::NotFound);
    let set = |settings| v1::CreateMapRequest { settings: Some(settings), ..map_request("new", "shipped") };
    let blank = v1::MapSettings::default;
    let unknown = "which this server does not know";
    let threshold = |value| set(v1::MapSettings { closure_threshold: Some(value), ..blank() });
    let prior = |value| set(v1::MapSettings { new_place_prior: Some(value), ..blank() });
    let rates = |seen, mistaken| {
        let (true_positive_rate, false_positive_rate) = (Some(seen), Some(mistaken));
        set(v1::MapSettings { true_positive_rate, false_positive_rate, ..blank() })
    };
    for (case, request, code, fragment) in [
        ("nothing at all", v1::CreateMapRequest::default(), invalid, "is no map name; use 1 to 63"),
        ("unicode", map_request("größe", "shipped"), invalid, "use 1 to 63 of a-z"),
        ("a path", map_request("../new", "shipped"), invalid, "use 1 to 63 of a-z"),
        ("a null", map_request("a\0b", "shipped"), invalid, "use 1 to 63 of a-z"),
        ("overlong", map_request(&"x".repeat(100_000), "shipped"), invalid, "use 1 to 63 of a-z"),
        ("taken", map_request("drive", "shipped"), Code::AlreadyExists, "choose another name"),
        ("no model of two", map_request("new", ""), invalid, "more than one model, so name one"),
        ("a model's collection alone", map_request("new", "models/"), invalid, "write models/"),
        ("a model below a model", map_request("new", "models/a/b"), invalid, "write models/"),
        ("a map as model", map_request("new", "maps/drive"), missing, "list the models"),
        ("a hash of too few digits", map_request("new", "models/abc"), missing, "list the models"),
        ("dependence of the future", set(v1::MapSettings { dependence: 99, ..blank() }), invalid, unknown),
        ("dependence below 0", set(v1::MapSettings { dependence: -1, ..blank() }), invalid, unknown),
        ("new place of the future", set(v1::MapSettings { new_place: 99, ..blank() }), invalid, unknown),
        ("keep of the future", set(v1::MapSettings { keep: 99, ..blank() }), invalid, unknown),
        ("threshold infinite", threshold(f64::INFINITY), invalid, "above 0 and at most 1"),
        ("threshold NaN", threshold(f64::NAN), invalid, "above 0 and at most 1"),
        ("threshold -0", threshold(-0.0), invalid, "above 0 and at most 1"),
        ("threshold in percent", threshold(90.0), invalid, "above 0 and at most 1, not 90"),
        ("prior infinite", prior(f64::INFINITY), invalid, "between 0 and 1"),
        ("prior negative", prior(-0.5), invalid, "between 0 and 1"),
        ("rates infinite", rates(f64::INFINITY, 0.1), invalid, "true positive rate"),
        ("rates negative", rates(0.5, -0.1), invalid, "false positive rate"),
        ("rates NaN", rates(f64::NAN, 0.1), invalid, "true positive rate"),
        ("rates equal", rates(0.3, 0.3), invalid, "below the true positive rate"),
    ] {
        cases.refused(case, service.create_map(request).await, code, fragment);
    }
    cases
}

pub(super) async fn names(ground: &Ground) -> Cases {
    let mut service = MapServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("map names");
    for (case, name, code, fragment) in bad_map_names() {
        let mut check = |call: &str, result: Result<(), Status>| {
            cases.refused(&format!("{call}, {case}"), result, code, fragment);
        };
        let request = v1::GetMapRequest { name: name.clone(), view: 0 };
        check("get", service.get_map(request).await.map(drop));
        let request = v1::DeleteMapRequest { name: name.clone() };
        check("delete", service.delete_map(request).await.map(drop));
        let request = v1::ListPlacesRequest { map: name.clone(), ..Default::default() };
        check("places", service.list_places(request).await.map(drop));
        let request = v1::ListLoopClosuresRequest { map: name.clone(), ..Default::default() };
        check("matches", service.list_loop_closures(request).await.map(drop));
        let request = v1::ListWordPlacesRequest { map: name.clone(), ..Default::default() };
        check("word places", service.list_word_places(request).await.map(drop));
        let request = v1::RebindMapRequest { name, model: "shipped".to_owned() };
        check("rebind", service.rebind_map(request).await.map(drop));
    }
    for view in [99, -1] {
        let request = v1::GetMapRequest { name: "maps/drive".to_owned(), view };
        let case = format!("view {view}");
        let result = service.get_map(request).await;
        cases.refused(&case, result, Code::InvalidArgument, "view has the value");
    }
    cases
}

pub(super) async fn pages(ground: &Ground) -> Cases {
    let mut service = MapServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("pages of maps");
    let map = || "maps/drive".to_owned();
    for (case, page_size, token, fragment) in bad_pages().into_iter().chain([SIGNED_TOKEN]) {
        let mut check = |call: &str, result: Result<(), Status>| {
            cases.refused(&format!("{call}, {case}"), result, Code::InvalidArgument, fragment);
        };
        let page_token = token.to_owned();
        let request = v1::ListMapsRequest { page_size, page_token: page_token.clone() };
        // The list of maps goes by their names, and a map may be called by a number.
        if token.is_empty() || !token.bytes().all(|digit| digit.is_ascii_digit()) {
            check("maps", service.list_maps(request).await.map(drop));
        }
        let request = v1::ListPlacesRequest {
            map: map(),
            page_size,
            page_token: page_token.clone(),
            ..Default::default()
        };
        check("places", service.list_places(request).await.map(drop));
        let request = v1::ListLoopClosuresRequest { map: map(), page_size, page_token: page_token.clone() };
        check("matches", service.list_loop_closures(request).await.map(drop));
        let request = v1::ListWordPlacesRequest { map: map(), word: 0, page_size, page_token };
        check("word places", service.list_word_places(request).await.map(drop));
    }
    cases
}

pub(super) async fn places_and_words(ground: &Ground) -> Cases {
    let mut service = MapServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("places and words");
    let (invalid, missing) = (Code::InvalidArgument, Code::NotFound);
    for (case, name, code, fragment) in [
        ("no name", "", invalid, "write maps/…/places/NUMBER"),
        ("a map", "maps/drive", invalid, "write maps/…/places/NUMBER"),
        ("no number", "maps/drive/places/", invalid, "write maps/…/places/NUMBER"),
        ("a word", "maps/drive/places/first", invalid, "write maps/…/places/NUMBER"),
        ("negative", "maps/drive/places/-1", invalid, "write maps/…/places/NUMBER"),
        ("signed", "maps/drive/places/+1", invalid, "write maps/…/places/NUMBER"),
        ("a zero too many", "maps/drive/places/01", invalid, "write maps/…/places/NUMBER"),
        ("2^32", "maps/drive/places/4294967296", invalid, "write maps/…/places/NUMBER"),
        ("below a place", "maps/drive/places/0/words", invalid, "write maps/…/places/NUMBER"),
        ("of a map in capitals", "maps/Drive/places/0", invalid, "use 1 to 63 of a-z"),
        ("not there", "maps/drive/places/4294967295", missing, "list its places to see what there is"),
        ("of an empty map", "maps/other/places/0", missing, "list its places to see what there is"),
        ("of no map", "maps/nowhere/places/0", missing, "list the maps to see what there is"),
    ] {
        let request = v1::GetPlaceRequest { name: name.to_owned() };
        cases.refused(case, service.get_place(request).await, code, fragment);
    }
    let words = reference().model().vocabulary().len() as u32;
    for (case, word) in [("the word after the last", words), ("the largest word", u32::MAX)] {
        let request = v1::ListWordPlacesRequest { map: "maps/drive".to_owned(), word, ..Default::default() };
        let result = service.list_word_places(request).await;
        cases.refused(case, result, invalid, "the map's vocabulary has the words 0 to");
    }
    cases
}

/// Bytes as they are.
#[derive(Clone, Copy, Default)]
struct RawCodec;

impl Codec for RawCodec {
    type Encode = Vec<u8>;
    type Decode = Vec<u8>;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

impl Encoder for RawCodec {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, item: Vec<u8>, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put_slice(&item);
        Ok(())
    }
}

impl Decoder for RawCodec {
    type Item = Vec<u8>;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Vec<u8>>, Status> {
        let length = buffer.remaining();
        Ok(Some(buffer.copy_to_bytes(length).to_vec()))
    }
}

/// What reaches a call without being its message. The codes are those that gRPC has for it.
pub(super) async fn not_protobuf(ground: &Ground) -> Cases {
    let mut cases = Cases::new("bytes");
    let noise = || vec![0xff; 40];
    // Field 1, of 5 bytes, of which 2 come.
    let cut = || vec![0x0a, 5, b'm', b'a'];
    let no_utf8 = || vec![0x0a, 2, 0xc3, 0x28];
    let wrong_type = || vec![0x08, 7];
    let decoding = "failed to decode Protobuf message";
    let maps = "waypost.v1.MapService";
    let sessions = "waypost.v1.SessionService";
    let recognition = "waypost.v1.RecognitionService";
    for (case, service, call, bytes, code, fragment) in [
        ("noise for a map", maps, "GetMap", noise(), Code::Internal, decoding),
        ("a name that is cut", maps, "GetMap", cut(), Code::Internal, decoding),
        ("a name that is no UTF-8", maps, "GetMap", no_utf8(), Code::Internal, decoding),
        ("a number as name", maps, "CreateMap", wrong_type(), Code::Internal, decoding),
        ("noise for a deletion", maps, "DeleteMap", noise(), Code::Internal, decoding),
        ("noise for a rebinding", maps, "RebindMap", noise(), Code::Internal, decoding),
        ("noise for a query", recognition, "Query", noise(), Code::Internal, decoding),
        ("noise for a frame", sessions, "GetFrame", noise(), Code::Internal, decoding),
        ("a call that is none", maps, "MergeMaps", Vec::new(), Code::Unimplemented, ""),
        ("a service that is none", "waypost.v9.MapService", "GetMap", Vec::new(), Code::Unimplemented, ""),
        (
            "a query of 17 MiB",
            recognition,
            "Query",
            vec![0; 17 << 20],
            Code::OutOfRange,
            "the limit is: 16777216",
        ),
    ] {
        let mut grpc = Grpc::new(ground.channel().await);
        grpc.ready().await.unwrap();
        let path: PathAndQuery = format!("/{service}/{call}").parse().unwrap();
        let result = grpc.unary(Request::new(bytes), path, RawCodec).await;
        cases.refused(case, result.map(drop), code, fragment);
    }
    for (case, bytes) in [("noise as stream", noise()), ("a stream that is cut", cut())] {
        let mut grpc = Grpc::new(ground.channel().await);
        grpc.ready().await.unwrap();
        let path = PathAndQuery::from_static("/waypost.v1.SessionService/Stream");
        let requests = Request::new(futures::stream::iter([bytes]));
        let result = grpc.streaming(requests, path, RawCodec).await;
        let result = match result {
            Ok(responses) => responses.into_inner().message().await.map(drop),
            Err(status) => Err(status),
        };
        cases.refused(case, result, Code::Internal, decoding);
    }
    cases
}
