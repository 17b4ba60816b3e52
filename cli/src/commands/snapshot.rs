//! `waypost map export` and `import`: a map with its model as one file.

use std::io;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use indicatif::ProgressBar;
use serde_json::json;
use tokio::fs::File;
use tokio::io::{AsyncRead, ReadBuf};
use tokio::sync::watch;
use waypost_client::{Client, v1};

use super::job;
use crate::failure::Failure;
use crate::files::Replacing;
use crate::names::short_map;
use crate::output::{Output, mebibytes};
use crate::progress;

/// The file appears under its name only when it is complete.
pub(crate) async fn export(
    client: &Client,
    name: &str,
    path: &Path,
    replacing: Replacing,
    output: Output,
) -> Result<(), Failure> {
    replacing.check_wanted(Some(path))?;
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = PathBuf::from(partial);
    let mut file = File::create(&partial).await.map_err(Failure::file("write", &partial))?;
    let spinner = progress::spinner(output, format!("exporting to {}", path.display()));
    let exported = tokio::select! {
        exported = client.export_map(name, &mut file) => exported.map_err(Failure::from),
        interrupt = tokio::signal::ctrl_c() => {
            Err(interrupt.map_or_else(Failure::Runtime, |()| Failure::Interrupted("export stopped".to_owned())))
        }
    };
    spinner.finish_and_clear();
    let exported = match exported {
        Ok(size_bytes) => {
            file.sync_all().await.map(|()| size_bytes).map_err(Failure::file("write", &partial))
        }
        Err(failure) => Err(failure),
    };
    drop(file);
    let size_bytes = match exported {
        Ok(size_bytes) => size_bytes,
        Err(failure) => {
            tokio::fs::remove_file(&partial).await.map_err(Failure::file("remove", &partial))?;
            return Err(failure);
        }
    };
    tokio::fs::rename(&partial, path).await.map_err(Failure::file("write", path))?;
    let name = format!("maps/{}", short_map(name));
    let object = json!({ "name": name, "file": path.to_string_lossy(), "size_bytes": size_bytes });
    output.result(&object, |out| writeln!(out, "{name} in {} ({})", path.display(), mebibytes(size_bytes)))
}

/// Uploads a snapshot and follows the job; returns the map.
pub(crate) async fn import(
    client: &Client,
    path: &Path,
    name: &str,
    output: Output,
) -> Result<v1::Map, Failure> {
    let file = File::open(path).await.map_err(Failure::file("read", path))?;
    let length = file.metadata().await.map_err(Failure::file("read", path))?.len();
    let bar = progress::bytes(output, format!("uploading {}", path.display()), length);
    let (stop, stopped) = watch::channel(false);
    let upload = client.import_map(name, Upload { file, bar: bar.clone(), stopped });
    let job = job::begun_by(upload, &stop, client, "nothing was imported").await?;
    bar.finish_and_clear();
    let job = job::follow(client, &job.name, output).await?;
    Ok(client.map(&job::result(job)?, v1::MapView::Basic).await?)
}

/// A file that is read with a progress bar. Reading fails once it is stopped, since an upload that
/// only ended would look complete.
struct Upload {
    file: File,
    bar: ProgressBar,
    stopped: watch::Receiver<bool>,
}

impl AsyncRead for Upload {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if *self.stopped.borrow() {
            return Poll::Ready(Err(io::Error::other("stopped")));
        }
        let before = buffer.filled().len();
        ready!(Pin::new(&mut self.file).poll_read(context, buffer))?;
        self.bar.inc((buffer.filled().len() - before) as u64);
        Poll::Ready(Ok(()))
    }
}
