//! Which store has the media of a database, and what of it nobody needs any more.

use std::time::Duration;

use futures::TryStreamExt;
use futures::stream::TryChunksError;
use sqlx::query::QueryScalar;
use tokio_util::sync::CancellationToken;

use super::objects::{NoObject, ObjectRef, Objects, random_name};
use super::{MediaAddress, Storage, StorageError};

/// How often what no row names is looked for, and how soon after a start.
const SWEEP_EVERY: Duration = Duration::from_secs(6 * 3600);
const FIRST_SWEEP: Duration = Duration::from_secs(600);

/// An object of this age is not of a frame that is just being stored: statements are bounded in time.
const OLD: Duration = Duration::from_secs(3600);

/// Names that are looked up by one statement.
const NAMES: usize = 64;

/// Whether a store is the one that a database's media are in.
#[derive(Debug, PartialEq, Eq)]
enum Fits {
    Yes,
    /// Neither has heard of the other.
    New,
    /// It is; the database knew it by another address.
    Moved {
        mark: String,
    },
}

impl Storage {
    /// Sees to it that media go to the store where those of this database are.
    pub(crate) async fn settle_media_store(&self) -> Result<(), StorageError> {
        let known = self.known_store().await?;
        let is_known = known.is_some();
        match fits(self.objects.as_deref(), known).await {
            Ok(Fits::Yes) => Ok(()),
            Ok(Fits::New) => {
                let Some(objects) = &self.objects else { return Ok(()) };
                let mark = random_name()?;
                objects.set_mark(&mark).await.map_err(|error| match error {
                    StorageError::Exists => of_another(objects.address()),
                    other => other,
                })?;
                tracing::info!(address = %objects.address(), "media of frames go there from now on");
                self.know_store(objects.address(), &mark).await
            }
            Ok(Fits::Moved { mark }) => {
                let Some(objects) = &self.objects else { return Ok(()) };
                self.know_store(objects.address(), &mark).await
            }
            // It was looked at when this server started; frames wait until it answers.
            Err(error @ StorageError::MediaHeldUp { .. }) if is_known => {
                tracing::warn!(%error, "media cannot be written yet");
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    async fn known_store(&self) -> Result<Option<(String, String)>, StorageError> {
        if !self.engine.may_have_objects() {
            return Ok(None);
        }
        let select = sqlx::query_as("SELECT address, mark FROM media_store WHERE id = 1");
        Ok(select.fetch_optional(&self.readers).await?)
    }

    async fn know_store(&self, address: &MediaAddress, mark: &str) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query(
                "INSERT INTO media_store (id, address, mark) VALUES (1, $1, $2) \
                 ON CONFLICT (id) DO UPDATE SET address = excluded.address, mark = excluded.mark",
            )
            .bind(address.to_string())
            .bind(mark)
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// Until the server stops, deletes now and then what no row names.
    pub(crate) async fn keep_sweeping(self, stopping: CancellationToken) {
        if self.objects.is_none() {
            return;
        }
        let mut pause = FIRST_SWEEP;
        loop {
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = stopping.cancelled() => return,
            }
            pause = SWEEP_EVERY;
            let swept = tokio::select! {
                swept = self.sweep_media() => swept,
                () = stopping.cancelled() => return,
            };
            match swept {
                Ok(0) => {}
                Ok(deleted) => tracing::info!(deleted, "media that no frame has any more are deleted"),
                Err(error) => tracing::warn!(%error, "media that no frame has any more could not be deleted"),
            }
        }
    }

    /// Deletes the objects that no row names, but for new ones; how many these were.
    pub(crate) async fn sweep_media(&self) -> Result<u64, StorageError> {
        let Some(objects) = &self.objects else { return Ok(0) };
        let mut deleted = 0;
        let mut old = objects.older_than(OLD).try_chunks(NAMES);
        while let Some(names) = old.try_next().await.map_err(|TryChunksError(_, error)| error)? {
            let unnamed = self.unnamed(&names).await?;
            objects.delete(&unnamed).await?;
            deleted += unnamed.len() as u64;
        }
        Ok(deleted)
    }

    /// Those of some objects that no row names. Asked by the connection that writes, so that no copy of a row is being made,
    /// and as the owner of the database.
    async fn unnamed(&self, names: &[String]) -> Result<Vec<String>, StorageError> {
        let placeholders =
            (1..=names.len()).map(|number| format!("${number}")).collect::<Vec<_>>().join(", ");
        let select = format!("SELECT object FROM frame_media WHERE object IN ({placeholders})");
        let named: Vec<String> = self
            .write(async |transaction| {
                let query = sqlx::query_scalar(sqlx::AssertSqlSafe(select.clone()));
                let query = names.iter().fold(query, QueryScalar::bind);
                Ok(query.fetch_all(&mut **transaction).await?)
            })
            .await?;
        Ok(names.iter().filter(|name| !named.contains(name)).cloned().collect())
    }
}

/// Refuses media outside a database that is a file.
pub(crate) fn check_media_beside_sqlite(media: &MediaAddress) -> Result<(), StorageError> {
    match media {
        MediaAddress::Database => Ok(()),
        MediaAddress::S3 { .. } | MediaAddress::Folder(_) => Err(StorageError::Unfit(format!(
            "media go to {media} beside a storage of postgres://… alone: SQLite's file has them itself; leave --media \
             (WAYPOST_MEDIA, or media in the file) out"
        ))),
    }
}

/// What one who does not own a database of PostgreSQL can say of where its media are to be.
pub(crate) async fn inspect_media_store(database: &str, media: &MediaAddress) -> Result<(), StorageError> {
    let known = super::postgres::media_store(database).await?;
    let objects = Objects::at(media)?;
    let is_new = fits(objects.as_ref(), known).await? == Fits::New;
    match &objects {
        Some(objects) if is_new && objects.mark().await?.is_some() => Err(of_another(objects.address())),
        Some(_) | None => Ok(()),
    }
}

async fn fits(objects: Option<&Objects>, known: Option<(String, String)>) -> Result<Fits, StorageError> {
    match (objects, known) {
        (None, None) => Ok(Fits::Yes),
        (Some(_), None) => Ok(Fits::New),
        (None, Some((address, _))) => Err(StorageError::Unfit(format!(
            "media of this database are in {address}; say so with --media {address} (WAYPOST_MEDIA, or media in the file)"
        ))),
        (Some(objects), Some((address, mark))) => {
            if objects.mark().await?.as_ref() != Some(&mark) {
                return Err(StorageError::Unfit(format!(
                    "{} is not where the media of this database are, which were put to {address}; name that one, or copy all \
                     of it, waypost-media too",
                    objects.address()
                )));
            }
            let is_there = objects.address().to_string() == address;
            Ok(if is_there { Fits::Yes } else { Fits::Moved { mark } })
        }
    }
}

fn of_another(address: &MediaAddress) -> StorageError {
    StorageError::Unfit(format!(
        "{address} has the media of another database; name a folder in it of its own, as in {address}/halls. If no database \
         uses it any more, delete its waypost-media"
    ))
}

/// An object that cannot be read, in words that tell what was found.
pub(super) fn damage(object: &ObjectRef, found: &NoObject) -> String {
    let ObjectRef { name, .. } = object;
    match found {
        NoObject::Gone => format!("the object {name} of the media store is gone"),
        NoObject::Another | NoObject::Failed(_) => {
            format!("the object {name} of the media store is not what was written")
        }
    }
}
