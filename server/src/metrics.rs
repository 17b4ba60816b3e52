//! What the server counts and times, for Prometheus.
//!
//! Each server has a recorder of its own, never the process's: two servers in one process, as in tests,
//! then count apart, and there is no second installation that could fail.

mod history;
mod levels;

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use metrics::{
    Gauge, Histogram, Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram,
    with_local_recorder,
};
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusRecorder};
use topomap::metric::AgreementVerdict;

pub(crate) use self::history::{EVERY as HISTORY_EVERY, History, HistoryView, SeriesName};
pub(crate) use self::levels::{Levels, ProcessLevels, QueueLengths};
use crate::quotas::Used;
use crate::storage::FleetLevels;

const GRPC_REQUESTS: &str = "waypost_grpc_requests_total";
const GRPC_SECONDS: &str = "waypost_grpc_request_duration_seconds";
const HTTP_REQUESTS: &str = "waypost_http_requests_total";
const HTTP_SECONDS: &str = "waypost_http_request_duration_seconds";
const OPEN_STREAMS: &str = "waypost_open_streams";
const FRAMES: &str = "waypost_frames_total";
const FRAME_SECONDS: &str = "waypost_frame_duration_seconds";
const TURNED_UNLIKE_ODOMETRY: &str = "waypost_frames_turned_unlike_odometry_total";
const COMMIT_FRAMES: &str = "waypost_commit_frames";
const OPEN_MAPS: &str = "waypost_open_maps";
const QUEUE_LENGTH: &str = "waypost_queue_length";
const JOBS_RUNNING: &str = "waypost_jobs_running";
const DATABASE_BYTES: &str = "waypost_database_bytes";
const DISK_FREE_BYTES: &str = "waypost_disk_free_bytes";
const MAPS: &str = "waypost_maps";
const SESSIONS: &str = "waypost_sessions";
const KEPT_BYTES: &str = "waypost_kept_bytes";
const QUOTA_REFUSALS: &str = "waypost_quota_refusals_total";
const ROBOTS_LED: &str = "waypost_robots_led";
const MEMORY_BYTES: &str = "waypost_process_resident_memory_bytes";
const CPU_SECONDS: &str = "waypost_process_cpu_seconds";
const FORWARDED: &str = "waypost_forwarded_requests_total";
const FORWARDED_OPEN: &str = "waypost_forwarded_requests_open";
const OWNS_DATABASE: &str = "waypost_owns_database";
const HELPER_CORES: &str = "waypost_helper_cores";
const HELPED_IMAGES: &str = "waypost_helped_images_total";
const DATABASE_EPOCH: &str = "waypost_database_epoch";
const STANDBYS: &str = "waypost_standbys";
const STANDBY_LAG_BYTES: &str = "waypost_standby_lag_bytes";
const BUILD: &str = "waypost_build_info";

/// Upper bounds of what a stage of a frame takes, from an indexed likelihood to a queue that is full.
const FRAME_BUCKETS_SECONDS: [f64; 14] =
    [0.000_1, 0.000_25, 0.000_5, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];

/// Upper bounds of what a request takes, from a list to a stream of an hour.
const REQUEST_BUCKETS_SECONDS: [f64; 12] =
    [0.001, 0.0025, 0.005, 0.01, 0.025, 0.1, 0.25, 1.0, 5.0, 30.0, 300.0, 3600.0];

/// Up to the most frames that share a commit.
const COMMIT_BUCKETS_FRAMES: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// Counters of one server. Cheap to clone.
#[derive(Clone)]
pub(crate) struct Metrics {
    recorder: Arc<PrometheusRecorder>,
    open_streams: Gauge,
    commit_frames: Histogram,
    stages: Arc<Stages>,
}

/// Where a frame's time went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FrameTimings {
    pub(crate) extract: Duration,
    pub(crate) quantize: Duration,
    pub(crate) likelihood: Duration,
    pub(crate) new_place: Duration,
    pub(crate) filter: Duration,
    pub(crate) verification: Duration,
    pub(crate) commit: Duration,
    pub(crate) total: Duration,
}

