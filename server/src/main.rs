//! Wiring: configuration, logging, sockets, signals.

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use serde::Serialize;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;
use waypost_server::config::{Config, DataLocation, Flags, LogFormat, StorageAddress, unknown_variables};
use waypost_server::offline::{self, Finding, ListedToken, TokenLimits};
use waypost_server::{Exposed, Opening, Ports, Role, Served, Server, Tls, open_beside_others, share_heaps};

mod shell;

/// Tells robots where they have been before
///
/// Every setting can be given as a flag, as a variable in the environment (--data-dir is WAYPOST_DATA_DIR) or
/// in a TOML file (data_dir = "…"); what comes first in this list wins.
///
/// A server that starts without any model takes in the one that ships, called "shipped". One that has models is
/// left as it is.
#[derive(Parser)]
#[command(name = "waypost-server", version)]
struct Arguments {
    #[command(flatten)]
    flags: Flags,
    /// TOML file with settings (WAYPOST_CONFIG)
    #[arg(long, global = true, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the settings in force as TOML, and end
    #[arg(long)]
    print_config: bool,
    /// Look whether the server could start, say what is wrong, and end
    #[arg(long, conflicts_with = "print_config")]
    check: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    #[command(flatten)]
    Data(DataCommand),
    #[command(flatten)]
    Shell(shell::Command),
}

/// What is done with a data directory.
#[derive(Subcommand)]
enum DataCommand {
    /// Look after tokens while no server runs on the data directory; for a running one, see `waypost token`
    #[command(subcommand)]
    Token(TokenCommand),
    /// Look whether the server could start, say what is wrong, and end
    Check {
        /// Read all of the database, too, and say what is not as it was written; while no server runs on it
        #[arg(long)]
        deep: bool,
    },
    /// Write a copy of all that the data directory holds, also while a server runs on it, and read the copy through
    Backup {
        /// Where to; made if it is missing, and holds no database yet
        directory: PathBuf,
    },
    /// Bring all that one database holds into another: from SQLite to PostgreSQL, and back
    ///
    /// A server may run on the source, and is best asked for reads alone. What it takes in after the beginning is not
    /// brought over. Cut off, the command goes on where it was when it is given again.
    Migrate {
        /// A data directory, or postgres://USER@HOST/DATABASE
        #[arg(long, value_name = "SOURCE")]
        from: DataLocation,
        /// The same, which holds nothing yet
        #[arg(long, value_name = "TARGET")]
        to: DataLocation,
    },
    /// Make an empty data directory what a backup is, after reading all of that
    Restore {
        /// Where the backup was made
        directory: PathBuf,
    },
}

#[derive(Subcommand)]
enum TokenCommand {
    /// Make a token and print its secret, which is kept nowhere
    Create {
        /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit
        name: String,
        /// What its holder may do
        #[arg(long)]
        role: Role,
        #[command(flatten)]
        limits: TokenLimits,
    },
    /// List tokens by name
    #[command(visible_alias = "list")]
    Ls,
    /// Delete a token
    Rm {
        /// Name of the token
        name: String,
    },
}

