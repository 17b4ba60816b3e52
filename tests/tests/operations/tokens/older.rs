//! Tokens of a server that knew no limits.

use sha2::{Digest, Sha256};
use sqlx::migrate::Migrator;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use waypost_client::v1;
use waypost_client::v1::token::Role;

use crate::harness::{
    Server, answers, database_options, frame, import_model, map_request, refused, session_options, workspace,
};

/// Tokens and jobs of a server that knew no limits mean what they meant.
#[tokio::test(flavor = "multi_thread")]
async fn tokens_of_an_older_server_are_without_limits() {
    const LAST_WITHOUT: i64 = 12;
    let old = tempfile::tempdir().unwrap();
    let mut migrator = Migrator::new(workspace().join("migrations")).await.unwrap();
    migrator.migrations = migrator.iter().filter(|one| one.version <= LAST_WITHOUT).cloned().collect();
    let file =
        SqliteConnectOptions::new().filename(old.path().join("waypost.sqlite")).create_if_missing(true);
    let mut database = file.connect().await.unwrap();
    migrator.run(&mut database).await.unwrap();
    let secrets = ["waypost_operator", "waypost_robot"];
    for (secret, role) in secrets.iter().zip(["admin", "robot"]) {
        let hash: [u8; 32] = Sha256::digest(secret).into();
        sqlx::query("INSERT INTO tokens (name, role, secret_sha256, created_ns) VALUES (?, ?, ?, 7)")
            .bind(role)
            .bind(role)
            .bind(hash.as_slice())
            .execute(&mut database)
            .await
            .unwrap();
    }
    for kind in ["train_model", "import_map"] {
        sqlx::query(
            "INSERT INTO jobs (kind, state, stage, created_ns, ended_ns) VALUES (?, 'cancelled', '', 7, ?)",
        )
        .bind(kind)
        .bind(i64::MAX)
        .execute(&mut database)
        .await
        .unwrap();
    }
    database.close().await.unwrap();

    let server = Server::start_on(old.path()).await;
    let client = async |secret: &str| {
        let options = waypost_client::ClientOptions::new(server.endpoint()).with_token(secret);
        waypost_client::Client::connect(options).await.unwrap()
    };
    let (admin, robot) = (client(secrets[0]).await, client(secrets[1]).await);
    let tokens = admin.tokens().await.unwrap();
    assert_eq!(tokens.iter().map(v1::Token::role).collect::<Vec<_>>(), [Role::Admin, Role::Robot]);
    assert_eq!(tokens.iter().map(|token| token.abilities.len()).collect::<Vec<_>>(), [5, 4]);
    assert!(tokens.iter().all(|token| token.maps.is_empty() && token.expire_time_ns.is_none()));
    assert!(tokens.iter().all(|token| token.quotas == Some(v1::Quotas::default())));
    let model = import_model(&admin).await;
    admin.create_map(map_request("drive", &model.name)).await.unwrap();
    answers(&robot, "drive", "tour", (1..=2).map(frame)).await;
    assert_eq!(robot.jobs().await.unwrap().len(), 2);
    // What an old import was about is not known.
    let limited = v1::CreateTokenRequest {
        token_id: "limited".to_owned(),
        role: Role::Robot.into(),
        maps: vec!["drive".to_owned()],
        ..Default::default()
    };
    let (_, secret) = admin.create_limited_token(limited).await.unwrap();
    let jobs = client(&secret).await.jobs().await.unwrap();
    assert_eq!(jobs.iter().map(v1::Job::kind).collect::<Vec<_>>(), [v1::job::Kind::TrainModel]);
    server.stop().await;
}

/// What sessions keep that an earlier server stored is counted once, and is what it would have noted.
#[tokio::test(flavor = "multi_thread")]
async fn what_an_older_server_stored_is_counted() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    for session in ["one", "two"] {
        answers(&client, "drive", session, (1..=3).map(frame)).await;
    }
    let kept = async |client: &waypost_client::Client| {
        let sessions = client.sessions("drive").await.unwrap();
        sessions.iter().map(|session| session.kept_bytes).collect::<Vec<_>>()
    };
    let before = kept(&client).await;
    assert!(before.iter().all(|bytes| *bytes > 30_000), "{before:?}");
    server.stop().await;

    let mut database = database_options(directory.path()).connect().await.unwrap();
    for as_before in ["UPDATE sessions SET kept_bytes = 0", "INSERT INTO upkeep (task) VALUES ('kept_bytes')"]
    {
        sqlx::query(as_before).execute(&mut database).await.unwrap();
    }
    database.close().await.unwrap();
    let two_sessions = |server: waypost_server::Server| {
        server.with_limits(waypost_server::ServerLimits {
            max_sessions: std::num::NonZeroU32::new(2),
            ..Default::default()
        })
    };
    let server = Server::start_as(directory.path(), two_sessions).await;
    let client = server.client().await;
    assert_eq!(kept(&client).await, before);
    let third = client.open_session(session_options("drive", "three")).await.map(drop);
    assert!(refused(third).1.contains("2 of the 2 sessions"));
    server.stop().await;
}
