//! What the REST API says of itself is what it does.

mod calls;
mod writes;

use jsonschema::Validator;
use reqwest::StatusCode;
use serde_json::{Value, json};
use waypost_client::{Client, ClientOptions, v1};

use self::calls::{Call, bad_calls, good_calls};
use self::writes::{bad_writes, good_writes};
use crate::harness::{Answer, Server, Surveyed, found, get, http, images, led, taught_hall, workspace};

/// Writes the description anew when it is set.
const RENEW: &str = "RENEW_OPENAPI";

#[tokio::test(flavor = "multi_thread")]
async fn the_description_is_the_one_that_is_checked_in() {
    let server = Server::start().await;
    let served = get(&server, "/v1/openapi.json").await;
    let file = workspace().join("server/openapi.json");
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(&file, served.text()).unwrap();
    }
    let kept = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(
        kept == served.text(),
        "server/openapi.json is out of date; run {RENEW}=1 cargo test --release -p waypost-e2e openapi:: and read \
         what has changed: clients depend on it"
    );
    server.stop().await;
}

/// The description, with its objects closed: an answer must not have what is not described.
struct Description {
    document: Value,
}

impl Description {
    async fn of(server: &Server) -> Self {
        let mut document = found(server, "/v1/openapi.json").await;
        let schemas = document["components"]["schemas"].as_object_mut().unwrap();
        for schema in schemas.values_mut().filter(|schema| schema["type"] == "object") {
            schema["additionalProperties"] = json!(false);
        }
        Self { document }
    }

    /// Method and path of every operation.
    fn operations(&self) -> Vec<(&'static str, &str)> {
        let mut operations = Vec::new();
        for (path, methods) in self.document["paths"].as_object().unwrap() {
            for method in methods.as_object().unwrap().keys() {
                let known =
                    ["get", "post", "put", "patch", "delete"].into_iter().find(|known| known == method);
                operations.push((known.expect("a method that this test can call"), path.as_str()));
            }
        }
        operations
    }

    /// What is said of an answer with this status.
    fn response(&self, call: &Call, status: StatusCode) -> &Value {
        let said = &self.document["paths"][&call.path][call.method]["responses"][status.as_str()];
        assert!(said.is_object(), "{} {} is not said to answer {status}", call.method, call.path);
        match said["$ref"].as_str() {
            Some(reference) => self.document.pointer(reference.strip_prefix('#').unwrap()).unwrap(),
            None => said,
        }
    }

    fn validator(&self, schema: &Value) -> Validator {
        let mut root = schema.clone();
        root["components"] = self.document["components"].clone();
        jsonschema::draft202012::new(&root).unwrap()
    }

