//! The appearance graph of an open map: which places can be matched from which.

mod graph;
mod growth;

use fabmap::appearance::PlaceId;

pub(crate) use self::graph::{Graph, Shown};
pub(crate) use self::growth::{Ground, GrowingGraph};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinkView {
    pub(crate) from: PlaceId,
    pub(crate) to: PlaceId,
    pub(crate) similarity: f64,
}
