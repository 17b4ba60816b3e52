//! Tokens that expire, and secrets that are replaced.

use waypost_client::v1::token::Role;
use waypost_client::{Code, Error, FrameOutcome, v1};

use super::{Guarded, run};
use crate::harness::{
    ServerProcess, answers, as_words, assert_status, frame, in_time, refused, session_options,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_token_expires_and_ends_its_streams() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let request = v1::CreateTokenRequest {
        token_id: "guest".to_owned(),
        role: Role::Robot.into(),
        lifetime_s: Some(2),
        ..Default::default()
    };
    let (token, secret) = admin.create_limited_token(request).await.unwrap();
    assert_eq!(token.expire_time_ns, Some(token.create_time_ns + 2_000_000_000));
    let guest = guarded.client(&secret).await;
    assert_eq!(guest.caller().await.unwrap().expire_time_ns, token.expire_time_ns);
    let mut session = guest.open_session(session_options("drive", "guest")).await.unwrap();
    session.send(frame(1)).await.unwrap();
    assert!(matches!(in_time(session.next()).await, Ok(Some(FrameOutcome::Answer(_)))));
    let mut watch = guest.watch_map("drive", None).await.unwrap();
    let ended = in_time(session.next()).await;
    let Err(Error::Status { code, message }) = ended else { panic!("{ended:?}") };
    assert_status("stream", (code, &message), Code::Unauthenticated, "the token guest expired at 2");
    let ended = in_time(async {
        loop {
            match watch.next().await {
                Ok(_) => {}
                Err(error) => return error,
            }
        }
    });
    let (code, message) = refused(Err::<(), _>(ended.await));
    assert_status("watch", (code, &message), Code::Unauthenticated, "expired at");
    let (code, message) = refused(guest.maps().await);
    let says = "Z; ask who runs the server to make another, or to renew this one";
    assert_status("later", (code, &message), Code::Unauthenticated, says);

    let rotation = v1::RotateTokenRequest { name: "guest".to_owned(), ..Default::default() };
    let (code, message) = refused(admin.rotate_token(rotation.clone()).await);
    assert_status(
        "rotated",
        (code, &message),
        Code::FailedPrecondition,
        "say how long it is to live from now on",
    );
    let rotation = v1::RotateTokenRequest { overlap_s: Some(0), lifetime_s: Some(3600), ..rotation };
    let (renewed, secret) = admin.rotate_token(rotation).await.unwrap();
    assert!(renewed.expire_time_ns > token.expire_time_ns);
    answers(&guarded.client(&secret).await, "drive", "guest", (2..=3).map(as_words)).await;
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_rotated_without_a_break() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let old = guarded.client(&guarded.robot).await;
    let (mut sender, mut outcomes) =
        old.open_session(session_options("drive", "tour")).await.unwrap().split();
    let rotation =
        v1::RotateTokenRequest { name: "tokens/robot".to_owned(), overlap_s: Some(3), lifetime_s: None };
    let (token, secret) = admin.rotate_token(rotation).await.unwrap();
    assert_eq!((token.name.as_str(), token.expire_time_ns), ("tokens/robot", None));
    // Both secrets are good for the moment.
    sender.send(frame(1)).await.unwrap();
    assert!(matches!(in_time(outcomes.next()).await, Ok(Some(FrameOutcome::Answer(_)))));
    assert_eq!(old.caller().await.unwrap().expire_time_ns, token.overlap_end_time_ns);
    let new = guarded.client(&secret).await;
    assert_eq!(new.caller().await.unwrap().expire_time_ns, None);
    // Then the new one alone, and the session is still its own.
    let ended = in_time(outcomes.next()).await;
    let Err(Error::Status { code, message }) = ended else { panic!("{ended:?}") };
    assert_status("stream", (code, &message), Code::Unauthenticated, "the token robot has a new secret");
    let (code, message) = refused(old.maps().await);
    assert_status("later", (code, &message), Code::Unauthenticated, "use the new one");
    answers(&new, "drive", "tour", (2..=3).map(as_words)).await;
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_and_rotation_are_on_both_command_lines() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().to_str().unwrap();
    let offline = |arguments: &[&str]| {
        run("waypost-server", &[&["token"], arguments, &["--data-dir", data]].concat(), &[])
    };
    let (_, admin, _) = offline(&["create", "operator", "--role", "admin"]);
    let admin = admin.trim();
    let limited = [
        "create",
        "scout",
        "--role",
        "robot",
        "--may",
        "localize,read",
        "--map",
        "hall",
        "--map",
        "floor2-*",
    ];
    assert_eq!(offline(&limited).0, 0);
    assert_eq!(offline(&["create", "guest", "--role", "reader", "--expires-in", "12h"]).0, 0);
    for (wrong, says) in [
        (&["--role", "reader", "--may", "stream"][..], "a reader may read, and not stream"),
        (&["--role", "robot", "--map", "*"], "leave them out for all maps"),
        (&["--role", "robot", "--expires-in", "30"], "write a whole number and its unit"),
    ] {
        let (code, _, stderr) = offline(&[&["create", "wrong"], wrong].concat());
        assert!(code != 0 && stderr.contains(says), "{wrong:?}: {stderr}");
    }
    let (_, listed, _) = offline(&["ls"]);
    let rows: Vec<&str> = listed.lines().collect();
    assert!(rows[0].starts_with("guest  reader  until 2"), "{listed}");
    assert_eq!(rows[1], "operator  admin");
    assert_eq!(rows[2], "scout  robot  may read and localize; the maps floor2-* and hall");

    let server = ServerProcess::start(directory.path());
    let endpoint = server.endpoint();
    let online = |arguments: &[&str], secret: &str| {
        run("waypost", arguments, &[("WAYPOST_SERVER", endpoint.as_str()), ("WAYPOST_TOKEN", secret)])
    };
    let create = [
        "token",
        "create",
        "short",
        "--role",
        "robot",
        "--may",
        "stream",
        "--map",
        "maps/hall",
        "--expires-in",
    ];
    let (code, created, stderr) = online(&[&create[..], &["30d"]].concat(), admin);
    assert_eq!(code, 0, "{stderr}");
    let secret =
        created.lines().find_map(|line| line.trim().strip_prefix("secret  ")).unwrap().trim().to_owned();
    let (_, listed, _) = online(&["token", "ls"], admin);
    let expected = "TOKEN ROLE MAY MAPS EXPIRES QUOTAS\n\
                    guest reader read all in 12 h none\n\
                    operator admin read,localize,stream,navigate,admin all never none\n\
                    scout robot read,localize floor2-*,hall never none\n\
                    short robot stream hall in 30 d none\n";
    assert_eq!(words(&listed), words(expected));
    let (code, _, stderr) = online(&["token", "create", "wrong", "--role", "admin", "--may", "read"], admin);
    assert!(code == 4 && stderr.contains("an admin may do everything"), "{stderr}");
    let (code, _, stderr) = online(&["token", "rotate", "short", "--overlap", "8d"], admin);
    assert!(code == 4 && stderr.contains("at most 604800 s"), "{stderr}");
    let (code, rotated, stderr) = online(&["token", "rotate", "short", "--overlap", "0s"], admin);
    assert!(code == 0 && rotated.contains("secret before is good for another 0 s"), "{rotated}{stderr}");
    let new = rotated.lines().find_map(|line| line.trim().strip_prefix("secret  ")).unwrap().trim();
    assert_ne!(new, secret);
    let (code, _, stderr) = online(&["map", "ls"], &secret);
    assert!(code == 4 && stderr.contains("the token short has a new secret"), "{stderr}");
    let (code, _, stderr) = online(&["map", "ls"], new);
    assert!(code == 4 && stderr.contains("short may only stream"), "{stderr}");
    assert!(!server.log().contains(new), "a secret is in the log");
    server.stop();
}

/// What a table holds, without its spaces.
fn words(table: &str) -> Vec<Vec<&str>> {
    table.lines().map(|line| line.split_whitespace().collect()).collect()
}
