//! Real ROS 1 bags, where they are at hand.

use std::path::PathBuf;

use waypost_bags::{Bag, Kind};

use crate::reading::open;

fn sample(name: &str) -> Option<Bag> {
    let beside_the_repository = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let data = std::env::var_os("WAYPOST_DATA").map_or_else(beside_the_repository, PathBuf::from);
    let path = data.join("imports/ros1").join(name);
    if path.is_file() {
        return Some(open(&path));
    }
    eprintln!("skipped: there is no {}", path.display());
    None
}

#[test]
fn a_real_robots_odometry_is_read() {
    let Some(bag) = sample("routefollow_day2_test1.bag") else { return };
    let odometry: Vec<_> = bag.topics().iter().filter(|topic| topic.kind == Kind::Odometry).collect();
    let [odometry] = odometry.as_slice() else { panic!("{odometry:?}") };
    assert_eq!((odometry.name.as_str(), odometry.readable()), ("/odom", odometry.count));
    let (first_ns, last_ns) = odometry.stamped_ns.unwrap();
    let span_s = (last_ns - first_ns) as f64 / 1e9;
    assert!((100.0..140.0).contains(&span_s), "{span_s} s");
    assert!(odometry.rate_hz().unwrap() > 5.0 && bag.cut_off().is_empty());
}

#[test]
fn two_odometries_are_told_apart() {
    let Some(bag) = sample("campusrover_testodoms.bag") else { return };
    for name in ["/odom", "/raw_odom"] {
        let topic = bag.topics().iter().find(|topic| topic.name == name).unwrap();
        assert!(topic.count > 10 && topic.left_out.is_none(), "{topic:?}");
    }
}

#[test]
fn both_compressions_hold_the_same() {
    let (Some(bz2), Some(lz4)) = (sample("turtlesim_example-bz2.bag"), sample("turtlesim_example-lz4.bag"))
    else {
        return;
    };
    let counts = |bag: &Bag| -> Vec<(String, u64)> {
        bag.topics().iter().map(|topic| (topic.name.clone(), topic.count)).collect()
    };
    assert_eq!(counts(&bz2), counts(&lz4));
    assert!(counts(&bz2).iter().any(|(name, count)| name.ends_with("pose") && *count > 100));
}
