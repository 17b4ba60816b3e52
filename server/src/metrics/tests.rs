use super::*;
use crate::ingest::extraction::Help;
use crate::quotas::{Holder, Quota, Refusals};

fn levels() -> Levels {
    Levels {
        open_maps: 2,
        jobs_running: 1,
        database_bytes: Some(4096),
        disk_free_bytes: Some(8192),
        robots_led: vec![("lost", 3)],
        queues: QueueLengths { images: 17, robots_in_line: 4, maps: 2 },
        help: Help { cores: 2, images: 9 },
        fleet: Some(FleetLevels { epoch: 3, standbys: Some(2), lag_bytes: Some(160) }),
        used: Used { maps: 5, sessions: 6, kept_bytes: 700 },
        refusals: Refusals::from([((Quota::Kept, Holder::Token), 8)]),
        process: ProcessLevels { resident_bytes: Some(512), cpu_seconds: Some(1.5) },
    }
}

#[test]
fn two_servers_count_apart() {
    let (first, second) = (Metrics::new().unwrap(), Metrics::new().unwrap());
    first.frame("invalid_argument", None);
    let counted = "waypost_frames_total{outcome=\"invalid_argument\"} 1";
    assert!(first.render(levels()).lines().any(|line| line == counted), "{}", first.render(levels()));
    assert!(!second.render(levels()).contains("waypost_frames_total{"));
}

#[test]
fn streams_are_counted_while_they_are_open() {
    let metrics = Metrics::new().unwrap();
    let stream = metrics.open_stream();
    assert!(metrics.render(levels()).contains("waypost_open_streams 1"));
    drop(stream);
    assert!(metrics.render(levels()).contains("waypost_open_streams 0"));
}

#[test]
fn times_are_in_buckets_of_seconds_and_levels_as_they_are() {
    let metrics = Metrics::new().unwrap();
    metrics.grpc_request("/a/B", "ok", Duration::from_millis(20));
    metrics.http_request("GET", "/v1/maps/{map}", 200, Duration::from_millis(2));
    metrics.http_request("BREW", "/v1/maps/{map}", 405, Duration::from_millis(2));
    metrics.committed(3);
    metrics.sum_up();
    let text = metrics.render(levels());
    for line in [
        "waypost_grpc_requests_total{method=\"/a/B\",code=\"ok\"} 1",
        "waypost_grpc_request_duration_seconds_bucket{method=\"/a/B\",le=\"0.01\"} 0",
        "waypost_grpc_request_duration_seconds_bucket{method=\"/a/B\",le=\"0.025\"} 1",
        "waypost_http_requests_total{method=\"GET\",route=\"/v1/maps/{map}\",code=\"200\"} 1",
        "waypost_http_requests_total{method=\"other\",route=\"/v1/maps/{map}\",code=\"405\"} 1",
        "waypost_commit_frames_bucket{le=\"2\"} 0",
        "waypost_commit_frames_bucket{le=\"4\"} 1",
        "waypost_open_maps 2",
        "waypost_jobs_running 1",
        "waypost_database_bytes 4096",
        "waypost_disk_free_bytes 8192",
        "waypost_robots_led{status=\"lost\"} 3",
        "waypost_maps 5",
        "waypost_sessions 6",
        "waypost_kept_bytes 700",
        "waypost_quota_refusals_total{quota=\"max_kept_mib\",of=\"token\"} 8",
        "waypost_process_resident_memory_bytes 512",
        "waypost_process_cpu_seconds 1.5",
        "waypost_owns_database 1",
        "waypost_helper_cores 2",
        "waypost_helped_images_total 9",
        "waypost_database_epoch 3",
        "waypost_standbys 2",
        "waypost_standby_lag_bytes 160",
    ] {
        assert!(text.lines().any(|there| there == line), "no {line} in\n{text}");
    }
}

#[test]
fn what_is_passed_on_is_counted_and_open_until_it_is_answered() {
    let metrics = Metrics::new().unwrap();
    let first = metrics.forward("grpc");
    let _second = metrics.forward("grpc");
    drop(first);
    let text = metrics.render_in_reserve(levels().process);
    for line in [
        "waypost_forwarded_requests_total{port=\"grpc\"} 2",
        "waypost_forwarded_requests_open{port=\"grpc\"} 1",
        "waypost_owns_database 0",
        "waypost_process_cpu_seconds 1.5",
    ] {
        assert!(text.lines().any(|there| there == line), "no {line} in\n{text}");
    }
}
