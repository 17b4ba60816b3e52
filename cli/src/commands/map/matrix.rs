//! `waypost map matrix`: which places of a map look alike.

use std::path::PathBuf;

use image::imageops::{FilterType, resize};
use image::{ImageFormat, Rgb, RgbImage};
use waypost_client::v1::matrix_mark::Kind;
use waypost_client::{Client, v1};

use crate::failure::Failure;
use crate::files::Replacing;
use crate::names::short_map;
use crate::output::Output;

/// Show which places of a map look alike, or like those of another map of the same model
///
/// Places are in the order of sessions and time. The brighter a pixel of the picture, the more of
/// what its row's place shows speaks for its column's place. Loop closures are orange, other links
/// are blue, and lines part sessions.
#[derive(clap::Args)]
pub(crate) struct Matrix {
    /// Name of the map
    name: String,
    /// Name of a map to compare it with, in place of itself
    #[arg(long, value_name = "MAP")]
    against: Option<String>,
    /// Write the matrix as PNG: some pixels for each two places of small maps, one for up to 32 x 32 of large ones
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "picture")]
    force: bool,
}

const CLOSURE: Rgb<u8> = Rgb([0xe6, 0x9f, 0x00]);
const LINK: Rgb<u8> = Rgb([0x56, 0xb4, 0xe9]);
const BORDER: Rgb<u8> = Rgb([0x60, 0x60, 0x60]);

/// Pictures of up to so many pixels a side have a pixel for each two places.
const MOST_PIXELS: usize = 2048;

/// Smaller ones are drawn larger, by a whole number, up to so many pixels a side.
const LARGE_ENOUGH_PIXELS: u32 = 800;

pub(super) async fn matrix(client: &Client, asked: Matrix, output: Output) -> Result<(), Failure> {
    let Matrix { name, against, picture, force } = asked;
    let replacing = Replacing::of(force);
    replacing.check_wanted(picture.as_deref())?;
    let described = client.match_matrix(&name, against.as_deref()).await?;
    if let Some(file) = &picture {
        replacing.write(file, &drawn(client, &described).await?)?;
    }
    output.result(&described, |out| {
        writeln!(out, "{} against {}", short_map(&described.map), short_map(&described.against))?;
        for (what, axis) in [("rows", &described.rows), ("columns", &described.columns)] {
            let axis = axis.clone().unwrap_or_default();
            writeln!(out, "  {what:<8} {} places", axis.place_numbers.len())?;
            for v1::MatrixSession { session, first, places } in axis.sessions {
                let end = (first + places).saturating_sub(1);
                let name = session.rsplit('/').next().unwrap_or_default();
                writeln!(out, "    {first} to {end}: {name}")?;
            }
        }
        let closures = described.marks.iter().filter(|mark| mark.kind() == Kind::LoopClosure).count();
        writeln!(
            out,
            "  marks    {closures} loop closures, {} other links",
            described.marks.len() - closures
        )?;
        writeln!(out, "  white    {:.1} nats and above; black 0 and below", described.full_shade_nats)?;
        picture.as_ref().map_or(Ok(()), |file| writeln!(out, "picture in {}", file.display()))
    })
}

/// The matrix as PNG, of the finest level that makes it small enough.
async fn drawn(client: &Client, described: &v1::MatchMatrix) -> Result<Vec<u8>, Failure> {
    let v1::MatchMatrix { map, against, tile_cells, levels, .. } = described;
    let sides = [&described.rows, &described.columns].map(|axis| axis.clone().unwrap_or_default());
    let places = sides.each_ref().map(|axis| axis.place_numbers.len());
    let most = places[0].max(places[1]);
    let last = levels.saturating_sub(1);
    let level = (0..last).find(|level| most >> level <= MOST_PIXELS).unwrap_or(last);
    let cells = places.map(|places| (places.div_ceil(1 << level) as u32).max(1));
    let mut picture = RgbImage::new(cells[1], cells[0]);
    let tiles = places.map(|places| places.div_ceil((*tile_cells as usize) << level) as u32);
    for row in 0..tiles[0] {
        for column in 0..tiles[1] {
            let (map, against) = (map.clone(), against.clone());
            let request = v1::GetMatchMatrixTileRequest { map, against, level, row, column };
            let tile = client.match_matrix_tile(request).await?;
            let tile = image::load_from_memory_with_format(&tile, ImageFormat::Png)
                .map_err(|error| unreadable(&error))?;
            for (x, y, shade) in tile.to_luma8().enumerate_pixels() {
                let (x, y) = (column * tile_cells + x, row * tile_cells + y);
                if let Some(pixel) = picture.get_pixel_mut_checked(x, y) {
                    *pixel = Rgb([shade.0[0]; 3]);
                }
            }
        }
    }
    for (side, axis) in sides.iter().enumerate() {
        for session in axis.sessions.iter().filter(|session| session.first > 0) {
            let at = session.first >> level;
            for along in 0..cells[1 - side] {
                let (x, y) = if side == 0 { (along, at) } else { (at, along) };
                picture.put_pixel(x, y, BORDER);
            }
        }
    }
    for closures in [false, true] {
        for mark in described.marks.iter().filter(|mark| (mark.kind() == Kind::LoopClosure) == closures) {
            let (row, column) = (mark.row >> level, mark.column >> level);
            let colour = if closures { CLOSURE } else { LINK };
            picture.put_pixel(column, row, colour);
            picture.put_pixel(row, column, colour);
        }
    }
    let times = (LARGE_ENOUGH_PIXELS / cells[0].max(cells[1])).max(1);
    let picture = resize(&picture, times * cells[1], times * cells[0], FilterType::Nearest);
    let mut png = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).map_err(|error| unreadable(&error))?;
    Ok(png.into_inner())
}

fn unreadable(error: &image::ImageError) -> Failure {
    Failure::Unfit(format!("the server's picture of the matrix cannot be used: {error}"))
}
