//! Pose graphs as text, as g2o reads and writes them.
//!
//! `VERTEX_SE2 id x y heading`, `EDGE_SE2 from to x y heading` and the upper triangle of the information matrix,
//! row by row; `VERTEX_SE3:QUAT` and `EDGE_SE3:QUAT` alike with `x y z qx qy qz qw`; `FIX id`. Metres and radians.
//! Edges between consecutive ids are odometry, all others closures. Numbers that are written read back bit for bit.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::ops::Range;

use nalgebra::{Isometry3, Quaternion, SMatrix, Translation3, UnitQuaternion};

use crate::relaxation::{Edge, EdgeError, EdgeKind, PlanarPose, Pose, PoseGraph};

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
            Some(Dimension::Plane) => NamedGraph::read(&lines).map(G2o::Planar),
            Some(Dimension::Space) => NamedGraph::read(&lines).map(G2o::Spatial),
        }
    }

    /// The text: vertices, what is fixed, edges.
    #[must_use]
    pub fn write(&self) -> Vec<u8> {
        match self {
            G2o::Planar(graph) => graph.write(),
            G2o::Spatial(graph) => graph.write(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dimension {
    Plane,
    Space,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Tag {
    Vertex(Dimension),
    Edge(Dimension),
    Fix,
}

struct Line<'a> {
    number: usize,
    tag: Tag,
    columns: Vec<&'a str>,
}

impl Tag {
    const ALL: [Tag; 5] = [
        Tag::Vertex(Dimension::Plane),
        Tag::Edge(Dimension::Plane),
        Tag::Vertex(Dimension::Space),
        Tag::Edge(Dimension::Space),
        Tag::Fix,
    ];

    fn named(name: &str) -> Result<Self, LineProblem> {
        let found = Self::ALL.into_iter().find(|tag| tag.name() == name);
        found.ok_or_else(|| LineProblem::UnknownTag(name.to_owned()))
    }

    fn name(self) -> &'static str {
        match self {
            Tag::Vertex(Dimension::Plane) => "VERTEX_SE2",
            Tag::Edge(Dimension::Plane) => "EDGE_SE2",
            Tag::Vertex(Dimension::Space) => "VERTEX_SE3:QUAT",
            Tag::Edge(Dimension::Space) => "EDGE_SE3:QUAT",
            Tag::Fix => "FIX",
        }
    }

    fn dimension(self) -> Option<Dimension> {
        match self {
            Tag::Vertex(dimension) | Tag::Edge(dimension) => Some(dimension),
            Tag::Fix => None,
        }
    }
}

impl Line<'_> {
    fn error(&self, problem: LineProblem) -> G2oError {
        G2oError::Line { line: self.number, problem }
    }

    fn expect(&self, expected: usize) -> Result<(), G2oError> {
        let found = self.columns.len();
        if found == expected {
            Ok(())
        } else {
            Err(self.error(LineProblem::Columns { tag: self.tag.name(), expected, found }))
        }
    }

    fn id(&self, column: usize) -> Result<u64, G2oError> {
        let text = self.columns[column];
        text.parse().map_err(|_| self.error(LineProblem::NotAnId(text.to_owned())))
    }

    /// The id in a column, and its place among all.
    fn vertex(&self, column: usize, ids: &[u64]) -> Result<(u64, usize), G2oError> {
        let id = self.id(column)?;
        let place = ids.binary_search(&id).map_err(|_| self.error(LineProblem::MissingVertex(id)))?;
        Ok((id, place))
    }

    fn numbers(&self, columns: Range<usize>) -> Result<Vec<f64>, G2oError> {
        let number = |text: &&str| match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) | Err(_) => Err(self.error(LineProblem::NotANumber((*text).to_owned()))),
        };
        self.columns[columns].iter().map(number).collect()
    }
}

/// How a pose is written.
trait Columns<const D: usize>: Pose<D> {
    const DIMENSION: Dimension;
    const NUMBERS: usize;
    fn from_numbers(numbers: &[f64]) -> Result<Self, LineProblem>;
    fn numbers(&self) -> Vec<f64>;
}

impl Columns<3> for PlanarPose {
    const DIMENSION: Dimension = Dimension::Plane;
    const NUMBERS: usize = 3;

    fn from_numbers(numbers: &[f64]) -> Result<Self, LineProblem> {
        Ok(PlanarPose::new(numbers[0], numbers[1], numbers[2]))
    }

    fn numbers(&self) -> Vec<f64> {
        vec![self.x_m(), self.y_m(), self.heading_rad()]
    }
}

impl Columns<6> for Isometry3<f64> {
    const DIMENSION: Dimension = Dimension::Space;
    const NUMBERS: usize = 7;

    fn from_numbers(numbers: &[f64]) -> Result<Self, LineProblem> {
        let quaternion = Quaternion::new(numbers[6], numbers[3], numbers[4], numbers[5]);
        // Scaled first: the square of a tiny number is zero, that of a huge one infinite.
        let largest = quaternion.coords.amax();
        if largest == 0.0 {
            return Err(LineProblem::NoRotation);
        }
        // What is of unit length already keeps its bits.
        let rotation = if (quaternion.norm_squared() - 1.0).abs() <= 16.0 * f64::EPSILON {
            UnitQuaternion::new_unchecked(quaternion)
        } else {
            UnitQuaternion::new_normalize(quaternion / largest)
        };
        Ok(Isometry3::from_parts(Translation3::new(numbers[0], numbers[1], numbers[2]), rotation))
    }

