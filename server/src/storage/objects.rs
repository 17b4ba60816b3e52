//! Media outside the database: objects in a bucket of S3, or files of a folder.
//!
//! An object is written before the row that names it, under a name that no other ever has, and never changed. So what a row
//! names is there. What no row names is of a frame that was never acknowledged, or of one that was deleted; it is deleted
//! once it is too old to be of a frame that is just being stored.

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use object_store::aws::AmazonS3Builder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{ClientOptions, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, RetryConfig};
use sha2::{Digest, Sha256};

use super::{MediaAddress, StorageError};

/// Content of at most so many bytes stays in its row: to ask for it elsewhere would take longer than to read it.
pub(super) const MOST_IN_ROW: usize = 4096;

/// Objects that are written, read or deleted at the same time.
pub(super) const AT_ONCE: usize = 16;

/// Each request is bounded in time, and so is trying it again.
const REQUEST_TIME: Duration = Duration::from_secs(10);
const CONNECT_TIME: Duration = Duration::from_secs(3);
const RETRIES: usize = 3;

/// The object with the mark of the database whose media these are.
const MARK: &str = "waypost-media";

/// Names an object, and tells whether it is the one that was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ObjectRef {
    /// Below the store's own folder.
    pub(super) name: String,
    pub(super) bytes: usize,
    pub(super) sha256: Vec<u8>,
}

/// Why an object is not handed out.
#[derive(Debug)]
pub(super) enum NoObject {
    /// There is none of this name.
    Gone,
    /// It is not what was written.
    Another,
    Failed(StorageError),
}

/// Where media lie.
pub(super) struct Objects {
    store: Arc<dyn ObjectStore>,
    folder: Path,
    address: MediaAddress,
}

impl fmt::Debug for Objects {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Objects").field("address", &self.address).finish_non_exhaustive()
    }
}

impl Objects {
    /// `None` for the database itself. Nothing is asked of the store yet.
    pub(super) fn at(address: &MediaAddress) -> Result<Option<Self>, StorageError> {
        let unfit = |error: object_store::Error| {
            StorageError::Unfit(format!("media cannot be put to {address}: {}", in_words(&error)))
        };
        let (store, folder): (Arc<dyn ObjectStore>, Path) = match address {
            MediaAddress::Database => return Ok(None),
            MediaAddress::Folder(folder) => {
                let files = LocalFileSystem::new_with_prefix(folder).map_err(unfit)?.with_fsync(true);
                (Arc::new(files), Path::default())
            }
            MediaAddress::S3 { bucket, prefix } => {
                let folder = Path::parse(prefix).map_err(|error| unfit(error.into()))?;
                // Where the process has one already, it is that one.
                let _ = rustls::crypto::ring::default_provider().install_default();
                let options =
                    ClientOptions::new().with_timeout(REQUEST_TIME).with_connect_timeout(CONNECT_TIME);
                let retry = RetryConfig {
                    max_retries: RETRIES,
                    retry_timeout: REQUEST_TIME,
                    ..RetryConfig::default()
                };
                // A server of one's own need not speak TLS; what names itself https:// does.
                let bucket = AmazonS3Builder::from_env()
                    .with_client_options(options.with_allow_http(true))
                    .with_retry(retry)
                    .with_bucket_name(bucket)
                    .build()
                    .map_err(unfit)?;
                (Arc::new(bucket), folder)
            }
        };
        Ok(Some(Self { store, folder, address: address.clone() }))
    }

    pub(super) fn address(&self) -> &MediaAddress {
        &self.address
    }

    /// Writes an object; returns when it is durable.
    pub(super) async fn put(&self, map: i64, content: &[u8]) -> Result<ObjectRef, StorageError> {
        let name = format!("maps/{map}/{}", random_name()?);
        let put = self.store.put(&self.path(&name), content.to_vec().into()).await;
        put.map_err(|error| self.failed(&error))?;
        Ok(ObjectRef { name, bytes: content.len(), sha256: Sha256::digest(content).to_vec() })
    }

