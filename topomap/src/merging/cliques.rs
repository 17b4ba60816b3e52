//! Large sets whose members all agree with each other.

/// Who agrees with whom: a row of bits for each.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Agreements {
    rows: Vec<Vec<u64>>,
}

/// Members that a search begins with, those that most agree with.
const STARTS: usize = 64;

impl Agreements {
    /// Of rows that say for each member with which others it agrees, both ways alike.
    pub(super) fn new(rows: Vec<Vec<u64>>) -> Self {
        Self { rows }
    }

    pub(super) fn words(members: usize) -> usize {
        members.div_ceil(64)
    }

    /// A large set among `allowed` in which all agree with all, ascending; the same always. Finding
    /// the largest takes for ever; from each of the members that most agree with, the next is the
    /// one that leaves most to choose from (Pattabiraman et al., 2015, whose heuristic Mangelson et
    /// al. use).
    pub(super) fn large_set(&self, allowed: &[usize]) -> Vec<usize> {
        let mut mask = vec![0; Self::words(self.rows.len())];
        allowed.iter().for_each(|&member| mask[member / 64] |= 1 << (member % 64));
        let mut starts: Vec<(usize, usize)> =
            allowed.iter().map(|&member| (in_common(&self.rows[member], &mask), member)).collect();
        starts.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut best: Vec<usize> = Vec::new();
        for &(agreeing, start) in starts.iter().take(STARTS) {
            if agreeing < best.len() {
                break;
            }
            let set = self.grown(start, &mask, best.len());
            if set.len() > best.len() {
                best = set;
            }
        }
        best.sort_unstable();
        best
    }

    /// The set that grows from one member; nothing if it cannot become larger than `beat`.
    fn grown(&self, start: usize, mask: &[u64], beat: usize) -> Vec<usize> {
        let mut set = vec![start];
        let mut left = both(&self.rows[start], mask);
        loop {
            let remaining = members(&left);
            if set.len() + remaining.len() <= beat {
                return Vec::new();
            }
            let count = |&member: &usize| (in_common(&self.rows[member], &left), member);
            let counted: Vec<(usize, usize)> = remaining.iter().map(count).collect();
            let most = counted.iter().max_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)));
            let Some(&(agreeing, next)) = most else { return set };
            if agreeing + 1 < remaining.len() {
                set.push(next);
                left = both(&left, &self.rows[next]);
                continue;
            }
            // Those that agree with all that is left would come next, one by one.
            for (_, member) in counted.into_iter().filter(|&(others, _)| others == agreeing) {
                set.push(member);
                left[member / 64] &= !(1 << (member % 64));
            }
        }
    }
}

fn both(one: &[u64], other: &[u64]) -> Vec<u64> {
    one.iter().zip(other).map(|(a, b)| a & b).collect()
}

fn in_common(one: &[u64], other: &[u64]) -> usize {
    one.iter().zip(other).map(|(a, b)| (a & b).count_ones() as usize).sum()
}

fn members(set: &[u64]) -> Vec<usize> {
    let mut members = Vec::new();
    for (word, &bits) in set.iter().enumerate() {
        let mut bits = bits;
        while bits != 0 {
            members.push(64 * word + bits.trailing_zeros() as usize);
            bits &= bits - 1;
        }
    }
    members
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn agreements(members: usize, agree: impl Fn(usize, usize) -> bool) -> Agreements {
        let row = |one: usize| {
            let mut row = vec![0; Agreements::words(members)];
            for other in (0..members).filter(|&other| other != one && agree(one.min(other), one.max(other))) {
                row[other / 64] |= 1 << (other % 64);
            }
            row
        };
        Agreements::new((0..members).map(row).collect())
    }

    fn agree(agreements: &Agreements, one: usize, other: usize) -> bool {
        agreements.rows[one][other / 64] >> (other % 64) & 1 == 1
    }

    /// With how many of `set` one agrees.
    fn count_with(agreements: &Agreements, one: usize, set: &[usize]) -> usize {
        set.iter().filter(|&&other| agree(agreements, one, other)).count()
    }

    /// By trying all subsets.
    fn largest(agreements: &Agreements, members: usize) -> usize {
        let is_set = |subset: u32| {
            let inside: Vec<usize> = (0..members).filter(|&member| subset >> member & 1 == 1).collect();
            inside.iter().all(|&a| inside.iter().all(|&b| a == b || agree(agreements, a, b)))
        };
        (0..1_u32 << members).filter(|&subset| is_set(subset)).map(u32::count_ones).max().unwrap_or(0)
            as usize
    }

    proptest! {
        #[test]
        fn all_agree_with_all_and_none_could_be_added(bits in proptest::collection::vec(any::<bool>(), 190), members in 2..20usize) {
            let agreements = agreements(members, |one, other| bits[one + other * (other - 1) / 2]);
            let all: Vec<usize> = (0..members).collect();
            let set = agreements.large_set(&all);
            prop_assert!(set.iter().all(|&a| count_with(&agreements, a, &set) == set.len() - 1));
            let outside = all.iter().filter(|member| !set.contains(member));
            prop_assert!(outside.clone().all(|&a| count_with(&agreements, a, &set) < set.len()));
        }

        /// A set that was planted among random agreements is found.
        #[test]
        fn a_planted_set_is_found(bits in proptest::collection::vec(0..4u8, 78), planted in 6..10usize) {
            let agreements = agreements(13, |one, other| other < planted || bits[one + other * (other - 1) / 2] == 0);
            let all: Vec<usize> = (0..13).collect();
            prop_assert_eq!(agreements.large_set(&all).len(), largest(&agreements, 13));
        }
    }

    #[test]
    fn only_what_is_allowed_is_chosen() {
        let agreements = agreements(70, |one, other| (one < 40) == (other < 40));
        let all: Vec<usize> = (0..70).collect();
        assert_eq!(agreements.large_set(&all), (0..40).collect::<Vec<_>>());
        assert_eq!(agreements.large_set(&all[40..]), (40..70).collect::<Vec<_>>());
        assert_eq!(agreements.large_set(&[]), [0; 0]);
    }
}
