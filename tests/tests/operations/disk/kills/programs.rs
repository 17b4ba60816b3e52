//! Kills of what works on a data directory before, or without, serving it: the first start of a newer version, backups, and
//! what is restored from them.
//!
//! `WAYPOST_KILLS_OF_STARTS` is how many kills there are of each, from the seed `WAYPOST_KILLS_SEED`.

use std::path::Path;
use std::process::{Command, Output};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::migrate::Migrator;
use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

use super::super::watched::{Calls, Fault, How, WatchedDisk, copy_below};
use super::template::{State, Template, state};
use super::{NO_FAULT, differences};
use crate::harness::{Server, database_options, run_to_its_end, workspace};
use crate::operations::long_runs::number;

/// Kills of each kind in every run of the tests.
const KILLS: u64 = 1;

/// The first schema whose database has checksums.
const WITH_CHECKSUMS: i64 = 11;

async fn execute(database: &mut SqliteConnection, statement: &str) {
    sqlx::query(AssertSqlSafe(statement.to_owned())).execute(database).await.unwrap();
}

async fn names(database: &mut SqliteConnection, select: &str) -> Vec<String> {
    sqlx::query_scalar(AssertSqlSafe(select.to_owned())).fetch_all(database).await.unwrap()
}

/// What the template holds, as the last server of a schema had it; without checkpoints, which may always be missing.
async fn as_it_was(template: &Path, schema: i64, old: &Path) {
    let file = old.join("waypost.sqlite");
    if schema >= WITH_CHECKSUMS {
        // A file with room for checksums, and nothing in it.
        Server::start_on(old).await.stop().await;
        let mut database = database_options(old).foreign_keys(false).connect().await.unwrap();
        let tables = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'";
        for table in names(&mut database, tables).await {
            execute(&mut database, &format!("DROP TABLE {table}")).await;
        }
        database.close().await.unwrap();
    }
    let mut migrator = Migrator::new(workspace().join("migrations")).await.unwrap();
    migrator.migrations = migrator.iter().filter(|one| one.version <= schema).cloned().collect();
    let options = if schema >= WITH_CHECKSUMS {
        database_options(old)
    } else {
        sqlx::sqlite::SqliteConnectOptions::new().filename(&file).create_if_missing(true)
    };
    let mut database = options.foreign_keys(false).connect().await.unwrap();
    migrator.run(&mut database).await.unwrap();
    execute(
        &mut database,
        &format!("ATTACH 'file:{}/waypost.sqlite?vfs=waypost' AS new", template.display()),
    )
    .await;
    for table in
        ["models", "maps", "sessions", "log", "frame_media", "frame_notes", "labels", "map_models", "tokens"]
    {
        let columns = format!(
            "SELECT name FROM pragma_table_info('{table}', 'main') INTERSECT SELECT name FROM pragma_table_info('{table}', 'new')"
        );
        let columns = names(&mut database, &columns).await.join(", ");
        // The table is of a later migration.
        if !columns.is_empty() {
            let copy = format!("INSERT INTO main.{table} ({columns}) SELECT {columns} FROM new.{table}");
            execute(&mut database, &copy).await;
        }
    }
    if schema >= WITH_CHECKSUMS {
        execute(&mut database, "DELETE FROM upkeep WHERE task = 'log_checksums'").await;
    }
    database.close().await.unwrap();
}

/// What a server on a directory tells.
async fn told(template: &Template, data: &Path) -> State {
    let server = Server::start_on(data).await;
    let state = state(&template.client(&server.endpoint()).await).await;
    server.stop().await;
    for finding in waypost_server::offline::check_all(data).await.unwrap() {
        assert!(finding.result.is_ok(), "{finding:?}");
    }
    state
}

