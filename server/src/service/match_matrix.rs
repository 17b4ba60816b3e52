//! Which places look alike: the match matrix of a map with itself, or with another of the same model.

mod axes;
mod cells;

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use fabmap::likelihood::ObservationModel;
use fabmap::likeness::evidence_of_itself;
use fabmap::observation::Observation;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use self::axes::{Axis, marks};
pub(crate) use self::axes::{AxisView, Mark, MarkView, SessionView};
pub(crate) use self::cells::TILE_CELLS;
use self::cells::shades;
use super::corrections::Corrections;
use crate::error::ServiceError;
use crate::ingest::model::{LoadedModel, LoadedModels};
use crate::names::{map_in, map_name};
use crate::open_map::{MapHandle, OpenMaps};
use crate::storage::{MapRow, Storage};

/// A cell of the last level is of 32 x 32 pairs, and a tile of 67 million: two to seven seconds of one core.
const MOST_LEVELS: u32 = 6;

/// Looks that are asked of a map's writer at a time: it has robots to answer.
const LOOKS_AT_A_TIME: usize = 128;

/// The model's samples that the shades are measured by.
const SCALING_SAMPLES: usize = 64;

/// The full shade where a model has no samples.
const FULL_SHADE_WITHOUT_SAMPLES_NATS: f64 = 100.0;

/// How a match matrix is laid out.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatrixView {
    /// `maps/{map}`, as all names.
    pub(crate) map: String,
    pub(crate) against: String,
    pub(crate) rows: AxisView,
    pub(crate) columns: AxisView,
    pub(crate) full_shade_nats: f64,
    pub(crate) levels: u32,
    pub(crate) marks: Vec<MarkView>,
}

/// Which tile of a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TileAt {
    pub(crate) level: u32,
    pub(crate) row: u32,
    pub(crate) column: u32,
}

/// A tile as a picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatrixTile {
    pub(crate) content_type: &'static str,
    pub(crate) picture: Vec<u8>,
}

/// Match matrices of maps. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct MatchMatrices {
    storage: Storage,
    models: LoadedModels,
    open_maps: OpenMaps,
    /// One tile at a time: it takes a core.
    turn: Arc<Semaphore>,
}

/// The two maps of a matrix.
struct Sides {
    model: Arc<LoadedModel>,
    /// As the settings of the map on the rows have it.
    observation_model: Arc<ObservationModel>,
    rows: Side,
    columns: Side,
    /// Whether they are one map.
    of_itself: bool,
}

struct Side {
    row: MapRow,
    handle: MapHandle,
    axis: Axis,
}

impl MatchMatrices {
    pub(super) fn new(storage: Storage, models: LoadedModels, open_maps: OpenMaps) -> Self {
        Self { storage, models, open_maps, turn: Arc::new(Semaphore::new(1)) }
    }

    /// How the matrix of a map is laid out, against itself where `against` is empty.
    pub(crate) async fn describe(&self, map: &str, against: &str) -> Result<MatrixView, ServiceError> {
        let sides = self.sides(map, against).await?;
        let Sides { model, observation_model, rows, columns, of_itself } = sides;
        let marks = if of_itself { self.marks(&rows).await? } else { Vec::new() };
        let levels = levels(rows.axis.len(), columns.axis.len());
        let scaled = tokio::task::spawn_blocking(move || full_shade_nats(&model, &observation_model));
        Ok(MatrixView {
            map: map_name(&rows.row.name),
            against: map_name(&columns.row.name),
            full_shade_nats: scaled.await.map_err(ServiceError::internal)?,
            levels,
            marks,
            rows: self.axis_view(rows).await?,
            columns: self.axis_view(columns).await?,
        })
    }

    /// A piece of that matrix.
    pub(crate) async fn tile(
        &self,
        map: &str,
        against: &str,
        at: TileAt,
    ) -> Result<MatrixTile, ServiceError> {
        let sides = self.sides(map, against).await?;
        let piece = Piece::of(sides, at)?;
        let turn = self.turn.clone().acquire_owned().await.map_err(|_| ServiceError::stopping())?;
        let abandoned = CancellationToken::new();
        let _abandon = abandoned.clone().drop_guard();
        let runtime = Handle::current();
        let drawing = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            piece.draw(&runtime, &abandoned)
        });
        let picture = drawing.await.map_err(ServiceError::internal)??;
        Ok(MatrixTile { content_type: "image/png", picture })
    }

    async fn sides(&self, map: &str, against: &str) -> Result<Sides, ServiceError> {
        let map = map_in(map)?;
        let other = if against.is_empty() { map } else { map_in(against)? };
        let (rows, columns) = (self.open_maps.row(map).await?, self.open_maps.row(other).await?);
        if rows.model != columns.model {
            return Err(ServiceError::precondition(format_args!(
                "the maps {map} and {other} have different models, so that a word of the one is another of the other; \
                 compare maps of one model, or rebuild one of them with the other's (waypost map rebuild)"
            )));
        }
        let model = self.models.get(&rows.model).await?;
        let of_itself = rows.id == columns.id;
        let (rows, observation_model) = self.side(rows).await?;
        let (columns, _) = self.side(columns).await?;
        Ok(Sides { model, observation_model, rows, columns, of_itself })
    }

    async fn side(&self, row: MapRow) -> Result<(Side, Arc<ObservationModel>), ServiceError> {
        let handle = self.open_maps.open_of(&row).await?;
        let (firsts, model) = handle.place_order().await?;
        Ok((Side { row, handle, axis: Axis::of(&firsts) }, model))
    }

    async fn axis_view(&self, side: Side) -> Result<AxisView, ServiceError> {
        let sessions = self.storage.sessions(side.row.id).await?;
        Ok(side.axis.view(&side.row.name, &sessions))
    }

    async fn marks(&self, side: &Side) -> Result<Vec<MarkView>, ServiceError> {
        let map = side.row.id;
        let closures = self.storage.loop_closures(map, None, u32::MAX).await?;
        let corrections = Corrections::read(&self.storage, map).await?;
        let standing = closures.iter().filter(|closure| !corrections.is_withdrawn(closure.position));
        let standing: Vec<_> = standing
            .map(|closure| (closure.frame.session, closure.position, PlaceId::new(closure.place)))
            .collect();
        let graph = side.handle.place_graph().await?;
        let axis = side.axis.clone();
        let marked = tokio::task::spawn_blocking(move || marks(&axis, *graph, &standing));
        marked.await.map_err(ServiceError::internal)
    }
}

