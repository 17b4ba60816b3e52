//! What the renderer shows, held to the geometry of pinholes and cylinders.
#![expect(clippy::unwrap_used, reason = "a test's own inputs are valid")]

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector2;
use proptest::prelude::*;
use waypost_sim::camera::Camera;
use waypost_sim::floor_plan::{FloorPlan, Furniture, PlanParts, Room, Wall};
use waypost_sim::image::GreyImage;
use waypost_sim::light::{Light, LightSettings};
use waypost_sim::people::Person;
use waypost_sim::pose::Pose;
use waypost_sim::render::{CameraRig, Mount, Sensor, Shot};
use waypost_sim::scene::Scene;
use waypost_sim::texture::{Material, Surface};
use waypost_sim::worlds::NamedWorld;

const HEIGHT_M: f64 = 1.0;
const CEILING_M: f64 = 2.6;

/// A hall of 12 x 8 m about the origin, with walls that are bright and furniture that is dark.
fn hall(furniture: Vec<Furniture>) -> Scene {
    let (min, max) = (Vector2::new(-6.0, -4.0), Vector2::new(6.0, 4.0));
    let corners = [min, Vector2::new(max.x, min.y), max, Vector2::new(min.x, max.y)];
    let bright = Surface::unique(Material::CeilingBoards, 1, 1);
    let walls = (0..4).map(|side| Wall {
        from: corners[side],
        to: corners[(side + 1) % 4],
        bottom_m: 0.0,
        top_m: CEILING_M,
        surfaces: [bright.part(side as u64); 2],
    });
    let room = Room {
        name: "hall".to_owned(),
        min,
        max,
        floor: bright.part(8),
        ceiling: bright.part(9),
        quarter_turns: 0,
    };
    let parts = PlanParts {
        ceiling_m: CEILING_M,
        rooms: vec![room],
        walls: walls.collect(),
        furniture,
        doors: vec![],
    };
    Scene::new(FloorPlan::new(parts).unwrap())
}

/// A post of plain dark wood.
fn post(x_m: f64, y_m: f64, side_m: f64, top_m: f64) -> Furniture {
    let dark = Surface::unique(Material::Wood, 3, 3);
    Furniture {
        pose: Pose::new(x_m, y_m, 0.3),
        size_m: [side_m; 2],
        bottom_m: 0.0,
        top_m,
        sides: dark,
        lid: dark,
    }
}

fn rig(camera: Camera) -> CameraRig {
    let sensor = Sensor { exposure_s: 0.0, noise_sigma: 0.0, softness: 0.0 };
    CameraRig::new(camera, Mount { forward_m: 0.0, height_m: HEIGHT_M, yaw_rad: 0.0 }, sensor).unwrap()
}

fn perspective() -> CameraRig {
    rig(Camera::perspective([250.0, 240.0], [162.0, 117.0], (320, 240)).unwrap())
}

fn panorama() -> CameraRig {
    rig(Camera::cylindrical((720, 200)).unwrap())
}

fn shot(pose: Pose) -> Shot {
    // Posts are darker than anything else in this light.
    let settings =
        LightSettings { gain: 1.0, gamma: 1.0, lamp_spread: 0.0, directed: 0.0, from_rad: 0.0, seed: 0 };
    Shot { pose, speed: [0.0; 2], people: Vec::new(), light: Light::new(settings).unwrap(), seed: 1 }
}

