//! Servers that look at images for this one.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use fabmap::observation::Observation;
use http::{Request, StatusCode};
use hyper::client::conn::http2::SendRequest;
use prost::Message;
use rustls::ClientConfig;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use waypost_vision::feature_record::FeatureRecord;

use super::looking::{Look, PATH, Seen};
use super::model::LoadedModel;
use super::observed::Observed;
use super::panoramic::PanoramicOptics;
use crate::error::ServiceError;
use crate::map_settings::Keep;
use crate::net::neighbours;
use crate::net::peer::{self, Unreachable};
use crate::storage::{HelperRow, Medium, MediumKind};

/// Within which a helper has looked at an image, which takes a tenth of a second; then it is looked at here.
const PATIENCE: Duration = Duration::from_secs(5);

/// After which one is asked again that was given up.
const RETRY: Duration = Duration::from_secs(10);

/// What a helper answers at most: features of an image, and a small picture.
const MAX_SEEN_BYTES: usize = 8 << 20;

/// All helpers, with a place for each of their cores. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Helpers {
    free: Arc<Semaphore>,
    places: Arc<Mutex<Places>>,
    helped: Arc<AtomicU64>,
}

#[derive(Debug, Default)]
struct Places {
    /// Free ones; there are as many as `free` has permits, or more.
    free: VecDeque<Arc<Helper>>,
    known: Vec<Arc<Helper>>,
    /// Images that each has looked at, by its number; one that was given up and comes back goes on.
    helped: BTreeMap<i64, Arc<AtomicU64>>,
}

/// Another server, as this one asks it.
#[derive(Debug)]
pub(super) struct Helper {
    row: HelperRow,
    secret: Arc<str>,
    tls: Option<Arc<ClientConfig>>,
    connection: tokio::sync::Mutex<Option<SendRequest<Body>>>,
    /// Images that it has looked at.
    helped: Arc<AtomicU64>,
    /// Since when it is not asked any more.
    gone: OnceLock<Instant>,
}

/// A helper's core; free again when dropped.
#[derive(Debug)]
pub(super) struct Place {
    pub(super) helper: Arc<Helper>,
    helpers: Helpers,
    permit: Option<OwnedSemaphorePermit>,
}

/// Why a helper has not seen an image.
#[derive(Debug, thiserror::Error)]
pub(super) enum NotSeen {
    /// It is the image's fault: it would not be seen here either.
    #[error("{0}")]
    Refused(ServiceError),
    #[error("{0}")]
    Unreachable(#[from] Unreachable),
    #[error("it did not answer within {} s", PATIENCE.as_secs())]
    Late,
    #[error("it answered with status {0}")]
    Status(StatusCode),
    #[error("its answer cannot be read: {0}")]
    Unreadable(String),
}

impl Default for Helpers {
    fn default() -> Self {
        Self { free: Arc::new(Semaphore::new(0)), places: Arc::default(), helped: Arc::default() }
    }
}

impl Helpers {
    /// Which there are from now on, and how they are asked.
    pub(crate) fn set(&self, rows: &[HelperRow], secret: &Arc<str>, tls: Option<&Arc<ClientConfig>>) {
        let mut places = self.places();
        places.known.retain(|helper| {
            if !rows.contains(&helper.row) {
                tracing::info!(helper = helper.row.holder, "a server looks at no more images for this one");
                helper.gone.get_or_init(Instant::now);
                return false;
            }
            helper.gone.get().is_none_or(|since| since.elapsed() < RETRY)
        });
        for row in rows {
            if places.known.iter().any(|helper| helper.row == *row) {
                continue;
            }
            tracing::info!(helper = row.holder, cores = row.cores, "a server looks at images for this one");
            let helper = Arc::new(Helper {
                row: row.clone(),
                secret: secret.clone(),
                tls: tls.cloned(),
                connection: tokio::sync::Mutex::default(),
                helped: places.helped.entry(row.id).or_default().clone(),
                gone: OnceLock::new(),
            });
            let cores = row.cores as usize;
            places.free.extend(std::iter::repeat_n(helper.clone(), cores));
            self.free.add_permits(cores);
            places.known.push(helper);
        }
    }

    /// Cores of all helpers.
    pub(crate) fn cores(&self) -> usize {
        let places = self.places();
        let helpers = places.known.iter().filter(|helper| !helper.is_gone());
        helpers.map(|helper| helper.row.cores as usize).sum()
    }

