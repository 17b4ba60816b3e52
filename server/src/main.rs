//! Wiring: configuration, logging, sockets, signals.

use std::io::IsTerminal;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use clap::Parser;
use serde::Serialize;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;
use waypost_server::Server;
use waypost_server::config::Config;

#[tokio::main]
async fn main() -> ExitCode {
    match run().await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("waypost-server: {error:#}");
            ExitCode::FAILURE
        }
    }
}

async fn run() -> anyhow::Result<()> {
    let Config { data_dir, grpc_address, http_address, ready_file } = Config::parse();
    let filter = EnvFilter::try_from_env("WAYPOST_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let ansi = std::io::stderr().is_terminal();
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(ansi).with_writer(std::io::stderr).init();

    let server = Server::open(data_dir.clone()).await?;
    let grpc = bind(grpc_address, "--grpc-address").await?;
    let http = bind(http_address, "--http-address").await?;
    let (grpc_at, http_at) = (grpc.local_addr()?, http.local_addr()?);
    if let Some(file) = &ready_file {
        announce(file, &grpc_at.to_string(), &http_at.to_string())?;
    }
    tracing::info!(grpc = %grpc_at, http = %http_at, data_dir = %data_dir.display(), "serving");

    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    server
        .serve(grpc, http, async move {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
            tracing::info!("stopping");
        })
        .await
}

async fn bind(address: std::net::SocketAddr, option: &str) -> anyhow::Result<TcpListener> {
    TcpListener::bind(address).await.with_context(|| {
        format!("cannot listen on {address}; is a server running there? choose another with {option}")
    })
}

/// Written beside and renamed, so that whoever waits for the file never reads half of it.
fn announce(file: &Path, grpc: &str, http: &str) -> anyhow::Result<()> {
    #[derive(Serialize)]
    struct Addresses<'a> {
        grpc: &'a str,
        http: &'a str,
    }
    let partial = file.with_extension("partial");
    let failed = || format!("cannot write the ready file {}", file.display());
    std::fs::write(&partial, serde_json::to_string(&Addresses { grpc, http })?).with_context(failed)?;
    std::fs::rename(&partial, file).with_context(failed)
}
