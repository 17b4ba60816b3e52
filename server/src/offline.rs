//! What an operator does with a data directory, or a database, while no server runs on it.

use std::path::Path;

use anyhow::bail;
use futures::future::LocalBoxFuture;
use tokio::net::TcpListener;
use waypost_proto::flags::{QuotasFlags, seconds};

use crate::clock::in_words;
use crate::config::{Config, DataLocation, MediaAddress, StorageAddress};
use crate::net::tls::Tls;
use crate::role::{Ability, Reach, Role};
use crate::service::Service;
use crate::service::maps::Detail;
use crate::service::tokens::{NewToken, TokenRow};
use crate::storage::{
    Claim, DeepInspection, Inspection, Moved, Source, back_up, check_media_beside_sqlite, inspect,
    inspect_all, inspect_media_store, inspect_postgres, restore,
};
use crate::wire::tokens::requested_limits;
use crate::{Exposed, exposed, open};

/// A token as it is listed.
#[derive(Clone, Debug, PartialEq)]
pub struct ListedToken {
    /// Name within the server.
    pub name: String,
    /// What its holder may do.
    pub role: Role,
    /// How it is limited, in words; empty if it is not.
    pub limits: String,
}

/// How a token is limited; not at all by default.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct TokenLimits {
    /// What it may do, where that is less than its role may; names with commas between them
    #[arg(long = "may", value_name = "ABILITY", value_delimiter = ',', value_enum)]
    pub abilities: Vec<Ability>,
    /// A map that it reaches, or the beginning of names and an asterisk, as in floor2-*; may be given several times
    #[arg(long = "map", value_name = "MAP")]
    pub maps: Vec<String>,
    /// After how long it expires, as in 90s, 12h or 30d
    #[arg(long = "expires-in", value_name = "TIME", value_parser = seconds)]
    pub lifetime_s: Option<u32>,
    /// How much its holder may have and send.
    #[command(flatten)]
    pub quotas: QuotasFlags,
}

/// Makes a token in `location`; gives its secret, which is kept nowhere.
///
/// # Errors
/// If the directory cannot be used, or the token cannot be; the message says how to mend it.
pub fn create_token(
    location: DataLocation,
    name: &str,
    role: Role,
    limits: TokenLimits,
) -> LocalBoxFuture<'_, anyhow::Result<String>> {
    Box::pin(async move {
        let service = open(&location, Claim::at_once()).await?;
        let TokenLimits { abilities, maps, lifetime_s, quotas } = limits;
        let limits = requested_limits(quotas.into());
        let new = NewToken { name: name.to_owned(), role, abilities, maps, lifetime_s, limits };
        let created = service.tokens.create(new).await;
        service.stop().await;
        Ok(created?.1)
    })
}

/// All tokens in `location`, by name.
///
/// # Errors
/// If the directory cannot be used.
pub fn list_tokens(location: DataLocation) -> LocalBoxFuture<'static, anyhow::Result<Vec<ListedToken>>> {
    Box::pin(async move {
        let service = open(&location, Claim::at_once()).await?;
        let listed = service.tokens.all();
        service.stop().await;
        Ok(listed.into_iter().map(listed_token).collect())
    })
}

fn listed_token(token: TokenRow) -> ListedToken {
    let TokenRow { name, role, abilities, reach, expires_ns, limits, .. } = token;
    let may = (abilities != role.abilities()).then(|| format!("may {abilities}"));
    let maps = (reach != Reach::Everywhere).then(|| reach.to_string());
    let until = expires_ns.map(|at| format!("until {}", in_words(at)));
    ListedToken {
        name,
        role,
        limits: [may, maps, until, limits.in_words()].into_iter().flatten().collect::<Vec<_>>().join("; "),
    }
}

/// Deletes a token in `location`; gives how many are left.
///
/// # Errors
/// If the directory cannot be used, or the token must stay; the message says how to mend it.
pub fn delete_token(location: DataLocation, name: &str) -> LocalBoxFuture<'_, anyhow::Result<usize>> {
    Box::pin(async move {
        let service = open(&location, Claim::at_once()).await?;
        let deleted = service.tokens.delete(&format!("tokens/{name}")).await;
        let left = service.tokens.all().len();
        service.stop().await;
        deleted.map(|()| left).map_err(Into::into)
    })
}

/// Refuses to make a database where nobody said that one is to be: a server that has another would not know of it.
///
/// # Errors
/// If the data directory is the default one, and has no database.
pub fn need_named_directory(config: &Config) -> anyhow::Result<()> {
    let is_default =
        config.storage == StorageAddress::Sqlite && config.data_dir == Config::default().data_dir;
    anyhow::ensure!(
        !is_default || config.data_dir.exists(),
        "no server has its data in {}, where this would make a database; say which server it is for: --data-dir DIRECTORY, or \
         --config FILE, as that one has it",
        config.data_dir.display()
    );
    Ok(())
}

