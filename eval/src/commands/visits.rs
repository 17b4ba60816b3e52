//! `waypost-eval visits`: are places recognised better after more visits, though they change?

use std::path::PathBuf;

use fabmap::appearance::Appearance;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::place_filter::MotionPrior;
use fabmap::recognizer::{Association, Recognizer, RecognizerSettings};
use rayon::prelude::*;
use serde::Serialize;

use super::sequence::Knobs;
use crate::dataset::Sequence;
use crate::error::EvalError;
use crate::{files, progress};

/// What to run, on what.
#[derive(Clone, Debug, PartialEq)]
pub struct VisitsOptions {
    /// Folder with `images/` and `loops.csv`: the same places in the same order, visit after visit.
    pub sequence: PathBuf,
    /// Places a visit; at least 1.
    pub places: usize,
    /// The model file.
    pub model: PathBuf,
    /// FAB-MAP's settings; no more than its likelihoods and priors matter here.
    pub knobs: Knobs,
}

/// How often places were recognised, by how many visits had been learnt.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VisitsReport {
    /// Visits of the sequence.
    pub visits: usize,
    /// After one visit, after two.
    pub after: Vec<AfterVisits>,
}

/// The queries of all visits after the second, against maps of so many earlier visits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AfterVisits {
    /// Visits learnt.
    pub learnt: usize,
    /// Queries: every place of every later visit, against every choice of visits before it.
    pub queries: usize,
    /// Share whose right place is the most probable of all, "somewhere new" included.
    pub recognised: f64,
    /// Share for which a wrong place is.
    pub mistaken: f64,
    /// Share whose right place is the most probable of the known ones.
    pub nearest: f64,
}

/// Learns every choice of one and of two visits, queries with each later one from the third on, and
/// averages over visits: each counts as much, however many choices precede it. Nothing is learnt from
/// queries, and nothing is expected of motion.
///
/// # Errors
/// [`EvalError`]; [`EvalError::Visits`] if the frames do not make visits of so many places.
pub fn run(options: &VisitsOptions) -> Result<VisitsReport, EvalError> {
    let sequence = Sequence::open(&options.sequence)?;
    let (model, extractor) = files::read_model(&options.model)?;
    check(&sequence, options)?;
    let bar = progress::bar("frames", sequence.images.len());
    let mut observations = Vec::with_capacity(sequence.images.len());
    for path in bar.wrap_iter(sequence.images.iter()) {
        let (_, features) = extractor
            .extract_encoded(&files::read(path)?)
            .map_err(|reason| EvalError::Image { path: path.clone(), reason })?;
        let observation = model.vocabulary().observe(&features.descriptors);
        observations.push(
            observation
                .map_err(|reason| EvalError::ForeignVocabulary { path: options.model.clone(), reason })?,
        );
    }
    bar.finish_and_clear();
    let visits: Vec<&[Observation]> = observations.chunks(options.places).collect();
    let settings = options.knobs.settings(&model, options.places)?.recognizer;
    let report = measure(&model, settings, &visits)?;
    eprint!("{}", report.table());
    Ok(report)
}

/// Frames k, k + places, k + 2 places, ... have to be loops of each other, and no others.
fn check(sequence: &Sequence, options: &VisitsOptions) -> Result<(), EvalError> {
    let (frames, places) = (sequence.images.len(), options.places);
    let refused = |reason: String| EvalError::Visits { path: options.sequence.clone(), reason };
    if !frames.is_multiple_of(places) || frames / places < 3 {
        return Err(refused(format!("{frames} frames are not three or more visits of {places} places each")));
    }
    for query in 0..frames {
        for earlier in 0..query {
            let same = (query - earlier).is_multiple_of(places);
            if same != sequence.truth.is_loop(query, earlier) {
                let truth = if same { "is no loop" } else { "is a loop" };
                return Err(refused(format!(
                    "frame {query} with frame {earlier} {truth}, though a visit has {places} places"
                )));
            }
        }
    }
    Ok(())
}

