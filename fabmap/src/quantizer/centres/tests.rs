use super::*;
use proptest::prelude::*;

const KINDS: [DescriptorKind; 2] = [DescriptorKind::Float, DescriptorKind::Binary];

fn brute_force(kind: DescriptorKind, width: usize, centres: &[u8], row: &[u8]) -> Nearest {
    let distances = centres.chunks_exact(width).map(|centre| kind.distance(centre, row));
    let (distance, id) = distances.zip(0..).min().unwrap();
    Nearest { id, distance }
}

/// Rows of few different bytes, so that equal distances are common.
fn rows(len: std::ops::Range<usize>) -> impl Strategy<Value = (usize, Vec<u8>, Vec<u8>)> {
    (1..70usize, len, 1..70usize, any::<bool>()).prop_flat_map(|(width, centres, queries, extreme)| {
        let byte = move || if extreme { prop_oneof![Just(0u8), Just(255)].boxed() } else { (0..4u8).boxed() };
        let bytes = move |len| proptest::collection::vec(byte(), len);
        (Just(width), bytes(width * centres), bytes(width * queries))
    })
}

proptest! {
    #[test]
    fn the_nearest_is_that_of_brute_force((width, centres, queries) in rows(1..60)) {
        for kind in KINDS {
            let packed = Centres::pack(kind, width, &centres);
            let mut nearest = vec![Nearest::default(); queries.len() / width];
            packed.nearest(&queries, &mut nearest);
            let distances = packed.distances(&queries);
            let distances = distances.chunks_exact(packed.len());
            for ((nearest, query), distances) in nearest.iter().zip(queries.chunks_exact(width)).zip(distances) {
                prop_assert_eq!(*nearest, brute_force(kind, width, &centres, query));
                prop_assert_eq!(packed.nearest_one(query), *nearest);
                let expected: Vec<u32> =
                    centres.chunks_exact(width).map(|centre| kind.distance(centre, query)).collect();
                prop_assert_eq!(distances, &expected[..]);
                prop_assert_eq!(packed.distances(query), expected);
            }
        }
    }

    #[test]
    fn centres_come_back_as_they_were((width, centres, _) in rows(1..60)) {
        for kind in KINDS {
            prop_assert_eq!(&Centres::pack(kind, width, &centres).rows(), &centres);
        }
    }
}

#[test]
fn the_widest_and_brightest_rows_do_not_overflow() {
    let width = crate::descriptor::Descriptors::MAX_WIDTH;
    let centres = [vec![0; width], vec![255; width], vec![128; width]].concat();
    let panels = Centres::pack(DescriptorKind::Float, width, &centres);
    let expected = DescriptorKind::Float.distance(&vec![0; width], &vec![255; width]);
    assert_eq!(panels.distances(&vec![255; width])[..2], [expected, 0]);
    assert_eq!(panels.nearest_one(&vec![250; width]).id, 1);
    assert_eq!(panels.nearest_one(&vec![0; width]), Nearest { id: 0, distance: 0 });
}
