//! Pose graphs as text, as g2o reads and writes them.
//!
//! `VERTEX_SE2 id x y heading`, `EDGE_SE2 from to x y heading` and the upper triangle of the
//! information matrix, row by row; `VERTEX_SE3:QUAT` and `EDGE_SE3:QUAT` alike with `x y z qx qy qz
//! qw`; `FIX id`. Metres and radians. Edges between consecutive ids are odometry, all others
//! closures. Numbers that are written read back bit for bit.

mod text;

use nalgebra::Isometry3;

use crate::{PlanarPose, Pose, PoseGraph};
use text::{Dimension, Line, Tag};

/// A pose graph in the plane or in space.
#[derive(Clone, Debug, PartialEq)]
pub enum G2o {
    /// `VERTEX_SE2`, `EDGE_SE2`.
    Planar(NamedGraph<PlanarPose, 3>),
    /// `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT`.
    Spatial(NamedGraph<Isometry3<f64>, 6>),
}

/// A pose graph whose poses have ids, and may have a place.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedGraph<P, const D: usize> {
    ids: Vec<u64>,
    graph: PoseGraph<P, D>,
    poses: Option<Vec<P>>,
}

/// Ids or poses that do not go with a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NamingError {
    /// There are more or fewer than the graph has poses.
    #[error("{given} ids or poses for a graph of {poses} poses; give one for each")]
    Count {
        /// How many were given.
        given: usize,
        /// How many poses there are.
        poses: usize,
    },
    /// Ids do not rise.
    #[error("the id {0} is not above the one before; give ids in ascending order, each once")]
    NotAscending(u64),
}

/// Why a text is no pose graph.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum G2oError {
    /// A line cannot be read.
    #[error("line {line}: {problem}")]
    Line {
        /// Its number, from 1.
        line: usize,
        /// What is wrong with it.
        problem: LineProblem,
    },
    /// There is neither a vertex nor an edge.
    #[error("there is no VERTEX or EDGE line; give a pose graph in g2o's text format")]
    Empty,
}

/// What is wrong with a line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LineProblem {
    /// It is not UTF-8.
    #[error("this is not text; give a pose graph in g2o's text format")]
    NotText,
    /// It begins with what we do not know.
    #[error(
        "the tag {0} is not known; leave out all but VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT and FIX"
    )]
    UnknownTag(String),
    /// It has too few or too many columns.
    #[error("{tag} needs {expected} numbers, this line has {found}; complete it or leave it out")]
    Columns {
        /// How the line begins.
        tag: &'static str,
        /// Columns that it should have after the tag.
        expected: usize,
        /// Columns that it has.
        found: usize,
    },
    /// A column is no finite number.
    #[error("{0} is not a finite number; write numbers like -1.25e-3, with a point")]
    NotANumber(String),
    /// A column is no id.
    #[error("{0} is not the id of a vertex; ids are whole numbers from 0")]
    NotAnId(String),
    /// The text was of the other kind so far.
    #[error("{0} in a text whose lines before are of the other dimension; split it in two")]
    MixedDimensions(&'static str),
    /// A vertex comes a second time.
    #[error("the vertex {0} was there before; leave out one of its lines")]
    VertexTwice(u64),
    /// An edge or `FIX` names a vertex without a line.
    #[error("there is no vertex {0}; add its VERTEX line, or leave out all VERTEX lines")]
    MissingVertex(u64),
    /// A quaternion has no direction.
    #[error("a quaternion has length 0; write 0 0 0 1 for no rotation")]
    NoRotation,
    /// Both ends of an edge are the same vertex.
    #[error("the edge {0} -> {0} leads to where it comes from; leave it out")]
    Loop(u64),
    /// The information matrix is none.
    #[error(
        "the information matrix of the edge {from} -> {to} is not positive definite; give the inverse of the \
         measurement's covariance, its upper triangle row by row"
    )]
    NotPositiveDefinite {
        /// Id of the vertex that the edge leaves.
        from: u64,
        /// Id of the vertex that it leads to.
        to: u64,
    },
}

impl G2o {
    /// Reads a text; blank lines and whatever follows a `#` do not count.
    ///
    /// # Errors
    /// [`G2oError`], which names the line.
    pub fn read(text: &[u8]) -> Result<Self, G2oError> {
        let mut lines = Vec::new();
        let mut dimension = None;
        for (index, bytes) in text.split(|&byte| byte == b'\n').enumerate() {
            let line = index + 1;
            let at_line = |problem| G2oError::Line { line, problem };
            let content = std::str::from_utf8(bytes).map_err(|_| at_line(LineProblem::NotText))?;
            let content = content.split('#').next().unwrap_or_default();
            let mut columns = content.split_whitespace();
            let Some(tag) = columns.next() else { continue };
            let tag = Tag::named(tag).map_err(at_line)?;
            if let Some(of_tag) = tag.dimension()
                && *dimension.get_or_insert(of_tag) != of_tag
            {
                return Err(at_line(LineProblem::MixedDimensions(tag.name())));
            }
            lines.push(Line { number: line, tag, columns: columns.collect() });
        }
        match dimension {
            None => Err(G2oError::Empty),
            Some(Dimension::Plane) => text::read(&lines).map(G2o::Planar),
            Some(Dimension::Space) => text::read(&lines).map(G2o::Spatial),
        }
    }

    /// The text: vertices, what is fixed, edges.
    #[must_use]
    pub fn write(&self) -> Vec<u8> {
        match self {
            G2o::Planar(graph) => text::write(graph),
            G2o::Spatial(graph) => text::write(graph),
        }
    }
}

impl<P, const D: usize> NamedGraph<P, D> {
    /// Gives poses their ids, and their places if there are any.
    ///
    /// # Errors
    /// [`NamingError`] if there are not as many as poses, or ids do not ascend.
    pub fn new(ids: Vec<u64>, graph: PoseGraph<P, D>, poses: Option<Vec<P>>) -> Result<Self, NamingError>
    where
        P: Pose<D>,
    {
        let lengths = [Some(ids.len()), poses.as_ref().map(Vec::len)];
        if let Some(given) = lengths.into_iter().flatten().find(|&given| given != graph.poses()) {
            return Err(NamingError::Count { given, poses: graph.poses() });
        }
        if let Some(pair) = ids.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(NamingError::NotAscending(pair[1]));
        }
        Ok(Self { ids, graph, poses })
    }

    /// Id of each pose, ascending.
    #[must_use]
    pub fn ids(&self) -> &[u64] {
        &self.ids
    }

    /// Poses in the order of their ids, and edges in the order of the text.
    #[must_use]
    pub fn graph(&self) -> &PoseGraph<P, D> {
        &self.graph
    }

    /// Where the text has each pose; `None` of a text that has edges alone.
    #[must_use]
    pub fn poses(&self) -> Option<&[P]> {
        self.poses.as_deref()
    }
}

#[cfg(test)]
mod tests;
