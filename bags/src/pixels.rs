//! Pixels of raw images as PNG, without loss.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use crate::error::Problem;
use crate::messages::Image;

/// How the bytes of a pixel are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    Grey,
    /// Where red, green and blue are among the bytes of a pixel, and how many those are.
    Colours {
        places: [usize; 3],
        bytes: usize,
    },
    /// Colours (0 red, 1 green, 2 blue) of the first two pixels of the first row, and of the second.
    Mosaic([[usize; 2]; 2]),
}

const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;

impl Layout {
    fn of(encoding: &str) -> Result<Self, Problem> {
        Ok(match encoding {
            "mono8" | "8UC1" => Layout::Grey,
            "rgb8" => Layout::Colours { places: [0, 1, 2], bytes: 3 },
            // OpenCV's own order.
            "bgr8" | "8UC3" => Layout::Colours { places: [2, 1, 0], bytes: 3 },
            "rgba8" => Layout::Colours { places: [0, 1, 2], bytes: 4 },
            "bgra8" | "8UC4" => Layout::Colours { places: [2, 1, 0], bytes: 4 },
            "bayer_rggb8" => Layout::Mosaic([[RED, GREEN], [GREEN, BLUE]]),
            "bayer_bggr8" => Layout::Mosaic([[BLUE, GREEN], [GREEN, RED]]),
            "bayer_gbrg8" => Layout::Mosaic([[GREEN, BLUE], [RED, GREEN]]),
            "bayer_grbg8" => Layout::Mosaic([[GREEN, RED], [BLUE, GREEN]]),
            other => return Err(Problem::Pixels(other.to_owned())),
        })
    }

    fn bytes_per_pixel(self) -> usize {
        match self {
            Layout::Grey | Layout::Mosaic(_) => 1,
            Layout::Colours { places: _, bytes } => bytes,
        }
    }
}

/// Pixels whose sizes agree.
pub(crate) struct Pixels<'a> {
    layout: Layout,
    width: usize,
    height: usize,
    step: usize,
    data: &'a [u8],
}

impl<'a> Pixels<'a> {
    /// Holds the sizes of an image against each other.
    pub(crate) fn of(image: &Image<'a>) -> Result<Self, Problem> {
        let &Image { header: _, height_px, width_px, encoding, step_bytes, data } = image;
        let layout = Layout::of(encoding)?;
        let fits = || {
            let [width, height, step] =
                [width_px, height_px, step_bytes].map(|size| usize::try_from(size).unwrap_or(usize::MAX));
            let is_row_whole = width.checked_mul(layout.bytes_per_pixel())? <= step;
            let is_whole = step.checked_mul(height)? <= data.len();
            let is_any = width > 0 && height > 0;
            (is_row_whole && is_whole && is_any).then_some(Self { layout, width, height, step, data })
        };
        let size_bytes = data.len();
        fits().ok_or(Problem::Shape { width_px, height_px, step_bytes, size_bytes })
    }

