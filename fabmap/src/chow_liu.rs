//! The Chow-Liu tree: which word tells most about which (Chow & Liu 1968; Cummins & Newman 2008,
//! eqs. (9)-(14)).

mod error;
mod training;

pub use error::ChowLiuError;
pub use training::{TreeTrainingError, TreeTrainingSettings};

use crate::codec::{DecodeError, Reader, Writer};
use crate::observation::WordId;

/// A forest over all words in which each word depends on at most one other, its parent p_q: p(Z) =
/// Π_q p(z_q | z_pq). Of all distributions of this form the trained one is nearest to that of the
/// training images (Chow & Liu 1968, "Approximating Discrete Probability Distributions with
/// Dependence Trees").
///
/// Holds p(z_q = 1), p(z_q = 1 | z_pq = 1) and p(z_q = 1 | z_pq = 0), all strictly between 0 and 1.
/// A word without a parent is a root; its conditionals are its marginal. A forest of roots alone is
/// the naive Bayes model, so that no formula needs a second form ([`ChowLiuTree::independent`]).
#[derive(Clone, Debug, PartialEq)]
pub struct ChowLiuTree {
    parents: Vec<WordId>,
    marginals: Vec<f64>,
    given_parent_seen: Vec<f64>,
    given_parent_unseen: Vec<f64>,
    first_child: Vec<u32>,
    children: Vec<WordId>,
}

/// One word's row of the tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WordDependence {
    /// The word that this one depends on; the word itself if it is a root.
    pub parent: WordId,
    /// p(z_q = 1).
    pub marginal: f64,
    /// p(z_q = 1 | z_pq = 1); the marginal for a root.
    pub given_parent_seen: f64,
    /// p(z_q = 1 | z_pq = 0); the marginal for a root.
    pub given_parent_unseen: f64,
}

impl ChowLiuTree {
    /// Makes a tree of one row per word, in order of word id.
    ///
    /// # Errors
    /// [`ChowLiuError`] if a parent does not exist, a probability is not strictly between 0 and 1,
    /// or the parents form a cycle.
    pub fn from_rows(rows: impl IntoIterator<Item = WordDependence>) -> Result<Self, ChowLiuError> {
        let rows: Vec<WordDependence> = rows.into_iter().collect();
        if rows.is_empty() || u32::try_from(rows.len()).is_err() {
            return Err(ChowLiuError::Size { words: rows.len() });
        }
        for (word, row) in WordId::all().zip(&rows) {
            if row.parent.index() >= rows.len() {
                return Err(ChowLiuError::Parent { word, parent: row.parent });
            }
            for probability in [row.marginal, row.given_parent_seen, row.given_parent_unseen] {
                if !(probability > 0.0 && probability < 1.0) {
                    return Err(ChowLiuError::Probability { word, probability });
                }
            }
        }
        let parents: Vec<WordId> = rows.iter().map(|row| row.parent).collect();
        if let Some(word) = word_on_cycle(&parents) {
            return Err(ChowLiuError::Cycle { word });
        }
        let (first_child, children) = children_of(&parents);
        let conditional = |of: fn(&WordDependence) -> f64| {
            WordId::all()
                .zip(&rows)
                .map(|(word, row)| if row.parent == word { row.marginal } else { of(row) })
                .collect()
        };
        Ok(Self {
            marginals: rows.iter().map(|row| row.marginal).collect(),
            given_parent_seen: conditional(|row| row.given_parent_seen),
            given_parent_unseen: conditional(|row| row.given_parent_unseen),
            parents,
            first_child,
            children,
        })
    }

    /// The same marginals with every word a root: naive Bayes.
    #[must_use]
    pub fn independent(&self) -> Self {
        let parents: Vec<WordId> = WordId::first(self.len()).collect();
        let (first_child, children) = children_of(&parents);
        Self {
            parents,
            marginals: self.marginals.clone(),
            given_parent_seen: self.marginals.clone(),
            given_parent_unseen: self.marginals.clone(),
            first_child,
            children,
        }
    }

    /// Number of words.
    #[must_use]
    pub fn len(&self) -> usize {
        self.parents.len()
    }

    /// A tree has at least one word; here for the convention.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.parents.is_empty()
    }

    /// p_q, or `None` for a root.
    ///
    /// # Panics
    /// If `word` is not below [`ChowLiuTree::len`]; so for every function of a word here.
    #[must_use]
    pub fn parent(&self, word: WordId) -> Option<WordId> {
        let parent = self.parents[word.index()];
        (parent != word).then_some(parent)
    }

    /// The words whose parent is `word`, ascending.
    #[must_use]
    pub fn children(&self, word: WordId) -> &[WordId] {
        let word = word.index();
        &self.children[self.first_child[word] as usize..self.first_child[word + 1] as usize]
    }

    /// p(z_q = `seen`).
    #[must_use]
    pub fn marginal(&self, word: WordId, seen: bool) -> f64 {
        let probability = self.marginals[word.index()];
        if seen { probability } else { 1.0 - probability }
    }

    /// p(z_q = `seen` | z_pq = `parent_seen`); the marginal for a root.
    #[must_use]
    pub fn conditional(&self, word: WordId, seen: bool, parent_seen: bool) -> f64 {
        let given = if parent_seen { &self.given_parent_seen } else { &self.given_parent_unseen };
        let probability = given[word.index()];
        if seen { probability } else { 1.0 - probability }
    }

    /// Appends the byte form: number of words, then 28 bytes a word.
    pub fn encode(&self, writer: &mut Writer) {
        writer.varint(self.len() as u64);
        for word in 0..self.len() {
            writer.u32(self.parents[word].number());
            writer.f64(self.marginals[word]);
            writer.f64(self.given_parent_seen[word]);
            writer.f64(self.given_parent_unseen[word]);
        }
    }

    /// Reads what [`ChowLiuTree::encode`] wrote.
    ///
    /// # Errors
    /// [`DecodeError`] if the bytes are cut or are not a tree.
    pub fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let words = reader.count(28)?;
        let mut rows = Vec::with_capacity(words);
        for _ in 0..words {
            rows.push(WordDependence {
                parent: WordId::new(reader.u32()?),
                marginal: reader.f64()?,
                given_parent_seen: reader.f64()?,
                given_parent_unseen: reader.f64()?,
            });
        }
        Self::from_rows(rows).map_err(DecodeError::invalid)
    }
}

