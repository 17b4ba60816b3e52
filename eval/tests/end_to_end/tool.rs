//! Running the program and reading what it leaves behind.

use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// What the program did.
pub(crate) struct Run {
    pub(crate) exit_code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs `waypost-eval` with these arguments.
pub(crate) fn waypost_eval<S: AsRef<OsStr>>(arguments: &[S]) -> Run {
    run(Command::new(PROGRAM).args(arguments))
}

/// Runs it on so many threads.
pub(crate) fn waypost_eval_on_threads<S: AsRef<OsStr>>(threads: usize, arguments: &[S]) -> Run {
    run(Command::new(PROGRAM).args(arguments).env("RAYON_NUM_THREADS", threads.to_string()))
}

const PROGRAM: &str = env!("CARGO_BIN_EXE_waypost-eval");

fn run(command: &mut Command) -> Run {
    let Output { status, stdout, stderr } = command.output().unwrap();
    Run {
        exit_code: status.code(),
        stdout: String::from_utf8(stdout).unwrap(),
        stderr: String::from_utf8(stderr).unwrap(),
    }
}

impl Run {
    /// The one JSON object that a successful run prints, and nothing else.
    pub(crate) fn json(&self) -> Value {
        assert_eq!(self.exit_code, Some(0), "{}", self.stderr);
        let mut objects = serde_json::Deserializer::from_str(&self.stdout).into_iter::<Value>();
        let object = objects.next().unwrap().unwrap();
        assert!(object.is_object() && objects.next().is_none(), "not one object: {}", self.stdout);
        object
    }

    /// What it said when it failed with this exit code; nothing may have gone to stdout.
    pub(crate) fn refusal(&self, exit_code: i32) -> &str {
        assert_eq!((self.exit_code, self.stdout.as_str()), (Some(exit_code), ""), "{}", self.stderr);
        &self.stderr
    }
}

/// One row of a table, by column.
pub(crate) type Row = std::collections::HashMap<String, String>;

pub(crate) fn frame_rows(folder: &Path) -> Vec<Row> {
    rows(&folder.join("frames.csv"))
}

pub(crate) fn candidate_rows(folder: &Path) -> Vec<Row> {
    rows(&folder.join("candidates.csv"))
}

fn rows(file: &Path) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(file).unwrap();
    assert!(reader.headers().unwrap().len() > 1, "{} has no header", file.display());
    reader.deserialize().map(Result::unwrap).collect()
}

/// Index of the proposed frame; `None` without a proposal.
pub(crate) fn proposal(row: &Row) -> Option<usize> {
    row["proposal_frame"].parse().ok()
}
