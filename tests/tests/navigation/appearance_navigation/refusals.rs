//! What cannot be led by appearance is refused, with the way out.

use super::*;

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_led_by_looks_is_refused_with_the_way_out() {
    let panoramas = Panoramas::new();
    let (server, client) = Server::with_map().await;
    let model = import_model(&client).await;
    let taught = panoramas.teach(&client, ("looks", &model.name), &[&[[9.2, 2.0], [9.2, 5.0]]]).await;
    let settings = v1::MapSettings {
        keep: v1::map_settings::Keep::Words.into(),
        ..by_looks_request("", "").settings.unwrap()
    };
    let request = v1::CreateMapRequest { settings: Some(settings), ..map_request("words", &model.name) };
    let (code, message) = refused(client.create_map(request).await);
    assert_status("words alone", (code, &message), Code::InvalidArgument, "keep features");

    let ahead = v1::Camera {
        model: Some(v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: 1.2 })),
        ..v1::Camera::default()
    };
    let session = SessionOptions { camera: Some(ahead.clone()), ..session_options("looks", "ahead") };
    let (code, message) = refused(client.open_session(session).await);
    assert_status("a session", (code, &message), Code::FailedPrecondition, "takes panoramas");
    let good = || options(&panoramas, "robot");
    let label = |label: &str| to(v1::goal::Target::Label(label.to_owned()));
    let nowhere = v1::PositionGoal { part: 0, x_m: Some(1.0), y_m: Some(1.0), heading_rad: None };
    let mirror = v1::HyperbolicMirror {
        center_x_px: 256.0,
        center_y_px: 256.0,
        inner_radius_px: 40.0,
        outer_radius_px: 250.0,
        eccentricity: 1.4,
        ..v1::HyperbolicMirror::default()
    };
    let unwound =
        v1::Camera { model: Some(v1::camera::Model::HyperbolicMirror(mirror)), ..v1::Camera::default() };
    for (case, options, code, fragment) in [
        ("ahead", NavigationOptions { camera: ahead, ..good() }, Code::InvalidArgument, "takes panoramas"),
        ("no horizon", NavigationOptions { camera: unwound, ..good() }, Code::InvalidArgument, "horizon"),
        (
            "not by looks",
            NavigationOptions { map: "maps/drive".to_owned(), ..good() },
            Code::InvalidArgument,
            "strategy appearance",
        ),
        ("no label", NavigationOptions { goal: Some(label("attic")), ..good() }, Code::NotFound, "none has"),
        (
            "a position",
            NavigationOptions { goal: Some(to(v1::goal::Target::Position(nowhere))), ..good() },
            Code::FailedPrecondition,
            "no metres",
        ),
        (
            "no place",
            NavigationOptions { goal: Some(to(v1::goal::Target::PlaceNumber(99))), ..good() },
            Code::NotFound,
            "no node",
        ),
    ] {
        let (said, message) = refused(client.navigate(options).await);
        assert_status(case, (said, &message), code, fragment);
    }

    // Labels that are none, and places that are none.
    for (place, body, status, fragment) in [
        ("0", json!({ "label": "" }), StatusCode::BAD_REQUEST, "is no label"),
        ("0", json!({ "label": "a", "scope": "map" }), StatusCode::BAD_REQUEST, "\"scope\": \"space\""),
        ("999", json!({ "label": "a" }), StatusCode::NOT_FOUND, "list its places"),
    ] {
        let path = format!("/v1/maps/looks/places/{place}/label");
        let answer = ask(&server, Method::PUT, &path, body).await;
        assert_eq!(answer.status, status, "{}", answer.text());
        let message = answer.json()["error"]["message"].as_str().unwrap().to_owned();
        assert!(message.contains(fragment), "{message}");
    }
    let answer = get(&server, "/v1/maps/drive/appearance-graph").await;
    assert!(answer.status == StatusCode::CONFLICT && answer.text().contains("strategy appearance"));
    let none = ask(&server, Method::DELETE, "/v1/maps/looks/places/0/label", json!({})).await;
    assert!(none.status == StatusCode::NOT_FOUND && none.text().contains("has no label"), "{}", none.text());
    client.set_label("maps/looks/places/0", "hall", v1::LabelScope::Place).await.unwrap();
    client.set_label("maps/looks/places/1", "the end", v1::LabelScope::Place).await.unwrap();

    // One commander a robot.
    let mut navigation = client.navigate(good()).await.unwrap();
    let (code, message) = refused(client.navigate(good()).await);
    assert_status("a second one", (code, &message), Code::FailedPrecondition, "one commander at a time");

    // A label that no place has, with those that there are; by the stream and by REST.
    navigation.go_to(label("attic")).await.unwrap();
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    let NavigationEvent::GoalRefused(refusal) = event else { panic!("{event:?}") };
    assert!(said(&refusal.status).contains("there are the labels hall, the end"), "{refusal:?}");
    assert_eq!(refusal.goal, Some(label("attic")));
    let goal = "/v1/maps/looks/navigations/robot/goal";
    let answer = ask(&server, Method::PUT, goal, json!({ "label": "attic" })).await;
    assert!(answer.status == StatusCode::NOT_FOUND && answer.text().contains("hall, the end"));
    let both = ask(&server, Method::PUT, goal, json!({ "label": "hall", "place_number": 1 })).await;
    assert!(both.status == StatusCode::BAD_REQUEST && both.text().contains("one of them alone"));
    let robot = robot_at(&panoramas, taught[2].pose);
    navigation.go_to(v1::Goal { target: Some(v1::goal::Target::Image(b"nothing".to_vec())) }).await.unwrap();
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    assert!(matches!(&event, NavigationEvent::GoalRefused(refusal) if refusal.goal.is_none()), "{event:?}");

    // Without a goal it stands; a panorama of another size is none of the declared camera.
    let told = look(&panoramas, &robot, &mut navigation, 1).await;
    assert_eq!((told.status(), told.appearance), (v1::NavigationStatus::Idle, None));
    assert!(matches!(in_time(navigation.next()).await.unwrap(), Some(NavigationEvent::Seen(_))));
    let frame = |sequence, content| FrameInput {
        sequence,
        stamp_ns: 1_000_000_000 * sequence as i64,
        content: FrameContent::Image(content),
        odometry: None,
        note: String::new(),
    };
    for (case, wrong, fragment) in [
        ("another size", frame(2, crate::harness::images()[0].clone()), "declared with 512 x 128"),
        ("an old one", frame(1, panoramas.taken_at(taught[0].pose, 1)), "number frames upwards"),
    ] {
        navigation.see(wrong);
        let event = in_time(navigation.next()).await.unwrap().unwrap();
        let NavigationEvent::FrameRefused(refusal) = event else { panic!("{case}: {event:?}") };
        assert!(refusal.status.as_ref().unwrap().message.contains(fragment), "{case}: {refusal:?}");
    }
    // After all that the robot is led; while its own reflex drives it is blocked.
    navigation.go_to(label("hall")).await.unwrap();
    let waited = async {
        while client.navigation("maps/looks/navigations/robot").await.unwrap().goal.is_none() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    in_time(waited).await;
    navigation.see(frame(3, panoramas.taken_at(taught[4].pose, 1)));
    let mut guidance = navigation.guidance();
    let told =
        in_time(guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == 3_000_000_000)));
    let told = told.await.unwrap().clone().unwrap();
    assert_eq!(told.status(), v1::NavigationStatus::Following, "{told:?}");
    let heading_rad = told.appearance.unwrap().heading_rad.unwrap();
    // It looks along the corridor, and the hall lies behind it.
    assert!(heading_rad.abs() > 2.6 && told.command.unwrap().forward_m_s == 0.0, "{told:?}");
    navigation.report_reflex(3_100_000_000, true);
    let blocked = guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == 3_100_000_000));
    assert_eq!(in_time(blocked).await.unwrap().as_ref().unwrap().status(), v1::NavigationStatus::Blocked);
    navigation.report(Reading { stamp_ns: 3_000_000_000, odometry: v1::Odometry::default(), reflex: false });
    let refusal = async {
        loop {
            if let NavigationEvent::WheelsRefused(refusal) = navigation.next().await.unwrap().unwrap() {
                return refusal;
            }
        }
    };
    assert!(in_time(refusal).await.status.unwrap().message.contains("has no pose"));
    drop(navigation);
    server.stop().await;
}