impl FrameTimings {
    /// Time spent on the frame itself; the rest of the total is waiting.
    pub(crate) fn work(&self) -> Duration {
        self.extract + self.quantize + self.likelihood + self.new_place + self.filter + self.verification
    }
}

/// How long frames take, stage by stage.
struct Stages {
    extract: Histogram,
    quantize: Histogram,
    likelihood: Histogram,
    new_place: Histogram,
    filter: Histogram,
    verification: Histogram,
    commit: Histogram,
    total: Histogram,
}

impl Metrics {
    pub(crate) fn new() -> Result<Self, BuildError> {
        let named = |name: &str| Matcher::Full(name.to_owned());
        let recorder = PrometheusBuilder::new()
            .set_buckets_for_metric(named(FRAME_SECONDS), &FRAME_BUCKETS_SECONDS)?
            .set_buckets_for_metric(named(GRPC_SECONDS), &REQUEST_BUCKETS_SECONDS)?
            .set_buckets_for_metric(named(HTTP_SECONDS), &REQUEST_BUCKETS_SECONDS)?
            .set_buckets_for_metric(named(COMMIT_FRAMES), &COMMIT_BUCKETS_FRAMES)?
            .build_recorder();
        let recorder = Arc::new(recorder);
        let (open_streams, commit_frames, stages) = with_local_recorder(&*recorder, || {
            describe();
            gauge!(BUILD, "version" => env!("CARGO_PKG_VERSION")).set(1.0);
            let stage = |name: &'static str| histogram!(FRAME_SECONDS, "stage" => name);
            let stages = Stages {
                extract: stage("extract"),
                quantize: stage("quantize"),
                likelihood: stage("likelihood"),
                new_place: stage("new_place"),
                filter: stage("filter"),
                verification: stage("verification"),
                commit: stage("commit"),
                total: stage("total"),
            };
            (gauge!(OPEN_STREAMS), histogram!(COMMIT_FRAMES), Arc::new(stages))
        });
        Ok(Self { recorder, open_streams, commit_frames, stages })
    }

    /// A gRPC call that is over.
    pub(crate) fn grpc_request(&self, method: &'static str, code: &'static str, took: Duration) {
        let requests = self.local(|| counter!(GRPC_REQUESTS, "method" => method, "code" => code));
        requests.increment(1);
        self.local(|| histogram!(GRPC_SECONDS, "method" => method)).record(took);
    }

    /// An HTTP request that was answered. `route` is the pattern, not the path: names of maps would make
    /// a metric each.
    pub(crate) fn http_request(&self, method: &str, route: &str, code: u16, took: Duration) {
        let method = known_method(method);
        let route = route.to_owned();
        let requests = self.local(|| {
            counter!(HTTP_REQUESTS, "method" => method, "route" => route.clone(), "code" => code.to_string())
        });
        requests.increment(1);
        self.local(|| histogram!(HTTP_SECONDS, "method" => method, "route" => route)).record(took);
    }

    /// Counts a stream of frames for as long as what comes back lives.
    pub(crate) fn open_stream(&self) -> OpenStream {
        self.open_streams.increment(1.0);
        OpenStream(self.open_streams.clone())
    }

    /// What became of a frame, in a word, and where its time went if it was decided.
    pub(crate) fn frame(&self, outcome: &'static str, timings: Option<FrameTimings>) {
        self.local(|| counter!(FRAMES, "outcome" => outcome)).increment(1);
        let Some(timings) = timings else { return };
        let FrameTimings { extract, quantize, likelihood, new_place, filter, verification, commit, total } =
            timings;
        let stages = &self.stages;
        stages.extract.record(extract);
        stages.quantize.record(quantize);
        stages.likelihood.record(likelihood);
        stages.new_place.record(new_place);
        stages.filter.record(filter);
        stages.verification.record(verification);
        stages.commit.record(commit);
        stages.total.record(total);
    }

    /// A frame by which images and odometry did not turn alike over a robot's last turns; nothing if they did.
    pub(crate) fn turned(&self, verdict: AgreementVerdict) {
        let how = match verdict {
            AgreementVerdict::Alike => return,
            AgreementVerdict::OfAnotherScale => "of_another_scale",
            AgreementVerdict::OutOfStep => "out_of_step",
        };
        self.local(|| counter!(TURNED_UNLIKE_ODOMETRY, "how" => how)).increment(1);
    }

