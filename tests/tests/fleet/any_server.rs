//! Servers in reserve: they answer as the owner does, and lose nothing when the owner changes.

use std::time::{Duration, Instant};

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, ExtendedKeyUsagePurpose, IsCa, KeyPair};
use waypost_client::{Client, ClientOptions, Code, Error, v1};
use waypost_server::Role;
use waypost_server::config::{DataLocation, StorageAddress};
use waypost_server::offline;

use super::owners::{
    FRAMES, beside_others, beside_others_with, epoch, is_whole, owner, prepared, until_it_owns,
};
use crate::harness::{
    Answer, Cluster, ServerProcess, answers, assert_status, frame, http, in_time, map_request,
    session_options, stream, stream_through, told,
};

/// A robot knows the address of one server. That is never the owner's at first, and the owners die.
#[tokio::test(flavor = "multi_thread")]
async fn a_robot_goes_on_at_the_server_that_it_reached() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "one_address").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let (reached, _reached_directory) = beside_others(&database.url());
    let client = Client::connect(&reached.endpoint()).await.unwrap();
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let (third, _third_directory) = beside_others(&database.url());
    let third = std::cell::Cell::new(Some(third));
    // It may be the next owner, and lives until the end.
    let _last = stream_through(session, FRAMES, frame, first, |answered, server| {
        if answered != 17 {
            return server;
        }
        server.kill();
        third.take().expect("this happens once")
    })
    .await;
    is_whole(&client, FRAMES).await;
    assert_eq!(epoch(&database).await, 3);
}

/// An owner that stops is followed at once, and what a robot had under way is answered by the next.
#[tokio::test(flavor = "multi_thread")]
async fn a_robot_hardly_waits_for_an_owner_that_stops() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "drained").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let (reached, _reached_directory) = beside_others(&database.url());
    let client = Client::connect(&reached.endpoint()).await.unwrap();
    let (before, after) = (answers(&client, "drive", "robot", (1..=20).map(frame)).await, 21..=FRAMES);
    let stopped = tokio::task::spawn_blocking(move || first.stop());
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let rest = stream(session, after.map(frame)).await;
    stopped.await.unwrap();
    assert_eq!(before.len() + rest.len(), FRAMES as usize);
    is_whole(&client, FRAMES).await;
    assert!(reached.log().contains("serving"), "{}", reached.log());
}

/// Through either, the same map: the same answers, and each server tells the other's.
#[tokio::test(flavor = "multi_thread")]
async fn two_robots_at_two_servers_share_a_map() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "shared_map").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let (second, _second_directory) = beside_others(&database.url());
    let mut by_both = Vec::new();
    for (server, map) in [(&first, "through_owner"), (&second, "through_other")] {
        let client = server.client().await;
        let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
        client.create_map(map_request(map, &model)).await.unwrap();
        by_both.push(answers(&client, map, "robot", (1..=FRAMES).map(frame)).await);
    }
    let [owned, other] =
        [&by_both[0], &by_both[1]].map(|answers| answers.iter().map(told).collect::<Vec<_>>());
    assert_eq!(owned, other);
    for server in [&first, &second] {
        let maps = server.client().await.maps().await.unwrap();
        let frames: Vec<_> = maps.iter().map(|map| (map.name.as_str(), map.frames)).collect();
        assert_eq!(
            frames,
            [("maps/drive", 0), ("maps/through_other", FRAMES), ("maps/through_owner", FRAMES)]
        );
    }
}

/// Tokens are asked for at either, and an owner hears who really asks.
#[tokio::test(flavor = "multi_thread")]
async fn tokens_hold_at_every_server() {
    let Some(cluster) = Cluster::running() else { return };
    let database = cluster.database("tokens_everywhere").await;
    let directory = tempfile::tempdir().unwrap();
    let storage = StorageAddress::Postgres(database.url());
    let location = DataLocation { storage, data_dir: directory.path().to_owned(), ..Default::default() };
    let secret = offline::create_token(location, "operator", Role::Admin, Default::default()).await.unwrap();
    let (first, _first_directory) = owner(&database.url()).await;
    let (second, _second_directory) = beside_others(&database.url());
    let stranger = Client::connect(&second.endpoint()).await.unwrap();
    is_refused(stranger.maps().await, Code::Unauthenticated, "asks for a token");
    let with = async |secret: &str| {
        let options = ClientOptions::new(second.endpoint()).with_token(secret);
        Client::connect(options).await.unwrap()
    };
    let known = with(&secret).await;
    assert_eq!(known.maps().await.unwrap().len(), 0);
    let unknown = with("waypost_1").await;
    is_refused(unknown.maps().await, Code::Unauthenticated, "is not known here");

    let url = format!("http://{}/metrics", second.http());
    let refused = Answer::to(http().get(&url)).await;
    assert_eq!(refused.status.as_u16(), 401, "{}", refused.text());
    // Its own, and not the owner's; read by who may read the owner's.
    let metrics = Answer::to(http().get(&url).bearer_auth(&secret)).await;
    assert!(metrics.text().contains("\nwaypost_owns_database 0\n"), "{}", metrics.text());
    let url = format!("http://{}/metrics", first.http());
    let metrics = Answer::to(http().get(&url).bearer_auth(&secret)).await;
    assert!(metrics.text().contains("\nwaypost_owns_database 1\n"), "{}", metrics.text());

    // Whoever does not know the fleet's secret is who it is.
    let url = format!("http://{}/v1/maps", first.http());
    let pretending = http().get(&url).bearer_auth(&secret).header("waypost-forwarded", "192.0.2.7 secret");
    assert_eq!(Answer::to(pretending).await.status.as_u16(), 200);
    let url = format!("http://{}/v1/maps", second.http());
    let pretending = http().get(&url).bearer_auth(&secret).header("waypost-forwarded", "192.0.2.7 secret");
    assert_eq!(Answer::to(pretending).await.status.as_u16(), 200);
    assert!(!first.log().contains("192.0.2.7"), "{}", first.log());
}

