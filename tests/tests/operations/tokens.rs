//! Who may do what: every method and every route with no, wrong and right token.

use reqwest::StatusCode;
use tonic::Status;
use waypost_client::{Client, ClientOptions, Code, Error, FrameOutcome, SessionOptions, v1};

use self::callable::{FOR_ADMINS, OPEN_ROUTES, call, guarded_routes, methods};
use crate::harness::{
    Built, Proxy, RawStream, Server, ServerProcess, answers, as_words, assert_status, channel, frame,
    import_model, in_time, map_request, open, refused, run_to_its_end, session_options, wire,
};

mod callable;
mod doors;
mod limits;
mod older;
mod passing;
mod quotas;
mod waiting;

/// A server with an admin's token and a robot's, and a map `drive` in it.
struct Guarded {
    server: Server,
    admin: String,
    robot: String,
}

impl Guarded {
    async fn start() -> Self {
        let (server, client) = Server::with_map().await;
        let (_, admin) = client.create_token("operator", v1::token::Role::Admin).await.unwrap();
        let options = ClientOptions::new(server.endpoint()).with_token(&admin);
        let client = Client::connect(options).await.unwrap();
        let (_, robot) = client.create_token("robot", v1::token::Role::Robot).await.unwrap();
        Self { server, admin, robot }
    }

