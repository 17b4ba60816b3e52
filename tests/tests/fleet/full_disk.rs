//! The database's disk is full: frames wait, nothing is lost, and space heals it.

use std::time::Duration;

use super::owners::is_whole;
use super::standbys::Fleet;
use crate::harness::{Machines, SmallDisk, answers, frame, import_model, in_time, map_request};

/// Of a new database of PostgreSQL, its log of writes, and a map: 60 MiB.
const DISK_MIB: u32 = 160;

/// In a round, sent while the disk is full.
const FRAMES: u64 = 8;

/// A robot at a server in reserve, while the disk of the database is full, is freed, and the database dies meanwhile, too.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_of_the_database_loses_nothing() {
    let Some(disk) = SmallDisk::mount(DISK_MIB) else { return };
    std::fs::create_dir(disk.folder()).unwrap();
    let Some(machines) = Machines::alone(&disk.folder()) else { return };
    let fleet = Fleet::start(&machines.database("on_a_small_disk").await, 2);
    let owner = fleet.owner().await;
    let client = fleet.client_in_time(1 - owner).await;
    let model = import_model(&client).await.name;
    client.create_map(map_request("drive", &model)).await.unwrap();
    answers(&client, "drive", "robot", (1..=FRAMES).map(frame)).await;
    for round in 1..=3 {
        let told_before = told_of_full_disks(&fleet);
        disk.fill();
        let streaming = tokio::spawn({
            let client = client.clone();
            let frames = FRAMES * round + 1..=FRAMES * (round + 1);
            async move { answers(&client, "drive", "robot", frames.map(frame)).await.len() }
        });
        in_time(async {
            // It may die of it, where it cannot even write its log.
            while told_of_full_disks(&fleet) == told_before && machines.answers(machines.primary) {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        })
        .await;
        assert!(!streaming.is_finished(), "a full disk took {FRAMES} frames");
        if round == 2 && machines.answers(machines.primary) {
            machines.kill_primary();
        }
        disk.free();
        if !machines.answers(machines.primary) {
            machines.start_again(machines.primary);
        }
        assert_eq!(in_time(streaming).await.unwrap(), FRAMES as usize, "round {round}");
    }
    for server in 0..2 {
        is_whole(&fleet.client_in_time(server).await, FRAMES * 4).await;
    }
}

/// How often servers said that the disk is full.
fn told_of_full_disks(fleet: &Fleet) -> usize {
    (0..2).map(|server| fleet.log(server).matches("disk full").count()).sum()
}
