use super::*;
use proptest::prelude::*;

fn set(kind: DescriptorKind, width: usize, rows: usize) -> impl Strategy<Value = Descriptors> {
    proptest::collection::vec(any::<u8>(), width * rows)
        .prop_map(move |bytes| Descriptors::new(kind, width, bytes).unwrap())
}

/// Entry (i, j) is the distance of row i of `from` to row j of `to`.
fn distances(from: &Descriptors, to: &Descriptors) -> DMatrix<u32> {
    let mut columns = Vec::new();
    each_column(from, to, |column| columns.extend_from_slice(column));
    DMatrix::from_vec(from.len(), to.len(), columns)
}

fn mutual(distances: &DMatrix<u32>) -> Vec<Match> {
    let mut nearest = Nearest::of(distances.nrows());
    distances.column_iter().for_each(|column| nearest.take(column.as_slice()));
    nearest.mutual()
}

proptest! {
    /// The product is a faster way to the very same integers.
    #[test]
    fn distances_are_exact(
        from in set(DescriptorKind::Float, 128, 9),
        to in set(DescriptorKind::Float, 128, 2 * COLUMNS_AT_ONCE + 7),
    ) {
        let found = distances(&from, &to);
        for (row, a) in from.rows().enumerate() {
            for (column, b) in to.rows().enumerate() {
                prop_assert_eq!(found[(row, column)], DescriptorKind::Float.distance(a, b));
            }
        }
    }

    #[test]
    fn binary_distances_are_exact(from in set(DescriptorKind::Binary, 32, 9), to in set(DescriptorKind::Binary, 32, 7)) {
        let found = distances(&from, &to);
        for (row, a) in from.rows().enumerate() {
            for (column, b) in to.rows().enumerate() {
                prop_assert_eq!(found[(row, column)], DescriptorKind::Binary.distance(a, b));
            }
        }
    }

    /// Against the definition, by brute force.
    #[test]
    fn mutual_nearest_by_definition(values in proptest::collection::vec(0..30u32, 30)) {
        let distances = DMatrix::from_vec(6, 5, values);
        let unique_least = |values: Vec<u32>| {
            let least = *values.iter().min().unwrap();
            let mut rest = values.clone();
            let at = rest.iter().position(|&value| value == least).unwrap();
            rest.remove(at);
            (at, least, *rest.iter().min().unwrap())
        };
        let mut expected = Vec::new();
        for row in 0..6 {
            let (column, least, second) = unique_least(distances.row(row).iter().copied().collect());
            let (back, _, other) = unique_least(distances.column(column).iter().copied().collect());
            if back == row {
                let distinct = f64::from(least).sqrt() <= 0.9 * f64::from(second.min(other)).sqrt() + 1e-12;
                expected.push(Match { earlier: row, current: column, distinct });
            }
        }
        prop_assert_eq!(mutual(&distances), expected);
    }
}

#[test]
fn repeated_words_are_ambiguous_and_common_ones_nothing() {
    let found = of_same_word(&[7, 8, 9, 9, 9, 3].map(WordId::new), &[8, 7, 7, 9, 4].map(WordId::new));
    let matched = |earlier, current, distinct| Match { earlier, current, distinct };
    assert_eq!(found, [matched(0, 1, false), matched(0, 2, false), matched(1, 0, true)]);
}

#[test]
fn a_blank_view_matches_nothing() {
    assert_eq!(mutual(&DMatrix::zeros(0, 4)), []);
    assert_eq!(mutual(&DMatrix::zeros(4, 0)), []);
    // The only feature of either view has no second nearest to be confused with.
    assert_eq!(mutual(&DMatrix::zeros(1, 1)), [Match { earlier: 0, current: 0, distinct: true }]);
}
