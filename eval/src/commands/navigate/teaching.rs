//! The drive that makes the map.

use anyhow::Result;
use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use nalgebra::Vector2;
use posegraph::PlanarPose;
use topomap::ids::FrameId;
use topomap::settings::MapperSettings;
use waypost_sim::drive::{Building, WHEN_MOVED};
use waypost_sim::people::{Behaviour, Person};
use waypost_sim::pose::Pose;
use waypost_sim::render::Shot;
use waypost_sim::robot::WheelErrors;
use waypost_sim::simulation::CameraTrigger;
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::GreyImage;
use waypost_vision::features::Extractor;

use super::{NavigateOptions, Trial};
use crate::commands::map::drive::{Drive, drive_through, grey};
use crate::commands::map::mapping::{Mapped, map};
use crate::commands::map::named_route;

/// How far from the way people wait, in metres.
const BESIDE_M: f64 = 0.8;

/// A way that was driven and mapped.
#[derive(Debug)]
pub(super) struct Taught {
    pub(super) building: Building,
    pub(super) wheels: WheelErrors,
    pub(super) drive: Drive,
    pub(super) mapped: Mapped,
    /// The last place of the way.
    pub(super) goal: PlaceId,
}

pub(super) fn teach(
    options: &NavigateOptions,
    seed: u64,
    (model, extractor): (&Model, Extractor),
) -> Result<Taught> {
    let (world, route) = match options.trial {
        Trial::Repeat | Trial::Sparse | Trial::Kidnapped | Trial::Facing | Trial::Stuck => {
            (options.world, named_route(options.world, &options.route)?)
        }
        Trial::Shortcut => (NamedWorld::Office, detour()),
    };
    let building = Building::named(world, seed, &route)?;
    let wheels = WheelErrors::drawn(2 * seed);
    let trigger = match options.trial {
        Trial::Sparse => CameraTrigger::Moved { distance_m: 0.05, angle_rad: 10_f64.to_radians() },
        Trial::Repeat | Trial::Shortcut | Trial::Kidnapped | Trial::Facing | Trial::Stuck => WHEN_MOVED,
    };
    let drive = drive_through(&building, 2 * seed, wheels, trigger)?;
    let mapped = map(&drive.frames, model, extractor, MapperSettings::default())?;
    let goal = mapped.log.frames().filter_map(|event| event.decision.place).last().unwrap_or(PlaceId::new(0));
    Ok(Taught { building, wheels, drive, mapped, goal })
}

/// A corridor, a way round through the ring of corridors and back into it, and on: the way round is not needed. As in
/// Bazeille, Battesti and Filliat 2011, figure 6.
fn detour() -> NamedRoute {
    let corners = [[6.0, 5.0], [13.0, 5.0], [13.0, 15.0], [5.0, 15.0], [5.0, 5.0], [21.0, 5.0]];
    NamedRoute { name: "detour", corners: corners.map(Vector2::from).to_vec(), length_m: None }
}

impl Taught {
    /// What a camera sees of the building.
    pub(super) fn image(&self, shot: &Shot) -> Result<GreyImage> {
        grey(&self.building.image(shot))
    }

    /// Where the robot really was when it took a frame of the map.
    pub(super) fn truth(&self, frame: FrameId) -> Option<PlanarPose> {
        Some(self.drive.frames.get(self.mapped.log.index(frame)?)?.truth)
    }

    /// Where it was when it made a place.
    pub(super) fn truth_of_place(&self, place: PlaceId) -> Option<PlanarPose> {
        let place = self.mapped.mapper.map().places().get(place.index())?;
        self.truth(place.frames.first()?.frame)
    }

    /// Where it really drove.
    pub(super) fn path(&self) -> Vec<Vector2<f64>> {
        self.drive.recording.ticks.iter().map(|tick| tick.truth.position()).collect()
    }

    pub(super) fn length_m(&self) -> f64 {
        self.drive.recording.length_m()
    }

    /// People who wait beside the way, where there is room for them, at even distances along it.
    pub(super) fn people_beside(&self, count: u32) -> Vec<(Person, Behaviour)> {
        let plan = self.drive.scene.plan();
        let ticks = &self.drive.recording.ticks;
        let beside = |number: u32| {
            let share = f64::from(number + 1) / f64::from(count + 1);
            let about = (share * ticks.len() as f64) as usize;
            let sides = ticks.iter().skip(about).flat_map(|tick| [-1.0, 1.0].map(|side| (tick.truth, side)));
            sides
                .map(|(way, side)| {
                    let across = Vector2::new(-way.heading_rad.sin(), way.heading_rad.cos());
                    way.position() + side * BESIDE_M * across
                })
                .find(|position| plan.clearance_m(*position) > 2.0 * Person::RADIUS_M)
        };
        let person = |number: u32| {
            let position = beside(number)?;
            let pose = Pose::new(position.x, position.y, 0.0);
            let behaviour = Behaviour::Blocking { notice_m: 2.0, patience_s: 6.0, speed_m_s: 0.7 };
            Some((Person { pose, look: u64::from(number) }, behaviour))
        };
        (0..count).filter_map(person).collect()
    }
}
