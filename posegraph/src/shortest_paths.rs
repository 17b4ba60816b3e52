//! Shortest paths through any graph: Dijkstra's search (Numerische Mathematik 1, 1959).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A step from a node to another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Where it leads.
    pub to: usize,
    /// Its length, at least 0.
    pub length: f64,
    /// The number of the edge that it goes along, by which [`ShortestPaths::way_to`] names it.
    pub edge: usize,
}

/// A search over nodes that are numbered from 0; its memory is kept from one search to the next.
///
/// Of equally near nodes the one of the lowest number is looked at first, and of equally short paths
/// the first one found stays, so the same graph gives the same paths.
#[derive(Clone, Debug)]
pub struct ShortestPaths {
    lengths: Vec<f64>,
    /// The node before each, and the edge from there.
    came_by: Vec<(usize, usize)>,
    reached: Vec<usize>,
    /// In the order in which they were looked at.
    settled: Vec<usize>,
    waiting: BinaryHeap<Reverse<(u64, usize)>>,
}

impl ShortestPaths {
    /// Of a graph of so many nodes.
    #[must_use]
    pub fn new(nodes: usize) -> Self {
        Self {
            lengths: vec![f64::INFINITY; nodes],
            came_by: vec![(0, 0); nodes],
            reached: Vec::new(),
            settled: Vec::new(),
            waiting: BinaryHeap::new(),
        }
    }

    /// Searches from the nearest of some nodes, and forgets the search before. Ends at the first
    /// node that is a goal, which it returns, or where all nodes that can be have been reached.
    ///
    /// `steps` are those that lead away from a node.
    pub fn search<S: IntoIterator<Item = Step>>(
        &mut self,
        starts: impl IntoIterator<Item = usize>,
        is_goal: impl Fn(usize) -> bool,
        steps: impl Fn(usize) -> S,
    ) -> Option<usize> {
        self.reached.drain(..).for_each(|node| self.lengths[node] = f64::INFINITY);
        self.settled.clear();
        self.waiting.clear();
        for start in starts {
            self.reach(start, 0.0, (start, usize::MAX));
        }
        while let Some(Reverse((bits, node))) = self.waiting.pop() {
            let length = f64::from_bits(bits);
            if length > self.lengths[node] {
                continue;
            }
            self.settled.push(node);
            if is_goal(node) {
                return Some(node);
            }
            for step in steps(node) {
                self.reach(step.to, length + step.length, (node, step.edge));
            }
        }
        None
    }

    fn reach(&mut self, node: usize, length: f64, came_by: (usize, usize)) {
        let known = self.lengths[node];
        if length < known {
            if known == f64::INFINITY {
                self.reached.push(node);
            }
            self.lengths[node] = length;
            self.came_by[node] = came_by;
            // The bits of positive numbers are in their order.
            self.waiting.push(Reverse((length.to_bits(), node)));
        }
    }

    /// How long the shortest path to each node is, as far as was searched; infinite where none was
    /// found.
    #[must_use]
    pub fn lengths(&self) -> &[f64] {
        &self.lengths
    }

    /// Of each node the start that its path comes from; `None` where there is none.
    #[must_use]
    pub fn origins(&self) -> Vec<Option<usize>> {
        let mut origins = vec![None; self.lengths.len()];
        for &node in &self.settled {
            let (before, _) = self.came_by[node];
            origins[node] = if before == node { Some(node) } else { origins[before] };
        }
        origins
    }

    /// The path to a node that was reached: the nodes from the start on, each with the edge by which
    /// it was reached; the start with `None`.
    #[must_use]
    pub fn way_to(&self, node: usize) -> Vec<(usize, Option<usize>)> {
        let mut way = Vec::new();
        let mut at = node;
        loop {
            let (before, edge) = self.came_by[at];
            way.push((at, (before != at).then_some(edge)));
            if before == at {
                break;
            }
            at = before;
        }
        way.reverse();
        way
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    type Edges = Vec<(usize, usize, f64)>;

    fn steps(edges: &Edges) -> impl Fn(usize) -> Vec<Step> {
        move |node| {
            let away = edges.iter().enumerate().filter(|(_, edge)| edge.0 == node);
            away.map(|(edge, &(_, to, length))| Step { to, length, edge }).collect()
        }
    }

    #[test]
    fn the_shortest_path_is_found_and_its_edges_named() {
        let edges = vec![(0, 1, 5.0), (0, 2, 1.0), (2, 1, 1.5), (1, 3, 1.0), (2, 1, 9.0)];
        let mut paths = ShortestPaths::new(5);
        assert_eq!(paths.search([0], |node| node == 3, steps(&edges)), Some(3));
        assert_eq!(paths.way_to(3), [(0, None), (2, Some(1)), (1, Some(2)), (3, Some(3))]);
        assert_eq!(paths.search([3], |node| node == 0, steps(&edges)), None);
        assert_eq!(paths.lengths(), [f64::INFINITY, f64::INFINITY, f64::INFINITY, 0.0, f64::INFINITY]);
        assert_eq!(paths.search([0, 1], |_| false, steps(&edges)), None);
        assert_eq!(paths.lengths(), [0.0, 0.0, 1.0, 1.0, f64::INFINITY]);
        assert_eq!(paths.origins(), [Some(0), Some(1), Some(0), Some(1), None]);
    }

    proptest! {
        /// Against Bellman and Ford's, with a search before it.
        #[test]
        fn lengths_are_those_of_all_edges_tried_often_enough(
            edges in prop::collection::vec((0..12_usize, 0..12_usize, 0..20_u8), 0..60),
        ) {
            let edges: Edges = edges.into_iter().map(|(from, to, length)| (from, to, f64::from(length))).collect();
            let mut plain = [f64::INFINITY; 12];
            plain[3] = 0.0;
            for _ in 0..12 {
                for &(from, to, length) in &edges {
                    plain[to] = plain[to].min(plain[from] + length);
                }
            }
            let mut paths = ShortestPaths::new(12);
            paths.search([7], |_| false, steps(&edges));
            paths.search([3], |_| false, steps(&edges));
            prop_assert_eq!(paths.lengths(), &plain[..]);
            for node in (0..12).filter(|&node| plain[node].is_finite()) {
                let edges_of_way = paths.way_to(node).into_iter().filter_map(|(_, edge)| edge);
                prop_assert_eq!(edges_of_way.map(|edge| edges[edge].2).sum::<f64>(), plain[node]);
                prop_assert_eq!(paths.origins()[node], Some(3));
            }
        }
    }
}