    /// What was written.
    pub(super) async fn get(&self, object: &ObjectRef) -> Result<Vec<u8>, NoObject> {
        let got = async { self.store.get(&self.path(&object.name)).await?.bytes().await };
        let content = match got.await {
            Ok(content) => content,
            Err(object_store::Error::NotFound { .. }) => return Err(NoObject::Gone),
            Err(error) => return Err(NoObject::Failed(self.failed(&error))),
        };
        if content.len() == object.bytes && Sha256::digest(&content).as_slice() == object.sha256 {
            Ok(content.into())
        } else {
            Err(NoObject::Another)
        }
    }

    /// Names of the objects that were written longer than `age` ago, as the store lists them.
    pub(super) fn older_than(&self, age: Duration) -> BoxStream<'_, Result<String, StorageError>> {
        let objects = self.store.list(Some(&self.path("maps")));
        let name = move |object: ObjectMeta| {
            let written = SystemTime::from(object.last_modified);
            // One that was written in the future is none that is old.
            let is_old = written.elapsed().is_ok_and(|elapsed| elapsed >= age);
            let name = object.location.prefix_match(&self.folder).filter(|_| is_old);
            name.map(|parts| parts.map(|part| part.as_ref().to_owned()).collect::<Vec<_>>().join("/"))
        };
        let names = objects.try_filter_map(move |object| futures::future::ready(Ok(name(object))));
        names.map_err(|error| self.failed(&error)).boxed()
    }

    /// Deletes objects; one that is gone already will do.
    pub(super) async fn delete(&self, names: &[String]) -> Result<(), StorageError> {
        let delete = |name: &String| {
            let path = self.path(name);
            async move {
                match self.store.delete(&path).await {
                    Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
                    Err(error) => Err(self.failed(&error)),
                }
            }
        };
        let deletions: Vec<_> = names.iter().map(delete).collect();
        futures::stream::iter(deletions).buffer_unordered(AT_ONCE).try_collect().await
    }

    /// Which database's media these are, if any database's.
    pub(super) async fn mark(&self) -> Result<Option<String>, StorageError> {
        let got = async { self.store.get(&self.path(MARK)).await?.bytes().await };
        match got.await {
            Ok(mark) => Ok(Some(String::from_utf8_lossy(&mark).into_owned())),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.failed(&error)),
        }
    }

    /// Says that these are the media of the database with that mark. [`StorageError::Exists`] if they are another's.
    pub(super) async fn set_mark(&self, mark: &str) -> Result<(), StorageError> {
        let put = self.store.put_opts(&self.path(MARK), mark.to_owned().into(), PutMode::Create.into()).await;
        match put {
            Ok(_) => Ok(()),
            Err(object_store::Error::AlreadyExists { .. }) => Err(StorageError::Exists),
            Err(error) => Err(self.failed(&error)),
        }
    }

    fn path(&self, name: &str) -> Path {
        name.split('/').fold(self.folder.clone(), Path::join)
    }

    fn failed(&self, error: &object_store::Error) -> StorageError {
        StorageError::MediaHeldUp { address: self.address.to_string(), reason: in_words(error) }
    }
}

/// What went wrong, with its causes: the first is often no more than the name of an object.
fn in_words(error: &object_store::Error) -> String {
    let mut words = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(next) = cause {
        let said = next.to_string();
        if !words.contains(&said) {
            words.push_str(": ");
            words.push_str(&said);
        }
        cause = next.source();
    }
    words
}

/// A name that no other object has. [`StorageError::Unfit`] where the system has no random numbers: any other name might be
/// taken, and what is there would be lost.
pub(super) fn random_name() -> Result<String, StorageError> {
    let random = || {
        getrandom::u64().map_err(|error| {
            StorageError::Unfit(format!(
                "the system gives no random numbers ({error}); see to its /dev/urandom"
            ))
        })
    };
    Ok(format!("{:016x}{:016x}", random()?, random()?))
}