    /// The image as PNG: grey stays grey, all else is red, green and blue.
    pub(crate) fn to_png(&self) -> Result<Vec<u8>, Problem> {
        let (bytes, colour) = match self.layout {
            Layout::Grey => {
                let rows = self.rows().flat_map(|row| &row[..self.width]);
                (rows.copied().collect::<Vec<u8>>(), ExtendedColorType::L8)
            }
            Layout::Colours { places, bytes } => {
                let pixels = self.rows().flat_map(|row| row[..self.width * bytes].chunks_exact(bytes));
                let colours = pixels.flat_map(|pixel| places.map(|place| pixel[place]));
                (colours.collect(), ExtendedColorType::Rgb8)
            }
            Layout::Mosaic(pattern) => (self.demosaiced(pattern), ExtendedColorType::Rgb8),
        };
        let mut png = Vec::new();
        // Sizes were 32 bits before.
        let (width, height) = (self.width as u32, self.height as u32);
        PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive)
            .write_image(&bytes, width, height, colour)
            .map_err(|error| Problem::Format(error.to_string()))?;
        Ok(png)
    }

    fn rows(&self) -> impl Iterator<Item = &'a [u8]> {
        self.data.chunks(self.step).take(self.height)
    }

    /// Each colour of a pixel is its own, or the mean of the same colour around it (bilinear).
    fn demosaiced(&self, pattern: [[usize; 2]; 2]) -> Vec<u8> {
        let mut colours = Vec::with_capacity(3 * self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let (mut sums, mut counts) = ([0_u32; 3], [0_u32; 3]);
                for near_y in y.saturating_sub(1)..(y + 2).min(self.height) {
                    for near_x in x.saturating_sub(1)..(x + 2).min(self.width) {
                        let colour = pattern[near_y % 2][near_x % 2];
                        sums[colour] += u32::from(self.data[near_y * self.step + near_x]);
                        counts[colour] += 1;
                    }
                }
                let own = pattern[y % 2][x % 2];
                (sums[own], counts[own]) = (u32::from(self.data[y * self.step + x]), 1);
                let mean = |colour: usize| (sums[colour] + counts[colour] / 2) / counts[colour].max(1);
                colours.extend([RED, GREEN, BLUE].map(|colour| mean(colour) as u8));
            }
        }
        colours
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Header;

    fn image<'a>(encoding: &'a str, width_px: u32, step_bytes: u32, data: &'a [u8]) -> Image<'a> {
        let header = Header { stamp_ns: 1, frame_id: "camera" };
        Image { header, height_px: 2, width_px, encoding, step_bytes, data }
    }

    fn decoded(encoding: &str, width_px: u32, step_bytes: u32, data: &[u8]) -> Vec<u8> {
        let png = Pixels::of(&image(encoding, width_px, step_bytes, data)).unwrap().to_png().unwrap();
        image::load_from_memory(&png).unwrap().into_rgb8().into_raw()
    }

    #[test]
    fn every_order_of_colours_comes_out_the_same() {
        let rgb = [1, 2, 3, 4, 5, 6];
        assert_eq!(decoded("rgb8", 1, 3, &rgb), rgb);
        assert_eq!(decoded("bgr8", 1, 3, &[3, 2, 1, 6, 5, 4]), rgb);
        assert_eq!(decoded("rgba8", 1, 4, &[1, 2, 3, 0, 4, 5, 6, 9]), rgb);
        assert_eq!(decoded("bgra8", 1, 5, &[3, 2, 1, 0, 77, 6, 5, 4, 9, 77]), rgb);
        assert_eq!(decoded("mono8", 1, 2, &[7, 0, 8, 0]), [7, 7, 7, 8, 8, 8]);
    }

    #[test]
    fn a_mosaic_of_one_colour_is_that_colour_everywhere() {
        let (red, green, blue) = (200, 100, 50);
        for (encoding, cell) in [
            ("bayer_rggb8", [red, green, green, blue]),
            ("bayer_bggr8", [blue, green, green, red]),
            ("bayer_gbrg8", [green, blue, red, green]),
            ("bayer_grbg8", [green, red, blue, green]),
        ] {
            let data = [cell[0], cell[1], cell[0], cell[1], cell[2], cell[3], cell[2], cell[3]];
            assert_eq!(decoded(encoding, 4, 4, &data), [red, green, blue].repeat(8), "{encoding}");
        }
    }

    #[test]
    fn sizes_that_contradict_each_other_are_refused() {
        for (width, step, data) in [(2, 3, 12), (1, 3, 5), (0, 3, 6), (u32::MAX, u32::MAX, 6)] {
            let data = vec![0; data];
            let refused = Pixels::of(&image("rgb8", width, step, &data)).err().unwrap().to_string();
            assert!(refused.contains("do not fit"), "{refused}");
        }
        let refused = Pixels::of(&image("mono16", 1, 2, &[0; 4])).err().unwrap().to_string();
        assert_eq!(
            refused,
            "pixels of encoding `mono16` are not read; mono8, rgb8, bgr8, rgba8, bgra8 and bayer of 8 bits are"
        );
    }
}