/// One thing that was looked at, and what is wrong with it, if anything is.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What was looked at.
    pub subject: &'static str,
    /// What is there, or what is wrong and how to mend it.
    pub result: Result<String, String>,
}

/// Looks whether a server could serve with `config`, and serves nothing. All is looked at, whatever is
/// wrong. The data directory is made if it is missing, nothing in it is changed.
pub fn check(config: &Config) -> LocalBoxFuture<'_, Vec<Finding>> {
    Box::pin(async move {
        let (mut findings, tokens) = check_what_is_kept(config).await;
        // While a server runs on the directory, the addresses are its own.
        if tokens.is_some() {
            findings.push(Finding { subject: "addresses", result: check_addresses(config).await });
        }
        findings
    })
}

/// [`check`] without the addresses: a copy is read beside the server whose addresses they are.
pub fn check_copy(config: &Config) -> LocalBoxFuture<'_, Vec<Finding>> {
    Box::pin(async move { check_what_is_kept(config).await.0 })
}

/// Certificates, data and access, and how many tokens there are; `None` where the data cannot be read.
async fn check_what_is_kept(config: &Config) -> (Vec<Finding>, Option<u64>) {
    let tls = check_tls(config);
    let (data, tokens) = check_data(&config.location()).await;
    let mut findings = vec![
        Finding { subject: "certificates", result: tls },
        Finding { subject: config.location().subject(), result: data },
    ];
    if config.media != MediaAddress::Database || config.storage != StorageAddress::Sqlite {
        findings.push(Finding { subject: "media", result: check_media(&config.location()).await });
    }
    findings.extend(tokens.map(|tokens| Finding { subject: "access", result: check_access(config, tokens) }));
    (findings, tokens)
}

/// That something is about a data directory, which a database of PostgreSQL has not got.
///
/// # Errors
/// If `storage` is one; the message says what does it there.
pub fn need_sqlite(storage: &StorageAddress, what: &str) -> anyhow::Result<()> {
    match storage {
        StorageAddress::Sqlite => Ok(()),
        StorageAddress::Postgres(_) => bail!(
            "`{what}` is for SQLite; a database of PostgreSQL has its own means, as pg_dump and pg_basebackup \
             (https://www.postgresql.org/docs/current/backup.html)"
        ),
    }
}

/// That a data directory is there: who mistyped its name is not told that nothing is wrong.
///
/// # Errors
/// If it is not; the message says how to mend it.
pub fn need_directory(data_dir: &Path) -> anyhow::Result<()> {
    if data_dir.is_dir() {
        return Ok(());
    }
    bail!("there is no data directory {}; name the one of a server with --data-dir", data_dir.display())
}

/// Reads all that `data_dir` holds, whole pages and every row, and says what is not as it was written. Changes nothing.
///
/// # Errors
/// If the directory cannot be used, or a server runs on it; the message says how to mend it.
pub fn check_all(data_dir: &Path) -> LocalBoxFuture<'_, anyhow::Result<Vec<Finding>>> {
    Box::pin(async move {
        let finding = |result| Finding { subject: "contents", result };
        let Some(inspected) = inspect_all(data_dir).await? else {
            return Ok(vec![finding(Ok(format!("{} holds no database yet", data_dir.display())))]);
        };
        let DeepInspection { models, maps, events, notes, media, problems } = inspected;
        if !problems.is_empty() {
            return Ok(problems.into_iter().map(|problem| finding(Err(problem))).collect());
        }
        Ok(vec![finding(Ok(format!(
            "{models} models and {maps} maps with {events} events, {notes} notes and {media} images and features are as they \
             were written"
        )))])
    })
}

/// Writes a copy of all that `data_dir` holds into `directory`, also while a server runs, and reads all of the copy.
///
/// # Errors
/// If the copy cannot be made; the message says how to mend it. What is damaged in the copy is a finding.
pub fn make_backup<'a>(
    data_dir: &'a Path,
    directory: &'a Path,
) -> LocalBoxFuture<'a, anyhow::Result<Vec<Finding>>> {
    Box::pin(async move {
        back_up(data_dir, directory).await?;
        check_all(directory).await
    })
}

/// Makes `data_dir`, which holds no database, what the backup in `directory` is. Reads all of the backup before.
///
/// # Errors
/// If the backup is damaged, or the directory holds a database already; the message says how to mend it.
pub fn restore_backup<'a>(directory: &'a Path, data_dir: &'a Path) -> LocalBoxFuture<'a, anyhow::Result<()>> {
    Box::pin(async move {
        let Some(DeepInspection { problems, .. }) = inspect_all(directory).await? else {
            anyhow::bail!("{} holds no backup; name the directory that one was made in", directory.display());
        };
        if let Some(first) = problems.first() {
            anyhow::bail!(
                "the backup in {} is damaged ({first}); take another, or see `waypost-server check --deep --data-dir {}`",
                directory.display(),
                directory.display()
            );
        }
        Ok(restore(directory, data_dir).await?)
    })
}

