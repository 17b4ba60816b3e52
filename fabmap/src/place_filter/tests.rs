use super::*;
use crate::appearance::PlaceId;
use proptest::prelude::*;

fn filters() -> impl Strategy<Value = PlaceFilter> {
    (0.01..0.99f64, 0.001..=1.0f64, 0.5..=1.0f64).prop_map(
        |(new_place_prior, even_share, likelihood_smoothing)| {
            PlaceFilter::new(FilterSettings { new_place_prior, even_share, likelihood_smoothing }).unwrap()
        },
    )
}

fn motion_priors() -> impl Strategy<Value = MotionPrior> {
    (proptest::collection::vec(((0..30u32).prop_map(PlaceId::new), 0.0..1.0f64), 0..10), 0.0..1.0f64)
        .prop_map(|(places, even)| MotionPrior::from_weights(places, even))
}

fn total(distribution: &PlaceDistribution) -> f64 {
    distribution.places.iter().sum::<f64>() + distribution.new_place
}

fn untempered(log_likelihood: f64) -> NewPlaceTerm {
    NewPlaceTerm { log_likelihood, temperature: 1.0 }
}

fn all(prior: &PlacePrior) -> Vec<f64> {
    PlaceId::first(prior.places).map(|place| prior.of(place).unwrap()).collect()
}

proptest! {
    #[test]
    fn prior_and_posterior_sum_to_1(
        filter in filters(), motion in motion_priors(), likelihoods in proptest::collection::vec(-800.0..0.0f64, 30..60), new in -800.0..0.0f64,
    ) {
        let prior = filter.prior(&motion, likelihoods.len());
        prop_assert!((all(&prior).iter().sum::<f64>() + prior.new_place() - 1.0).abs() < 1e-12);
        prop_assert!((prior.new_place() - filter.settings().new_place_prior).abs() < 1e-12);
        prop_assert_eq!(prior.of(PlaceId::from_index(likelihoods.len())), None);
        let posterior = filter.update(&likelihoods, &untempered(new), &prior);
        prop_assert!((total(&posterior) - 1.0).abs() < 1e-12);
        prop_assert!(posterior.places.iter().all(|p| (0.0..=1.0).contains(p)));
    }

    /// Bayes' rule in plain arithmetic, on likelihoods that do not underflow.
    #[test]
    fn the_posterior_is_bayes_rule(
        filter in filters(), motion in motion_priors(), likelihoods in proptest::collection::vec(-30.0..0.0f64, 30..40), new in -30.0..0.0f64,
        temperature in prop_oneof![Just(1.0), 1.0..20.0f64],
    ) {
        let settings = filter.settings();
        let n = likelihoods.len() as f64;
        let term = NewPlaceTerm { log_likelihood: new, temperature };
        let likelihoods_of_all = &likelihoods;
        let likelihoods: Vec<f64> = likelihoods_of_all.iter().map(|l| new + (l - new) / temperature).collect();
        let sum: f64 = likelihoods.iter().map(|l| l.exp()).sum::<f64>() + new.exp();
        let smooth = |l: f64| settings.likelihood_smoothing * l.exp() / sum + (1.0 - settings.likelihood_smoothing) / (n + 1.0);
        let prior = filter.prior(&motion, likelihoods.len());
        let joint: Vec<f64> = likelihoods.iter().zip(all(&prior)).map(|(&l, p)| smooth(l) * p).collect();
        let joint_new = smooth(new) * prior.new_place();
        let evidence: f64 = joint.iter().sum::<f64>() + joint_new;
        let posterior = filter.update(likelihoods_of_all, &term, &prior);
        for (p, j) in posterior.places.iter().zip(&joint) {
            prop_assert!((p - j / evidence).abs() < 1e-12);
        }
        prop_assert!((posterior.new_place - joint_new / evidence).abs() < 1e-12);
    }

    #[test]
    fn carrying_loses_no_mass(
        weights in proptest::collection::vec(0.0..1.0f64, 1..200), new in 0.001..1.0f64, creates in any::<bool>(),
    ) {
        let all = weights.iter().sum::<f64>() + new;
        let places = weights.iter().map(|weight| weight / all).collect();
        let distribution = PlaceDistribution { places, new_place: new / all };
        let next = PlaceId::from_index(distribution.places.len());
        let belief = distribution.carry(creates.then_some(next));
        prop_assert!(belief.places.len() <= Belief::MAX_PLACES);
        prop_assert!(belief.places.is_sorted_by(|a, b| a.0 < b.0));
        let sum = belief.places.iter().map(|p| p.1).sum::<f64>() + belief.new_place + belief.remainder;
        prop_assert!((sum - 1.0).abs() < 1e-9);
        prop_assert_eq!(creates, belief.places.last().is_some_and(|p| p.0 == next && p.1 == distribution.new_place));
    }

    #[test]
    fn top_is_the_sorted_beginning(weights in proptest::collection::vec(0..30u8, 0..400), count in 0..60usize) {
        let distribution = PlaceDistribution { places: weights.iter().map(|&w| f64::from(w)).collect(), new_place: 0.0 };
        let mut sorted: Vec<(PlaceId, f64)> = PlaceId::all().zip(distribution.places.iter().copied()).collect();
        sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
        sorted.truncate(count);
        prop_assert_eq!(distribution.top(count), sorted);
    }
}

