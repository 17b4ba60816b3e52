//! The servers of a database, as messages.

use waypost_proto::v1;
use waypost_proto::v1::cluster::Database;
use waypost_proto::v1::cluster_server::Role;

use crate::service::cluster::{ClusterView, Duty, Load, ServerView, StandbyRow};

pub(crate) fn cluster(view: ClusterView) -> v1::Cluster {
    let ClusterView { epoch, servers, standbys, warnings, load } = view;
    let database = if epoch.is_some() { Database::Postgres } else { Database::Sqlite };
    v1::Cluster {
        database: database.into(),
        epoch,
        servers: servers.into_iter().map(server).collect(),
        standbys: standbys.into_iter().map(standby).collect(),
        warnings,
        load: Some(cluster_load(load)),
    }
}

fn server(view: ServerView) -> v1::ClusterServer {
    let ServerView { duty, holder, version, grpc_address, http_address, cores, images, silent_s } = view;
    let role = match duty {
        Duty::Owner => Role::Owner,
        Duty::Reserve => Role::Reserve,
    };
    let cores = u32::try_from(cores).unwrap_or(u32::MAX);
    v1::ClusterServer {
        role: role.into(),
        holder,
        version,
        grpc_address,
        http_address,
        cores,
        images,
        silent_s,
    }
}

fn standby(row: StandbyRow) -> v1::Standby {
    let StandbyRow { name, state, sync_state, lag_bytes } = row;
    let lag_bytes = lag_bytes.map(|bytes| u64::try_from(bytes).unwrap_or_default());
    v1::Standby { name, state, sync_state, lag_bytes }
}

fn cluster_load(load: Load) -> v1::ClusterLoad {
    let Load {
        open_maps,
        open_streams,
        robots_led,
        images_waiting,
        robots_in_line,
        requests_waiting,
        jobs_running,
    } = load;
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    v1::ClusterLoad {
        open_maps: count(open_maps),
        open_streams: count(open_streams),
        robots_led: count(robots_led),
        images_waiting: count(images_waiting),
        robots_in_line: count(robots_in_line),
        requests_waiting: count(requests_waiting),
        jobs_running: count(jobs_running),
    }
}
