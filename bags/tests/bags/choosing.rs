//! Which topics are chosen, and what is said where none can be.

use waypost_bags::{ChoiceError, Lens, Rectification, Wanted};

use crate::reading::{joined, open};
use crate::writing::mcap_file::mcap;
use crate::writing::messages::{
    Order, camera_info, compressed_image, odometry, raw_image, transforms, transforms_at,
};
use crate::writing::{Folder, Message, drive, png};

const COMPRESSED: &str = "sensor_msgs/CompressedImage";

fn image(topic: &'static str, log_ns: u64) -> Message {
    let fields = compressed_image(log_ns, "png", &png(1));
    Message { topic, type_name: COMPRESSED, log_ns, fields }
}

fn chosen(messages: &[Message], wanted: &Wanted) -> Result<waypost_bags::Choice, ChoiceError> {
    let folder = Folder::new();
    open(&folder.file("drive.mcap", &mcap(messages, None, Order::Little))).choose(wanted)
}

fn refused(messages: &[Message], wanted: &Wanted) -> String {
    chosen(messages, wanted).unwrap_err().to_string()
}

#[test]
fn two_cameras_have_to_be_chosen_between() {
    let two = [image("/left/image/compressed", 5), image("/right/image/compressed", 6)];
    assert_eq!(
        refused(&two, &Wanted::default()),
        "several topics have images: /left/image/compressed, /right/image/compressed; name one with --image-topic"
    );
    let wanted = Wanted { image_topic: Some("/right/image/compressed".to_owned()), ..Wanted::default() };
    assert_eq!(chosen(&two, &wanted).unwrap().image_topic, "/right/image/compressed");
}

#[test]
fn the_compressed_twin_is_taken() {
    let raw = Message {
        topic: "/camera/image",
        type_name: "sensor_msgs/Image",
        log_ns: 5,
        fields: raw_image(5, "mono8", (1, 1), 1, &[7]),
    };
    let choice = chosen(&[raw, image("/camera/image/compressed", 6)], &Wanted::default()).unwrap();
    assert_eq!(choice.image_topic, "/camera/image/compressed");
}

#[test]
fn topics_that_do_not_serve_are_named() {
    let wanted = Wanted { image_topic: Some("/odom".to_owned()), ..Wanted::default() };
    assert_eq!(
        refused(&drive(), &wanted),
        "/odom is of type nav_msgs/msg/Odometry; --image-topic takes sensor_msgs/CompressedImage or sensor_msgs/Image"
    );
    let wanted = Wanted { odometry_topic: Some("/odo".to_owned()), ..Wanted::default() };
    let told = refused(&drive(), &wanted);
    assert!(told.starts_with("there is no topic /odo; the bag has /camera/camera_info, "), "{told}");
    let without = refused(&drive()[..2], &Wanted::default());
    assert!(without.contains("none is of type sensor_msgs/CompressedImage"), "{without}");
}

#[test]
fn a_topic_that_changes_its_type_is_refused() {
    let mut messages = drive();
    messages.push(Message { topic: "/camera/image/compressed", ..messages[3].clone() });
    assert_eq!(
        refused(&messages, &Wanted::default()),
        "/camera/image/compressed changes its type from sensor_msgs/msg/CompressedImage to nav_msgs/msg/Odometry; \
         a topic of one type is needed"
    );
}

#[test]
fn images_that_cannot_be_used_say_why() {
    let raw = |encoding: &str| Message {
        topic: "/depth/image",
        type_name: "sensor_msgs/Image",
        log_ns: 5,
        fields: raw_image(5, encoding, (1, 1), 2, &[7, 0]),
    };
    let told = refused(&[raw("mono16")], &Wanted::default());
    assert!(
        told.contains("/depth/image: message 1: pixels of encoding `mono16` are not read; mono8"),
        "{told}"
    );
    // A depth image beside a camera is no choice.
    let choice = chosen(&[raw("32FC1"), image("/camera/image/compressed", 6)], &Wanted::default()).unwrap();
    assert_eq!(choice.image_topic, "/camera/image/compressed");
}

