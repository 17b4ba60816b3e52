use super::*;
use crate::descriptor::Descriptors;
use proptest::prelude::*;
use rand::SeedableRng;

const KINDS: [DescriptorKind; 2] = [DescriptorKind::Float, DescriptorKind::Binary];

fn run(set: &TrainingSet<'_>, count: usize, iterations: u32, seed: u64) -> Clusters {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    cluster(set, count, iterations, &mut random, &mut |_| ControlFlow::Continue(())).unwrap()
}

proptest! {
    #[test]
    fn inertia_never_rises_and_clusters_are_whole(
        bytes in proptest::collection::vec(prop_oneof![any::<u8>(), 0..3u8], 4..1200),
        count in 1..60usize, seed in any::<u64>(),
    ) {
        for kind in KINDS {
            let descriptors = Descriptors::new(kind, 4, bytes[..bytes.len() / 4 * 4].to_vec()).unwrap();
            let set = TrainingSet::new(&descriptors);
            let count = count.min(set.len());
            let mut inertia = u64::MAX;
            for iterations in [0, 1, 2, 3, 30] {
                let clusters = run(&set, count, iterations, seed);
                prop_assert!(clusters.inertia <= inertia);
                inertia = clusters.inertia;

                prop_assert!(clusters.members(4).iter().all(|members| !members.is_empty()));
                let mut centres: Vec<&[u8]> = clusters.centres.chunks_exact(4).collect();
                centres.sort_unstable();
                prop_assert!(centres.is_sorted_by(|a, b| a < b), "two equal centres");
                for (row, nearest) in set.rows.iter().zip(&clusters.assigned) {
                    let centre = clusters.centres.chunks_exact(4).nth(nearest.id as usize).unwrap();
                    prop_assert_eq!(kind.distance(row, centre), nearest.distance);
                }
            }
        }
    }

    #[test]
    fn no_centre_is_better_than_the_mean_or_the_majority(
        bytes in proptest::collection::vec(any::<u8>(), 1..40), other in any::<u8>(), old in any::<u8>(),
    ) {
        for kind in KINDS {
            let mut centre = [old];
            let rows = bytes.chunks(1).map(|row| (row, 3));
            match kind {
                DescriptorKind::Float => move_to_mean(&mut centre, rows, 3 * bytes.len() as u64),
                DescriptorKind::Binary => move_to_majority(&mut centre, rows, 3 * bytes.len() as u64),
            }
            let inertia = |centre: u8| bytes.iter().map(|&row| kind.distance(&[row], &[centre])).sum::<u32>();
            prop_assert!(inertia(centre[0]) <= inertia(other));
        }
    }
}

#[test]
fn halves_round_up_and_tied_bits_stay() {
    let mut mean = [0, 0];
    move_to_mean(&mut mean, [(&[1u8, 7][..], 1), (&[2, 7][..], 1)].into_iter(), 2);
    assert_eq!(mean, [2, 7]);
    let mut majority = [0b1010];
    move_to_majority(&mut majority, [(&[0b1100u8][..], 1), (&[0b0101][..], 1)].into_iter(), 2);
    assert_eq!(majority, [0b1100]);
}

#[test]
fn repeated_rows_count_as_often_as_they_occur() {
    let descriptors = Descriptors::new(DescriptorKind::Float, 1, vec![10, 10, 10, 20]).unwrap();
    let set = TrainingSet::new(&descriptors);
    assert_eq!((set.len(), set.weights.as_slice()), (2, &[3, 1][..]));
    let clusters = run(&set, 1, 5, 0);
    assert_eq!((clusters.centres, clusters.inertia), (vec![13], 3 * 9 + 49));
}

#[test]
fn an_empty_cluster_takes_the_farthest_row() {
    let descriptors = Descriptors::new(DescriptorKind::Float, 1, vec![0, 1, 9, 100, 104]).unwrap();
    let set = TrainingSet::new(&descriptors);
    let clusters = assign(&set, vec![2, 2, 200], 0, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(clusters.centres, [2, 100, 200]);
    let ids: Vec<u32> = clusters.assigned.iter().map(|nearest| nearest.id).collect();
    assert_eq!(ids, [0, 0, 0, 1, 2]);
}
