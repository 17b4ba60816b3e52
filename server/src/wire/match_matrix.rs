//! Match matrices as messages.

use fabmap::PlaceId;
use waypost_proto::v1;

use crate::service::match_matrix::{
    AxisView, Mark, MarkView, MatrixTile, MatrixView, SessionView, TILE_CELLS,
};

pub(crate) fn match_matrix(view: MatrixView) -> v1::MatchMatrix {
    let MatrixView { map, against, rows, columns, full_shade_nats, levels, marks } = view;
    v1::MatchMatrix {
        map,
        against,
        rows: Some(axis(rows)),
        columns: Some(axis(columns)),
        full_shade_nats,
        tile_cells: TILE_CELLS as u32,
        levels,
        marks: marks.into_iter().map(mark).collect(),
    }
}

pub(crate) fn tile(MatrixTile { content_type, picture }: MatrixTile) -> v1::GetMatchMatrixTileResponse {
    v1::GetMatchMatrixTileResponse { content_type: content_type.to_owned(), picture }
}

fn axis(AxisView { places, sessions }: AxisView) -> v1::MatrixAxis {
    let session = |SessionView { session, first, places }| v1::MatrixSession {
        session,
        first: first as u32,
        places: places as u32,
    };
    v1::MatrixAxis {
        place_numbers: places.into_iter().map(PlaceId::number).collect(),
        sessions: sessions.into_iter().map(session).collect(),
    }
}

fn mark(MarkView { row, column, kind }: MarkView) -> v1::MatrixMark {
    use v1::matrix_mark::Kind;
    let kind = match kind {
        Mark::Link => Kind::Link,
        Mark::LoopClosure => Kind::LoopClosure,
    };
    v1::MatrixMark { row: row as u32, column: column as u32, kind: kind.into() }
}