    /// Images that helpers have looked at.
    pub(crate) fn helped(&self) -> u64 {
        self.helped.load(Ordering::Relaxed)
    }

    /// Images that the helper of that number has looked at; `None` if it is not asked now.
    pub(crate) fn helped_by(&self, id: i64) -> Option<u64> {
        let places = self.places();
        let helper = places.known.iter().find(|helper| helper.row.id == id && !helper.is_gone())?;
        Some(helper.helped.load(Ordering::Relaxed))
    }

    /// A helper's core, once one is free.
    pub(super) async fn place(&self) -> Place {
        loop {
            // Closed never.
            let Ok(permit) = self.free.clone().acquire_owned().await else { std::future::pending().await };
            let Some(helper) = self.places().free.pop_front() else { continue };
            if helper.is_gone() {
                permit.forget();
                continue;
            }
            return Place { helper, helpers: self.clone(), permit: Some(permit) };
        }
    }

    fn places(&self) -> MutexGuard<'_, Places> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// What an image shows, as the helper sees it.
    pub(super) async fn observe(
        &self,
        model: &LoadedModel,
        image: &Bytes,
        keep: Keep,
        optics: Option<&PanoramicOptics>,
    ) -> Result<Observed, NotSeen> {
        let thumbnail = keep >= Keep::Features;
        let panoramic_camera = optics.map(|optics| optics.camera().to_bytes()).unwrap_or_default();
        let look = Look { model: model.hash.clone(), thumbnail, image: image.clone(), panoramic_camera };
        let seen = tokio::time::timeout(PATIENCE, self.helper.look(&look)).await;
        let seen = seen.map_err(|_elapsed| NotSeen::Late)??;
        let observed = observed(model, seen, image, keep)?;
        self.helper.helped.fetch_add(1, Ordering::Relaxed);
        self.helpers.helped.fetch_add(1, Ordering::Relaxed);
        Ok(observed)
    }

    /// The helper is not asked any more, until it is there anew.
    pub(super) fn give_up(&self, why: &NotSeen) {
        tracing::warn!(helper = self.helper.row.holder, %why, "a server did not look at an image for this one");
        self.helper.gone.get_or_init(Instant::now);
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let permit = self.permit.take();
        if self.helper.is_gone() {
            if let Some(permit) = permit {
                permit.forget();
            }
        } else {
            self.helpers.places().free.push_back(self.helper.clone());
        }
    }
}

impl Helper {
    fn is_gone(&self) -> bool {
        self.gone.get().is_some()
    }

    async fn look(&self, look: &Look) -> Result<Seen, NotSeen> {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        let uri = format!("{scheme}://{}{PATH}", self.row.address);
        let request = Request::post(uri).body(Body::from(look.encode_to_vec()));
        let mut request = request.map_err(Unreachable::from)?;
        neighbours::tell(request.headers_mut(), std::net::Ipv4Addr::LOCALHOST.into(), &self.secret);
        let mut sender = self.sender().await?;
        let response = sender.send_request(request).await.map_err(Unreachable::from)?;
        if response.status() != StatusCode::OK {
            return Err(NotSeen::Status(response.status()));
        }
        let bytes = axum::body::to_bytes(Body::new(response.into_body()), MAX_SEEN_BYTES).await;
        let bytes = bytes.map_err(|error| NotSeen::Unreadable(error.to_string()))?;
        Seen::decode(bytes).map_err(|error| NotSeen::Unreadable(error.to_string()))
    }

