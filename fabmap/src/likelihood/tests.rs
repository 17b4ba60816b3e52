use super::*;
use crate::test_worlds::{self, World};
use proptest::prelude::*;

proptest! {
    #[test]
    fn an_exponent_scales_every_log_likelihood(world in test_worlds::worlds(30, 3), exponent in 0.01..1.0f64) {
        let World { model, observations, appearances } = world;
        let tempered = model.clone().with_exponent(EvidenceExponent::new(exponent).unwrap());
        for (z, place) in observations.iter().zip(&appearances) {
            let plain = exponent * model.dense_log_likelihood(z, place);
            let value = tempered.dense_log_likelihood(z, place);
            prop_assert!((value - plain).abs() <= 1e-9 * plain.abs(), "{value} {plain}");
            let plain = exponent * model.dense_log_likelihood(z, &Appearance::of(z));
            let value = tempered.single_looks(z).log_likelihood(z);
            prop_assert!((value - plain).abs() <= 1e-9 * plain.abs(), "{value} {plain}");
        }
    }

    #[test]
    fn the_sparse_average_place_is_the_dense_one(world in test_worlds::worlds(30, 4)) {
        let World { model, observations, .. } = world;
        for z in &observations {
            let dense = model.dense_log_likelihood_of_average_place(z);
            let sparse = model.log_likelihood_of_empty_place(&model.informative_words(z), 0);
            prop_assert!((dense - sparse).abs() <= 1e-9 * dense.abs(), "{dense} {sparse}");
        }
    }

    #[test]
    fn a_single_look_is_the_dense_place(world in test_worlds::worlds(30, 4)) {
        let World { model, observations, .. } = world;
        for z in &observations {
            let single_looks = model.single_looks(z);
            for place in &observations {
                let dense = model.dense_log_likelihood(z, &Appearance::of(place));
                let single = single_looks.log_likelihood(place);
                prop_assert!((dense - single).abs() <= 1e-9 * dense.abs(), "{dense} {single}");
            }
        }
    }

    /// Σ_Z p(Z | L) over all observations of a small vocabulary. Naive Bayes is a distribution; the
    /// Chow-Liu form is one too, because each factor sums to 1 over z_q whatever the parent.
    #[test]
    fn likelihoods_are_probabilities(world in test_worlds::worlds(7, 3)) {
        let World { model, appearances, .. } = world;
        for place in &appearances {
            let total: f64 = (0..1u32 << 7)
                .map(|bits| Observation::from_words((0..7).filter(|q| bits >> q & 1 == 1), 7).unwrap())
                .map(|z| model.dense_log_likelihood(&z, place).exp())
                .sum();
            prop_assert!((total - 1.0).abs() < 1e-9, "{total}");
        }
    }
}
