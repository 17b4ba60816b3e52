//! A database on three machines, whose primary dies: a standby takes over, and what was acknowledged is there.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Pid, Signal, kill_process};
use waypost_client::{Client, FrameInput, FrameOutcome, SessionOptions, v1};

use super::owners::{beside_others, ends, is_whole, until_it_owns};
use crate::harness::{
    Machines, Reference, ServerProcess, answers, as_histogram, as_words, by_words_request, frame, http,
    import_model, in_time, map_request, reference, reference_by_words, session_options, state_hash,
    words_options,
};

/// Of each robot in one round.
const FRAMES: u64 = 40;
const BETWEEN_FRAMES: Duration = Duration::from_millis(100);

/// Longer than the last owner is waited for.
const LEASE: Duration = Duration::from_secs(6);

/// A number from the environment. Rounds of other seeds add up.
pub(super) fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().expect("a number"))
}

/// Servers over one database, and where they keep what need not last.
pub(super) struct Fleet {
    url: String,
    servers: Mutex<Vec<(ServerProcess, tempfile::TempDir)>>,
}

impl Fleet {
    pub(super) fn start(url: &str, servers: usize) -> Self {
        let servers = (0..servers).map(|_| beside_others(url)).collect();
        Self { url: url.to_owned(), servers: Mutex::new(servers) }
    }

    pub(super) fn endpoint(&self, server: usize) -> String {
        self.servers.lock().unwrap()[server].0.endpoint()
    }

    pub(super) fn log(&self, server: usize) -> String {
        self.servers.lock().unwrap()[server].0.log()
    }

    pub(super) fn signal(&self, server: usize, signal: Signal) {
        let server = Pid::from_child(self.servers.lock().unwrap()[server].0.child());
        kill_process(server, signal).unwrap();
    }

    /// One dies, unless it has, and another is started.
    pub(super) fn replace(&self, server: usize) {
        self.servers.lock().unwrap()[server] = beside_others(&self.url);
    }

