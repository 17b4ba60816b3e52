//! The cells of a tile: how alike each two places look, thinned by the largest.

use std::sync::Arc;

use fabmap::likelihood::ObservationModel;
use fabmap::likeness::{Likeness, LikenessWorkspace};
use fabmap::observation::Observation;

/// Cells along each side of a tile.
pub(crate) const TILE_CELLS: usize = 256;

/// The shades of a tile, row by row: 0 at 0 nats and below, 255 at `full_shade_nats` and above. A cell of level z is the
/// largest of 2^z x 2^z pairs. None if nobody waits for it any more.
pub(super) fn shades(
    model: Arc<ObservationModel>,
    (rows, columns): (&[Observation], &[Observation]),
    level: u32,
    full_shade_nats: f64,
    is_wanted: impl Fn() -> bool,
) -> Option<Vec<u8>> {
    let places = Likeness::with(model, columns);
    let (mut workspace, mut evidence) = (LikenessWorkspace::default(), Vec::new());
    let mut shades = vec![0; TILE_CELLS * TILE_CELLS];
    for (rows, shades) in rows.chunks(1 << level).zip(shades.chunks_mut(TILE_CELLS)) {
        let mut largest = [f64::NEG_INFINITY; TILE_CELLS];
        for row in rows {
            if !is_wanted() {
                return None;
            }
            places.evidence_into(row, &mut workspace, &mut evidence);
            for (largest, cell) in largest.iter_mut().zip(evidence.chunks(1 << level)) {
                *largest = cell.iter().copied().fold(*largest, f64::max);
            }
        }
        for (shade, nats) in shades.iter_mut().zip(largest) {
            *shade = (255.0 * (nats / full_shade_nats).clamp(0.0, 1.0)).round() as u8;
        }
    }
    Some(shades)
}

#[cfg(test)]
mod tests {
    use fabmap::observation::WordId;
    use fabmap::{Appearance, ChowLiuTree, Dependence, DetectorModel};

    use super::*;

    const WORDS: u32 = 60;

    /// Words of places that go on into each other; the last ten places look like the first.
    fn looks(places: u32) -> Vec<Observation> {
        let look = |place: u32| {
            let from = (place % (places - 10)) * 7 % WORDS;
            Observation::from_words((from..from + 12).map(|word| word * (1 + place % 3) % WORDS), 60).unwrap()
        };
        (0..places).map(look).collect()
    }

    fn model() -> Arc<ObservationModel> {
        let rows = WordId::first(WORDS as usize).map(|word| fabmap::chow_liu::WordDependence {
            parent: WordId::new(word.number().saturating_sub(1)),
            marginal: 0.1 + f64::from(word.number()) / 200.0,
            given_parent_seen: 0.5,
            given_parent_unseen: 0.15,
        });
        let tree = ChowLiuTree::from_rows(rows).unwrap();
        Arc::new(ObservationModel::new(&tree, DetectorModel::default(), Dependence::ChowLiu))
    }

    #[test]
    fn a_cell_is_the_largest_of_its_pairs_by_the_dense_equations() {
        let (rows, columns, model) = (looks(70), looks(45), model());
        let full = 12.0;
        let dense = |row: &Observation, column: &Observation| {
            model.dense_log_likelihood(row, &Appearance::of(column))
                - model.dense_log_likelihood_of_average_place(row)
        };
        let mut bright = 0;
        for level in 0..4 {
            let shades = shades(model.clone(), (&rows, &columns), level, full, || true).unwrap();
            assert_eq!(shades.len(), TILE_CELLS * TILE_CELLS);
            for (at, &shade) in shades.iter().enumerate() {
                let of = |cell: usize, looks: &[Observation]| {
                    let from = (cell << level).min(looks.len());
                    looks[from..(from + (1 << level)).min(looks.len())].to_vec()
                };
                let (rows, columns) = (of(at / TILE_CELLS, &rows), of(at % TILE_CELLS, &columns));
                let pairs = rows.iter().flat_map(|row| columns.iter().map(move |column| dense(row, column)));
                let largest = pairs.fold(f64::NEG_INFINITY, f64::max);
                let exact = 255.0 * (largest / full).clamp(0.0, 1.0);
                assert!((f64::from(shade) - exact).abs() <= 0.5 + 1e-6, "{shade} for {exact} at {at}");
                bright += usize::from(shade > 200);
            }
        }
        assert!(bright > 40, "nothing looks alike: {bright}");
    }

    #[test]
    fn a_tile_that_nobody_waits_for_is_left() {
        assert_eq!(shades(model(), (&looks(20), &looks(20)), 0, 12.0, || false), None);
    }
}
