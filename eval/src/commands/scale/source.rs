//! The map's places and the queries, drawn one by one.

use anyhow::Result;
use fabmap::appearance::PlaceId;
use fabmap::chow_liu::ChowLiuTree;
use fabmap::observation::Observation;
use rayon::prelude::*;

use super::ScaleOptions;
use crate::workload::{Revisit, Use, Workload, WorkloadSettings};

/// The map's places and the queries, drawn at random; place i is looked at 1 + i mod `most_looks` times.
pub(super) struct Source {
    workload: Workload,
    pub(super) places: u32,
    most_looks: u8,
    samples: u32,
    queries: u32,
}

/// An observation and where it was made.
pub(super) struct Query {
    /// The place visited; `None` for a new one.
    pub(super) place: Option<u32>,
    /// What was seen.
    pub(super) observation: Observation,
}

impl Source {
    pub(super) fn new(options: &ScaleOptions) -> Result<Self> {
        let &ScaleOptions { places, words, most_looks, samples, queries, seed, .. } = options;
        let workload = Workload::new(WorkloadSettings { words, seed, ..WorkloadSettings::default() })?;
        Ok(Self { workload, places, most_looks, samples, queries })
    }

    pub(super) fn tree(&self) -> &ChowLiuTree {
        self.workload.tree()
    }

    /// What a model is made of.
    pub(super) fn training(&self) -> Vec<Observation> {
        self.workload.images(Use::Training, self.samples)
    }

    /// What is seen of a place, look by look.
    pub(super) fn looks(&self, place: u32) -> Vec<Observation> {
        self.workload.looks(place, 1 + (place % u32::from(self.most_looks)) as u8)
    }

    /// The queries of a map of the first `places` places: revisits and new places in turn.
    pub(super) fn queries(&self, places: u32) -> Vec<Observation> {
        let query = |index: u32| match index % 2 {
            0 => self.workload.revisit_to_one_of(index, places).observation,
            _ => self.workload.image(Use::NewQuery, index),
        };
        (0..self.queries).into_par_iter().map(query).collect()
    }

    /// Queries of the whole map with where they were made: the first half revisits.
    pub(super) fn judged_queries(&self) -> Vec<Query> {
        let revisit = |index: u32| {
            let Revisit { place, observation } = self.workload.revisit_to_one_of(index, self.places);
            Query { place: Some(place), observation }
        };
        let half = self.queries / 2;
        let new = self.workload.images(Use::NewQuery, self.queries - half).into_iter();
        let new = new.map(|observation| Query { place: None, observation });
        (0..half).into_par_iter().map(revisit).collect::<Vec<_>>().into_iter().chain(new).collect()
    }

    /// Looks at places all over the map.
    pub(super) fn revisits(&self, count: u32, places: u32) -> Vec<(PlaceId, Observation)> {
        let chosen = |index: u32| (u64::from(index) * u64::from(places) / u64::from(count)) as u32;
        let look = |index| (chosen(index), self.workload.revisit_to(index, chosen(index)));
        (0..count).into_par_iter().map(look).collect()
    }
}