#[test]
fn log_odds_tell_near_certainties_apart() {
    let near = |doubt: f64| PlaceDistribution { places: vec![doubt, 1.0], new_place: 0.0 };
    assert!(near(1e-30).log_odds(PlaceId::new(1)) > near(1e-20).log_odds(PlaceId::new(1)));
    assert!((near(1e-20).log_odds(PlaceId::new(1)) - 20.0 * 10f64.ln()).abs() < 1e-9);
    assert!(
        near(0.0).log_odds(PlaceId::new(1)).is_finite() && near(0.0).log_odds(PlaceId::new(0)).is_finite()
    );
    let even = PlaceDistribution { places: vec![0.25, 0.25], new_place: 0.5 };
    assert!((even.log_odds(PlaceId::new(0)) - (0.25f64 / 0.75).ln()).abs() < 1e-15);
}

#[test]
fn an_empty_map_has_only_new_places() {
    let filter = PlaceFilter::new(FilterSettings::default()).unwrap();
    let prior = filter.prior(&MotionPrior::even(), 0);
    let posterior = filter.update(&[], &untempered(-100.0), &prior);
    assert_eq!(posterior, PlaceDistribution { places: vec![], new_place: 1.0 });
}

#[test]
fn motion_moves_the_mass_where_it_says() {
    let filter = PlaceFilter::new(FilterSettings::default()).unwrap();
    let prior = filter.prior(
        &MotionPrior::from_weights(
            vec![(PlaceId::new(3), 2.0), (PlaceId::new(1), 1.0), (PlaceId::new(3), 1.0)],
            0.0,
        ),
        5,
    );
    assert!((prior.of(PlaceId::new(3)).unwrap() - 0.1 * (0.9 * 0.75 + 0.1 / 5.0)).abs() < 1e-15);
    assert!((prior.of(PlaceId::new(0)).unwrap() - 0.1 * 0.1 / 5.0).abs() < 1e-15);
}

#[test]
fn settings_out_of_range_are_refused() {
    let refused = |settings| PlaceFilter::new(settings).unwrap_err();
    let good = FilterSettings::default();
    for value in [0.0, 1.0, f64::NAN] {
        assert!(matches!(
            refused(FilterSettings { new_place_prior: value, ..good }),
            FilterError::NewPlacePrior { .. }
        ));
    }
    for value in [0.0, 1.1, f64::NAN] {
        assert!(matches!(
            refused(FilterSettings { even_share: value, ..good }),
            FilterError::EvenShare { .. }
        ));
        let smoothing = FilterSettings { likelihood_smoothing: value, ..good };
        assert!(matches!(refused(smoothing), FilterError::LikelihoodSmoothing { .. }));
    }
}
