//! A camera that looks up into a hyperbolic mirror maps and leads as one of panoramas does.

use std::f64::consts::{PI, TAU};
use std::fs;

use image::{GrayImage, ImageFormat, Luma};
use serde_json::json;
use waypost_client::{Client, FrameContent, FrameInput, NavigationOptions, v1};
use waypost_sim::pose::Pose;
use waypost_vision::panorama::mirror::{HyperbolicMirror, MirrorSettings};

use crate::harness::{CommandLine, PANORAMA_PX, Panoramas, in_time, path, taught_at};

const WAY: &[[f64; 2]] = &[[9.2, 2.0], [9.2, 5.0]];
const CENTER_PX: [f64; 2] = [402.0, 398.0];
const RADII_PX: [f64; 2] = [80.0, 355.0];
const HORIZON_RADIUS_PX: f64 = 160.0;
const ECCENTRICITY: f64 = 1.4;
const AHEAD_RAD: f64 = 0.5;
const SIDE_PX: u32 = 800;

fn mirror() -> HyperbolicMirror {
    let parameter = 2.0 * ECCENTRICITY / (1.0 + ECCENTRICITY * ECCENTRICITY);
    HyperbolicMirror::new(MirrorSettings {
        center_px: CENTER_PX,
        radii_px: RADII_PX,
        horizon_radius_px: HORIZON_RADIUS_PX,
        parameter,
        ahead_rad: AHEAD_RAD,
    })
    .unwrap()
}

/// What the mirror shows of what a panorama shows.
fn wound(panorama: &GrayImage) -> Vec<u8> {
    let (mirror, (width, height)) = (mirror(), panorama.dimensions());
    let rad_per_px = TAU / f64::from(width);
    let image = GrayImage::from_fn(SIDE_PX, SIDE_PX, |column, row| {
        let right = f64::from(column) - CENTER_PX[0];
        let up = CENTER_PX[1] - f64::from(row);
        let elevation = mirror.elevation_rad(right.hypot(up));
        let azimuth = up.atan2(right) - AHEAD_RAD;
        let column = (PI - azimuth) / rad_per_px - 0.5;
        let row = (f64::from(height) - 1.0) / 2.0 - elevation.tan() / rad_per_px;
        if !(0.0..=f64::from(height) - 1.0).contains(&row) {
            return Luma([0]);
        }
        let (left, top) = (column.floor(), row.floor());
        let grey = |column: f64, row: f64| {
            let column = column.rem_euclid(f64::from(width)) as u32;
            f64::from(panorama.get_pixel(column, (row as u32).min(height - 1)).0[0])
        };
        let along = |row: f64| {
            let share = column - left;
            (1.0 - share) * grey(left, row) + share * grey(left + 1.0, row)
        };
        let share = row - top;
        Luma([((1.0 - share) * along(top) + share * along(top + 1.0)).round() as u8])
    });
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, ImageFormat::Png).unwrap();
    png.into_inner()
}

fn seen_from(panoramas: &Panoramas, pose: Pose, seed: u64) -> Vec<u8> {
    let panorama = image::load_from_memory(&panoramas.taken_at(pose, seed)).unwrap().to_luma8();
    assert_eq!(panorama.dimensions(), PANORAMA_PX);
    wound(&panorama)
}

