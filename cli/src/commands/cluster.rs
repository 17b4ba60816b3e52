//! `waypost cluster`: the servers of a database, and how they do.

use std::io::{self, Write};

use waypost_client::{Client, ClientOptions, v1};

use crate::failure::Failure;
use crate::output::{Output, rounded, table};

/// Show the servers of the database, which of them owns it, what it has to do, and the database's standbys
///
/// Whichever server is asked, the owner answers. Asks for a token of an administrator of the whole server, where it has
/// tokens.
#[derive(clap::Args)]
pub(crate) struct Arguments {}

pub(crate) async fn run(
    Arguments {}: Arguments,
    server: &ClientOptions,
    output: Output,
) -> Result<(), Failure> {
    let cluster = Client::connect(server).await?.cluster().await?;
    output.result(&cluster, |out| show(out, &cluster))
}

fn show(out: &mut dyn Write, cluster: &v1::Cluster) -> io::Result<()> {
    let v1::Cluster { database, epoch, servers, standbys, warnings, load } = cluster;
    let database = match v1::cluster::Database::try_from(*database) {
        Ok(v1::cluster::Database::Postgres) => "PostgreSQL",
        Ok(v1::cluster::Database::Sqlite) => "SQLite",
        Ok(v1::cluster::Database::Unspecified) | Err(_) => "of a kind that this version does not know",
    };
    match epoch {
        Some(epoch) => writeln!(out, "database {database}, epoch {epoch}")?,
        None => writeln!(out, "database {database}, which has one server")?,
    }
    let headings = ["ROLE", "SERVER", "VERSION", "CORES", "IMAGES", "GRPC", "HTTP", "SILENT"];
    table(out, headings, servers.iter().map(server_row))?;
    if !standbys.is_empty() {
        table(out, ["STANDBY", "STATE", "SYNC", "LACKS"], standbys.iter().map(standby_row))?;
    }
    if let Some(load) = load {
        writeln!(out, "load {}", load_in_words(load))?;
    }
    warnings.iter().try_for_each(|warning| writeln!(out, "warning {warning}"))
}

fn server_row(server: &v1::ClusterServer) -> [String; 8] {
    let v1::ClusterServer { role: _, holder, version, grpc_address, http_address, cores, images, silent_s } =
        server;
    let role = match server.role() {
        v1::cluster_server::Role::Owner => "owner",
        v1::cluster_server::Role::Reserve => "reserve",
        v1::cluster_server::Role::Unspecified => "unknown",
    };
    [
        role.to_owned(),
        holder.clone(),
        said(version),
        cores.to_string(),
        images.map_or_else(|| "not asked".to_owned(), |images| images.to_string()),
        said(grpc_address),
        said(http_address),
        format!("{} s", rounded(*silent_s, 1)),
    ]
}

fn standby_row(standby: &v1::Standby) -> [String; 4] {
    let v1::Standby { name, state, sync_state, lag_bytes } = standby;
    let lacks = lag_bytes.map_or_else(|| "unknown".to_owned(), |bytes| format!("{bytes} bytes"));
    [name.clone(), state.clone(), sync_state.clone(), lacks]
}

fn load_in_words(load: &v1::ClusterLoad) -> String {
    let v1::ClusterLoad {
        open_maps,
        open_streams,
        robots_led,
        images_waiting,
        robots_in_line,
        requests_waiting,
        jobs_running,
    } = load;
    format!(
        "open maps {open_maps}, streams {open_streams}, robots led {robots_led}, images waiting {images_waiting}, \
         robots in line {robots_in_line}, requests waiting {requests_waiting}, jobs {jobs_running}"
    )
}

fn said(text: &str) -> String {
    if text.is_empty() { "-".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn servers_standbys_and_warnings_are_lines() {
        let server = |role: v1::cluster_server::Role, images| v1::ClusterServer {
            role: role.into(),
            holder: "hall-1, process 7".to_owned(),
            version: "0.1.0".to_owned(),
            grpc_address: "hall-1:7600".to_owned(),
            http_address: String::new(),
            cores: 2,
            images,
            silent_s: 0.25,
        };
        let cluster = v1::Cluster {
            database: v1::cluster::Database::Postgres.into(),
            epoch: Some(3),
            servers: vec![
                server(v1::cluster_server::Role::Owner, Some(40)),
                server(v1::cluster_server::Role::Reserve, None),
            ],
            standbys: vec![v1::Standby {
                name: "two".to_owned(),
                state: "streaming".to_owned(),
                sync_state: "quorum".to_owned(),
                lag_bytes: None,
            }],
            warnings: vec!["fsync is off".to_owned()],
            load: Some(v1::ClusterLoad { open_maps: 1, ..v1::ClusterLoad::default() }),
        };
        let mut out = Vec::new();
        show(&mut out, &cluster).unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "database PostgreSQL, epoch 3");
        assert!(lines[2].starts_with("owner    hall-1, process 7  0.1.0    2      40"), "{text}");
        assert!(lines[3].starts_with("reserve") && lines[3].contains("not asked"), "{text}");
        assert_eq!(lines[5], "two      streaming  quorum  unknown");
        assert!(lines[6].starts_with("load open maps 1, streams 0"), "{text}");
        assert_eq!(lines[7], "warning fsync is off");
    }
}
