//! How materials are painted: noise of several scales, patterns with hard edges, and leaves of all
//! sizes over them, as pictures of the world have them (A. B. Lee, D. Mumford and J. Huang,
//! Occlusion models for natural images, IJCV 41, 2001).

use super::Surface;
use super::canvas::{Canvas, Leaf, Shape};
use crate::random::{Draws, derived_seed, unit};

/// What a surface is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Material {
    /// Painted walls with stains, notices and pictures.
    Plaster,
    /// A printed motif that repeats, with pictures over it.
    Wallpaper,
    /// Bricks.
    Brick,
    /// Upright boards.
    Panelling,
    /// Shelves full of books.
    Bookshelf,
    /// Drawers and doors with handles and labels.
    Cabinet,
    /// A door frame, or another thing of plain wood.
    Wood,
    /// Squares of carpet, worn and stained.
    Carpet,
    /// Wooden floor.
    Parquet,
    /// Stone tiles.
    Tiles,
    /// Ceiling boards and lamps.
    CeilingBoards,
    /// What people wear.
    Cloth,
    /// Plain walls hung with photographs: large ones side by side, small ones between.
    Photographs,
}

/// Numbers in which materials differ.
struct Recipe {
    texels_per_m: f64,
    /// From which and to which grey value the style chooses.
    grey: [f64; 2],
    /// Contrast of the noise.
    noise: f32,
    pattern: Pattern,
    /// Leaves per square metre.
    leaves: f64,
    /// Their contrast.
    leaf_contrast: f64,
    /// Share of the slots for pictures, one every 1.1 m, that have one.
    pictures: f64,
}

enum Pattern {
    None,
    /// Rectangles of so many metres, every other row shifted by half; joints are darker; and how
    /// much tiles differ.
    Blocks {
        size_m: [f64; 2],
        shift: f64,
        joint_m: f64,
        contrast: f64,
    },
    /// Some leaves that repeat.
    Motif,
    Books,
    Drawers,
    Photographs,
}

impl Material {
    fn recipe(self) -> Recipe {
        let wall = Recipe {
            texels_per_m: 128.0,
            grey: [120.0, 200.0],
            noise: 14.0,
            pattern: Pattern::None,
            leaves: 220.0,
            leaf_contrast: 60.0,
            pictures: 0.85,
        };
        let blocks = |size_m, shift, joint_m, contrast| Pattern::Blocks { size_m, shift, joint_m, contrast };
        match self {
            Material::Plaster => wall,
            Material::Wallpaper => Recipe { pattern: Pattern::Motif, leaves: 160.0, ..wall },
            Material::Brick => Recipe {
                grey: [90.0, 150.0],
                pattern: blocks([0.25, 0.085], 0.5, 0.012, 32.0),
                leaves: 80.0,
                pictures: 0.8,
                ..wall
            },
            Material::Panelling => Recipe {
                grey: [80.0, 150.0],
                pattern: blocks([0.14, 9.0], 0.0, 0.01, 22.0),
                leaves: 160.0,
                ..wall
            },
            Material::Bookshelf => {
                Recipe { grey: [60.0, 110.0], pattern: Pattern::Books, leaves: 25.0, pictures: 0.0, ..wall }
            }
            Material::Cabinet => Recipe {
                grey: [110.0, 190.0],
                pattern: Pattern::Drawers,
                leaves: 50.0,
                pictures: 0.0,
                ..wall
            },
            Material::Wood => Recipe { grey: [60.0, 130.0], leaves: 60.0, pictures: 0.0, ..wall },
            Material::Cloth => {
                Recipe { grey: [40.0, 190.0], pattern: Pattern::Motif, leaves: 40.0, pictures: 0.0, ..wall }
            }
            Material::Photographs => Recipe {
                grey: [170.0, 210.0],
                noise: 5.0,
                pattern: Pattern::Photographs,
                leaves: 6.0,
                leaf_contrast: 25.0,
                pictures: 0.0,
                ..wall
            },
            Material::Carpet => Recipe {
                texels_per_m: 96.0,
                grey: [80.0, 140.0],
                noise: 20.0,
                pattern: blocks([0.5, 0.5], 0.0, 0.006, 12.0),
                leaves: 60.0,
                leaf_contrast: 40.0,
                pictures: 0.0,
            },
            Material::Parquet => Recipe {
                texels_per_m: 96.0,
                grey: [100.0, 160.0],
                pattern: blocks([0.45, 0.09], 0.5, 0.006, 24.0),
                leaves: 25.0,
                leaf_contrast: 40.0,
                pictures: 0.0,
                ..wall
            },
            Material::Tiles => Recipe {
                texels_per_m: 96.0,
                grey: [110.0, 180.0],
                pattern: blocks([0.33, 0.33], 0.0, 0.012, 18.0),
                leaves: 35.0,
                leaf_contrast: 40.0,
                pictures: 0.0,
                ..wall
            },
            Material::CeilingBoards => Recipe {
                texels_per_m: 64.0,
                grey: [180.0, 215.0],
                noise: 8.0,
                pattern: blocks([0.6, 0.6], 0.0, 0.02, 14.0),
                leaves: 30.0,
                leaf_contrast: 35.0,
                pictures: 0.0,
            },
        }
    }
}

