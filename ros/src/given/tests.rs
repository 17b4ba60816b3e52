use super::*;

fn given(arguments: &[&str]) -> Given {
    Given::try_parse_from(["waypost-ros"].iter().chain(arguments)).unwrap()
}

fn told(arguments: &[&str]) -> String {
    given(arguments).resolved().unwrap_err().to_string()
}

#[test]
fn a_robot_of_many_has_its_topics_in_its_namespace() {
    let settings = given(&["--map", "hall", "--namespace", "/robot1"]).resolved().unwrap();
    let topics = settings.topics;
    assert_eq!((topics.image.as_str(), topics.image_kind), ("/robot1/camera/image_raw", Kind::Image));
    assert_eq!(topics.camera_info.as_deref(), Some("/robot1/camera/camera_info"));
    assert_eq!((topics.tf.as_str(), topics.diagnostics.as_str()), ("/robot1/tf", "/diagnostics"));
}

#[test]
fn the_camera_info_is_beside_the_images() {
    assert_eq!(beside("/camera/image_raw/compressed"), "/camera/camera_info");
    assert_eq!(beside("/image"), "/camera_info");
}

#[test]
fn a_flag_wins_over_the_file() {
    let file: Given = toml::from_str("map = 'hall'\nmost_hz = 2.5\nsensor_qos = 'reliable'").unwrap();
    let settings = given(&["--map", "office", "--localize"]).over(file).resolved().unwrap();
    assert_eq!((settings.map.as_deref(), settings.most_hz), (Some("office"), 2.5));
    assert_eq!((settings.mode, settings.sensor_qos), (Mode::Localize, SensorQos::Reliable));
}

#[test]
fn what_does_not_fit_is_told_with_what_mends_it() {
    assert!(told(&[]).contains("--map"));
    assert!(told(&["--map", "a", "--drive"]).contains("--localize"));
    let blind = ["--map", "a", "--drive", "--localize", "--odometry-topic", "none"];
    assert!(told(&blind).contains("need odometry"));
    assert!(told(&["--map", "a", "--domain", "233"]).contains("0 to 232"));
    assert!(told(&["--map", "a", "--most-hz=-1"]).contains("0 or above"));
    let unknown = toml::from_str::<Given>("mapp = 'hall'").unwrap_err().to_string();
    assert!(unknown.contains("unknown field `mapp`"), "{unknown}");
}

#[test]
fn what_the_environment_leaves_empty_is_unset() {
    let empty = given(&["--server", "", "--token", "", "--ca", "", "--map", "hall"]).settings().unwrap();
    assert_eq!((empty.server.as_str(), empty.token, empty.ca), (DEFAULT_SERVER, None, None));
}
