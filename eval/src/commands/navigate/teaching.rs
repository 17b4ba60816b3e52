//! The drive that makes the map.

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use fabmap::model::Model;
use nalgebra::Vector2;
use topomap::event::FrameId;
use topomap::mapper::MapperSettings;
use topomap::relaxation::PlanarPose;
use waypost_sim::robot::{Body, WheelErrors};
use waypost_sim::route::Route;
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{CameraTrigger, SimulationSettings};
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::features::Extractor;

use super::{NavigateOptions, Trial};
use crate::commands::map::drive::{Drive, camera_rig, drive_along};
use crate::commands::map::mapping::{Mapped, map};
use crate::commands::map::{MapError, named_route};
use crate::error::EvalError;

/// A way that was driven and mapped.
#[derive(Debug)]
pub(super) struct Taught {
    pub(super) route: Route,
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
) -> Result<Taught, EvalError> {
    let (world, route) = match options.trial {
        Trial::Repeat | Trial::Sparse | Trial::Kidnapped | Trial::Facing => {
            (options.world, named_route(options.world, &options.route)?)
        }
        Trial::Shortcut => (NamedWorld::Office, detour()),
    };
    let scene = Arc::new(Scene::new(world.plan(seed)));
    let route = Route::named(scene.plan(), &route, Body::default().radius_m).map_err(MapError::from)?;
    let wheels = WheelErrors::drawn(2 * seed);
    let mut settings =
        SimulationSettings { wheels, seed: 2 * seed, ..SimulationSettings::new(camera_rig()?) };
    if options.trial == Trial::Sparse {
        settings.trigger = CameraTrigger::Moved { distance_m: 0.05, angle_rad: 10_f64.to_radians() };
    }
    let drive = drive_along(scene, &route, settings)?;
    let mut mapping = MapperSettings::default();
    if options.trial == Trial::Sparse {
        // The guard counts frames: the same ten metres as with an image every 50 cm.
        mapping.guard_frames *= 10;
    }
    let mapped = map(&drive.frames, model, extractor, mapping)?;
    let goal = mapped.log.frames().filter_map(|event| event.decision.place).last().unwrap_or(0);
    Ok(Taught { route, wheels, drive, mapped, goal })
}

/// A corridor, a way round through the ring of corridors and back into it, and on: the way round is not needed. As in
/// Bazeille, Battesti and Filliat 2011, figure 6.
fn detour() -> NamedRoute {
    let corners = [[6.0, 5.0], [13.0, 5.0], [13.0, 15.0], [5.0, 15.0], [5.0, 5.0], [21.0, 5.0]];
    NamedRoute { name: "detour", corners: corners.map(Vector2::from).to_vec(), length_m: None }
}

impl Taught {
    /// Where the robot really was when it took a frame of the map.
    pub(super) fn truth(&self, frame: FrameId) -> Option<PlanarPose> {
        let index = usize::try_from(self.mapped.log.frame(frame)?.sequence).ok()?;
        Some(self.drive.frames.get(index)?.truth)
    }

    /// Where it was when it made a place.
    pub(super) fn truth_of_place(&self, place: PlaceId) -> Option<PlanarPose> {
        let place = self.mapped.mapper.map().places().get(place as usize)?;
        self.truth(place.frames.first()?.frame)
    }

    /// Where it really drove.
    pub(super) fn path(&self) -> Vec<Vector2<f64>> {
        self.drive.recording.ticks.iter().map(|tick| tick.truth.position()).collect()
    }

    pub(super) fn length_m(&self) -> f64 {
        self.drive.recording.length_m()
    }
}