fn camera() -> v1::Camera {
    let mirror = v1::HyperbolicMirror {
        center_x_px: CENTER_PX[0],
        center_y_px: CENTER_PX[1],
        inner_radius_px: RADII_PX[0],
        outer_radius_px: RADII_PX[1],
        eccentricity: ECCENTRICITY,
        horizon_radius_px: Some(HORIZON_RADIUS_PX),
        ahead_rad: AHEAD_RAD,
    };
    v1::Camera {
        model: Some(v1::camera::Model::HyperbolicMirror(mirror)),
        image_width_px: Some(SIDE_PX),
        image_height_px: Some(SIDE_PX),
        base_to_camera: None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mirror_leads_as_a_panorama_does() {
    let panoramas = Panoramas::new();
    let waypost = CommandLine::new();
    waypost.prepare();
    waypost.text(&["map", "create", "looks", "--model", "shipped", "--navigation-strategy", "appearance"]);
    let (folder, taught) = (tempfile::tempdir().unwrap(), taught_at(&[WAY]));
    let images = folder.path().join("images");
    fs::create_dir(&images).unwrap();
    for (number, pose) in (1..).zip(&taught) {
        fs::write(images.join(format!("{number:03}.png")), seen_from(&panoramas, *pose, number)).unwrap();
    }

    // A file that describes no mirror says what it lacks; one that cannot be is refused by the server.
    let file = folder.path().join("mirror.json");
    let stream = ["stream", path(folder.path()), "--map", "looks", "--mirror", path(&file)];
    assert!(waypost.fails(&stream).1.contains("mirror.json cannot be read"));
    let described = json!({
        "center_x_px": CENTER_PX[0], "center_y_px": CENTER_PX[1], "inner_radius_px": RADII_PX[0],
        "outer_radius_px": RADII_PX[1], "eccentricity": ECCENTRICITY, "horizon_radius_px": HORIZON_RADIUS_PX,
        "ahead_rad": AHEAD_RAD,
    });
    for (field, value, fragment) in [
        ("eccentricity", json!(null), "mirror.json describes no mirror"),
        ("focal_px", json!(3.0), "unknown field `focal_px`"),
        ("eccentricity", json!(0.5), "eccentricity"),
    ] {
        let mut wrong = described.clone();
        wrong[field] = value;
        fs::write(&file, wrong.to_string()).unwrap();
        let refusal = waypost.fails(&stream).1;
        assert!(refusal.contains(fragment), "{refusal}");
    }

    fs::write(&file, described.to_string()).unwrap();
    let streamed = waypost.json(&stream);
    assert_eq!(streamed["places_created"], json!(taught.len()), "{streamed}");
    let client = Client::connect(&waypost.endpoint()).await.unwrap();
    let graph = client.appearance_graph("looks").await.unwrap();
    assert_eq!(graph.nodes.len(), taught.len());
    for place in 1..taught.len() as u32 {
        let is_next =
            |link: &v1::AppearanceLink| (link.from_place_number, link.to_place_number) == (place - 1, place);
        assert!(graph.links.iter().any(is_next), "{place} of {:?}", graph.links);
    }

    // Turned anywhere, at one end, it is led to the other one: straight along the line.
    let options = NavigationOptions {
        navigation_id: "robot".to_owned(),
        goal: Some(v1::Goal { target: Some(v1::goal::Target::PlaceNumber(taught.len() as u32 - 1)) }),
        ..NavigationOptions::new("looks", camera())
    };
    let navigation = client.navigate(options).await.unwrap();
    let along_rad = taught[0].heading_rad;
    for (sequence, heading_rad) in (1_u64..).zip([-2.0, 0.3, 1.4, 2.9]) {
        let pose = Pose { heading_rad, ..taught[0] };
        let stamp_ns = sequence as i64 * 1_000_000_000;
        let content = FrameContent::Image(seen_from(&panoramas, pose, 700 + sequence));
        let mut guidance = navigation.guidance();
        navigation.see(FrameInput { sequence, stamp_ns, content, odometry: None, note: String::new() });
        let told = guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == stamp_ns));
        let told = in_time(told).await.unwrap().clone().unwrap();
        let heading = told.appearance.and_then(|by_looks| by_looks.heading_rad);
        let heading = heading.unwrap_or_else(|| panic!("{told:?}"));
        let error = heading - (along_rad - heading_rad);
        assert!(error.sin().atan2(error.cos()).abs() < 0.15, "turned to {heading_rad}: {told:?}");
    }
    drop(navigation);
}
