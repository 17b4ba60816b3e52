//! Wiring: configuration, logging, sockets, signals.

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use serde::Serialize;
use tokio::net::TcpListener;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing_subscriber::EnvFilter;
use waypost_server::config::{Config, DataLocation, Flags, LogFormat, StorageAddress, unknown_variables};
use waypost_server::offline::{self, Finding, ListedToken, TokenLimits};
use waypost_server::{Ports, Role, Server, Tls, open_beside_others};

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
        DataCommand::Token(command) => look_after_tokens(command, config.location()).await,
        DataCommand::Check { deep: false } => report(&offline::check(config).await),
        DataCommand::Check { deep: true } => {
            offline::need_sqlite(&config.storage, "check --deep")?;
            let mut findings = offline::check(config).await;
            findings.extend(offline::check_all(&config.data_dir).await?);
            report(&findings)
        }
        DataCommand::Backup { directory } => {
            offline::need_sqlite(&config.storage, "backup")?;
            report(&offline::make_backup(&config.data_dir, &directory).await?)
        }
        DataCommand::Migrate { from, to } => {
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
    let tls = config.tls_files().as_ref().map(Tls::load).transpose()?;
    let map_memory_bytes = config.map_memory_bytes();
    let strangers = config.strangers();
    let limits = config.limits();
    let location = config.location();
    let Config {
        data_dir: _,
        storage: _,
        grpc_address,
        http_address,
        advertised_host,
        ready_file,
        log,
        log_format,
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
    start_log(&log, log_format)?;
    for variable in unknown_variables(std::env::vars_os()) {
        tracing::warn!(variable, "no setting has this name; it is left alone");
    }

    let mut asked =
        Asked { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? };
    let encrypted = tls.is_some();
    let (server, grpc, http) = match &location.storage {
        StorageAddress::Sqlite => {
            let server = Server::open(location.clone()).await?;
            let server = if allow_anonymous { server.allow_anonymous() } else { server };
            server.check_exposure([grpc_address, http_address])?;
            (server, bind(grpc_address, "--grpc-address").await?, bind(http_address, "--http-address").await?)
        }
        StorageAddress::Postgres(_) => {
            let ports = Ports {
                grpc: bind(grpc_address, "--grpc-address").await?,
                http: bind(http_address, "--http-address").await?,
                tls: tls.clone(),
                strangers,
                advertised_host,
                allow_anonymous,
            };
            // What is asked while another server owns the database is answered, too.
            announce(ready_file.as_deref(), &ports.grpc, &ports.http)?;
            let opened = open_beside_others(&location, &ports, asked.to_stop()).await?;
            let Some(server) = opened else { return Ok(ExitCode::SUCCESS) };
            let server = if allow_anonymous { server.allow_anonymous() } else { server };
            (server, ports.grpc, ports.http)
        }
    };
    let mut server = server
        .with_shipped_model()
        .await?
        .with_map_memory(map_memory_bytes)
        .with_strangers(strangers)
        .with_wrong_tokens_per_minute(wrong_tokens_per_minute)
        .with_limits(limits)
        .with_cors_origins(cors_origins);
    if let Some(tls) = tls {
        server = server.with_tls(tls);
    }
    if location.storage == StorageAddress::Sqlite {
        announce(ready_file.as_deref(), &grpc, &http)?;
    }
    tracing::info!(grpc = %grpc.local_addr()?, http = %http.local_addr()?, tls = encrypted, data = %location, "serving");

    server
        .serve(grpc, http, async move {
            asked.to_stop().await;
            tracing::info!("stopping");
            tokio::spawn(async move {
                asked.to_stop().await;
                tracing::warn!("asked to stop again: ending at once; what was acknowledged is on the disk");
                std::process::exit(1);
            });
        })
        .await?;
    Ok(ExitCode::SUCCESS)
}

/// What a process hears that is to stop.
struct Asked {
    terminate: Signal,
    interrupt: Signal,
}

impl Asked {
    /// Completes when it is asked to stop.
    async fn to_stop(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
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
            let secret = offline::create_token(location, &name, role, limits).await?;
            eprintln!("this is the secret of {name}; it is not kept here, so note it now:");
            writeln!(stdout, "{secret}")?;
        }
        TokenCommand::Ls => {
            for ListedToken { name, role, limits } in offline::list_tokens(location).await? {
                let row = format!("{name}  {}  {limits}", role.name());
                writeln!(stdout, "{}", row.trim_end())?;
            }
        }
        TokenCommand::Rm { name } => offline::delete_token(location, &name).await?,
    }
    Ok(ExitCode::SUCCESS)
}
