//! The graph of a map, as it grows: a node for each place, whose image is the panorama that made the place.
//!
//! It hangs on the log and the stored features alone, taken in the order of places: however often it is built, and in
//! however many pieces, it comes out the same, and so it does from the links that are kept of it.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use crate::ingest::{FeatureRecord, PanoramicView};
use fabmap::appearance::PlaceId;
use waypost_navigation::appearance::epipolar::SearchSettings;
use waypost_navigation::appearance::graph::candidates::{CandidateIndex, IndexedFeature};
use waypost_navigation::appearance::graph::{AppearanceGraph, Checks, ImageId, Overlap, Panorama};

use super::LinkView;
use crate::error::ServiceError;
use crate::ingest::model::LoadedModel;
use crate::ingest::panoramic::PanoramicOptics;
use crate::storage::LinkRow;

/// Images that the index names to a robot that is lost.
const MAX_NAMED: usize = 64;

/// Places and what their panoramas have in common, at some moment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Graph {
    /// By image, rising: places without a panorama have none.
    places: Vec<PlaceId>,
    views: Vec<Arc<PanoramicView>>,
    index: CandidateIndex,
    links: AppearanceGraph,
    spaces: OnceLock<Vec<u32>>,
}

/// A panorama as it is compared, and as the index has it.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub(crate) view: Arc<PanoramicView>,
    indexed: Vec<IndexedFeature>,
}

/// A panorama that comes to the graph.
struct Coming<'a> {
    view: &'a PanoramicView,
    earlier: &'a [Arc<PanoramicView>],
}

impl Panorama for Coming<'_> {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        self.view.compare(&self.earlier[image as usize], &SearchSettings::default()).overlap
    }
}

impl Shown {
    /// None if the features came without descriptors, or lie in no panorama.
    pub(crate) fn new(
        model: &LoadedModel,
        optics: &PanoramicOptics,
        features: &FeatureRecord,
    ) -> Result<Option<Self>, ServiceError> {
        let Some(view) = optics.view(features) else { return Ok(None) };
        let signed = model.signatures().sign(features.words(), view.descriptors());
        let signed = signed.map_err(ServiceError::internal)?.into_iter();
        let indexed = signed.zip(view.rays()).map(|(word, ray)| IndexedFeature::new(word, ray)).collect();
        Ok(Some(Self { view: Arc::new(view), indexed }))
    }
}

impl Graph {
    /// By image, rising.
    pub(crate) fn places(&self) -> &[PlaceId] {
        &self.places
    }

    /// The image of a place; none if no panorama made it.
    pub(crate) fn image_of(&self, place: PlaceId) -> Option<ImageId> {
        self.places.binary_search(&place).ok().map(|image| image as ImageId)
    }

    pub(crate) fn place_of(&self, image: ImageId) -> Option<PlaceId> {
        self.places.get(image as usize).copied()
    }

    pub(crate) fn appearance(&self) -> &AppearanceGraph {
        &self.links
    }

    /// What a view and an image have in common; None if no motion joins them, or there is no such image.
    pub(crate) fn compare(&self, view: &PanoramicView, image: ImageId) -> Option<Overlap> {
        view.compare(self.views.get(image as usize)?, &SearchSettings::default()).overlap
    }

    /// The images that may show what a panorama does: all of a small map, else those that the index names.
    pub(crate) fn candidates(&self, shown: &Shown) -> Vec<ImageId> {
        if self.places.len() <= MAX_NAMED {
            return (0..self.places.len() as ImageId).collect();
        }
        self.index.most_voted(&shown.indexed, MAX_NAMED)
    }

    /// Convex spaces by image. It takes a while at first.
    pub(crate) fn spaces(&self) -> &[u32] {
        self.spaces.get_or_init(|| self.links.convex_spaces())
    }

    pub(crate) fn links(&self) -> impl Iterator<Item = LinkView> + '_ {
        self.links.links().filter_map(|(from, link)| {
            let from = self.place_of(from)?;
            let to = self.place_of(link.to)?;
            Some(LinkView { from, to, similarity: link.similarity })
        })
    }

    /// Adds the panorama of a place that is above all others, and looks for its links.
    pub(crate) fn add(&mut self, place: PlaceId, shown: Shown) {
        let coming = Coming { view: &shown.view, earlier: &self.views };
        let votes = self.index.votes(&shown.indexed);
        self.links.add(&coming, Checks::Promising(&votes));
        self.show(place, shown);
    }

    /// Adds the panorama of a place that is above all others, with the links that it was found to have: rising by the
    /// earlier place.
    pub(crate) fn restore(&mut self, place: PlaceId, shown: Shown, links: &[LinkRow]) {
        let image = self.links.add_image();
        for &LinkRow { place: _, earlier, similarity } in links {
            if let Some(other) = self.image_of(earlier) {
                self.links.link(image, other, similarity);
            }
        }
        self.show(place, shown);
    }

    fn show(&mut self, place: PlaceId, shown: Shown) {
        self.index.add(&shown.indexed);
        self.places.push(place);
        self.views.push(shown.view);
        self.spaces = OnceLock::new();
    }

    /// What a range of places has in common with earlier ones: by place, then by the earlier one.
    pub(crate) fn links_of_places(&self, places: Range<PlaceId>) -> impl Iterator<Item = LinkRow> + '_ {
        let [from, to] =
            [places.start, places.end].map(|place| self.places.partition_point(|known| *known < place));
        (from..to).flat_map(move |image| {
            let mut earlier: Vec<_> = self.links.neighbours(image as ImageId).to_vec();
            earlier.retain(|link| (link.to as usize) < image);
            earlier.sort_unstable_by_key(|link| link.to);
            earlier.into_iter().map(move |link| LinkRow {
                place: self.places[image],
                earlier: self.places[link.to as usize],
                similarity: link.similarity,
            })
        })
    }

    pub(crate) fn memory_bytes(&self) -> u64 {
        let ray = size_of::<[f64; 3]>();
        let view = |view: &Arc<PanoramicView>| view.descriptors().as_bytes().len() + ray * view.rays().len();
        (self.views.iter().map(view).sum::<usize>() + self.index.memory_bytes()) as u64
    }
}