    /// Frames that one transaction brought to the disk.
    pub(crate) fn committed(&self, frames: usize) {
        self.commit_frames.record(frames as f64);
    }

    /// Counts what is asked of the owner of the database for somebody else, for as long as what comes back lives.
    pub(crate) fn forward(&self, port: &'static str) -> Forwarding {
        self.local(|| counter!(FORWARDED, "port" => port)).increment(1);
        let open = self.local(|| gauge!(FORWARDED_OPEN, "port" => port));
        open.increment(1.0);
        Forwarding(open)
    }

    /// The metrics of a server that does not own its database.
    pub(crate) fn render_in_reserve(&self, process: ProcessLevels) -> String {
        self.local(|| gauge!(OWNS_DATABASE).set(0.0));
        self.set_process(process);
        self.recorder.handle().render()
    }

    fn set_process(&self, process: ProcessLevels) {
        let ProcessLevels { resident_bytes, cpu_seconds } = process;
        self.local(|| {
            gauge!(MEMORY_BYTES).set(resident_bytes.map_or(f64::NAN, |bytes| bytes as f64));
            gauge!(CPU_SECONDS).set(cpu_seconds.unwrap_or(f64::NAN));
        });
    }

    /// All metrics in Prometheus' text format.
    pub(crate) fn render(&self, levels: Levels) -> String {
        let Levels {
            open_maps,
            jobs_running,
            database_bytes,
            disk_free_bytes,
            robots_led,
            queues,
            help,
            fleet,
            used,
            refusals,
            process,
        } = levels;
        let Used { maps: maps_made, sessions, kept_bytes } = used;
        let QueueLengths { images, robots_in_line, maps } = queues;
        self.set_process(process);
        let bytes = |bytes: Option<u64>| bytes.map_or(f64::NAN, |bytes| bytes as f64);
        self.local(|| {
            gauge!(DISK_FREE_BYTES).set(bytes(disk_free_bytes));
            gauge!(OWNS_DATABASE).set(1.0);
            gauge!(HELPER_CORES).set(help.cores as f64);
            counter!(HELPED_IMAGES).absolute(help.images);
            if let Some(FleetLevels { epoch, standbys, lag_bytes }) = fleet {
                gauge!(DATABASE_EPOCH).set(epoch as f64);
                gauge!(STANDBYS).set(standbys.map_or(f64::NAN, |standbys| standbys as f64));
                gauge!(STANDBY_LAG_BYTES).set(lag_bytes.map_or(f64::NAN, |bytes| bytes as f64));
            }
            for (status, robots) in robots_led {
                gauge!(ROBOTS_LED, "status" => status).set(robots as f64);
            }
            for (queue, length) in [("images", images), ("robots_in_line", robots_in_line), ("maps", maps)] {
                gauge!(QUEUE_LENGTH, "queue" => queue).set(length as f64);
            }
            gauge!(MAPS).set(maps_made as f64);
            gauge!(SESSIONS).set(sessions as f64);
            gauge!(KEPT_BYTES).set(kept_bytes as f64);
            for ((quota, holder), times) in refusals {
                let (quota, holder) = (quota.setting(), holder.name());
                counter!(QUOTA_REFUSALS, "quota" => quota, "of" => holder).absolute(times);
            }
            gauge!(OPEN_MAPS).set(open_maps as f64);
            gauge!(JOBS_RUNNING).set(jobs_running as f64);
            gauge!(DATABASE_BYTES).set(bytes(database_bytes));
        });
        self.recorder.handle().render()
    }

    /// Sorts what was timed into buckets, which reading does too: without it, a server whose metrics
    /// nobody reads would keep every single time.
    pub(crate) fn sum_up(&self) {
        self.recorder.handle().run_upkeep();
    }

    fn local<T>(&self, work: impl FnOnce() -> T) -> T {
        with_local_recorder(&*self.recorder, work)
    }
}

impl fmt::Debug for Metrics {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Metrics").finish_non_exhaustive()
    }
}

