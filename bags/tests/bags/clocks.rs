//! Stamps that are wrong, and clocks that are set while a robot drives.

use waypost_bags::{Choice, Frame, Joined, Wanted};

use crate::reading::{joined, open};
use crate::writing::mcap_file::mcap;
use crate::writing::messages::{Order, compressed_image, odometry};
use crate::writing::{Folder, Message, png};

const SECOND_NS: u64 = 1_000_000_000;
const BEGIN_NS: u64 = 1_700_000_000 * SECOND_NS;

/// A message's true time, and what is made of it: its stamp, and when it was recorded.
#[derive(Clone, Copy)]
struct Times {
    stamp_ns: u64,
    log_ns: u64,
}

/// 30 images at 1 Hz, odometry at 4 Hz at a metre a second.
fn drive(image: impl Fn(u64, Times) -> Times, pose: impl Fn(u64, Times) -> Times) -> Vec<Message> {
    let at = |quarter: u64, late_ns: u64| {
        let stamp_ns = BEGIN_NS + quarter * SECOND_NS / 4;
        Times { stamp_ns, log_ns: stamp_ns + late_ns }
    };
    let mut messages: Vec<Message> = (0..120)
        .map(|quarter| {
            let Times { stamp_ns, log_ns } = pose(quarter, at(quarter, 1));
            let fields = odometry(stamp_ns, "base_link", quarter as f64 / 4.0);
            Message { topic: "/odom", type_name: "nav_msgs/Odometry", log_ns, fields }
        })
        .collect();
    messages.extend((0..30).map(|second| {
        let Times { stamp_ns, log_ns } = image(second, at(4 * second, 5_000_000));
        let fields = compressed_image(stamp_ns, "png", &png(1));
        Message {
            topic: "/camera/image/compressed",
            type_name: "sensor_msgs/CompressedImage",
            log_ns,
            fields,
        }
    }));
    messages.sort_by_key(|message| message.log_ns);
    messages
}

fn right(_: u64, times: Times) -> Times {
    times
}

fn read(messages: &[Message]) -> (Choice, Vec<Frame>, Joined) {
    let folder = Folder::new();
    let bag = open(&folder.file("drive.mcap", &mcap(messages, None, Order::Little)));
    let choice = bag.choose(&Wanted::default()).unwrap();
    let (frames, joined) = joined(&bag, &choice, 0);
    (choice, frames, joined)
}

fn x_m(frame: &Frame) -> Option<f64> {
    Some(frame.pose?.position_m[0])
}

#[test]
fn one_wrong_stamp_of_odometry_costs_itself_alone() {
    for wrong_ns in [BEGIN_NS + 1_000_000 * SECOND_NS, 5] {
        let spike =
            |quarter, times| if quarter == 11 { Times { stamp_ns: wrong_ns, ..times } } else { times };
        let (choice, frames, joined) = read(&drive(right, spike));
        for (second, frame) in frames.iter().enumerate() {
            assert!((x_m(frame).unwrap() - second as f64).abs() < 1e-9, "{second}: {:?}", frame.pose);
        }
        assert_eq!((joined.with_pose, joined.without_pose.all()), (30, 0));
        assert_eq!((joined.astray.left_out, joined.astray.set_back), (1, 0));
        assert_eq!(joined.astray.first, Some((12, wrong_ns as i64)));
        let told = &choice.notes[0];
        assert!(
            told.starts_with("odometry of /odom: 1 message is left out, number 12: its stamp "),
            "{told}"
        );
    }
}

