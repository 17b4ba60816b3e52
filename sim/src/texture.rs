//! What surfaces look like: painted by a seed, and looked up without aliasing.

mod canvas;
mod materials;
mod photographs;

use crate::random::derived_seed;

pub use materials::Material;

/// How a surface is to be painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// What it is made of.
    pub material: Material,
    /// Colours and patterns that all surfaces of a room, or of all rooms that look alike, have in
    /// common.
    pub style: u64,
    /// What look-alikes of this very surface have in common: every stain and every poster.
    pub family: u64,
    /// What is this surface's alone.
    pub own: u64,
    /// Share of the surface, in patches of half a metre, that is its own; the rest it shares with
    /// its family.
    pub own_share: f64,
}

impl Surface {
    /// A surface like no other.
    #[must_use]
    pub fn unique(material: Material, style: u64, own: u64) -> Self {
        Self { material, style, family: own, own, own_share: 1.0 }
    }

    /// Another surface of the same kind.
    #[must_use]
    pub fn part(&self, number: u64) -> Self {
        Self { family: derived_seed(self.family, number), own: derived_seed(self.own, number), ..*self }
    }
}

/// Grey values of a rectangle in levels of detail, each half as large as the one before (L.
/// Williams, Pyramidal parametrics, SIGGRAPH 1983).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Texture {
    texels_per_m: f32,
    levels: Vec<Level>,
}

/// Column by column, because that is how walls are looked at.
#[derive(Clone, Debug, PartialEq)]
struct Level {
    width: usize,
    height: usize,
    texels: Vec<u8>,
}

/// The piece of a texture that one pixel sees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// Its longer side, in metres to the right and down.
    pub(crate) major_m: [f32; 2],
    /// Length of its shorter side.
    pub(crate) minor_m: f32,
}

/// How much longer than wide the piece of one look-up may be; longer ones take several, up to this
/// number.
const MAX_LOOKUPS: f32 = 4.0;

/// Looking up is done in whole numbers of this part.
const FIXED_ONE: i32 = 256;

impl Texture {
    /// Paints `width_m` by `height_m` of a surface; both must be above 0.
    pub(crate) fn paint(surface: &Surface, width_m: f64, height_m: f64) -> Self {
        let canvas = materials::paint(surface, width_m, height_m);
        let (width, height) = (canvas.width, canvas.height);
        let mut levels = vec![Level { width, height, texels: canvas.to_bytes_by_columns() }];
        while let Some(half) = levels.last().and_then(Level::half) {
            levels.push(half);
        }
        Self { texels_per_m: canvas.texels_per_m as f32, levels }
    }

    /// The mean grey value around a point, in metres from the upper left corner.
    pub(crate) fn sample(&self, x_m: f32, y_m: f32, footprint: &Footprint) -> f32 {
        let [major_x, major_y] = footprint.major_m.map(|side| side * self.texels_per_m);
        let major = (major_x * major_x + major_y * major_y).sqrt();
        let width = (footprint.minor_m * self.texels_per_m).max(major / MAX_LOOKUPS).max(1.0);
        let lookups = ((major / width).clamp(1.0, MAX_LOOKUPS) + 0.5) as i32;
        let detail = log2(width).min((self.levels.len() - 1) as f32);
        let level = detail as usize;
        let share = detail - level as f32;
        let fixed = |texels: f32| (texels * FIXED_ONE as f32) as i32;
        let (x, y) = (fixed(x_m * self.texels_per_m), fixed(y_m * self.texels_per_m));
        let (major_x, major_y) = (fixed(major_x), fixed(major_y));
        let (mut fine, mut coarse) = (0, 0);
        for lookup in 0..lookups {
            // From -1/2 to 1/2 of the longer side.
            let aside = |side: i32| side * (2 * lookup + 1 - lookups) / (2 * lookups);
            let (x, y) = (x + aside(major_x), y + aside(major_y));
            fine += self.levels[level].at(x >> level, y >> level);
            if share > 0.0 {
                coarse += self.levels[level + 1].at(x >> (level + 1), y >> (level + 1));
            }
        }
        let grey = |sum: i32| sum as f32 / (FIXED_ONE * FIXED_ONE * lookups) as f32;
        if share > 0.0 { grey(fine) + share * (grey(coarse) - grey(fine)) } else { grey(fine) }
    }
}

impl Level {
    /// Bilinear, in [`FIXED_ONE`]² of a grey value, at a point in [`FIXED_ONE`] of a texel; the
    /// border goes on for ever.
    #[inline]
    fn at(&self, x: i32, y: i32) -> i32 {
        let x = (x - FIXED_ONE / 2).clamp(0, (self.width as i32 - 1) * FIXED_ONE);
        let y = (y - FIXED_ONE / 2).clamp(0, (self.height as i32 - 1) * FIXED_ONE);
        let (column, row) = ((x / FIXED_ONE) as usize, (y / FIXED_ONE) as usize);
        let (x, y) = (x % FIXED_ONE, y % FIXED_ONE);
        let below = usize::from(row + 1 < self.height);
        let down = |column: usize| {
            let texels = &self.texels[column * self.height + row..][..=below];
            (FIXED_ONE - y) * i32::from(texels[0]) + y * i32::from(texels[below])
        };
        (FIXED_ONE - x) * down(column) + x * down((column + 1).min(self.width - 1))
    }

    fn half(&self) -> Option<Level> {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        if self.width.max(self.height) == 1 {
            return None;
        }
        let texel = |column: usize, row: usize| {
            u32::from(self.texels[column.min(self.width - 1) * self.height + row.min(self.height - 1)])
        };
        let mean = |column: usize, row: usize| {
            let sum = texel(column, row)
                + texel(column + 1, row)
                + texel(column, row + 1)
                + texel(column + 1, row + 1);
            ((sum + 2) / 4) as u8
        };
        let columns = (0..width).flat_map(|column| (0..height).map(move |row| (2 * column, 2 * row)));
        Some(Level { width, height, texels: columns.map(|(column, row)| mean(column, row)).collect() })
    }
}

/// Of a number of at least 1: exact at powers of two and straight between them.
fn log2(value: f32) -> f32 {
    let bits = value.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    exponent as f32 + (f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000) - 1.0)
}

#[cfg(test)]
mod tests;
