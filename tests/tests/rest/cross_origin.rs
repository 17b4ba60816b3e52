//! Pages of other origins: none may ask, but those that the setting `cors_origins` names.

use reqwest::{Method, RequestBuilder, StatusCode};
use serde_json::json;
use waypost_client::v1;

use crate::harness::{Answer, Built, Server, ServerProcess, http, run_to_its_end};

const FLEET: &str = "https://fleet.example";

fn of(origin: &str, request: RequestBuilder) -> RequestBuilder {
    request.header("origin", origin).header("sec-fetch-site", "cross-site")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_listed_page_may_ask_and_read_and_others_may_not() {
    let directory = tempfile::tempdir().unwrap();
    let server =
        Server::start_as(directory.path(), |server| server.with_cors_origins(vec![FLEET.parse().unwrap()]))
            .await;
    let preflight = |origin: &str, method: &str| {
        let asked = http().request(Method::OPTIONS, server.url("/v1/tokens"));
        let asked = of(origin, asked).header("access-control-request-method", method);
        Answer::to(asked.header("access-control-request-headers", "authorization,content-type"))
    };
    let allowed = preflight(FLEET, "POST").await;
    assert_eq!((allowed.status, allowed.header("access-control-allow-origin")), (StatusCode::OK, FLEET));
    assert!(allowed.header("access-control-allow-methods").contains("DELETE"));
    assert!(allowed.header("access-control-allow-headers").contains("authorization"));
    assert!(allowed.header("access-control-allow-credentials").is_empty(), "passwords would go along");
    let other = preflight("https://evil.example", "POST").await;
    assert!(other.header("access-control-allow-origin").is_empty(), "{:?}", other.headers);

    // Without tokens, the page makes the first one; a page that is not listed does not.
    let body = json!({ "token_id": "operator", "role": "admin" });
    let create = || http().post(server.url("/v1/tokens")).json(&body);
    let refused = Answer::to(of("https://evil.example", create())).await;
    assert_eq!(refused.status, StatusCode::FORBIDDEN, "{}", refused.text());
    assert!(refused.text().contains("cors_origins"), "{}", refused.text());
    let remembered = Answer::to(of(FLEET, create()).basic_auth("me", Some("remembered"))).await;
    assert_eq!(remembered.status, StatusCode::FORBIDDEN, "{}", remembered.text());
    let made = Answer::to(of(FLEET, create())).await;
    assert_eq!(made.status, StatusCode::OK, "{}", made.text());
    let secret = made.json()["secret"].as_str().unwrap().to_owned();

    let list = || of(FLEET, http().get(server.url("/v1/tokens")));
    let read = Answer::to(list().bearer_auth(&secret)).await;
    assert_eq!((read.status, read.header("access-control-allow-origin")), (StatusCode::OK, FLEET));
    assert!(read.header("access-control-expose-headers").contains("x-request-id"), "{:?}", read.headers);
    // What is refused can be read, too: the page tells its user why.
    let unknown = Answer::to(list()).await;
    assert_eq!(
        (unknown.status, unknown.header("access-control-allow-origin")),
        (StatusCode::UNAUTHORIZED, FLEET)
    );
    assert_eq!(unknown.json()["status"], 401);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn origins_are_set_by_a_flag_and_wrong_ones_stop_the_start() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start_with(
        directory.path(),
        &["--cors-origins", "http://127.0.0.1:8080,https://fleet.example:443"],
    );
    let client = server.client().await;
    let (_, secret) = client.create_token("operator", v1::token::Role::Admin).await.unwrap();
    for origin in ["http://127.0.0.1:8080", FLEET] {
        let maps = http().get(format!("http://{}/v1/maps", server.http()));
        let answer = Answer::to(of(origin, maps).bearer_auth(&secret)).await;
        assert_eq!((answer.status, answer.header("access-control-allow-origin")), (StatusCode::OK, origin));
    }
    server.stop();

    let mut command = Built::command("waypost-server");
    command.arg("--data-dir").arg(directory.path()).args(["--cors-origins", "https://fleet.example/page"]);
    let ended = run_to_its_end(command);
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success() && said.contains("without a path or a slash"), "{said}");
}