#[tokio::main]
async fn main() -> ExitCode {
    match run(Arguments::parse()).await {
        Ok(code) => code,
        Err(error) => {
            eprintln!("waypost-server: {error:#}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: Arguments) -> anyhow::Result<ExitCode> {
    let Arguments { flags, config, print_config, check, command } = arguments;
    let named = || std::env::var_os("WAYPOST_CONFIG").filter(|path| !path.is_empty()).map(PathBuf::from);
    let load = || Config::load(&flags, config.or_else(named).as_deref(), std::env::vars_os());
    match command {
        Some(Command::Data(command)) => work_on_data(command, &load()?).await,
        Some(Command::Shell(command)) => {
            command.run(Arguments::command())?;
            Ok(ExitCode::SUCCESS)
        }
        None if print_config => {
            std::io::stdout().write_all(load()?.to_toml()?.as_bytes())?;
            Ok(ExitCode::SUCCESS)
        }
        None if check => report(&offline::check(&load()?).await),
        None => serve(load()?).await,
    }
}

async fn work_on_data(command: DataCommand, config: &Config) -> anyhow::Result<ExitCode> {
    match command {
        DataCommand::Token(command) => {
            offline::need_named_directory(config)?;
            look_after_tokens(command, config.location()).await
        }
        DataCommand::Check { deep: false } => report(&offline::check(config).await),
        DataCommand::Check { deep: true } => {
            offline::need_sqlite(&config.storage, "check --deep")?;
            offline::need_directory(&config.data_dir)?;
            let mut findings = offline::check_copy(config).await;
            findings.extend(offline::check_all(&config.data_dir).await?);
            report(&findings)
        }
        DataCommand::Backup { directory } => {
            offline::need_sqlite(&config.storage, "backup")?;
            report(&offline::make_backup(&config.data_dir, &directory).await?)
        }
        DataCommand::Migrate { mut from, mut to } => {
            // Of the one that may have them elsewhere.
            let is_from = matches!(from.storage, StorageAddress::Postgres(_));
            let of = if is_from { &mut from } else { &mut to };
            of.media = config.media.clone();
            let findings = offline::migrate(&from, &to).await?;
            eprintln!("all of {from} is in {to}; start a server on it");
            report(&findings)
        }
        DataCommand::Restore { directory } => {
            offline::need_sqlite(&config.storage, "restore")?;
            offline::restore_backup(&directory, &config.data_dir).await?;
            eprintln!("{} is restored; start a server on it", config.data_dir.display());
            Ok(ExitCode::SUCCESS)
        }
    }
}

async fn serve(config: Config) -> anyhow::Result<ExitCode> {
    share_heaps();
    let tls = config.tls_files().as_ref().map(Tls::load).transpose()?;
    start_log(&config.log, config.log_format)?;
    for variable in unknown_variables(std::env::vars_os()) {
        tracing::warn!(variable, "no setting has this name; it is left alone");
    }
    let stop = stop_when_asked()?;
    let location = config.location();
    match &location.storage {
        StorageAddress::Sqlite => {
            // One that will not listen makes no directory.
            if !config.allow_anonymous && !location.data_dir.exists() {
                Exposed::check_new([config.grpc_address, config.http_address])?;
            }
            let server = configured(Server::open(location.clone()).await?, &config, tls).await?;
            server.check_exposure([config.grpc_address, config.http_address])?;
            let (grpc, http) = bind_both(&config).await?;
            announce(config.ready_file.as_deref(), &grpc, &http)?;
            tell_of(&config, &grpc, &http)?;
            server.serve(grpc, http, stop.cancelled_owned()).await?;
        }
        StorageAddress::Postgres(_) => serve_beside_others(&config, tls, stop).await?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Serves whenever this server owns the database, and asks the one that does at other times.
async fn serve_beside_others(
    config: &Config,
    tls: Option<Tls>,
    stop: CancellationToken,
) -> anyhow::Result<()> {
    let (grpc, http) = bind_both(config).await?;
    let ports = Ports {
        grpc,
        http,
        tls: tls.clone(),
        strangers: config.strangers(),
        advertised_host: config.advertised_host.clone(),
        allow_anonymous: config.allow_anonymous,
    };
    announce(config.ready_file.as_deref(), &ports.grpc, &ports.http)?;
    let mut opening = Opening::First;
    loop {
        let opened = open_beside_others(&config.location(), &ports, opening, stop.cancelled()).await?;
        let Some(server) = opened else { return Ok(()) };
        let server = configured(server, config, tls.clone()).await?;
        tell_of(config, &ports.grpc, &ports.http)?;
        let (grpc, http) = ports.shared()?;
        match server.serve(grpc, http, stop.clone().cancelled_owned()).await? {
            Served::UntilStopped => return Ok(()),
            Served::UntilTakenOver => opening = Opening::Again,
        }
    }
}

/// A server as its settings have it.
async fn configured(server: Server, config: &Config, tls: Option<Tls>) -> anyhow::Result<Server> {
    let map_memory_bytes = config.map_memory_bytes();
    let strangers = config.strangers();
    let limits = config.limits();
    let Config {
        data_dir: _,
        storage: _,
        media: _,
        grpc_address: _,
        http_address: _,
        advertised_host: _,
        ready_file: _,
        log: _,
        log_format: _,
        allow_anonymous,
        map_memory_mib: _,
        stranger_connections: _,
        stranger_connections_per_address: _,
        stranger_time_s: _,
        wrong_tokens_per_minute,
        max_maps: _,
        max_sessions: _,
        max_kept_mib: _,
        cors_origins,
        tls_certificate: _,
        tls_key: _,
        tls_client_ca: _,
        tls_fleet_ca: _,
    } = config;
    let mut server = server
        .with_shipped_model()
        .await?
        .with_map_memory(map_memory_bytes)
        .with_strangers(strangers)
        .with_wrong_tokens_per_minute(*wrong_tokens_per_minute)
        .with_limits(limits)
        .with_cors_origins(cors_origins.clone());
    if let Some(tls) = tls {
        server = server.with_tls(tls);
    }
    if *allow_anonymous {
        server = server.allow_anonymous();
    }
    Ok(server)
}

fn tell_of(config: &Config, grpc: &TcpListener, http: &TcpListener) -> anyhow::Result<()> {
    let encrypted = config.tls_certificate.is_some();
    let (grpc, http) = (grpc.local_addr()?, http.local_addr()?);
    tracing::info!(%grpc, %http, tls = encrypted, data = %config.location(), "serving");
    Ok(())
}

/// Cancelled once the process is asked to stop. Asked again, it ends.
fn stop_when_asked() -> anyhow::Result<CancellationToken> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let stop = CancellationToken::new();
    let stopping = stop.clone();
    tokio::spawn(async move {
        let mut asked = async || {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
        };
        asked().await;
        tracing::info!("stopping");
        stopping.cancel();
        asked().await;
        tracing::warn!("asked to stop again: ending at once; what was acknowledged is on the disk");
        std::process::exit(1);
    });
    Ok(stop)
}

fn start_log(filter: &str, format: LogFormat) -> anyhow::Result<()> {
    let ansi = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt()
        .with_env_filter(EnvFilter::try_new(filter)?)
        .with_ansi(ansi)
        // Where nobody reads it any more, saying so would panic.
        .log_internal_errors(false)
        .with_writer(std::io::stderr);
    match format {
        LogFormat::Text => log.init(),
        LogFormat::Json => log.json().with_current_span(true).with_span_list(false).init(),
    }
    Ok(())
}

/// Where robots connect, and where people look.
async fn bind_both(config: &Config) -> anyhow::Result<(TcpListener, TcpListener)> {
    let grpc = bind(config.grpc_address, "--grpc-address").await?;
    Ok((grpc, bind(config.http_address, "--http-address").await?))
}

async fn bind(address: SocketAddr, option: &str) -> anyhow::Result<TcpListener> {
    TcpListener::bind(address).await.with_context(|| {
        format!("cannot listen on {address}; is a server running there? choose another with {option}")
    })
}

/// Tells where the server listens, in a file if one is named. It is written beside and renamed, so that a reader who waits
/// for it never reads half of it.
fn announce(file: Option<&Path>, grpc: &TcpListener, http: &TcpListener) -> anyhow::Result<()> {
    #[derive(Serialize)]
    struct Addresses {
        grpc: SocketAddr,
        http: SocketAddr,
    }
    let Some(file) = file else { return Ok(()) };
    let addresses = Addresses { grpc: grpc.local_addr()?, http: http.local_addr()? };
    let partial = file.with_extension("partial");
    let failed = || format!("cannot write the ready file {}", file.display());
    std::fs::write(&partial, serde_json::to_string(&addresses)?).with_context(failed)?;
    std::fs::rename(&partial, file).with_context(failed)
}

/// Says what was found; a failure if anything is wrong.
fn report(findings: &[Finding]) -> anyhow::Result<ExitCode> {
    let mut stdout = std::io::stdout().lock();
    let mut code = ExitCode::SUCCESS;
    writeln!(stdout, "ok     settings: they can be read")?;
    for Finding { subject, result } in findings {
        match result {
            Ok(there) => writeln!(stdout, "ok     {subject}: {there}")?,
            Err(wrong) => {
                writeln!(stdout, "wrong  {subject}: {wrong}")?;
                code = ExitCode::FAILURE;
            }
        }
    }
    Ok(code)
}

async fn look_after_tokens(command: TokenCommand, location: DataLocation) -> anyhow::Result<ExitCode> {
    let mut stdout = std::io::stdout().lock();
    match command {
        TokenCommand::Create { name, role, limits } => {
            let place = location.to_string();
            let secret = offline::create_token(location, &name, role, limits).await?;
            eprintln!(
                "this is the secret of {name} for the server of {place}; it is not kept there, so note it now:"
            );
            writeln!(stdout, "{secret}")?;
        }
        TokenCommand::Ls => {
            for ListedToken { name, role, limits } in offline::list_tokens(location).await? {
                let row = format!("{name}  {}  {limits}", role.name());
                writeln!(stdout, "{}", row.trim_end())?;
            }
        }
        TokenCommand::Rm { name } => {
            let left = offline::delete_token(location, &name).await?;
            eprintln!("deleted {name}");
            if left == 0 {
                eprintln!("no token is left: who reaches the server may do everything");
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}
