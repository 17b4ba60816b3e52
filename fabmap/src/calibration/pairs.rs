//! Two looks at one place, found among training images that are in order of time.

use crate::baselines::TfIdf;
use crate::observation::Observation;

/// Samples that follow each other and overlap: (earlier, later = earlier + 1), at most `most` of
/// them, evenly spread.
///
/// They overlap if their tf-idf cosine is above that of 99 in 100 pairs half the set apart, which
/// show different places. Images in no order have about as many such neighbours as chance gives.
pub(super) fn overlapping(samples: &[Observation], words: usize, most: usize) -> Vec<(usize, usize)> {
    let half = samples.len() / 2;
    let shows_enough = |index: usize| samples[index].len() >= MIN_WORDS;
    let pairs = |distance: usize| {
        (0..samples.len().saturating_sub(distance))
            .map(move |index| (index, index + distance))
            .filter(move |&(a, b)| shows_enough(a) && shows_enough(b))
    };
    let mut baseline = TfIdf::new(samples, words);
    samples.iter().for_each(|sample| baseline.add(sample));
    let cosines: Vec<Vec<f64>> = samples.iter().map(|sample| baseline.similarities(sample)).collect();
    let mut apart: Vec<f64> = pairs(half.max(1)).map(|(a, b)| cosines[a][b]).collect();
    apart.sort_by(f64::total_cmp);
    let Some(&chance) = apart.get(apart.len() * 99 / 100) else { return Vec::new() };
    let found: Vec<(usize, usize)> = pairs(1).filter(|&(a, b)| cosines[a][b] > chance).collect();
    let taken = found.len().min(most);
    (0..taken).map(|index| found[index * found.len() / taken]).collect()
}

/// Different words that an image must show to be compared.
const MIN_WORDS: usize = 10;

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(words: impl IntoIterator<Item = u32>) -> Observation {
        Observation::from_words(words, 4000).unwrap()
    }

    /// A walk: image i shows words 20 i to 20 i + 40, so neighbours share half of them.
    #[test]
    fn neighbours_of_a_walk_overlap() {
        let walk: Vec<Observation> = (0..60).map(|i| sample(20 * i..20 * i + 40)).collect();
        let all = overlapping(&walk, 4000, 1000);
        assert_eq!(all, (0..59).map(|i| (i, i + 1)).collect::<Vec<_>>());
        let some = overlapping(&walk, 4000, 10);
        assert_eq!((some.len(), some[0], some[9]), (10, (0, 1), (53, 54)));
    }

    #[test]
    fn images_that_share_nothing_or_show_nothing_make_no_pair() {
        let apart: Vec<Observation> = (0..60).map(|i| sample(60 * i..60 * i + 40)).collect();
        assert_eq!(overlapping(&apart, 4000, 1000), []);
        assert_eq!(overlapping(&vec![sample(0..5); 60], 4000, 1000), []);
        assert_eq!(overlapping(&[], 4000, 1000), []);
    }
}
