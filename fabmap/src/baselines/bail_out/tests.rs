use super::*;
use std::sync::Arc;

use crate::appearance::Appearance;
use crate::new_place::log_sum_exp;
use crate::test_worlds::{self, World};
use proptest::prelude::*;

fn best_of(scores: &[f64]) -> usize {
    (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(b.cmp(&a))).unwrap()
}

proptest! {
    #[test]
    fn survivors_have_the_dense_likelihood(world in test_worlds::worlds(60, 12), risk in 1e-9..0.9f64) {
        let World { model, appearances, observations } = world;
        let scorer = DenseScorer::new(Arc::new(model), &appearances);
        for z in &observations {
            let scores = scorer.bail_out(z, BailOutRisk::new(risk).unwrap());
            prop_assert_eq!(scores.log_likelihoods.len(), appearances.len());
            prop_assert!(!scores.survivors.is_empty());
            for &place in &scores.survivors {
                let dense = scorer.model().dense_log_likelihood(z, &appearances[place as usize]);
                let found = scores.log_likelihoods[place as usize];
                prop_assert!((dense - found).abs() <= 1e-9 * dense.abs().max(1.0), "{dense} {found}");
            }
        }
    }

    #[test]
    fn the_dense_scorer_is_the_dense_evaluation(world in test_worlds::worlds(60, 12)) {
        let World { model, appearances, observations } = world;
        let scorer = DenseScorer::new(Arc::new(model), &appearances);
        for z in &observations {
            for (found, place) in scorer.log_likelihoods(z).iter().zip(&appearances) {
                let dense = scorer.model().dense_log_likelihood(z, place);
                prop_assert!((dense - found).abs() <= 1e-9 * dense.abs().max(1.0), "{dense} {found}");
            }
        }
    }
}

/// Queries of which none was made at a place of the map: the best is the luckiest of unrelated
/// places, the hardest case. With a risk of 5 % at most 5 % may be lost, six standard deviations
/// allowed. And the normaliser is right but for as many.
#[test]
fn the_best_place_is_lost_no_more_often_than_the_risk_says() {
    let World { model, observations, .. } = test_worlds::fixed(300, 3000, 3);
    let (places, queries) = observations.split_at(1000);
    let appearances: Vec<Appearance> = places.iter().map(Appearance::of).collect();
    let scorer = DenseScorer::new(Arc::new(model), &appearances);
    let risk = BailOutRisk::new(0.05).unwrap();
    let (mut lost, mut wrong, mut dropped) = (0, 0, 0);
    for z in queries {
        let exact = scorer.log_likelihoods(z);
        let scores = scorer.bail_out(z, risk);
        lost += usize::from(!scores.survivors.contains(&(best_of(&exact) as u32)));
        wrong += usize::from((log_sum_exp(&scores.log_likelihoods) - log_sum_exp(&exact)).abs() > 0.1);
        dropped += places.len() - scores.survivors.len();
    }
    let most = 0.05 * queries.len() as f64 + 6.0 * (0.05 * 0.95 * queries.len() as f64).sqrt();
    assert!(lost as f64 <= most, "{lost} of {} lost", queries.len());
    assert!(wrong as f64 <= most, "{wrong} of {} normalisers are wrong", queries.len());
    assert!(dropped > places.len() * queries.len() / 2, "hardly any place is dropped: {dropped}");
}

#[test]
fn revisits_are_found_with_few_terms() {
    let World { model, observations, .. } = test_worlds::fixed(2000, 400, 8);
    let appearances: Vec<Appearance> = observations.iter().map(Appearance::of).collect();
    let scorer = DenseScorer::new(Arc::new(model), &appearances);
    let all = (observations.len() * 2000) as f64;
    for (place, z) in observations.iter().enumerate().step_by(17) {
        let scores = scorer.bail_out(z, BailOutRisk::default());
        assert_eq!(best_of(&scores.log_likelihoods), place);
        assert!(scores.terms as f64 <= 0.25 * all, "{} of {all} terms", scores.terms);
    }
}

#[test]
fn what_is_no_risk_is_refused() {
    for value in [0.0, 1.0, -1.0, f64::NAN] {
        assert!(BailOutRisk::new(value).is_err(), "{value}");
    }
    let nobody = DenseScorer::new(Arc::new(test_worlds::fixed(5, 1, 1).model), &[]);
    assert_eq!(nobody.bail_out(&Observation::default(), BailOutRisk::default()), BailOutScores::default());
}