#[test]
fn a_clock_that_jumps_back_or_says_nothing_leaves_images_out() {
    let topic = "/camera/image/compressed";
    let stamped = |stamp_ns: u64, log_ns: u64| Message {
        topic,
        type_name: COMPRESSED,
        log_ns,
        fields: compressed_image(stamp_ns, "png", &png(1)),
    };
    let choice = chosen(&[stamped(10, 1), stamped(9, 2), stamped(10, 3), stamped(11, 4)], &Wanted::default());
    let choice = choice.unwrap();
    assert_eq!(choice.stamps_ns, [Some(10), None, None, Some(11)]);
    let left_out = choice.left_out.unwrap();
    assert_eq!((left_out.count, left_out.first_number), (2, 2));
    let problem = left_out.first_problem.to_string();
    assert_eq!(
        problem,
        "its stamp 9 is not above the 10 of one before; --stamps log takes the times of recording"
    );
    let told = refused(&[stamped(0, 1)], &Wanted::default());
    assert!(told.contains("its header has no stamp above 0; --stamps log takes"), "{told}");
}

#[test]
fn what_is_missing_is_said_and_not_guessed() {
    let choice = chosen(&[image("/camera/image/compressed", 5)], &Wanted::default()).unwrap();
    assert_eq!(choice.camera, None);
    assert_eq!(
        choice.notes,
        [
            "frames have no odometry: no topic is of type nav_msgs/Odometry",
            "no camera is declared: no CameraInfo belongs to /camera/image/compressed"
        ]
    );
    let of = |size, model, parameters: &[f64]| {
        let info = Message {
            topic: "/camera/camera_info",
            type_name: "sensor_msgs/CameraInfo",
            log_ns: 4,
            fields: camera_info(4, size, model, parameters),
        };
        let odometry = Message {
            topic: "/odom",
            type_name: "nav_msgs/Odometry",
            log_ns: 5,
            fields: odometry(5, "base_footprint", 0.0),
        };
        let choice = chosen(&[info, odometry, image("/camera/image", 6)], &Wanted::default()).unwrap();
        (choice.camera.is_some(), choice.notes)
    };
    let (declared, notes) = of((8, 6), "plumb_bob", &[]);
    let unplaced = "where the camera is on the robot is not declared: tf_static does not lead from base_footprint to \
                    camera_optical";
    assert_eq!((declared, notes.as_slice()), (true, [unplaced.to_owned()].as_slice()));
    let (declared, notes) = of((16, 12), "plumb_bob", &[]);
    assert!(!declared && notes[0].contains("the images are 8 x 6, and /camera/camera_info is for 16 x 12"));
    let folding = [-90.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    let (declared, notes) = of((8, 6), "rational_polynomial", &folding);
    assert!(!declared && notes[0].contains("has k4, k5 or k6, which cannot be declared"), "{notes:?}");
    let (declared, notes) = of((8, 6), "rational_polynomial", &[0.1; 8]);
    let told = "the rational_polynomial of /camera/camera_info is declared as the nearest plumb_bob, which is up to 0.00 pixels";
    assert!(declared && notes[0].starts_with(told), "{notes:?}");
}

#[test]
fn transforms_in_a_circle_are_refused() {
    let mut messages = drive();
    let still = [0.0, 0.0, 0.0, 1.0];
    messages[0].fields = transforms(&[
        ("camera_optical", "base_link", [0.0; 3], still),
        ("base_link", "camera_optical", [0.0; 3], still),
    ]);
    let told = refused(&messages, &Wanted::default());
    assert!(told.contains("the transforms of tf_static go in a circle at"), "{told}");
    let wanted = Wanted { camera_info_topic: Some("none".to_owned()), ..Wanted::default() };
    assert!(chosen(&messages, &wanted).unwrap().camera.is_none());
}

const STILL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// The drive with its odometry as transforms, and no other.
fn driven_by_transforms(parent: &str, child: &str) -> Vec<Message> {
    let mut messages = drive();
    for message in messages.iter_mut().filter(|message| message.topic == "/odom") {
        let stamp_ns = message.log_ns - 25_000_002;
        let x_m = stamp_ns as f64 / 1e9;
        (message.topic, message.type_name) = ("/tf", "tf2_msgs/TFMessage");
        message.fields = transforms_at(
            stamp_ns,
            &[(parent, child, [x_m, 0.0, 0.0], STILL), ("base", "wheel", [0.0; 3], STILL)],
        );
    }
    messages
}

fn by_topic(topic: &str) -> Wanted {
    Wanted { odometry_topic: Some(topic.to_owned()), ..Wanted::default() }
}

#[test]
fn transforms_of_the_base_or_of_its_place_on_the_floor_are_odometry() {
    for base in ["base_link", "base_footprint"] {
        let folder = Folder::new();
        let messages = driven_by_transforms("odom", base);
        let bag = open(&folder.file("drive.mcap", &mcap(&messages, None, Order::Little)));
        let choice = bag.choose(&by_topic("/tf")).unwrap();
        assert_eq!(choice.odometry.as_ref().unwrap().base_frame, base);
        assert_eq!(joined(&bag, &choice, 0).1.with_pose, 4);
        let notes = bag.choose(&Wanted::default()).unwrap().notes;
        assert_eq!(
            notes[0],
            "frames have no odometry: no topic is of type nav_msgs/Odometry; --odometry-topic also takes /tf"
        );
    }
}

#[test]
fn transforms_that_are_no_odometry_are_refused_by_the_names_of_their_frames() {
    let messages = driven_by_transforms("map", "odom");
    assert_eq!(
        refused(&messages, &by_topic("/tf")),
        "/tf has no transform from odom to base_link or base_footprint, which odometry is; it has base to wheel, map to odom; name \
         another topic with --odometry-topic, or none"
    );
    let told = refused(&messages, &by_topic("/tf_static"));
    assert!(
        told.starts_with("/tf_static has no transform from odom") && told.contains("it has what never moves")
    );
    // Neither is held out as one.
    let notes = chosen(&messages, &Wanted::default()).unwrap().notes;
    assert_eq!(notes[0], "frames have no odometry: no topic is of type nav_msgs/Odometry");
}

#[test]
fn odometry_that_is_there_and_of_no_use_is_not_said_to_be_missing() {
    let mut messages = drive();
    let of_odometry = messages.iter_mut().filter(|message| message.topic == "/odom");
    of_odometry.for_each(|message| message.fields = odometry(message.log_ns, "base_link", f64::NAN));
    let notes = chosen(&messages, &Wanted::default()).unwrap().notes;
    assert!(
        notes[0].starts_with(
            "frames have no odometry: no message of type nav_msgs/Odometry can be used: /odom: message 1: its pose is none"
        ),
        "{notes:?}"
    );
}

#[test]
fn what_images_are_is_said_whatever_their_topic_is_called() {
    let as_they_are = |rectification| {
        let wanted = Wanted { rectification, ..Wanted::default() };
        match chosen(&drive(), &wanted).unwrap().camera.unwrap().lens {
            Lens::Pinhole(intrinsics) => (intrinsics.fx_px, intrinsics.distortion.len()),
            Lens::Fisheye(intrinsics) => panic!("{intrinsics:?}"),
        }
    };
    assert_eq!(as_they_are(None), (50.0, 5));
    assert_eq!(as_they_are(Some(Rectification::Raw)), (50.0, 5));
    assert_eq!(as_they_are(Some(Rectification::Rectified)), (40.0, 0));
    // A name that says so in another way is asked about.
    let mut messages = drive();
    let images = messages.iter_mut().filter(|message| message.topic == "/camera/image/compressed");
    images.for_each(|message| message.topic = "/camera/color_rect");
    let notes = chosen(&messages, &Wanted::default()).unwrap().notes;
    assert!(
        notes[0].contains("/camera/color_rect are taken as raw; if they are rectified, give"),
        "{notes:?}"
    );
    let wanted = Wanted { rectification: Some(Rectification::Raw), ..Wanted::default() };
    assert_eq!(chosen(&messages, &wanted).unwrap().notes, [""; 0]);
}