/// Children in compressed rows: those of word q are `children[first_child[q]..first_child[q + 1]]`.
fn children_of(parents: &[WordId]) -> (Vec<u32>, Vec<WordId>) {
    let mut first_child = vec![0u32; parents.len() + 1];
    let with_parent =
        || WordId::all().zip(parents).filter(|&(word, &parent): &(WordId, &WordId)| word != parent);
    for (_, &parent) in with_parent() {
        first_child[parent.index() + 1] += 1;
    }
    for word in 0..parents.len() {
        first_child[word + 1] += first_child[word];
    }
    let mut next = first_child.clone();
    let mut children = vec![WordId::default(); first_child[parents.len()] as usize];
    for (word, &parent) in with_parent() {
        let slot = &mut next[parent.index()];
        children[*slot as usize] = word;
        *slot += 1;
    }
    (first_child, children)
}

/// Walks up from every word, each word once in all.
fn word_on_cycle(parents: &[WordId]) -> Option<WordId> {
    const UNSEEN: u32 = u32::MAX;
    let mut walk_of = vec![UNSEEN; parents.len()];
    for start in 0..parents.len() as u32 {
        let mut word = WordId::new(start);
        while walk_of[word.index()] == UNSEEN {
            walk_of[word.index()] = start;
            word = parents[word.index()];
        }
        if walk_of[word.index()] == start && parents[word.index()] != word {
            return Some(word);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(parent: u32) -> WordDependence {
        WordDependence {
            parent: WordId::new(parent),
            marginal: 0.2,
            given_parent_seen: 0.6,
            given_parent_unseen: 0.1,
        }
    }

    #[test]
    fn a_root_depends_on_nothing() {
        let tree = ChowLiuTree::from_rows([row(0), row(0), row(1), row(0)]).unwrap();
        assert_eq!(tree.parent(WordId::new(0)), None);
        assert_eq!(tree.conditional(WordId::new(0), true, true), 0.2);
        assert_eq!(tree.parent(WordId::new(2)), Some(WordId::new(1)));
        assert_eq!(tree.conditional(WordId::new(2), false, true), 0.4);
        assert_eq!(
            (tree.children(WordId::new(0)), tree.children(WordId::new(1)), tree.children(WordId::new(3))),
            (&[1, 3].map(WordId::new)[..], &[2].map(WordId::new)[..], &[][..])
        );
    }

    #[test]
    fn naive_bayes_is_a_forest_of_roots() {
        let tree = ChowLiuTree::from_rows([row(0), row(0)]).unwrap().independent();
        assert_eq!(tree.parent(WordId::new(1)), None);
        assert_eq!(tree.conditional(WordId::new(1), true, true), tree.marginal(WordId::new(1), true));
        assert!(tree.children(WordId::new(0)).is_empty());
    }

    #[test]
    fn what_is_no_tree_is_refused() {
        let refused = |rows: Vec<WordDependence>| ChowLiuTree::from_rows(rows).unwrap_err();
        assert_eq!(refused(vec![]), ChowLiuError::Size { words: 0 });
        assert_eq!(
            refused(vec![row(1)]),
            ChowLiuError::Parent { word: WordId::new(0), parent: WordId::new(1) }
        );
        assert!(matches!(refused(vec![row(0), row(2), row(3), row(1)]), ChowLiuError::Cycle { .. }));
        for certain in [0.0, 1.0, f64::NAN] {
            let rows = vec![WordDependence { given_parent_seen: certain, ..row(0) }];
            assert!(matches!(refused(rows), ChowLiuError::Probability { word, .. } if word.index() == 0));
        }
    }

    #[test]
    fn a_chain_of_a_million_words_needs_no_stack() {
        let chain = (0..1_000_000u32).map(|word| row(word.saturating_sub(1)));
        assert_eq!(
            ChowLiuTree::from_rows(chain).unwrap().children(WordId::new(999_998)),
            [WordId::new(999_999)]
        );
    }

    #[test]
    fn bytes_give_the_tree_back() {
        let tree = ChowLiuTree::from_rows([row(0), row(0), row(1)]).unwrap();
        let mut writer = Writer::default();
        tree.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(ChowLiuTree::decode(&mut Reader::new(&bytes)), Ok(tree));
    }
}
