//! What panoramas have in common is kept, so that a map opens without comparing them anew; and only as long as it holds.

use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use sqlx::sqlite::SqliteConnection;
use sqlx::{ConnectOptions, Connection, Row};
use waypost_client::v1;

use crate::harness::{Panoramas, Server, database_options, found, import_model, in_time};

/// From one room through the hall into another.
const WAY: [&[[f64; 2]]; 1] = [&[[5.0, 4.5], [5.0, 0.8], [9.2, 0.8], [9.2, 3.5], [7.1, 3.5]]];

const GRAPH: &str = "/v1/maps/looks/appearance-graph";

async fn database(directory: &Path) -> SqliteConnection {
    database_options(directory).connect().await.unwrap()
}

async fn links_on_disk(database: &mut SqliteConnection) -> Vec<(u32, u32, f64)> {
    let select = "SELECT earlier, place, similarity FROM appearance_links ORDER BY earlier, place";
    let rows = sqlx::query(select).fetch_all(database).await.unwrap();
    rows.iter().map(|row| (row.get(0), row.get(1), row.get(2))).collect()
}

/// Places below have their links on the disk, by the rules of this number.
async fn kept(database: &mut SqliteConnection) -> Option<(u32, u32)> {
    let row = sqlx::query("SELECT next_place, rules FROM appearance_graphs")
        .fetch_optional(database)
        .await
        .unwrap();
    row.map(|row| (row.get(0), row.get(1)))
}

/// Links by the earlier place, then by the later one.
fn links_of(graph: &Value) -> Vec<(u32, u32, f64)> {
    let links = graph["links"].as_array().unwrap().iter();
    let place = |link: &Value, end: &str| link[end].as_u64().unwrap() as u32;
    let mut links: Vec<_> = links
        .map(|link| {
            (
                place(link, "from_place_number"),
                place(link, "to_place_number"),
                link["similarity"].as_f64().unwrap(),
            )
        })
        .collect();
    links.sort_by_key(|&(earlier, later, _)| (earlier, later));
    links
}

async fn graph_of_a_new_server(directory: &Path) -> Value {
    let server = Server::start_on(directory).await;
    let graph = found(&server, GRAPH).await;
    server.stop().await;
    graph
}

#[tokio::test(flavor = "multi_thread")]
async fn links_are_kept_as_long_as_they_hold() {
    let panoramas = Panoramas::new();
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let taught = panoramas.teach(&client, ("looks", &model.name), &WAY).await;
    let graph = found(&server, GRAPH).await;
    drop(client);
    server.stop().await;

    // What is on the disk is what the graph says of these places.
    let mut at_rest = database(directory.path()).await;
    let (next_place, rules) = kept(&mut at_rest).await.unwrap();
    assert!((16..=taught.len() as u32).contains(&next_place), "{next_place} of {}", taught.len());
    let mut links = links_of(&graph);
    links.retain(|&(_, later, _)| later < next_place);
    assert!(links.len() > 16, "{links:?}");
    assert_eq!(links_on_disk(&mut at_rest).await, links);

    // A map that is opened takes it from there: a link that was altered on the disk shows.
    let (earlier, later, similarity) = links[links.len() / 2];
    let altered = 0.123_456;
    let update = "UPDATE appearance_links SET similarity = ? WHERE earlier = ? AND place = ?";
    sqlx::query(update).bind(altered).bind(earlier).bind(later).execute(&mut at_rest).await.unwrap();
    at_rest.close().await.unwrap();
    let mut expected = links_of(&graph);
    for link in &mut expected {
        if *link == (earlier, later, similarity) {
            link.2 = altered;
        }
    }
    assert_eq!(links_of(&graph_of_a_new_server(directory.path()).await), expected);

    // What other rules found is found anew, and kept in its place.
    let mut at_rest = database(directory.path()).await;
    sqlx::query("UPDATE appearance_graphs SET rules = rules + 1").execute(&mut at_rest).await.unwrap();
    at_rest.close().await.unwrap();
    assert_eq!(graph_of_a_new_server(directory.path()).await, graph);
    let mut at_rest = database(directory.path()).await;
    assert_eq!(kept(&mut at_rest).await, Some((taught.len() as u32, rules)));
    assert_eq!(links_on_disk(&mut at_rest).await, links_of(&graph));
    at_rest.close().await.unwrap();

    // Places that are numbered anew have other links.
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(found(&server, GRAPH).await, graph);
    let trim = v1::TrimMapRequest {
        name: "maps/looks".to_owned(),
        max_places: taught.len() as u32 - 4,
        mode: v1::trim_map_request::Mode::Apply.into(),
    };
    let trimmed = client.trim_map(trim).await.unwrap();
    let mut dropped: Vec<u32> = trimmed.dropped.iter().map(|dropped| dropped.place_number).collect();
    dropped.sort_unstable();
    assert_eq!((dropped.len(), trimmed.excess_places), (4, 0), "{trimmed:?}");
    let left = |place: u32| dropped.binary_search(&place).err().map(|before| place - before as u32);
    let expected: Vec<_> = links_of(&graph)
        .iter()
        .filter_map(|&(a, b, similarity)| Some((left(a)?, left(b)?, similarity)))
        .collect();
    assert!(expected.len() < links_of(&graph).len());
    let graph = found(&server, GRAPH).await;
    assert_eq!(links_of(&graph), expected);
    drop(client);
    server.stop().await;
    assert_eq!(graph_of_a_new_server(directory.path()).await, graph);

    // And nothing of a map that was deleted stays, once the server has come to it.
    let server = Server::start_on(directory.path()).await;
    server.client().await.delete_map("looks").await.unwrap();
    let mut served = database(directory.path()).await;
    let gone = async {
        while kept(&mut served).await.is_some() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    in_time(gone).await;
    assert_eq!(links_on_disk(&mut served).await, Vec::new());
    served.close().await.unwrap();
    server.stop().await;
}
