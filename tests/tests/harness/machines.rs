//! A database of PostgreSQL on three machines: one takes writes, and a transaction counts once another has it. Or on one
//! machine of its own.

use std::fs::OpenOptions;
use std::io::Write;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use rand::RngExt;
use rustix::process::{Pid, Signal, getuid, kill_process};
use sqlx::{AssertSqlSafe, Connection, PgConnection};
use tempfile::TempDir;

use super::Cluster;

const NAMES: [&str; 3] = ["one", "two", "three"];

/// Far more than a machine takes to start, to follow, or to end.
const PATIENCE: Duration = Duration::from_secs(60);

/// Three machines, or one. Ended when dropped.
pub(crate) struct Machines {
    programs: PathBuf,
    machines: Vec<Machine>,
    /// The one that takes writes.
    pub(crate) primary: usize,
    directory: TempDir,
}

struct Machine {
    name: &'static str,
    data: PathBuf,
    port: u16,
}

impl Machines {
    /// A primary and its two standbys; `None` with a word why where PostgreSQL is not there.
    pub(crate) async fn start() -> Option<Self> {
        let directory = tempfile::tempdir().unwrap();
        let data = directory.path().to_owned();
        let machines = Self::with_a_primary(&NAMES, &data, directory)?;
        let first = &machines.machines[0];
        // After the start: what is made first has no standby to wait for.
        let mut settings = OpenOptions::new().append(true).open(first.data.join("postgresql.conf")).unwrap();
        writeln!(settings, "synchronous_standby_names = 'ANY 1 ({})'", NAMES.join(", ")).unwrap();
        machines.follow(1);
        machines.follow(2);
        machines.tell(0, "SELECT pg_reload_conf()").await;
        machines.until_followed_by(2).await;
        Some(machines)
    }

    /// One machine, with all that it keeps in that folder; `None` likewise.
    pub(crate) fn alone(data: &Path) -> Option<Self> {
        Self::with_a_primary(&NAMES[..1], data, tempfile::tempdir().unwrap())
    }