/// Mean column and row of the pixels that something changed, and how many they are.
fn changed(before: &GreyImage, after: &GreyImage) -> Option<([f64; 2], [f64; 2], usize)> {
    let width = before.width_px() as usize;
    let differ = |index: &usize| before.pixels()[*index].abs_diff(after.pixels()[*index]) > 3;
    let places: Vec<[f64; 2]> = (0..before.pixels().len())
        .filter(differ)
        .map(|index| [(index % width) as f64, (index / width) as f64])
        .collect();
    let extreme =
        |axis: usize, pick: fn(f64, f64) -> f64| places.iter().map(|place| place[axis]).reduce(pick);
    let columns = [extreme(0, f64::min)?, extreme(0, f64::max)?];
    let rows = [extreme(1, f64::min)?, extreme(1, f64::max)?];
    Some((columns, rows, places.len()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A thin post lands on the columns and rows that the pinhole formulas say, wherever camera and
    /// post are.
    #[test]
    fn a_post_lands_where_a_pinhole_puts_it(
        [x, y] in [-2.0..2.0f64, -1.5..1.5], heading in -PI..PI, ahead in 1.0..1.9f64, aside in -0.4..0.4f64,
        top in 0.5..0.9f64,
    ) {
        let robot = Pose::new(x, y, heading);
        let at = robot.compose(&Pose::new(ahead, ahead * aside, 0.0));
        let (empty, with_post) = (hall(vec![]), hall(vec![post(at.x_m, at.y_m, 0.06, top)]));
        let camera = perspective();
        let images = [&empty, &with_post].map(|scene| scene.render(&camera, &shot(robot)));
        let ([left, right], [upper, lower], _) = changed(&images[0], &images[1]).expect("the post is seen");
        // By hand: u = 162 - 250 y / x, v = 117 - 240 z / x.
        let column = 162.0 - 250.0 * aside;
        let half = 250.0 * 0.043 / (ahead - 0.043) * (1.0 + aside.abs()) + 1.5;
        prop_assert!((f64::midpoint(left, right) - column).abs() < 2.5, "columns {left} to {right}, not about {column}");
        prop_assert!(right - left < 2.0 * half);
        let row_of_top = |x: f64| 117.0 - 240.0 * (top - HEIGHT_M) / x;
        prop_assert!(upper >= row_of_top(ahead + 0.06) - 2.0 && upper <= row_of_top(ahead - 0.06) + 2.0);
        let row_of_foot = 117.0 + 240.0 * HEIGHT_M / (ahead - 0.06);
        prop_assert!(lower >= (row_of_foot - 22.0).min(237.0) && lower <= row_of_foot + 2.0, "foot at {lower}");
        // And so say the camera's own formulas.
        let projected = camera.camera().project(&nalgebra::Vector3::new(ahead, ahead * aside, top - HEIGHT_M)).unwrap();
        prop_assert!((projected[0] - column).abs() < 1e-9 && (projected[1] - row_of_top(ahead)).abs() < 1e-9);
    }

    /// In a panorama columns are azimuths, and left is left of the middle.
    #[test]
    fn a_post_lands_at_its_azimuth_in_a_panorama(heading in -PI..PI, azimuth in -PI..PI, away in 1.0..3.0f64) {
        let robot = Pose::new(0.3, -0.2, heading);
        let at = robot.compose(&Pose::new(away * azimuth.cos(), away * azimuth.sin(), 0.0));
        let scenes = [hall(vec![]), hall(vec![post(at.x_m, at.y_m, 0.05, 2.0)])];
        let images = scenes.map(|scene| scene.render(&panorama(), &shot(robot)));
        let column = (PI - azimuth) / TAU * 720.0 - 0.5;
        prop_assume!((15.0..705.0).contains(&column));
        let ([left, right], _, _) = changed(&images[0], &images[1]).expect("the post is seen");
        prop_assert!((f64::midpoint(left, right) - column).abs() < 1.6, "columns {left} to {right}, not {column}");
    }
}

#[test]
fn left_is_left_and_turning_left_moves_the_image_to_the_right() {
    // Ahead on the left: y above 0.
    let scenes = [hall(vec![]), hall(vec![post(2.0, 0.4, 0.1, 1.2)])];
    let columns_at = |heading_rad: f64| {
        let [before, after] = [0, 1].map(|scene: usize| {
            scenes[scene].render(&perspective(), &shot(Pose::new(0.0, 0.0, heading_rad)))
        });
        changed(&before, &after).unwrap().0
    };
    let ahead = columns_at(0.0);
    assert!(ahead[1] < 162.0, "a post on the left is seen at columns {ahead:?}");
    let turned = columns_at(0.15);
    assert!(turned[0] > ahead[0] + 20.0, "after a turn to the left {ahead:?} became {turned:?}");
}

#[test]
fn what_is_nearer_hides_what_is_behind() {
    let (near, far) = (post(1.5, 0.0, 0.3, 2.0), post(3.0, 0.0, 0.2, 1.9));
    let image = |furniture| hall(furniture).render(&perspective(), &shot(Pose::default()));
    let (neither, both) = (image(vec![]), image(vec![far.clone(), near.clone()]));
    assert_eq!(image(vec![near]), both, "the far post shows through");
    let seen = changed(&neither, &image(vec![far])).unwrap();
    let hidden_behind = changed(&neither, &both).unwrap();
    assert!(hidden_behind.2 > 2 * seen.2 && hidden_behind.0[0] < seen.0[0] && hidden_behind.0[1] > seen.0[1]);
}

#[test]
fn one_looks_onto_what_is_lower_and_under_what_is_higher() {
    let table = Furniture { bottom_m: 0.7, top_m: 0.75, size_m: [0.8, 0.8], ..post(1.5, 0.0, 0.8, 1.0) };
    let lamp = Furniture { bottom_m: 1.8, top_m: 1.85, ..table.clone() };
    let before = hall(vec![]).render(&perspective(), &shot(Pose::default()));
    let rows = |item: Furniture, turned: f64| {
        let item = Furniture { pose: Pose::new(1.5, 0.0, turned), ..item };
        let after = hall(vec![item]).render(&perspective(), &shot(Pose::default()));
        changed(&before, &after).unwrap().1
    };
    let row = |z: f64, x: f64| 117.0 - 240.0 * (z - HEIGHT_M) / x;
    // From the far edge of the top to the lower edge of the front, which are 1.9 and 1.1 m away.
    let [upper, lower] = rows(table, 0.0);
    assert!(
        (upper - row(0.75, 1.9)).abs() < 1.6 && (lower - row(0.7, 1.1)).abs() < 1.6,
        "rows {upper} to {lower}"
    );
    let [upper, lower] = rows(lamp, 0.0);
    assert!(upper < 1.0 && (lower - row(1.8, 1.9)).abs() < 1.6, "rows {upper} to {lower}");
}

#[test]
fn a_panorama_goes_round_without_a_seam() {
    let scene = hall(vec![post(-1.5, 0.2, 0.4, 1.5), post(1.0, 2.0, 0.4, 1.0)]);
    for camera in [Camera::cylindrical((720, 200)), Camera::equirectangular((720, 200))] {
        let rig = rig(camera.unwrap());
        let ahead = scene.render(&rig, &shot(Pose::default()));
        // A quarter turn to the left shifts by a quarter of the image to the right, over the edge.
        let turned = scene.render(&rig, &shot(Pose::new(0.0, 0.0, FRAC_PI_2)));
        let off =
            (0..200).flat_map(|row| (0..720).map(move |column| (row, column))).filter(|&(row, column)| {
                ahead.at(column, row).abs_diff(turned.at((column + 180) % 720, row)) > 2
            });
        let share = off.count() as f64 / (720.0 * 200.0);
        assert!(share < 0.002, "{share} of the pixels are elsewhere after a turn");
        assert_ne!(ahead, turned);
    }
}

/// The same office in two buildings, seen from its middle away from its door.
#[test]
fn an_office_looks_the_same_wherever_it_is() {
    let views = [NamedWorld::BuildingA, NamedWorld::BuildingB].map(|world| {
        let scene = Scene::new(world.plan(3));
        let view = |name: &str| {
            let door = scene.plan().parts().doors.iter();
            let middle = scene.plan().room(name).unwrap().center();
            let nearest =
                door.min_by(|a, b| (a.position - middle).norm().total_cmp(&(b.position - middle).norm()));
            let away = middle - nearest.unwrap().position;
            let pose = Pose::new(middle.x, middle.y, away.y.atan2(away.x));
            scene.render(&perspective(), &shot(pose))
        };
        ["office 1", "office 2", "office 5"].map(view)
    });
    let unlike = |a: &GreyImage, b: &GreyImage| {
        let off = a.pixels().iter().zip(b.pixels()).filter(|(a, b)| a.abs_diff(**b) > 6).count();
        off as f64 / a.pixels().len() as f64
    };
    let [in_a, in_b] = views;
    for (office, (a, b)) in in_a.iter().zip(&in_b).enumerate() {
        assert!(unlike(a, b) < 0.01, "office {office} differs in {} of its pixels", unlike(a, b));
        assert!(unlike(a, &in_b[(office + 1) % 3]) > 0.5);
    }
}

#[test]
fn a_person_before_the_camera_hides_most_of_the_view() {
    let scene = hall(vec![post(3.0, 0.5, 0.4, 1.8)]);
    let blocked = |people| scene.render(&perspective(), &Shot { people, ..shot(Pose::default()) });
    // 20 cm before the hull of a robot of 20 cm.
    let person = Person { pose: Pose::new(0.2 + 0.2 + Person::RADIUS_M, 0.0, PI), look: 1 };
    let (free, hidden) = (blocked(vec![]), blocked(vec![person]));
    let (_, _, pixels) = changed(&free, &hidden).unwrap();
    assert!(pixels > 320 * 240 / 2, "{pixels} pixels differ");
    // Half the angle that the body takes is asin (radius / distance).
    let edge = (Person::RADIUS_M / 0.62_f64).asin().tan();
    let columns = changed(&free, &hidden).unwrap().0;
    assert!(
        (columns[0] - (162.0 - 250.0 * edge)).abs() < 3.0
            && (columns[1] - (162.0 + 250.0 * edge)).abs() < 3.0
    );
}

#[test]
fn light_and_exposure_do_what_they_say() {
    let scene = hall(vec![post(2.0, 0.0, 0.3, 2.0)]);
    let mean = |image: &GreyImage| {
        image.pixels().iter().map(|&grey| f64::from(grey)).sum::<f64>() / image.pixels().len() as f64
    };
    let settings =
        LightSettings { gain: 1.0, gamma: 1.0, lamp_spread: 0.0, directed: 0.0, from_rad: 0.0, seed: 0 };
    let lit = |settings| {
        let light = Light::new(settings).unwrap();
        scene.render(&perspective(), &Shot { light, ..shot(Pose::default()) })
    };
    let plain = mean(&lit(settings));
    assert!((mean(&lit(LightSettings { gain: 0.5, ..settings })) / plain - 0.5).abs() < 0.01);
    assert!(mean(&lit(LightSettings { gamma: 2.0, ..settings })) < plain);
    assert!(Light::new(LightSettings { gain: 0.0, ..settings }).is_err());
    let noisy = Sensor { exposure_s: 0.0, noise_sigma: 4.0, softness: 0.0 };
    let with_sensor = |sensor, speed| {
        let rig = CameraRig::new(perspective().camera().clone(), *perspective().mount(), sensor).unwrap();
        scene.render(&rig, &Shot { speed, ..shot(Pose::default()) })
    };
    let clean = lit(settings);
    let noise = with_sensor(noisy, [0.0; 2]);
    let off: Vec<f64> =
        clean.pixels().iter().zip(noise.pixels()).map(|(a, b)| f64::from(*b) - f64::from(*a)).collect();
    let sigma = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
    assert!((sigma - 4.0).abs() < 0.3, "noise of {sigma}");
    // Turning at 1 rad/s for 40 ms moves the edges of the post over 10 pixels.
    let sharp = |image: &GreyImage| {
        (100..220).map(|x| image.at(x, 117).abs_diff(image.at(x + 1, 117))).max().unwrap()
    };
    let blurred = with_sensor(Sensor { exposure_s: 0.04, noise_sigma: 0.0, softness: 0.0 }, [0.0, 1.0]);
    assert!(sharp(&blurred) * 2 < sharp(&clean), "{} after {}", sharp(&blurred), sharp(&clean));
}
