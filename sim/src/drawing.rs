//! A floor plan as a picture, with what happened on it.

use std::fmt::Write;

use nalgebra::Vector2;

use crate::floor_plan::FloorPlan;

/// Something to draw over a plan, in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// What it is, for the legend; nothing for none.
    pub name: String,
    /// As SVG knows it: `#1459aa`, `crimson`.
    pub colour: String,
    /// What is drawn.
    pub marks: Marks,
}

/// How something is drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Marks {
    /// One line from point to point.
    Path(Vec<Vector2<f64>>),
    /// Lines from one point to another, each as dark as its weight from 0 to 1.
    Links(Vec<(Vector2<f64>, Vector2<f64>, f64)>),
    /// Dots.
    Dots(Vec<Vector2<f64>>),
}

const PIXELS_PER_M: f64 = 32.0;
const MARGIN_M: f64 = 0.5;
const LEGEND_M: f64 = 0.6;

/// Points of a path that are nearer to the one before are not drawn.
const APART_M: f64 = 0.1;

/// One file of SVG with y upwards, as on a map: rooms, walls, furniture, the rooms' names, and the
/// layers over them in their order.
#[must_use]
pub fn plan_svg(plan: &FloorPlan, layers: &[Layer]) -> String {
    let [min, max] = bounds(plan, layers);
    let named = layers.iter().filter(|layer| !layer.name.is_empty());
    let legend_m = LEGEND_M * named.clone().count() as f64;
    let [width, height] = [max.x - min.x + 2.0 * MARGIN_M, max.y - min.y + 2.0 * MARGIN_M + legend_m];
    let at = |point: Vector2<f64>| {
        format!(
            "{:.1},{:.1}",
            (point.x - min.x + MARGIN_M) * PIXELS_PER_M,
            (max.y - point.y + MARGIN_M) * PIXELS_PER_M
        )
    };
    let mut svg = String::new();
    let [width, height] = [width, height].map(|side| side * PIXELS_PER_M);
    push(
        &mut svg,
        format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" \
         height=\"{height:.0}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        ),
    );
    draw_plan(&mut svg, plan, &at);
    for layer in layers {
        draw_marks(&mut svg, layer, &at);
    }
    for (line, layer) in (0..).zip(named) {
        let y = min.y - MARGIN_M - LEGEND_M * (f64::from(line) + 0.3);
        let [left, right, text] = [0.0, 0.8, 1.0].map(|x| at(Vector2::new(min.x + x, y)));
        let (Layer { name, colour, .. }, (x, y)) = (layer, text.split_once(',').unwrap_or_default());
        let name = escaped(name);
        push(
            &mut svg,
            format_args!(
                "<polyline points=\"{left} {right}\" stroke=\"{colour}\" stroke-width=\"3\"/>\
             <text x=\"{x}\" y=\"{y}\" dominant-baseline=\"middle\">{name}</text>\n"
            ),
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// Of the plan and of what lies beyond it.
fn bounds(plan: &FloorPlan, layers: &[Layer]) -> [Vector2<f64>; 2] {
    let points = layers.iter().flat_map(|layer| match &layer.marks {
        Marks::Path(points) | Marks::Dots(points) => points.clone(),
        Marks::Links(links) => links.iter().flat_map(|&(from, to, _)| [from, to]).collect(),
    });
    points.fold(plan.bounds(), |[min, max], point| [min.inf(&point), max.sup(&point)])
}

/// The points of a path without those too close together to be seen; both ends stay.
fn thinned(points: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let mut kept: Vec<Vector2<f64>> = Vec::new();
    for &point in points {
        if kept.last().is_none_or(|last| (point - last).norm() >= APART_M) {
            kept.push(point);
        }
    }
    kept.extend(points.last().filter(|&last| kept.last() != Some(last)));
    kept
}

fn draw_plan(svg: &mut String, plan: &FloorPlan, at: &impl Fn(Vector2<f64>) -> String) {
    let polygon =
        |corners: &[Vector2<f64>]| corners.iter().map(|&corner| at(corner)).collect::<Vec<_>>().join(" ");
    for room in &plan.parts().rooms {
        let (min, max) = (room.min, room.max);
        let corners = polygon(&[min, Vector2::new(max.x, min.y), max, Vector2::new(min.x, max.y)]);
        let center = at(room.center());
        let ((x, y), name) = (center.split_once(',').unwrap_or_default(), escaped(&room.name));
        push(
            svg,
            format_args!(
                "<polygon points=\"{corners}\" fill=\"#f4f4f0\"/><text x=\"{x}\" y=\"{y}\" text-anchor=\"middle\" \
             fill=\"#999\">{name}</text>\n"
            ),
        );
    }
    for item in &plan.parts().furniture {
        let corners = polygon(&item.corners());
        push(svg, format_args!("<polygon points=\"{corners}\" fill=\"#d8c8a8\" stroke=\"#a89878\"/>\n"));
    }
    for wall in plan.parts().walls.iter().filter(|wall| wall.bottom_m < FloorPlan::HEADROOM_M) {
        let ends = polygon(&[wall.from, wall.to]);
        push(svg, format_args!("<polyline points=\"{ends}\" stroke=\"#333\" stroke-width=\"3\"/>\n"));
    }
}

fn draw_marks(
    svg: &mut String,
    Layer { name: _, colour, marks }: &Layer,
    at: &impl Fn(Vector2<f64>) -> String,
) {
    match marks {
        Marks::Path(points) => {
            let points = thinned(points).into_iter().map(at).collect::<Vec<_>>().join(" ");
            push(
                svg,
                format_args!(
                    "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>\n"
                ),
            );
        }
        Marks::Links(links) => {
            for (from, to, weight) in links {
                let (from, to) = (at(*from), at(*to));
                push(
                    svg,
                    format_args!(
                        "<polyline points=\"{from} {to}\" stroke=\"{colour}\" stroke-opacity=\"{weight:.2}\"/>\n"
                    ),
                );
            }
        }
        Marks::Dots(points) => {
            for point in points.iter().map(|&point| at(point)) {
                let (x, y) = point.split_once(',').unwrap_or_default();
                push(svg, format_args!("<circle cx=\"{x}\" cy=\"{y}\" r=\"4\" fill=\"{colour}\"/>\n"));
            }
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn push(svg: &mut String, text: std::fmt::Arguments<'_>) {
    // A string takes everything.
    let _ = svg.write_fmt(text);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worlds::NamedWorld;

    #[test]
    fn the_picture_has_all_that_is_there() {
        let plan = NamedWorld::BooijOffice.plan(1);
        let [from, to] = [[1.0, 1.0], [2.0, 1.0]].map(Vector2::from);
        let layer = |name: &str, marks| Layer { name: name.to_owned(), colour: "crimson".to_owned(), marks };
        let layers = [
            layer("truth <here>", Marks::Path(vec![from, to])),
            layer("", Marks::Links(vec![(from, to, 0.5)])),
            layer("", Marks::Dots(vec![from])),
        ];
        let svg = plan_svg(&plan, &layers);
        let count = |what: &str| svg.matches(what).count();
        let parts = plan.parts();
        assert_eq!(count("<polygon"), parts.rooms.len() + parts.furniture.len());
        assert_eq!(count("#333"), parts.walls.iter().filter(|wall| wall.bottom_m == 0.0).count());
        assert_eq!((count("<circle"), count("stroke-opacity"), count("truth &lt;here>")), (1, 1, 1));
        // y is up: the lower end of the plan is further down in the file's own axes, which begin
        // 0.5 m above 7 m.
        assert!(svg.contains("48.0,208.0 80.0,208.0"));
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"));
    }
}