    async fn sender(&self) -> Result<SendRequest<Body>, Unreachable> {
        let mut connection = self.connection.lock().await;
        if let Some(sender) = connection.as_ref().filter(|sender| !sender.is_closed()) {
            return Ok(sender.clone());
        }
        let sender = peer::connect(&self.row.address, self.tls.as_ref(), std::future::pending()).await?;
        *connection = Some(sender.clone());
        Ok(sender)
    }
}

/// As if it had been seen here.
fn observed(model: &LoadedModel, seen: Seen, image: &Bytes, keep: Keep) -> Result<Observed, NotSeen> {
    let Seen { features: kept, thumbnail, extract_s, quantize_s, refusal } = seen;
    if !refusal.is_empty() {
        return Err(NotSeen::Refused(ServiceError::invalid(refusal)));
    }
    let unreadable = |error: &dyn std::fmt::Display| NotSeen::Unreadable(error.to_string());
    let features = FeatureRecord::from_bytes(&kept).map_err(|error| unreadable(&error))?;
    let observation =
        Observation::from_words(features.words().iter().copied(), model.model.vocabulary().len())
            .map_err(|error| unreadable(&error))?;
    let mut media = Vec::new();
    if keep >= Keep::Features {
        media.push(Medium { kind: MediumKind::Features, content: kept });
        media.push(Medium { kind: MediumKind::Thumbnail, content: thumbnail });
    }
    if keep >= Keep::Images {
        media.push(Medium { kind: MediumKind::Image, content: image.to_vec() });
    }
    let seconds = |seconds: f64| Duration::try_from_secs_f64(seconds).unwrap_or_default();
    Ok(Observed {
        observation,
        features: Some(Arc::new(features)),
        media,
        extract: seconds(extract_s),
        quantize: seconds(quantize_s),
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use futures::FutureExt;

    use super::*;

    fn row(id: i64, cores: i64) -> HelperRow {
        HelperRow { id, holder: format!("server {id}"), address: "127.0.0.1:1".to_owned(), cores }
    }

    fn set(helpers: &Helpers, rows: &[HelperRow]) {
        helpers.set(rows, &Arc::from("word"), None);
    }

    /// Places that are free now.
    fn all(helpers: &Helpers) -> Vec<Place> {
        std::iter::from_fn(|| helpers.place().now_or_never()).collect()
    }

    #[tokio::test]
    async fn there_is_a_place_for_each_core_of_those_that_are_there() {
        let helpers = Helpers::default();
        assert_eq!(all(&helpers).len(), 0);
        set(&helpers, &[row(1, 2), row(2, 1)]);
        let taken = all(&helpers);
        assert_eq!((taken.len(), helpers.cores()), (3, 3));
        assert_eq!([1, 2, 3].map(|id| helpers.helped_by(id)), [Some(0), Some(0), None]);
        // Told again, nothing is there twice.
        set(&helpers, &[row(1, 2), row(2, 1)]);
        assert_eq!(all(&helpers).len(), 0);
        drop(taken);
        assert_eq!(all(&helpers).len(), 3);
    }

    #[tokio::test]
    async fn places_of_those_that_are_gone_are_given_to_nobody() {
        let helpers = Helpers::default();
        set(&helpers, &[row(1, 2), row(2, 1)]);
        let mut taken = all(&helpers);
        // One place of the first is free when it goes, the other is not.
        let of_first = taken.iter().position(|place| place.helper.row.id == 1).unwrap();
        drop(taken.remove(of_first));
        set(&helpers, &[row(2, 1)]);
        drop(taken);
        let left = all(&helpers);
        assert!(left.len() == 1 && left[0].helper.row.id == 2, "{left:?}");
        drop(left);
        set(&helpers, &[row(2, 1), row(3, 4)]);
        assert_eq!((all(&helpers).len(), helpers.cores()), (5, 5));
    }

    #[tokio::test]
    async fn one_that_comes_back_goes_on_counting() {
        let helpers = Helpers::default();
        set(&helpers, &[row(1, 1), row(2, 1)]);
        let place = helpers.place().await;
        place.helper.helped.fetch_add(3, Ordering::Relaxed);
        drop(place);
        set(&helpers, &[row(2, 1)]);
        assert_eq!(helpers.helped_by(1), None);
        set(&helpers, &[row(1, 1), row(2, 1)]);
        assert_eq!([1, 2].map(|id| helpers.helped_by(id)), [Some(3), Some(0)]);
    }

    #[tokio::test]
    async fn one_that_is_given_up_is_left_alone_for_a_while() {
        let helpers = Helpers::default();
        set(&helpers, &[row(1, 3)]);
        let mut taken = all(&helpers);
        taken.pop().unwrap().give_up(&NotSeen::Late);
        assert_eq!(helpers.helped_by(1), None);
        drop(taken);
        set(&helpers, &[row(1, 3)]);
        assert_eq!((all(&helpers).len(), helpers.cores()), (0, 0));
        // Started anew, it is another.
        set(&helpers, &[row(4, 3)]);
        assert_eq!((all(&helpers).len(), helpers.cores()), (3, 3));
    }
}
