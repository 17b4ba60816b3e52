//! The match matrix: how well every frame matches every earlier one, as a picture.

use image::{ImageError, ImageFormat, Rgb, RgbImage};

use crate::dataset::{Truth, Verdict};

/// Scores of frame i (row, downwards) against earlier frames j (column, to the right), the darker
/// the higher. Cells of true loops are orange, of neutral pairs blue; above the diagonal it is grey.
#[derive(Clone, Debug)]
pub(crate) struct MatchMatrix {
    scale: Scale,
    /// Row i has i shades, 0 (no match) to 255.
    rows: Vec<Vec<u8>>,
}

/// How a score becomes a shade.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    /// Posteriors, by their square root: 1 is black, 0.1 can be seen, what smoothing leaves cannot.
    Posterior,
    /// Cosines, by their square, from 0 to the largest of the row.
    Cosine,
}

/// Longest side of the picture, in pixels; larger matrices show the darkest of several cells.
const MAX_SIDE_PX: usize = 4000;
/// Small matrices are magnified to at least this, in pixels.
const MIN_SIDE_PX: usize = 800;

impl MatchMatrix {
    /// An empty matrix.
    pub(crate) fn new(scale: Scale) -> Self {
        Self { scale, rows: Vec::new() }
    }

    /// Adds the next frame's scores, each in [0, 1], against all frames before it.
    pub(crate) fn push(&mut self, scores: &[f64]) {
        let highest = scores.iter().copied().fold(0.0, f64::max);
        let darkness = |score: f64| match self.scale {
            Scale::Posterior => score.sqrt(),
            Scale::Cosine if highest > 0.0 => (score / highest).powi(2),
            Scale::Cosine => 0.0,
        };
        let shade = |&score: &f64| (255.0 * darkness(score).clamp(0.0, 1.0)).round() as u8;
        self.rows.push(scores.iter().map(shade).collect());
    }

    /// The picture as PNG.
    pub(crate) fn to_png(&self, truth: &Truth) -> Result<Vec<u8>, ImageError> {
        let mut png = std::io::Cursor::new(Vec::new());
        self.draw(truth).write_to(&mut png, ImageFormat::Png)?;
        Ok(png.into_inner())
    }

    fn draw(&self, truth: &Truth) -> RgbImage {
        let frames = self.rows.len();
        let cells_per_pixel = frames.div_ceil(MAX_SIDE_PX).max(1);
        let pixels_per_cell = MIN_SIDE_PX.div_ceil(frames.max(1));
        let side = frames.div_ceil(cells_per_pixel) * pixels_per_cell;
        let side = u32::try_from(side.max(1)).unwrap_or(u32::MAX);
        RgbImage::from_fn(side, side, |x, y| {
            let first = |pixel: u32| pixel as usize / pixels_per_cell * cells_per_pixel;
            let block = |pixel: u32| first(pixel)..first(pixel) + cells_per_pixel;
            self.colour(block(y), block(x), truth)
        })
    }

    /// Colour of a block of cells: the darkest shade in it, and true rather than neutral.
    fn colour(
        &self,
        rows: std::ops::Range<usize>,
        columns: std::ops::Range<usize>,
        truth: &Truth,
    ) -> Rgb<u8> {
        let mut darkest: Option<u8> = None;
        let mut is_loop = false;
        let mut is_neutral = false;
        for row in rows {
            for column in columns.clone() {
                let Some(&shade) = self.rows.get(row).and_then(|row| row.get(column)) else { continue };
                darkest = darkest.max(Some(shade));
                match truth.verdict(row, column) {
                    Verdict::True => is_loop = true,
                    Verdict::Neutral => is_neutral = true,
                    Verdict::False => {}
                }
            }
        }
        match darkest {
            None => ABOVE_DIAGONAL,
            Some(shade) if is_loop => between(LOOP_NOT_MATCHED, LOOP_MATCHED, shade),
            Some(shade) if is_neutral => between(NEUTRAL_NOT_MATCHED, NEUTRAL_MATCHED, shade),
            Some(shade) => between(WHITE, BLACK, shade),
        }
    }
}

const ABOVE_DIAGONAL: Rgb<u8> = Rgb([200, 200, 200]);
const WHITE: Rgb<u8> = Rgb([255, 255, 255]);
const BLACK: Rgb<u8> = Rgb([0, 0, 0]);
const LOOP_NOT_MATCHED: Rgb<u8> = Rgb([255, 190, 120]);
const LOOP_MATCHED: Rgb<u8> = Rgb([190, 0, 0]);
const NEUTRAL_NOT_MATCHED: Rgb<u8> = Rgb([225, 238, 250]);
const NEUTRAL_MATCHED: Rgb<u8> = Rgb([20, 60, 140]);

fn between(light: Rgb<u8>, dark: Rgb<u8>, shade: u8) -> Rgb<u8> {
    let mix = |light: u8, dark: u8| {
        let shade = u32::from(shade);
        ((u32::from(light) * (255 - shade) + u32::from(dark) * shade) / 255) as u8
    };
    Rgb(std::array::from_fn(|channel| mix(light[channel], dark[channel])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn three_frames(scale: Scale) -> MatchMatrix {
        let mut matrix = MatchMatrix::new(scale);
        matrix.push(&[]);
        matrix.push(&[0.25]);
        matrix.push(&[1.0, 0.0]);
        matrix
    }

    #[test]
    fn shades_follow_the_scale() {
        assert_eq!(three_frames(Scale::Posterior).rows, [vec![], vec![128], vec![255, 0]]);
        assert_eq!(three_frames(Scale::Cosine).rows, [vec![], vec![255], vec![255, 0]]);
    }

    #[test]
    fn truth_is_coloured_and_the_future_grey() {
        let truth = Truth::new([(2, 0)].into(), [(1, 0)].into());
        let picture = three_frames(Scale::Posterior).draw(&truth);
        let cell = picture.width() / 3;
        let at = |row: u32, column: u32| *picture.get_pixel(column * cell + 1, row * cell + 1);
        assert!(cell >= 200);
        assert_eq!(at(2, 0), LOOP_MATCHED);
        assert_eq!(at(2, 1), WHITE);
        assert_eq!(at(0, 0), ABOVE_DIAGONAL);
        assert_eq!(at(0, 2), ABOVE_DIAGONAL);
        assert_ne!(at(1, 0), between(WHITE, BLACK, 128));
    }

    #[test]
    fn a_large_matrix_keeps_its_single_matches() {
        let mut matrix = MatchMatrix::new(Scale::Posterior);
        let frames = MAX_SIDE_PX + 500;
        for frame in 0..frames {
            let mut scores = vec![0.0; frame];
            if frame == 4001 {
                scores[1000] = 1.0;
            }
            matrix.push(&scores);
        }
        let picture = matrix.draw(&Truth::new(HashSet::new(), HashSet::new()));
        assert_eq!(picture.width() as usize, frames / 2);
        assert_eq!(*picture.get_pixel(500, 2000), BLACK);
        assert_eq!(*picture.get_pixel(501, 2000), WHITE);
    }

    #[test]
    fn the_png_can_be_read_back() {
        let png = three_frames(Scale::Posterior).to_png(&Truth::default()).unwrap();
        assert_eq!(image::load_from_memory(&png).unwrap().width(), 801);
    }
}