    fn numbers(&self) -> Vec<f64> {
        let (position, quaternion) = (&self.translation.vector, &self.rotation.coords);
        position.iter().chain(quaternion.iter()).copied().collect()
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

impl<P: Columns<D>, const D: usize> NamedGraph<P, D> {
    const EDGE_COLUMNS: usize = 2 + P::NUMBERS + D * (D + 1) / 2;

    fn read(lines: &[Line<'_>]) -> Result<Self, G2oError> {
        let given = Self::vertices(lines)?;
        let ids = if given.is_empty() { Self::ends(lines)? } else { given.keys().copied().collect() };
        let mut graph = PoseGraph::new(ids.len());
        for line in lines {
            match line.tag {
                Tag::Vertex(_) => {}
                Tag::Edge(_) => {
                    let edge = Self::edge(line, &ids)?;
                    // Both ends were just found among the ids.
                    let added = graph.add_edge(edge);
                    debug_assert!(added.is_ok());
                }
                Tag::Fix => {
                    for column in 0..line.columns.len() {
                        let (id, pose) = line.vertex(column, &ids)?;
                        // A single pose that is fixed anywhere only chooses the frame.
                        let anywhere = given.is_empty() && graph.fixed().keys().all(|&other| other == pose);
                        let at = given.get(&id).copied().or_else(|| anywhere.then(P::identity));
                        let at = at.ok_or_else(|| line.error(LineProblem::MissingVertex(id)))?;
                        let fixed = graph.fix(pose, at);
                        debug_assert!(fixed.is_ok());
                    }
                }
            }
        }
        let poses = (!given.is_empty()).then(|| given.into_values().collect());
        Ok(Self { ids, graph, poses })
    }

    fn vertices(lines: &[Line<'_>]) -> Result<BTreeMap<u64, P>, G2oError> {
        let mut vertices = BTreeMap::new();
        for line in lines.iter().filter(|line| line.tag == Tag::Vertex(P::DIMENSION)) {
            line.expect(1 + P::NUMBERS)?;
            let id = line.id(0)?;
            let numbers = line.numbers(1..1 + P::NUMBERS)?;
            let pose = P::from_numbers(&numbers).map_err(|problem| line.error(problem))?;
            if vertices.insert(id, pose).is_some() {
                return Err(line.error(LineProblem::VertexTwice(id)));
            }
        }
        Ok(vertices)
    }

    /// Ids of all vertices that edges have, ascending.
    fn ends(lines: &[Line<'_>]) -> Result<Vec<u64>, G2oError> {
        let mut ids = Vec::new();
        for line in lines.iter().filter(|line| line.tag == Tag::Edge(P::DIMENSION)) {
            line.expect(Self::EDGE_COLUMNS)?;
            ids.extend([line.id(0)?, line.id(1)?]);
        }
        ids.sort_unstable();
        ids.dedup();
        Ok(ids)
    }

    fn edge(line: &Line<'_>, ids: &[u64]) -> Result<Edge<P, D>, G2oError> {
        line.expect(Self::EDGE_COLUMNS)?;
        let ((from_id, from), (to_id, to)) = (line.vertex(0, ids)?, line.vertex(1, ids)?);
        let numbers = line.numbers(2..Self::EDGE_COLUMNS)?;
        let (pose, upper) = numbers.split_at(P::NUMBERS);
        let measurement = P::from_numbers(pose).map_err(|problem| line.error(problem))?;
        let mut information = SMatrix::<f64, D, D>::zeros();
        let triangle = (0..D).flat_map(|row| (row..D).map(move |column| (row, column)));
        for ((row, column), &value) in triangle.zip(upper) {
            information[(row, column)] = value;
            information[(column, row)] = value;
        }
        let kind = if from_id.abs_diff(to_id) == 1 { EdgeKind::Odometry } else { EdgeKind::Closure };
        Edge::new(from, to, measurement, information, kind).map_err(|error| {
            line.error(match error {
                EdgeError::Loop { .. } => LineProblem::Loop(from_id),
                EdgeError::NotPositiveDefinite { .. } | EdgeError::NotFinite { .. } => {
                    LineProblem::NotPositiveDefinite { from: from_id, to: to_id }
                }
            })
        })
    }

    fn write(&self) -> Vec<u8> {
        let mut text = String::new();
        let (vertex, edge_tag) = (Tag::Vertex(P::DIMENSION).name(), Tag::Edge(P::DIMENSION).name());
        for (id, pose) in self.ids.iter().zip(self.poses.iter().flatten()) {
            append(&mut text, format_args!("{vertex} {id}"), pose.numbers());
        }
        for (&pose, _) in self.graph.fixed() {
            append(&mut text, format_args!("FIX {}", self.ids[pose]), []);
        }
        for edge in self.graph.edges() {
            let triangle = (0..D).flat_map(|row| (row..D).map(move |column| edge.information()[(row, column)]));
            let (from, to) = (self.ids[edge.from()], self.ids[edge.to()]);
            let numbers = edge.measurement().numbers().into_iter().chain(triangle);
            append(&mut text, format_args!("{edge_tag} {from} {to}"), numbers);
        }
        text.into_bytes()
    }
}

/// One line; `{:?}` writes the shortest number that reads back to the same bits.
fn append(text: &mut String, begin: std::fmt::Arguments<'_>, numbers: impl IntoIterator<Item = f64>) {
    // Writing to a string cannot fail.
    let _ = text.write_fmt(begin);
    for number in numbers {
        let _ = write!(text, " {number:?}");
    }
    text.push('\n');
}