fn a_kill(random: &mut ChaCha8Rng, calls: u64) -> Fault {
    let how = [How::Kill, How::KillHalfway][random.random_range(0..2)];
    Fault {
        nth: random.random_range(1..=u32::try_from(calls).unwrap()),
        calls: Calls::CHANGES,
        how,
        error: 0,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_first_start_of_this_version_that_is_killed_goes_on_at_the_next() {
    let template = Template::new().await;
    let (kills, seed) = (number("WAYPOST_KILLS_OF_STARTS", KILLS), number("WAYPOST_KILLS_SEED", 1));
    let last = Migrator::new(workspace().join("migrations")).await.unwrap().iter().last().unwrap().version;
    let mut met_in_all = 0;
    for schema in 1..last {
        let old = super::super::scratch();
        as_it_was(template.directory.path(), schema, old.path()).await;
        let disk = WatchedDisk::new();
        copy_below(old.path(), &disk.data());
        disk.arm(NO_FAULT);
        disk.start().kill();
        let calls = disk.counted().0;
        disk.mend();
        let whole = told(&template, &disk.data()).await;
        // Three maps and their four sessions.
        let things = whole.keys().filter(|name| name.starts_with("maps/") && !name.ends_with(": labels"));
        assert_eq!(things.count(), 7, "schema {schema}");
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(schema.cast_unsigned());
        let mut met = 0;
        for kill in 0..kills {
            let disk = WatchedDisk::new();
            copy_below(old.path(), &disk.data());
            let fault = a_kill(&mut random, calls);
            disk.arm(fault);
            met += u64::from(disk.try_start().is_err());
            disk.mend();
            let now = told(&template, &disk.data()).await;
            let case = format!("schema {schema}, kill {kill} of seed {seed}, {fault:?}");
            assert!(now == whole, "{case}: {}", differences(&now, std::slice::from_ref(&whole)));
        }
        println!("schema {schema}: {kills} starts of seed {seed}, {met} were killed at one of {calls} calls");
        met_in_all += met;
    }
    let starts = kills * (last - 1).cast_unsigned();
    assert!(met_in_all * 2 > starts, "{met_in_all} of {starts} starts were killed");
}

/// Runs the server's program on the disk's directory, to its end or to a kill.
fn run(disk: &WatchedDisk, data: &Path, arguments: &[&str]) -> Output {
    let mut command: Command = disk.command();
    command.arg("--data-dir").arg(data).args(arguments);
    run_to_its_end(command)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_that_is_killed_is_no_backup_and_so_is_what_is_restored() {
    let template = Template::new().await;
    let (kills, seed) = (10 * number("WAYPOST_KILLS_OF_STARTS", KILLS), number("WAYPOST_KILLS_SEED", 1));
    let disk = WatchedDisk::new();
    copy_below(template.directory.path(), &disk.data());
    let before = told(&template, &disk.data()).await;
    let (backup, restored) = (disk.root().join("backup"), disk.root().join("restored"));
    let name = backup.to_str().unwrap().to_owned();
    let (making, restoring) = (["backup", &name], ["restore", &name]);
    let commands: [(&str, &Path, &[&str], &Path); 2] =
        [("backup", &disk.data(), &making, &backup), ("restore", &restored, &restoring, &restored)];
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for (what, data, arguments, made) in commands {
        disk.arm(NO_FAULT);
        let whole = run(&disk, data, arguments);
        assert!(whole.status.success(), "{whole:?}");
        let calls = disk.counted().0;
        let (mut nothing, mut there) = (0, 0);
        for kill in 0..kills {
            std::fs::remove_dir_all(made).unwrap();
            let fault = a_kill(&mut random, calls);
            let case = format!("{what}, kill {kill} of seed {seed}, {fault:?}");
            disk.arm(fault);
            let ended = run(&disk, data, arguments);
            disk.mend();
            if ended.status.success() {
                assert_eq!(disk.counted().1, 0, "{case}");
            }
            if made.join("waypost.sqlite").metadata().is_ok_and(|file| file.len() > 0) {
                there += 1;
            } else {
                // It is asked for again.
                nothing += 1;
                let again = run(&disk, data, arguments);
                assert!(again.status.success(), "{case}: {again:?}");
            }
            let copy = super::super::scratch();
            copy_below(made, copy.path());
            let now = told(&template, copy.path()).await;
            assert!(now == before, "{case}: {}", differences(&now, std::slice::from_ref(&before)));
        }
        println!(
            "{what}: {kills} kills of seed {seed} at {calls} calls: {there} left a whole one, {nothing} none"
        );
        assert!(nothing > 0, "{what}: no kill came before the end");
    }
    assert!(told(&template, &disk.data()).await == before, "the source is another");
}
