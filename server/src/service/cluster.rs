//! The servers of the database, and how they and it do.

use super::jobs::Jobs;
use super::navigation::Navigation;
use super::streams::Streams;
use crate::error::ServiceError;
use crate::ingest::extraction::Extraction;
use crate::open_map::OpenMaps;
pub(crate) use crate::storage::StandbyRow;
use crate::storage::{ClusterRows, ServerRow, Storage, VERSION, cores, holder};

/// All servers of the database of this one, which owns it. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Cluster {
    pub(super) storage: Storage,
    pub(super) open_maps: OpenMaps,
    pub(super) extraction: Extraction,
    pub(super) streams: Streams,
    pub(super) navigation: Navigation,
    pub(super) jobs: Jobs,
}

/// The servers and their database.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClusterView {
    /// `None` for SQLite.
    pub(crate) epoch: Option<i64>,
    /// The owner first.
    pub(crate) servers: Vec<ServerView>,
    pub(crate) standbys: Vec<StandbyRow>,
    pub(crate) warnings: Vec<String>,
    pub(crate) load: Load,
}

/// A server.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ServerView {
    pub(crate) duty: Duty,
    pub(crate) holder: String,
    pub(crate) version: String,
    pub(crate) grpc_address: String,
    pub(crate) http_address: String,
    pub(crate) cores: u64,
    /// That it looked at for the owner; `None` if it is not asked.
    pub(crate) images: Option<u64>,
    pub(crate) silent_s: f64,
}

/// What a server does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Duty {
    Owner,
    Reserve,
}

/// What the owner has to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Load {
    pub(crate) open_maps: usize,
    pub(crate) open_streams: usize,
    pub(crate) robots_led: usize,
    pub(crate) images_waiting: usize,
    pub(crate) robots_in_line: usize,
    pub(crate) requests_waiting: usize,
    pub(crate) jobs_running: usize,
}

impl Cluster {
    /// The servers and their database, as they are now.
    pub(crate) async fn view(&self) -> Result<ClusterView, ServiceError> {
        let load = self.load();
        let own_images = Some(self.extraction.looked_at());
        Ok(match self.storage.cluster().await? {
            None => ClusterView {
                epoch: None,
                servers: vec![alone(own_images)],
                standbys: Vec::new(),
                warnings: Vec::new(),
                load,
            },
            Some(ClusterRows { epoch, owner, reserve, standbys, warnings }) => {
                let in_reserve = reserve
                    .into_iter()
                    .map(|row| server(Duty::Reserve, self.extraction.helped_by(row.id), row));
                let servers = std::iter::once(server(Duty::Owner, own_images, owner)).chain(in_reserve);
                ClusterView { epoch: Some(epoch), servers: servers.collect(), standbys, warnings, load }
            }
        })
    }

    fn load(&self) -> Load {
        let images = self.extraction.backlog();
        Load {
            open_maps: self.open_maps.count(),
            open_streams: self.streams.count(),
            robots_led: self.navigation.counts().iter().map(|(_status, robots)| robots).sum(),
            images_waiting: images.on_hand,
            robots_in_line: images.in_line,
            requests_waiting: self.open_maps.waiting_requests(),
            jobs_running: self.jobs.count(),
        }
    }
}

/// The one server of a database of SQLite. Nobody asks where it is.
fn alone(images: Option<u64>) -> ServerView {
    ServerView {
        duty: Duty::Owner,
        holder: holder(),
        version: VERSION.to_owned(),
        grpc_address: String::new(),
        http_address: String::new(),
        cores: cores() as u64,
        images,
        silent_s: 0.0,
    }
}

fn server(duty: Duty, images: Option<u64>, row: ServerRow) -> ServerView {
    let ServerRow { id: _, holder, version, grpc_address, http_address, cores, silent_s } = row;
    let cores = u64::try_from(cores).unwrap_or_default();
    ServerView { duty, holder, version, grpc_address, http_address, cores, images, silent_s }
}