    /// Whether an answer is as described; gives what it was checked by, if it is JSON.
    fn check(&self, call: &Call, status: StatusCode, answer: &Answer) -> Option<Validator> {
        let Call { asked, .. } = call;
        assert_eq!(answer.status, status, "{asked}: {}", String::from_utf8_lossy(&answer.body));
        let kind = answer.header("content-type").split(';').next().unwrap();
        let content = &self.response(call, status)["content"][kind];
        assert!(content["schema"].is_object(), "{asked}: {kind} is not described");
        if !["application/json", "application/problem+json"].contains(&kind) {
            return None;
        }
        let (validator, value) = (self.validator(&content["schema"]), answer.json());
        let wrong: Vec<String> = validator
            .iter_errors(&value)
            .map(|error| format!("{}: {error}", error.instance_path()))
            .collect();
        assert!(wrong.is_empty(), "{asked} is not as described:\n{}\n{value:#}", wrong.join("\n"));
        Some(validator)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_answer_is_as_described() {
    let surveyed = Surveyed::start().await;
    let description = Description::of(&surveyed.server).await;
    let client = surveyed.server.client().await;
    let mut snapshot = Vec::new();
    client.export_map("empty", &mut snapshot).await.unwrap();
    // The first token would end what was begun without one.
    let (_, admin) = client.create_token("operator", v1::token::Role::Admin).await.unwrap();
    let options = ClientOptions::new(surveyed.server.endpoint()).with_token(&admin);
    let client = Client::connect(options).await.unwrap();
    let _led = led(&client).await;
    let model = client.model("shipped").await.unwrap();
    taught_hall(&client, &model.name).await;
    // It is taken away before it is set.
    client.set_label("maps/looks/places/0", "hall", v1::LabelScope::Place).await.unwrap();
    let mut calls = good_calls(&surveyed);
    calls.extend(good_writes(&surveyed, snapshot));
    for (method, path) in description.operations() {
        let described: Vec<&Call> =
            calls.iter().filter(|call| call.method == method && call.path == path).collect();
        assert!(!described.is_empty(), "{method} {path} is called by no test: say with which parameters");
        for call in described {
            let answer = call.answer(&surveyed.server, Some(&admin)).await;
            if let Some(validator) = description.check(call, StatusCode::OK, &answer) {
                assert_strict(&validator, &call.asked, &answer.json());
            }
        }
    }
    for call in &calls {
        assert!(
            description.operations().contains(&(call.method, call.path.as_str())),
            "{} is not described",
            call.path
        );
    }
    surveyed.server.stop().await;
}

/// A field less, or one more, is no longer as described.
#[track_caller]
fn assert_strict(validator: &Validator, asked: &str, answer: &Value) {
    let Some(fields) = answer.as_object() else { return };
    for field in fields.keys() {
        let mut less = answer.clone();
        less.as_object_mut().unwrap().remove(field);
        assert!(!validator.is_valid(&less), "{asked}: the description does not ask for {field}");
    }
    let mut more = answer.clone();
    more["unheard_of"] = json!(1);
    assert!(!validator.is_valid(&more), "{asked}: the description takes anything");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_refusal_is_as_described() {
    let (server, _client) = Server::with_map().await;
    let description = Description::of(&server).await;
    let operations = description.operations();
    assert!(operations.len() >= 20, "{operations:?}");
    for (method, path) in operations {
        for (status, call) in bad_calls(method, path) {
            let answer = call.answer(&server, None).await;
            assert!(description.check(&call, status, &answer).is_some(), "{}: no JSON", call.asked);
        }
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_described_is_described_well() {
    let server = Server::start().await;
    let description = Description::of(&server).await;
    let examples = check_examples(&description, &description.document);
    assert!(examples >= 10, "only {examples} examples");
    for (method, path) in description.operations() {
        let operation = &description.document["paths"][path][method];
        assert!(operation["summary"].as_str().is_some_and(|said| said.len() > 5), "{method} {path}");
        for parameter in operation["parameters"].as_array().into_iter().flatten() {
            assert!(parameter["description"].is_string(), "{method} {path}: {}", parameter["name"]);
        }
        let variables = path.matches('{').count();
        let declared = operation["parameters"].as_array().into_iter().flatten();
        assert_eq!(declared.filter(|parameter| parameter["in"] == "path").count(), variables, "{path}");
    }
    server.stop().await;
}

/// Checks all examples within a value of the description by the schema that they belong to; how many there were.
fn check_examples(description: &Description, value: &Value) -> usize {
    let mut checked = 0;
    if let Some(example) = value.get("example") {
        let schema = value.get("schema").unwrap_or(value);
        assert!(description.validator(schema).is_valid(example), "{example} is no example of {schema:#}");
        checked += 1;
    }
    match value {
        Value::Object(fields) => {
            let within = fields.iter().filter(|(name, _)| *name != "example");
            checked + within.map(|(_, value)| check_examples(description, value)).sum::<usize>()
        }
        Value::Array(values) => {
            checked + values.iter().map(|value| check_examples(description, value)).sum::<usize>()
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => checked,
    }
}