/// See [`Metrics::open_stream`].
#[derive(Debug)]
pub(crate) struct OpenStream(Gauge);

impl Drop for OpenStream {
    fn drop(&mut self) {
        self.0.decrement(1.0);
    }
}

/// See [`Metrics::forward`].
#[derive(Debug)]
pub(crate) struct Forwarding(Gauge);

impl Drop for Forwarding {
    fn drop(&mut self) {
        self.0.decrement(1.0);
    }
}

/// Clients may send any word as a method; each would be a metric of its own.
fn known_method(method: &str) -> &'static str {
    ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"]
        .into_iter()
        .find(|known| *known == method)
        .unwrap_or("other")
}

fn describe() {
    describe_counter!(GRPC_REQUESTS, "gRPC calls that are over, by method and status code.");
    describe_histogram!(GRPC_SECONDS, Unit::Seconds, "Time from the begin of a gRPC call to its end.");
    describe_counter!(HTTP_REQUESTS, "HTTP requests, by method, route and status code.");
    describe_histogram!(HTTP_SECONDS, Unit::Seconds, "Time from an HTTP request to its answer.");
    describe_gauge!(OPEN_STREAMS, "Streams of frames that are open.");
    describe_counter!(
        FRAMES,
        "Frames by outcome: the reason of the decision, resent if answered from the store, or why refused."
    );
    describe_histogram!(
        FRAME_SECONDS,
        Unit::Seconds,
        "Time of a frame by stage; commit includes waiting, total is from its arrival to its answer."
    );
    describe_counter!(
        TURNED_UNLIKE_ODOMETRY,
        "Frames by which a robot's images did not turn as its odometry did, of another scale (wrong field of \
         view, or odometry) or out of step (wrong stamps); explain says more."
    );
    describe_histogram!(COMMIT_FRAMES, "Frames that shared one commit.");
    describe_gauge!(OPEN_MAPS, "Maps in memory.");
    describe_gauge!(
        QUEUE_LENGTH,
        "What waits: images for a core or on one, robots that were told when to come again, and requests for the \
         writers of maps."
    );
    describe_gauge!(JOBS_RUNNING, "Jobs that are running or wait for their turn.");
    describe_gauge!(DATABASE_BYTES, Unit::Bytes, "Size of the database, without its write-ahead log.");
    describe_gauge!(DISK_FREE_BYTES, Unit::Bytes, "What is left of the disk that the database is on.");
    describe_gauge!(MAPS, "Maps that are there.");
    describe_gauge!(SESSIONS, "Sessions that maps keep.");
    describe_gauge!(
        KEPT_BYTES,
        Unit::Bytes,
        "What sessions keep: events of the log, features, thumbnails and images."
    );
    describe_counter!(
        QUOTA_REFUSALS,
        "What quotas have refused, by quota and whether it is a token's or the server's; a frame that waits counts \
         each time."
    );
    describe_gauge!(ROBOTS_LED, "Robots that navigate, by their status.");
    describe_gauge!(MEMORY_BYTES, Unit::Bytes, "Memory of the process.");
    describe_gauge!(CPU_SECONDS, Unit::Seconds, "Processor time that the process has taken.");
    describe_counter!(FORWARDED, "What was asked of the owner of the database for somebody else, by port.");
    describe_gauge!(FORWARDED_OPEN, "What is being asked so, streams included, by port.");
    describe_gauge!(OWNS_DATABASE, "1 if this server owns its database, 0 if it asks the server that does.");
    describe_gauge!(HELPER_CORES, "Cores of other servers that look at images for this one.");
    describe_counter!(HELPED_IMAGES, "Images that other servers have looked at for this one.");
    describe_gauge!(DATABASE_EPOCH, "Owners that the database of PostgreSQL has had, this server the last.");
    describe_gauge!(STANDBYS, "Machines of PostgreSQL that follow the one that takes writes.");
    describe_gauge!(STANDBY_LAG_BYTES, Unit::Bytes, "What the standby that lacks most has not stored yet.");
    describe_gauge!(BUILD, "Always 1; the version is in the label.");
}

#[cfg(test)]
mod tests;
