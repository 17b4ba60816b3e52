//! Lines of g2o's text, and the graph that they make.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::ops::Range;

use nalgebra::{Isometry3, Quaternion, SMatrix, Translation3};

use super::{G2oError, LineProblem, NamedGraph};
use crate::trajectory::unit;
use crate::{Edge, EdgeError, EdgeKind, PlanarPose, Pose, PoseGraph};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dimension {
    Plane,
    Space,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tag {
    Vertex(Dimension),
    Edge(Dimension),
    Fix,
}

/// A line with something on it.
pub(super) struct Line<'a> {
    pub(super) number: usize,
    pub(super) tag: Tag,
    pub(super) columns: Vec<&'a str>,
}

impl Tag {
    const ALL: [Tag; 5] = [
        Tag::Vertex(Dimension::Plane),
        Tag::Edge(Dimension::Plane),
        Tag::Vertex(Dimension::Space),
        Tag::Edge(Dimension::Space),
        Tag::Fix,
    ];

    pub(super) fn named(name: &str) -> Result<Self, LineProblem> {
        let found = Self::ALL.into_iter().find(|tag| tag.name() == name);
        found.ok_or_else(|| LineProblem::UnknownTag(name.to_owned()))
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Tag::Vertex(Dimension::Plane) => "VERTEX_SE2",
            Tag::Edge(Dimension::Plane) => "EDGE_SE2",
            Tag::Vertex(Dimension::Space) => "VERTEX_SE3:QUAT",
            Tag::Edge(Dimension::Space) => "EDGE_SE3:QUAT",
            Tag::Fix => "FIX",
        }
    }

    pub(super) fn dimension(self) -> Option<Dimension> {
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
pub(super) trait Columns<const D: usize>: Pose<D> {
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
        let rotation = unit(quaternion).ok_or(LineProblem::NoRotation)?;
        Ok(Isometry3::from_parts(Translation3::new(numbers[0], numbers[1], numbers[2]), rotation))
    }

    fn numbers(&self) -> Vec<f64> {
        let position = &self.translation.vector;
        let quaternion = &self.rotation.coords;
        position.iter().chain(quaternion.iter()).copied().collect()
    }
}

/// Columns of an edge after its tag: two ids, the measurement, the upper triangle.
fn edge_columns<P: Columns<D>, const D: usize>() -> usize {
    2 + P::NUMBERS + D * (D + 1) / 2
}

/// The graph that lines of one dimension make.
pub(super) fn read<P: Columns<D>, const D: usize>(lines: &[Line<'_>]) -> Result<NamedGraph<P, D>, G2oError> {
    let given = vertices::<P, D>(lines)?;
    let ids = if given.is_empty() { ends::<P, D>(lines)? } else { given.keys().copied().collect() };
    let mut graph = PoseGraph::new(ids.len());
    for line in lines {
        match line.tag {
            Tag::Vertex(_) => {}
            Tag::Edge(_) => {
                let edge = edge::<P, D>(line, &ids)?;
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
    Ok(NamedGraph { ids, graph, poses })
}

fn vertices<P: Columns<D>, const D: usize>(lines: &[Line<'_>]) -> Result<BTreeMap<u64, P>, G2oError> {
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
fn ends<P: Columns<D>, const D: usize>(lines: &[Line<'_>]) -> Result<Vec<u64>, G2oError> {
    let mut ids = Vec::new();
    for line in lines.iter().filter(|line| line.tag == Tag::Edge(P::DIMENSION)) {
        line.expect(edge_columns::<P, D>())?;
        ids.extend([line.id(0)?, line.id(1)?]);
    }
    ids.sort_unstable();
    ids.dedup();
    Ok(ids)
}

fn edge<P: Columns<D>, const D: usize>(line: &Line<'_>, ids: &[u64]) -> Result<Edge<P, D>, G2oError> {
    line.expect(edge_columns::<P, D>())?;
    let ((from_id, from), (to_id, to)) = (line.vertex(0, ids)?, line.vertex(1, ids)?);
    let numbers = line.numbers(2..edge_columns::<P, D>())?;
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

/// A graph as text: vertices, what is fixed, edges.
pub(super) fn write<P: Columns<D>, const D: usize>(graph: &NamedGraph<P, D>) -> Vec<u8> {
    let mut text = String::new();
    let vertex = Tag::Vertex(P::DIMENSION).name();
    let edge_tag = Tag::Edge(P::DIMENSION).name();
    for (id, pose) in graph.ids.iter().zip(graph.poses.iter().flatten()) {
        append(&mut text, format_args!("{vertex} {id}"), pose.numbers());
    }
    for pose in graph.graph.fixed().keys() {
        append(&mut text, format_args!("FIX {}", graph.ids[*pose]), []);
    }
    for edge in graph.graph.edges() {
        let triangle = (0..D).flat_map(|row| (row..D).map(move |column| edge.information()[(row, column)]));
        let from = graph.ids[edge.from()];
        let to = graph.ids[edge.to()];
        let numbers = edge.measurement().numbers().into_iter().chain(triangle);
        append(&mut text, format_args!("{edge_tag} {from} {to}"), numbers);
    }
    text.into_bytes()
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