fn measure(
    model: &Model,
    settings: RecognizerSettings,
    visits: &[&[Observation]],
) -> Result<VisitsReport, EvalError> {
    let empty = Recognizer::new(model, settings)
        .map_err(|reason| EvalError::Mapper(topomap::mapper::MapperError::Recognizer(reason)))?;
    let after = [1, 2].map(|learnt| {
        let of_visits: Vec<Tally> = (2..visits.len())
            .into_par_iter()
            .map(|visit| {
                let choices = choices(visit, learnt).into_iter();
                choices
                    .map(|chosen| {
                        let learnt: Vec<&[Observation]> =
                            chosen.into_iter().map(|chosen| visits[chosen]).collect();
                        tally(&empty, &learnt, visits[visit])
                    })
                    .sum()
            })
            .collect();
        AfterVisits::new(learnt, &of_visits)
    });
    Ok(VisitsReport { visits: visits.len(), after: after.to_vec() })
}

/// All choices of `learnt` of the visits before `visit`, ascending: each one, or each pair.
fn choices(visit: usize, learnt: usize) -> Vec<Vec<usize>> {
    match learnt {
        1 => (0..visit).map(|first| vec![first]).collect(),
        _ => (0..visit).flat_map(|second| (0..second).map(move |first| vec![first, second])).collect(),
    }
}

/// How the queries of one visit went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Tally {
    queries: usize,
    recognised: usize,
    mistaken: usize,
    nearest: usize,
}

/// Queries a map of the `learnt` visits with every frame of a later one; frame k shows place k.
fn tally(empty: &Recognizer, learnt: &[&[Observation]], queries: &[Observation]) -> Tally {
    let mut recognizer = empty.clone();
    for place in 0..queries.len() {
        let mut appearance = Appearance::default();
        learnt.iter().for_each(|visit| appearance.observe(&visit[place]));
        recognizer.add_place(&appearance);
    }
    let mut tally = Tally::default();
    for (place, query) in (0..).zip(queries) {
        let recognition = recognizer.recognize(query, &MotionPrior::even(), &mut ());
        let association = recognition.association();
        tally.queries += 1;
        tally.recognised += usize::from(association == Association::Seen(place));
        tally.mistaken += usize::from(matches!(association, Association::Seen(other) if other != place));
        let right = recognition.log_likelihoods[place as usize];
        tally.nearest += usize::from(recognition.log_likelihoods.iter().all(|&other| other <= right));
    }
    tally
}

impl std::iter::Sum for Tally {
    fn sum<I: Iterator<Item = Self>>(tallies: I) -> Self {
        tallies.fold(Self::default(), |a, b| Self {
            queries: a.queries + b.queries,
            recognised: a.recognised + b.recognised,
            mistaken: a.mistaken + b.mistaken,
            nearest: a.nearest + b.nearest,
        })
    }
}

impl AfterVisits {
    fn new(learnt: usize, of_visits: &[Tally]) -> Self {
        let mean = |count: fn(&Tally) -> usize| {
            let shares = of_visits.iter().map(|tally| count(tally) as f64 / tally.queries as f64);
            shares.sum::<f64>() / of_visits.len() as f64
        };
        Self {
            learnt,
            queries: of_visits.iter().map(|tally| tally.queries).sum(),
            recognised: mean(|tally| tally.recognised),
            mistaken: mean(|tally| tally.mistaken),
            nearest: mean(|tally| tally.nearest),
        }
    }
}

impl VisitsReport {
    fn table(&self) -> String {
        let mut table = "visits learnt  queries  recognised  mistaken  nearest of the known\n".to_owned();
        for AfterVisits { learnt, queries, recognised, mistaken, nearest } in &self.after {
            let percent = [recognised, mistaken, nearest].map(|share| format!("{:.1} %", 100.0 * share));
            let [recognised, mistaken, nearest] = percent;
            table.push_str(&format!(
                "{learnt:<13}  {queries:<7}  {recognised:<10}  {mistaken:<8}  {nearest}\n"
            ));
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_choice_of_earlier_visits_is_made_once() {
        assert_eq!(choices(3, 1), [[0], [1], [2]]);
        assert_eq!(choices(3, 2), [[0, 1], [0, 2], [1, 2]]);
    }

    #[test]
    fn every_visit_counts_as_much() {
        let few = Tally { queries: 2, recognised: 2, mistaken: 0, nearest: 2 };
        let many = Tally { queries: 100, recognised: 0, mistaken: 50, nearest: 0 };
        let AfterVisits { queries, recognised, mistaken, nearest, .. } = AfterVisits::new(1, &[few, many]);
        assert_eq!((queries, recognised, mistaken, nearest), (102, 0.5, 0.25, 0.5));
    }
}
