//! Where the map's places and the queries come from.

use anyhow::Result;
use fabmap::appearance::PlaceId;
use fabmap::chow_liu::ChowLiuTree;
use fabmap::observation::Observation;
use rayon::prelude::*;

use super::ScaleOptions;
use crate::workload::files::{Query, WorkloadFiles};
use crate::workload::{Revisit, Use, Workload, WorkloadSettings};

/// Where the map's places and the queries come from, one by one.
pub(super) enum Source {
    /// Drawn at random; place i is looked at 1 + i mod `most_looks` times.
    Drawn { workload: Box<Workload>, places: u32, most_looks: u8, queries: u32 },
    /// Read from the files of the numpy generator.
    Files { places: Vec<Observation>, queries: Vec<Query> },
}

/// A source, and what a model is made of for it.
pub(super) struct Opened {
    pub(super) source: Source,
    pub(super) tree: ChowLiuTree,
    pub(super) training: Vec<Observation>,
}

impl Source {
    pub(super) fn open(options: &ScaleOptions) -> Result<Opened> {
        let &ScaleOptions { places, words, most_looks, samples, queries, seed, .. } = options;
        if let Some(folder) = &options.workload {
            let WorkloadFiles { tree, places, training, queries } = WorkloadFiles::open(folder)?;
            return Ok(Opened { source: Self::Files { places, queries }, tree, training });
        }
        let workload = Workload::new(WorkloadSettings { words, seed, ..WorkloadSettings::default() })?;
        Ok(Opened {
            tree: workload.tree().clone(),
            training: workload.images(Use::Training, samples),
            source: Self::Drawn { workload: Box::new(workload), places, most_looks, queries },
        })
    }

    pub(super) fn places(&self) -> u32 {
        match self {
            Self::Drawn { places, .. } => *places,
            Self::Files { places, .. } => places.len() as u32,
        }
    }

    /// What is seen of a place, look by look.
    pub(super) fn looks(&self, place: u32) -> Vec<Observation> {
        match self {
            Self::Drawn { workload, most_looks, .. } => {
                workload.looks(place, 1 + (place % u32::from(*most_looks)) as u8)
            }
            Self::Files { places, .. } => vec![places[place as usize].clone()],
        }
    }

    /// The queries of a map of the first `places` places.
    pub(super) fn queries(&self, places: u32) -> Vec<Observation> {
        match self {
            Self::Drawn { workload, queries, .. } => {
                let query = |index: u32| match index % 2 {
                    0 => workload.revisit_to_one_of(index, places).observation,
                    _ => workload.image(Use::NewQuery, index),
                };
                (0..*queries).into_par_iter().map(query).collect()
            }
            Self::Files { queries, .. } => queries.iter().map(|query| query.observation.clone()).collect(),
        }
    }

    /// Queries of the whole map with where they were made: the first half revisits, where they are drawn.
    pub(super) fn judged_queries(&self) -> Vec<Query> {
        match self {
            Self::Drawn { workload, places, queries, .. } => {
                let revisit = |index: u32| {
                    let Revisit { place, observation } = workload.revisit_to_one_of(index, *places);
                    Query { place: Some(place), observation }
                };
                let revisits = (0..queries / 2).into_par_iter().map(revisit);
                let new = workload.images(Use::NewQuery, queries - queries / 2).into_par_iter();
                revisits.chain(new.map(|observation| Query { place: None, observation })).collect()
            }
            Self::Files { queries, .. } => queries.clone(),
        }
    }

    /// Looks at places all over the map; those of files are other places' words, as good for measuring.
    pub(super) fn revisits(&self, count: u32, places: u32) -> Vec<(PlaceId, Observation)> {
        let chosen = |index: u32| (u64::from(index) * u64::from(places) / u64::from(count)) as u32;
        match self {
            Self::Drawn { workload, .. } => {
                let look = |index| (chosen(index), workload.revisit_to(index, chosen(index)));
                (0..count).into_par_iter().map(look).collect()
            }
            Self::Files { queries, .. } => {
                let looks = queries.iter().cycle();
                (0..count).zip(looks).map(|(index, look)| (chosen(index), look.observation.clone())).collect()
            }
        }
    }
}