pub(super) fn paint(surface: &Surface, width_m: f64, height_m: f64) -> Canvas {
    let recipe = surface.material.recipe();
    let mut style = Draws::new(surface.style);
    let grey = style.between(recipe.grey[0], recipe.grey[1]);
    let canvas = Canvas::new(width_m, height_m, recipe.texels_per_m, grey as f32);
    let mut painter = Painter { surface, canvas, size_m: [width_m, height_m], grey, style: style.seed() };
    match recipe.pattern {
        Pattern::None => {}
        Pattern::Blocks { size_m, shift, joint_m, contrast } => {
            painter.blocks(size_m, shift, joint_m, contrast);
        }
        Pattern::Motif => painter.motif(),
        Pattern::Books => painter.books(),
        Pattern::Drawers => painter.drawers(),
        Pattern::Photographs => {}
    }
    for (octave, (spacing_m, share)) in
        [(0.8, 1.0), (0.2, 0.8), (0.05, 0.6), (0.02, 0.5)].into_iter().enumerate()
    {
        let own = |point| derived_seed(surface.seed_at(point), 100 + octave as u64);
        painter.canvas.add_noise(spacing_m, recipe.noise * share, own);
    }
    painter.leaves(recipe.leaves, recipe.leaf_contrast);
    painter.pictures(recipe.pictures);
    if matches!(recipe.pattern, Pattern::Photographs) {
        painter.photographs();
    }
    painter.canvas
}

impl Surface {
    /// The family's seed or its own, by the patch of half a metre that a point is in.
    fn seed_at(&self, [x, y]: [f64; 2]) -> u64 {
        let patch =
            (((x / 0.5).floor() as i64 as u64) << 32) ^ ((y / 0.5).floor() as i64 as u64 & 0xffff_ffff);
        if unit(derived_seed(derived_seed(self.own, 1), patch)) < self.own_share {
            self.own
        } else {
            self.family
        }
    }
}

pub(super) struct Painter<'a> {
    surface: &'a Surface,
    pub(super) canvas: Canvas,
    pub(super) size_m: [f64; 2],
    grey: f64,
    style: u64,
}