/// Brings all that `from` holds, and may be serving, into `to`, which holds nothing, or what an earlier run that was cut off
/// left. Every row is read back and compared; then every map is opened, and its state hash is told.
///
/// # Errors
/// If something cannot be read or written, `to` holds something else, or a server runs on it; the message says how to mend
/// it.
pub fn migrate<'a>(
    from: &'a DataLocation,
    to: &'a DataLocation,
) -> LocalBoxFuture<'a, anyhow::Result<Vec<Finding>>> {
    Box::pin(async move {
        anyhow::ensure!(from != to, "the source and the target are the same; name another target");
        let source = match &from.storage {
            StorageAddress::Sqlite => Source::of_directory(&from.data_dir).await?,
            StorageAddress::Postgres(url) => Source::of_postgres(url, &from.media).await?,
        };
        let service = open(to, Claim::at_once()).await?;
        service.settle_media_store().await?;
        let moved = move_into(&service, source).await;
        service.stop().await;
        moved
    })
}

async fn move_into(service: &Service, source: Source) -> anyhow::Result<Vec<Finding>> {
    let Moved { maps, rows } = service.take_over_from(source).await?;
    let mut findings = vec![Finding {
        subject: "contents",
        result: Ok(format!("{rows} rows are as they are in the source")),
    }];
    for name in maps {
        let view = service.maps.get(&format!("maps/{name}"), Detail::Full).await?;
        let state_hash = view.state_hash.unwrap_or_default();
        findings
            .push(Finding { subject: "map", result: Ok(format!("{name} has the state hash {state_hash}")) });
    }
    Ok(findings)
}

/// Makes the file system that writes checksums known to SQLite in this process; its name, for those who look into a
/// database by themselves. What another one writes has no checksums, and is taken for damage.
///
/// # Errors
/// If SQLite has no file system.
pub fn file_system_with_checksums() -> anyhow::Result<&'static str> {
    Ok(crate::storage::file_system()?)
}

fn check_tls(config: &Config) -> Result<String, String> {
    let Some(files) = config.tls_files() else {
        return Ok("none; connections are not encrypted".to_owned());
    };
    match Tls::load(&files) {
        Ok(Tls { client_ca: Some(_), .. }) => {
            Ok("certificate and key fit; clients need a certificate, too".to_owned())
        }
        Ok(Tls { client_ca: None, .. }) => Ok("certificate and key fit".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

/// Also how many tokens there are, if that can be told.
async fn check_data(location: &DataLocation) -> (Result<String, String>, Option<u64>) {
    let (inspected, makes) = match &location.storage {
        StorageAddress::Sqlite => (inspect(&location.data_dir).await, "no database yet; one will be made"),
        StorageAddress::Postgres(url) => (inspect_postgres(url).await, "no tables yet; they will be made"),
    };
    match inspected {
        Ok(None) => (Ok(format!("{location} holds {makes}")), Some(0)),
        Ok(Some(Inspection { maps, tokens, outdated })) => {
            let update = if outdated { "; the next start brings its database up to date" } else { "" };
            let there = format!("{location} holds {maps} maps and {tokens} tokens{update}");
            (Ok(there), Some(tokens))
        }
        Err(error) => (Err(error.to_string()), None),
    }
}

async fn check_media(location: &DataLocation) -> Result<String, String> {
    let checked = match &location.storage {
        StorageAddress::Sqlite => check_media_beside_sqlite(&location.media),
        StorageAddress::Postgres(url) => inspect_media_store(url, &location.media).await,
    };
    checked.map(|()| format!("they go to {}", location.media)).map_err(|error| error.to_string())
}

fn check_access(config: &Config, tokens: u64) -> Result<String, String> {
    match exposed([config.grpc_address, config.http_address]) {
        Some(address) if tokens == 0 && !config.allow_anonymous => Err(Exposed { address }.to_string()),
        Some(_) if tokens == 0 => Ok("no token is asked for, and other machines reach the server".to_owned()),
        None if tokens == 0 => Ok("no token is asked for; this machine alone reaches the server".to_owned()),
        Some(_) | None => Ok("a token is asked for".to_owned()),
    }
}

async fn check_addresses(config: &Config) -> Result<String, String> {
    // Held together: one of them may take the port of the other, as 0.0.0.0 does.
    let mut held = Vec::new();
    for (address, option) in [(config.grpc_address, "grpc_address"), (config.http_address, "http_address")] {
        match TcpListener::bind(address).await {
            Ok(listener) => held.push(listener),
            Err(error) => {
                return Err(format!(
                    "cannot listen on {address}: {error}; stop what runs there, or choose another {option}. A copy that no server is \
                     to serve is read by `check --deep`, which leaves addresses out"
                ));
            }
        }
    }
    Ok(format!("{} and {} are free", config.grpc_address, config.http_address))
}