#[test]
fn odometry_begins_anew_where_its_clock_was_set_back() {
    let set_back = |quarter, times: Times| {
        let back_ns = if quarter < 40 { 0 } else { 5 * SECOND_NS };
        Times { stamp_ns: times.stamp_ns - back_ns, ..times }
    };
    let (choice, frames, joined) = read(&drive(right, set_back));
    let told = &choice.notes[0];
    assert!(told.contains("/odom: its clock was set back by 4.750 s, at message 41"), "{told}");
    // Before, as it was; then nothing that mixes both; then what the new clock says.
    assert!((0..=9).all(|second| x_m(&frames[second]) == Some(second as f64)), "{frames:?}");
    for (second, frame) in frames.iter().enumerate().skip(11) {
        assert!(
            x_m(frame).is_none_or(|x_m| (x_m - (second as f64 + 5.0)).abs() < 1e-9),
            "{second}: {frame:?}"
        );
    }
    assert!(frames.iter().filter(|frame| frame.pose.is_some()).count() >= 24, "{frames:?}");
    assert_eq!((joined.astray.left_out, joined.astray.set_back), (0, 1));
    assert_eq!(joined.astray.first_set_back, Some((41, 5 * SECOND_NS as i64 - SECOND_NS as i64 / 4)));
    assert_eq!(joined.without_pose.apart, 0);
}

#[test]
fn one_wrong_stamp_of_an_image_costs_itself_alone() {
    for (wrong, wrong_s) in [(3, 1_000_000), (0, 1_000_000), (10, 3)] {
        let spike = |second, times: Times| {
            let ahead_ns = if second == wrong { wrong_s * SECOND_NS } else { 0 };
            Times { stamp_ns: times.stamp_ns + ahead_ns, ..times }
        };
        let (choice, frames, joined) = read(&drive(spike, right));
        let numbers: Vec<u64> = frames.iter().map(|frame| frame.number).collect();
        let others: Vec<u64> = (1..=30).filter(|number| *number != wrong + 1).collect();
        assert_eq!((numbers, joined.with_pose), (others, 29));
        let left_out = choice.left_out.unwrap();
        assert_eq!((left_out.count, left_out.first_number), (1, wrong + 1));
        let told = left_out.first_problem.to_string();
        assert!(told.contains("does not follow the"), "{told}");
    }
}

#[test]
fn images_go_on_after_a_pause_and_after_a_clock_that_was_set_ahead() {
    let later = |second, times: Times| {
        let ahead_ns = if second >= 15 { 3600 * SECOND_NS } else { 0 };
        Times { stamp_ns: times.stamp_ns + ahead_ns, ..times }
    };
    let (choice, frames, joined) = read(&drive(later, |quarter, times| later(quarter / 4, times)));
    assert_eq!((frames.len(), choice.left_out, joined.with_pose), (30, None, 30));
    assert!(joined.astray.is_none());
}

#[test]
fn images_after_a_clock_that_was_set_back_are_left_out_and_why_is_told() {
    let back = |second, times: Times| {
        let back_ns = if second >= 15 { 3600 * SECOND_NS } else { 0 };
        Times { stamp_ns: times.stamp_ns - back_ns, ..times }
    };
    let (choice, frames, joined) = read(&drive(back, |quarter, times| back(quarter / 4, times)));
    assert_eq!((frames.len(), joined.with_pose, joined.astray.set_back), (15, 15, 1));
    let left_out = choice.left_out.unwrap();
    assert_eq!((left_out.count, left_out.first_number), (15, 16));
    assert!(left_out.first_problem.to_string().contains("is not above the"), "{left_out:?}");
}

#[test]
fn odometry_is_joined_by_its_stamps_however_late_it_was_recorded() {
    let late = |late_s| move |_, times: Times| Times { log_ns: times.log_ns + late_s * SECOND_NS, ..times };
    let (_, _, joined) = read(&drive(right, late(40)));
    assert_eq!((joined.with_pose, joined.without_pose.all()), (30, 0));
    // Beyond what is waited for it is said why. The first image is there still when the first pose is.
    let (_, _, joined) = read(&drive(right, late(100)));
    assert_eq!((joined.with_pose, joined.without_pose.apart, joined.without_pose.all()), (1, 29, 29));
    let (_, _, joined) = read(&drive(late(20), right));
    assert_eq!((joined.with_pose, joined.without_pose.all()), (30, 0));
}
