//! A rectangle to paint on.

use crate::random::{Draws, derived_seed, unit};

/// Grey values 0 to 255, row by row from the upper left.
pub(super) struct Canvas {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) texels_per_m: f64,
    texels: Vec<f32>,
}

/// A flat patch of one grey value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaf {
    pub(super) shape: Shape,
    /// Its middle, in metres from the upper left corner of the canvas.
    pub(super) center_m: [f64; 2],
    /// Half its length and half its width.
    pub(super) half_m: [f64; 2],
    pub(super) turn_rad: f64,
    pub(super) grey: f32,
    /// From 0, which is invisible, to 1.
    pub(super) opacity: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    Rectangle,
    Ellipse,
    Triangle,
    Frame,
}

impl Leaf {
    /// An upright rectangle from corner to corner.
    pub(super) fn rectangle([left, upper]: [f64; 2], [right, lower]: [f64; 2], grey: f32) -> Self {
        Self {
            shape: Shape::Rectangle,
            center_m: [(left + right) / 2.0, (upper + lower) / 2.0],
            half_m: [(right - left) / 2.0, (lower - upper) / 2.0],
            turn_rad: 0.0,
            grey,
            opacity: 1.0,
        }
    }

    /// Any shape at any angle, half as long as `size_m`, and as wide as that or less.
    pub(super) fn drawn(draws: &mut Draws, center_m: [f64; 2], size_m: f64, grey: f32) -> Self {
        let shapes = [Shape::Rectangle, Shape::Rectangle, Shape::Ellipse, Shape::Triangle, Shape::Frame];
        Self {
            shape: shapes[draws.below(shapes.len())],
            center_m,
            half_m: [size_m / 2.0, size_m / 2.0 * draws.between(0.35, 1.0)],
            turn_rad: draws.between(0.0, std::f64::consts::TAU),
            grey,
            opacity: draws.between(0.6, 1.0) as f32,
        }
    }

    /// Metres from its outline, below 0 inside; of ellipses roughly.
    fn distance_m(&self, x: f64, y: f64) -> f64 {
        let [length, width] = self.half_m;
        match self.shape {
            Shape::Rectangle => (x.abs() - length).max(y.abs() - width),
            Shape::Ellipse => (((x / length).powi(2) + (y / width).powi(2)).sqrt() - 1.0) * width,
            Shape::Triangle => (-x - length).max((x - length) * 0.5 + y.abs() * length / width * 0.5),
            Shape::Frame => {
                let outer = (x.abs() - length).max(y.abs() - width);
                (outer + 0.18 * width).abs() - 0.18 * width
            }
        }
    }
}

impl Canvas {
    pub(super) fn new(width_m: f64, height_m: f64, texels_per_m: f64, grey: f32) -> Self {
        let [width, height] = [width_m, height_m].map(|side| ((side * texels_per_m).ceil() as usize).max(1));
        Self { width, height, texels_per_m, texels: vec![grey; width * height] }
    }

    pub(super) fn to_bytes_by_columns(&self) -> Vec<u8> {
        let mut bytes = vec![0; self.texels.len()];
        for (row, texels) in self.texels.chunks(self.width).enumerate() {
            for (texel, byte) in texels.iter().zip(bytes[row..].iter_mut().step_by(self.height)) {
                *byte = (texel + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
        bytes
    }

    /// Adds value noise: independent numbers at the points of a lattice, `between` which it is
    /// smooth. `seed` says whose number a point gets.
    pub(super) fn add_noise(&mut self, spacing_m: f64, amplitude: f32, seed: impl Fn([f64; 2]) -> u64) {
        let texels_per_cell = spacing_m * self.texels_per_m;
        let columns = (self.width as f64 / texels_per_cell) as usize + 2;
        let lattice_row = |row: usize| -> Vec<f32> {
            let number = |column: usize| {
                let seed = seed([column as f64 * spacing_m, row as f64 * spacing_m]);
                unit(derived_seed(seed, ((row as u64) << 32) | column as u64)) as f32 * 2.0 - 1.0
            };
            (0..columns).map(number).collect()
        };
        let smooth = |share: f32| share * share * (3.0 - 2.0 * share);
        // The number to the left of each column, and how far the column is from it.
        let columns_between: Vec<(usize, f32)> = (0..self.width)
            .map(|column| {
                let x = (column as f64 / texels_per_cell) as f32;
                (x as usize, smooth(x.fract()))
            })
            .collect();
        let mut above = usize::MAX;
        let mut upper = Vec::new();
        let mut lower = Vec::new();
        for (row, texels) in self.texels.chunks_mut(self.width).enumerate() {
            let y = row as f64 / texels_per_cell;
            if above != y as usize {
                above = y as usize;
                (upper, lower) = (lattice_row(above), lattice_row(above + 1));
            }
            let down = smooth((y - above as f64) as f32);
            for (texel, &(left, across)) in texels.iter_mut().zip(&columns_between) {
                let blend = |row: &[f32]| row[left] + across * (row[left + 1] - row[left]);
                *texel += amplitude * (blend(&upper) + down * (blend(&lower) - blend(&upper)));
            }
        }
    }

    /// Paints a leaf over what is there; edges cover texels in part.
    pub(super) fn put(&mut self, leaf: &Leaf) {
        let (sin, cos) = leaf.turn_rad.sin_cos();
        let ([length, width], edge_m) = (leaf.half_m, 1.0 / self.texels_per_m);
        let reach_m = [
            (cos * length).abs() + (sin * width).abs() + edge_m,
            (sin * length).abs() + (cos * width).abs() + edge_m,
        ];
        let span = |axis: usize, size: usize| {
            let bound = |metres: f64| ((metres * self.texels_per_m).max(0.0) as usize).min(size);
            bound(leaf.center_m[axis] - reach_m[axis])..bound(leaf.center_m[axis] + reach_m[axis] + edge_m)
        };
        let (columns, rows) = (span(0, self.width), span(1, self.height));
        for row in rows {
            let y = (row as f64 + 0.5) / self.texels_per_m - leaf.center_m[1];
            for column in columns.clone() {
                let x = (column as f64 + 0.5) / self.texels_per_m - leaf.center_m[0];
                let distance = leaf.distance_m(cos * x + sin * y, cos * y - sin * x);
                let cover = (0.5 - distance * self.texels_per_m).clamp(0.0, 1.0) as f32 * leaf.opacity;
                let texel = &mut self.texels[row * self.width + column];
                *texel += cover * (leaf.grey - *texel);
            }
        }
    }

    /// Covers a rectangle with a picture; `grey` gives its value at points from [0, 0], its upper
    /// left corner, to [1, 1].
    pub(super) fn put_picture(
        &mut self,
        corner_m: [f64; 2],
        size_m: [f64; 2],
        grey: impl Fn([f64; 2]) -> f32,
    ) {
        let span = |axis: usize, size: usize| {
            let texel = |metres: f64| ((metres * self.texels_per_m).round().max(0.0) as usize).min(size);
            texel(corner_m[axis])..texel(corner_m[axis] + size_m[axis])
        };
        let (columns, rows) = (span(0, self.width), span(1, self.height));
        for row in rows {
            for column in columns.clone() {
                let middle = [column, row].map(|texel| (texel as f64 + 0.5) / self.texels_per_m);
                let point = [0, 1].map(|axis| (middle[axis] - corner_m[axis]) / size_m[axis]);
                self.texels[row * self.width + column] = grey(point);
            }
        }
    }
}