/// Zoom levels of a matrix.
fn levels(rows: usize, columns: usize) -> u32 {
    let most = rows.max(columns);
    (1..MOST_LEVELS).find(|level| TILE_CELLS << (level - 1) >= most).unwrap_or(MOST_LEVELS)
}

fn full_shade_nats(model: &LoadedModel, observation_model: &ObservationModel) -> f64 {
    let samples = model.model.sampling_set().iter().take(SCALING_SAMPLES);
    let mut says: Vec<f64> = samples.map(|sample| evidence_of_itself(observation_model, sample)).collect();
    says.sort_by(f64::total_cmp);
    let median = says.get(says.len() / 2).copied().filter(|&nats| nats > 0.0);
    median.unwrap_or(FULL_SHADE_WITHOUT_SAMPLES_NATS)
}

/// What a tile is made of.
struct Piece {
    model: Arc<LoadedModel>,
    observation_model: Arc<ObservationModel>,
    rows: (MapHandle, Vec<PlaceId>),
    columns: (MapHandle, Vec<PlaceId>),
    level: u32,
}

impl Piece {
    fn of(sides: Sides, TileAt { level, row, column }: TileAt) -> Result<Self, ServiceError> {
        let Sides { model, observation_model, rows, columns, of_itself: _ } = sides;
        let levels = levels(rows.axis.len(), columns.axis.len());
        if level >= levels {
            return Err(ServiceError::invalid(format_args!(
                "the matrix has {levels} zoom levels, the last of them {}; level {level} is none",
                levels - 1
            )));
        }
        let places = |side: &Side, tile: u32| side.axis.tile(level, tile).map(<[PlaceId]>::to_vec);
        let (Some(shown), Some(against)) = (places(&rows, row), places(&columns, column)) else {
            let tiles = |side: &Side| side.axis.len().div_ceil(TILE_CELLS << level);
            return Err(ServiceError::not_found(format_args!(
                "the matrix has {} x {} tiles at level {level}, counted from 0; there is no tile {row}, {column}",
                tiles(&rows),
                tiles(&columns)
            )));
        };
        Ok(Self {
            model,
            observation_model,
            rows: (rows.handle, shown),
            columns: (columns.handle, against),
            level,
        })
    }

    /// Blocks.
    fn draw(self, runtime: &Handle, abandoned: &CancellationToken) -> Result<Vec<u8>, ServiceError> {
        let Self { model, observation_model, rows, columns, level } = self;
        let looks = |(map, places): &(MapHandle, Vec<PlaceId>)| {
            let mut looks: Vec<Observation> = Vec::with_capacity(places.len());
            for some in places.chunks(LOOKS_AT_A_TIME) {
                if abandoned.is_cancelled() {
                    return Err(nobody_waits());
                }
                looks.extend(runtime.block_on(map.usual_looks(some.to_vec()))?);
            }
            Ok(looks)
        };
        let (rows, columns) = (looks(&rows)?, looks(&columns)?);
        let full = full_shade_nats(&model, &observation_model);
        let is_wanted = || !abandoned.is_cancelled();
        let shades = shades(observation_model, (&rows, &columns), level, full, is_wanted);
        let shades = shades.ok_or_else(nobody_waits)?;
        let mut png = Vec::new();
        let side = TILE_CELLS as u32;
        let drawn = PngEncoder::new(&mut png).write_image(&shades, side, side, ExtendedColorType::L8);
        drawn.map_err(ServiceError::internal)?;
        Ok(png)
    }
}

fn nobody_waits() -> ServiceError {
    ServiceError::unavailable("the tile is wanted no more; ask for it again")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_as_many_levels_as_bring_all_into_a_tile_and_no_more_than_six() {
        for (places, expected) in [(0, 1), (256, 1), (257, 2), (512, 2), (513, 3), (8192, 6), (100_000, 6)] {
            assert_eq!((levels(places, 3), levels(0, places)), (expected, expected), "{places}");
        }
    }
}
