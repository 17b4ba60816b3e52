use super::*;
use crate::test_worlds::{self, World};
use proptest::prelude::*;

fn term(new_place: &NewPlace, informative: &[WordState], places: usize) -> NewPlaceTerm {
    new_place.term(informative, places, &mut SampleWorkspace::default())
}

proptest! {
    #[test]
    fn the_sampled_term_is_the_mean_over_the_samples(world in test_worlds::worlds(20, 2)) {
        let World { model, observations, .. } = world;
        let model = Arc::new(model);
        let new_place = NewPlace::new(NewPlaceMethod::Sampled, &model, &observations).unwrap();
        for z in &observations {
            let mean = observations.iter()
                .map(|sample| model.dense_log_likelihood(z, &Appearance::of(sample)).exp())
                .sum::<f64>() / observations.len() as f64;
            let term = term(&new_place, &model.informative_words(z), 7).log_likelihood;
            prop_assert!((term - mean.ln()).abs() <= 1e-9 * term.abs().max(1.0), "{term} {}", mean.ln());
        }
    }

    /// Written from the definition, over dense likelihoods; of fewer than a hundred samples, a
    /// quarter is the tail.
    #[test]
    fn the_tail_is_that_of_the_dense_likelihoods(
        world in test_worlds::worlds(20, 1), samples in test_worlds::observations(20), places in 0..100_000usize,
    ) {
        let World { model, observations, .. } = world;
        let model = Arc::new(model);
        let new_place = NewPlace::new(NewPlaceMethod::Tail, &model, &samples).unwrap();
        for z in &observations {
            let mut dense: Vec<f64> = samples.iter()
                .map(|sample| model.dense_log_likelihood(z, &Appearance::of(sample)))
                .collect();
            dense.sort_by(|a, b| b.total_cmp(a));
            let n_s = dense.len() as f64;
            let mean = (dense.iter().map(|l| l.exp()).sum::<f64>() / n_s).ln();
            let top = ((n_s / 4.0).floor().max(1.0) as usize).min(dense.len() - 1);
            let scale = dense[..top].iter().map(|l| l - dense[top]).sum::<f64>() / (top as f64).max(1.0);
            let n = places.max(1) as f64;
            let best = dense[top] + scale * (n * (top as f64).max(1.0) / n_s / 0.01).ln();
            let term = term(&new_place, &model.informative_words(z), places).log_likelihood;
            let expected = mean.max(best - n.ln());
            prop_assert!((term - expected).abs() <= 1e-8 * term.abs().max(1.0), "{term} {expected}");
        }
    }

    /// The ratio against "somewhere new" is c over the share of unrelated places that are as
    /// likely, as far as the tail is one of scale 1 or more.
    #[test]
    fn tempered_ratios_are_those_of_the_tail(
        world in test_worlds::worlds(20, 1), samples in test_worlds::observations(20), nats in 0.0..500.0f64,
    ) {
        let World { model, observations, .. } = world;
        let model = Arc::new(model);
        let new_place = NewPlace::new(NewPlaceMethod::TemperedTail, &model, &samples).unwrap();
        for z in &observations {
            let mut dense: Vec<f64> = samples.iter()
                .map(|sample| model.dense_log_likelihood(z, &Appearance::of(sample)))
                .collect();
            dense.sort_by(|a, b| b.total_cmp(a));
            let n_s = dense.len() as f64;
            let top = ((n_s / 4.0).floor().max(1.0) as usize).min(dense.len() - 1);
            let scale = dense[..top].iter().map(|l| l - dense[top]).sum::<f64>() / (top as f64).max(1.0);
            let share = (top as f64).max(1.0) / n_s;
            let term = term(&new_place, &model.informative_words(z), 1);
            prop_assert!(term.temperature >= 1.0);
            prop_assert!((term.temperature - scale.max(1.0)).abs() <= 1e-8 * scale.max(1.0));
            if scale > 1.0 {
                let unrelated_as_likely = share.ln() - nats / scale;
                let expected = 0.05f64.ln() - unrelated_as_likely;
                let found = (dense[top] + nats - term.log_likelihood) / term.temperature;
                prop_assert!((found - expected).abs() < 1e-6 * (1.0 + nats), "{found} {expected}");
            }
        }
    }

    #[test]
    fn log_sum_exp_is_the_plain_sum(values in proptest::collection::vec(-20.0..20.0f64, 1..30)) {
        let plain = values.iter().map(|v| v.exp()).sum::<f64>().ln();
        prop_assert!((log_sum_exp(&values) - plain).abs() < 1e-9);
    }
}

#[test]
fn a_sum_of_tiny_likelihoods_is_not_zero() {
    assert!((log_sum_exp(&[-5000.0, -5000.0]) - (-5000.0 + 2f64.ln())).abs() < 1e-9);
    assert_eq!(log_sum_exp(&[]), f64::NEG_INFINITY);
}

#[test]
fn sampling_needs_samples() {
    let World { model, .. } = test_worlds::fixed(5, 1, 1);
    let model = Arc::new(model);
    assert!(NewPlace::new(NewPlaceMethod::Sampled, &model, &[]).is_err());
    assert!(NewPlace::new(NewPlaceMethod::Tail, &model, &[]).is_err());
    assert!(NewPlace::new(NewPlaceMethod::TemperedTail, &model, &[]).is_err());
    assert!(NewPlace::new(NewPlaceMethod::MeanField, &model, &[]).is_ok());
}