    /// The first of the machines runs, the others are names.
    fn with_a_primary(names: &[&'static str], data: &Path, directory: TempDir) -> Option<Self> {
        Cluster::running()?;
        if getuid().is_root() {
            let folders = [directory.path(), data];
            assert!(Command::new("chown").arg("postgres").args(folders).status().unwrap().success());
        }
        let machine = |&name| Machine { name, data: data.join(name), port: free_port() };
        let machines = names.iter().map(machine).collect();
        let machines = Self { programs: programs(), machines, primary: 0, directory };
        machines.run(
            "initdb",
            &["--username=waypost", "--auth=trust", "--encoding=UTF8", "--locale=C", "--no-sync", "--pgdata"],
            &machines.machines[0].data,
        );
        machines.start_again(0);
        Some(machines)
    }

    /// A database with that name: its URL names all machines.
    pub(crate) async fn database(&self, name: &str) -> String {
        self.tell(self.primary, &format!("CREATE DATABASE {name}")).await;
        // Standbys have it when they have replayed that.
        let there = format!("SELECT count(*)::text FROM pg_database WHERE datname = '{name}'");
        let runs = |standby: &usize| self.answers(*standby);
        let all = 0..self.machines.len();
        for standby in all.clone().filter(|machine| *machine != self.primary).filter(runs) {
            let since = Instant::now();
            while self.ask(standby, &there).await != "1" {
                assert!(since.elapsed() < PATIENCE, "a standby does not get the database {name}");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
        format!("{}?target_session_attrs=read-write", self.url(&all.collect::<Vec<_>>(), name))
    }

    /// The URL of a database on some of the machines.
    pub(crate) fn url(&self, machines: &[usize], name: &str) -> String {
        let hosts: Vec<String> =
            machines.iter().map(|&machine| self.machines[machine].socket().to_string()).collect();
        format!("postgres://waypost@{}/{name}", hosts.join(","))
    }

    /// Those that take no writes.
    pub(crate) fn standbys(&self) -> [usize; 2] {
        [(self.primary + 1) % 3, (self.primary + 2) % 3]
    }

    /// `kill -9` of the primary; the machine that it was.
    pub(crate) fn kill_primary(&self) -> usize {
        let machine = &self.machines[self.primary];
        let pid = std::fs::read_to_string(machine.data.join("postmaster.pid")).unwrap();
        let pid = pid.lines().next().unwrap().trim().parse().unwrap();
        let first = Pid::from_raw(pid).unwrap();
        // What is stopped makes no more processes.
        kill_process(first, Signal::STOP).unwrap();
        let processes: Vec<i32> = children(pid).into_iter().chain([pid]).collect();
        kill_process(first, Signal::KILL).unwrap();
        // One that still writes, on a slow disk, would keep the machine from being started again.
        until(|| processes.iter().all(|pid| !Path::new(&format!("/proc/{pid}")).exists()));
        assert!(!self.answers(self.primary), "{} still answers", machine.name);
        self.primary
    }

    /// The standby that has most takes over, and the other follows it.
    pub(crate) async fn promote(&mut self) {
        let mut standbys = Vec::new();
        for standby in self.standbys() {
            let received = "SELECT (pg_last_wal_receive_lsn() - '0/0')::text";
            standbys.push((self.ask(standby, received).await.parse::<u64>().unwrap(), standby));
        }
        standbys.sort_unstable();
        let [(_, other), (_, next)] = standbys[..] else { unreachable!("two follow") };
        self.run("pg_ctl", &["promote", "--silent", "--wait", "--pgdata"], &self.machines[next].data);
        self.primary = next;
        let conninfo = self.conninfo(other);
        self.tell(other, &format!("ALTER SYSTEM SET primary_conninfo = '{conninfo}'")).await;
        self.tell(other, "SELECT pg_reload_conf()").await;
        self.until_followed_by(1).await;
    }

    /// A machine that was killed follows the primary, with a copy of it in place of what it had.
    pub(crate) async fn rejoin(&self, machine: usize) {
        std::fs::remove_dir_all(&self.machines[machine].data).unwrap();
        self.follow(machine);
        self.until_followed_by(2).await;
    }

    /// Stops a machine in good order.
    pub(crate) fn stop(&self, machine: usize) {
        let stop = ["stop", "--silent", "--wait", "--mode=fast", "--pgdata"];
        self.run("pg_ctl", &stop, &self.machines[machine].data);
    }

    /// Whether a machine answers.
    pub(crate) fn answers(&self, machine: usize) -> bool {
        TcpStream::connect(self.machines[machine].socket()).is_ok()
    }

    /// Starts a machine with what it has.
    pub(crate) fn start_again(&self, machine: usize) {
        let Machine { data, port, .. } = &self.machines[machine];
        let options = format!("--options=-h 127.0.0.1 -p {port} -k {}", self.directory.path().display());
        let log = format!("--log={}.log", data.display());
        self.run("pg_ctl", &["start", "--silent", "--wait", &log, &options, "--pgdata"], data);
    }

    fn follow(&self, machine: usize) {
        let from = format!("--dbname={}", self.conninfo(machine));
        let how = ["--write-recovery-conf", "--wal-method=stream", "--checkpoint=fast", "--no-sync"];
        self.run("pg_basebackup", &[&how[..], &[&from, "--pgdata"]].concat(), &self.machines[machine].data);
        self.start_again(machine);
    }

    /// How a machine reaches the primary, and by which name it is known there.
    fn conninfo(&self, machine: usize) -> String {
        let (name, port) = (self.machines[machine].name, self.machines[self.primary].port);
        format!("host=127.0.0.1 port={port} user=waypost application_name={name}")
    }

    async fn until_followed_by(&self, standbys: u64) {
        let since = Instant::now();
        let following = "SELECT count(*)::text FROM pg_stat_replication WHERE state = 'streaming' \
                         AND application_name IN ('one', 'two', 'three')";
        while self.ask(self.primary, following).await != standbys.to_string() {
            assert!(since.elapsed() < PATIENCE, "the primary is not followed by {standbys}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    async fn connect(&self, machine: usize) -> PgConnection {
        PgConnection::connect(&self.url(&[machine], "postgres")).await.unwrap()
    }

    async fn ask(&self, machine: usize, query: &str) -> String {
        let mut connection = self.connect(machine).await;
        sqlx::query_scalar(AssertSqlSafe(query)).fetch_one(&mut connection).await.unwrap()
    }

    async fn tell(&self, machine: usize, statement: &str) {
        let mut connection = self.connect(machine).await;
        sqlx::raw_sql(AssertSqlSafe(statement)).execute(&mut connection).await.unwrap();
    }

    /// Runs a program of PostgreSQL with a directory as its last argument.
    #[track_caller]
    fn run(&self, program: &str, arguments: &[&str], data: &Path) {
        let output = self.command(program).args(arguments).arg(data).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        let log = || {
            let log = std::fs::read_to_string(format!("{}.log", data.display())).unwrap_or_default();
            let lines: Vec<&str> = log.lines().collect();
            lines[lines.len().saturating_sub(20)..].join("\n")
        };
        assert!(output.status.success(), "{program} {arguments:?}: {said}\n{}", log());
    }

    /// PostgreSQL does not run as root.
    fn command(&self, program: &str) -> Command {
        let program = self.programs.join(program);
        let mut command = if getuid().is_root() {
            let mut command = Command::new("runuser");
            command.args(["-u", "postgres", "--"]).arg(program);
            command
        } else {
            Command::new(program)
        };
        command.current_dir("/");
        command
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for machine in &self.machines {
            let stop = ["stop", "--silent", "--mode=immediate", "--pgdata"];
            // An error means that it does not run.
            let _ = self.command("pg_ctl").args(stop).arg(&machine.data).output();
        }
    }
}

impl Machine {
    fn socket(&self) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], self.port))
    }
}

/// The processes that a process began.
fn children(pid: i32) -> Vec<i32> {
    let all = std::fs::read_dir("/proc")
        .unwrap()
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    let parent = format!("PPid:\t{pid}\n");
    // One that ends meanwhile has no status.
    let is_child = |child: &i32| {
        std::fs::read_to_string(format!("/proc/{child}/status")).is_ok_and(|status| status.contains(&parent))
    };
    all.filter(is_child).collect()
}

/// Not one that the system gives to who connects: a machine that comes back has the same port, whoever came meanwhile.
fn free_port() -> u16 {
    let mut random = rand::rng();
    let ports = std::iter::repeat_with(|| random.random_range(10_000..32_000));
    ports.take(1000).find(|&port| TcpListener::bind(("127.0.0.1", port)).is_ok()).expect("a port is free")
}

/// Debian keeps the programs of each version in a directory of its own.
fn programs() -> PathBuf {
    let versions = std::fs::read_dir("/usr/lib/postgresql").expect("PostgreSQL is installed");
    let programs = versions.map(|version| version.unwrap().path().join("bin"));
    programs.filter(|programs| programs.join("initdb").exists()).max().expect("PostgreSQL is installed")
}

#[track_caller]
fn until(done: impl Fn() -> bool) {
    let since = Instant::now();
    while !done() {
        assert!(since.elapsed() < PATIENCE, "this hangs");
        std::thread::sleep(Duration::from_millis(10));
    }
}
