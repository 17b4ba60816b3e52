//! Servers in reserve look at images for the owner of the database.

use std::time::Duration;

use waypost_client::v1;

use super::owners::{FRAMES, beside_others, owner, prepared};
use crate::harness::{
    Answer, Cluster, Panoramas, ServerProcess, answers, frame, http, in_time, map_request, reference,
};

/// Robots send more images than the owner has cores for: another server looks at some of them, and nothing is decided
/// otherwise. That server dies under its work.
#[tokio::test(flavor = "multi_thread")]
async fn servers_in_reserve_look_at_images_and_may_die() {
    const ROBOTS: usize = 4;
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "helped").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let client = first.client().await;
    let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
    let (helper, _helper_directory) = beside_others(&database.url());
    until_helped(&first, true).await;
    let mut helped = Vec::new();
    for (round, helper) in [None, Some(helper)].into_iter().enumerate() {
        let robots = (0..ROBOTS).map(async |robot| {
            let map = format!("round-{round}-{robot}");
            client.create_map(map_request(&map, &model)).await.unwrap();
            answers(&client, &map, "robot", (1..=FRAMES).map(frame)).await;
            let there = client.map(&map, v1::MapView::Full).await.unwrap();
            assert_eq!(there.state_hash, Some(reference().maps[FRAMES as usize].state_hash.clone()));
        });
        let dying = async {
            tokio::time::sleep(Duration::from_millis(500)).await;
            if let Some(helper) = helper {
                helper.kill();
            }
        };
        tokio::join!(futures::future::join_all(robots), dying);
        helped.push(helped_images(&metrics_of(&first).await));
    }
    assert!(helped[0] > 10 && helped[1] >= helped[0], "{helped:?} images were looked at elsewhere");
    until_helped(&first, false).await;
    // It is asked nothing more from the first failure on, and gone once it has been silent for a while.
    in_time(async {
        while !first.log().contains("looks at no more images") {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
}

/// So they do at panoramas, whose camera goes with them.
#[tokio::test(flavor = "multi_thread")]
async fn servers_in_reserve_look_at_panoramas() {
    const HALL: [[f64; 2]; 2] = [[9.2, 2.0], [9.2, 5.0]];
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "panoramas").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let client = first.client().await;
    let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
    let panoramas = Panoramas::new();
    let state = async |map: &str| client.map(map, v1::MapView::Full).await.unwrap().state_hash.unwrap();
    assert!(panoramas.teach(&client, ("alone", &model), &[&HALL]).await.len() > 3);
    let alone = state("alone").await;
    let (_helper, _helper_directory) = beside_others(&database.url());
    until_helped(&first, true).await;
    let maps = ["one", "two", "three", "four"];
    futures::future::join_all(maps.map(async |map| {
        panoramas.teach(&client, (map, &model), &[&HALL]).await;
    }))
    .await;
    for map in maps {
        assert_eq!(state(map).await, alone, "{map}");
    }
    assert!(helped_images(&metrics_of(&first).await) > 0);
}

/// Waits until an owner has helpers, or none.
async fn until_helped(owner: &ServerProcess, helped: bool) {
    in_time(async {
        while metrics_of(owner).await.contains("waypost_helper_cores 0") == helped {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
}

async fn metrics_of(server: &ServerProcess) -> String {
    Answer::to(http().get(format!("http://{}/metrics", server.http()))).await.text().to_owned()
}

fn helped_images(metrics: &str) -> u64 {
    let line = metrics.lines().find_map(|line| line.strip_prefix("waypost_helped_images_total "));
    line.and_then(|count| count.parse().ok()).expect("it is counted")
}
