use super::*;
use proptest::prelude::*;

fn observations(images: &[Vec<u32>], words: usize) -> Vec<Observation> {
    images.iter().map(|image| Observation::from_words(image.iter().copied(), words).unwrap()).collect()
}

fn train(images: &[Vec<u32>], words: usize) -> ChowLiuTree {
    let settings = TreeTrainingSettings::default();
    ChowLiuTree::train(&observations(images, words), words, settings, &mut |_| ControlFlow::Continue(()))
        .unwrap()
}

/// From the definition, one state at a time.
fn plain_mutual_information(images: &[Vec<u32>], a: u32, b: u32) -> f64 {
    let share = |test: &dyn Fn(&Vec<u32>) -> bool| {
        images.iter().filter(|image| test(image)).count() as f64 / images.len() as f64
    };
    let mut sum = 0.0;
    for (x, y) in [(false, false), (false, true), (true, false), (true, true)] {
        let joint = share(&|image| image.contains(&a) == x && image.contains(&b) == y);
        if joint > 0.0 {
            let apart = share(&|image| image.contains(&a) == x) * share(&|image| image.contains(&b) == y);
            sum += joint * (joint / apart).ln();
        }
    }
    sum
}

/// Kruskal over all pairs that met.
fn brute_force_total(images: &[Vec<u32>], words: usize) -> f64 {
    let mut edges = Vec::new();
    for a in 0..words as u32 {
        for b in 0..a {
            if images.iter().any(|image| image.contains(&a) && image.contains(&b)) {
                edges.push((plain_mutual_information(images, a, b), a, b));
            }
        }
    }
    edges.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut component: Vec<usize> = (0..words).collect();
    let mut total = 0.0;
    for (mutual_information, a, b) in edges {
        let (from, to) = (component[a as usize], component[b as usize]);
        if from != to {
            total += mutual_information;
            component.iter_mut().filter(|c| **c == from).for_each(|c| *c = to);
        }
    }
    total
}

proptest! {
    #[test]
    fn the_forest_has_the_most_information_of_all(
        images in proptest::collection::vec(proptest::collection::vec(0..12u32, 0..7), 1..25),
    ) {
        let tree = train(&images, 12);
        let total: f64 = (0..12)
            .filter_map(|word| {
                let parent = tree.parent(WordId::new(word))?;
                Some(plain_mutual_information(&images, word, parent.number()))
            })
            .sum();
        let best = brute_force_total(&images, 12);
        prop_assert!((total - best).abs() < 1e-9, "{total} against {best}");
    }

    #[test]
    fn probabilities_never_reach_0_or_1_and_keep_rare_words_rare(
        images in proptest::collection::vec(proptest::collection::vec(0..6u32, 0..6), 1..40),
    ) {
        let tree = train(&images, 6);
        for word in 0..6 {
            let seen = images.iter().filter(|image| image.contains(&word)).count() as f64;
            let marginal = tree.marginal(WordId::new(word), true);
            prop_assert!(marginal > 0.0 && marginal < 1.0);
            // One image of prior moves a rate by less than one image.
            prop_assert!((marginal * images.len() as f64 - seen).abs() <= 1.0);
        }
    }
}

#[test]
fn words_that_never_meet_are_roots_of_their_own() {
    let tree = train(&[vec![0, 1], vec![0, 1], vec![2], vec![2, 3], vec![3], vec![]], 5);
    assert_eq!((tree.parent(WordId::new(0)), tree.parent(WordId::new(1))), (None, Some(WordId::new(0))));
    assert!(tree.parent(WordId::new(2)).is_none() || tree.parent(WordId::new(3)).is_none());
    assert_eq!(tree.parent(WordId::new(4)), None);
}

#[test]
fn conditionals_are_counts_with_a_prior_of_one_image() {
    let tree = train(&[vec![0, 1], vec![0, 1], vec![0], vec![]], 2);
    let marginal = (2.0 + (5.0 + 1.0) / (8.0 + 2.0)) / 5.0;
    assert!((tree.marginal(WordId::new(1), true) - marginal).abs() < 1e-15);
    assert!((tree.conditional(WordId::new(1), true, true) - (2.0 + marginal) / 4.0).abs() < 1e-15);
    assert!((tree.conditional(WordId::new(1), true, false) - (0.0 + marginal) / 2.0).abs() < 1e-15);
}

#[test]
fn what_cannot_be_learnt_from_is_refused() {
    let settings = TreeTrainingSettings::default();
    let go_on = &mut |_| ControlFlow::Continue(());
    let images = observations(&[vec![3]], 4);
    let refused =
        |settings, images: &[Observation], words| ChowLiuTree::train(images, words, settings, go_on);
    let mut refused = refused;
    assert_eq!(refused(settings, &[], 4), Err(TreeTrainingError::NoObservations));
    let unknown = TreeTrainingError::UnknownWord { observation: 0, word: WordId::new(3), words: 2 };
    assert_eq!(refused(settings, &images, 2), Err(unknown));
    let prior = TreeTrainingSettings { prior_images: 0.0 };
    assert_eq!(refused(prior, &images, 4), Err(TreeTrainingError::Prior { prior_images: 0.0 }));
}

#[test]
fn training_can_be_cancelled() {
    let images = observations(&[vec![0, 1]], 2);
    let cancelled =
        ChowLiuTree::train(&images, 2, TreeTrainingSettings::default(), &mut |_| ControlFlow::Break(()));
    assert_eq!(cancelled, Err(TreeTrainingError::Cancelled));
}
