//! The robots that demonstration, evaluation and tests drive: a camera that looks ahead or all around, wheels, and a way
//! through a building.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use crate::camera::Panorama;
use crate::image::GreyImage;
use crate::range_sensor::ReflexSettings;
use crate::render::{CameraRig, Shot};
use crate::robot::{Body, WheelErrors};
use crate::route::{Route, RouteError};
use crate::scene::Scene;
use crate::simulation::{CameraTrigger, Simulation, SimulationError, SimulationSettings};
use crate::worlds::{NamedRoute, NamedWorld};

pub use crate::rigs::{FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX, PANORAMA_SIZE_PX, camera_rig, panorama_rig};

/// Metres a second on straight ways.
pub const SPEED_M_S: f64 = 0.4;

/// An image every 50 cm or 10 degrees by the wheels, for mapping.
pub const WHEN_MOVED: CameraTrigger = CameraTrigger::Moved { distance_m: 0.5, angle_rad: 10.0 / 180.0 * PI };

/// Two images a second, for being led.
pub const TWICE_A_SECOND: CameraTrigger = CameraTrigger::Period { period_ns: 500_000_000 };

/// A panorama every 50 cm by the wheels, for mapping: one that turns on the spot sees nothing new.
pub const EVERY_HALF_METRE: CameraTrigger = CameraTrigger::Moved { distance_m: 0.5, angle_rad: TAU };

/// Four panoramas a second, for being led by looks.
pub const FOUR_A_SECOND: CameraTrigger = CameraTrigger::Period { period_ns: 250_000_000 };

/// What stops a robot that is led by looks: narrow doors are no reason.
pub const REFLEX_IN_DOORS: ReflexSettings =
    ReflexSettings { stop_m: 0.15, margin_m: 0.02, turn_rad_s: 0.8, ahead_ns: 600_000_000, ahead_m_s: 0.25 };

/// A building with a way through it, and the camera of the robots there.
#[derive(Debug)]
pub struct Building {
    /// The building.
    pub scene: Arc<Scene>,
    /// What robots see with.
    pub rig: CameraRig,
    /// The way.
    pub route: Route,
}

impl Building {
    /// # Errors
    /// [`RouteError`] if a robot does not fit along the way.
    pub fn new(scene: Arc<Scene>, route: &NamedRoute) -> Result<Self, RouteError> {
        let route = Route::named(scene.plan(), route, Body::default().radius_m)?;
        Ok(Self { scene, rig: camera_rig(), route })
    }

    /// A building of that name, its way, and the camera of the robots there.
    ///
    /// # Errors
    /// [`RouteError`] if a robot does not fit along the way.
    pub fn named(world: NamedWorld, seed: u64, route: &NamedRoute) -> Result<Self, RouteError> {
        let building = Self::new(Arc::new(Scene::new(world.plan(seed))), route)?;
        Ok(Self { rig: world.camera_rig(), ..building })
    }

    /// The same building for robots that look all around.
    #[must_use]
    pub fn seen_all_around(self, panorama: Panorama) -> Self {
        Self { rig: panorama_rig(panorama), ..self }
    }

    /// A robot at the way's start; `seed` is that of the noise of wheels and camera.
    ///
    /// # Errors
    /// [`SimulationError`] if a number of the wheels or the trigger is out of its range.
    pub fn robot(
        &self,
        wheels: WheelErrors,
        seed: u64,
        trigger: CameraTrigger,
    ) -> Result<Simulation, SimulationError> {
        let settings = SimulationSettings::new(self.rig.clone());
        let reflex = match self.rig.camera().panorama() {
            Some(Panorama::Cylindrical | Panorama::Equirectangular) => Some(REFLEX_IN_DOORS),
            None => settings.reflex,
        };
        let settings = SimulationSettings { wheels, seed, trigger, reflex, ..settings };
        Simulation::new(self.scene.clone(), self.route.start(), settings)
    }

    /// What a robot's camera sees.
    #[must_use]
    pub fn image(&self, shot: &Shot) -> GreyImage {
        self.scene.render(&self.rig, shot)
    }
}
