//! What whoever looks after several servers hears of them.

use std::time::Duration;

use sqlx::AssertSqlSafe;
use waypost_client::{Code, v1};
use waypost_proto::v1::cluster_server::Role;

use super::any_server::is_refused;
use super::owners::{beside_others, owner, prepared};
use crate::harness::{Cluster, ServerProcess, answers, frame, http, in_time};

/// Each server says the same: who owns the database, who is in reserve, and what they have done. One of another version
/// is listed and not asked; one that has gone is, until the owner is another.
#[tokio::test(flavor = "multi_thread")]
async fn every_server_tells_of_all() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "told").await;
    let (first, _first_directory) = owner(&database.url()).await;
    let (second, _second_directory) = beside_others(&database.url());
    let client = second.client().await;
    answers(&client, "drive", "robot", (1..=5).map(frame)).await;
    let mut connection = database.connect().await;
    let older = "INSERT INTO helpers (holder, version, address, cores, seen) \
         VALUES ('attic', '0.0.9', 'attic:7601', 4, now() - interval '20 seconds')";
    sqlx::query(AssertSqlSafe(older)).execute(&mut connection).await.unwrap();
    let told = in_time(async {
        loop {
            let told = client.cluster().await.unwrap();
            if told.servers.len() == 3 {
                return told;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
    assert_eq!((told.database(), told.epoch), (v1::cluster::Database::Postgres, Some(2)));
    let of = |server: &v1::ClusterServer| {
        (server.role(), server.grpc_address.clone(), server.http_address.clone())
    };
    let at = |role, server: &ServerProcess| (role, server.grpc().to_string(), server.http().to_string());
    assert_eq!(of(&told.servers[0]), at(Role::Owner, &first));
    assert_eq!(of(&told.servers[1]), at(Role::Reserve, &second));
    assert_eq!(of(&told.servers[2]), (Role::Reserve, String::new(), "attic:7601".to_owned()));
    let [own, helped, attic] = [0, 1, 2].map(|server| told.servers[server].images);
    assert_eq!(own.unwrap() + helped.unwrap_or_default(), 5, "{told:?}");
    assert_eq!(attic, None);
    assert!(told.servers[0].silent_s < 3.0 && told.servers[1].silent_s < 3.0, "{told:?}");
    assert!(told.servers[2].silent_s >= 20.0, "{told:?}");
    assert_eq!(
        (told.servers[0].version.as_str(), told.servers[2].version.as_str()),
        (env!("CARGO_PKG_VERSION"), "0.0.9")
    );
    assert_eq!(told.load.unwrap().open_maps, 1);
    let metrics =
        http().get(format!("http://{}/metrics", first.http())).send().await.unwrap().text().await.unwrap();
    assert!(metrics.contains("\nwaypost_database_epoch 2\n"), "{metrics}");
    assert!(
        metrics.contains("\nwaypost_standbys 0\n") && metrics.contains("\nwaypost_standby_lag_bytes NaN\n"),
        "{metrics}"
    );

    first.kill();
    let told = in_time(async {
        loop {
            // Nobody owns the database for a moment.
            match client.cluster().await {
                Ok(told) => return told,
                Err(refused) => is_refused(Err::<(), _>(refused), Code::Unavailable, "in a moment"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
    assert_eq!(told.epoch, Some(3));
    assert_eq!(of(&told.servers[0]), at(Role::Owner, &second));
    assert_eq!(told.servers.len(), 2, "{told:?}");
    assert!(told.servers[1..].iter().all(|server| server.holder == "attic"), "{told:?}");
}