impl Painter<'_> {
    pub(super) fn draws_at(&self, point: [f64; 2], purpose: u64, number: u64) -> Draws {
        Draws::new(derived_seed(derived_seed(self.surface.seed_at(point), purpose), number))
    }

    /// Sizes as 1 / size³, so that every scale covers as much.
    fn leaves(&mut self, per_m2: f64, contrast: f64) {
        let cell_m = 0.25;
        let [columns, rows] = self.size_m.map(|side| (side / cell_m).ceil() as u64);
        for cell in 0..columns * rows {
            let corner = [(cell % columns) as f64 * cell_m, (cell / columns) as f64 * cell_m];
            let mut draws = self.draws_at(corner, 2, cell);
            let count = (per_m2 * cell_m * cell_m + draws.between(0.0, 1.0)) as usize;
            for _ in 0..count {
                let center = corner.map(|low| low + draws.between(0.0, cell_m));
                let size_m = leaf_size_m(&mut draws, 0.018, 0.25);
                let tone = self.grey + signed(&mut draws, 0.35 * contrast, contrast);
                let leaf = Leaf::drawn(&mut draws, center, size_m, tone as f32);
                self.canvas.put(&leaf);
            }
        }
    }

    /// Framed pictures and notices at eye height, full of detail.
    fn pictures(&mut self, share: f64) {
        let [width, height] = self.size_m;
        let slot_m = 1.1;
        if share == 0.0 || height < 1.0 {
            return;
        }
        for slot in 0..(width / slot_m) as u64 {
            let middle = [(slot as f64 + 0.5) * slot_m, height / 2.0];
            let mut draws = self.draws_at(middle, 3, slot);
            if draws.between(0.0, 1.0) > share {
                continue;
            }
            let half = [draws.between(0.2, 0.45), draws.between(0.2, 0.5)];
            let center = [middle[0] + draws.between(-0.1, 0.1), height - draws.between(1.05, 1.7)];
            let corner = |sign: f64, scale: f64| [0, 1].map(|axis| center[axis] + sign * scale * half[axis]);
            let frame = draws.between(10.0, 90.0) as f32;
            let paper = draws.between(120.0, 240.0);
            self.canvas.put(&Leaf::rectangle(corner(-1.0, 1.06), corner(1.0, 1.06), frame));
            self.canvas.put(&Leaf::rectangle(corner(-1.0, 1.0), corner(1.0, 1.0), paper as f32));
            let count = (half[0] * half[1] * 4.0 * 260.0) as usize;
            for _ in 0..count {
                let size_m = leaf_size_m(&mut draws, 0.03, 0.4).min(half[0]);
                let inside = |axis: usize, draws: &mut Draws| {
                    let room = (half[axis] - size_m * 0.6).max(0.0);
                    center[axis] + draws.between(-room, room)
                };
                let place = [inside(0, &mut draws), inside(1, &mut draws)];
                let tone = draws.between(5.0, 250.0) as f32;
                let leaf = Leaf::drawn(&mut draws, place, size_m, tone);
                self.canvas.put(&leaf);
            }
        }
    }

    fn blocks(&mut self, [length, width]: [f64; 2], shift: f64, joint_m: f64, contrast: f64) {
        let dark = (self.grey * 0.62) as f32;
        let [width_m, height_m] = self.size_m;
        self.canvas.put(&Leaf::rectangle([-1.0, -1.0], [width_m + 1.0, height_m + 1.0], dark));
        for row in 0..(height_m / width).ceil() as u64 {
            let start = if row % 2 == 1 { -shift * length } else { 0.0 };
            for column in 0..((width_m - start) / length).ceil() as u64 {
                let left = start + column as f64 * length;
                let upper = row as f64 * width;
                let mut draws = self.draws_at([left.max(0.0), upper], 4, (row << 32) | column);
                let tone = (self.grey + draws.between(-contrast, contrast)) as f32;
                let block = [left + length - joint_m, upper + width - joint_m];
                self.canvas.put(&Leaf::rectangle([left, upper], block, tone));
            }
        }
    }

    fn motif(&mut self) {
        let mut style = Draws::new(self.style);
        let period = [style.between(0.28, 0.5), style.between(0.28, 0.5)];
        let leaves: Vec<Leaf> = (0..5)
            .map(|_| {
                let center = period.map(|side| style.between(0.0, side));
                let size_m = style.between(0.03, 0.14);
                let tone = self.grey + signed(&mut style, 20.0, 60.0);
                Leaf::drawn(&mut style, center, size_m, tone as f32)
            })
            .collect();
        let [columns, rows] = [0, 1].map(|axis| (self.size_m[axis] / period[axis]).ceil() as u32);
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let corner = [f64::from(column) * period[0], f64::from(row) * period[1]];
            for leaf in &leaves {
                let center_m = [0, 1].map(|axis| corner[axis] + leaf.center_m[axis]);
                self.canvas.put(&Leaf { center_m, ..*leaf });
            }
        }
    }

    fn books(&mut self) {
        let [width, height] = self.size_m;
        let mut shelf = height;
        for row in 0..(height / 0.34) as u64 {
            shelf -= 0.34;
            let mut left = 0.02;
            let mut number = row << 32;
            while left < width - 0.03 {
                number += 1;
                let mut draws = self.draws_at([left, shelf.max(0.0)], 5, number);
                let thick = draws.between(0.018, 0.06);
                let tall = draws.between(0.2, 0.3);
                let lower = shelf + 0.32;
                let right = (left + thick).min(width);
                if draws.between(0.0, 1.0) < 0.9 {
                    let tone = draws.between(25.0, 235.0);
                    self.canvas.put(&Leaf::rectangle(
                        [left, lower - tall],
                        [right - 0.003, lower],
                        tone as f32,
                    ));
                    let label = lower - tall * draws.between(0.35, 0.9);
                    let label_tone = (tone + signed(&mut draws, 60.0, 120.0)) as f32;
                    let label_end = [right - 0.007, label + draws.between(0.02, 0.07)];
                    self.canvas.put(&Leaf::rectangle([left + 0.004, label], label_end, label_tone));
                }
                left = right;
            }
            let board = (self.grey * 0.8) as f32;
            self.canvas.put(&Leaf::rectangle([0.0, shelf + 0.32], [width, shelf + 0.34], board));
        }
    }

    fn drawers(&mut self) {
        self.blocks([0.44, 0.3], 0.0, 0.01, 14.0);
        let [columns, rows] = [(self.size_m[0] / 0.44) as u64 + 1, (self.size_m[1] / 0.3) as u64 + 1];
        for drawer in 0..columns * rows {
            let corner = [(drawer % columns) as f64 * 0.44, (drawer / columns) as f64 * 0.3];
            let mut draws = self.draws_at(corner, 6, drawer);
            let dark = (self.grey * 0.4) as f32;
            let handle = [corner[0] + 0.15, corner[1] + 0.05];
            self.canvas.put(&Leaf::rectangle(handle, [handle[0] + 0.14, handle[1] + 0.025], dark));
            let label = [corner[0] + draws.between(0.05, 0.3), corner[1] + draws.between(0.1, 0.2)];
            let end = [label[0] + draws.between(0.04, 0.1), label[1] + draws.between(0.02, 0.06)];
            let mut notice = Leaf::rectangle(label, end, draws.between(150.0, 250.0) as f32);
            self.canvas.put(&notice);
            notice.shape = Shape::Frame;
            notice.grey = dark;
            self.canvas.put(&notice);
        }
    }
}

/// Density 1 / size³ between two sizes.
fn leaf_size_m(draws: &mut Draws, least_m: f64, most_m: f64) -> f64 {
    let (low, high) = (least_m.powi(-2), most_m.powi(-2));
    draws.between(high, low).powf(-0.5)
}

/// Between two sizes, above or below 0.
fn signed(draws: &mut Draws, least: f64, most: f64) -> f64 {
    let size = draws.between(least, most);
    if draws.below(2) == 0 { size } else { -size }
}
