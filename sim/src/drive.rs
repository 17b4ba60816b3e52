//! The robot that demonstration, evaluation and tests drive: a camera that looks ahead, wheels, and a way through a building.

use std::f64::consts::PI;
use std::sync::Arc;

use crate::image::GreyImage;
use crate::render::{CameraRig, Shot};
use crate::robot::{Body, WheelErrors};
use crate::route::{Route, RouteError};
use crate::scene::Scene;
use crate::simulation::{CameraTrigger, Simulation, SimulationError, SimulationSettings};
use crate::worlds::{NamedRoute, NamedWorld};

pub use crate::rigs::{FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX, camera_rig};

/// Metres a second on straight ways.
pub const SPEED_M_S: f64 = 0.4;

/// An image every 50 cm or 10 degrees by the wheels, for mapping.
pub const WHEN_MOVED: CameraTrigger = CameraTrigger::Moved { distance_m: 0.5, angle_rad: 10.0 / 180.0 * PI };

/// Two images a second, for being led.
pub const TWICE_A_SECOND: CameraTrigger = CameraTrigger::Period { period_ns: 500_000_000 };

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
        let settings =
            SimulationSettings { wheels, seed, trigger, ..SimulationSettings::new(self.rig.clone()) };
        Simulation::new(self.scene.clone(), self.route.start(), settings)
    }

    /// What a robot's camera sees.
    #[must_use]
    pub fn image(&self, shot: &Shot) -> GreyImage {
        self.scene.render(&self.rig, shot)
    }
}