    /// The one that owns the database.
    pub(super) async fn owner(&self) -> usize {
        in_time(async {
            loop {
                let urls: Vec<String> = {
                    let servers = self.servers.lock().unwrap();
                    servers.iter().map(|(server, _)| format!("http://{}/metrics", server.http())).collect()
                };
                for (server, url) in urls.iter().enumerate() {
                    // One that changes its part, or has ended, does not answer.
                    let Ok(answer) = http().get(url).send().await else { continue };
                    if answer.text().await.is_ok_and(|text| text.contains("\nwaypost_owns_database 1\n")) {
                        return server;
                    }
                }
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        })
        .await
    }

    async fn client(&self, server: usize) -> Client {
        Client::connect(&self.endpoint(server)).await.unwrap()
    }

    /// A client of a server, once that answers.
    pub(super) async fn client_in_time(&self, server: usize) -> Client {
        let client = self.client(server).await;
        in_time(async {
            while client.maps().await.is_err() {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        })
        .await;
        client
    }
}

/// Streams frames one after another; the longest that one was waited for.
async fn paced(client: Client, options: SessionOptions, frame: fn(u64) -> FrameInput) -> Duration {
    let (mut sender, mut outcomes) = client.open_session(options).await.unwrap().split();
    let mut longest = Duration::ZERO;
    for sequence in 1..=FRAMES {
        let sent = Instant::now();
        sender.send(frame(sequence)).await.unwrap();
        match in_time(outcomes.next()).await.unwrap() {
            Some(FrameOutcome::Answer(answer)) => assert_eq!(answer.sequence, sequence),
            other => panic!("frame {sequence}: {other:?}"),
        }
        longest = longest.max(sent.elapsed());
        tokio::time::sleep(BETWEEN_FRAMES).await;
    }
    longest
}

async fn holds(client: &Client, map: &str, reference: &Reference) {
    let found = client.map(map, v1::MapView::Full).await.unwrap();
    assert_eq!(found.frames, FRAMES, "{map}");
    assert_eq!(found.state_hash.as_ref(), Some(&reference.maps[FRAMES as usize].state_hash), "{map}");
}

/// Robots with images and with words, each at a server of its own, while primaries die, and a server with every other one.
#[tokio::test(flavor = "multi_thread")]
async fn a_machine_that_takes_over_has_what_was_acknowledged() {
    let Some(mut machines) = Machines::start().await else { return };
    let (rounds, seed) = (number("WAYPOST_TEST_PROMOTIONS", 2), number("WAYPOST_TEST_PROMOTIONS_SEED", 1));
    let fleet = Fleet::start(&machines.database("promotions").await, 3);
    let model = import_model(&fleet.client_in_time(0).await).await.name;
    for round in 0..rounds {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(round);
        let [images, words] = ["images", "words"].map(|kind| format!("{kind}-{round}"));
        let operator = fleet.client_in_time(0).await;
        operator.create_map(map_request(&images, &model)).await.unwrap();
        operator.create_map(by_words_request(&words, &model)).await.unwrap();
        // The server that dies is never one that a robot was told of.
        let [seer, reader] = [fleet.client_in_time(1).await, fleet.client_in_time(2).await];
        let seeing = tokio::spawn(paced(seer, session_options(&images, "robot"), frame));
        let reading = tokio::spawn(paced(reader, words_options(&words, "robot"), as_histogram));
        let cluster = operator.cluster().await.unwrap();
        let standby = |standby: &v1::Standby| (standby.sync_state.clone(), standby.lag_bytes.is_some());
        let standbys: Vec<_> = cluster.standbys.iter().map(standby).collect();
        assert_eq!(standbys, [("quorum".to_owned(), true), ("quorum".to_owned(), true)], "{cluster:?}");
        in_time(async {
            // Each that lives is there once; one that was killed is listed for a while.
            let lives = |server: &&v1::ClusterServer| server.silent_s < 3.0;
            while operator.cluster().await.unwrap().servers.iter().filter(lives).count() != 3 {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        })
        .await;
        tokio::time::sleep(BETWEEN_FRAMES * random.random_range(1..FRAMES as u32)).await;
        let dead = machines.kill_primary();
        let with_a_server = round % 2 == 1;
        if with_a_server {
            fleet.signal(0, Signal::KILL);
        }
        tokio::time::sleep(Duration::from_millis(random.random_range(0..1500))).await;
        machines.promote().await;
        if with_a_server {
            fleet.replace(0);
        }
        machines.rejoin(dead).await;
        let longest = [seeing.await.unwrap(), reading.await.unwrap()];
        for server in 0..3 {
            let client = fleet.client_in_time(server).await;
            holds(&client, &images, reference()).await;
            holds(&client, &words, reference_by_words()).await;
        }
        eprintln!("round {round} of seed {seed}: the longest that a frame was waited for: {longest:.1?}");
    }
}

/// Nobody but the primary has a transaction: it does not count, and nobody is told that it does.
#[tokio::test(flavor = "multi_thread")]
async fn without_a_standby_nothing_is_acknowledged() {
    let Some(mut machines) = Machines::start().await else { return };
    let fleet = Fleet::start(&machines.database("no_standby").await, 1);
    let client = fleet.client_in_time(0).await;
    let model = import_model(&client).await.name;
    client.create_map(map_request("drive", &model)).await.unwrap();
    answers(&client, "drive", "robot", (1..=5).map(as_words)).await;
    for standby in machines.standbys() {
        machines.stop(standby);
    }
    let waiting = tokio::spawn({
        let client = client.clone();
        async move { answers(&client, "drive", "robot", (6..=10).map(as_words)).await.len() }
    });
    tokio::time::sleep(2 * LEASE).await;
    assert!(!waiting.is_finished(), "a frame was acknowledged that one machine has");
    assert!(fleet.log(0).contains("out of reach for too long"), "{}", fleet.log(0));
    for standby in machines.standbys() {
        machines.start_again(standby);
    }
    assert_eq!(waiting.await.unwrap(), 5);
    machines.kill_primary();
    machines.promote().await;
    is_whole(&fleet.client_in_time(0).await, 10).await;
}

/// A machine that was the primary comes back as it was, and takes writes: none are sent there.
#[tokio::test(flavor = "multi_thread")]
async fn a_primary_of_yesterday_is_not_written_to() {
    let Some(mut machines) = Machines::start().await else { return };
    let url = machines.database("yesterday").await;
    let fleet = Fleet::start(&url, 1);
    let client = fleet.client_in_time(0).await;
    let model = import_model(&client).await.name;
    client.create_map(map_request("drive", &model)).await.unwrap();
    answers(&client, "drive", "robot", (1..=5).map(as_words)).await;
    let dead = machines.kill_primary();
    machines.promote().await;
    answers(&fleet.client_in_time(0).await, "drive", "robot", (6..=10).map(as_words)).await;
    machines.start_again(dead);
    fleet.replace(0);
    let client = fleet.client_in_time(0).await;
    is_whole(&client, 10).await;
    assert!(fleet.log(0).contains("two machines of the database take writes"), "{}", fleet.log(0));
    answers(&client, "drive", "robot", (11..=15).map(as_words)).await;
    assert_eq!(state_hash(&client, "drive").await, reference().maps[15].state_hash);
}

#[tokio::test(flavor = "multi_thread")]
async fn machines_that_take_no_writes_are_said_to() {
    let Some(machines) = Machines::start().await else { return };
    let url = machines.database("standby_alone").await;
    let [standby, other] = machines.standbys();
    let alone = machines.url(&[standby], "standby_alone");
    let both = machines.url(&[standby, other], "standby_alone");
    machines.stop(other);
    for (url, says) in [
        (alone.as_str(), "the database is a standby, which takes no writes"),
        (both.as_str(), "no machine of the database takes writes: "),
        (both.as_str(), "see that one is the primary"),
        (both.as_str(), "cannot be used ("),
    ] {
        for more in [&["--check"][..], &[]] {
            let said = ends(url, more).await;
            assert!(said.contains(says), "{url} {more:?}:\n{said}");
        }
    }
    // One standby is enough.
    let (server, _directory) = beside_others(&url);
    until_it_owns(&server);
}
