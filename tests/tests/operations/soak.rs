//! `waypost-eval soak`, a minute of it; and that it finds what is lost.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::Duration;

use serde_json::Value;
use sqlx::{ConnectOptions, Connection};

use crate::harness::{Built, database_options, model_file};

/// A minute, of which a tenth is six seconds.
const HOURS: &str = "0.017";

/// Longer than a minute with its setting up takes on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(400);

/// Runs it for a minute with a server, if not with the one beside it.
async fn soak(server: Option<PathBuf>) -> Output {
    let mut command = Built::command("waypost-eval");
    command.args(["soak", "--json", "--hours", HOURS, "--model"]).arg(model_file());
    if let Some(server) = server {
        command.arg("--server-binary").arg(server);
    }
    let running = tokio::process::Command::from(command)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    tokio::time::timeout(PATIENCE, running.wait_with_output()).await.expect("this hangs").unwrap()
}

fn report(output: &Output) -> (Value, String) {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let report = serde_json::from_slice(&output.stdout);
    (report.unwrap_or_else(|error| panic!("{error}: {said}")), said)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_minute_in_a_servers_life_is_sound() {
    let output = soak(None).await;
    let (report, said) = report(&output);
    assert_eq!(
        (output.status.code(), &report["failures"], &report["seed"]),
        (Some(0), &Value::from([""; 0]), &Value::from(1)),
        "{}\n{said}",
        report["failures"]
    );
    let count = |what: &str| report["counts"][what].as_u64().unwrap_or(0);
    assert!(count("kill -9") + count("SIGTERM") >= 2, "{said}");
    assert_eq!(count("lives of the server"), 1 + count("kill -9") + count("SIGTERM"), "{said}");
    for (what, least) in [
        ("frames answered", 300),
        ("frames sent again", 10),
        ("sessions read through", 5),
        ("maps looked at", 5),
        ("tokens rotated", 2),
        ("connections cut", 1),
        ("seen, a place", 5),
    ] {
        assert!(count(what) >= least, "{what}: {} of {least}\n{said}", count(what));
    }
    assert_eq!(report["tenths"].as_array().unwrap().len(), 10);
    assert!(report["tenths"].as_array().unwrap().iter().all(|tenth| tenth["rss_mib"].as_f64() > Some(10.0)));
}

/// The server's program; at its second start it waits in `folder` until something was done to its data.
fn server_that_waits(folder: &Path) -> PathBuf {
    let program = folder.join("server");
    let real = Built::command("waypost-server");
    let script = format!(
        "#!/bin/sh\n\
         case \" $* \" in *\" --ready-file \"*)\n\
             echo started >>{0}/starts\n\
             if [ $(wc -l <{0}/starts) = 2 ]; then\n\
                 echo \"$*\" >{0}/writing && mv {0}/writing {0}/waiting\n\
                 while [ ! -e {0}/go ]; do sleep 0.05; done\n\
             fi;;\n\
         esac\n\
         exec {1} \"$@\"\n",
        folder.display(),
        real.get_program().display()
    );
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    program
}

/// Between two lives of the server the last frame of each map is lost, as if it had never been written.
#[tokio::test(flavor = "multi_thread")]
async fn a_soak_finds_a_frame_that_is_lost_at_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let losing = async {
        let waiting = folder.path().join("waiting");
        while !waiting.exists() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let arguments = std::fs::read_to_string(&waiting).unwrap();
        let mut arguments = arguments.split_whitespace().skip_while(|argument| *argument != "--data-dir");
        let data = PathBuf::from(arguments.nth(1).unwrap());
        let mut database = database_options(&data).connect().await.unwrap();
        let statement = "DELETE FROM log WHERE sequence IS NOT NULL AND (map_id, position) IN \
                         (SELECT map_id, max(position) FROM log GROUP BY map_id)";
        let lost = sqlx::query(statement).execute(&mut database).await.unwrap().rows_affected();
        database.close().await.unwrap();
        std::fs::write(folder.path().join("go"), "").unwrap();
        lost
    };
    let (output, lost) = tokio::join!(soak(Some(server_that_waits(folder.path()))), losing);
    assert!(lost > 0);
    let (report, said) = report(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let failures = report["failures"].as_array().unwrap();
    let told = failures[0].as_str().unwrap();
    assert!(failures.len() == 1 && told.starts_with("after "), "{told}");
    assert!(said.contains("error: seed 1: after "), "{said}");
    let found = ["is another", "acknowledged", "was lost", "before", "log"];
    assert!(found.iter().any(|found| told.contains(found)), "{told}");
}