    async fn client(&self, secret: &str) -> Client {
        Client::connect(ClientOptions::new(self.server.endpoint()).with_token(secret)).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_method_asks_for_the_right_token() {
    let guarded = Guarded::start().await;
    let channel = channel(&guarded.server.endpoint()).await;
    let (admin, robot) = (format!("Bearer {}", guarded.admin), format!("Bearer {}", guarded.robot));
    let truncated = &admin[..admin.len() - 1];
    for path in methods() {
        for (wrong, says) in [
            (None, "WAYPOST_TOKEN"),
            (Some("Bearer waypost_0"), "ask who runs the server"),
            (Some(truncated), "ask who runs the server"),
            (Some(guarded.admin.as_str()), "WAYPOST_TOKEN"),
        ] {
            let status = call(&channel, &path, wrong).await.expect_err(&path);
            assert_status(&path, (status.code(), status.message()), Code::Unauthenticated, says);
        }
        let for_admins = FOR_ADMINS.contains(&path.as_str());
        match call(&channel, &path, Some(&robot)).await {
            Err(status) if for_admins => {
                let said = (status.code(), status.message());
                assert_status(&path, said, Code::PermissionDenied, "robot is a robot's; ask");
            }
            Ok(()) => assert!(!for_admins, "{path} lets a robot in"),
            Err(status) => assert_let_in(&path, &status),
        }
        if let Err(status) = call(&channel, &path, Some(&admin)).await {
            assert_let_in(&path, &status);
        }
    }
    let known = methods();
    assert!(FOR_ADMINS.iter().all(|path| known.iter().any(|known| known == path)));
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_belongs_to_the_token_that_opened_it() {
    let guarded = Guarded::start().await;
    let (admin, robot) = (guarded.client(&guarded.admin).await, guarded.client(&guarded.robot).await);
    let (_, secret) = admin.create_token("other", v1::token::Role::Robot).await.unwrap();
    let other = guarded.client(&secret).await;
    let looking =
        |name: &str| SessionOptions { mode: v1::SessionMode::Localize, ..session_options("drive", name) };
    answers(&robot, "drive", "tour", (1..=3).map(as_words)).await;
    let (mut sender, mut outcomes) =
        robot.open_session(session_options("drive", "tour")).await.unwrap().split();
    let localizing = robot.open_session(looking("watch")).await.unwrap();
    for options in [session_options("drive", "tour"), looking("watch")] {
        let (code, message) = refused(in_time(other.open_session(options)).await.map(drop));
        assert_status("another's", (code, &message), Code::PermissionDenied, "is of the token robot, which");
    }
    sender.send(frame(4)).await.unwrap();
    match in_time(outcomes.next()).await.unwrap() {
        Some(FrameOutcome::Answer(answer)) => assert_eq!(answer.sequence, 4),
        other => panic!("{other:?}"),
    }
    drop((sender, outcomes, localizing));
    answers(&other, "drive", "round", (1..=2).map(as_words)).await;

    // The robot's next secret goes by the same name, and an admin may go on with all.
    admin.delete_token("robot").await.unwrap();
    let (_, secret) = admin.create_token("robot", v1::token::Role::Robot).await.unwrap();
    answers(&guarded.client(&secret).await, "drive", "tour", (5..=6).map(as_words)).await;
    answers(&admin, "drive", "tour", (7..=8).map(as_words)).await;
    guarded.server.stop().await;
}

/// An empty message may be refused, but not for its token.
#[track_caller]
fn assert_let_in(path: &str, status: &Status) {
    let shut_out = [Code::Unauthenticated, Code::PermissionDenied].contains(&status.code());
    assert!(!shut_out, "{path}: {status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_belongs_to_no_service_of_ours_is_guarded_too() {
    let guarded = Guarded::start().await;
    let channel = channel(&guarded.server.endpoint()).await;
    let (admin, robot) = (format!("Bearer {}", guarded.admin), format!("Bearer {}", guarded.robot));
    let reflection = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";
    let health = "/grpc.health.v1.Health/Check";
    let unknown = "/waypost.v1.MapService/PaintMap";
    let code = async |path: &str, token: Option<&str>| match call(&channel, path, token).await {
        Ok(()) => Code::Ok,
        Err(status) => status.code(),
    };
    assert_eq!(code(health, None).await, Code::Ok);
    assert_eq!(code(health, Some("Bearer waypost_0")).await, Code::Ok);
    assert_eq!(code(reflection, None).await, Code::Unauthenticated);
    // Let in: an empty question is refused for what it is.
    assert_eq!(code(reflection, Some(&robot)).await, Code::InvalidArgument);
    assert_eq!(code(unknown, None).await, Code::Unauthenticated);
    assert_eq!(code(unknown, Some(&robot)).await, Code::PermissionDenied);
    assert_eq!(code(unknown, Some(&admin)).await, Code::Unimplemented);
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_route_asks_for_a_token() {
    let guarded = Guarded::start().await;
    let http = crate::harness::http();
    let get = |path: &str| http.get(guarded.server.url(path));
    for path in OPEN_ROUTES {
        assert_eq!(get(path).send().await.unwrap().status(), StatusCode::OK, "{path}");
        let wrong = get(path).bearer_auth("waypost_0").send().await.unwrap();
        assert_eq!(wrong.status(), StatusCode::OK, "{path}");
    }
    for (method, path, for_admins) in guarded_routes() {
        let ask = |path: &str| http.request(method.clone(), guarded.server.url(path));
        let path = path.as_str();
        let wrong = [
            ask(path),
            ask(path).bearer_auth("waypost_0"),
            ask(path).bearer_auth(""),
            ask(path).basic_auth("me", Some("waypost_0")),
            ask(path).basic_auth(&guarded.admin, None::<&str>),
            ask(path).header("authorization", &guarded.admin),
            ask(&format!("{path}?token={}", guarded.admin)),
        ];
        for request in wrong {
            let response = request.send().await.unwrap();
            assert_eq!(response.status(), StatusCode::UNAUTHORIZED, "{path}");
            let asks: Vec<String> = response
                .headers()
                .get_all("www-authenticate")
                .iter()
                .map(|scheme| scheme.to_str().unwrap().to_owned())
                .collect();
            assert!(asks.iter().any(|scheme| scheme.starts_with("Basic realm=")), "{path}: {asks:?}");
            assert!(asks.iter().any(|scheme| scheme.starts_with("Bearer realm=")), "{path}: {asks:?}");
            let body: serde_json::Value = serde_json::from_str(&response.text().await.unwrap()).unwrap();
            assert_eq!(body["error"]["code"], "unauthenticated");
            assert!(body["error"]["message"].as_str().unwrap().contains("who runs the server"));
        }
        if for_admins {
            let robots = ask(path).bearer_auth(&guarded.robot).send().await.unwrap();
            assert_eq!(robots.status(), StatusCode::FORBIDDEN, "{method} {path}");
        }
        let let_in = if for_admins { vec![&guarded.admin] } else { vec![&guarded.admin, &guarded.robot] };
        for secret in let_in {
            for right in [ask(path).bearer_auth(secret), ask(path).basic_auth("anyone", Some(secret))] {
                let status = right.send().await.unwrap().status();
                let shut_out = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&status);
                assert!(!shut_out && !status.is_server_error(), "{path}: {status}");
            }
        }
    }
    for (path, expected) in [("/v1/maps/drive", StatusCode::OK), ("/v1/nowhere", StatusCode::NOT_FOUND)] {
        let status = get(path).bearer_auth(&guarded.robot).send().await.unwrap().status();
        assert_eq!(status, expected, "{path}");
    }
    guarded.server.stop().await;
}

/// What a browser does for a page whose own name was made to lead to 127.0.0.1.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_a_token_answers_to_no_foreign_name() {
    let (server, client) = Server::with_map().await;
    let http = crate::harness::http();
    let ask = |path: &str, host: &str| http.get(server.url(path)).header("host", host);
    for host in ["rebound.example", "rebound.example:7601"] {
        let refused = ask("/v1/maps", host).send().await.unwrap();
        assert_eq!(refused.status(), StatusCode::FORBIDDEN);
        let body = refused.text().await.unwrap();
        assert!(body.contains("create a token") && !body.contains("drive"), "{body}");
        assert_eq!(ask("/healthz", host).send().await.unwrap().status(), StatusCode::OK);
    }
    assert_eq!(ask("/v1/maps", "localhost:7601").send().await.unwrap().status(), StatusCode::OK);
    // With a token, names are no matter: the caller must hold one.
    let (_, admin) = client.create_token("operator", v1::token::Role::Admin).await.unwrap();
    let admitted = ask("/v1/maps", "waypost.example").bearer_auth(admin).send().await.unwrap();
    assert_eq!(admitted.status(), StatusCode::OK);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_with_its_token() {
    let guarded = Guarded::start().await;
    let robot = guarded.client(&guarded.robot).await;
    let mut session = robot.open_session(session_options("drive", "robot")).await.unwrap();
    session.send(frame(1)).await.unwrap();
    assert!(matches!(in_time(session.next()).await, Ok(Some(FrameOutcome::Answer(_)))));
    let admin = guarded.client(&guarded.admin).await;
    let other = admin.open_session(session_options("drive", "other")).await.unwrap();

    admin.delete_token("robot").await.unwrap();
    let ended = in_time(session.next()).await;
    let Err(Error::Status { code, message }) = ended else { panic!("{ended:?}") };
    assert_status("deleted", (code, &message), Code::Unauthenticated, "was deleted");
    let (code, message) = refused(robot.maps().await);
    assert_status("deleted", (code, &message), Code::Unauthenticated, "not known here");
    // What others do goes on.
    let (mut sender, mut outcomes) = other.split();
    sender.send(frame(2)).await.unwrap();
    assert!(matches!(in_time(outcomes.next()).await, Ok(Some(FrameOutcome::Answer(_)))));
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_token_ends_what_began_without_one() {
    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    raw.answered(wire(frame(1))).await;
    let robot_first = client.create_token("robot", v1::token::Role::Robot).await;
    let (code, message) = refused(robot_first);
    assert_status("first", (code, &message), Code::FailedPrecondition, "the first token must be an admin's");
    raw.answered(wire(frame(2))).await;
    client.create_token("operator", v1::token::Role::Admin).await.unwrap();
    let status = raw.next().await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated, "{status}");
    let (code, _) = refused(client.maps().await);
    assert_eq!(code, Code::Unauthenticated);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_deletes_the_own_token_hears_that_it_is_gone() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    admin.delete_token("robot").await.unwrap();
    admin.delete_token("operator").await.unwrap();
    // It was the last one, and this server listens on loopback alone: everyone is served again.
    let anyone = guarded.server.client().await;
    assert_eq!(anyone.maps().await.unwrap().len(), 1);
    assert_eq!(anyone.tokens().await.unwrap(), []);
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_reconnects_shows_its_token_again() {
    let directory = tempfile::tempdir().unwrap();
    let mut server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let (_, secret) = client.create_token("operator", v1::token::Role::Admin).await.unwrap();
    let proxy = Proxy::start().await;
    proxy.forward_to(Some(server.grpc()));
    let client = Client::connect(ClientOptions::new(proxy.endpoint()).with_token(&secret)).await.unwrap();
    let mut session = client.open_session(session_options("drive", "robot")).await.unwrap();
    for sequence in 1..=4 {
        if sequence == 3 {
            proxy.forward_to(None);
            server.kill();
            server = ServerProcess::start(directory.path());
            proxy.forward_to(Some(server.grpc()));
        }
        session.send(frame(sequence)).await.unwrap();
        match in_time(session.next()).await.unwrap() {
            Some(FrameOutcome::Answer(answer)) => assert_eq!(answer.sequence, sequence),
            other => panic!("frame {sequence}: {other:?}"),
        }
    }
    server.stop();
}

/// Runs a binary; gives its exit code and what it wrote to stdout and stderr.
fn run(binary: &str, arguments: &[&str], environment: &[(&str, &str)]) -> (i32, String, String) {
    let mut command = Built::command(binary);
    command.args(arguments).envs(environment.iter().copied());
    let output = run_to_its_end(command);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_are_looked_after_from_both_command_lines() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().to_str().unwrap();
    let offline = |arguments: &[&str]| {
        run("waypost-server", &[&["token"], arguments, &["--data-dir", data]].concat(), &[])
    };
    let (code, _, stderr) = offline(&["create", "robot", "--role", "robot"]);
    assert!(code == 1 && stderr.contains("the first token must be an admin's"), "{stderr}");
    let (code, admin, stderr) = offline(&["create", "operator", "--role", "admin"]);
    assert!(code == 0 && stderr.contains("note it now"), "{stderr}");
    assert_eq!(admin.lines().count(), 1);
    let admin = admin.trim();
    assert_eq!(offline(&["ls"]), (0, "operator  admin\n".to_owned(), String::new()));

    let server = ServerProcess::start(directory.path());
    let (code, _, stderr) = offline(&["ls"]);
    assert!(code == 1 && stderr.contains("is used by another waypost-server"), "{stderr}");
    let endpoint = server.endpoint();
    let online = |arguments: &[&str], secret: &str| {
        let environment = [("WAYPOST_SERVER", endpoint.as_str()), ("WAYPOST_TOKEN", secret)];
        run("waypost", arguments, &environment)
    };
    let (code, _, stderr) = online(&["map", "ls"], "");
    assert!(code == 4 && stderr.contains("--token or WAYPOST_TOKEN"), "{stderr}");
    let (code, created, _) = online(&["token", "create", "robot", "--role", "robot", "--json"], admin);
    assert_eq!(code, 0);
    let created: serde_json::Value = serde_json::from_str(&created).unwrap();
    assert_eq!(
        (&created["token"]["name"], &created["token"]["role"]),
        (&"tokens/robot".into(), &"robot".into())
    );
    let robot = created["secret"].as_str().unwrap();
    assert_eq!(online(&["map", "ls"], robot).0, 0);
    let (code, _, stderr) = online(&["token", "ls"], robot);
    assert!(code == 4 && stderr.contains("takes the token of an admin"), "{stderr}");
    let (code, listed, _) = online(&["token", "ls", "--token", admin], robot);
    assert_eq!(
        (code, listed.as_str()),
        (
            0,
            "TOKEN     ROLE   MAY                                  MAPS  EXPIRES  QUOTAS\n\
             operator  admin  read,localize,stream,navigate,admin  all   never    none\n\
             robot     robot  read,localize,stream,navigate        all   never    none\n"
        )
    );
    let (code, _, stderr) = online(&["token", "rm", "operator", "--yes"], admin);
    assert!(code == 4 && stderr.contains("create another admin token first"), "{stderr}");
    assert_eq!(online(&["token", "rm", "robot", "--yes"], admin).0, 0);
    assert_eq!(online(&["map", "ls"], robot).0, 4);
    assert!(!server.log().contains(admin) && !server.log().contains(robot), "a secret is in the log");
    server.stop();
    let (code, _, stderr) = offline(&["rm", "nobody"]);
    assert!(code == 1 && stderr.contains("there is no token nobody"), "{stderr}");
    let told = "deleted operator\nno token is left: who reaches the server may do everything\n";
    assert_eq!(offline(&["rm", "operator"]), (0, String::new(), told.to_owned()));
}
