//! The real command line against a real server.

use std::fs::File;
use std::path::Path;
use std::process::Output;

use serde_json::Value;
use waypost_client::launch;

use super::{BY_WORDS_THRESHOLD, Built, ServerProcess, images, model_file, run_to_its_end};

/// The command line, talking to one server.
pub(crate) struct CommandLine {
    server: ServerProcess,
    _directory: tempfile::TempDir,
    cache: tempfile::TempDir,
}

impl CommandLine {
    pub(crate) fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let cache = tempfile::tempdir().unwrap();
        Self { server: ServerProcess::start(directory.path()), _directory: directory, cache }
    }

    pub(crate) fn endpoint(&self) -> String {
        self.server.endpoint()
    }

    /// Where REST is served.
    pub(crate) fn http(&self) -> String {
        format!("http://{}", self.server.http())
    }

    pub(crate) fn kill_server(self) {
        self.server.kill();
    }

    /// Where models are kept between runs.
    pub(crate) fn cache(&self) -> &Path {
        self.cache.path()
    }

    pub(crate) fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Built::command("waypost");
        command.args(arguments).args(["--server", &self.endpoint()]).env("XDG_CACHE_HOME", self.cache());
        run_to_its_end(command)
    }

    /// Exit code of a command on a terminal at which somebody types this and hangs up, and all that is on its screen.
    pub(crate) fn on_a_terminal(&self, arguments: &[&str], typed: &str) -> (i32, String) {
        let program = Built::command("waypost");
        let words = [program.get_program().to_str().unwrap()].into_iter();
        let words = words.chain(arguments.iter().copied());
        let quoted: Vec<String> = words.map(|word| format!("'{}'", word.replace('\'', r"'\''"))).collect();
        let line = format!("{} --server {}", quoted.join(" "), self.endpoint());
        let keys = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(keys.path(), typed).unwrap();
        let mut script = launch::command("script");
        // Gives what it runs a terminal, types what it reads into it, and ends with its exit code.
        script.args(["--quiet", "--return", "--command", &line, "/dev/null"]);
        script.stdin(File::open(keys.path()).unwrap()).env("XDG_CACHE_HOME", self.cache());
        let Output { status, stdout, stderr: _ } = run_to_its_end(script);
        (status.code().unwrap(), String::from_utf8(stdout).unwrap())
    }

    /// What a command that succeeds prints.
    #[track_caller]
    pub(crate) fn text(&self, arguments: &[&str]) -> String {
        let Output { status, stdout, stderr } = self.run(arguments);
        assert!(status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&stderr));
        String::from_utf8(stdout).unwrap()
    }

    /// The one object that a command prints with `--json`.
    #[track_caller]
    pub(crate) fn json(&self, arguments: &[&str]) -> Value {
        json_object(&self.text(&[arguments, &["--json"]].concat()))
    }

    /// Exit code and stderr of a command that fails; nothing may be on stdout.
    #[track_caller]
    pub(crate) fn fails(&self, arguments: &[&str]) -> (i32, String) {
        let Output { status, stdout, stderr } = self.run(arguments);
        assert_eq!(String::from_utf8(stdout).unwrap(), "", "{arguments:?}");
        (status.code().unwrap(), String::from_utf8(stderr).unwrap())
    }

    /// Imports the shipped model, and makes a map of it.
    pub(crate) fn prepare(&self) {
        self.text(&["model", "import", path(&model_file()), "--name", "shipped"]);
        self.text(&["map", "create", "drive", "--model", "shipped"]);
    }

    /// The same with a map that goes by words alone.
    pub(crate) fn prepare_by_words(&self) {
        self.text(&["model", "import", path(&model_file()), "--name", "shipped"]);
        self.create_by_words("drive");
    }

    /// As [`super::by_words_request`].
    pub(crate) fn create_by_words(&self, map: &str) {
        let threshold = BY_WORDS_THRESHOLD.to_string();
        let alone = ["--verification", "none", "--closure-threshold", &threshold];
        self.text(&[&["map", "create", map, "--model", "shipped"][..], &alone].concat());
    }
}

/// Exactly one JSON object, and nothing after it.
#[track_caller]
pub(crate) fn json_object(text: &str) -> Value {
    let value: Value = serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"));
    assert!(value.is_object(), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    value
}

pub(crate) fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The first frames of the shipped drive, as a folder.
pub(crate) fn folder(frames: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (index, image) in images().iter().take(frames).enumerate() {
        std::fs::write(folder.path().join(format!("{index:06}.jpg")), image).unwrap();
    }
    folder
}
