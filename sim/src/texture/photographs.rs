//! Photographs of the real world, to hang on walls.

use std::sync::OnceLock;

use image::GrayImage;

use super::materials::Painter;
use crate::random::Draws;

/// Eighty photographs side by side; where they are from: `sim/photographs/README.md`.
const SHEET: &[u8] = include_bytes!("../../photographs/sheet.jpg");

/// Columns and rows of photographs on the sheet.
const COLUMNS: u32 = 8;
const ROWS: u32 = 10;

/// Width of a photograph, in heights.
const PROPORTION: f64 = 16.0 / 9.0;

/// How many there are.
const COUNT: usize = (COLUMNS * ROWS) as usize;

/// One of them.
#[derive(Clone, Copy)]
struct Photograph {
    sheet: &'static GrayImage,
    corner_px: [u32; 2],
    size_px: [u32; 2],
}

impl Photograph {
    /// The photograph of that number, below [`COUNT`].
    fn numbered(number: usize) -> Self {
        let sheet = sheet();
        let size_px = [sheet.width() / COLUMNS, sheet.height() / ROWS];
        let number = (number % COUNT) as u32;
        let corner_px = [number % COLUMNS * size_px[0], number / COLUMNS * size_px[1]];
        Self { sheet, corner_px, size_px }
    }

    /// The grey value at a point, bilinear; [0, 0] is its upper left corner, [1, 1] the lower right.
    fn grey(&self, point: [f64; 2]) -> f32 {
        let [column, row] = [0, 1].map(|axis| {
            let last = f64::from(self.size_px[axis] - 1);
            (point[axis] * f64::from(self.size_px[axis]) - 0.5).clamp(0.0, last)
        });
        let at = |column: u32, row: u32| {
            let [x, y] = [column.min(self.size_px[0] - 1), row.min(self.size_px[1] - 1)];
            f32::from(self.sheet.get_pixel(self.corner_px[0] + x, self.corner_px[1] + y).0[0])
        };
        let (left, upper) = (column as u32, row as u32);
        let (across, down) = (column.fract() as f32, row.fract() as f32);
        let blend = |a: f32, b: f32, share: f32| a + share * (b - a);
        let row_at = |row: u32| blend(at(left, row), at(left + 1, row), across);
        blend(row_at(upper), row_at(upper + 1), down)
    }
}

impl Painter<'_> {
    /// Photographs of 0.6 to 2.2 m, one after the other along the wall at about eye height, some
    /// above others.
    pub(super) fn photographs(&mut self) {
        let [width, height] = self.size_m;
        let mut left = 0.15;
        for number in 0.. {
            let mut draws = self.draws_at([left, height / 2.0], 7, number);
            let length_m = draws.between(0.6, 2.2);
            let tall_m = length_m / PROPORTION;
            if left + length_m > width || tall_m > height {
                break;
            }
            let upper = draws.between(0.1, (height - tall_m - 0.1).clamp(0.1, 1.2) + 1e-3);
            self.hang(&mut draws, [left, upper], length_m);
            let below = upper + tall_m + 0.1;
            if below + tall_m < height - 0.1 {
                self.hang(&mut draws, [left, below], length_m);
            }
            left += length_m + draws.between(0.1, 0.7);
        }
    }

    fn hang(&mut self, draws: &mut Draws, corner_m: [f64; 2], length_m: f64) {
        let photograph = Photograph::numbered(draws.below(COUNT));
        let size_m = [length_m, length_m / PROPORTION];
        // A part of it, as it is or mirrored: two prints of one photograph are seldom alike.
        let share = draws.between(0.6, 1.0);
        let start = [0, 1].map(|_| draws.between(0.0, 1.0 - share));
        let is_mirrored = draws.below(2) == 0;
        self.canvas.put_picture(corner_m, size_m, |[x, y]| {
            let x = if is_mirrored { 1.0 - x } else { x };
            photograph.grey([start[0] + share * x, start[1] + share * y])
        });
    }
}

fn sheet() -> &'static GrayImage {
    static SHEET_IN_GREY: OnceLock<GrayImage> = OnceLock::new();
    SHEET_IN_GREY.get_or_init(|| match image::load_from_memory(SHEET) {
        Ok(image) => image.to_luma8(),
        Err(error) => unreachable!("the sheet is built in, and an image: {error}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_photograph_shows_something_else() {
        let greys = |number| -> Vec<f32> {
            let photograph = Photograph::numbered(number);
            let at = |index: usize| [(index % 16) as f64 / 16.0, (index / 16) as f64 / 9.0];
            (0..144).map(|index| photograph.grey(at(index))).collect()
        };
        let all: Vec<Vec<f32>> = (0..COUNT).map(greys).collect();
        for (number, one) in all.iter().enumerate() {
            let spread = one.iter().copied().fold(0.0, f32::max) - one.iter().copied().fold(255.0, f32::min);
            assert!(spread > 100.0, "{number} is flat");
            for other in &all[..number] {
                let off = one.iter().zip(other).map(|(a, b)| (a - b).abs()).sum::<f32>() / one.len() as f32;
                assert!(off > 10.0, "{number} is there twice");
            }
        }
    }
}