/// What nobody can answer is refused at once with when to try again; that it lives is said by each for itself.
#[tokio::test(flavor = "multi_thread")]
async fn without_an_owner_it_is_said_when_to_try_again() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "nobody").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let (second, _second_directory) = beside_others(&database.url());
    let client = second.client().await;
    client.maps().await.unwrap();
    let at = |path: &str| format!("http://{}{path}", second.http());
    assert_eq!(Answer::to(http().get(at("/readyz"))).await.status.as_u16(), 200);
    let died = Instant::now();
    first.kill();
    let refused = Answer::to(http().get(at("/readyz"))).await;
    assert_eq!(refused.status.as_u16(), 503, "{}", refused.text());
    assert!(refused.text().contains("send this again in a moment"), "{}", refused.text());
    assert_eq!(refused.header("retry-after"), "1");
    assert_eq!(Answer::to(http().get(at("/healthz"))).await.text(), "ok\n");
    is_refused(client.maps().await, Code::Unavailable, "send this again in a moment");
    in_time(async {
        while client.maps().await.is_err() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
    println!("{:?} without an owner", died.elapsed());
    assert!(second.log().contains("serving"), "{}", second.log());
}

/// Servers show each other their certificates, and trust those of one authority alone.
#[tokio::test(flavor = "multi_thread")]
async fn servers_ask_each_other_over_tls() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "encrypted").await;
    let files = tempfile::tempdir().unwrap();
    let path = |name: &str| files.path().join(name).to_str().unwrap().to_owned();
    let (authority, other) = (authority(), authority());
    let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
    params.extended_key_usages =
        vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
    let key = KeyPair::generate().unwrap();
    let certificate = params.signed_by(&key, &authority).unwrap().pem();
    for (name, content) in [
        ("server.crt", certificate.clone()),
        ("server.key", key.serialize_pem()),
        ("ca.crt", authority.pem()),
        ("other.crt", other.pem()),
    ] {
        std::fs::write(path(name), content).unwrap();
    }
    let pair = ["--tls-certificate", &path("server.crt"), "--tls-key", &path("server.key")];
    let clients = ["--tls-client-ca", &path("ca.crt")];
    let trusting = |ca: &str| [&pair[..], &clients, &["--tls-fleet-ca", ca]].concat().join("\n");
    let start = |ca: &str| {
        let options = trusting(&path(ca));
        beside_others_with(&database.url(), &options.split('\n').collect::<Vec<_>>())
    };
    let asked = async |server: &ServerProcess| {
        let options = ClientOptions::new(server.endpoint().replace("http://", "https://"));
        let options = options.with_ca(authority.pem()).with_identity(&certificate, key.serialize_pem());
        Client::connect(options).await.unwrap().maps().await
    };
    let (first, _first_directory) = start("ca.crt");
    until_it_owns(&first);
    let (second, _second_directory) = start("ca.crt");
    let (third, _third_directory) = start("other.crt");
    for server in [&first, &second] {
        assert_eq!(asked(server).await.unwrap().len(), 1);
    }
    is_refused(asked(&third).await, Code::Unavailable, "was not reached");
    assert!(third.log().contains("invalid peer certificate"), "{}", third.log());
}

fn authority() -> CertifiedIssuer<'static, KeyPair> {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap()
}

pub(super) fn is_refused<T: std::fmt::Debug>(answer: Result<T, Error>, code: Code, says: &str) {
    match answer {
        Err(Error::Status { code: said, message, .. }) => assert_status("", (said, &message), code, says),
        other => panic!("{other:?}"),
    }
}
